"""The function that is fitted: its calls, its bounds, and its derivatives by differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.setup.calibration_table import Loss

Function = Callable[[Array], tuple[Array, Array]]
#: Least and largest value of every parameter; None where nothing bounds them.
Bounds: TypeAlias = Sequence[tuple[float, float]] | None


def evaluate(function: Function, x: Array) -> tuple[Array, Array] | None:
    """Call a function for its residual and Jacobian; None where there is no finite answer."""
    # Shapes: function, x (p,).
    if not np.all(np.isfinite(x)):
        return None
    try:
        with np.errstate(all="ignore"):  # a far trial point may overflow: that is a rejection
            residual, jacobian = function(x.copy())
    except (EvaluationFailed, OverflowError, ZeroDivisionError):
        return None
    residual = np.asarray(residual, float).ravel()
    jacobian = np.asarray(jacobian, float).reshape(residual.size, x.size)
    if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
        return None
    # beyond 1e150 the squares overflow, also those of a parameter's influence on the residual
    with np.errstate(over="ignore"):
        sizes = [np.abs(part).max(initial=0) for part in (residual, jacobian, jacobian * x)]
    return (residual, jacobian) if max(sizes) <= 1e150 else None


def checked_bounds(start: Array, bounds: Bounds) -> tuple[Array, Array]:
    """Check a start against its bounds and return them as two arrays."""
    if start.ndim != 1 or start.size == 0 or not np.all(np.isfinite(start)):
        raise InputError(Fault("start", f"must be finite numbers in a row, got {start}"))
    pairs = np.array([(-np.inf, np.inf)] * start.size if bounds is None else bounds, float)
    if pairs.shape != (start.size, 2) or np.any(pairs[:, 0] >= pairs[:, 1]):
        raise InputError(Fault("bounds", f"need low < high for {start.size} parameters"))
    outside = np.flatnonzero((start < pairs[:, 0]) | (start > pairs[:, 1]))
    rule, mend = "{:g} lies outside its bounds {:g} to {:g}", "start inside them or widen them"
    faults = [Fault(f"start[{i}]", rule.format(start[i], *pairs[i]), mend) for i in outside]
    if faults:
        raise InputError(faults)
    return pairs[:, 0].copy(), pairs[:, 1].copy()


class EvaluationFailed(Exception):
    """The model has no answer at these constants; the optimizer rejects the step."""


# A measured curve of a fit, and what must hold of it.

#: noise of a row up to which residuals count by squares: 95 % efficient where all noise is normal
LOSS_LIMIT = 1.345


def _loss_weight(loss: Loss, size: Array) -> Array:
    """Weight of a squared residual by its size over the limit."""
    if loss == "huber":
        return 1 / np.maximum(size, 1.0)
    return np.asarray(1 / np.sqrt(1 + size**2))


@dataclass(frozen=True)
class MeasuredCurve:
    """One measured curve of a fit."""

    #: How reports and errors call it.
    label: str
    #: With the rows as recorded, of every repeat, whose linear interpolation and mean it is.
    curve: Curve
    #: shape (n,); factor on the residual, for instance one over the scatter; zero leaves a point
    #: out.
    weight: float | Array = 1.0
    #: How residuals count, and shape (n,): the residual in N up to which they count by squares.
    loss: Loss = "linear"
    limit_N: float | Array = math.inf  # noqa: N815
    #: 2 where the points of a second direction follow those of the first, row for row.
    directions: int = 1

    def robust(self, residual: Array) -> tuple[Array, Array]:
        """Residual whose square is the loss, and its derivative; both shape (n,) of used rows."""
        used = self.weights > 0
        limit = self.weights[used] * np.broadcast_to(self.limit_N, used.shape)[used]
        size = np.abs(residual)
        weight = _loss_weight(self.loss, size / limit)
        if self.loss == "huber":
            root = np.sqrt(np.where(size > limit, 2 * limit * size - limit**2, size**2))
        else:  # 2 c^2 (sqrt(1 + z) - 1), without the difference of nearly equal numbers
            root = size * np.sqrt(2 / (1 + np.sqrt(1 + (size / limit) ** 2)))
        slope = np.divide(weight * size, root, out=np.ones_like(size), where=root > 0)
        return np.sign(residual) * root, slope

    def reweighted(self, predicted: Curve) -> MeasuredCurve:
        """Copy whose residuals are as large as their influence, which the loss bounds."""
        if self.loss == "linear":
            return self
        apart = np.abs(predicted.force_at(self.curve.displacement_mm) - self.curve.force_N)
        weight = self.weights * _loss_weight(self.loss, apart / self.limit_N)
        return replace(self, weight=weight, loss="linear")

    @property
    def weights(self) -> Array:
        """Weight of every point, shape (n,)."""
        return np.broadcast_to(np.asarray(self.weight, float), (len(self.curve),))

    @property
    def states(self) -> Array | None:
        """Direction (0 or 1) of every biaxial point, its elongation and that across, (n, 3)."""
        if self.directions == 1:
            return None
        along = self.curve.displacement_mm.reshape(self.directions, -1)
        direction = np.repeat(np.arange(self.directions), along.shape[1])
        return np.column_stack([direction, along.ravel(), along[::-1].ravel()])

    def slopes(self, predicted: Curve, names: Sequence[str]) -> Array:
        """Differentiate the weighted residual of every used point by constants, shape (n, p)."""
        used = self.weights > 0
        slopes = predicted.gradients_at(names, self.curve.displacement_mm[used])
        return np.asarray(self.weights[used][:, None] * slopes)


def curve_faults(measured: MeasuredCurve) -> list[Fault]:
    """Say what of a curve cannot be fitted."""
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
    if np.count_nonzero(used) < 2:
        return []
    d, force = d[used], force[used]
    # the force of a course in time may fall while it is held
    rule, work = "the force does not resist the displacement", float(d @ force)
    if measured.curve.time_s is None:
        if np.ptp(force) <= 1e-9 * np.abs(force).max():
            return [Fault(where, f"is constant ({force[0]:g} N everywhere): no stiffness to fit")]
        rule = "the force falls as the displacement grows"
        work = float((d - d.mean()) @ (force - force.mean()))
    mend = "a force that resists is positive: see `sign` of the measurements"
    return [Fault(where, rule, mend)] if work <= 0 else []


#: change of an input without an uncertainty from which its influence is taken, over its value
_STEP = 0.01

# Priors of parameters as pseudo-observations (Theil and Goldberger 1961, Int. Econ. Rev. 2, 65).


@dataclass(frozen=True)
class Prior:
    """Normal prior of one parameter."""

    name: str
    #: Expected value and standard uncertainty, in the parameter's unit.
    mean: float
    uncertainty: float
    #: Standard deviation of a weighted residual that a standard uncertainty is to count as much as:
    #: the weight of the pseudo-observation is ``noise / uncertainty``.
    noise: float

    @property
    def weight(self) -> float:
        """Factor on the deviation from the mean, in units of the weighted residual."""
        return self.noise / self.uncertainty


def pseudo_rows(priors: Sequence[Prior], names: Sequence[str], values: Array) -> Array:
    """Residuals of the pseudo-observations, shape (k,). Shapes: values (p,)."""
    index = {name: i for i, name in enumerate(names)}
    return np.array([prior.weight * (values[index[prior.name]] - prior.mean) for prior in priors])


def pseudo_jacobian(priors: Sequence[Prior], names: Sequence[str]) -> Array:
    """Return the derivative of :func:`pseudo_rows` by the parameters, shape (k, p)."""
    rows = np.zeros((len(priors), len(names)))
    for row, prior in zip(rows, priors, strict=True):
        row[list(names).index(prior.name)] = prior.weight
    return rows


@dataclass(frozen=True)
class NuisanceParameter:
    """One nuisance parameter of a fit; mm, N, MPa, degrees or plain."""

    #: What it is called, and its key in the file.
    name: str
    key: str
    #: Value that was expected before the fit.
    expected: float
    #: Standard uncertainty of that; None where nothing was known.
    uncertainty: float | None
    #: Whether the tests may move it; else its uncertainty is propagated.
    is_fitted: bool
    #: Places of the curves that it moves, in the order of the fit.
    curves: tuple[int, ...]

    @property
    def step(self) -> float:
        """Change from which its influence is taken."""
        return self.uncertainty or _STEP * abs(self.expected)


@dataclass(frozen=True)
class NuisanceEstimate(NuisanceParameter):
    """The same after the fit."""

    value: float
    standard_error: float
    ci95: tuple[float, float]
    #: By constant: share of its variance that would be gone if this were known exactly.
    shares: Mapping[str, float]
