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
no curve), records of another program (their difference from ours is what such a study asks), and
directions whose constants a record does not hold. Not computed again: stiffnesses.

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
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a script: the folder above holds this one
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from study.ground.errors import Fault, InputError, StudyError
from validation.apart import Apart
from validation.recompute_forward import MORE_STEPS, averaged, recomputed
from validation.recompute_records import RESPONSES, Job, jobs_of

#: largest difference that passes: pp of a response in %, else % of the measured force
BAR = 0.05


@dataclass(frozen=True)
class Line:
    """One response of one record.

    Parameters
    ----------
    difference : float
        In pp for a response in %, else in % of the RMS or the largest measured force; of a
        response of the simulation alone in % of itself.
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
    for name, known in recorded.items():
        one = scale[name] if name in scale else 100 / abs(known) if known else math.nan
        yield Line(
            job.study, job.case_id, job.levels, name + label, known, value[name],
            one * (value[name] - known), one * abs(value[name] - other[name]),
        )  # fmt: skip


def _scales(job: Job) -> dict[str, float]:
    """Factors that make differences pp, or % of the measured force where they are in N.

    A response of the simulation alone has none: its differences are in % of itself.
    """
    forces = [np.array(one.measured[1]) for one in job.directions if one.measured is not None]
    if not forces:
        return {}
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
        jobs = jobs_of(folder, data, outcome.left_out)
        outcome.finished += len(jobs)
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
    if job.sticks:
        outcome.notes.append(
            f"{job.case_id}: its indenter holds each point where a load step first finds it, so "
            "more load steps are a finer answer and not the same one"
        )
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
    yield "measured force (a response of the simulation alone: of itself); steps: largest"
    yield "difference of force at the recorded steps, in %"
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
