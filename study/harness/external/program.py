"""One run of a program: supervised, within limits of time, output and disk, with nothing left.

The output comes through a pipe and never lies in the folder, where the program could put something
else in its place. :mod:`study.harness.external.launcher` ends whatever the program started.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

#: characters of the output of a program that its record keeps, and that numbers are looked for in
TAIL = 4000
LOG = 64_000
#: bytes that a program may say, and that its folder may hold on the disk
OUTPUT_BYTES = 256_000_000
FOLDER_BYTES = 4_000_000_000
#: files and folders that its folder may hold
FOLDER_ENTRIES = 100_000

_LAUNCHER = Path(__file__).with_name("launcher.py")
#: seconds between two looks at the folder, at least; and in which a launcher ends
_LOOK_S = 0.25
_LAUNCHER_S = 15.0


@dataclass(frozen=True)
class Ended:
    """How a program ended."""

    #: Return code, negative for a signal; None where it was ended.
    code: int | None
    output: str = ""
    #: Its first ones, of which there may be fewer.
    beginning: str = ""
    #: More of the last ones.
    log: str = ""
    #: Which limit but that of time it was ended for; empty for none.
    excess: str = ""


@contextmanager
def fresh_folder() -> Iterator[Path]:
    """Folder for one case, removed whatever a program made of it."""
    home = Path(tempfile.mkdtemp(prefix="study-case-"))
    folder = home / "case"
    folder.mkdir()
    try:
        yield folder
    finally:
        _remove(home)


def run(
    argv: Sequence[str],
    folder: Path,
    until: float | None = None,
    output_bytes: int = OUTPUT_BYTES,
    environment: Mapping[str, str] | None = None,
) -> Ended:
    """Run a program in a folder, and end all that it started with it."""
    lifeline, held = os.pipe()
    answer, status = os.pipe()
    said, output = os.pipe()
    process = None
    try:
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(_LAUNCHER), str(lifeline), str(status),
             str(FOLDER_BYTES), *argv],
            cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=output,
            pass_fds=(lifeline, status), start_new_session=True,
        )  # fmt: skip
        for end in (lifeline, status, output):
            os.close(end)
        lifeline = status = output = -1
        return _watched(folder, answer, said, until, output_bytes)
    except OSError as error:  # of a folder that is gone, or more words than the system takes
        return Ended(None, excess=f"it could not be run ({error.strerror})")
    finally:
        for end in (held, answer, said, lifeline, status, output):
            if end >= 0:
                os.close(end)
        if process is not None:  # it ends all, for its lifeline is closed
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_LAUNCHER_S)
            process.kill()
            process.wait()


def _watched(folder: Path, answer: int, said: int, until: float | None, output_bytes: int) -> Ended:
    """Follow a program by its two pipes until it ends, or comes to a limit."""
    head, tail, size, code, excess = b"", b"", 0, b"", ""
    look = time.monotonic() + _LOOK_S
    pipes = [answer, said]
    while not excess:
        now = time.monotonic()
        if until is not None and now >= until:
            break
        if now >= look:
            excess = _excess_of(folder)
            look = time.monotonic() + max(_LOOK_S, 10 * (time.monotonic() - now))
        wait = look if until is None else min(look, until)
        ready, _, _ = select.select(pipes, [], [], max(wait - time.monotonic(), 0.0))
        if said in ready:
            part = os.read(said, 1 << 16)
            head = head + part if len(head) < TAIL else head
            tail, size = (tail + part)[-4 * LOG :], size + len(part)
            if not part:
                pipes.remove(said)
            if size > output_bytes:
                excess = f"it said more than {output_bytes / 1e6:g} MB"
        elif answer in ready:
            code = os.read(answer, 64)
            excess = "" if code else "the process that supervised it was killed"
            break
    first, last = head.decode(errors="replace"), tail.decode(errors="replace")
    ended = int(code) if code else None
    return Ended(ended, last[-TAIL:], first[:TAIL], last[-LOG:], excess)


def _excess_of(folder: Path) -> str:
    """Which limit what lies in a folder is beyond; empty for none."""
    size = entries = 0
    waiting = [str(folder)]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as inside:
                for entry in inside:
                    entries += 1
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(entry.path)
                    with contextlib.suppress(FileNotFoundError):
                        size += 512 * entry.stat(follow_symlinks=False).st_blocks
                    if size > FOLDER_BYTES:
                        return f"its folder holds more than {FOLDER_BYTES / 1e9:g} GB"
                    if entries > FOLDER_ENTRIES:
                        return f"its folder holds more than {FOLDER_ENTRIES} files"
        except (FileNotFoundError, NotADirectoryError):
            continue  # it was there a moment ago
        except OSError as error:
            return f"its folder holds a folder that cannot be read ({error.strerror})"
    return ""


def _remove(home: Path) -> None:
    """Remove a folder of any depth: folders in it are moved to its top before they are emptied."""
    # ``shutil.rmtree`` calls itself for every level, and ends in a RecursionError at a thousand.
    waiting = [home]
    while waiting:
        path = waiting.pop()
        with contextlib.suppress(OSError), os.scandir(path) as inside:
            for entry in list(inside):
                with contextlib.suppress(OSError):
                    if entry.is_dir(follow_symlinks=False):
                        os.chmod(entry.path, 0o700)
                        top = home / uuid.uuid4().hex
                        os.rename(entry.path, top)
                        waiting.append(top)
                    else:
                        os.unlink(entry.path)
        if path != home:
            with contextlib.suppress(OSError):
                os.rmdir(path)
    with contextlib.suppress(OSError):
        os.rmdir(home)
