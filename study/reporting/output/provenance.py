"""What a report was made from, so that one that would be the same again is not made again.

The same bytes of the results folder, the same formats and warnings, the same code and the same
libraries give the same report: its name is the hash of all of them. It is believed only while the
files of the report are those that were written. Beside it stands what adds up the statistics: on
another processor, sums of the same numbers differ in their last digits.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import numpy as np
import scipy.linalg  # noqa: F401  (its linear algebra is another one than numpy's)
from threadpoolctl import threadpool_info

import study
from study.bounded_file import read_json, sha256_of
from study.errors import StoreError
from study.record.folder import own_folder
from study.reporting.figure.registry import slug
from study.reporting.output.files import replace_file

#: file in the folder of a report's data
NAME = "made-from.json"

#: files of a results folder that say nothing about results: who works on it, and what is found
#: in the records faster
_SILENT = frozenset({".lock", "index.json"})

#: libraries that compute or draw what a report shows, besides those that solve
_STATISTICS = ("numpy", "scipy", "statsmodels", "pandas")
_LIBRARIES = ("matplotlib", "seaborn", "pandas", "statsmodels", "jinja2", "pint")


def made_of(results: Path, options: Sequence[str], versions: Mapping[str, str]) -> str:
    """Hash of everything that decides a report.

    Parameters
    ----------
    results : Path
        Results folder of the study.
    options : sequence of str
        What was asked for, and what is said besides the results.
    versions : mapping of str to str
        Versions of what computes.

    Returns
    -------
    str
        Hexadecimal.
    """
    package = Path(study.__file__).parent
    code = (path for path in package.rglob("*") if "__pycache__" not in path.parts)
    stored = (path for path in results.rglob("*") if path.name not in _SILENT)
    drawn_by = {name: _version(name) for name in _LIBRARIES}
    said = json.dumps([list(options), dict(versions), drawn_by], sort_keys=True)
    parts = [said, _content(package, code), _content(results, stored)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def is_kept(folder: Path, name: str, made_from: str) -> bool:
    """Whether the report there was made from just this, and is as it was written.

    Parameters
    ----------
    folder : Path
        Where the report of the study goes.
    name : str
        The study.
    made_from : str
        By :func:`made_of`.
    """
    with suppress(OSError, StoreError):
        told = read_json(_note(folder, name))
        return bool(told == _told(folder, name, made_from))
    return False


def keep(folder: Path, name: str, made_from: str) -> None:
    """Note what a report was made from, once it is written.

    Parameters
    ----------
    folder, name, made_from : Path, str, str
        As of :func:`is_kept`.
    """
    told = _told(folder, name, made_from)
    replace_file(_note(folder, name), json.dumps(told, indent=1) + "\n")


def forget(folder: Path, name: str) -> None:
    """Have a report made again the next time.

    Parameters
    ----------
    folder, name : Path, str
        As of :func:`is_kept`.

    Raises
    ------
    StoreError
        If the folder of the report's data is a link that leads out of ``folder``.
    """
    note = _note(folder, name)
    own_folder(folder, note.parent.name)
    note.unlink(missing_ok=True)


@functools.cache
def arithmetic() -> str:
    """Name what decides the last digits of statistics: libraries, and kernels for the processor."""
    versions = [f"{name} {_version(name)}" for name in _STATISTICS]
    algebra = {f"{lib['internal_api']} {lib['version']} {lib['architecture']}"
               for lib in threadpool_info() if lib["internal_api"] == "openblas"}  # fmt: skip
    found = np.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", [])
    return ", ".join([*versions, *sorted(algebra), *found])


def arithmetic_of(folder: Path, name: str) -> str:
    """Read what :func:`arithmetic` was for a report, empty where that is not known.

    Parameters
    ----------
    folder : Path
        Folder of the report.
    name : str
        The study.
    """
    with suppress(StoreError):
        told = read_json(_note(folder, name))
        return str(told.get("arithmetic", "")) if isinstance(told, dict) else ""
    return ""


def _told(folder: Path, name: str, made_from: str) -> dict[str, str]:
    files = _report(folder, name)
    return {"made_from": made_from, "files": files, "arithmetic": arithmetic()}


def _note(folder: Path, name: str) -> Path:
    return folder / f"{slug(name)}-data" / NAME


def _report(folder: Path, name: str) -> str:
    """Hash of the files of a report, whatever formats it has."""
    stem = slug(name)
    pages = [folder / f"{stem}.{suffix}" for suffix in ("html", "tex", "pdf")]
    data = [path for path in (folder / f"{stem}-data").rglob("*") if path.name != NAME]
    return _content(folder, [*pages, *data])


def _content(root: Path, paths: Iterable[Path]) -> str:
    """Hash of the names and bytes of files."""
    sha = hashlib.sha256()
    for path in sorted(paths):
        if path.is_file():
            sha.update(os.fsencode(f"{path.relative_to(root)}{os.sep}"))
            sha.update(bytes.fromhex(sha256_of(path)))
    return sha.hexdigest()


def _version(name: str) -> str:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(name)
    return "none"
