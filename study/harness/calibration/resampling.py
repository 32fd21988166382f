"""Intervals of constants from resampled data, which take no shape of the errors for granted.

Residuals are laid around the fitted curves again in circular blocks (Politis and Romano 1992), as
long as the correlation of neighbors asks for (Politis and White 2004); where specimens are
several, whole specimens are drawn instead, for they are what is independent (Davison and Hinkley
1997, sec. 3.8). The constants are fitted again to each resample, and the interval lies between
percentiles of these (Efron and Tibshirani 1993, chapter 13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.harness.calibration.measured_tests import FitCurve, in_order, of_specimens, parts_of
from study.harness.design.calibration_section import CalibratedTest, CalibrationDesign
from study.harness.runner import fit_task
from study.harness.runner.fit_task import Residuals, fitted_model, resampled, residuals_of
from study.harness.runner.response import scale_of
from study.harness.runner.staged_fit import Checkpoint, FitPart, Staged, single_stage
from study.mechanics.calibration.fit import residual_function
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.material.energy import Energy
from study.mechanics.material.material import ENERGIES
from study.mechanics.material.relaxation import is_of_relaxation

if TYPE_CHECKING:
    from study.mechanics.calibration.fit import Fit


#: resamples below which percentiles of 2.5 and 97.5 % are those of a few extremes
FEWEST = 200

_TAILS = (2.5, 97.5)


@dataclass(frozen=True)
class Bootstrap:
    """Percentile intervals of the constants."""

    names: tuple[str, ...]
    #: shape (p, 2); 95 %, MPa (exponents plain).
    interval: Array
    #: shape (p,); standard deviation over the resamples.
    standard_error: Array
    #: Fits that were made, and those among them that did not converge and count for nothing.
    resamples: int
    failed: int
    seed: int
    #: Rows drawn together, by curve; empty where specimens were drawn.
    blocks: tuple[int, ...]
    #: Specimens that were drawn from; 0 where rows were.
    specimens: int

    @property
    def sentence(self) -> str:
        """How it was drawn."""
        longest = max(self.blocks, default=0)
        drawn = (
            f"residuals in blocks of up to {longest} rows" if longest > 1 else "single residuals"
        )
        if self.specimens:
            drawn = f"{self.specimens} whole specimens"
        failed = f", {self.failed} of them without a minimum" if self.failed else ""
        return f"bootstrap: {self.resamples} resamples of {drawn}, seed {self.seed}{failed}"

    def as_dict(self) -> dict[str, object]:
        """Intervals in kPa, exponents plain."""
        scale = np.array([scale_of(name) for name in self.names])
        return {
            "sentence": self.sentence,
            "interval": dict(
                zip(self.names, (scale[:, None] * self.interval).tolist(), strict=True)
            ),
            "standard_error": dict(
                zip(self.names, (scale * self.standard_error).tolist(), strict=True)
            ),
            "resamples": self.resamples,
            "failed": self.failed,
            "seed": self.seed,
            "blocks": list(self.blocks),
            "specimens": self.specimens,
        }


def bootstrap(
    found: Fit,
    config: CalibrationDesign,
    curves: Sequence[FitCurve],
    resamples: int,
    bounds: Sequence[tuple[float, float]] | None = None,
) -> Bootstrap:
    """Fit the constants again to resampled data."""
    if resamples < FEWEST:
        rule = f"must be at least {FEWEST} resamples for an interval of 95 %, got {resamples}"
        raise InputError(Fault("--bootstrap", rule, "write --bootstrap 1000"))
    if found.joint is not None:
        rule = "cannot resample what is expected of fitted nuisance parameters"
        raise InputError(Fault("--bootstrap", rule, "leave one or the other out"))
    tests, seed = config.tests, config.asked.seed
    own, rng = in_order(curves), np.random.default_rng(seed)
    specimens = of_specimens(own)
    several = len(specimens) > 1
    parts = parts_of(tests, own)
    blocks = () if several else _residuals(found, parts)
    values = []
    for _ in range(resamples):
        again = _of_specimens(tests, specimens, rng) if several else _of_rows(parts, blocks, rng)
        fitted = single_stage(
            "resampled", again, found.names, found.values, fit_task.fitted_model, bounds, None,
            Checkpoint(),
        ).fit  # fmt: skip
        if fitted.converged:
            values.append(fitted.values)
    known = np.array(values).reshape(len(values), len(found.names))
    enough = len(values) > 1
    missing = np.full((2, len(found.names)), np.nan)
    return Bootstrap(
        found.names,
        (np.percentile(known, _TAILS, axis=0) if enough else missing).T,
        known.std(axis=0, ddof=1) if enough else missing[0],
        resamples,
        resamples - len(values),
        seed,
        tuple(one.block for one in blocks),
        len(specimens) if several else 0,
    )


def _residuals(found: Fit, parts: Sequence[FitPart]) -> tuple[Residuals, ...]:
    """Residuals of every curve, in the order of the parts."""
    share = found.n / max(1, found.n - len(found.names))
    curves = [one.curve for part in parts for one in part.measured]
    return tuple(
        residuals_of(curve, predicted.force_at(curve.displacement_mm), share)
        for curve, predicted in zip(curves, found.curves, strict=True)
    )


def _of_rows(
    parts: Sequence[FitPart], blocks: Sequence[Residuals], rng: np.random.Generator
) -> list[FitPart]:
    """Put drawn residuals around the curves of the fit."""
    left = iter(blocks)
    return [
        replace(
            part,
            measured=tuple(
                replace(
                    one, curve=replace(one.curve, force_N=resampled(next(left), rng)), recordings=()
                )
                for one in part.measured
            ),
        )
        for part in parts
    ]


def _of_specimens(
    tests: Sequence[CalibratedTest], specimens: dict[str, list[FitCurve]], rng: np.random.Generator
) -> list[FitPart]:
    """Draw as many specimens as there are, with replacement; each brings all its curves."""
    labels = list(specimens)
    drawn = rng.integers(0, len(labels), len(labels))
    return parts_of(tests, in_order([c for k in drawn for c in specimens[labels[k]]]))


# Further starts of a calibration, drawn from its seed: exponents by the energy, moduli by linear
# least squares, in which every energy is linear where K scales with them.

#: sums of squares that differ by less are the same minimum
SAME_MINIMUM = 1e-3


@dataclass(frozen=True)
class Starts:
    """What the fits from several starts found."""

    seed: int
    #: Least sum of squares of each, that of the calibration's own start first; None where the fit
    #: did not converge.
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
    parts: Sequence[FitPart],
    bounds: Sequence[tuple[float, float]] | None,
    rng: np.random.Generator,
) -> Array:
    """Draw a start. Shapes: start (p,), MPa; returns (p,)."""
    energy = ENERGIES[name]
    own = dict(zip(names, start.tolist(), strict=True))
    drawn = energy.scattered({n: v for n, v in own.items() if not is_of_relaxation(n)}, rng)
    values = _inside(np.array([{**own, **drawn}[n] for n in names]), bounds)
    closed = [part for part in parts if part.method == "closed-form"]
    if not closed:
        return values
    return _inside(_with_moduli(energy, names, values, closed), bounds)


def best(found: Sequence[Staged]) -> Staged:
    """Fit with the least sum of squares among those that converged, else the first."""
    usable = [one for one in found if one.fit.converged]
    return min(usable, key=lambda one: one.fit.rss) if usable else found[0]


def _inside(values: Array, bounds: Sequence[tuple[float, float]] | None) -> Array:
    if bounds is None:
        return values
    return np.asarray(np.clip(values, *np.array(bounds, float).T))


def _with_moduli(
    energy: Energy, names: Sequence[str], values: Array, parts: Sequence[FitPart]
) -> Array:
    """Moduli that fit best beside these plain numbers; unchanged where the model has no answer."""
    moduli = [k for k, n in enumerate(names)
              if not (energy.is_dimensionless(n) or is_of_relaxation(n))]  # fmt: skip
    models = [fitted_model(p.method, p.tables, [m.curve for m in p.measured], names) for p in parts]
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
    """Fault of a start that lies outside the bounds of its constant. Units: value MPa."""
    return Fault(
        f"calibration.bounds.{name}",
        f"{bounds[0]:g} to {bounds[1]:g} excludes the start {value:.6g} (MPa; exponents plain)",
        "widen them, or give constants inside them to start from",
    )
