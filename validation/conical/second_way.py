"""Headline figures of a finished study, computed a second way from the data beside its report.

    python validation/conical/second_way.py reports/NAME [--all] [--tolerance 1e-6]

Reads ``NAME-data/`` (``cases.csv``, ``curves.csv.gz``, ``numbers.json``) and nothing else, and
shares no code with the program: curves are summed point by point, sums of squares come from
loops over means, p from a continued fraction. Prints each figure as reported and as found
here, and exits 1 if one differs by more than the tolerance, 2 if one cannot be recomputed.

What it covers: complete tables of cells against blocks, each effect tested against its own
interaction with the blocks (error source E1). What it takes from the report: which cells are
copies of one computation, for the checks of the residuals use one of each.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import itertools
import json
import math
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from loops import Table, Unfit, helmert_rows, mean, ryan_joiner, tested, upper_f

TOLERANCE = 1e-6
#: marks with which a spreadsheet begins a formula; the report puts a quote before them
FORMULA = "=+-@\t\r\n"
SMALLEST = 1e-300


@dataclass(frozen=True)
class Line:
    """One figure: as reported, as found here, and the size against which they are compared."""

    name: str
    reported: float
    found: float
    scale: float = 0.0

    @property
    def difference(self) -> float:
        """Difference relative to the reported figure (or to ``scale`` where that is larger)."""
        if math.isnan(self.reported) or math.isnan(self.found):
            return math.inf
        size = max(abs(self.reported), self.scale, SMALLEST)
        return abs(self.reported - self.found) / size


@dataclass(frozen=True)
class Case:
    """One row of the table of cases."""

    name: str
    block: str
    levels: Mapping[str, str]
    status: str
    numbers: Mapping[str, float]


# Reading


def text(cell: str) -> str:
    """Cell of a CSV without the quote that keeps a spreadsheet from running it."""
    plain = cell[1:]
    quoted = cell[:1] == "'" and (plain[:1] in FORMULA or plain.lstrip(" ")[:1] in FORMULA)
    return plain if quoted and plain else cell


def rows(path: Path) -> Iterator[dict[str, str]]:
    """Rows of a CSV file, packed or not."""
    if not path.is_file():
        raise Unfit(f"there is no {path.name}: write the report again (study report NAME)")
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            yield {text(name): text(cell) for name, cell in row.items()}


def number(cell: str) -> float:
    """Read a number; NaN where the cell is empty."""
    return float(cell) if cell else math.nan


def data_folder(path: Path) -> Path:
    """Folder with the data of a report: given itself, or in the folder of the report."""
    found = [path] if (path / "numbers.json").is_file() else sorted(path.glob("*-data"))
    found = [folder for folder in found if (folder / "numbers.json").is_file()]
    if len(found) != 1:
        raise Unfit(f"{path} holds {len(found)} folders NAME-data with a numbers.json, not one")
    return found[0]


def read_cases(folder: Path, factors: Iterable[str], responses: Iterable[str]) -> list[Case]:
    """All cases, with the factors as labels and the responses as numbers."""
    factors, responses = list(factors), list(responses)
    return [
        Case(
            row["case_id"],
            row["block"],
            {f: row[f] for f in factors},
            row["status"],
            {r: number(row[r]) for r in responses if r in row},
        )
        for row in rows(folder / "cases.csv")
    ]


# Scores of the curves


def curve_scores(folder: Path) -> dict[str, dict[str, float]]:
    """Errors of every case from its curves, the mean over its directions."""
    points: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for row in rows(folder / "curves.csv.gz"):
        values = (row["displacement_mm"], row["measured_N"], row["predicted_N"])
        points[row["case_id"], row["curve"]].append(tuple(map(number, values)))  # type: ignore[arg-type]
    scores: dict[str, list[dict[str, float]]] = defaultdict(list)
    for (case, _), curve in points.items():
        scores[case].append(errors(curve))
    return {
        case: {name: math.fsum(s[name] for s in each) / len(each) for name in each[0]}
        for case, each in scores.items()
    }


def errors(curve: Sequence[tuple[float, float, float]]) -> dict[str, float]:
    """Errors of one predicted curve: points of displacement, measured and predicted force."""
    squares = math.fsum((p - m) ** 2 for _, m, p in curve)
    size = math.fsum(m * m for _, m, _ in curve)
    work = gap = 0.0
    for (d0, m0, p0), (d1, m1, p1) in itertools.pairwise(curve):
        work += (d1 - d0) * (m0 + m1) / 2
        gap += (d1 - d0) * ((p0 - m0) + (p1 - m1)) / 2
    return {
        "relative_rms_force_error": 100 * math.sqrt(squares / size),
        "rms_force_error": math.sqrt(squares / len(curve)),
        "peak_force_error": abs(max(p for *_, p in curve) - max(m for _, m, _ in curve)),
        "work_error": 100 * abs(gap / work),
    }


def check_curves(cases: Sequence[Case], scores: Mapping[str, Mapping[str, float]]) -> list[Line]:
    """Every error of every case that the table holds."""
    lines = []
    for case in cases:
        for name, reported in case.numbers.items():
            kinds = next(iter(scores.values()), {})
            if case.status != "converged" or name not in kinds:
                continue
            found = scores.get(case.name, {}).get(name, math.nan)
            label = " / ".join([*case.levels.values(), case.block])
            lines.append(Line(f"{name} of {label}", reported, found))
    return lines


# Means and sums of squares


def table_of(cases: Sequence[Case], effects: Sequence[Mapping[str, Any]], response: str) -> Table:
    """Complete table of a response (its logarithm where it was analyzed so)."""
    mains = {e["term"]: tuple(e["levels"]) for e in effects if ":" not in e["term"]}
    value: dict[tuple[tuple[str, ...], str], float] = {}
    for case in cases:
        key = tuple(case.levels[f] for f in mains), case.block
        if key in value:
            raise Unfit(f"{response}: cell {' / '.join(key[0])} stands twice in block {key[1]}")
        value[key] = case.numbers.get(response, math.nan)
    blocks = tuple(dict.fromkeys(case.block for case in cases))
    table = Table(tuple(mains), mains, blocks, value)
    lost = [
        (cell, block) for cell in table.cells for block in blocks
        if math.isnan(value.get((cell, block), math.nan))
    ]  # fmt: skip
    if lost:
        raise Unfit(
            f"{response}: the table is not complete ({len(lost)} cells without a value, the first "
            f"is {' / '.join(lost[0][0])} in block {lost[0][1]}); the loops want every cell"
        )
    return table


# One response


def check_response(name: str, reported: Mapping[str, Any], cases: Sequence[Case]) -> list[Line]:
    """Every figure of one response that can be found a second way."""
    if reported["error_term"]["source"] == "E7" and not reported["anova"]["rows"]:
        return []  # a constant response has no effects
    own = [row for row in reported["anova"]["rows"] if str(row["term"]).startswith("block:")]
    if reported["error_term"]["source"] != "E1" or not own:
        raise Unfit(f"{name}: effects are not tested against their interactions with the blocks")
    table = table_of(cases, reported["effects"], name)
    if reported["transform"] == "log":
        table = Table(
            table.factors, table.levels, table.blocks,
            {key: math.log(value) for key, value in table.value.items()},
        )  # fmt: skip
    return [
        *_means(name, reported, table),
        *_tests(name, reported, table),
        *_assumptions(name, reported, table),
    ]


def _means(name: str, reported: Mapping[str, Any], table: Table) -> Iterator[Line]:
    log = reported["transform"] == "log"
    for effect in reported["effects"]:
        factor = effect["term"]
        if ":" in factor:
            continue
        found = [mean(table, {factor: level}) for level in effect["levels"]]
        for level, given, value in zip(effect["levels"], effect["mean"], found, strict=True):
            yield Line(f"{name}: mean at {factor} = {level}", given,
                       math.exp(value) if log else value)  # fmt: skip
        largest = max(found) - min(found)
        # a difference of means is known to the digits of the means themselves
        floor = 1.0 if log else 1e-6 * max(map(abs, found))
        yield Line(f"{name}: largest {'ratio' if log else 'difference'} of {factor}",
                   effect["range"], math.exp(largest) if log else largest, floor)  # fmt: skip


def _tests(name: str, reported: Mapping[str, Any], table: Table) -> Iterator[Line]:
    rows_of = {row["term"]: row for row in reported["anova"]["rows"]}
    for effect in reported["effects"]:
        term = effect["term"]
        row = rows_of[term]
        if row["f"] is None:
            continue  # the same in every block to the tolerance of the solver: no test is made
        found = tested(table, term.split(":"))
        epsilon = found.epsilon
        yield Line(f"{name}: df of {term}", row["df"], found.df)
        yield Line(f"{name}: error df of {term}", row["df_error"], found.df_error)
        yield Line(f"{name}: sum of squares of {term}", row["ss"], found.ss)
        yield Line(f"{name}: F of {term}", row["f"], found.f)
        yield Line(f"{name}: p of {term}", row["p"], upper_f(found.f, found.df, found.df_error))
        yield Line(f"{name}: Greenhouse-Geisser epsilon of {term}", row["epsilon_gg"], epsilon)
        corrected = upper_f(found.f, epsilon * found.df, epsilon * found.df_error)
        yield Line(f"{name}: corrected p of {term}", row["p_gg"], corrected)


def _assumptions(name: str, reported: Mapping[str, Any], table: Table) -> Iterator[Line]:
    """Ryan-Joiner of every contrast over the blocks, which is a sample of its own."""
    for row in reported["normality_rows"]:
        own = helmert_rows(table, row["term"].split(":"))[row["contrast"]]
        label = f"{name}: Ryan-Joiner of contrast {row['contrast'] + 1} of {row['term']}"
        yield Line(label, row["rj"], ryan_joiner(own))
    normality = reported["normality"]
    if normality is not None:
        yield Line(f"{name}: blocks tested", normality["n"], len(table.blocks))
        smallest = min(row["rj"] for row in reported["normality_rows"])
        yield Line(f"{name}: Ryan-Joiner", normality["rj"], smallest)


# The whole study


def untested(responses: Mapping[str, Any]) -> list[str]:
    """Effects that the report itself does not test."""
    return [
        f"{name}: {effect['term']}"
        for name, reported in responses.items()
        for effect in (reported or {}).get("effects", ())
        if effect["p"] is None
    ]


def recompute(path: Path) -> tuple[list[Line], list[str], list[str]]:
    """Every figure of a report's data twice, what could not be recomputed, what has no test.

    Raises
    ------
    Unfit
        If the data are not there.
    """
    folder = data_folder(path)
    responses = json.loads((folder / "numbers.json").read_text("utf-8"))["responses"]
    known = {name: found for name, found in responses.items() if found is not None}
    if not known:
        raise Unfit("no response of this report was analyzed")
    factors = [e["term"] for r in known.values() for e in r["effects"] if ":" not in e["term"]]
    header = next(rows(folder / "cases.csv"), {})
    numeric = [*responses, "relative_rms_force_error", "peak_force_error"]
    cases = read_cases(folder, dict.fromkeys(factors), [n for n in numeric if n in header])
    lines = check_curves(cases, curve_scores(folder))
    unfit = []
    for name, reported in known.items():
        try:
            lines += check_response(name, reported, cases)
        except Unfit as reason:
            unfit.append(str(reason))
    return lines, unfit, untested(responses)


def shown(lines: Sequence[Line], tolerance: float, everything: bool) -> Iterator[str]:
    """Lines of the printed table: figures that differ, all others but single cases."""
    yield f"{'figure':<76} {'reported':>20} {'second way':>20} {'difference':>11}"
    cases: dict[str, list[Line]] = defaultdict(list)
    for line in lines:
        kind, _, where = line.name.partition(" of ")
        single = bool(where) and ":" not in kind
        if single:
            cases[kind].append(line)
        if not single or everything or line.difference > tolerance:
            yield _row(line)
    for kind, each in cases.items():
        worst = max(each, key=lambda line: line.difference)
        most = f"largest difference {worst.difference:.1e}"
        yield f"{kind} of {len(each)} cases: {most} ({worst.name})"


def _row(line: Line) -> str:
    name = line.name if len(line.name) <= 76 else line.name[:73] + "..."
    return f"{name:<76} {line.reported:>20.12g} {line.found:>20.12g} {line.difference:>11.1e}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 0 if all agrees, 1 if something differs, 2 if something is not covered."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("report", type=Path, help="folder of a report, or its NAME-data")
    parser.add_argument("--all", action="store_true", help="print every case too")
    parser.add_argument("--tolerance", type=float, default=TOLERANCE)
    given = parser.parse_args(arguments)
    try:
        lines, unfit, without = recompute(given.report)
    except Unfit as reason:
        print(f"cannot recompute: {reason}", file=sys.stderr)
        return 2
    for text_ in shown(lines, given.tolerance, given.all):
        print(text_)
    if without:
        print(f"no F in the report, so none here: {', '.join(without)}")
    different = sum(line.difference > given.tolerance for line in lines)
    print(f"{len(lines)} figures, {different} differ by more than {given.tolerance:g}")
    for why in unfit:
        print(f"not recomputed: {why}", file=sys.stderr)
    return 1 if different else 2 if unfit or not lines else 0


if __name__ == "__main__":
    sys.exit(main())
