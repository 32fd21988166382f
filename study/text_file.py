"""Text of a file that somebody gave: plain or gzip, UTF-8, of a bounded size."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path

from study.errors import Fault, InputError

MAX_BYTES = 256_000_000


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
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise InputError(too_large_fault(source, size))
        return path.read_bytes()
    except OSError as error:
        raise InputError(Fault(source, f"cannot be read: {error.strerror or error}")) from error


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
        with gzip.open(io.BytesIO(raw)) as stream:
            data = stream.read(MAX_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            Fault(source, f"is a broken gzip file ({error})", "copy the file again from its source")
        ) from error
    if len(data) > MAX_BYTES:
        raise InputError(too_large_fault(source, len(data)))
    return data


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


def too_large_fault(source: str, size: int) -> Fault:
    """Say that a file is too large.

    Parameters
    ----------
    source : str
        Name of the file in messages.
    size : int
        Bytes that it holds; those that were read where it is packed.
    """
    return Fault(
        source,
        f"holds more than {MAX_BYTES // 10**6} MB ({size} bytes)",
        "thin the recording out or split it into several files",
    )
