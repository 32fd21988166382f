"""The command that comes next, or that resumes, as it is typed, and what a shell offers behind it.

A shell completes studies that have run, design files, tables and cases.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from study.api.planning.plan import Plan
    from study.study_result.study_result import StudyResult

#: verbs that keep what is finished, so that the same command goes on from there
RESUMABLE = frozenset({"demo", "run", "converge", "calibrate"})

#: inside double quotes a shell reads these
_READ_INSIDE = frozenset('"$`\\!')

#: options of a verb by how they are typed; None or a usual value leaves one out
Options = Mapping[str, object]


def written(*words: object, options: Options | None = None) -> str:
    r"""Command as it is typed.

    Parameters
    ----------
    *words : object
        Verb and arguments, written as text and quoted for a shell where they need it.
    options : mapping of str to object, optional
        By how they are typed. None leaves one out, True writes it alone, a list or tuple writes it
        once for every item.

    Examples
    --------
    >>> written("run", "my study.toml", options={"--data": None, "-s": ["a=\'1 mm\'"]})
    'study run \'my study.toml\' -s "a=\'1 mm\'"'
    """
    typed = [str(word) for word in words]
    for name, value in (options or {}).items():
        values = value if isinstance(value, (list, tuple)) else [value]
        for one in values:
            typed += [] if one is None else [name] if one is True else [name, str(one)]
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
    """Say what is kept of an interrupted command, and what resumes it.

    Parameters
    ----------
    arguments : sequence of str
        Words behind ``study``, as they were typed.
    """
    if not is_resumable(arguments):
        return "interrupted: nothing was written"
    return (
        "interrupted: what is finished is kept, and is not computed again. To resume:\n"
        f"  {written(*arguments)}"
    )


def after_plan(found: Plan, design: Path, options: Options) -> tuple[str, str]:
    """Say what to do after a plan, and the command.

    Parameters
    ----------
    found : Plan
        Without predicted seconds its measurements are missing.
    design : Path
        Design file, as it was typed.
    options : mapping of str to object
        Options of the plan by how they are typed, to be typed again.
    """
    if found.predicted_seconds is None:
        return (
            "put the measurements there, or make some of virtual specimens",
            written("virtual", "measurements", options={"--from": design, "-s": options.get("-s")}),
        )
    if found.missing:
        allowed = {"--allow-digest": found.digest or None}
        return "compute what is missing", written("run", design, options={**options, **allowed})
    return "everything is computed; the report again", written(
        "report", found.design.name, options=_folders(options)
    )


def after_run(study: StudyResult, options: Options) -> tuple[str, str]:
    """Say what to do after a run or a report, and the command.

    Parameters
    ----------
    study : StudyResult
        With its report, if one was written.
    options : mapping of str to object
        ``--results`` and ``--reports``; None for the usual folder.
    """
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
        wanted = {**folders, "--format": "html"}
        return "write its page", written("report", study.design.name, options=wanted)
    return "check every number of the report", written("verify", study.design.name, options=folders)


def _folders(options: Options) -> Options:
    return {name: options.get(name) for name in ("--results", "--reports")}


#: where results are kept when no option says otherwise
_RESULTS = Path("results")

#: cases that are offered at most: nobody reads more
_MOST = 200


def designs(incomplete: str) -> list[str]:
    """Offer TOML files and the folders on the way to one.

    Parameters
    ----------
    incomplete : str
        What is typed of the word so far.
    """
    return _paths(incomplete, (".toml",))


def studies(context: typer.Context, incomplete: str) -> list[str]:
    """Offer studies with results, and what :func:`designs` does.

    Parameters
    ----------
    context : Context
        Of the command; its ``--results``, if typed already, names the folder of the studies.
    incomplete : str
        What is typed of the word so far.
    """
    names = _beginning(incomplete, (folder.name for folder in _results_in(context)))
    return [*names, *designs(incomplete)]


def studies_and_tables(context: typer.Context, incomplete: str) -> list[str]:
    """Offer what :func:`studies` does, and CSV files.

    Parameters
    ----------
    context, incomplete : Context, str
        As for :func:`studies`.
    """
    return [*studies(context, incomplete), *_paths(incomplete, (".csv",), folders=False)]


def cases(context: typer.Context, incomplete: str) -> list[str]:
    """Offer the cases of all studies whose names begin so.

    Parameters
    ----------
    context, incomplete : Context, str
        As for :func:`studies`.

    Returns
    -------
    list of str
        At most 200 ids of cases.
    """
    names = (path.name for study in _results_in(context) for path in _inside(study / "cases"))
    return _beginning(incomplete, names)[:_MOST]


def _results_in(context: typer.Context) -> list[Path]:
    """Folders of studies, in that of the results."""
    results = Path(context.params.get("results") or _RESULTS)
    return [folder for folder in _inside(results) if folder.is_dir()]


def _paths(incomplete: str, endings: tuple[str, ...], *, folders: bool = True) -> list[str]:
    """Files and folders below what is typed already, as it was typed."""
    typed, _, _ = incomplete.rpartition("/")
    above = f"{typed}/" if "/" in incomplete else ""
    found = list(_inside(Path(above or ".")))
    names = [f"{above}{one.name}" for one in found if one.suffix in endings and one.is_file()]
    names += [f"{above}{one.name}/" for one in found if folders and one.is_dir()]
    return _beginning(incomplete, names)


def _inside(folder: Path) -> Iterator[Path]:
    """List what a folder holds but hidden files; nothing of one that cannot be read."""
    with suppress(OSError):
        yield from (one for one in folder.iterdir() if not one.name.startswith("."))


def _beginning(start: str, names: Iterable[str]) -> list[str]:
    return sorted({name for name in names if name.startswith(start)})
