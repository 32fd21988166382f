"""Files of a report: each replaced whole, none outside the folder it was asked for.

A project may come from others, with links in it that lead elsewhere. The folder that the user
names may be a link; what the program puts below it may not lead out again.
"""

from __future__ import annotations

import gzip
from pathlib import Path

from study.record.atomic_files import write_atomic
from study.record.folder import own_folder


def data_folder(folder: Path, stem: str) -> Path:
    """Make the folder for what a page was drawn from, beside the page.

    Parameters
    ----------
    folder : Path
        Of the page; made where missing.
    stem : str
        Name of the page without its suffix.

    Raises
    ------
    StudyError
        If it is a link that leads out of ``folder``.
    """
    beside = own_folder(folder, f"{stem}-data")
    beside.mkdir(parents=True, exist_ok=True)
    return beside


def replace_file(path: Path, text: str) -> None:
    """Write a text beside, then rename: a reader never sees half a file.

    Parameters
    ----------
    path : Path
        In a folder that exists.
    text : str
        Written as UTF-8.
    """
    replace_bytes(path, text.encode())


def replace_packed(path: Path, text: str) -> None:
    """Write a gzip file, the same bytes for the same text.

    Parameters
    ----------
    path : Path
        In a folder that exists.
    text : str
        Packed as UTF-8.
    """
    replace_bytes(path, gzip.compress(text.encode(), 6, mtime=0))


def replace_bytes(path: Path, data: bytes) -> None:
    """Write the bytes of a file beside, then rename; see :func:`replace_file`.

    Parameters
    ----------
    path : Path
        In a folder that exists; a link there is replaced, not followed.
    data : bytes
        The whole file.
    """
    write_atomic(path, data, flush=False)
