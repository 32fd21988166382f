"""What is known of a parameter before the fit, as one more observation of it, and after it.

A prior with a mean and a standard uncertainty is a pseudo-observation: a row of the least-squares
problem that measures the parameter itself (Theil and Goldberger 1961, Int. Econ. Rev. 2, 65). It
is no measurement of these tests, and is told from them wherever rows are counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from study.arrays import Array


@dataclass(frozen=True)
class Prior:
    """Normal prior of one parameter.

    Parameters
    ----------
    name : str
        Of the parameter.
    mean, uncertainty : float
        Expected value and standard uncertainty, in the parameter's unit.
    noise : float
        Standard deviation of a weighted residual that a standard uncertainty is to count as
        much as: the weight of the pseudo-observation is ``noise / uncertainty``.
    """

    name: str
    mean: float
    uncertainty: float
    noise: float

    @property
    def weight(self) -> float:
        """Factor on the deviation from the mean, in units of the weighted residual."""
        return self.noise / self.uncertainty


def pseudo_rows(priors: Sequence[Prior], names: Sequence[str], values: Array) -> Array:
    """Residuals of the pseudo-observations, shape (k,).

    Parameters
    ----------
    priors : sequence of Prior
        Each of a parameter among the names.
    names : sequence of str
        Fitted parameters.
    values : ndarray, shape (p,)
        In the order of the names, each in its own unit.
    """
    place = {name: i for i, name in enumerate(names)}
    return np.array([one.weight * (values[place[one.name]] - one.mean) for one in priors])


def pseudo_jacobian(priors: Sequence[Prior], names: Sequence[str]) -> Array:
    """Return the derivative of :func:`pseudo_rows` by the parameters, shape (k, p).

    Parameters
    ----------
    priors, names
        As for :func:`pseudo_rows`.
    """
    rows = np.zeros((len(priors), len(names)))
    for row, one in zip(rows, priors, strict=True):
        row[list(names).index(one.name)] = one.weight
    return rows


def known_covariance(priors: Sequence[Prior], names: Sequence[str], inverse: Array) -> Array:
    """Covariance of the estimates by the errors of the priors alone.

    Parameters
    ----------
    priors : sequence of Prior
        Each of a parameter that is fitted.
    names : sequence of str
        Fitted parameters.
    inverse : ndarray, shape (p, p)
        ``(J'J)^-1`` with the pseudo-observations among the rows.

    Returns
    -------
    ndarray, shape (p, p)
        An error of the mean moves the estimates by ``(J'J)^-1 e weight^2`` times itself.
    """
    total = np.zeros_like(inverse)
    for one in priors:
        moved = inverse[:, list(names).index(one.name)] * one.weight**2 * one.uncertainty
        total += np.outer(moved, moved)
    return total


@dataclass(frozen=True)
class NuisanceEstimate:
    """One nuisance parameter after the fit; mm, N, MPa, degrees or plain.

    Parameters
    ----------
    name, key : str
        What it is called, and its key in the file.
    treated : {"fitted", "propagated"}
        Whether the tests helped to find it, or its uncertainty was carried to the constants.
    expected : float
        Value that was expected before the fit.
    uncertainty : float or None
        Standard uncertainty of that; None where nothing was known.
    value, standard_error : float
        After the fit.
    ci95 : tuple of float
        95 % interval.
    shares : mapping of str to float
        By constant: share of its variance that would be gone if this were known exactly.
    """

    name: str
    key: str
    treated: Literal["fitted", "propagated"]
    expected: float
    uncertainty: float | None
    value: float
    standard_error: float
    ci95: tuple[float, float]
    shares: Mapping[str, float]
