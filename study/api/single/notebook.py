"""A simulation and a calibration as a notebook shows them: a frame, a table in HTML, a figure."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from study.api.single.fit_figure import panels_of
from study.fem.solver.solution import Solution
from study.reporting.figure.curves.fit import draw_fit
from study.reporting.figure.curves.single import draw_curve
from study.reporting.figure.style import shown
from study.runner.calibration.result import CalibrationResult

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figure.style import Drawing


@dataclass(frozen=True)
class SolvedProblem(Solution):
    """What :func:`study.solve` returns: a :class:`Solution` that can be shown."""

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

    def _repr_html_(self) -> str:
        """Curve, and how it ended, as the last line of a cell shows them."""
        import pandas as pd

        facts = pd.DataFrame(
            [[self.status, self.dofs, self.elements, self.solver, self.seconds.get("total")]],
            columns=["status", "unknowns", "elements", "solver", "seconds"],
        )
        tables = (facts, self.to_frame()[["displacement_mm", "force_N"]])
        return "\n".join(
            one.to_html(index=False, float_format=lambda x: f"{x:.6g}") for one in tables
        )


@dataclass(frozen=True)
class Calibrated(CalibrationResult):
    """What :func:`study.calibrate` returns: a :class:`CalibrationResult` that can be shown."""

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

    def _repr_html_(self) -> str:
        """Constants with their intervals, as the last line of a cell shows them."""
        return self.to_frame().to_html(index=False, na_rep="", float_format=lambda x: f"{x:.5g}")
