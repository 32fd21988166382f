"""One folder for caches that are run as code: the user's, with rights for nobody else."""

from __future__ import annotations

import functools
import multiprocessing
import os
import stat
import sys
from pathlib import Path

#: owner of files whose owner a container does not know
_UNMAPPED = 65534


@functools.cache
def private_folder() -> Path | None:
    """Folder of this user for caches of this package; None where there is none to be trusted.

    It is ``study`` in XDG_CACHE_HOME or ``~/.cache``; where neither can be written, or others
    could write there, one in the folder for temporary files.
    """
    for place in _places():
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.mkdir(mode=0o700, exist_ok=True)
            fault = fault_of(place)
        except OSError:  # a home that cannot be written
            continue
        if fault is None and os.access(place, os.W_OK | os.X_OK):
            return place
        if fault is not None and multiprocessing.current_process().name == "MainProcess":
            print(f"warning: the cache {place} is not used: {fault}", file=sys.stderr)
    return None


def _places() -> list[Path]:
    """Where the folder may be; a relative path, which would name the working folder, is none."""
    cache = os.environ.get("XDG_CACHE_HOME", "")
    home = os.path.expanduser(os.path.join("~", ".cache"))
    temporary = os.environ.get("TMPDIR", "")
    return [
        Path(cache if os.path.isabs(cache) else home, "study"),
        Path(temporary if os.path.isabs(temporary) else "/tmp", f"study-{os.geteuid()}"),
    ]


def fault_of(place: Path) -> str | None:
    """Say what lets others put files into a folder, and how to mend it; None if nothing does.

    Parameters
    ----------
    place : Path
        Of the folder. Whoever can write one of the folders above it, or the folder that a link
        leads to, can put another one in its place.
    """
    real = place.resolve()
    for path in dict.fromkeys([place, real, *place.absolute().parents, *real.parents]):
        status = path.lstat()
        is_leaf, is_link = path in (place, real), stat.S_ISLNK(status.st_mode)
        trusted = {os.geteuid()} if is_leaf else {os.geteuid(), 0, _UNMAPPED}
        if status.st_uid not in trusted:
            return f"{path} belongs to another user\n    {_mend(place, path)}"
        others = 0o077 if is_leaf else 0o002 if status.st_gid == os.getgid() else 0o022
        is_sticky = not is_leaf and status.st_mode & stat.S_ISVTX
        if status.st_mode & others and not is_link and not is_sticky:
            mode = stat.S_IMODE(status.st_mode)
            return f"others have rights in {path} (mode {mode:o})\n    {_mend(place, path)}"
    return None


def _mend(place: Path, path: Path) -> str:
    if path in (place, place.resolve()):
        return f"remove it, it is made again: rm -r {path}"
    return f"chmod go-w {path}, or name another folder: XDG_CACHE_HOME=/a/folder/of/yours"
