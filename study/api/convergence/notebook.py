"""Refinement series as a notebook shows them: a frame, a table in HTML, a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, cast

from study.reporting.figure.convergence import draw_values, value_points
from study.reporting.figure.style import shown
from study.reporting.notebook import Shown

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figure.convergence import Document
    from study.reporting.figure.style import Drawing


class SeriesDocument(Shown, dict[str, object]):
    """Document of ``study converge``, a dictionary that can be shown."""

    digits: ClassVar[int] = 6

    @property
    def _cells(self) -> Sequence[Document]:
        return cast("Sequence[Document]", self.get("cells", [self]))

    def to_frame(self) -> pd.DataFrame:
        """Return the meshes of all series, one row each.

        Returns
        -------
        DataFrame
            ``cell``, ``quantity``, ``unit``, ``mesh_size``, ``value``, and what is said of the
            series: ``behaviour``, ``observed_order``, ``extrapolated``, ``u_num``.
        """
        return value_points(self._cells)

    def plot(self) -> Drawing:
        """Draw value against mesh size, a panel a series, with the limit at zero.

        Returns
        -------
        Figure
            Of matplotlib.
        """
        frame = self.to_frame()
        return shown(lambda: draw_values(frame), "convergence", "value against mesh size")

    def tables(self) -> Sequence[pd.DataFrame]:
        """Meshes and values."""
        names = ["cell", "mesh_size", "value", "unit", "observed_order", "extrapolated", "u_num"]
        return (self.to_frame()[names],)
