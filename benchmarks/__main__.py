"""Compare `study` with other codes on the same meshes, elements, material and tolerance.

Imports and the first compilation are left out, set-up is counted. Run by ``make bench``.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import fitting, force_law, indentation, launch, table
from benchmarks.cases import CASES, Case
from benchmarks.peers import NAMES

EXTRAS = ("indentation-3k", "fitting", "force-law")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen cases, print the table, write the file."""
    chosen = parsed(arguments)
    machine = described() | {"threads": chosen.threads}
    print(f"{machine['cores']} cores, load {machine['load']:.1f}")
    print(f"threads of every code: {chosen.threads}")
    print("ratio: seconds over those of study; force: relative difference from study's")
    if machine["load"] > 0.5:
        print("the machine is busy: times are longer than they should be, and ratios uncertain")
    print(f"\n{table.HEAD}")
    rows: list[table.Row] = []
    for case in CASES:
        if not chosen.only or case.name in chosen.only:
            rows += compared(case, chosen)
    if not chosen.only or "indentation-3k" in chosen.only:
        rows += indented()
    for path in (chosen.json, chosen.csv):
        if path is not None:
            table.write(path, rows, machine)
    if not chosen.only or "fitting" in chosen.only:
        fitting.main()
    if not chosen.only or "force-law" in chosen.only:
        force_law.main()


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    names = [*(case.name for case in CASES), *EXTRAS]
    parser.add_argument("--only", nargs="+", choices=names, help="these cases alone")
    parser.add_argument("--codes", nargs="+", choices=NAMES, help="these codes alone")
    parser.add_argument(
        "--python", action="append", default=[], metavar="CODE=INTERPRETER",
        help="Python that has a code; also by the variable BENCH_PYTHON_CODE",
    )  # fmt: skip
    parser.add_argument("--limit", type=float, default=1200.0, help="seconds for one code and case")
    parser.add_argument(
        "--processes", type=int, default=1, help="of DOLFINx, under mpirun, sharing the threads"
    )
    parser.add_argument("--threads", type=int, default=2, help="threads of every code")
    parser.add_argument("--repeats", type=int, help="runs of which the median counts")
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    parser.add_argument("--csv", type=Path, help="write the rows to this file")
    chosen = parser.parse_args(arguments)
    if any("=" not in given for given in chosen.python):
        parser.error("--python takes CODE=INTERPRETER, such as felupe=/path/to/python")
    chosen.python = dict(given.split("=", 1) for given in chosen.python)
    unknown = sorted(set(chosen.python) - set(NAMES))
    if unknown:
        parser.error(f"--python knows no code {unknown[0]}; there are {', '.join(NAMES)}")
    return chosen


def described() -> table.Row:
    """Machine and how busy it is."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return {
        "cores": os.cpu_count(), "load": load,
        "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(),
    }  # fmt: skip


def compared(case: Case, chosen: argparse.Namespace) -> list[table.Row]:
    """Rows of a case, printed one by one; `study` comes first, as the others need its figures."""
    codes = chosen.codes or case.codes
    rows: list[table.Row] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        case.warm_up().write(folder / "warm.npz")
        case.task().write(folder / "task.npz")
        for code in sorted(codes, key=lambda code: code != "study"):
            found = launch.run(
                code, folder, python=chosen.python, limit_s=chosen.limit,
                repeats=chosen.repeats or case.repeats, threads=chosen.threads,
                processes=chosen.processes,
            )  # fmt: skip
            rows.append(row(case, code, found, rows[0] if rows else None))
            print(table.text(rows[-1]), flush=True)
    for sentence in table.verdicts(case, rows):
        print(f"{'':<17}{sentence}")
    print(flush=True)
    return rows


def row(case: Case, code: str, found: dict[str, Any], ours: table.Row | None) -> table.Row:
    """One row of the table from what a child wrote."""
    made: table.Row = {"case": case.name, "code": code}
    if "problem" in found:
        why = found["problem"]
        hint = f": {NAMES[code].install}" if why == "not installed" else ""
        return made | {"note": why + hint}
    seconds, parts = statistics.median(found["seconds"]), found["parts_s"]
    made |= {name: found[name] for name in ("unknowns", "iterations", "force_N", "peak_MB")}
    made |= {"seconds": seconds, "runs_s": found["seconds"], "solver": found["solver"]}
    made |= {"cpu_s": statistics.median(found["cpu_s"]), "note": found["solver"]}
    if parts:
        share = parts["assembly"] / (parts["total"] - parts["setup"])
        made |= {"setup_s": parts["setup"], "assembly_share": share}
        made["note"] += f", set-up {parts['setup']:.2f} s, assembly {100 * share:.1f} %"
    reference = ours if ours and ours["code"] == "study" and "seconds" in ours else None
    if reference or code == "study":
        against = reference or made
        made["ratio"] = seconds / against["seconds"]
        made["force_difference"] = abs(found["force_N"] / against["force_N"] - 1)
    return made


def indented() -> list[table.Row]:
    """Rows of the indentation, and what is asked of it."""
    rows = indentation.rows()
    for made in rows:
        print(table.text(made))
    worst, asked = max(made["seconds"] for made in rows), indentation.ASKED_S
    print(f"{'':<17}a curve in {worst:.2f} s, asked at most {asked:g}: "
          f"{'met' if worst <= asked else 'MISSED'}\n")  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
