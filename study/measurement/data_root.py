"""Find measurement files below the data root, and never outside it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

from study.errors import Fault, InputError, MissingDataError

MAX_FILES = 10_000
_FIELD = re.compile(r"\{([^{}]*)\}")


def check_relative(name: str, where: str = "measurements.file") -> None:
    """Refuse a path that is absolute, climbs with ``..`` or holds a NUL.

    Parameters
    ----------
    name : str
        Path as written in the study file, or a pattern of one.
    where : str
        Dotted key of the study file, for messages.

    Raises
    ------
    InputError
        With the rule that the path breaks.
    """
    parts = PurePosixPath(name.replace("\\", "/")).parts
    rule = ""
    if not name.strip():
        rule = "is empty"
    elif "\0" in name:
        rule = "holds a NUL character"
    elif name.startswith(("/", "\\", "~")) or PureWindowsPath(name).drive:
        rule = f"must be relative to the data root, got {name!r}"
    elif ".." in parts:
        rule = f"must stay below the data root, got {name!r}"
    if rule:
        raise InputError(Fault(where, rule, "write it relative to the folder that --data names"))


def locate(name: str, root: Path, *, citation: str = "", where: str = "measurements.file") -> Path:
    """Absolute path of one file below the data root.

    Parameters
    ----------
    name : str
        Path relative to the root.
    root : Path
        Data root.
    citation : str
        Where the data come from, for the message where the file is missing.
    where : str
        Dotted key of the study file, for messages.

    Returns
    -------
    Path
        With links resolved.

    Raises
    ------
    MissingDataError
        If there is no such file; the message says where it was looked for.
    InputError
        If the path is not relative, or a link leads outside the root.
    """
    check_relative(name, where)
    path = root / name
    try:
        resolved = path.resolve()
        inside = resolved.is_relative_to(root.resolve())
        found = inside and resolved.is_file()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(Fault(where, f"{name!r} cannot be used: {error}")) from error
    if not inside:
        raise InputError(
            Fault(
                where,
                f"{name!r} leads outside the data root {str(root)!r} through a link",
                "copy the file there, or name its folder with --data DIR",
            )
        )
    if not found:
        raise MissingDataError(_missing(f"no file {name!r}", root, citation, where))
    return resolved


def locate_pattern(
    pattern: str, root: Path, *, citation: str = "", where: str = "measurements.files"
) -> list[tuple[str, dict[str, str]]]:
    """Files below the data root that match a pattern such as ``"compression-{specimen}.csv"``.

    Parameters
    ----------
    pattern : str
        Path relative to the root; each ``{name}`` stands for one or more characters.
    root : Path
        Data root.
    citation : str
        Where the data come from, for the message where nothing matches.
    where : str
        Dotted key of the study file, for messages.

    Returns
    -------
    list of (relative name, group values)
        Sorted by name; the groups are what stands in the place of each ``{name}``.

    Raises
    ------
    MissingDataError
        If nothing matches.
    InputError
        If the pattern is malformed, or more files match than are read.
    """
    check_relative(pattern, where)
    names = _FIELD.findall(pattern)
    bad = [n for n in names if not n.isidentifier()]
    stray = "{" in _FIELD.sub("", pattern) or "}" in _FIELD.sub("", pattern)
    if not names or bad or stray or len(set(names)) < len(names):
        raise InputError(
            Fault(
                where,
                f"must hold distinct names in braces, got {pattern!r}",
                'for example "compression-{specimen}.csv"; one table is named by `file`',
            )
        )
    matches = sorted(_walk(root, "", list(PurePosixPath(pattern).parts), {}))
    if not matches:
        raise MissingDataError(_missing(f"no file matches {pattern!r}", root, citation, where))
    if len(matches) > MAX_FILES:
        raise InputError(Fault(where, f"{len(matches)} files match, at most {MAX_FILES} are read"))
    return [(name, dict(groups)) for name, groups in matches]


def _walk(
    folder: Path, prefix: str, parts: list[str], groups: dict[str, str]
) -> Iterator[tuple[str, tuple[tuple[str, str], ...]]]:
    regex, last = _part_regex(parts[0]), len(parts) == 1
    try:
        entries = sorted(os.scandir(folder), key=lambda e: e.name)
    except OSError:
        return
    for entry in entries:
        match = regex.fullmatch(entry.name)
        if match is None or (entry.is_dir() == last):
            continue
        found = {**groups, **match.groupdict()}
        if last:
            yield prefix + entry.name, tuple(found.items())
        else:
            yield from _walk(folder / entry.name, f"{prefix}{entry.name}/", parts[1:], found)


def _part_regex(part: str) -> re.Pattern[str]:
    """One path component as a regular expression; each name takes as little as it can."""
    pieces = _FIELD.split(part)
    out = [f"(?P<{p}>.+?)" if k % 2 else re.escape(p) for k, p in enumerate(pieces)]
    return re.compile("".join(out), re.DOTALL)


def _missing(what: str, root: Path, citation: str, where: str) -> Fault:
    mend = "point to the folder that holds it with --data DIR"
    if citation:
        mend += f"; the data come from: {citation}"
    elif where.startswith("measurements"):
        mend += ", or let 'study virtual measurements --help' make curves of virtual specimens"
    state = "" if root.is_dir() else " (there is no such folder)"
    return Fault(where, f"{what} below {str(root)!r}{state}", mend)
