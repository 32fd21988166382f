"""Arrays beside a record: what a hostile archive promises is not believed."""

from __future__ import annotations

import io
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

from study.ground.errors import StoreError
from study.harness.record import document


def archive(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as made:
        for name, data in members.items():
            made.writestr(f"{name}.npy", data)
    return stream.getvalue()


def array(header: str, data: bytes = b"", version: bytes = b"\1\0") -> bytes:
    text = header.encode() + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text + data


def test_what_was_packed_is_unpacked() -> None:
    given = {"u": np.arange(12.0).reshape(3, 4), "names": np.array(["a", "bc"]), "on": np.bool_(1)}
    _, data = document.pack(given)
    unpacked = document.unpack(data, Path("f"))
    for name, values in given.items():
        np.testing.assert_array_equal(unpacked[name], values)


def test_a_header_that_promises_more_than_there_is_takes_no_memory() -> None:
    """Four gigabytes would be reserved before the first byte is read."""
    header = "{'descr': '|u1', 'fortran_order': False, 'shape': (4000000000,)}"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(StoreError, match="promises 4000000"):
        document.unpack(archive(u=array(header, bytes(100))), Path("f"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


@pytest.mark.parametrize(
    "content",
    [
        b"no archive",
        archive(u=b""),
        archive(u=b"text"),
        archive(u=array("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", bytes(8))),
        archive(u=array("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}")),
        archive(u=array("(" * 9000)),
        archive(u=array("-" * 9000 + "1")),
        archive(u=array("{'descr': '<f8', 'fortran_order': 0, 'shape': 'x'}")),
        archive(u=array("{}", version=b"\7\7")),
        archive(u=array("{'descr': '<f8', 'fortran_order': False, 'shape': (2,)}", bytes(16)))[
            :-60
        ],
    ],
)
def test_a_damaged_archive_is_said_to_be_none(content: bytes) -> None:
    with pytest.raises(StoreError, match="f: is no field file"):
        document.unpack(content, Path("f"))


def test_an_archive_that_unpacks_to_gigabytes_is_refused() -> None:
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as made,
        made.open("u.npy", "w", force_zip64=True) as member,
    ):
        for _ in range(70):
            member.write(bytes(1 << 24))
    with pytest.raises(StoreError, match="unpacks to"):
        document.unpack(stream.getvalue(), Path("f"))
