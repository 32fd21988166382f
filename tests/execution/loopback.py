"""A Dask cluster on the loopback device, as processes that a test can kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.waiting import until

ROOT = Path(__file__).parents[2]
#: of a cluster that a test starts nobody looks at the profile, for which each of its processes
#: wakes up 100 times a second
QUIET = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}


def children(pid):
    """Command line of every process that one has started, by any of its threads."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    places = {int(child): Path(f"/proc/{child}/cmdline") for path in lists
              for child in path.read_text().split()}  # fmt: skip
    return {child: path.read_text() for child, path in places.items() if path.exists()}


@dataclass
class Loopback:
    """A scheduler and its workers."""

    folder: Path
    tls: Sequence[str] = ()
    threads: int = 1
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def file(self):
        return self.folder / "scheduler.json"

    @property
    def scheduler(self):
        return self.processes[0]

    @property
    def workers(self):
        return self.processes[1:]

    def start_scheduler(self):
        protocol = "tls" if self.tls else "tcp"
        self._start(
            "dask_scheduler", "--host", f"{protocol}://127.0.0.1", "--port", "0",
            "--scheduler-file", str(self.file), "--no-dashboard", "--no-show", *self.tls,
        )  # fmt: skip
        until(self.file.is_file)

    def start_worker(self, shadow="", nanny=False):
        return self._start(
            "dask_worker", "--scheduler-file", str(self.file), "--nthreads", str(self.threads),
            "--memory-limit", "0", "--no-dashboard", "--nanny" if nanny else "--no-nanny",
            "--death-timeout", "60",
            "--local-directory", str(self.folder), *self.tls, shadow=shadow,
        )  # fmt: skip

    def _start(self, what, *options, shadow=""):
        path = os.pathsep.join(p for p in (shadow, str(ROOT), os.environ.get("PYTHONPATH")) if p)
        log = (self.folder / f"{what}-{len(self.processes)}.log").open("wb")
        with log:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{what}", *options],
                stdout=log, stderr=log, cwd=self.folder,
                env={**os.environ, **QUIET, "PYTHONPATH": path},
                start_new_session=True,
            )  # fmt: skip
        self.processes.append(process)
        return process

    def log(self, number):
        (found,) = self.folder.glob(f"*-{number}.log")
        return found.read_text()

    def stop(self):
        for process in self.processes[::-1]:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextmanager
def loopback(folder, workers=2, **options):
    """Start a scheduler and some workers; kill them in the end."""
    made = Loopback(folder, **options)
    try:
        made.start_scheduler()
        for _ in range(workers):
            made.start_worker()
        yield made
    finally:
        made.stop()
