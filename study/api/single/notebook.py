"""A simulation as a notebook shows it: a frame, a table in HTML, a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from study.fem.solver.solution import Solution
from study.reporting.figure.curves.single import draw_curve
from study.reporting.figure.style import shown
from study.reporting.notebook import Shown

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figure.style import Drawing


@dataclass(frozen=True, repr=False)
class SolvedProblem(Shown, Solution):
    """What :func:`study.solve` returns: a :class:`Solution` that can be shown."""

    digits: ClassVar[int] = 6

    @classmethod
    def of(cls, found: Solution) -> SolvedProblem:
        """Give a solution the ways to be shown."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(Solution)})

    def to_frame(self) -> pd.DataFrame:
        """Curve with one row a load step.

        Returns
        -------
        DataFrame
            ``displacement_mm``, ``force_N``, ``stiffness_N_per_mm``, and dF/d(constant) in N per
            MPa as ``force_gradient_NAME``.
        """
        import pandas as pd

        curve = self.curve
        gradients = {f"force_gradient_{n}": g for n, g in curve.force_gradient.items()}
        columns = {"displacement_mm": curve.displacement_mm, "force_N": curve.force_N}
        if curve.stiffness_N_per_mm is not None:
            columns["stiffness_N_per_mm"] = curve.stiffness_N_per_mm
        return pd.DataFrame(columns | gradients)

    def plot(self) -> Drawing:
        """Draw force against displacement.

        Returns
        -------
        Figure
            Of matplotlib.

        Raises
        ------
        ValueError
            If no step converged.
        """
        if not len(self.curve):
            raise ValueError(f"there is nothing to draw: {self.message}")
        return shown(lambda: draw_curve(self.curve), "solution", "force against displacement")

    def tables(self) -> Sequence[pd.DataFrame]:
        """How it ended, and its curve."""
        import pandas as pd

        facts = pd.DataFrame(
            [[self.status, self.dofs, self.elements, self.solver, self.seconds.get("total")]],
            columns=["status", "unknowns", "elements", "solver", "seconds"],
        )
        return facts, self.to_frame()[["displacement_mm", "force_N"]]
