"""What a shell offers behind a verb: studies that have run, design files, tables, cases."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import typer

#: where results are kept when no option says otherwise
_RESULTS = Path("results")

#: cases that are offered at most: nobody reads more
_MOST = 200


def designs(incomplete: str) -> list[str]:
    """Offer TOML files and the folders on the way to one."""
    return _paths(incomplete, (".toml",))


def studies(context: typer.Context, incomplete: str) -> list[str]:
    """Offer studies with results, and what :func:`designs` does."""
    names = _beginning(incomplete, (folder.name for folder in _folders(context)))
    return [*names, *designs(incomplete)]


def studies_and_tables(context: typer.Context, incomplete: str) -> list[str]:
    """Offer what :func:`studies` does, and CSV files."""
    return [*studies(context, incomplete), *_paths(incomplete, (".csv",), folders=False)]


def cases(context: typer.Context, incomplete: str) -> list[str]:
    """Offer the cases of all studies whose names begin so."""
    names = (path.name for study in _folders(context) for path in _inside(study / "cases"))
    return _beginning(incomplete, names)[:_MOST]


def _folders(context: typer.Context) -> list[Path]:
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
