"""Every curve response of finished records, computed once more and differently.

    python -m validation.recompute results/NAME... --sample 20 --seed 1 [--data DIR] [--json FILE]

The forward problem of a record is solved again with the constants that the record holds: from
the unloaded state, in a process of its own, with gradients, and with four times the load steps.
Forces between the steps come from a cubic spline through forces alone, where the program uses
tangents, and each response from its definition, written down here again. What a fit gave is
taken as it is: a wrong optimum is not found here.

A record of the closed form is compared with finite elements, which have no closed form.
Measured curves are read again where ``--data`` names their folder; else those of the records
are used. Left out, and counted: records without an answer, fits to resampled noise (they hold
no curve), and directions whose constants a record does not hold.

Exit code 0 if all agree, 1 if one differs by more than the bar or has no answer now, 2 for
bad input.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

if not __package__:  # run as a script: the folder above holds this one
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from study.errors import Fault, InputError, StudyError
from validation.apart import Apart

Array = NDArray[np.float64]
Config = Mapping[str, Any]

#: load steps here over those of the record
MORE_STEPS = 4
#: largest difference that passes: pp of a response in %, else % of the measured force
BAR = 0.05
RESPONSES = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")
_CLOSED_FORM = "closed form"


@dataclass(frozen=True)
class Direction:
    """One scored curve of a record: constants in MPa (None: those of the design), and curves."""

    label: str
    responses: dict[str, float]
    constants: dict[str, float] | None
    measured: tuple[list[float], list[float]]
    predicted: tuple[list[float], list[float]]


@dataclass(frozen=True)
class Job:
    """One record, in plain values."""

    study: str
    case_id: str
    levels: str
    config: dict[str, Any]
    responses: dict[str, float]
    directions: tuple[Direction, ...]
    closed_form: bool
    mesh_hash: str


@dataclass(frozen=True)
class Line:
    """One response of one record.

    Parameters
    ----------
    difference : float
        In pp for a response in %, else in % of the RMS or the largest measured force.
    interpolation : float
        How far two interpolations of the denser curve differ, in the same unit: what cannot be
        told apart here.
    """

    study: str
    case_id: str
    levels: str
    response: str
    recorded: float
    recomputed: float
    difference: float
    interpolation: float


@dataclass
class Outcome:
    """Everything that was found in one folder or several."""

    lines: list[Line] = field(default_factory=list)
    steps: dict[str, float] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    finished: int = 0
    sampled: int = 0

    def above(self, bar: float) -> list[Line]:
        """Responses that differ by more than the bar; a missing number is never within it."""
        return [line for line in self.lines if not abs(line.difference) <= bar]

    @property
    def worst(self) -> Line | None:
        """Response that differs most."""
        return max(self.lines, key=_size, default=None)


def _size(line: Line) -> float:
    return math.inf if math.isnan(line.difference) else abs(line.difference)


# What the records hold


def jobs_of(folder: Path, data: Path | None, outcome: Outcome) -> list[Job]:
    """List the records of a results folder that can be computed again.

    Raises
    ------
    InputError
        If the folder holds no study, or ``data`` not its measurements.
    """
    from study.api.places import results_folder
    from study.design import loads
    from study.record import Store

    home = results_folder(folder)
    store = Store(home)
    manifest = store.read_manifest()
    if manifest is None:
        raise InputError(f"{home}: its manifest is damaged; run the design again")
    records = store.records(manifest["cases"])
    outcome.left_out["not computed yet"] += len(manifest["cases"]) - len(records)
    design = loads(manifest["design"], manifest["source"])
    configs = _configs(design, manifest["blocks"], data)
    found = [_job(record, configs, data, outcome) for record in records]
    return sorted((job for job in found if job is not None), key=lambda job: job.case_id)


def _configs(design: Any, blocks: Sequence[str], data: Path | None) -> dict[Any, Config]:
    """Resolve every case, by its levels, its block and the number of its mesh."""
    from study.design import cases
    from study.runner.replicates import mesh_seeded
    from study.runner.surfaces import located

    places = () if data is None else (data.resolve(),)
    return {
        _name(case.levels, case.block, extra): located(case.config, places)
        for case, extra in mesh_seeded(cases(design, blocks), design)
    }


def _name(levels: Mapping[str, str], block: str | None, extra: Mapping[str, Any]) -> Any:
    return tuple(sorted(levels.items())), block, extra.get("mesh_seed")


def _job(
    record: Any, configs: Mapping[Any, Config], data: Path | None, outcome: Outcome
) -> Job | None:
    """Job of a record; None where there is nothing to compute, which is counted."""
    why = _unfit(record)
    if why:
        outcome.left_out[why] += 1
        return None
    config = configs.get(_name(record.levels, record.block, record.extra))
    if config is None:
        raise InputError(f"case {record.case_id}: the stored design has no such cell")
    outcome.finished += 1
    return Job(
        record.study,
        record.case_id,
        " / ".join([*record.levels.values(), *([record.block] if record.block else [])]),
        _plain(config),
        {name: record.response(name) for name in RESPONSES if name in record.responses},
        tuple(_directions(record, config, data)),
        record.solver.get("name") == _CLOSED_FORM,
        str(record.mesh.get("hash", "")),
    )


def _unfit(record: Any) -> str:
    """Why a record cannot be computed again; empty where it can."""
    if not record.converged:
        return f"without an answer ({record.status})"
    if record.extra.get("noise_seed"):
        return "fits to resampled noise, which hold no curve"
    facts = record.extra.get("directions") or ()
    if not facts or not all(f"predicted:{fact['score']}" in record.curves for fact in facts):
        return "without a predicted curve"
    fits = [fact["fit"] or "all" for fact in facts]
    if record.fit is not None and len(set(fits)) < len(fits):
        return "two fits under one name, of which the record holds one"
    return ""


def _plain(config: Config) -> dict[str, Any]:
    from study.design import plain

    made: dict[str, Any] = plain(config)
    return made


def _directions(record: Any, config: Config, data: Path | None) -> Iterator[Direction]:
    for number, fact in enumerate(record.extra["directions"]):
        label = fact["score"]
        fit = None if record.fit is None else record.fit[fact["fit"] or "all"]
        measured = record.curves[f"measured:{label}"]
        if data is not None:
            measured = _read(config, record.block, data, number)
        yield Direction(
            label,
            {name: float(found["value"]) for name, found in fact["responses"].items()},
            None if fit is None else dict(fit["values"]),
            _lists(measured),
            _lists(record.curves[f"predicted:{label}"]),
        )


def _lists(curve: Any) -> tuple[list[float], list[float]]:
    return curve.displacement_mm.tolist(), curve.force_N.tolist()


def _read(config: Config, block: str | None, data: Path, number: int) -> Any:
    """Read the measured curve that a direction is scored on; the second is the first's reverse."""
    from study.design import MeasurementSpec
    from study.record import read_measurements

    spec, height = config["measurements"], config["specimen"].get("height_mm")
    made = spec if isinstance(spec, MeasurementSpec) else MeasurementSpec.from_dict(spec)
    found = read_measurements(made, data, height, config["test"].get("displacement_mm"))
    sides = [found.score or found.fit, found.fit]
    where = dict(sides[number] or {})
    return found.curve(block if found.block is not None else None, **where).curve


# One record again, in a process of its own


def recomputed(job: Job) -> dict[str, Any]:
    """Responses of a record from forward solutions made here.

    Returns
    -------
    dict
        ``responses`` of every direction, ``monotone`` (the same with the other interpolation),
        ``steps`` (largest difference of force at the record's own steps, % of the largest) and
        ``same_mesh``.
    """
    spline, monotone, at_steps, meshes = [], [], 0.0, set()
    for one in job.directions:
        measured, recorded = np.array(one.measured), np.array(one.predicted)
        dense, mesh = solved(job, one, float(measured[0].max()))
        meshes.add(mesh)
        spline.append(scores(between(dense, measured[0]), measured))
        monotone.append(scores(between(dense, measured[0], monotone=True), measured))
        gap = np.abs(between(dense, recorded[0]) - recorded[1]).max()
        at_steps = max(at_steps, 100 * float(gap / np.abs(recorded[1]).max()))
    return {
        "responses": spline,
        "monotone": monotone,
        "steps": at_steps,
        "same_mesh": job.closed_form or meshes == {job.mesh_hash},
    }


def solved(job: Job, one: Direction, depth_mm: float) -> tuple[Array, str]:
    """Displacements and forces of a cold solution with more load steps, shape (2, n).

    Raises
    ------
    RuntimeError
        If it has no answer.
    """
    from study.forward.solve import solve
    from study.runner import build

    problem = build.problem(job.config, one.constants, depth_mm)
    if job.closed_form:
        problem = _on_two_elements(problem, build.area_mm2(job.config["specimen"]))
    test = replace(problem.test, steps=MORE_STEPS * problem.test.steps)
    found = solve(replace(problem, test=test), gradients=True)
    if found.status != "converged":
        raise RuntimeError(f"{found.status}: {found.message}")
    return np.array([found.curve.displacement_mm, found.curve.force_N]), found.mesh_hash


def _on_two_elements(problem: Any, area_mm2: float) -> Any:
    """Cylinder of the same cross-section on a coarse mesh: homogeneous, so any mesh is exact."""
    from study.forward.problem import Cylinder, Model

    height = problem.specimen.height_mm
    cylinder = Cylinder(math.sqrt(area_mm2 / math.pi), height)
    return replace(problem, specimen=cylinder, model=Model(mesh_size_mm=height / 2))


def between(curve: Array, at: Array, *, monotone: bool = False) -> Array:
    """Interpolate forces between the solved steps and the unloaded origin by a cubic.

    Examples
    --------
    >>> curve = np.array([[1.0, 2.0, 3.0], [1.0, 8.0, 27.0]])
    >>> between(curve, np.array([0.5, 2.5])).round(9).tolist()
    [0.125, 15.625]
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    knots, force = curve
    if knots[0] > 0:
        knots, force = np.r_[0.0, knots], np.r_[0.0, force]
    make = PchipInterpolator if monotone else CubicSpline
    return np.asarray(make(knots, force)(np.clip(at, 0.0, knots[-1])), dtype=float)


def scores(force: Array, measured: Array) -> dict[str, float]:
    """Responses of predicted forces at the measured displacements.

    Examples
    --------
    >>> found = scores(np.array([3.3, 4.4]), np.array([[1.0, 2.0], [3.0, 4.0]]))
    >>> [round(found[name], 9) for name in RESPONSES]
    [10.0, 0.353553391, 0.4, 10.0]
    """
    d, known = measured
    gap = force - known
    widths = np.diff(d)
    work = widths @ (known[1:] + known[:-1])
    return {
        "relative_rms_force_error": 100 * math.sqrt(float(gap @ gap) / float(known @ known)),
        "rms_force_error": math.sqrt(float(gap @ gap) / gap.size),
        "peak_force_error": abs(float(force.max()) - float(known.max())),
        "work_error": 100 * abs(float(widths @ (gap[1:] + gap[:-1])) / float(work)),
    }


def averaged(found: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each response over the directions."""
    return {name: math.fsum(one[name] for one in found) / len(found) for name in found[0]}


# Both beside each other


def compare(job: Job, found: Mapping[str, Any]) -> Iterator[Line]:
    """Lines of one record: its responses, and those of each direction where there are two.

    What one direction gains the other may lose: a mean alone would hide it.
    """
    spline, monotone = found["responses"], found["monotone"]
    yield from _lines(job, "", job.responses, averaged(spline), averaged(monotone))
    if len(job.directions) > 1:
        for one, value, other in zip(job.directions, spline, monotone, strict=True):
            yield from _lines(job, f":{one.label}", one.responses, value, other)


def _lines(
    job: Job, label: str, recorded: Mapping[str, float], value: Mapping[str, float],
    other: Mapping[str, float],
) -> Iterator[Line]:  # fmt: skip
    scale = _scales(job)
    for name in RESPONSES:
        if name in recorded:
            difference = scale[name] * (value[name] - recorded[name])
            unclear = scale[name] * abs(value[name] - other[name])
            yield Line(
                job.study, job.case_id, job.levels, name + label, recorded[name], value[name],
                difference, unclear,
            )  # fmt: skip


def _scales(job: Job) -> dict[str, float]:
    """Factors that make differences pp, or % of the measured force where they are in N."""
    forces = [np.array(one.measured[1]) for one in job.directions]
    rms = float(np.mean([np.sqrt(np.mean(force**2)) for force in forces]))
    peak = float(np.mean([np.abs(force).max() for force in forces]))
    return dict.fromkeys(RESPONSES, 1.0) | {
        "rms_force_error": 100 / rms,
        "peak_force_error": 100 / peak,
    }


def sampled(jobs: Sequence[Job], count: int, seed: int) -> list[Job]:
    """Draw records without repetition, in the order of their names; all where there are fewer."""
    if count >= len(jobs):
        return list(jobs)
    drawn = np.random.default_rng(seed).choice(len(jobs), size=count, replace=False)
    return [jobs[k] for k in sorted(drawn.tolist())]


def verify(
    folders: Sequence[Path],
    *,
    sample: int,
    seed: int,
    data: Path | None = None,
    workers: int = 1,
    timeout_s: float = 3600.0,
    say: Any = lambda _: None,
) -> Outcome:
    """Compute a sample of the records of every folder again.

    Parameters
    ----------
    sample : int
        Records of each folder.
    say : callable
        Told of every record as it is done.

    Raises
    ------
    InputError
        If a folder holds no study or nothing to compute, or ``data`` not its measurements.
    """
    outcome = Outcome()
    drawn: list[Job] = []
    for folder in folders:
        jobs = jobs_of(folder, data, outcome)
        if not jobs:
            reasons = ", ".join(f"{n} {why}" for why, n in outcome.left_out.items() if n)
            rule = f"holds no record that can be computed again ({reasons or 'it is empty'})"
            raise InputError(Fault(str(folder), rule))
        drawn += sampled(jobs, sample, seed)
    outcome.sampled = len(drawn)
    with ThreadPoolExecutor(workers) as pool:
        answers = pool.map(lambda job: _asked(job, timeout_s), drawn)
        for job, answer in zip(drawn, answers, strict=True):
            _take(outcome, job, answer)
            say(f"{job.case_id} {job.levels}")
    return outcome


def _asked(job: Job, timeout_s: float) -> Any:
    with Apart() as process:
        return process.ask(recomputed, (job,), timeout_s)


def _take(outcome: Outcome, job: Job, answer: Any) -> None:
    if not answer.ok:
        outcome.failed[f"{job.case_id} ({job.levels})"] = f"{answer.status}: {answer.message}"
        return
    outcome.lines += compare(job, answer.value)
    outcome.steps[job.case_id] = answer.value["steps"]
    if not answer.value["same_mesh"]:
        outcome.notes.append(f"{job.case_id}: its mesh is not the one of the record")


# Output


def shown(outcome: Outcome, bar: float) -> Iterator[str]:
    """Lines of the printed table, the reasons of what is missing, and the worst at the end.

    Single directions are printed where they differ.
    """
    width = max([len(line.levels) for line in outcome.lines] + [6])
    yield (
        f"{'case':<16}  {'levels':<{width}}  {'response':<24}  {'recorded':>12}  "
        f"{'recomputed':>12}  {'difference':>10}  {'spline':>8}  {'steps':>8}"
    )
    for line in outcome.lines:
        fits = abs(line.difference) <= bar
        if fits and ":" in line.response:
            continue
        mark = "" if fits else "  <"
        yield (
            f"{line.case_id:<16}  {line.levels:<{width}}  {line.response:<24}  "
            f"{line.recorded:>12.6g}  {line.recomputed:>12.6g}  {line.difference:>+10.2e}  "
            f"{line.interpolation:>8.1e}  {outcome.steps[line.case_id]:>8.1e}{mark}"
        )
    yield "difference and spline (two interpolations of the denser curve) in pp, or in % of the"
    yield "measured force; steps: largest difference of force at the recorded steps, in %"
    yield from (f"note: {note}" for note in outcome.notes)
    yield from (f"left out: {n} {why}" for why, n in sorted(outcome.left_out.items()) if n)
    yield from (f"no answer: {name}: {why}" for name, why in outcome.failed.items())
    yield _closing(outcome, bar)


def _closing(outcome: Outcome, bar: float) -> str:
    begin = (
        f"{outcome.sampled} of {outcome.finished} records computed again with {MORE_STEPS} times "
        "the load steps"
    )
    worst = outcome.worst
    if worst is None:
        return f"{begin}: none has an answer"
    most = f"worst {worst.difference:+.3g} ({worst.response} of {worst.case_id}, {worst.levels})"
    above, lost = len(outcome.above(bar)), len(outcome.failed)
    return f"{begin}: {most}; {above} responses above {bar:g}, {lost} records without an answer"


def document(outcome: Outcome, bar: float) -> dict[str, Any]:
    """Everything, for JSON; a number that is not finite is null."""
    lines = [asdict(line) for line in outcome.lines]
    finite = [{k: None if v != v else v for k, v in line.items()} for line in lines]
    return {
        "bar": bar,
        "more_steps": MORE_STEPS,
        "sampled": outcome.sampled,
        "finished": outcome.finished,
        "left_out": {why: n for why, n in outcome.left_out.items() if n},
        "failed": outcome.failed,
        "notes": outcome.notes,
        "steps": outcome.steps,
        "above": len(outcome.above(bar)),
        "worst": None if outcome.worst is None else abs(outcome.worst.difference),
        "lines": finite,
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").split("\n")[0],
        epilog="Exit codes: 0 all agree, 1 something differs, 2 bad input.",
    )
    parser.add_argument("results", type=Path, nargs="+", help="results folder of a study, or name")
    parser.add_argument("--sample", type=int, default=20, help="records of each folder (20)")
    parser.add_argument("--seed", type=int, default=1, help="of the sample (1)")
    parser.add_argument("--data", type=Path, help="folder of the measurements, to read them again")
    parser.add_argument("--bar", type=float, default=BAR, help=f"pp or %% that pass ({BAR})")
    parser.add_argument("--jobs", type=int, default=1, help="records at a time (1)")
    parser.add_argument("--timeout", type=float, default=3600.0, help="seconds a record (3600)")
    parser.add_argument("--json", type=Path, help="file for everything that was found")
    return parser


def _faults(given: argparse.Namespace) -> Iterator[Fault]:
    for name in ("sample", "jobs"):
        if getattr(given, name) < 1:
            yield Fault(f"--{name}", f"must be at least 1, got {getattr(given, name)}")
    for name in ("bar", "timeout"):
        if not getattr(given, name) > 0:
            yield Fault(f"--{name}", f"must be positive, got {getattr(given, name):g}")
    if given.data is not None and not given.data.is_dir():
        yield Fault("--data", f"there is no folder {str(given.data)!r}")
    if given.json is not None and not given.json.parent.is_dir():
        yield Fault("--json", f"there is no folder {str(given.json.parent)!r}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 0 if all agree, 1 if something differs, 2 for bad input."""
    given = _parser().parse_args(arguments)
    try:
        if faults := [*_faults(given)]:
            raise InputError(faults)
        outcome = verify(
            given.results, sample=given.sample, seed=given.seed, data=given.data,
            workers=given.jobs, timeout_s=given.timeout,
            say=lambda text: print(text, file=sys.stderr, flush=True),
        )  # fmt: skip
    except StudyError as error:
        print(f"cannot recompute: {error}", file=sys.stderr)
        return 2
    for text in shown(outcome, given.bar):
        print(text)
    if given.json is not None:
        given.json.write_text(json.dumps(document(outcome, given.bar), indent=1) + "\n")
    return 1 if outcome.failed or outcome.above(given.bar) else 0


if __name__ == "__main__":
    sys.exit(main())
