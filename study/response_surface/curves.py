"""An emulator of whole curves: a mean, and a few shapes whose sizes are emulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, RefusedError
from study.response_surface.emulator.emulator import GIVEN, Emulator, fit_emulator
from study.response_surface.factors import Runs

#: a shape is kept as long as it is this large beside the first one; at most so many
SMALLEST = 1e-4
MOST = 6


@dataclass(frozen=True)
class CurveEmulator:
    """Curves at settings that were not run.

    Parameters
    ----------
    runs : Runs
        Settings of the runs; the response is the mean of each curve.
    mean : array, shape (m,)
        Of the curves, in their unit.
    shapes : array, shape (q, m)
        Orthonormal.
    sizes : tuple of Emulator
        Of each shape, in the curves' unit.
    loo_errors : array, shape (n, m)
        Errors of predicting the curve of each run from all the others, in that unit.
    q2 : float
        Share of the curves' variance that is predicted so.
    """

    runs: Runs
    mean: Array
    shapes: Array
    sizes: tuple[Emulator, ...]
    loo_errors: Array
    q2: float

    @property
    def loo_rms(self) -> float:
        """Root mean square of the leave-one-out errors, in the curves' unit."""
        return float(np.sqrt(np.mean(self.loo_errors**2)))

    def value(self, coded: Array) -> Array:
        """Curves, shape (p, m), at coded points of shape (p, k)."""
        sizes = np.column_stack([one.value(coded) for one in self.sizes])
        return np.asarray(self.mean + sizes @ self.shapes)


def fit_curves(runs: Runs, curves: Array, seed: int = 0) -> CurveEmulator:
    """Emulate curves by their principal components (Higdon et al. 2008, JASA 103, 570).

    Parameters
    ----------
    runs : Runs
        Settings; its responses are not used.
    curves : array, shape (n, m)
        One a run.
    seed : int
        Of everything random.

    Raises
    ------
    RefusedError
        If the runs cannot carry an emulator, or left-out curves are not predicted: a Q2 below .9.
    """
    settings, which = runs.distinct()
    own = np.zeros((len(settings), curves.shape[1]))
    np.add.at(own, which, curves)
    own /= np.bincount(which)[:, None]
    mean = own.mean(axis=0)
    _, size, shapes = np.linalg.svd(own - mean, full_matrices=False)
    if size[0] <= 1e-12 * float(np.abs(own).max()):
        rule = "every run has the same curve"
        raise RefusedError(str(Fault("invert", rule, "no input can be told from it")))
    kept = shapes[: max(1, min(MOST, int((size > SMALLEST * size[0]).sum())))]
    scores = (own - mean) @ kept.T
    sizes = tuple(
        fit_emulator(Runs(f"shape {j + 1}", runs.factors, settings, column), seed)
        for j, column in enumerate(scores.T)
    )
    # what the shapes leave out is an error, too
    rest = own - mean - scores @ kept
    errors = np.column_stack([one.loo_errors for one in sizes]) @ kept + rest
    q2 = 1.0 - float((errors**2).sum() / ((own - mean) ** 2).sum())
    if not q2 >= GIVEN:
        rule = f"the emulator of the curves has a Q2 of {q2:.2f}, below {GIVEN}"
        raise RefusedError(str(Fault("invert", rule, f"add runs: {2 * len(settings)} in all")))
    single = Runs("force", runs.factors, settings, own.mean(axis=1))
    return CurveEmulator(single, mean, kept, sizes, errors, q2)
