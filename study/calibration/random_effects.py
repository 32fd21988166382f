"""Specimens as the unit: a constant's mean in the population and its range for the next specimen.

The scatter between specimens is no error of a test: more rows do not lessen it. A pooled fit of
eight specimens whose stiffness scatters by 15 % takes it for noise of rows; were they
independent, its interval would hold the population's mean in a quarter of all cases. Here each
specimen gives one value, and their mean has Student's t distribution with specimens - 1 degrees
of freedom, whatever the errors within specimens, as long as these are alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.calibration.covariance import student_t
from study.calibration.fit import Fit


@dataclass(frozen=True)
class Population:
    """One constant among specimens; MPa, exponents plain.

    Parameters
    ----------
    name : str
        The constant.
    specimens : int
        Specimens that gave a value.
    mean : float
        Of their values, each counted once.
    standard_deviation : float
        Of their values; holds the errors within specimens.
    between : float
        Standard deviation of the true values: the errors within specimens taken off (by
        moments, Hedges 1983, Psychol. Bull. 93, 388); zero where these explain all scatter.
    mean_ci95, next_ci95 : tuple of float
        95 % intervals of the population's mean, and of the value found in the next specimen.
    """

    name: str
    specimens: int
    mean: float
    standard_deviation: float
    between: float
    mean_ci95: tuple[float, float]
    next_ci95: tuple[float, float]


def population(fits: Sequence[Fit]) -> tuple[Population, ...]:
    """Mean, scatter and intervals of every constant from fits to one specimen each.

    Parameters
    ----------
    fits : sequence of Fit
        Of the same constants; those that did not converge, or ended at a bound, give no value.

    Returns
    -------
    tuple of Population
        One for every constant that two or more specimens determine.
    """
    names = fits[0].names if fits else ()
    found = (_of(name, k, fits) for k, name in enumerate(names))
    return tuple(one for one in found if one is not None)


def _of(name: str, k: int, fits: Sequence[Fit]) -> Population | None:
    used = [one for one in fits if one.converged and not math.isnan(one.standard_error[k])]
    n = len(used)
    if n < 2:
        return None
    values = np.array([one.values[k] for one in used])
    within = float(np.mean([one.standard_error[k] ** 2 for one in used]))
    mean, deviation = float(values.mean()), float(values.std(ddof=1))
    t = student_t(n - 1)
    of_mean, of_next = t * deviation / math.sqrt(n), t * deviation * math.sqrt(1 + 1 / n)
    return Population(
        name,
        n,
        mean,
        deviation,
        math.sqrt(max(deviation**2 - within, 0.0)),
        (mean - of_mean, mean + of_mean),
        (mean - of_next, mean + of_next),
    )
