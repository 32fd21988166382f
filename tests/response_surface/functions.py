"""Functions with known indices, and designs to run them at."""

import numpy as np
from scipy.stats import qmc

from study.statistics.surfaces.surface_factors import NumericFactor, Runs

ISHIGAMI_S = np.array([0.3139, 0.4424, 0.0])
ISHIGAMI_T = np.array([0.5576, 0.4424, 0.2437])
#: uniform inputs, 131,072 points
BOREHOLE_S = np.array([0.829, 0.0, 0.0, 0.041, 0.0, 0.041, 0.039, 0.010])
BOREHOLE_T = np.array([0.867, 0.0, 0.0, 0.054, 0.0, 0.054, 0.052, 0.013])


def ishigami(x):
    """Ishigami and Homma 1990, a = 7, b = .1, on the unit box."""
    z = np.pi * (2.0 * x - 1.0)
    return np.asarray(np.sin(z[:, 0]) * (1 + 0.1 * z[:, 2] ** 4) + 7.0 * np.sin(z[:, 1]) ** 2)


def borehole(x):
    """Morris, Mitchell and Ylvisaker 1993, m^3/yr, on the unit box."""
    low = np.array([0.05, 100.0, 63070.0, 990.0, 63.1, 700.0, 1120.0, 9855.0])
    high = np.array([0.15, 50000.0, 115600.0, 1110.0, 116.0, 820.0, 1680.0, 12045.0])
    rw, r, tu, hu, tl, hl, length, kw = (low + x * (high - low)).T
    ratio = np.log(r / rw)
    return np.asarray(
        2
        * np.pi
        * tu
        * (hu - hl)
        / (ratio * (1 + 2 * length * tu / (ratio * rw**2 * kw) + tu / tl))
    )


SOBOL_G = np.array([0.0, 1.0, 4.5, 9.0])


def sobol_g(x):
    """Sobol' 1993, on the unit box."""
    return np.asarray(np.prod((np.abs(4.0 * x - 2.0) + SOBOL_G) / (1.0 + SOBOL_G), axis=1))


def sobol_g_indices():
    """First-order and total indices in closed form (Saltelli et al. 2008, section 5.9)."""
    parts = 1.0 / (3.0 * (1.0 + SOBOL_G) ** 2)
    whole = float(np.prod(1.0 + parts)) - 1.0
    others = np.array([np.prod(np.delete(1.0 + parts, j)) for j in range(4)])
    return parts / whole, parts * others / whole


def friedman(x):
    """Friedman 1991 without noise, five inputs on the unit box."""
    wave = 10.0 * np.sin(np.pi * x[:, 0] * x[:, 1])
    return np.asarray(wave + 20.0 * (x[:, 2] - 0.5) ** 2 + 10.0 * x[:, 3] + 5.0 * x[:, 4])


def friedman_indices():
    """Give indices of Friedman's function.

    The wave of the first two inputs by Gauss's quadrature, the others in closed form.
    """
    nodes, weights = np.polynomial.legendre.leggauss(60)
    u, w = 0.5 * (nodes + 1.0), 0.5 * weights
    wave = 10.0 * np.sin(np.pi * np.outer(u, u))
    mean = float(w @ wave @ w)
    along = wave @ w  # of either input, by symmetry
    alone = float(w @ (along - mean) ** 2)
    both = float(w @ (wave - mean) ** 2 @ w)
    additive = np.array([20.0**2 / 180.0, 100.0 / 12.0, 25.0 / 12.0])
    whole = both + additive.sum()
    first = np.array([alone, alone, *additive]) / whole
    total = np.array([both - alone, both - alone, *additive]) / whole
    return first, total


def harmonic(x):
    """Fill a product of cosines and a straight line: indices follow from their variances."""
    return np.asarray((1.0 + 0.6 * np.cos(2 * np.pi * x[:, 0])) * (2.0 + x[:, 1]) + 0.5 * x[:, 2])


def harmonic_indices():
    """Relative variances of the factors: .36/2 and (1/12)/2.5^2; that of the sum beside."""
    a, b, c = 0.18, 1.0 / 12.0 / 6.25, 0.25 / 12.0
    square = 2.5**2
    whole = square * ((1 + a) * (1 + b) - 1) + c
    first = np.array([square * a, square * b, c]) / whole
    total = np.array([square * a * (1 + b), square * b * (1 + a), c]) / whole
    return first, total


def hypercube(k, n, seed):
    """Latin hypercube in the unit box, improved for centred discrepancy."""
    return np.asarray(qmc.LatinHypercube(k, seed=seed, optimization="random-cd").random(n))


def unit_runs(x, response):
    factors = tuple(NumericFactor(f"x{j + 1}", 0.0, 1.0) for j in range(x.shape[1]))
    return Runs("y", factors, 2.0 * x - 1.0, response)
