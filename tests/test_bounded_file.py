"""The reader of files: what it refuses, within how many bytes, and how it says so."""

import gzip
import lzma
import os
import resource
import socket
import zlib
from pathlib import Path

import pytest

from study.ground import files
from study.ground.files import NotRegularError, UnreadableError


def bind_socket(path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(path.name)  # the name of a socket has at most 107 bytes


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (os.mkfifo, "is no file but a pipe"),
        (Path.mkdir, "is no file but a folder"),
        (lambda path: path.symlink_to("/dev/zero"), "is no file but a device"),
        (bind_socket, "cannot be read"),
    ],
)
def test_what_is_no_file_is_refused_at_once(tmp_path, monkeypatch, make, said):
    monkeypatch.chdir(tmp_path)
    make(tmp_path / "study.json")
    with pytest.raises(UnreadableError, match=said) as caught:
        files.read_regular(tmp_path / "study.json")
    assert isinstance(caught.value, NotRegularError) == ("is no file" in said)


def test_a_missing_file_is_none_or_said(tmp_path):
    assert files.read_regular(tmp_path / "none") is None
    with pytest.raises(UnreadableError, match="there is no such file"):
        files.read_existing(tmp_path / "none")


@pytest.mark.parametrize("name", ["a\0b", "a" * 300, "\udcff\0"])
def test_a_name_that_no_file_has_is_said(tmp_path, name):
    with pytest.raises(UnreadableError, match="cannot be read") as caught:
        files.read_regular(tmp_path / name)
    assert str(caught.value).isprintable()


def test_a_link_is_followed_only_where_that_is_meant(tmp_path):
    (tmp_path / "file").write_bytes(b"data")
    (tmp_path / "link").symlink_to("file")
    assert files.read_regular(tmp_path / "link") == b"data"
    with pytest.raises(NotRegularError, match="a link, which is not followed"):
        files.read_regular(tmp_path / "link", follow=False)


def test_bytes_are_limited(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(bytes(1000))
    assert files.read_regular(path, 1000) == bytes(1000)
    with pytest.raises(NotRegularError, match="holds more than 999 bytes"):
        files.read_regular(path, 999)


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="needs /proc")
def test_a_file_that_hides_its_size_is_limited_all_the_same():
    assert os.stat("/proc/self/status").st_size == 0
    with pytest.raises(NotRegularError, match="holds more than 10 bytes"):
        files.read_regular("/proc/self/status", 10)
    whole = files.read_existing("/proc/self/status")
    assert whole.startswith(b"Name:")
    assert len(whole) > 500


def test_a_packed_file_is_unpacked_up_to_its_limit():
    text = b"line\n" * 1000
    assert files.unzip(gzip.compress(text) + gzip.compress(b"end"), "f") == text + b"end"
    assert files.unzip(gzip.compress(text), "f", 5000) == text
    with pytest.raises(NotRegularError, match="unpacked, holds more than 4999 bytes"):
        files.unzip(gzip.compress(text), "f", 4999)


def test_a_packed_bomb_takes_no_more_than_the_limit():
    packer = zlib.compressobj(1, wbits=31)
    zeros = bytes(1 << 24)
    bomb = b"".join(packer.compress(zeros) for _ in range(24)) + packer.flush()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(NotRegularError, match="holds more than 50 MB"):
        files.unzip(bomb, "f", 50_000_000)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


@pytest.mark.parametrize(
    "damage",
    [
        lambda raw: raw[:-9],
        lambda raw: raw[:30] + bytes(20) + raw[50:],
        lambda raw: raw[:-4] + b"\1\2\3\4",
        lambda raw: raw + b"rest",
        lambda raw: b"\x1f\x8b",
        lambda raw: b"text",
    ],
)
def test_a_damaged_packed_file_is_said_to_be_broken(damage):
    raw = gzip.compress(os.urandom(2000))
    with pytest.raises(UnreadableError, match="f: is a broken gzip file"):
        files.unzip(damage(raw), "f")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, "[" * 250 + "]" * 250, "", "{", "NaN", b"\xff"]
)
def test_json_that_is_none_or_too_deep_is_said(text):
    with pytest.raises(UnreadableError, match="f: is not valid JSON"):
        files.parse_json(text, "f")


def test_a_file_is_hashed_without_being_held(tmp_path):
    (tmp_path / "file").write_bytes(b"abc")
    found = files.sha256_of(tmp_path / "file")
    assert found == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "none"):
        with pytest.raises(UnreadableError):
            files.sha256_of(tmp_path / name)


@pytest.mark.parametrize("packed", [zlib.compress, lzma.compress])
def test_parts_that_others_unpack_are_limited_together(packed):
    unpacker = files.Unpacker("f", 1000)
    assert unpacker.decompress(packed(bytes(600))) == bytes(600)
    with pytest.raises(NotRegularError, match="f: unpacked, holds more than 1000 bytes"):
        unpacker.decompress(packed(bytes(401)))
    with pytest.raises(UnreadableError, match="a part ends too early"):
        files.Unpacker("f").decompress(packed(bytes(600))[:-2])
    with pytest.raises(UnreadableError, match="f: is broken"):
        files.Unpacker("f").decompress(b"\xfd7zXZ\0no archive")
