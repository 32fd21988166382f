"""Every test of what an analysis assumes: its field, what fills it, and its key in JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from study.analysis.assumption.normality import anderson_darling, shapiro_wilk
from study.analysis.linear_model.influence import influential
from study.analysis.unreplicated import non_additivity
from study.canonical import plain

if TYPE_CHECKING:
    from study.analysis.anova_table import BoxCoxResult, Influential, Sensitivity
    from study.analysis.assumption.diagnostics import Diagnostics
    from study.analysis.assumption.normality import NormalityResult, RyanJoinerResult
    from study.analysis.assumption.row_normality import RowTest
    from study.analysis.assumption.variance import BartlettResult, LeveneResult
    from study.analysis.linear_model.sphericity import SphericityResult
    from study.analysis.outcome import Outcome
    from study.analysis.unreplicated import NonAdditivityResult


@dataclass(frozen=True)
class Assumptions:
    """Tests of what the analysis assumes; what does not apply is None.

    Parameters
    ----------
    normality : RyanJoinerResult or None
    normality_rows : tuple of RowTest
        Of single contrasts over blocks.
    bartlett, levene : BartlettResult, LeveneResult or None
        Of equal spread.
    sphericity : dict of str to SphericityResult
        By term.
    non_additivity : NonAdditivityResult or None
        Tukey's one degree of freedom.
    anderson_darling, shapiro_wilk : NormalityResult or None
    influence : Influential or None
        Rows that the fit leans on.
    robustness : Sensitivity or None
        p in every defensible analysis.
    box_cox : BoxCoxResult or None
    """

    normality: RyanJoinerResult | None = None
    normality_rows: tuple[RowTest, ...] = ()
    bartlett: BartlettResult | None = None
    levene: LeveneResult | None = None
    sphericity: dict[str, SphericityResult] = field(default_factory=dict)
    non_additivity: NonAdditivityResult | None = None
    anderson_darling: NormalityResult | None = None
    shapiro_wilk: NormalityResult | None = None
    influence: Influential | None = None
    robustness: Sensitivity | None = None
    box_cox: BoxCoxResult | None = None

    @property
    def spread(self) -> dict[str, BartlettResult | LeveneResult]:
        """Tests of equal spread that were run, by name."""
        tests = {"bartlett": self.bartlett, "levene": self.levene}
        return {name: test for name, test in tests.items() if test is not None}

    def to_json(self) -> dict[str, object]:
        """Return the tests by their keys in ``study analyze --json``."""
        return {
            "normality": None if self.normality is None else self.normality.to_json(),
            "normality_rows": plain(self.normality_rows),
            "variance": {
                "bartlett": None if self.bartlett is None else self.bartlett.to_json(),
                "levene": None if self.levene is None else self.levene.to_json(),
            },
            "sphericity": plain(self.sphericity),
            "non_additivity": plain(self.non_additivity),
            "influence": plain(self.influence),
            "robustness": plain(self.robustness),
            "box_cox": plain(self.box_cox),
        }


def assumptions_of(out: Outcome, found: Diagnostics) -> Assumptions:
    """Gather what the analysis assumes and how it was tested.

    Parameters
    ----------
    out : Outcome
        With its fit, where there is an error to compare with.
    found : Diagnostics
        Normality and equal spread.
    """
    fit = out.fit if out.fit is not None and out.fit.df_residual > 0 else None
    residual = None if fit is None else fit.residual
    return Assumptions(
        normality=found.normality,
        normality_rows=found.rows,
        bartlett=found.bartlett,
        levene=found.levene,
        sphericity=out.sphericity,
        non_additivity=None if fit is None else non_additivity(fit),
        anderson_darling=None if residual is None else anderson_darling(residual),
        shapiro_wilk=None if residual is None else shapiro_wilk(residual),
        influence=None if fit is None else influential(fit),
        robustness=out.robustness,
        box_cox=out.box_cox,
    )
