"""What the terminal shows: results on stdout, progress and complaints on stderr."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from study.errors import Fault, InputError, StudyError

if TYPE_CHECKING:
    from study.curve import Curve
    from study.runner.batch import Progress


#: what a verb answers with --json
Document = Mapping[str, Any]

#: seconds between two lines of progress where there is no terminal to redraw
QUIET_S = 10.0

#: places that are listed of faults with the same rule and mend
SAME = 4


def print_json(document: object) -> None:
    """One JSON document on stdout; never a bare NaN.

    Parameters
    ----------
    document : object
        Plain data. A number that is not finite raises ValueError.
    """
    print(json.dumps(document, indent=2, allow_nan=False))


def complain(error: StudyError) -> None:
    """Print every fault of an error on stderr.

    Parameters
    ----------
    error : StudyError
        Faults with the same rule and mend are printed once, with their places.
    """
    faults = error.faults if isinstance(error, InputError) else (str(error),)
    head = "error" if len(faults) == 1 else f"{len(faults)} errors"
    print(f"{head}:", file=sys.stderr)
    for text in _folded(faults):
        print("  " + text.replace("\n", "\n  "), file=sys.stderr)


def _folded(faults: Sequence[Fault | str]) -> Iterator[str]:
    """Write each fault once, and places with the same fault after its first ones."""
    places: dict[tuple[str, str], list[str]] = {}
    for fault in faults:
        if isinstance(fault, str):
            yield fault
        else:
            places.setdefault((fault.rule, fault.mend), []).append(fault.where)
    for (rule, mend), where in places.items():
        more = f" and {len(where) - SAME} more" if len(where) > SAME else ""
        also = f"    the same at: {'; '.join(where[1:SAME])}{more}" if len(where) > 1 else ""
        lines = (str(Fault(where[0], rule)), also, f"    {mend}" if mend else "")
        yield "\n".join(line for line in lines if line)


def warn(messages: Sequence[str]) -> None:
    """Print warnings on stderr, each once.

    Parameters
    ----------
    messages : sequence of str
        Printed in this order; further lines of one are indented.
    """
    for message in dict.fromkeys(messages):
        print("warning: " + message.replace("\n", "\n  "), file=sys.stderr)


def paragraph(text: str) -> None:
    """Print a sentence or more, folded to the width of the terminal, at most 100 columns.

    Parameters
    ----------
    text : str
        Line breaks in it count as spaces.
    """
    import shutil
    import textwrap

    print(textwrap.fill(text, min(shutil.get_terminal_size((100, 24)).columns, 100)))


def table(rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print rows of text as a table; the first is the header.

    Parameters
    ----------
    rows : sequence of sequence of str
        Cells, as many in every row; without rows nothing is printed.
    title : str
        Printed above; empty for none.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    if not rows:
        return
    made = Table(title=escape(title) or None, title_justify="left", box=None, pad_edge=False)
    for name in rows[0]:
        made.add_column(escape(name), overflow="fold")
    for row in rows[1:]:
        made.add_row(*(escape(cell) for cell in row))
    console = Console(highlight=False, emoji=False)  # "s:a:b" is a term, not a picture
    if not console.is_terminal:
        console.width = 160  # a file has no width: lines must not be folded at 80
    console.print(made)


def seconds(value: float) -> str:
    """Give a duration in words.

    Parameters
    ----------
    value : float
        Duration in s.

    Examples
    --------
    >>> seconds(0.1), seconds(4.2), seconds(75), seconds(7300)
    ('under 1 s', '4 s', '1 min 15 s', '2 h 2 min')
    """
    whole = round(value)
    if whole < 1:
        return "under 1 s"
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    minutes = round(value / 60)
    return f"{minutes // 60} h {minutes % 60} min"


def number(value: float | None, digits: int = 4) -> str:
    """Give a number in a few digits, or a dash.

    Parameters
    ----------
    value : float or None
        None gives the dash.
    digits : int
        Significant digits.
    """
    return "-" if value is None else f"{value:.{digits}g}"


@contextmanager
def progress_line() -> Iterator[Callable[[Progress], None]]:
    """Progress of a run on stderr: a bar on a terminal, a line now and then elsewhere."""
    if sys.stderr.isatty():
        with _bar() as update:
            yield update
        return
    last = 0.0

    def line(state: Progress) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= QUIET_S or state.done == state.total:
            last = now
            print(_text(state), file=sys.stderr, flush=True)

    yield line


def _text(state: Progress) -> str:
    failed = f", {state.failed} failed" if state.failed else ""
    left = f", {seconds(state.seconds_left)} left" if state.seconds_left >= 0.5 else ""
    return f"{state.counted}{failed}{left}: {state.label}"


@contextmanager
def _bar() -> Iterator[Callable[[Progress], None]]:
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        BarColumn(bar_width=30), TextColumn("{task.fields[counted]}"),
        TextColumn("{task.fields[left]} left"), TextColumn("{task.description}"),
    )  # fmt: skip
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None, left="?", counted="")

        def update(state: Progress) -> None:
            failed = f"[red]{state.failed} failed[/red] " if state.failed else ""
            bar.update(
                task,
                total=state.total,
                completed=state.done,
                counted=state.counted,
                left=seconds(state.seconds_left),
                description=failed + escape(state.label),
            )

        yield update


def next_step(what: str, command: str, *, beside: bool = False) -> None:
    """Say what can be done next, and the command that does it.

    Parameters
    ----------
    what : str
        What the command does, in words that follow "next,".
    command : str
        As it is typed; may have several lines.
    beside : bool
        Whether it goes to stderr: for verbs whose stdout is a list that scripts read.
    """
    print(f"next, {what}:\n  {command}", file=sys.stderr if beside else sys.stdout)


def counts(cases: Mapping[str, int]) -> str:
    """Cases in one line.

    Parameters
    ----------
    cases : mapping of str to int
        ``total``, ``done``, ``failed`` and ``missing``.

    Examples
    --------
    >>> counts({"total": 4, "done": 3, "failed": 1, "missing": 0})
    '4 cases: 3 done, 1 failed, 0 missing'
    """
    return (
        f"{cases['total']} cases: {cases['done']} done, {cases['failed']} failed, "
        f"{cases['missing']} missing"
    )


def curve_rows(curve: Curve) -> list[list[str]]:
    """Rows of a table of the quantities that a curve has.

    Parameters
    ----------
    curve : Curve
        Time in s, displacement in mm, force in N and stiffness in N/mm are shown where it has them.

    Returns
    -------
    list of list of str
        The header with units, and one row for every row of the curve.
    """
    every = {
        "time [s]": curve.time_s,
        "displacement [mm]": curve.displacement_mm,
        "force [N]": curve.force_N,
        "stiffness [N/mm]": curve.stiffness_N_per_mm,
    }
    known = {head: values for head, values in every.items() if values is not None}
    rows = zip(*known.values(), strict=True)
    return [list(known), *([f"{v:.6g}" for v in row] for row in rows)]


def print_nuisance(found: Document) -> None:
    """Show nuisance parameters and the share that each has in the variance of the constants.

    Parameters
    ----------
    found : mapping
        Document of each parameter by its name, in the units of the file; shares are from 0 to 1.
        Nothing is printed where it is empty.
    """
    if not found:
        return
    constants = next(iter(found.values()))["shares"]
    rows = [["nuisance parameter", "", "expected", "found", "unit", "95 % interval",
             *(f"share in {name}" for name in constants)]]  # fmt: skip
    for name, one in found.items():
        before = number(one["expected"])
        if one["uncertainty"] is not None:
            before = f"{before} +- {number(one['uncertainty'])}"
        low, high = (number(v) for v in one["ci95"])
        shares = (f"{100 * share:.3g} %" for share in one["shares"].values())
        rows.append([name, one["treated"], before, number(one["value"]), one["unit"],
                     f"{low} to {high}", *shares])  # fmt: skip
    table(rows, "nuisance parameters")
    if any(one["treated"] == "fitted" and one["uncertainty"] for one in found.values()):
        print(
            "what was expected of a fitted one is a pseudo-observation: a row of the fit that "
            "nobody measured"
        )
