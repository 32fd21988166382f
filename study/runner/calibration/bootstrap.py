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

from study.arrays import Array
from study.design.sections.calibration_design import CalibratedTest, CalibrationDesign
from study.errors import Fault, InputError
from study.runner.calibration.measured_tests import FitCurve, in_order, of_specimens, parts_of
from study.runner.fitting import fit_task
from study.runner.fitting.residual_bootstrap import Residuals, resampled, residuals_of
from study.runner.fitting.staged_fit import Checkpoint, Part, single_stage
from study.runner.response import scale_of

if TYPE_CHECKING:
    from study.calibration.fit import Fit

#: resamples below which percentiles of 2.5 and 97.5 % are those of a few extremes
FEWEST = 200

_TAILS = (2.5, 97.5)


@dataclass(frozen=True)
class Bootstrap:
    """Percentile intervals of the constants.

    Parameters
    ----------
    names : tuple of str
        Constants.
    interval : ndarray, shape (p, 2)
        95 %, MPa (exponents plain).
    standard_error : ndarray, shape (p,)
        Standard deviation over the resamples.
    resamples, failed : int
        Fits that were made, and those among them that did not converge and count for nothing.
    seed : int
        Of the draws.
    blocks : tuple of int
        Rows drawn together, by curve; empty where specimens were drawn.
    specimens : int
        Specimens that were drawn from; 0 where rows were.
    """

    names: tuple[str, ...]
    interval: Array
    standard_error: Array
    resamples: int
    failed: int
    seed: int
    blocks: tuple[int, ...]
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
    """Fit the constants again to resampled data.

    Parameters
    ----------
    found : Fit
        Converged; every fit starts from it.
    config : CalibrationDesign
        The calibration; its seed is that of the draws.
    curves : sequence of FitCurve
        Measured ones; specimens are drawn where there are two or more.
    resamples : int
        How often.
    bounds : sequence of (low, high), optional
        Of the constants.

    Raises
    ------
    InputError
        If there are too few resamples, or nuisance parameters are fitted, whose priors a resample
        of rows says nothing of.
    """
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
            "resampled", again, found.names, found.values, fit_task.model, bounds, None,
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


def _residuals(found: Fit, parts: Sequence[Part]) -> tuple[Residuals, ...]:
    """Residuals of every curve, in the order of the parts."""
    share = found.n / max(1, found.n - len(found.names))
    curves = [one.curve for part in parts for one in part.measured]
    return tuple(
        residuals_of(curve, predicted.force_at(curve.displacement_mm), share)
        for curve, predicted in zip(curves, found.curves, strict=True)
    )


def _of_rows(
    parts: Sequence[Part], blocks: Sequence[Residuals], rng: np.random.Generator
) -> list[Part]:
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
) -> list[Part]:
    """Draw as many specimens as there are, with replacement; each brings all its curves."""
    labels = list(specimens)
    drawn = rng.integers(0, len(labels), len(labels))
    return parts_of(tests, in_order([c for k in drawn for c in specimens[labels[k]]]))
