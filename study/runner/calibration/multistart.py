"""Starts of a calibration besides its own: a sum of squares may have several minima.

Exponents and other plain numbers are drawn by the energy, moduli follow by linear least squares,
since every energy is linear in its moduli where these scale K as well. The draws are those of a
seed, so that a calibration remains a function of its file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.calibration.fit import residual_function
from study.calibration.function import EvaluationFailed
from study.errors import Fault
from study.material.energy import Energy
from study.material.registry import ENERGIES
from study.material.relaxation import is_of_relaxation
from study.runner.fitting.fit_task import model
from study.runner.fitting.staged_fit import Part, Staged

#: sums of squares that differ by less are the same minimum
SAME_MINIMUM = 1e-3


@dataclass(frozen=True)
class Starts:
    """What the fits from several starts found.

    Parameters
    ----------
    seed : int
        Of the draws.
    rss : tuple of float or None
        Least sum of squares of each, that of the calibration's own start first; None where the
        fit did not converge.
    """

    seed: int
    rss: tuple[float | None, ...]

    @property
    def at_best(self) -> int:
        """How many ended at the least of all sums of squares."""
        found = [one for one in self.rss if one is not None]
        return sum(one <= (1 + SAME_MINIMUM) * min(found) for one in found)

    @property
    def sentence(self) -> str:
        """The same in words."""
        said = f"{self.at_best} of {len(self.rss)} starts (seed {self.seed}) end at the least sum"
        return f"{said} of squares"

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return {"count": len(self.rss), "seed": self.seed, "at_best": self.at_best,
                "rss": list(self.rss)}  # fmt: skip


def scattered(
    name: str,
    names: Sequence[str],
    start: Array,
    parts: Sequence[Part],
    bounds: Sequence[tuple[float, float]] | None,
    rng: np.random.Generator,
) -> Array:
    """Draw a start.

    Parameters
    ----------
    name : str
        Of the energy.
    names : sequence of str
        Constants.
    start : ndarray, shape (p,)
        The calibration's own start, MPa, exponents plain.
    parts : sequence of Part
        Tests that are fitted; those that need simulations do not move the moduli.
    bounds : sequence of (low, high), optional
        One pair for every constant; the start stays inside.
    rng : numpy.random.Generator
        Where the draws come from.

    Returns
    -------
    ndarray, shape (p,)
    """
    energy = ENERGIES[name]
    own = dict(zip(names, start.tolist(), strict=True))
    drawn = energy.scattered({n: v for n, v in own.items() if not is_of_relaxation(n)}, rng)
    values = _inside(np.array([{**own, **drawn}[n] for n in names]), bounds)
    closed = [part for part in parts if part.method == "closed-form"]
    if not closed:
        return values
    return _inside(_with_moduli(energy, names, values, closed), bounds)


def best(found: Sequence[Staged]) -> Staged:
    """Fit with the least sum of squares among those that converged, else the first.

    Parameters
    ----------
    found : sequence of Staged
        One at least, all of the same data and weights.
    """
    usable = [one for one in found if one.fit.converged]
    return min(usable, key=lambda one: one.fit.rss) if usable else found[0]


def _inside(values: Array, bounds: Sequence[tuple[float, float]] | None) -> Array:
    if bounds is None:
        return values
    return np.asarray(np.clip(values, *np.array(bounds, float).T))


def _with_moduli(
    energy: Energy, names: Sequence[str], values: Array, parts: Sequence[Part]
) -> Array:
    """Moduli that fit best beside these plain numbers; unchanged where the model has no answer."""
    moduli = [k for k, n in enumerate(names)
              if not (energy.is_dimensionless(n) or is_of_relaxation(n))]  # fmt: skip
    models = [model(p.method, p.tables, [m.curve for m in p.measured], names) for p in parts]
    measured = [m for part in parts for m in part.measured]
    residual = residual_function(
        lambda x: [curve for one in models for curve in one(x)], measured, names
    )
    try:
        r, jacobian = residual(values)
    except EvaluationFailed:
        return values
    step, *_ = np.linalg.lstsq(jacobian[:, moduli], -r, rcond=None)
    moved = values.copy()
    moved[moduli] += step
    # a modulus of a single term must stay positive, or nothing resists
    return moved if len(moduli) > 1 or (moved[moduli] > 0).all() else values


def excluded(name: str, value: float, bounds: tuple[float, float]) -> Fault:
    """Fault of a start that lies outside the bounds of its constant.

    Parameters
    ----------
    name : str
        Of the constant.
    value : float
        Its start, MPa (exponents plain).
    bounds : (float, float)
        Its least and largest value in the same unit.
    """
    return Fault(
        f"calibration.bounds.{name}",
        f"{bounds[0]:g} to {bounds[1]:g} excludes the start {value:.6g} (MPa; exponents plain)",
        "widen them, or give constants inside them to start from",
    )
