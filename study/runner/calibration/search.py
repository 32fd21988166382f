"""Where the search for the constants of a calibration begins, and within which bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.calibration.influence import with_serial_correlation
from study.design.sections.calibration_design import CalibratedTest, CalibrationDesign
from study.errors import Fault, InputError
from study.runner.calibration.measured_tests import FitCurve, in_order, parts_of, problem_of
from study.runner.calibration.multistart import Starts, best, excluded, scattered
from study.runner.calibration.nuisance.propagation import with_nuisance
from study.runner.fitting import fit_task
from study.runner.fitting.fit_problem import FitProblem, start_problem
from study.runner.fitting.staged_fit import (
    Checkpoint,
    Progress,
    Staged,
    begun_stage,
    cheaper,
    staged_fit,
)
from study.runner.fitting.starts import gentler


@dataclass(frozen=True)
class Setting:
    """What all fits of one calibration share."""

    config: CalibrationDesign
    tests: Sequence[CalibratedTest]
    names: tuple[str, ...]
    start: Array
    bounds: Sequence[tuple[float, float]] | None
    progress: Progress | None
    #: what was done to a start outside the bounds, in words
    moved: tuple[str, ...] = ()

    def fitted(self, curves: Sequence[FitCurve], checkpoint: Checkpoint | None = None) -> Staged:
        """Fit to the curves whose role is ``fit``."""
        parts = parts_of(self.tests, in_order(curves))
        done = staged_fit(
            parts, self.names, self.start, fit_task.model, bounds=self.bounds,
            progress=self.progress, checkpoint=checkpoint,
        )  # fmt: skip
        measured = [one for part in parts for one in part.measured]
        found = with_serial_correlation(done.fit, measured)
        own = in_order(curves)
        return replace(done, fit=with_nuisance(found, parts, self.tests, own, self.bounds))


def setting_of(
    config: CalibrationDesign,
    curves: Sequence[FitCurve],
    progress: Progress | None,
    checkpoint: Checkpoint,
    begin: Mapping[str, float] | None = None,
) -> Setting:
    """Constants, start and bounds of a calibration.

    Parameters
    ----------
    config : CalibrationDesign
        The calibration.
    curves : sequence of FitCurve
        Measured ones.
    progress : callable, optional
        Gets every accepted iteration, those of the fits that find the start included.
    checkpoint : Checkpoint
        Keeps accepted iterations.
    begin : mapping of str to float, optional
        Constants to start from, MPa (exponents plain), in place of the calibration's own.

    Returns
    -------
    Setting

    Raises
    ------
    InputError
        If no start is found, or the given one lies outside the bounds of the file.
    """
    tests, given = config.tests, config.bounds
    if begin is None:
        names, start = _start(tests, curves, progress, checkpoint)
    else:
        names, start = tuple(begin), np.array(list(begin.values()), float)
    bounds = bounds_of(config, names)
    low, high = np.array(bounds).T
    inside = np.clip(start, low, high)
    outside = [name for name, moved in zip(names, inside != start, strict=True) if moved]
    if outside and config.material.constants:
        raise InputError([excluded(n, start[names.index(n)], given[n]) for n in outside])
    moved = tuple(
        f"the start of {n} lay outside its bounds and was moved to {inside[names.index(n)]:.6g}"
        for n in outside
    )
    finite = np.isfinite(bounds).any()
    return Setting(config, tests, names, inside, bounds if finite else None, progress, moved)


def bounds_of(config: CalibrationDesign, names: Sequence[str]) -> list[tuple[float, float]]:
    """Bounds of the file; else those beyond which an energy is not defined.

    Parameters
    ----------
    config : CalibrationDesign
        The calibration.
    names : sequence of str
        Constants.

    Returns
    -------
    list of (low, high)
        MPa (exponents plain); may be infinite.
    """
    return [config.bounds.get(n) or config.material.bounds(n) for n in names]


def from_all_starts(
    setting: Setting, curves: Sequence[FitCurve], own: Staged
) -> tuple[Staged, Starts | None]:
    """Fit from the other starts that were asked for; the least sum of squares is the answer.

    Parameters
    ----------
    setting : Setting
        Its calibration gives the number of starts and the seed of the draws.
    curves : sequence of FitCurve
        Measured ones; those held out take no part.
    own : Staged
        Fit from the calibration's own start.

    Returns
    -------
    answer : Staged
        Its ``fruitless`` counts the evaluations of all other fits too.
    starts : Starts or None
        Sums of squares of all starts; None where one start alone was asked for.
    """
    count, seed = setting.config.asked.starts, setting.config.asked.seed
    if count == 1:
        return own, None
    rng, parts = np.random.default_rng(seed), parts_of(setting.tests, in_order(curves))
    energy, found = setting.config.material.model, [own]
    for _ in range(count - 1):
        start = scattered(energy, setting.names, setting.start, parts, setting.bounds, rng)
        found.append(replace(setting, start=start, progress=None).fitted(curves))
    rss = tuple(one.fit.rss if one.fit.converged else None for one in found)
    chosen = best(found)
    evaluations = sum(one.evaluations for one in found if one is not chosen)
    return replace(chosen, fruitless=chosen.fruitless + evaluations), Starts(seed, rss)


def _start(
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    progress: Progress | None,
    checkpoint: Checkpoint,
) -> tuple[tuple[str, ...], Array]:
    """Find the start: the given constants, or those of a simpler fit of one fitted test.

    A homogeneous test is preferred: its closed form costs nothing.
    """
    fitted = list(dict.fromkeys(c.test for c in in_order(curves)))
    problems = {number: problem_of(tests[number].tables) for number in fitted}
    closed = [number for number in fitted if problems[number].method == "closed-form"]
    number = (closed or fitted)[0]
    problem = problems[number]
    part = parts_of(tests, [c for c in in_order(curves) if c.test == number])[0]
    measured = [m.curve for m in part.measured]
    constants: dict[str, float] | None = None
    for before in _simpler(problem):
        names, first = fit_task.start_values(before.tables, measured, constants)
        own = replace(part, tables=before.tables)
        stage = f"start ({before.material.model}, {len(names)} constants)"
        found = begun_stage(
            stage,
            [cheaper(own) or own],
            names,
            gentler(names, first),
            fit_task.model,
            None,
            progress,
            checkpoint,
        ).fit
        if not found.status.usable:
            message = f"the {stage} did not converge: {found.message}"
            raise InputError(Fault("calibration", message, "give constants to start from"))
        constants = found.constants()
    return fit_task.start_values(problem.tables, measured, constants)


def _simpler(problem: FitProblem) -> list[FitProblem]:
    """Problems whose constants lead to those of a fit, the neo-Hookean one first."""
    chain: list[FitProblem] = []
    before = start_problem(problem)
    while before is not None:
        chain.insert(0, before)
        before = start_problem(before)
    return chain
