"""``study verify REPORT``: every number of a report once more, from the records alone.

The report is written again into a folder of its own and compared with the one that stands: page,
tables, figures and their data, number by number. The records are checked against their own sums,
and a sample of cases can be solved again from nothing.
"""

from __future__ import annotations

import itertools
import math
import os
import re
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from study.api.folders import REPORTS, RESULTS, design_root, finished_manifest, results_folder
from study.api.opened_study import load as load_study
from study.api.study import report
from study.ground.bounded_file import MAX_BYTES, UnreadableError, read_existing, unzip
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, StoreError
from study.harness.design.load import loads
from study.harness.record.store import Store
from study.harness.runner.batch import run_batch
from study.harness.runner.expansion import expand
from study.harness.runner.fit_problem import Allowed
from study.reporting.output import write
from study.reporting.output.page import DETAILS

#: relative difference of numbers that another processor or other libraries have added up
OTHER_ARITHMETIC = 1e-9

#: relative difference of a response that was solved again: the tolerance of fit and solver
SOLVED_AGAIN = 1e-5

#: bytes that a file of a report may have besides twice those of the one that is written again
_SPARE_BYTES = 65_536

#: kinds of files of a report by the beginning of their names
_KINDS = {"figures": "figure-", "curves": "curves"}

#: differences that are told one by one
TOLD = 50

_NUMBER = re.compile(r"[-+\u2212]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
#: what the clock of a run said of its own statistics, which no record holds
_CLOCK = re.compile(r", statistics [^,(<]*|(?:(?<!\s)\s+)?\(sum [^)]{0,99}\)")
#: where the results lay when the report was written
_PLACE = re.compile(r"(?<=study report )[^\s<]+")
_TEXTS = (".html", ".csv", ".json", ".tex", ".gz")


@dataclass(frozen=True)
class Difference:
    """One thing that is not what the records say."""

    where: str
    reported: str
    recomputed: str


@dataclass
class Verification(Keyed):
    """What a report was found to hold."""

    KEYS = (
        "agrees numbers numbers_total=numbers.total rounded tolerance records solved_again=solved "
        "differences"
    )

    #: Numbers that were compared, by kind: page, tables, figures, curves.
    numbers: Counter[str] = field(default_factory=Counter)
    #: Lines whose numbers agree within the tolerance and not to the last digit.
    rounded: int = 0
    #: Relative difference of numbers that was passed over.
    tolerance: float = 0.0
    records: int = 0
    solved: int = 0
    differences: list[Difference] = field(default_factory=list)

    @property
    def agrees(self) -> bool:
        """Whether nothing differs."""
        return not self.differences


def verify(
    path: str | Path,
    *,
    results: str | Path = RESULTS,
    reports: str | Path = REPORTS,
    resolve: int = 0,
    seed: int = 1,
    data: str | Path | None = None,
    allow_commands: bool | str = False,
    tolerance: float | None = None,
) -> Verification:
    """Compute every number of a report again from its records; ``resolve`` cases from nothing.

    The tolerance is the relative difference of numbers that is passed over: by default none where
    the report was written with the libraries and on the kind of processor of this machine, else
    1e-9, for sums of the same numbers differ in their last digits there.
    """
    page = _page(Path(path), Path(reports))
    folder = results_folder(page.parent.name, results)
    if tolerance is None:
        then = write.arithmetic_of(page.parent, page.stem)
        tolerance = 0.0 if then == write.arithmetic() else OTHER_ARITHMETIC
    verification = Verification(tolerance=tolerance)
    _check_records(folder, verification)
    _compare_report(page.parent, folder, verification)
    if resolve > 0:
        _solve_again(folder, verification, resolve, seed, data, Allowed(allow_commands))
    return verification


def _page(path: Path, reports: Path) -> Path:
    """Page of a report, named by itself, by its folder, or by the study."""
    if os.path.isfile(path):  # of what may not be read nothing is known
        return path.with_stem(path.stem.removesuffix(DETAILS)).resolve()
    for folder in (path, reports / path.name):
        written = sorted(folder.glob("*.html")) if os.path.isdir(folder) else []
        pages = [p for p in written if not p.stem.endswith(DETAILS)]
        if len(pages) == 1:
            return pages[0].resolve()
    mend = "name a folder such as reports/NAME, or write the report: study report NAME"
    raise InputError(Fault(str(path), "there is no page of a report there", mend))


def _check_records(folder: Path, verification: Verification) -> None:
    """Compare every record with its own sum, and with the case that it was written for."""
    warnings: list[str] = []
    store = Store(folder, warn=warnings.append)
    manifest = finished_manifest(store)
    for case_id, input_hash in manifest["cases"].items():
        verification.records += 1
        record = store.read(case_id)
        differs = None
        if record is None:
            differs = Difference(f"record {case_id}", "damaged or missing", "whole")
        elif record.input_hash != input_hash:
            differs = Difference(f"record {case_id}: input", record.input_hash, input_hash)
        verification.differences += [differs] if differs else []


def _compare_report(home: Path, folder: Path, verification: Verification) -> None:
    with tempfile.TemporaryDirectory(prefix="study-verify-") as place:
        formats = ["html", *(["tex"] if list(home.glob("*.tex")) else [])]
        again = report(
            load_study(folder, tell_unfinished=False), reports=Path(place), formats=formats
        )
        if again.report is None:
            raise InputError(f"{folder}: {'; '.join(again.warnings)}")
        fresh = again.report.parent
        names = {
            p.relative_to(top)
            for top in (home, fresh)
            for p in top.rglob("*")
            if p.suffix in _TEXTS and p.name != write.NAME and os.path.isfile(p)
        }
        for name in sorted(names):
            there = os.path.isfile(home / name), os.path.isfile(fresh / name)
            if not all(there):
                lost, made = ("there" if is_there else "missing" for is_there in there)
                verification.differences.append(Difference(str(name), lost, made))
                continue
            text = _text(fresh / name)
            try:
                reported = _text(home / name, 2 * len(text.encode()) + _SPARE_BYTES)
            except StoreError as error:
                verification.differences.append(Difference(str(name), str(error), "readable"))
                continue
            _compare(str(name), _lines(reported), _lines(text), verification)


def _text(path: Path, limit: int = MAX_BYTES) -> str:
    """Text of a file of a report, unpacked, of at most so many bytes."""
    raw = read_existing(path, limit)
    try:
        return (unzip(raw, path, limit) if path.suffix == ".gz" else raw).decode("utf-8")
    except UnicodeDecodeError as error:
        raise UnreadableError(path, f"is no text in UTF-8 ({error.reason})") from error


def _lines(text: str) -> list[str]:
    lines = text.splitlines()
    lines = [_CLOCK.sub("", line) if "<dt>time</dt>" in line else line for line in lines]
    return [_PLACE.sub("", line) for line in lines]


def _compare(name: str, old: Sequence[str], new: Sequence[str], verification: Verification) -> None:
    file = Path(name).name
    kind = next((kind for kind, begin in _KINDS.items() if file.startswith(begin)), "tables")
    if kind == "tables" and file.endswith((".html", ".tex")):
        kind = "page"
    for number, (first, second) in enumerate(itertools.zip_longest(old, new, fillvalue=""), 1):
        numbers = _NUMBER.findall(second)
        verification.numbers[kind] += len(numbers)
        if first == second:
            continue
        if verification.tolerance > 0 and _rounding(first, second, numbers, verification.tolerance):
            verification.rounded += 1
            continue
        same = next(
            (k for k, (a, b) in enumerate(zip(first, second, strict=False)) if a != b),
            min(len(first), len(second)),
        )
        begin = max(same - 30, 0)
        reported, recomputed = first[begin : same + 30].strip(), second[begin : same + 30].strip()
        verification.differences.append(Difference(f"{name}: line {number}", reported, recomputed))


def _rounding(first: str, second: str, numbers: Sequence[str], tolerance: float) -> bool:
    """Whether two lines differ by the last digits of their numbers alone."""
    others = _NUMBER.findall(first)
    if _NUMBER.sub("#", first) != _NUMBER.sub("#", second) or len(others) != len(numbers):
        return False
    old, new = ([float(v.replace("\u2212", "-")) for v in line] for line in (others, numbers))
    pairs = zip(old, new, strict=True)
    return all(math.isclose(a, b, rel_tol=tolerance, abs_tol=0.0) for a, b in pairs)


def _solve_again(
    folder: Path,
    verification: Verification,
    count: int,
    seed: int,
    data: str | Path | None,
    allowed: Allowed,
) -> None:
    """Solve a sample of the cases in an empty store and compare their responses."""
    store = Store(folder)
    manifest = finished_manifest(store)
    design = loads(manifest["design"], manifest["source"])
    work = expand(design, design_root(design, data), allowed)
    stored = store.by_case(manifest["cases"])
    solved = [job for job in work.jobs if (r := stored.get(job.case.case_id)) and r.converged]
    size = min(count, len(solved))
    drawn = sorted(np.random.default_rng(seed).choice(len(solved), size, replace=False).tolist())
    part = replace(work, jobs=tuple(solved[k] for k in drawn))
    with tempfile.TemporaryDirectory(prefix="study-verify-") as place:
        again = Store(Path(place))
        run_batch(part, again, jobs=1)
        fresh = again.by_case(part.input_hashes)
    for job in part.jobs:
        verification.solved += 1
        old = stored[job.case.case_id]
        new = fresh.get(job.case.case_id)
        for name in old.responses:
            first, second = old.value(name), None if new is None else new.value(name)
            if name == "seconds" or first == second:
                continue
            if first is None or second is None or not math.isclose(
                first, second, rel_tol=SOLVED_AGAIN, abs_tol=1e-9
            ):  # fmt: skip
                where = f"case {old.case_id} solved again: {name}"
                verification.differences.append(Difference(where, str(first), str(second)))
