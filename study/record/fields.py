"""Arrays beside a record: packed into one file, whose name holds the hash of its content."""

from __future__ import annotations

import hashlib
import io
import math
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic
from numpy.typing import ArrayLike, NDArray

from study.errors import StoreError

#: an array as it was kept: of numbers, flags or text
Stored = NDArray[np.generic]

MAX_FIELD_BYTES = 1_000_000_000
_NAME = re.compile(r"fields-[0-9a-f]{16}\.npz")


def pack(fields: Mapping[str, ArrayLike]) -> tuple[str, bytes]:
    """File name and content of some arrays.

    Parameters
    ----------
    fields : mapping of str to array_like
        Numbers, flags or text.

    Returns
    -------
    (name, data) : str and bytes
        ``fields-HASH.npz``, the hash being that of the content, and the compressed archive.

    Raises
    ------
    TypeError
        If one of them holds Python objects.
    """
    arrays = {name: np.asarray(value) for name, value in fields.items()}
    bad = [name for name, value in arrays.items() if value.dtype.hasobject]
    if bad:
        raise TypeError(f"field {bad[0]!r} holds Python objects, which are never stored")
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    data = stream.getvalue()
    return f"fields-{hashlib.sha256(data).hexdigest()[:16]}.npz", data


def is_name(name: object) -> bool:
    """Whether a text is the name of a file of arrays, and no path to somewhere else.

    Parameters
    ----------
    name
        As a record gives it; anything but a text is none.
    """
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def fits(name: str, data: bytes | None) -> bool:
    """Whether the content of a file is the one that its name promises.

    Parameters
    ----------
    name : str
        One that :func:`is_name` accepts.
    data : bytes or None
        None where the file could not be read.
    """
    return data is not None and hashlib.sha256(data).hexdigest()[:16] == name[7:23]


def unpack(data: bytes, path: Path) -> dict[str, Stored]:
    """Arrays of a file.

    Parameters
    ----------
    data : bytes
        Content of the file, as :func:`pack` makes it.
    path : Path
        Where it was read, for messages.

    Raises
    ------
    StoreError
        If it is no such file, or would unpack to more than any study keeps.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > MAX_FIELD_BYTES:
                raise StoreError(f"{path}: unpacks to {size} bytes, which no field file does")
            for info in archive.infolist():
                _check_header(archive, info)
        with np.load(io.BytesIO(data), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except StoreError:
        raise
    except Exception as error:  # numpy's parser of headers raises whatever it stumbles over
        raise StoreError(f"{path}: is no field file ({error})") from error


def _check_header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> None:
    """Refuse an array whose header promises another size than its file: numpy reserves that."""
    with archive.open(info) as member:
        read = {(1, 0): read_array_header_1_0, (2, 0): read_array_header_2_0}
        shape, _, dtype = read[read_magic(member)](member)
        promised = member.tell() + math.prod(shape) * dtype.itemsize
    if promised != info.file_size:
        raise ValueError(f"{info.filename} promises {promised} bytes and has {info.file_size}")
