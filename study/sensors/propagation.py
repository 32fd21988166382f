"""First-order propagation of sensor errors through a least-squares fit (JCGM 100:2008, 5).

A row measured at displacement d differs from the model there by

    zero + scale_F F + noise_F - F' (offset + scale_d d + noise_d),

and the fit answers with its pseudo-inverse. Offset, zero and scales are the same in all rows of
a test; noise is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.covariance import scaled_inverse
from study.errors import RefusedError
from study.sensors.force_model import ForceAt
from study.sensors.section import ForceAccuracy, PositionAccuracy

#: Largest multiple that a requirement is looked for at: beyond it a sensor need not be there.
UNLIMITED = 1e6


@dataclass(frozen=True)
class ErrorSource:
    """One error of one sensor.

    Parameters
    ----------
    sensor, name : str
        ``position`` or ``force``; ``offset``, ``zero``, ``scale`` or ``noise``.
    unit : str
        Of ``given``: mm, N, or empty for a share.
    given : float
        Its standard uncertainty.
    response : ndarray, shape (n,)
        Change of the residual of every row by one unit of the error.
    is_shared : bool
        Whether all rows have the same error.
    """

    sensor: str
    name: str
    unit: str
    given: float
    response: Array
    is_shared: bool


def sources_of(
    position: PositionAccuracy, force: ForceAccuracy, at: ForceAt, displacement_mm: Array
) -> tuple[ErrorSource, ...]:
    """List all errors of both sensors, with what they do to the rows of a test.

    Parameters
    ----------
    position, force : PositionAccuracy, ForceAccuracy
        Standard uncertainties.
    at : ForceAt
        The test at its rows.
    displacement_mm : ndarray, shape (n,)
        Of the rows.
    """
    slope, ones = at.stiffness_N_per_mm, np.ones(displacement_mm.size)
    return (
        ErrorSource("position", "offset", "mm", position.offset_mm, -slope, True),
        ErrorSource("position", "scale", "", position.scale, -slope * displacement_mm, True),
        ErrorSource("position", "noise", "mm", position.noise_mm, -slope, False),
        ErrorSource("force", "zero", "N", force.zero_N, ones, True),
        ErrorSource("force", "scale", "", force.scale, at.force_N, True),
        ErrorSource("force", "noise", "N", force.noise_N, ones, False),
    )


@dataclass(frozen=True)
class Quantity:
    """A constant, or the force that is predicted with the constants.

    Parameters
    ----------
    name, unit : str
        Unit of ``value``: MPa, N, or empty.
    value : float
        As assumed.
    per_source : ndarray, shape (n_sources,)
        Standard uncertainty by one unit of every source.
    given : ndarray, shape (n_sources,)
        Standard uncertainties of the sources.
    is_position : ndarray of bool, shape (n_sources,)
        Whether a source is one of the tracker.
    """

    name: str
    unit: str
    value: float
    per_source: Array
    given: Array
    is_position: Array

    @property
    def parts(self) -> Array:
        """Standard uncertainty that every source makes, over the value."""
        return np.asarray(self.per_source * self.given / abs(self.value))

    @property
    def relative(self) -> float:
        """Standard uncertainty over the value, all sources together."""
        return float(np.sqrt(np.sum(self.parts**2)))

    def at_multiples(self, position: Array, force: Array) -> Array:
        """Relative standard uncertainty with both sensors' errors so many times as large."""
        squares = self.parts**2
        own = float(squares[self.is_position.astype(bool)].sum())
        other = float(squares.sum()) - own
        return np.asarray(np.sqrt(position**2 * own + force**2 * other))

    def allowed_alone(self, relative: float) -> Array:
        """Largest error of every source if there were no other; infinite where it does nothing."""
        unit = self.per_source / abs(self.value)
        return np.asarray(np.divide(relative, unit, out=np.full(unit.size, np.inf), where=unit > 0))

    def allowed_beside(self, relative: float) -> Array:
        """Largest error of every source beside the others as given; NaN where they leave none."""
        unit = self.per_source / abs(self.value)
        left = relative**2 - (self.relative**2 - self.parts**2)
        root = np.sqrt(np.where(left >= 0, left, np.nan))
        return np.asarray(
            np.divide(root, unit, out=np.where(left >= 0, np.inf, np.nan), where=unit > 0)
        )


@dataclass(frozen=True)
class Propagation:
    """Constants and predicted force, to first order of the errors.

    Parameters
    ----------
    sources : tuple of ErrorSource
        Of both sensors.
    constants : tuple of Quantity
        In their order.
    force : Quantity
        Predicted at the end of the predicted test.
    pseudo_inverse : ndarray, shape (p, n)
        Change of the constants by that of every row.
    gradient : ndarray, shape (p,)
        Change of the predicted force by the constants.
    """

    sources: tuple[ErrorSource, ...]
    constants: tuple[Quantity, ...]
    force: Quantity
    pseudo_inverse: Array
    gradient: Array

    @property
    def worst(self) -> Quantity:
        """Constant with the largest relative uncertainty."""
        return max(self.constants, key=lambda one: one.relative)


def propagate(
    names: Sequence[str],
    values: Array,
    units: Sequence[str],
    at: ForceAt,
    sources: tuple[ErrorSource, ...],
    predicted: ForceAt,
) -> Propagation:
    """Propagate sensor errors to the constants of an unweighted fit, and to a predicted force.

    Parameters
    ----------
    names, values, units : sequence, ndarray of shape (p,), sequence
        Constants.
    at : ForceAt
        The fitted test at its n rows.
    sources : tuple of ErrorSource
        Of both sensors.
    predicted : ForceAt
        The predicted test at one displacement.

    Raises
    ------
    RefusedError
        If the test does not determine the constants.
    """
    inverse, rank = scaled_inverse(at.jacobian)
    if rank < len(names):
        raise RefusedError(
            f"the test determines {rank} of {len(names)} constants ({', '.join(names)}): "
            "no accuracy of a sensor tells them apart; press deeper, or take a simpler energy"
        )
    pseudo_inverse = inverse @ at.jacobian.T
    effects = np.stack([_covariance_root(pseudo_inverse, one) for one in sources])
    given = np.array([one.given for one in sources])
    of_position = np.array([one.sensor == "position" for one in sources])
    variance = np.einsum("skn,skn->sk", effects, effects)
    gradient = predicted.jacobian[0]
    force = np.einsum("k,skn->sn", gradient, effects)
    return Propagation(
        sources,
        tuple(
            Quantity(name, unit, float(value), np.sqrt(variance[:, k]), given, of_position)
            for k, (name, value, unit) in enumerate(zip(names, values, units, strict=True))
        ),
        Quantity(
            "force",
            "N",
            float(predicted.force_N[0]),
            np.linalg.norm(force, axis=1),
            given,
            of_position,
        ),  # fmt: skip
        pseudo_inverse,
        gradient,
    )


def _covariance_root(pseudo_inverse: Array, source: ErrorSource) -> Array:
    """Root of the constants' covariance by one unit of a source, shape (p, n).

    A shared error has one column and is filled up with zeros.
    """
    moved = pseudo_inverse * source.response
    if not source.is_shared:
        return moved
    found = np.zeros_like(moved)
    found[:, 0] = moved.sum(axis=1)
    return found
