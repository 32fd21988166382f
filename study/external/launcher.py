"""A process between a case and its program, which ends with all that the program started.

Run by its path, with nothing but the standard library::

    python -I -S launcher.py LIFELINE STATUS FILE_BYTES PROGRAM WORD ...

The program gets a session of its own. Processes that it leaves behind, in another session too, are
handed to this one where the system has subreapers (Linux, prctl(2)), and are killed when the
program ends or LIFELINE, a pipe, closes: on a time limit, on Ctrl-C, and when the process that
runs the case is killed. STATUS receives the return code once nothing is left.
"""

from __future__ import annotations

import contextlib
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Iterator

#: of linux/prctl.h: what a parent leaves behind is handed to this process, PR_SET_CHILD_SUBREAPER;
#: and the signal that this process gets when its parent ends, PR_SET_PDEATHSIG
_SUBREAPER = 36
_PARENT_DEATH = 1
#: seconds in which processes that cannot be killed are waited for
_PATIENCE_S = 10.0


def main(lifeline: int, status: int, file_bytes: int, argv: list[str]) -> None:
    """Run a program to its end, or to that of the lifeline."""
    for pipe in (lifeline, status):
        os.set_inheritable(pipe, False)
    _control(_SUBREAPER, 1)
    ended, noted = os.pipe()
    os.set_blocking(noted, False)
    signal.set_wakeup_fd(noted, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    program = os.fork()
    if not program:
        _become(argv, file_bytes)
    code = None
    while code is None:
        ready, _, _ = select.select([lifeline, ended], [], [])
        if lifeline in ready:
            break
        os.read(ended, 4096)
        code = dict(_reaped()).get(program)
    _end_all(program)
    if code is not None:
        with contextlib.suppress(BrokenPipeError):  # whoever waited for it has gone
            os.write(status, str(code).encode())


def _become(argv: list[str], file_bytes: int) -> None:
    """Be the program, in a session of its own; 127 where it cannot be run, as shells have it."""
    try:
        os.setsid()
        _control(_PARENT_DEATH, signal.SIGKILL)
        for number in (signal.SIGCHLD, signal.SIGPIPE, signal.SIGXFSZ, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL)
        for kind, limit in ((resource.RLIMIT_FSIZE, file_bytes), (resource.RLIMIT_CORE, 0)):
            hard = resource.getrlimit(kind)[1]
            least = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
            resource.setrlimit(kind, (least, least))
        os.execv(argv[0], argv)
    except OSError as error:
        os.write(2, f"{argv[0]}: cannot be run ({error.strerror})\n".encode())
    finally:
        os._exit(127)


def _control(option: int, value: int) -> None:
    """Set an attribute of this process with prctl(2), where the system has it."""
    with contextlib.suppress(ImportError, OSError, AttributeError):
        import ctypes

        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _reaped() -> Iterator[tuple[int, int]]:
    """Process ids and return codes of the children that have ended."""
    with contextlib.suppress(ChildProcessError):
        while True:
            pid, how = os.waitpid(-1, os.WNOHANG)
            if not pid:
                return
            yield pid, os.waitstatus_to_exitcode(how)


def _end_all(program: int) -> None:
    """Kill the session of the program and whatever was handed to this process, until none is."""
    until = time.monotonic() + _PATIENCE_S
    groups = {program}
    while True:
        for group in groups:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(group, signal.SIGKILL)
        for _ in _reaped():
            pass
        children = list(_children())
        groups = {group for _, group in children} - {os.getpgrp()}
        for pid, _ in children:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        if not children or time.monotonic() > until:
            return
        time.sleep(0.005)


def _children() -> Iterator[tuple[int, int]]:
    """Process id and group of every child of this process; Linux alone tells."""
    names = os.listdir("/proc") if os.path.isdir("/proc/self") else []
    for name in filter(str.isdecimal, names):
        with contextlib.suppress(OSError), open(f"/proc/{name}/stat", "rb") as stream:
            _, parent, group, *_ = stream.read(4096).rpartition(b")")[2].split()
            if int(parent) == os.getpid():
                yield int(name), int(group)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
