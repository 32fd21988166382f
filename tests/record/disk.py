"""A disk that fails at the k-th operation: cleanly (full) or by losing power."""

from __future__ import annotations

import errno
from pathlib import Path

from study.ground.files import FileSystem


class PowerLoss(BaseException):
    """The process is gone: no handler of the program may run."""


class FailingDisk(FileSystem):
    """Counts operations; the k-th fails.

    ``power_loss=False`` raises ENOSPC once and goes on (a disk that was full for a moment).
    ``power_loss=True`` ends the process, and what was never flushed is gone: files without
    fsync lose their second half, renames in a folder without fsync are undone.
    """

    def __init__(self, fail_at=0, power_loss=False):
        self.fail_at, self.power_loss = fail_at, power_loss
        self.count = 0
        self.unsynced: set[Path] = set()
        self.renames: list[tuple[Path, bytes | None]] = []

    def make_folder(self, path):
        self._tick()
        super().make_folder(path)

    def write(self, path, data):
        if self._due():
            path.write_bytes(data[: len(data) // 2])  # a torn write
        self._tick()
        super().write(path, data)
        self.unsynced.add(path)

    def sync(self, paths):
        for path in paths:
            self._tick()
            self.unsynced.discard(path)
            self.renames = [(t, old) for t, old in self.renames if t.parent != path]

    def replace(self, source, target):
        self._tick()
        self.renames.append((target, target.read_bytes() if target.exists() else None))
        super().replace(source, target)
        if source in self.unsynced:
            self.unsynced.remove(source)
            self.unsynced.add(target)

    def unlink(self, path):
        self._tick()
        super().unlink(path)

    def _due(self):
        return self.count + 1 == self.fail_at

    def _tick(self):
        due = self._due()
        self.count += 1
        if not due:
            return
        if not self.power_loss:
            raise OSError(errno.ENOSPC, "No space left on device")
        for path in self.unsynced:
            if path.exists():
                path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        for target, old in reversed(self.renames):
            if old is None:
                target.unlink(missing_ok=True)
            else:
                target.write_bytes(old)
        raise PowerLoss
