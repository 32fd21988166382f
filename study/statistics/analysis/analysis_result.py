"""The result of an analysis: one frozen value from the checked rows to the verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.canonical import Keyed
from study.statistics.analysis.anova_table import Anova, ErrorTerm
from study.statistics.analysis.data import Structure
from study.statistics.analysis.effects import Gate, Scale, TermEstimate, size
from study.statistics.analysis.sums_of_squares import influence, summary_of
from study.statistics.analysis.unreplicated import Copies, functional_shares
from study.statistics.convergence.contrast_bound import OneBound

if TYPE_CHECKING:
    import pandas as pd

    from study.statistics.analysis.analysis_request import AnalysisRequest
    from study.statistics.analysis.anova_table import (
        AnalysisSensitivity,
        BoxCoxResult,
        Contrast,
        Effect,
        FailureBound,
        Influential,
        ModelSummary,
        NestedUnits,
        PowerRow,
    )
    from study.statistics.analysis.data import Crossed, Data
    from study.statistics.analysis.equal_variance import SpreadTest
    from study.statistics.analysis.linear_model import Term
    from study.statistics.analysis.normality import NormalityResult, RowTest, RyanJoinerResult
    from study.statistics.analysis.simple_effects import SimpleEffects
    from study.statistics.analysis.sums_of_squares import Factored, SphericityResult, TwoWayFit
    from study.statistics.analysis.unreplicated import LenthResult, NonAdditivityResult


@dataclass(frozen=True)
class Assumptions(Keyed):
    """Tests of what the analysis assumes; what does not apply is None."""

    KEYS = (
        "normality=normality.to_json normality_rows variance sphericity non_additivity influence "
        "robustness box_cox"
    )

    normality: RyanJoinerResult | None = None
    normality_rows: tuple[RowTest, ...] = ()
    bartlett: SpreadTest | None = None
    levene: SpreadTest | None = None
    #: Statistic and p of Fligner and Killeen's test.
    fligner: tuple[float, float] | None = None
    sphericity: dict[str, SphericityResult] = field(default_factory=dict)
    non_additivity: NonAdditivityResult | None = None
    anderson_darling: NormalityResult | None = None
    shapiro_wilk: NormalityResult | None = None
    #: Rows that the fit leans on.
    influence: Influential | None = None
    robustness: AnalysisSensitivity | None = None
    box_cox: BoxCoxResult | None = None

    @property
    def spread(self) -> dict[str, SpreadTest]:
        """Tests of equal spread that were run, by name."""
        tests = {"bartlett": self.bartlett, "levene": self.levene}
        return {name: test for name, test in tests.items() if test is not None}

    @property
    def variance(self) -> dict[str, object]:
        """Documents of the tests of equal spread; null where they do not apply."""
        documents = {name: test.to_json() for name, test in self.spread.items()}
        return {"bartlett": None, "levene": None, **documents, "fligner": self.fligner}


#: what a constant response is compared with
NO_ERROR = ErrorTerm("E7", "no p: nothing varies", 0.0, "constant response")


@dataclass(frozen=True)
class AnalysisResult(Keyed):
    """Everything that one response of a factorial can tell; grows by ``replace``.

    What follows from the rows and the fit alone (means of cells, residuals, shares) is computed
    when it is asked for.
    """

    KEYS = (
        "response=request.response transform=request.scale.transform error_term anova effects "
        "structure shares distinct_computations=distinct copies=copied_cells lenth summary "
        "failure_bounds nested power contrasts warnings=notes"
    )

    request: AnalysisRequest
    #: Rows that were analyzed.
    data: Data
    #: Terms of the model.
    terms: tuple[Term, ...]
    #: Of the solver, in the unit of the response.
    tolerance: float
    #: What the rows of one cell are: runs, mesh-seeds, noise.
    replicates: str = "runs"
    #: What the table is: step of the readings, nesting, empty cells, terms that are not told apart.
    structure: Structure = field(default_factory=Structure)
    #: Largest numerical uncertainty of an effect, in the unit of the response.
    u_num: float | None = None
    #: Response on the working scale.
    y: Array = field(default_factory=lambda: np.zeros(0))
    #: What turns differences into verdicts.
    scale: Scale = field(default_factory=lambda: Scale("none", None, None, False))
    #: What to beware of, in sentences.
    notes: tuple[str, ...] = ()
    #: Cells that agree in every block.
    copies: Copies = ()
    #: What effects are compared with, and which question p answers.
    error_term: ErrorTerm = NO_ERROR
    #: Table of the sums of squares.
    anova: Anova = field(default_factory=lambda: Anova("II", ()))
    #: Size of every term with its interval and verdict.
    effects: tuple[Effect, ...] = ()
    #: Whose residuals are judged; cells and blocks where strata have errors of their own.
    fit: Factored | TwoWayFit | None = None
    #: Of the terms by least squares: to all rows, or to what they are within whole plots.
    model: Factored | None = None
    #: Lenth's analysis of an unreplicated design.
    lenth: LenthResult | None = None
    #: Cells against blocks, where effects are tested against their own interactions.
    crossed: Crossed | None = None
    #: Whole plot of each row; None where there are none.
    plots: Ints | None = None
    #: What claims have to pass; None of a constant response.
    gate: Gate | None = None
    #: Tests of what the analysis assumes.
    assumptions: Assumptions = field(default_factory=Assumptions)
    #: Detectable difference of each factor with other numbers of blocks or replicates.
    power: dict[str, tuple[PowerRow, ...]] = field(default_factory=dict)
    #: What missing responses could do to the conclusion.
    failure_bounds: tuple[FailureBound, ...] = ()
    #: What taking rows on one unit as independent would have claimed.
    nested: NestedUnits | None = None
    #: Differences of two settings that were asked for by name.
    contrasts: tuple[Contrast, ...] = ()

    def warn(self, *notes: str) -> AnalysisResult:
        """Copy with more notes."""
        return replace(self, notes=(*self.notes, *notes))

    def concluded(
        self,
        error: ErrorTerm,
        table: Anova,
        estimates: Sequence[TermEstimate],
        gate: Gate,
        judged: Mapping[str, SimpleEffects] | None = None,
    ) -> AnalysisResult:
        """Copy with a table, the sizes of its terms, and their verdicts behind the gate."""
        judged = gate.judged(self.terms) if judged is None else judged
        effects = tuple(size(estimate, self.scale, judged) for estimate in estimates)
        out = replace(self, error_term=error, anova=table, effects=effects, gate=gate)
        return out.warn(*gate.notes)

    def constant(self) -> AnalysisResult:
        """Say that the response does not vary: there is no analysis of variance."""
        y = self.data.y
        message = (
            f"{self.request.response} is constant ({y[0]:.6g} in all {y.size} rows, to rounding or "
            "solver tolerance): no ANOVA"
        )
        copies = tuple(np.unique(self.data.cell).tolist())
        return replace(self, y=y, copies=(copies,)).warn(*self.data.warnings, message)

    def working_tolerance(self) -> float:
        """Ten solver tolerances on the working scale."""
        if self.request.scale.is_log:
            return 10 * self.tolerance / float(np.abs(self.data.y).min())
        return 10 * self.tolerance

    @property
    def grand_mean(self) -> float:
        """Mean of the response, the geometric one of a log response."""
        return self.scale.back(self.y[0] + float(np.mean(self.y - self.y[0])))

    @property
    def u_num_by_term(self) -> bool:
        """Whether each effect has a numerical uncertainty of its own."""
        return self.scale.bound is not None and not isinstance(self.scale.bound, OneBound)

    @property
    def summary(self) -> ModelSummary | None:
        """Residual standard deviation and coefficients of determination."""
        return None if self.model is None or self.plots is not None else summary_of(self.model)

    @property
    def shares(self) -> dict[str, float]:
        """Functional-ANOVA share of every term, where every cell exists."""
        data = self.data
        if self.error_term is NO_ERROR:
            return {}
        size = int(np.prod([len(data.layout.levels[f]) for f in data.factors]))
        counts = np.bincount(data.cell, minlength=size)
        if counts.min() == 0:
            return {}
        shift = self.y[0]
        means = np.bincount(data.cell, weights=self.y - shift, minlength=size) / counts + shift
        return functional_shares(data.layout, data.factors, means)

    @property
    def distinct(self) -> int:
        """Number of distinct computations."""
        return len(self.copies)

    @property
    def copied_cells(self) -> tuple[tuple[str, ...], ...]:
        """Names of the cells that agree in every block, group by group."""
        names = self.data.cell_names()
        return tuple(tuple(names[c] for c in g) for g in self.copies if len(g) > 1)

    @property
    def is_representative(self) -> Flags:
        """Whether each row belongs to the cell that stands for its copies, shape (n,)."""
        return np.isin(self.data.cell, [group[0] for group in self.copies])

    @cached_property
    def cell_means(self) -> pd.DataFrame:
        """One row a cell: levels, ``n``, ``mean``, ``sd``, ``representative``."""
        import pandas as pd

        data = self.data
        rows = []
        copies = {cell for group in self.copies for cell in group[1:]}
        order = np.argsort(data.cell, kind="stable")
        cells, start = np.unique(data.cell[order], return_index=True)
        for cell, here in zip(cells.tolist(), np.split(order, start[1:]), strict=True):
            values, shifted = data.y[here], data.y[here] - data.y[here[0]]
            levels = {f: data.layout.levels[f][data.layout.codes[f][here[0]]] for f in data.factors}
            mean = values[0] + float(np.mean(shifted))
            if self.request.scale.is_log:
                mean = float(np.exp(np.mean(np.log(values))))
            sd = float(np.std(shifted, ddof=1)) if values.size > 1 else None
            size = {"n": values.size, "mean": mean, "sd": sd, "representative": cell not in copies}
            rows.append({**levels, **size})
        return pd.DataFrame(rows)

    @cached_property
    def residuals(self) -> pd.DataFrame:
        """One row a run: levels, ``response``, ``fitted``, ``residual``, ``leverage``, ``cook``.

        ``representative`` says whether its cell stands for copies, ``block`` where it was run.
        """
        import pandas as pd

        data, names = self.data, self.data.cell_names()
        cell, is_first = [names[c] for c in data.cell], self.is_representative
        frame = {"row": data.rows, "cell": cell, "representative": is_first, "response": data.y}
        if data.block is not None:
            frame["block"] = data.layout.labels(data.block)
        if self.fit is not None:
            frame["fitted"], frame["residual"] = self.fit.fitted, self.fit.residual
            of_rows = influence(self.fit)
            frame["leverage"], frame["cook"] = of_rows.leverage, of_rows.cook
        of_factors = {f: data.layout.labels(f) for f in data.factors if f not in frame}
        return pd.DataFrame({**frame, **of_factors})

    def effect(self, term: str) -> Effect:
        """Effect of a term."""
        return next(item for item in self.effects if item.term == term)

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key, the tests of what is assumed among them."""
        effects = [effect.to_json() for effect in self.effects]
        return super().keyed() | {"effects": effects, **self.assumptions.to_json()}

    def verdicts(self) -> list[dict[str, object]]:
        """One line a factor or interaction, as ``study run --json`` lists them."""
        lines = []
        for effect in self.effects:
            document = effect.to_json() | {"of_components": effect.of_components or None}
            pairs = (key.partition("=") for key in _VERDICT_KEYS.split())
            line = {key: document[name or key] for key, _, name in pairs}
            lines.append({"response": self.request.response, **line})
        return lines


def kind_of(out: AnalysisResult, even: bool, why: str = "unbalanced") -> tuple[str, AnalysisResult]:
    """Type of the sums; unbalanced data take Type III with sum contrasts, and say so."""
    kind = "auto" if out.request.any_type else out.request.sums
    if even:
        return ("II" if kind == "auto" else kind), out
    if kind == "auto" and out.structure.empty_cells:
        n = out.structure.empty_cells
        cells = "1 cell is empty" if n == 1 else f"{n} cells are empty"
        return "I", out.warn(f"{cells}: Type I, each term given those before it")
    if kind == "auto":
        return "III", out.warn(f"{why}: Type III with sum-to-zero contrasts")
    return kind, out.warn(f"{why}: Type {kind} as asked")


#: keys of the line of a factor, with the field of its effect where it has another name
_VERDICT_KEYS = (
    "factor=term verdict effect=range ci95 practical u_num p effect_over_u_num resolved why "
    "U=u_num U_needed=u_needed p_holm lost_without of_components simple_effects withdrawn"
)
