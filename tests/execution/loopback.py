"""A Dask cluster on the loopback device, as processes that a test can kill."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests.waiting import until

ROOT = Path(__file__).parents[2]
#: of a cluster that a test starts nobody looks at the profile, for which each of its processes
#: wakes up 100 times a second
QUIET = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
#: has Dask imported, and starts the processes of clusters by a fork: each would take .6 s for it
STARTER = multiprocessing.get_context("forkserver")
STARTER.set_forkserver_preload(["distributed.cli.dask_scheduler", "distributed.cli.dask_worker"])


def become(what, options, log, folder, environment, shadow):
    """Be what ``python -m distributed.cli.WHAT`` is, a session and a log of its own."""
    os.setsid()
    os.chdir(folder)
    with log.open("ab") as stream:
        for output in (1, 2):
            os.dup2(stream.fileno(), output)
    os.environ.update(environment)
    importlib.import_module("dask.config").refresh()
    if shadow:
        sys.path.insert(0, shadow)
    sys.argv = [what, *options]
    importlib.import_module(f"distributed.cli.{what}").main()


def children(pid):
    """Command line of every process that one has started, by any of its threads."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    places = {int(child): Path(f"/proc/{child}/cmdline") for path in lists
              for child in path.read_text().split()}  # fmt: skip
    return {child: path.read_text() for child, path in places.items() if path.exists()}


class Fresh(subprocess.Popen):
    """A process of an interpreter of its own, asked as those that were forked."""

    def is_alive(self):
        return self.poll() is None

    def join(self, timeout=None):
        self.wait(timeout)


@dataclass
class Loopback:
    """A scheduler and its workers."""

    folder: Path
    tls: Sequence[str] = ()
    threads: int = 1
    #: whether each process is an interpreter that has imported nothing yet
    is_fresh: bool = False
    processes: list[multiprocessing.Process | Fresh] = field(default_factory=list)

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
        log = self.folder / f"{what}-{len(self.processes)}.log"
        environment = {**os.environ, **QUIET, "PYTHONPATH": path}
        if self.is_fresh:
            with log.open("wb") as stream:
                process = Fresh(
                    [sys.executable, "-m", f"distributed.cli.{what}", *options],
                    stdout=stream, stderr=stream, cwd=self.folder, env=environment,
                    start_new_session=True,
                )  # fmt: skip
        else:
            log.touch()
            given = what, options, log, self.folder, environment, shadow
            process = STARTER.Process(target=become, args=given)
            process.start()
        self.processes.append(process)
        return process

    def log(self, number):
        (found,) = self.folder.glob(f"*-{number}.log")
        return found.read_text()

    def stop(self):
        for process in self.processes[::-1]:
            if process.is_alive():
                with suppress(ProcessLookupError):  # it is not the first of its session yet
                    os.killpg(process.pid, signal.SIGKILL)
                process.kill()
            process.join()


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
