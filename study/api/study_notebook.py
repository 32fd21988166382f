"""A study as a notebook shows it: a frame, verdicts in HTML, a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from study.api.assemble import report_data
from study.errors import Fault, InputError, nearest
from study.reporting.figure.effects.sizes import shown_effect_sizes
from study.reporting.notebook import Shown
from study.reporting.report import facts
from study.study_result.study_result import StudyResult

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figure.style import Drawing


@dataclass(frozen=True, repr=False)
class Study(Shown, StudyResult):
    """What :func:`study.run` and :func:`study.report` return: a study that can be shown."""

    @classmethod
    def of(cls, found: StudyResult) -> Study:
        """Give a study the ways to be shown."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(StudyResult)})

    def to_frame(self) -> pd.DataFrame:
        """Table of the study, one tidy row a case, failed ones included.

        Returns
        -------
        DataFrame
            ``case_id``, a column for every factor, ``block``, ``status`` and the responses.
        """
        return self.table

    def plot(self, response: str | None = None) -> Drawing:
        """Draw the largest difference of every term with its interval against what matters.

        Parameters
        ----------
        response : str, optional
            Name of a response; the first one by default.

        Returns
        -------
        Figure
            Of matplotlib.

        Raises
        ------
        InputError
            If the study has no such response.
        ValueError
            If no effect could be estimated.
        """
        data = report_data(self, {})
        found = {item.name: item for item in facts(data)}
        name = response or next(iter(found), "")
        if name not in found:
            rule = f"there is no response {name!r}"
            raise InputError(Fault("response", rule, nearest(name, found)))
        return shown_effect_sizes(found[name], data.labels)

    def tables(self) -> Sequence[pd.DataFrame]:
        """Cases and verdicts."""
        import pandas as pd

        shape = {"response", "factor", "verdict", "effect", "p"}
        rows = [{k: v for k, v in row.items() if k in shape} for row in self.verdicts]
        return pd.DataFrame([{"study": self.design.name, **self.cases}]), pd.DataFrame(rows)
