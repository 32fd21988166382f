"""Programs and functions of a study: found, named, allowed, and asked for curves."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.bounded_file import UnreadableError, read_existing, sha256_of
from study.canonical import plain
from study.design.sections.cell import Config
from study.errors import Fault, InputError
from study.forward import command
from study.forward.external import External
from study.forward.python_function import PythonFunction
from study.measurement.data_root import locate
from study.setup.section import table_of
from study.setup.setup import Tables

_WHERE = "forward.files"

#: bytes of a file that goes along with a case
MAX_BYTES = 2_000_000


@dataclass(frozen=True)
class Allowed:
    """What a run may use besides this package.

    Parameters
    ----------
    commands : bool or str
        Whether commands may run; a text allows those whose digest begins with it.
    function : PythonFunction or None
        What ``model = "python"`` stands for.
    """

    commands: bool | str = False
    function: PythonFunction | None = None


NOTHING = Allowed()


def with_external(
    config: Tables, places: Sequence[Path], function: PythonFunction | None
) -> Config:
    """Copy a configuration with the files and the identity of its forward model.

    Nothing is run: a program is known by the content of its file.

    Parameters
    ----------
    config : mapping
        Resolved tables of a case.
    places : sequence of Path
        Folders in which ``forward.files`` are looked for; the first that has a file counts.
    function : PythonFunction or None
        What ``model = "python"`` stands for; None where no function was given.

    Returns
    -------
    dict
        Its ``forward`` has ``function`` and ``function_version``, where a function was given, or
        ``programs`` (sha256 by word, empty where a program is missing) and ``contents`` (text by
        file name). Without an external forward model nothing is added.

    Raises
    ------
    InputError
        If a file is missing, too large, or no text.
    """
    external = External.of(config)
    if external is None:
        return dict(config)
    made = plain({k: v for k, v in table_of(config, "forward").items() if v is not None})
    if external.section.model == "python":
        if function is not None:
            made |= {"function": function.text, "function_version": function.version}
        return {**config, "forward": made}
    words = dict.fromkeys([argv[0] for argv in external.section.argv])
    made["programs"] = {word: _program_sha(word) for word in words}
    made["contents"] = {Path(name).name: _text(name, places) for name in external.section.files}
    return {**config, "forward": made}


def _program_sha(word: str) -> str:
    path = command.path_of(word)
    return "" if path is None else _sha_of(path)


_sha_of = functools.cache(sha256_of)


def _text(name: str, places: Sequence[Path]) -> str:
    for folder in places:
        try:
            path = locate(name, folder, where=_WHERE)
            break
        except InputError:
            continue
    else:
        looked = " or ".join(repr(str(folder)) for folder in places)
        mend = "put it beside the design, and name it relative to that"
        raise InputError(Fault(_WHERE, f"there is no file {name!r} below {looked}", mend))
    try:
        text = read_existing(path, MAX_BYTES).decode("utf-8")
    except UnreadableError as error:
        mend = "name the program's own data by a path instead"
        raise InputError(Fault(_WHERE, f"{name!r} {error.rule}", mend)) from error
    except UnicodeDecodeError as error:
        raise InputError(Fault(_WHERE, f"{name!r} is no text in UTF-8")) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def externals(configs: Iterable[Tables]) -> list[External]:
    """Forward models of some configurations that are not ours, each once.

    Parameters
    ----------
    configs : iterable of mapping
        Resolved tables of cases; models of equal content count as one.
    """
    found = {one.digest: one for config in configs if (one := External.of(config)) is not None}
    return list(found.values())


def identity(tables: Tables) -> list[str]:
    """Name of the external forward model of a case; empty where there is none.

    Parameters
    ----------
    tables : mapping
        Resolved tables of the case.

    Returns
    -------
    list of str
        At most one digest, of 12 hex digits.
    """
    external = External.of(tables)
    return [] if external is None else [external.digest]


def named(tables: Tables) -> Mapping[str, object]:
    """Tables for a key, in which the forward model is its name: a pickled function is none.

    Parameters
    ----------
    tables : mapping
        Tables of a problem; returned as they are where our own model predicts.
    """
    external = External.of(tables)
    return tables if external is None else {**tables, "forward": external.digest}
