"""Files: read within bounds, from whoever wrote them, and written whole or not at all.

A path may lead to a pipe, which opens when somebody writes into it; to a device, which has no
end; to an archive that unpacks to a thousand times its size; or to JSON that is nested deeper
than the stack of a parser. Each is refused with a message that says which.
``tests/test_bounded_reading.py`` finds whatever reads past this module.

A file is written beside its place, flushed to the disk, renamed over its final name, and the
folder is flushed: after a crash or a power loss the old content or the new one is there,
never something in between (Pillai et al. 2014, OSDI, "All file systems are not created
equal").
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import gzip
import hashlib
import io
import json
import lzma
import os
import re
import socket
import stat
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from pydantic_core import from_json

from study.ground.errors import DiskFullError, Fault, InputError, StoreError, WriteError, nearest

#: bytes of a file of data, before and after it is unpacked
MAX_BYTES = 256_000_000
#: bytes of a JSON file: this program writes none that is larger
MAX_JSON_BYTES = 200_000_000
#: bytes of a file that is hashed and not kept in memory: programs and surfaces
MAX_HASHED_BYTES = 4_000_000_000

_CHUNK = 1 << 20
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


class UnreadableError(StoreError):
    """A file that is not read; ``rule`` is the reason without the name of the file."""

    def __init__(self, source: str | Path, rule: str) -> None:
        name = str(source)
        super().__init__(f"{name if name.isprintable() else ascii(name)}: {rule}")
        self.rule = rule


class NotRegularError(UnreadableError):
    """What stands in the place of a file is none, or larger than it may be."""


def open_regular(
    path: str | Path, limit: int = MAX_BYTES, *, follow: bool = True
) -> io.FileIO | None:
    """Open a regular file for reading, unbuffered; None if there is none."""
    try:
        if not follow and os.path.islink(path):
            raise NotRegularError(path, "is a link, which is not followed")
        # without O_NONBLOCK, to open a pipe waits until somebody writes into it
        flags = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | (0 if follow else os.O_NOFOLLOW)
        handle = os.open(path, flags)
        try:
            status = os.fstat(handle)
            if not stat.S_ISREG(status.st_mode):
                kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
                raise NotRegularError(path, f"is no file but {kind}")
            if status.st_size > limit:
                raise NotRegularError(path, _larger(limit))
            return io.FileIO(handle)
        except BaseException:
            os.close(handle)
            raise
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:  # a NUL in the name is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise UnreadableError(path, f"cannot be read ({reason})") from error


def read_regular(
    path: str | Path, limit: int = MAX_JSON_BYTES, *, follow: bool = True
) -> bytes | None:
    """Read a whole file; None if there is none."""
    stream = open_regular(path, limit, follow=follow)
    if stream is None:
        return None
    parts: list[bytes] = []
    left = limit + 1
    try:
        with stream:
            size = os.fstat(stream.fileno()).st_size + 1  # one read of all, and one of the end
            while left and (part := stream.read(min(size, left))):
                parts.append(part)
                left -= len(part)
                size = _CHUNK
    except OSError as error:
        raise UnreadableError(path, f"cannot be read ({error.strerror or error})") from error
    if not left:
        raise NotRegularError(path, _larger(limit))
    return b"".join(parts)


def read_existing(path: str | Path, limit: int = MAX_JSON_BYTES) -> bytes:
    """Read a whole file as :func:`read_regular` does; one that is missing is unreadable, too."""
    data = read_regular(path, limit)
    if data is None:
        raise UnreadableError(path, "there is no such file")
    return data


def read_json(path: str | Path) -> object:
    """Content of a JSON file: :func:`read_existing`, then :func:`parse_json`."""
    return parse_json(read_existing(path), path)


def parse_json(data: bytes | str, source: str | Path, *, each_once: bool = False) -> object:
    """Content of a JSON text of at most 200 nested brackets, the limit of pydantic's parser.

    With ``each_once`` an object that names a value twice is refused; parsers keep the last one.
    """
    try:
        content = from_json(data, allow_inf_nan=False)  # twice as fast as the standard library's
    except ValueError as error:
        raise UnreadableError(source, f"is not valid JSON ({error})") from error
    if each_once:
        json.loads(data, object_pairs_hook=lambda pairs: named_once(pairs, source))
    return content


def named_once(pairs: Sequence[tuple[str, object]], source: str | Path) -> dict[str, object]:
    """Names and values of a file, each name once."""
    if len(values := dict(pairs)) < len(pairs):
        twice = next(key for key in values if [k for k, _ in pairs].count(key) > 1)
        raise UnreadableError(source, f"has several values of {twice!r}: write the one that counts")
    return values


def unzip(raw: bytes, source: str | Path, limit: int = MAX_BYTES) -> bytes:
    """Unpack gzip, and no more of it than may be there."""
    unpacked = io.BytesIO()
    try:
        with gzip.open(io.BytesIO(raw)) as stream:
            while unpacked.tell() <= limit and (part := stream.read(_CHUNK)):
                unpacked.write(part)
    except (OSError, EOFError, zlib.error) as error:
        raise UnreadableError(source, f"is a broken gzip file ({error})") from error
    if unpacked.tell() > limit:
        raise NotRegularError(source, f"unpacked, {_larger(limit)}")
    return unpacked.getvalue()


class Unpacker:
    """Stands for the modules zlib and lzma where others unpack: all parts together are limited."""

    def __init__(self, source: str | Path, limit: int = MAX_BYTES) -> None:
        self._source, self._limit, self._left = source, limit, limit

    def decompress(self, data: bytes) -> bytes:
        """Unpack a part, packed by zlib or lzma."""
        is_lzma = data[:6] == b"\xfd7zXZ\0"
        stream = lzma.LZMADecompressor(memlimit=MAX_BYTES) if is_lzma else zlib.decompressobj()
        try:
            part: bytes = stream.decompress(data, self._left + 1)
        except (zlib.error, lzma.LZMAError) as error:
            raise UnreadableError(self._source, f"is broken ({error})") from error
        self._left -= len(part)
        if self._left < 0:
            raise NotRegularError(self._source, f"unpacked, {_larger(self._limit)}")
        if not stream.eof:
            raise UnreadableError(self._source, "is broken (a part ends too early)")
        return part


def sha256_of(path: str | Path) -> str:
    """Hash of a file of at most :data:`MAX_HASHED_BYTES`; UnreadableError as for the others."""
    stream = open_regular(path, MAX_HASHED_BYTES)
    if stream is None:
        raise UnreadableError(path, "there is no such file")
    try:
        with stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise UnreadableError(path, f"cannot be read ({error.strerror or error})") from error


def _larger(limit: int) -> str:
    size = f"{limit / 1e6:g} MB" if limit >= 10**6 else f"{limit} bytes"
    return f"holds more than {size}, the limit"


# Text of a file that somebody gave: plain or gzip, of a bounded size.

_THIN_OUT = "name a file of data; a long recording is thinned out or split into several files"


def read_bytes(path: Path, source: str) -> bytes:
    """Read a file as it lies on the disk."""
    try:
        return read_existing(path, MAX_BYTES)
    except UnreadableError as error:
        mend = _THIN_OUT if isinstance(error, NotRegularError) else ""
        raise InputError(Fault(source, error.rule, mend)) from error


def unzipped(raw: bytes, source: str) -> bytes:
    """Unpack the content of a file if it is gzip."""
    if raw[:2] != b"\x1f\x8b":
        return raw
    try:
        return unzip(raw, source, MAX_BYTES)
    except UnreadableError as error:
        is_large = isinstance(error, NotRegularError)
        mend = _THIN_OUT if is_large else "copy the file again from its source"
        raise InputError(Fault(source, error.rule, mend)) from error


#: encodings that may be declared, and how Python calls them
ENCODINGS = {
    "utf-8": "utf-8-sig",
    "utf-16": "utf-16",
    "latin-1": "latin-1",
    "windows-1252": "cp1252",
    "mac-roman": "mac_roman",
}


def decoded(data: bytes, source: str, declared: str = "") -> tuple[str, str]:
    """Text of a file and its encoding: UTF-8, UTF-16 with a byte order mark, or Windows-1252.

    Instruments without UTF-8 write Windows-1252. It is taken only where no other character of the
    file is UTF-8; where some are, one damaged byte is the likelier cause. A declared encoding, one
    of :data:`ENCODINGS`, is taken without a look at the file.
    """
    encoding = "UTF-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "UTF-8"
    codec = "utf-16" if encoding == "UTF-16" else "utf-8-sig"
    for order, half in (("utf-16-le", data[1:200:2]), ("utf-16-be", data[:200:2])):
        if half and not any(half):  # ASCII in two bytes each, without the mark that says so
            encoding, codec = "UTF-16", order
    if declared:
        encoding, codec = declared, ENCODINGS[declared]
    try:
        text = data.decode(codec)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        where, rule = f"{source}:{line}", f"byte {data[error.start]:#04x} is not {encoding}"
        mend = "save the file as UTF-8"
        if b"\0" in data and encoding != "UTF-16":  # MATLAB, LabVIEW's TDMS, test machines
            where, rule = source, "is a binary file, no text"
            raise InputError(Fault(where, rule, "export the recording as CSV or text")) from error
        if declared:
            rule += ", which is declared"
            mend = "leave measurements.encoding out: it is found"
        if encoding != "UTF-8" or not data.decode("utf-8", "ignore").isascii():
            raise InputError(Fault(where, rule, mend)) from error
        try:
            text, encoding = data.decode("cp1252"), "Windows-1252"
        except UnicodeDecodeError:
            raise InputError(Fault(where, f"{rule} and not Windows-1252", mend)) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(Fault(f"{source}:{line}", "holds a NUL character: this is not a CSV file"))
    return text, encoding


# Sheets of Excel workbooks, as tab-separated text whose lines are the rows of the sheet.

_OLD_WORKBOOK = b"\xd0\xcf\x11\xe0"


def is_workbook(data: bytes) -> bool:
    """Whether the content of a file is an Excel workbook."""
    return data[:4] in (b"PK\x03\x04", _OLD_WORKBOOK)


def sheets_of(data: bytes, source: str, decimal: str = ".") -> dict[str, str]:
    """Return the filled sheets of a workbook by their names, as tab-separated text."""
    from python_calamine import CalamineError, CalamineWorkbook

    mend = "save it as .xlsx, or the sheet as CSV"
    if data[:4] == _OLD_WORKBOOK:
        raise InputError(Fault(source, "is a workbook of Excel 2003 or older", mend))
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            size = sum(member.file_size for member in packed.infolist())
        if size > MAX_BYTES:
            raise InputError(Fault(source, f"unpacked, {_larger(MAX_BYTES)}", _THIN_OUT))
        book = CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = {
            name: book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            for name in book.sheet_names
        }
    except (zipfile.BadZipFile, CalamineError, OSError, ValueError) as error:
        raise InputError(
            Fault(source, f"is no workbook that can be read ({error})", mend)
        ) from error
    return {
        name: "\n".join("\t".join(_cell_text(cell, decimal) for cell in row) for row in rows)
        for name, rows in sheets.items()
        if rows
    }


def _sheet_text(data: bytes, source: str, sheet: str, decimal: str) -> tuple[str, str]:
    """Named or only sheet as text, and what was read."""
    sheets = sheets_of(data, source, decimal)
    if not sheets:
        raise InputError(Fault(source, "holds no filled sheet"))
    longest = max(sheets, key=lambda name: len(sheets[name]))
    if sheet and sheet not in sheets:
        rule = f"has no filled sheet {sheet!r}"
        raise InputError(Fault(source, rule, nearest(sheet, sheets)))
    if not sheet and len(sheets) > 1:
        rule = f"holds several sheets: {', '.join(map(repr, list(sheets)[:20]))}"
        mend = (
            f"write sheet = {longest!r} in [measurements], --sheet {longest!r} with analyze and "
            "inspect, or save the sheet as CSV"
        )
        raise InputError(Fault(source, rule, mend))
    name = sheet or longest
    return sheets[name], f"workbook, sheet {name!r}"


def _cell_text(cell: object, decimal: str) -> str:
    if isinstance(cell, float):
        return repr(cell).removesuffix(".0").replace(".", decimal)
    text = " ".join(str(cell).split())
    return f'"{text.replace(chr(34), chr(34) * 2)}"' if '"' in text else text


def table_text(
    raw: bytes, source: str, *, encoding: str = "", sheet: str = "", decimal: str = "."
) -> tuple[str, str]:
    """Text of a table, plain or gzip, or of a sheet of a workbook; and how it was read."""
    data = unzipped(raw, source)
    if is_workbook(data):
        return _sheet_text(data, source, sheet, decimal)
    if sheet:
        raise InputError(Fault(source, "is no workbook, so it has no sheets", "leave sheet out"))
    return decoded(data, source, encoding)


# Places in a results folder, none of which a link leads out of it.
ID = re.compile(r"[a-z0-9][a-z0-9-]{0,79}")
#: where a link in a results folder must not lead
OUTSIDE = "the results folder; remove it"


def own_folder(root: Path, name: str) -> Path:
    """Folder of a study or a report below the one that the user named; it is not made."""
    outside = f"{root}, where nothing is written; remove the link, or name another folder"
    return inside(root, Path(name).parts, outside)


def inside(root: Path, below: Sequence[str], outside: str) -> Path:
    """Place below a folder; refuse one that a link leads out of it."""
    places, nested = [], str(root)
    for part in below:
        nested = os.path.join(nested, part)
        places.append(nested)
    path = Path(nested)
    if not any(map(os.path.islink, places)):
        return path
    try:
        is_inside = path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise StoreError(f"{path}: cannot be used ({error})") from error
    if not is_inside:
        raise StoreError(f"{path}: a link leads outside {outside}")
    return path


TEMPORARY = ".part"
#: files that are flushed one by one; more of them together with their whole file system
_FEW = 4
#: what the system says of a disk that takes no more: no space, quota, size of a file, broken disk
FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


class FileSystem:
    """The operations that change the disk; tests replace it to crash at each of them."""

    def make_folder(self, path: Path) -> None:
        """Make a folder and those above it."""
        path.mkdir(parents=True, exist_ok=True)

    def write(self, path: Path, data: bytes) -> None:
        """Write a new file; what was left there, a link too, is not written through."""
        path.unlink(missing_ok=True)
        with open(path, "xb") as stream:
            stream.write(data)

    def sync(self, paths: Sequence[Path]) -> None:
        """Flush files, and the names in folders, to the disk."""
        if len(paths) > _FEW and _sync_all_of(paths[0]):
            return
        for path in paths:
            _sync(path, os.fsync)

    def replace(self, source: Path, target: Path) -> None:
        """Rename, atomically, over whatever stands there."""
        os.replace(source, target)

    def unlink(self, path: Path) -> None:
        """Delete a file."""
        path.unlink(missing_ok=True)


def _sync(path: Path, call: Callable[[int], object]) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        call(handle)
    finally:
        os.close(handle)


def _sync_all_of(path: Path) -> bool:
    """Flush the file system that a path lies on with syncfs(2); False where there is none."""
    # Linux tells of a failed write here since 5.8; 64 files take a quarter of the time of fsync.
    if sys.platform != "linux":
        return False
    release = os.uname().release.split(".")[:2]
    if [int(part) for part in release if part.isdigit()] < [5, 8]:
        return False
    import ctypes

    library = ctypes.CDLL(None, use_errno=True)

    def call(handle: int) -> None:
        if library.syncfs(handle):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(path))

    _sync(path, call)
    return True


def is_special(path: Path) -> bool:
    """Whether a device, a pipe or a socket stands there, which a new file would destroy."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _part_of(path: Path) -> Path:
    """Name beside a file under which its new content is written."""
    if is_special(path):
        raise WriteError(f"{path}: is a device or a pipe, which stays as it is. Name a file")
    return path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")


class Batch:
    """Files that become those of their names together, once all of them lie on the disk."""

    def __init__(self, system: FileSystem) -> None:
        self._system = system
        self._parts: dict[Path, Path] = {}
        self._folders: dict[Path, None] = {}
        self._then: list[Callable[[], None]] = []

    def add(self, path: Path, data: bytes, then: Callable[[], None] | None = None) -> None:
        """Write a file beside its place; ``then`` is called once it is there."""
        part = _part_of(path)
        with self._discarding([path]):  # the others are whole, and stay
            self._parts[path] = part
            if not path.parent.is_dir():
                new = [folder for folder in path.parents if not folder.exists()]
                if new:
                    self._system.make_folder(path.parent)
                # to be flushed for their names to survive a power loss too
                self._folders |= dict.fromkeys(folder.parent for folder in reversed(new))
            self._system.write(part, data)
        if then is not None:
            self._then.append(then)

    def finish(self, *, flush: bool = True) -> None:
        """Put every file in its place: after a crash the old content is there, or the new."""
        then, self._then = self._then, []
        if not self._parts:
            return
        with self._discarding(list(self._parts)):
            if flush:
                self._system.sync(list(self._parts.values()))
            for path in list(self._parts):
                # a link that stands there is replaced, not followed
                self._system.replace(self._parts[path], path)
                del self._parts[path]
                self._folders[path.parent] = None
            if flush:
                self._system.sync(list(self._folders))
        self._folders = {}
        for call in then:
            call()

    @contextmanager
    def _discarding(self, paths: Sequence[Path]) -> Iterator[None]:
        """Context that leaves no part of some files behind when it is not gone through."""
        try:
            yield
        except (OSError, KeyboardInterrupt) as error:
            for path in paths:
                if path in self._parts:
                    _discard(self._parts.pop(path), self._system)
            if isinstance(error, OSError):
                raise write_error(paths[0], error) from error
            raise


def write_atomic(
    path: Path, data: bytes, system: FileSystem | None = None, *, flush: bool = True
) -> None:
    """Write ``data`` to ``path`` so that a crash leaves the old content or the new."""
    batch = Batch(system or FileSystem())
    batch.add(path, data)
    batch.finish(flush=flush)


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Name beside ``path`` for a writer that takes names alone; renamed when all is well."""
    part = _part_of(path)
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_new(path: Path, text: str) -> None:
    """Write a file where there is none, whole or not at all."""
    with open(path, "x", encoding="utf-8"):
        pass
    try:
        write_atomic(path, text.encode())
    except BaseException:
        _discard(path, FileSystem())
        raise


def write_error(path: str | Path, error: OSError) -> WriteError:
    """Error of a file that could not be written, by what the system says of it."""
    text = f"{path}: could not be written ({error.strerror or error}); what was there before is "
    if error.errno in FULL:
        return DiskFullError(f"{text}unharmed. Free space, then run again")
    return WriteError(f"{text}unharmed. Choose another folder, or mend this one, then run again")


def is_leftover(name: str) -> bool:
    """Whether the name of a file is of those that an interrupted write leaves behind."""
    return name.startswith(".") and name.endswith(TEMPORARY)


def _discard(part: Path, system: FileSystem) -> None:
    try:
        system.unlink(part)
    except OSError:
        return  # the disk refuses even this; the next run clears the leftover


# One runner per results folder: a lock of the operating system on an open file (filelock: flock, on
# Windows LockFileEx), which dies with its owner. NFS carries it to other machines where the server
# locks files; other network file systems may hold it on one machine only.

LOCK_NAME = ".lock"
#: times that a lock is tried for, and seconds between them
_GLANCES = 5
_GLANCE_S = 0.01
#: what the lock file says of its owner, and the bytes that this and its progress take
_OWNER = ("pid", "host", "since")
_LENGTH = 512
#: Windows locks the first byte for reading, too: what the file says begins behind it
_BEGIN = 1
#: neither a link is followed nor a pipe waited for, where there are any
_AS_IT_LIES = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Hold the lock of a results folder, or say who holds it."""
    path = folder / LOCK_NAME
    with contextlib.ExitStack() as held:
        try:
            handle = held.enter_context(_opened(path, os.O_RDWR | os.O_CREAT))
        except OSError as error:
            raise StoreError(f"{path}: cannot be written ({error.strerror or error})") from error
        try:
            taken = _take(handle)
        except OSError as error:
            raise StoreError(
                f"{path}: this file system cannot lock files ({error.strerror or error}); keep "
                "results on a local disk"
            ) from error
        if not taken:
            owner = _read(handle)
            who = "another runner"
            if owner:
                who = "pid {} on host {} since {}".format(*(owner.get(key) for key in _OWNER))
            raise StoreError(f"{folder}: locked by {who}; wait for it or stop it")
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        _write(handle, dict(zip(_OWNER, (os.getpid(), socket.gethostname(), now), strict=True)))
        yield


@contextmanager
def _opened(path: Path, flags: int) -> Iterator[int]:
    """Context with the lock file open, and nothing else in its place; its end frees the lock."""
    handle = os.open(path, flags | _AS_IT_LIES, 0o644)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise OSError("it is no file; remove it")
        yield handle
    finally:
        os.close(handle)


def _take(handle: int) -> bool:
    """Take the lock if it is free; one who only looks whether it is has it for microseconds."""
    from filelock import lock_descriptor

    for _ in range(_GLANCES):
        if lock_descriptor(handle, blocking=False):
            return True
        time.sleep(_GLANCE_S)
    return False


def holder(folder: Path) -> dict[str, object] | None:
    """Read what the runner at work in a folder says of itself; None where there is none."""
    path = folder / LOCK_NAME
    # NFS locks for those alone who may write
    flags = os.O_RDWR if os.access(path, os.W_OK) else os.O_RDONLY
    with contextlib.suppress(OSError), _opened(path, flags) as handle:
        return None if _take(handle) else _read(handle)
    return None


def sign(folder: Path, progress: Mapping[str, object]) -> None:
    """Add progress to what the owner of the lock says of itself, on which nobody depends."""
    with contextlib.suppress(OSError), _opened(folder / LOCK_NAME, os.O_RDWR) as handle:
        owner = {name: value for name, value in _read(handle).items() if name in _OWNER}
        _write(handle, owner | dict(progress))


def _read(handle: int) -> dict[str, object]:
    """Read what the file says of the owner of the lock; nothing where that is damaged."""
    try:
        os.lseek(handle, _BEGIN, os.SEEK_SET)
        content = parse_json(os.read(handle, 4096), LOCK_NAME)
    except (OSError, StoreError):
        return {}
    return content if isinstance(content, dict) else {}


def _write(handle: int, facts: Mapping[str, object]) -> None:
    """Replace what the file says in one write: blanks cover what was there before."""
    text = json.dumps(facts).encode().ljust(_LENGTH)
    # on a full disk the lock holds all the same, it only cannot name its owner
    with contextlib.suppress(OSError):
        os.lseek(handle, _BEGIN, os.SEEK_SET)
        os.write(handle, text)
        os.ftruncate(handle, _BEGIN + len(text))
