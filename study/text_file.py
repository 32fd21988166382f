"""Text of a file that somebody gave: plain or gzip, UTF-8, of a bounded size."""

from __future__ import annotations

from pathlib import Path

from study import bounded_file
from study.bounded_file import MAX_BYTES, NotRegularError, UnreadableError
from study.errors import Fault, InputError

_THIN_OUT = "name a file of data; a long recording is thinned out or split into several files"


def read_bytes(path: Path, source: str) -> bytes:
    """Read a file as it lies on the disk.

    Parameters
    ----------
    path : Path
        File of at most :data:`MAX_BYTES` bytes.
    source : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If it cannot be read or is too large.
    """
    try:
        return bounded_file.read_existing(path, MAX_BYTES)
    except UnreadableError as error:
        mend = _THIN_OUT if isinstance(error, NotRegularError) else ""
        raise InputError(Fault(source, error.rule, mend)) from error


def unzipped(raw: bytes, source: str) -> bytes:
    """Unpack the content of a file if it is gzip.

    Parameters
    ----------
    raw : bytes
        Returned as it is where it does not begin as gzip does.
    source : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If it is broken, or too large unpacked.
    """
    if raw[:2] != b"\x1f\x8b":
        return raw
    try:
        return bounded_file.unzip(raw, source, MAX_BYTES)
    except UnreadableError as error:
        is_large = isinstance(error, NotRegularError)
        mend = _THIN_OUT if is_large else "copy the file again from its source"
        raise InputError(Fault(source, error.rule, mend)) from error


def decoded(data: bytes, source: str) -> str:
    """Decode UTF-8, with or without a byte order mark.

    Parameters
    ----------
    data : bytes
        Unpacked; a NUL character is refused.
    source : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If it is something else; the message names the line.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(Fault(source, "is in UTF-16", "save it as UTF-8"))
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            Fault(
                f"{source}:{line}",
                f"byte {data[error.start]:#04x} is not UTF-8",
                "save the file as UTF-8",
            )
        ) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(Fault(f"{source}:{line}", "holds a NUL character: this is not a CSV file"))
    return text
