"""Rows for a reader, and for a file."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.cases import Case
from benchmarks.peers import NAMES

Row = dict[str, Any]
COLUMNS = (
    "case", "unknowns", "code", "seconds", "ratio", "force_difference", "iterations",
    "peak_MB", "cpu_s", "force_N", "setup_s", "assembly_share", "solver", "note",
)  # fmt: skip
HEAD = (
    f"{'case':<17}{'unknowns':>9}  {'code':<24}{'seconds':>8}{'ratio':>7}{'force':>9}"
    f"{'iter.':>6}{'peak GB':>8}  note"
)


def text(row: Row) -> str:
    """One line of the table."""

    def shown(name: str, form: str, factor: float = 1.0) -> str:
        value = row.get(name)
        return "-" if value is None else format(value if form == "d" else value * factor, form)

    title = NAMES[row["code"]].title if row["code"] in NAMES else row["code"]
    line = (
        f"{row['case']:<17}{shown('unknowns', 'd'):>9}  {title:<24}{shown('seconds', '.2f'):>8}"
        f"{shown('ratio', '.1f'):>7}{shown('force_difference', '.0e'):>9}"
        f"{shown('iterations', 'd'):>6}{shown('peak_MB', '.2f', 1 / 1024):>8}"
        f"  {row.get('note', '')}"
    )
    return line.rstrip()


def verdicts(case: Case, rows: Sequence[Row]) -> list[str]:
    """Sentences on what is asked of `study` in a case."""
    ours = next((r for r in rows if r["code"] == "study" and r.get("seconds")), None)
    if ours is None:
        return []
    out = speed(case, [r for r in rows if r.get("ratio") and r["code"] != "study"])
    limits = (
        ("peak memory", "GB", ours["peak_MB"] / 1024, case.memory_GB),
        ("set-up", "s", ours["setup_s"], case.setup_s),
        ("assembly's share of an iteration", "%", 100 * ours["assembly_share"],
         case.assembly_share and 100 * case.assembly_share),
    )  # fmt: skip
    for what, unit, value, limit in limits:
        if limit is not None:
            out.append(
                f"{what} {value:.2f} {unit}, asked at most {limit:g}: {_met(value <= limit)}"
            )
    return out


def speed(case: Case, peers: Sequence[Row]) -> list[str]:
    """How many times slower the peers are that solve the same equations."""
    out = []
    same = [r for r in peers if r["force_difference"] < 1e-5]
    if case.faster and same:
        best = min(same, key=lambda r: r["ratio"])
        out.append(
            f"{best['ratio']:.2f} times faster than the fastest peer with the same answer "
            f"({NAMES[best['code']].title}), asked {case.faster:g}: "
            f"{_met(best['ratio'] >= case.faster)}"
        )
    for code, asked in case.than:
        for row in (r for r in same if r["code"] == code):
            met = _met(row["ratio"] >= asked)
            out.append(
                f"{row['ratio']:.2f} times faster than {NAMES[code].title}, asked {asked:g}: {met}"
            )
    return out


def _met(good: bool) -> str:
    return "met" if good else "MISSED"


def write(path: Path, rows: Sequence[Row], machine: Row) -> None:
    """Write all rows: JSON with the machine, or CSV, by the file's ending."""
    if path.suffix == ".csv":
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
        return
    path.write_text(
        json.dumps({"machine": machine, "rows": list(rows)}, indent=2) + "\n", encoding="utf-8"
    )
