"""An analysis as a notebook shows it: a frame, a table in HTML, a figure, a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from study.analysis.result import AnalysisResult
from study.api.statistics.table_report import Source, report_data, write_page
from study.reporting.figure.effects.sizes import shown_effect_sizes
from study.reporting.notebook import Shown
from study.reporting.report import facts

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figure.style import Drawing


@dataclass(frozen=True, repr=False)
class Analysis(Shown, AnalysisResult):
    """What :func:`study.analyze` returns: an :class:`AnalysisResult` that can be shown."""

    @classmethod
    def of(cls, found: AnalysisResult) -> Analysis:
        """Give a result the ways to be shown."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(AnalysisResult)})

    def to_frame(self) -> pd.DataFrame:
        """Table of the analysis of variance, one row a term; what does not apply is missing.

        Returns
        -------
        DataFrame
            ``term``, ``df``, ``ss``, ``ms``, ``f``, ``p`` and more; means and intervals are in
            :meth:`effects_frame`.
        """
        return self.anova.to_frame()

    def tables(self) -> Sequence[pd.DataFrame]:
        """Table of variance and verdicts."""
        import pandas as pd

        if not self.anova.rows:
            return (pd.DataFrame({"note": list(self.notes)}),)
        shown = self.to_frame()[["term", "df", "ss", "ms", "f", "p"]]
        sizes = pd.DataFrame(
            [
                {"term": e.term, "difference": e.range, "low": e.low, "high": e.high,
                 "p (Holm)": e.p_holm, "verdict": e.verdict}
                for e in self.effects
            ]
        )  # fmt: skip
        return shown, sizes

    def plot(self) -> Drawing:
        """Draw the largest difference of every term with its interval against what matters.

        Returns
        -------
        Figure
            Of matplotlib.

        Raises
        ------
        ValueError
            If no effect could be estimated.
        """
        data = report_data(self, Source())
        (item,) = facts(data)
        return shown_effect_sizes(item, data.labels)

    def report(self, out_dir: str | Path, formats: Sequence[str] = ("html",)) -> Path:
        """Write the page of the analysis, as ``study analyze CSV --report`` does.

        Parameters
        ----------
        out_dir : str or Path
            Made where it is missing.
        formats : sequence of {"html", "csv", "tex", "pdf"}
            What to write.

        Returns
        -------
        Path
            The page.
        """
        return write_page(self, out_dir, formats=formats)
