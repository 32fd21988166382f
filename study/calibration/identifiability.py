"""What the tests know of the constants, in the units of the curves that were measured.

Constants of different order, or a modulus and an exponent, cannot be compared as numbers. What
can be compared is what they do to the measured curve: every column of the Jacobian is taken in
lengths of itself, so that a constant counts in the unit of the force. Singular vectors of these
columns are the combinations that the tests know best and least (Raue et al. 2009, Bioinformatics
25, 1923; Gutenkunst et al. 2007, PLoS Comput. Biol. 3, e189), whatever units the constants have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.covariance import AS_GOOD_AS_ZERO
from study.calibration.fit import Fit
from study.calibration.measured_curve import MeasuredCurve
from study.material.registry import is_dimensionless

#: relative standard error up to which a combination counts as known
KNOWN = 0.1

#: share of the largest part below which a constant is no part of a combination
_PART = 0.03

#: share of the largest part from which a constant may be the first of a combination
_FIRST = 0.9


@dataclass(frozen=True)
class Direction:
    """A combination of constants, the first with the coefficient 1.

    Parameters
    ----------
    combination : mapping of str to float
        Coefficient of every constant that takes part; MPa over the unit of the constant, relative
        to the first.
    value, standard_error : float
        Of the combination, in the unit of the first constant (MPa, exponents plain).
    """

    combination: Mapping[str, float]
    value: float
    standard_error: float

    @property
    def relative(self) -> float:
        """Standard error over the value."""
        return self.standard_error / abs(self.value) if self.value else float("inf")

    @property
    def is_known(self) -> bool:
        """Whether the tests determine it."""
        return self.relative <= KNOWN

    @property
    def words(self) -> str:
        """The combination as a formula, moduli in kPa."""
        first, *others = self.combination
        parts = [first]
        for name in others:
            factor = self.combination[name]
            unit = ""
            if is_dimensionless(name) != is_dimensionless(first):
                factor *= 1e-3 if is_dimensionless(first) else 1e3
                unit = " / kPa x" if is_dimensionless(first) else " kPa x"
            size = f"{abs(factor):.3g}"
            shown = name if size == "1" and not unit else f"{size}{unit} {name}"
            parts.append(f"{'-' if factor < 0 else '+'} {shown}")
        return " ".join(parts)


@dataclass(frozen=True)
class ConstantEffect:
    """What one constant does to the curves.

    Parameters
    ----------
    name : str
        Of the constant.
    alone_N : float
        Largest change of a force by leaving it out (taking it as zero), the others kept.
    refitted_N : float
        The same with the others fitted again, by linear estimate.
    is_known : bool
        Whether its interval excludes zero, or changes no force by more than 1 % of the largest.
    """

    name: str
    alone_N: float  # noqa: N815
    refitted_N: float  # noqa: N815
    is_known: bool


@dataclass(frozen=True)
class Identifiability:
    """What the tests know of the constants.

    Parameters
    ----------
    noise_N : float
        Standard deviation of the residuals of the fitted points.
    directions : tuple of Direction
        From the stiffest to the sloppiest.
    constants : tuple of ConstantEffect
        One for every constant.
    """

    noise_N: float  # noqa: N815
    directions: tuple[Direction, ...]
    constants: tuple[ConstantEffect, ...]

    @property
    def sentence(self) -> str:
        """Say in words what is known, and what is not."""
        open_ones = [one for one in self.constants if not one.is_known]
        # as many combinations as remain: the sloppy ones say of no constant more than its interval
        stiff = self.directions[: max(len(self.constants) - len(open_ones), 1)]
        known = [one for one in stiff if one.is_known]
        said = [f"{one.words} is known to {100 * one.relative:.2g} %" for one in known]
        noise = f"the noise is {self.noise_N:.2g} N"
        said += [
            f"{one.name} alone is not: without it, the others fitted again, the curve changes by "
            f"at most {one.refitted_N:.2g} N, where {noise}"
            for one in open_ones
        ]
        return "; ".join(said)


def identify(found: Fit, measured: Sequence[MeasuredCurve]) -> Identifiability | None:
    """Stiff and sloppy combinations of the constants of a fit, and what each constant does.

    Parameters
    ----------
    found : Fit
        With errors of all constants.
    measured : sequence of MeasuredCurve
        What it was fitted to, in the order of its curves.

    Returns
    -------
    Identifiability or None
        None where the fit has no errors to judge by, or a constant has no influence.
    """
    if not np.isfinite(found.covariance).all() or not found.curves:
        return None
    slopes, weights, left = fitted_rows(found, measured)
    jacobian = weights[:, None] * slopes
    norms = np.linalg.norm(jacobian, axis=0)
    freedom = left.size - norms.size
    if freedom <= 0 or not np.all(norms > 0):
        return None
    noise = float(np.sqrt(left @ left / freedom))
    right = np.linalg.svd(jacobian / norms, full_matrices=False)[2]
    directions = tuple(_direction(found, row, norms) for row in right)
    force = max(float(np.abs(one.curve.force_N).max()) for one in measured)
    half = 0.5 * (found.ci95[:, 1] - found.ci95[:, 0])
    constants = tuple(
        _effect(found, k, slopes, jacobian, weights, half, force) for k in range(norms.size)
    )
    return Identifiability(noise, directions, constants)


def fitted_rows(found: Fit, measured: Sequence[MeasuredCurve]) -> tuple[Array, Array, Array]:
    """Slopes of the forces, weights and residuals of the fitted points.

    Parameters
    ----------
    found : Fit
        With its curves.
    measured : sequence of MeasuredCurve
        What it was fitted to, in the order of its curves.

    Returns
    -------
    slopes : ndarray, shape (n, p)
        N per MPa.
    weights, residuals : ndarray, shape (n,)
        Plain, and in N.
    """
    slopes, weights, left = [], [], []
    for one, curve in zip(measured, found.curves, strict=True):
        used = one.weights > 0
        d = one.curve.displacement_mm[used]
        slopes.append(curve.gradients_at(found.names, d))
        weights.append(one.weights[used])
        left.append(curve.force_at(d) - one.curve.force_N[used])
    return np.concatenate(slopes), np.concatenate(weights), np.concatenate(left)


def _direction(found: Fit, row: Array, norms: Array) -> Direction:
    size = np.abs(row)
    first = int(np.argmax(size >= _FIRST * size.max()))
    coefficients = row * norms / (row[first] * norms[first])
    kept = [k for k in np.argsort(np.arange(size.size) != first, kind="stable")
            if size[k] >= _PART * size.max()]  # fmt: skip
    whole = np.where(np.isin(np.arange(size.size), kept), coefficients, 0.0)
    return Direction(
        {found.names[k]: float(coefficients[k]) for k in kept},
        float(whole @ found.values),
        float(np.sqrt(whole @ found.covariance @ whole)),
    )


def _effect(
    found: Fit, k: int, slopes: Array, jacobian: Array, weights: Array, half: Array, force: float
) -> ConstantEffect:
    value, column = abs(float(found.values[k])), jacobian[:, k]
    others = np.delete(jacobian, k, axis=1)
    own = column
    if others.shape[1]:
        scale = np.linalg.norm(others, axis=0)
        own = column - others / scale @ np.linalg.lstsq(others / scale, column, rcond=None)[0]
    largest = float(np.abs(slopes[:, k]).max())
    known = float(half[k]) <= max(value, AS_GOOD_AS_ZERO * force / largest)
    return ConstantEffect(
        found.names[k], value * largest, value * float(np.abs(own / weights).max()), bool(known)
    )
