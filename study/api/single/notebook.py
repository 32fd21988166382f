"""A simulation and a calibration as a notebook shows them: a frame, a table in HTML, a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from study.api.single.fit_figure import panels_of
from study.fem.solver.solution import Solution
from study.reporting.figure.curves.fit import draw_fit
from study.reporting.figure.curves.single import draw_curve
from study.reporting.figure.style import shown
from study.reporting.notebook import Shown
from study.runner.calibration.result import CalibrationResult

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


@dataclass(frozen=True, repr=False)
class Calibrated(Shown, CalibrationResult):
    """What :func:`study.calibrate` returns: a :class:`CalibrationResult` that can be shown."""

    digits: ClassVar[int] = 5

    @classmethod
    def of(cls, found: CalibrationResult) -> Calibrated:
        """Give a calibration the ways to be shown."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(CalibrationResult)})

    def to_frame(self) -> pd.DataFrame:
        """Constants with one row each.

        Returns
        -------
        DataFrame
            ``constant``, ``value``, ``unit``, ``standard_error``, ``low`` and ``high`` (95 %).
        """
        import pandas as pd

        document = self.to_json()["parameters"]
        rows = [
            {"constant": name, "value": one["value"], "unit": one["unit"],
             "standard_error": one["standard_error"], "low": one["ci95"][0],
             "high": one["ci95"][1]}
            for name, one in (document.items() if isinstance(document, dict) else ())
        ]  # fmt: skip
        return pd.DataFrame(rows)

    def plot(self) -> Drawing:
        """Draw every measured curve with its fit or prediction, and the residuals below.

        Returns
        -------
        Figure
            Of matplotlib.
        """
        title = f"{self.name}: {self.model}, {self.status}"
        return shown(lambda: draw_fit(panels_of(self), title), "calibration", title)

    def tables(self) -> Sequence[pd.DataFrame]:
        """Constants with their intervals."""
        return (self.to_frame(),)
