"""What an analysis has found so far, and how it becomes the frozen result."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from study.analysis.anova_table import (
    Anova,
    BoxCoxResult,
    Effect,
    ErrorTerm,
    ModelSummary,
    Sensitivity,
)
from study.analysis.data import Crossed, Data
from study.analysis.effects.numerical_bound import SeriesBounds
from study.analysis.effects.scale import Scale
from study.analysis.effects.sizes import MOST_LEVELS
from study.analysis.linear_model.design_matrix import Term, term_name
from study.analysis.linear_model.factorization import Factorization
from study.analysis.linear_model.sphericity import SphericityResult
from study.analysis.linear_model.sums_of_squares import Factored
from study.analysis.linear_model.two_way import TwoWayFit
from study.analysis.pseudoreplication import CopyGroups
from study.analysis.request import AnalysisRequest
from study.analysis.structure import Structure
from study.analysis.unreplicated import LenthResult
from study.arrays import Array, Ints

_NO_ERROR = ErrorTerm("E7", "no p: nothing varies", 0.0, "constant response")


@dataclass(frozen=True)
class Outcome:
    """Inputs and findings of one analysis; grows by ``replace``.

    ``u_raw`` is the largest numerical uncertainty of an effect, ``u_cells`` that within which
    two cells are one computation, both in the unit of the response.
    """

    request: AnalysisRequest
    data: Data
    terms: tuple[Term, ...]
    tolerance: float
    u_raw: float | None = None
    u_cells: float | None = None
    y: Array = field(default_factory=lambda: np.zeros(0))
    scale: Scale = field(default_factory=lambda: Scale("none", None, None, False))
    warnings: tuple[str, ...] = ()
    copies: CopyGroups = field(default_factory=lambda: CopyGroups(()))
    error: ErrorTerm = _NO_ERROR
    anova: Anova = field(default_factory=lambda: Anova("II", ()))
    effects: tuple[Effect, ...] = ()
    sphericity: dict[str, SphericityResult] = field(default_factory=dict)
    fit: Factored | TwoWayFit | None = None
    lenth: LenthResult | None = None
    crossed: Crossed | None = None
    cell_model: Factorization | None = None
    plots: Ints | None = None
    replicates: str = "runs"
    structure: Structure = field(default_factory=Structure)
    summary: ModelSummary | None = None
    robustness: Sensitivity | None = None
    box_cox: BoxCoxResult | None = None

    def warn(self, *messages: str) -> Outcome:
        """Copy with more warnings."""
        return replace(self, warnings=(*self.warnings, *messages))

    def working_tolerance(self) -> float:
        """Ten solver tolerances on the working scale."""
        if self.request.scale.is_log:
            return 10 * self.tolerance / float(np.abs(self.data.y).min())
        return 10 * self.tolerance

    def constant(self) -> Outcome:
        """Outcome of a response that does not vary."""
        message = (
            f"{self.request.response} is constant ({self.data.y[0]:.6g} in all "
            f"{self.data.y.size} rows, to rounding or solver tolerance): no ANOVA"
        )
        cells = tuple(int(c) for c in np.unique(self.data.cell))
        return replace(
            self,
            y=self.data.y,
            copies=CopyGroups((cells,)),
            warnings=(*self.data.warnings, message),
        )


def kind_of(out: Outcome, even: bool, why: str = "unbalanced") -> tuple[str, Outcome]:
    """Type of the sums; unbalanced data take Type III with sum contrasts, and say so.

    Parameters
    ----------
    out : Outcome
        Its request says which type is asked for: {"auto", "I", "II", "III"}.
    even : bool
        Whether the data are balanced, or the terms orthogonal, so that all types agree.
    why : str
        How the warning begins where they are not.

    Returns
    -------
    kind : {"I", "II", "III"}
        "auto" is II for balanced data and III for others. Unbalanced records take III even where
        II is asked for.
    out : Outcome
        With a warning where the data are not balanced.
    """
    kind = out.request.sums
    if even:
        return ("II" if kind == "auto" else kind), out
    if kind == "auto" and out.structure.empty_cells:
        n = out.structure.empty_cells
        cells = "1 cell is empty" if n == 1 else f"{n} cells are empty"
        return "I", out.warn(f"{cells}: Type I, each term given those before it")
    if kind == "auto" or (out.request.records and kind == "II"):
        return "III", out.warn(f"{why}: Type III with sum-to-zero contrasts")
    return kind, out.warn(f"{why}: Type {kind} as asked")


def scale_of(out: Outcome, y: Array) -> Scale:
    """Scale of a response: its practical difference and numerical bound as was asked.

    Parameters
    ----------
    out : Outcome
        Its request holds the practical difference and the numerical uncertainty.
    y : ndarray, shape (n,)
        Response on the working scale: its logarithm where that was asked for.

    Returns
    -------
    Scale
        With the practical difference and the bound on the working scale, where one unit of the
        response is 1, or 1 / geometric mean for a log response.
    """
    asked = out.request.scale
    mean = float(np.exp(y.mean())) if asked.is_log else float(y.mean())
    limit = asked.practical
    practical = None if limit is None else limit.on_scale(mean, asked.transform)
    unit = 1 / mean if asked.is_log else 1.0
    bound = asked.bound(map(term_name, out.terms), unit)
    specimens = out.request.specimens
    measured = out.replicates not in ("mesh-seeds", "noise")
    if specimens is None and out.data.block is not None and measured:
        specimens = len(out.data.layout.levels[out.data.block])
    return Scale(
        asked.transform,
        practical,
        bound,
        out.request.records and out.data.block is None,
        unit,
        specimens,
        bound.only if isinstance(bound, SeriesBounds) else {},
    )


def range_of_bounds(out: Outcome, scale: Scale) -> tuple[float | None, float | None]:
    """Smallest and largest bound of a difference of two levels, in the unit of the response.

    A difference without a numerical error, such as one between meshes, does not count.

    Parameters
    ----------
    out : Outcome
        Its factors that are main effects of the model count, with their first 20 levels each.
    scale : Scale
        Its bound is on the working scale.

    Returns
    -------
    smallest, largest : float or None
        Both None where no difference has a bound above zero.
    """
    if scale.bound is None:
        return None, None
    pairs = (
        ({name: first}, {name: second})
        for (name,) in (term for term in out.terms if len(term) == 1)
        for first, second in combinations(out.data.layout.levels[name][:MOST_LEVELS], 2)
    )
    known = [u for pair in pairs if (u := scale.bound.of(*pair))]
    if not known:
        return None, None
    return min(known) / scale.unit, max(known) / scale.unit
