"""What the terminal shows: results on stdout, progress and complaints on stderr."""

from __future__ import annotations

import glob
import json
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_type_hints

import typer

from study.ground.errors import Fault, InputError, StudyError
from study.reporting.content.blocks import Block
from study.reporting.content.text import THIN, duration
from study.reporting.output.terminal import say

if TYPE_CHECKING:
    from study.api.assemble import Study
    from study.api.planning import Plan
    from study.harness.runner.batch import Progress


#: words that need not be given
Text = str | None
#: of an option that has no opposite ``--no-...``
SWITCH = object()

#: seconds between two lines of progress where there is no terminal to redraw
QUIET_S = 10.0

#: places that are listed of faults with the same rule and mend
SAME = 4


def option(words: str, *names: str, min: float | None = None, max: float | None = None) -> object:
    """Option of a verb with its help."""
    return typer.Option(*names, help=words, min=min, max=max)


def described(verb: Callable[..., None]) -> Callable[..., None]:
    """Verb with an option for each argument that its annotation describes in words alone."""
    hints = get_type_hints(verb, include_extras=True)
    for name, hint in hints.items():
        words = getattr(hint, "__metadata__", ())
        if words and isinstance(words[0], str):
            names = [f"--{name.replace('_', '-')}"] if SWITCH in words else []
            hints[name] = getitem(Annotated, (hint.__origin__, option(words[0], *names)))
    verb.__annotations__ = hints
    return verb


def argument(words: str, offered: Callable[..., list[str]] | None = None) -> object:
    """Argument of a verb with its help, and what a shell offers for it."""
    return typer.Argument(help=words, autocompletion=offered)


def print_json(result: object) -> None:
    """One JSON document on stdout: fields by name, NaN as null; or what ``to_json`` makes."""
    from study.ground.canonical import plain

    shaped = getattr(result, "to_json", None)
    document = plain(result if shaped is None else shaped())
    print(json.dumps(document, indent=2, allow_nan=False))


def show(
    result: object,
    as_json: bool,
    blocks: Iterable[Block | None],
    warnings: Sequence[str] = (),
) -> None:
    """Print what a verb found as JSON or, then only made, in blocks, after its warnings."""
    warn(warnings)
    if as_json:
        print_json(result)
    else:
        say(blocks)


def complain(error: StudyError) -> None:
    """Print every fault of an error on stderr."""
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
    """Print warnings on stderr, each once."""
    for message in dict.fromkeys(messages):
        print("warning: " + message.replace("\n", "\n  "), file=sys.stderr)


def seconds(value: float) -> str:
    """Give a duration in words."""
    return duration(value).replace(THIN, " ")


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
            failed = f", {state.failed} failed" if state.failed else ""
            more = state.seconds_left or 0.0
            left = f", {seconds(more)} left" if more >= 0.5 else ""
            print(f"{state.counted}{failed}{left}: {state.label}", file=sys.stderr, flush=True)

    yield line


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
                left="?" if state.seconds_left is None else seconds(state.seconds_left),
                description=failed + escape(state.label),
            )

        yield update


def next_step(what: str, command: str, *, is_optional: bool = False) -> None:
    """Say what can be done next, and the command that does it."""
    print(f"next, {what}:\n  {command}", file=sys.stderr if is_optional else sys.stdout)


# The command that comes next, or that resumes, as it is typed, and what a shell offers behind it.
#
# A shell completes studies that have run, design files, tables and cases.

#: verbs that keep what is finished, so that the same command goes on from there
RESUMABLE = frozenset({"demo", "run", "converge", "calibrate"})

#: inside double quotes a shell reads these
_READ_INSIDE = frozenset('"$`\\!')

#: options of a verb by how they are typed; None or a usual value leaves one out
Options = Mapping[str, object]


def written(*words: object, options: Options | None = None) -> str:
    r"""Command as it is typed.

    Examples
    --------
    >>> written("run", "my study.toml", options={"--data": None, "-s": ["a=\'1 mm\'"]})
    'study run \'my study.toml\' -s "a=\'1 mm\'"'
    """
    typed = [str(word) for word in words]
    for name, value in (options or {}).items():
        values = value if isinstance(value, (list, tuple)) else [value]
        for item in values:
            typed += [] if item is None else [name] if item is True else [name, str(item)]
    return " ".join(["study", *map(_quoted, typed)])


def _quoted(word: str) -> str:
    """Quote a word for a shell, with double quotes where it holds single ones alone."""
    if "'" in word and not _READ_INSIDE & set(word):
        return f'"{word}"'
    return shlex.quote(word)


def is_resumable(arguments: Sequence[str]) -> bool:
    """Whether the same words, typed once more, go on from what is finished."""
    return next((word for word in arguments if not word.startswith("-")), "") in RESUMABLE


def interrupted(arguments: Sequence[str]) -> str:
    """Say what is kept of an interrupted command, and what resumes it."""
    if not is_resumable(arguments):
        return "interrupted: nothing was written"
    return (
        "interrupted: what is finished is kept, and is not computed again. To resume:\n"
        f"  {written(*arguments)}"
    )


def after_plan(planned: Plan, design: Path, options: Options) -> tuple[str, str]:
    """Say what to do after a plan, and the command."""
    if planned.predicted_seconds is None:
        return (
            "put the measurements there, or make some of virtual specimens",
            written("virtual", "measurements", options={"--from": design, "-s": options.get("-s")}),
        )
    if not planned.design.responses:
        return "judge its meshes, since it names no response", written("converge", design)
    missing = planned.cases["missing"]
    if missing and planned.calls_function:
        return (
            "compute what is missing, from Python",
            f'study.run("{design}", forward=FUNCTION, version="1")',
        )
    if missing:
        allowed = {"--allow-digest": planned.digest or None}
        return "compute what is missing", written("run", design, options={**options, **allowed})
    return "everything is computed; the report again", written(
        "report", planned.design.name, options=_folders(options)
    )


def after_run(study: Study, options: Options) -> tuple[str, str]:
    """Say what to do after a run or a report, and the command."""
    folders = _folders(options)
    failed = [record.case_id for record in study.records if not record.converged]
    if failed:
        where = {"--study": study.folder, "--results": folders.get("--results")}
        return "why the first case failed", written("why", failed[0], options=where)
    if len(study.records) < study.total:
        return "progress of the cases that are missing", written(
            "status", study.design.name, options={"--results": folders.get("--results")}
        )
    if study.report is None or study.report.suffix != ".html":
        page_options = {**folders, "--format": "html"}
        if study.report is None:  # the folder that was named cannot be written to
            page_options["--reports"] = None if folders["--reports"] else "other-reports"
        return "write its page", written("report", study.design.name, options=page_options)
    return "check every number of the report", written("verify", study.design.name, options=folders)


def _folders(options: Options) -> Options:
    return {name: options.get(name) for name in ("--results", "--reports")}


#: cases that are offered at most: nobody reads more
_MOST = 200


def designs(incomplete: str) -> list[str]:
    """Offer TOML files and the folders on the way to one."""
    return _beginning(incomplete, ".toml", "/")


def studies(context: typer.Context, incomplete: str) -> list[str]:
    """Offer studies with results, and what :func:`designs` does."""
    folders = _beginning(f"{context.params.get('results') or 'results'}/{incomplete}", "/")
    return [*(Path(folder).name for folder in folders), *designs(incomplete)]


def studies_and_tables(context: typer.Context, incomplete: str) -> list[str]:
    """Offer what :func:`studies` does, and CSV files."""
    return [*studies(context, incomplete), *_beginning(incomplete, ".csv")]


def cases(context: typer.Context, incomplete: str) -> list[str]:
    """Offer the cases of all studies whose names begin so."""
    results = Path(context.params.get("results") or "results")
    named = results.glob(f"*/cases/{glob.escape(incomplete)}*")
    return sorted({path.name for path in named})[:_MOST]


def _beginning(typed: str, *endings: str) -> list[str]:
    """Files and folders that begin so and end so, as they are typed; no hidden ones."""
    return sorted(path for end in endings for path in glob.glob(f"{glob.escape(typed)}*{end}"))
