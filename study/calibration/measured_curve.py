"""A measured curve of a fit, and what must hold of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from study.arrays import Array
from study.curve import Curve
from study.errors import Fault


@dataclass(frozen=True)
class MeasuredCurve:
    """One measured curve of a fit.

    Parameters
    ----------
    label : str
        How reports and errors call it.
    curve : Curve
        Displacement and force.
    weight : float or ndarray, shape (n,)
        Factor on the residual, for instance one over the scatter; zero leaves a point out.
    role : str
        ``fit``, or ``held-out``: predicted and scored, never fitted.
    recordings : tuple of Curve
        Rows as recorded, of every repeat, whose linear interpolation and mean the curve is;
        none where the curve's points are the rows.
    """

    label: str
    curve: Curve
    weight: float | Array = 1.0
    role: Literal["fit", "held-out"] = "fit"
    recordings: tuple[Curve, ...] = ()

    @property
    def weights(self) -> Array:
        """Weight of every point, shape (n,)."""
        return np.broadcast_to(np.asarray(self.weight, float), (len(self.curve),))


def curve_faults(measured: MeasuredCurve) -> list[Fault]:
    """Say what of a curve cannot be fitted.

    Parameters
    ----------
    measured : MeasuredCurve
        Its force must also resist where its role is ``fit``.

    Returns
    -------
    list of Fault
        Empty where nothing is wrong.
    """
    d, force = measured.curve.displacement_mm, measured.curve.force_N
    where = f"curve {measured.label!r}"
    if d.size == 0 or d.shape != force.shape:
        return [Fault(where, f"has {d.size} displacements and {force.size} forces")]
    if not (np.all(np.isfinite(d)) and np.all(np.isfinite(force))):
        return [Fault(where, "holds numbers that are not finite")]
    try:
        weights = measured.weights
    except ValueError:
        return [Fault(where, f"has {np.size(measured.weight)} weights for {d.size} points")]
    if not (np.all(np.isfinite(weights)) and np.all(weights >= 0)):
        return [Fault(where, "weights must be finite and not negative")]
    used = weights > 0
    if measured.role == "fit" and np.count_nonzero(used) > 1:
        if measured.curve.time_s is None:
            return _force_faults(where, d[used], force[used])
        return _course_faults(where, d[used], force[used])
    return []


def _course_faults(where: str, d: Array, force: Array) -> list[Fault]:
    """Say that a course in time does not resist: its force may fall while it is held."""
    if float(d @ force) <= 0:
        mend = "a force that resists is positive: see `sign` of the measurements"
        return [Fault(where, "the force does not resist the displacement", mend)]
    return []


def _force_faults(where: str, d: Array, force: Array) -> list[Fault]:
    if np.ptp(force) <= 1e-9 * np.abs(force).max():
        return [Fault(where, f"is constant ({force[0]:g} N everywhere): no stiffness to fit")]
    if float((d - d.mean()) @ (force - force.mean())) <= 0:
        mend = "a force that resists is positive: see `sign` of the measurements"
        return [Fault(where, "the force falls as the displacement grows", mend)]
    return []
