"""What the noise of a measured curve does to its constants: fits to resampled residuals.

The residuals of a fit are laid around its curve again, in blocks where neighbors are
correlated, and the constants are fitted to that curve, starting from the fit (Efron and
Tibshirani 1993, chapter 9; blocks on a circle: Politis and Romano 1992). Draws depend on the
study's seed and the measured curve alone: cells that are fitted to one curve, with blocks of
one length, see its noise at the same places, so that effects are compared under one noise.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit
from study.canonical import digest
from study.curve import Curve
from study.execution.task import Received
from study.record.document import FitDocument
from study.runner.fitting import fit_task
from study.runner.fitting.fit_summary import FitResult, status_of
from study.runner.fitting.fit_task import FitTask
from study.runner.fitting.staged_fit import Checkpoint, Part, Predict, single_stage
from study.setup.material_section import MaterialSection
from study.setup.setup import Tables

#: points below which residuals say nothing of their correlation
_FEWEST = 8

#: correlation of neighbors beyond this many standard errors is believed
_BELIEVED = 2.0


@dataclass(frozen=True)
class Residuals:
    """What a fit left of a measured curve, ready to be drawn from.

    Parameters
    ----------
    predicted_N, noise_N : ndarray, shape (n,)
        Force of the fit, and its residuals, centered and scaled for the constants fitted.
    lag1 : float
        Correlation of neighboring residuals.
    block : int
        Neighbors that are drawn together.
    """

    predicted_N: Array  # noqa: N815
    noise_N: Array  # noqa: N815
    lag1: float
    block: int


def residuals_of(measured: Curve, predicted_N: Array, share: float) -> Residuals:  # noqa: N803
    """Residuals of a fit with their block length.

    Parameters
    ----------
    measured : Curve
        The curve that was fitted.
    predicted_N : ndarray, shape (n,)
        Force of the fit at the measured points, N.
    share : float
        Points over degrees of freedom: the mean square of the residuals of n points and p
        constants is smaller than the noise by (n - p) / n.
    """
    left = measured.force_N - predicted_N
    left = left - left.mean()
    power = float(left @ left)
    lag1 = float(left[1:] @ left[:-1]) / power if power > 0 else 0.0
    return Residuals(predicted_N, math.sqrt(share) * left, lag1, block_length(lag1, left.size))


def block_length(lag1: float, n: int) -> int:
    """Length of the blocks that serves the variance of a mean best; 1 without correlation.

    Politis and White (2004, Econometric Reviews 23, 53), eq. 6 for circular blocks, with the
    autocovariances of a first-order autoregression, and their upper bound.

    Parameters
    ----------
    lag1 : float
        Correlation of neighboring residuals; up to two standard errors, 2 / sqrt(n), count as none.
    n : int
        Points; fewer than 8 are never drawn in blocks.

    Examples
    --------
    >>> block_length(0.0, 200), block_length(0.5, 200), block_length(0.9, 200)
    (1, 8, 30)
    """
    if n < _FEWEST or lag1 <= _BELIEVED / math.sqrt(n):
        return 1
    rho = min(lag1, 0.999)
    best = math.cbrt(6 * rho**2 / (1 - rho**2) ** 2 * n)
    return max(1, min(round(best), math.ceil(min(3 * math.sqrt(n), n / 3))))


def resampled(residuals: Residuals, random: np.random.Generator) -> Array:
    """Force of the fit with its residuals drawn anew, N, shape (n,).

    Parameters
    ----------
    residuals : Residuals
        Of one curve; the blocks are laid on a circle.
    random : numpy.random.Generator
        Where the draws come from.
    """
    n, block = residuals.noise_N.size, residuals.block
    starts = random.integers(0, n, math.ceil(n / block))
    drawn = ((starts[:, None] + np.arange(block)) % n).ravel()[:n]
    return np.asarray(residuals.predicted_N + residuals.noise_N[drawn])


def perform(document: Received) -> dict[str, object]:
    """Fit the constants again to resampled curves: a task for a worker.

    Parameters
    ----------
    document : mapping
        Of :meth:`study.runner.fitting.fit_task.FitTask.to_json`, with ``start`` and ``noise``.

    Returns
    -------
    dict
        Of :meth:`study.runner.fitting.fit_summary.FitResult.to_json`, with ``resampling``: block
        length and lag-1 correlation of every curve.
    """
    return refitted(FitTask.from_json(document)).to_json()


def refitted(task: FitTask) -> FitResult:
    """Fit the constants again to resampled curves.

    Parameters
    ----------
    task : FitTask
        Its ``start`` is the fit whose residuals are drawn, its ``noise`` the seed and the number.

    Returns
    -------
    FitResult
        With the status of ``start`` and no constants where that fit found none.

    Raises
    ------
    ValueError
        If the task has no fit whose residuals it could draw from.
    """
    began = time.perf_counter()
    if task.start is None or task.noise is None:
        raise ValueError("a refit needs a fit, a seed and a number")
    base, (seed, number) = task.start, task.noise
    if not base.converged:
        why = f"the fit to the measured curve did not converge: {base.message}"
        return FitResult.without_answer(base.status, why)
    names = tuple(base.fit["names"])
    start = np.array([base.constants[name] for name in names])
    parts = fit_task.parts_of(task)
    models = [_Remembering(fit_task.model(p.method, p.tables, _curves(p), names)) for p in parts]
    predicted = [curve for model in models for curve in model(start)]
    points = sum(len(curve) for curve in task.measured)
    share = points / max(1, points - len(names))
    found = [
        residuals_of(curve, own.force_at(curve.displacement_mm), share)
        for curve, own in zip(task.measured, predicted, strict=True)
    ]
    drawn = [
        Curve(curve.displacement_mm, resampled(own, _random(seed, curve, number)))
        for curve, own in zip(task.measured, found, strict=True)
    ]
    again, made = _with_forces(parts, drawn), iter(models)
    done = single_stage(
        "resampled", again, names, start, lambda *_: next(made), None, None, Checkpoint()
    )
    document = _described(done.fit, parts[0].tables, found)
    document.update({"method": task.problem.method, "seconds": time.perf_counter() - began})
    return FitResult(status_of(done.fit), document)


def _described(fit: Fit, tables: Tables, found: Sequence[Residuals]) -> FitDocument:
    """Describe a refit; unstable constants stay, for they are part of the scatter."""
    constants = fit.constants()
    return {
        "message": fit.message,
        "names": list(fit.names),
        "values": constants,
        "mu0": float(MaterialSection.of(tables).material(constants).mu0),
        "identifiable": fit.converged,
        "reason": "" if fit.converged else fit.status.sentence,
        "evaluations": int(fit.evaluations),
        "resampling": [{"block": own.block, "lag1": own.lag1} for own in found],
    }


def _random(seed: int, measured: Curve, number: int) -> np.random.Generator:
    """Numbers of one resample of one measured curve, the same for every cell fitted to it."""
    name = digest([measured.displacement_mm.tolist(), measured.force_N.tolist()], 16)
    return np.random.default_rng([seed, int(name, 16), number])


def _curves(part: Part) -> list[Curve]:
    return [one.curve for one in part.measured]


def _with_forces(parts: Sequence[Part], drawn: Sequence[Curve]) -> list[Part]:
    """Put resampled curves, in order, in place of the measured ones."""
    left = iter(drawn)
    return [
        replace(part, measured=tuple(replace(one, curve=next(left)) for one in part.measured))
        for part in parts
    ]


class _Remembering:
    """A model that does not solve again for the constants it was last asked for."""

    def __init__(self, model: Predict) -> None:
        self._model = model
        self._values = b""
        self._curves: list[Curve] = []

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the curves at constants in MPa."""
        if values.tobytes() != self._values:
            self._curves = self._model(values)
            self._values = values.tobytes()
        return self._curves
