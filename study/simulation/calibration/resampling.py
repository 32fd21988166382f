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
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError
from study.mechanics.material.relaxation import is_of_relaxation
from study.simulation.calibration.calibration_file import CalibratedTest, CalibrationDesign
from study.simulation.calibration.measured_tests import FitCurve, in_order, of_specimens, parts_of
from study.simulation.fit_task import (
    FitPart,
    Residuals,
    StagedSearch,
    energy_of,
    resampled,
    residuals_of,
    single_stage,
    with_moduli,
    within,
)
from study.simulation.response import in_shown_units

if TYPE_CHECKING:
    from study.mechanics.calibration.fit import Fit


#: resamples below which percentiles of 2.5 and 97.5 % are those of a few extremes
FEWEST = 200

_TAILS = (2.5, 97.5)


@dataclass(frozen=True)
class Bootstrap(Keyed):
    """Percentile intervals of the constants."""

    KEYS = "sentence interval standard_error resamples failed seed blocks specimens"

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

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key: intervals in kPa, exponents plain."""
        sizes = {"interval": self.interval, "standard_error": self.standard_error}
        shown = {key: in_shown_units(self.names, values) for key, values in sizes.items()}
        return super().keyed() | shown


def refuse_bootstrap(tests: Sequence[CalibratedTest], resamples: int) -> None:
    """Refuse, before anything is fitted, resamples that are too few or leave a parameter open."""
    if resamples <= 0:
        return
    if resamples < FEWEST:
        rule = f"must be at least {FEWEST} resamples for an interval of 95 %, got {resamples}"
        raise InputError(Fault("--bootstrap", rule, "write --bootstrap 1000"))
    if any(test.nuisance for test in tests):
        rule = "cannot resample what is expected of nuisance parameters"
        mend = "leave one or the other out; of a contact found in the rows, write its displacement"
        raise InputError(Fault("--bootstrap", rule, f'{mend}: displacement_zero = "5.2 mm"'))


def bootstrap(
    fit: Fit,
    config: CalibrationDesign,
    curves: Sequence[FitCurve],
    resamples: int,
    bounds: Sequence[tuple[float, float]] | None = None,
) -> Bootstrap:
    """Fit the constants again to resampled data."""
    tests, seed = config.tests, config.fitting.seed
    ordered, rng = in_order(curves), np.random.default_rng(seed)
    specimens = of_specimens(ordered)
    several = len(specimens) > 1
    parts = parts_of(tests, ordered)
    share = fit.n / max(1, fit.n - len(fit.names))
    blocks = () if several else tuple(
        residuals_of(m.curve, predicted.force_at(m.curve.displacement_mm), share)
        for m, predicted in zip(ordered, fit.curves, strict=True)
    )  # fmt: skip
    values = []
    for _ in range(resamples):
        if several:  # as many specimens as there are; each brings all its curves
            labels = list(specimens)
            drawn_labels = [labels[k] for k in rng.integers(0, len(labels), len(labels))]
            again = parts_of(tests, in_order([c for s in drawn_labels for c in specimens[s]]))
        else:
            again = _of_rows(parts, blocks, rng)
        search = StagedSearch(fit.names, bounds)
        fitted = single_stage("resampled", again, fit.values, search).fit
        if fitted.converged:
            values.append(fitted.values)
    drawn = np.array(values).reshape(len(values), len(fit.names))
    enough = len(values) > 1
    missing = np.full((2, len(fit.names)), np.nan)
    return Bootstrap(
        fit.names,
        (np.percentile(drawn, _TAILS, axis=0) if enough else missing).T,
        drawn.std(axis=0, ddof=1) if enough else missing[0],
        resamples,
        resamples - len(values),
        seed,
        tuple(block.block for block in blocks),
        len(specimens) if several else 0,
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
                replace(m, curve=replace(m.curve, force_N=resampled(next(left), rng), recorded=()))
                for m in part.measured
            ),
        )
        for part in parts
    ]


# Further starts of a calibration, drawn from its seed: exponents by the energy, moduli by linear
# least squares, in which every energy is linear where K scales with them.

#: sums of squares that differ by less are the same minimum
SAME_MINIMUM = 1e-3


@dataclass(frozen=True)
class Starts(Keyed):
    """What the fits from several starts found."""

    KEYS = "count=rss.__len__ seed at_best rss"

    seed: int
    #: Least sum of squares of each, that of the calibration's own start first; None where the fit
    #: did not converge.
    rss: tuple[float | None, ...]

    @property
    def at_best(self) -> int:
        """How many ended at the least of all sums of squares."""
        ended = [rss for rss in self.rss if rss is not None]
        return sum(rss <= (1 + SAME_MINIMUM) * min(ended) for rss in ended)

    @property
    def sentence(self) -> str:
        """The same in words."""
        text = f"{self.at_best} of {len(self.rss)} starts (seed {self.seed}) end at the least sum"
        return f"{text} of squares"


def scattered(
    search: StagedSearch, start: Array, parts: Sequence[FitPart], rng: np.random.Generator
) -> Array:
    """Draw a start. Shapes: start (p,), MPa; returns (p,)."""
    constants = dict(zip(search.names, start.tolist(), strict=True))
    elastic = {n: v for n, v in constants.items() if not is_of_relaxation(n)}
    drawn = energy_of(parts).scattered(elastic, rng)
    values = within(np.array([{**constants, **drawn}[n] for n in search.names]), search.bounds)
    closed = [part for part in parts if part.method == "closed-form"]
    if not closed:
        return values
    return within(with_moduli(search, values, closed)[0], search.bounds)


def excluded(name: str, value: float, bounds: tuple[float, float]) -> Fault:
    """Fault of a start that lies outside the bounds of its constant. Units: value MPa."""
    return Fault(
        f"calibration.bounds.{name}",
        f"{bounds[0]:g} to {bounds[1]:g} excludes the start {value:.6g} (MPa; exponents plain)",
        "widen them, or give constants inside them to start from",
    )
