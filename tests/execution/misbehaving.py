"""Tasks that misbehave on demand, to see what the executor makes of them."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from threading import Timer

from study.execution.local import Task
from tests.execution.loopback import ROOT
from tests.waiting import CAP_S


def perform(task):
    kind = task["kind"]
    if kind == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "die once" and not Path(task["mark"]).exists():
        Path(task["mark"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "hang":
        if "mark" in task:
            with Path(task["mark"]).open("a") as stream:
                stream.write("begun\n")
        time.sleep(CAP_S)
    if kind == "exit":
        os._exit(3)
    if kind == "raise":
        raise ZeroDivisionError("a bug")
    if kind == "nan":
        return {"status": "converged", "value": float("nan")}
    if kind == "not plain":
        return {"status": "converged", "value": object()}
    if kind == "memory":
        raise MemoryError
    if kind == "hold the interpreter":
        re.match(r"(a+)+$", "a" * 40 + "b")  # one call into C that lasts for hours
    if kind == "stopped":
        os.kill(os.getpid(), signal.SIGSTOP)  # its answer never leaves the pipe
    if kind == "stop soon":  # after its answer: it reads nothing more
        Timer(0.2, os.kill, (os.getpid(), signal.SIGSTOP)).start()
        return {"status": "converged", "process": os.getpid()}
    if kind == "print":
        print("noise on stdout", flush=True)
        os.write(1, b"noise of a library\n")
    if kind == "threads":
        return {"status": "converged", "threads": os.environ["OMP_NUM_THREADS"]}
    if kind == "read":
        return {"status": "converged", "path": task["path"], "text": Path(task["path"]).read_text()}
    if kind == "process":
        time.sleep(0.05)
        return {"status": "converged", "process": os.getpid()}
    return {"status": "converged", "value": task.get("value", 0) + 1}


def task(key, kind="work", needs=(), **values):
    return Task(key, lambda results: {"kind": kind, **values}, needs)


def never_up(_parent):
    """Stop a worker before it can say that it is there."""
    os.kill(os.getpid(), signal.SIGSTOP)


#: a study of two tasks that say their process and two that hang, here or on a scheduler's workers
LEFT = """
import signal, sys
from study.execution.cluster import Cluster
from study.execution.local import Loky
from study.execution.local import Task
from tests.execution.misbehaving import perform
tasks = [Task(k, lambda _: {"kind": "process"}) for k in "ab"]
tasks += [Task(k, lambda _: {"kind": "hang"}) for k in "cd"]
# a shell that starts a test in the background has it ignore Ctrl-C
signal.signal(signal.SIGINT, signal.default_int_handler)
for outcome in (Cluster(perform, *sys.argv[1:]) if sys.argv[1:] else Loky(perform, 2)).run(tasks):
    print(outcome.result["process"], flush=True)
"""


@contextmanager
def study_left(*scheduler):
    """Process of such a study, killed at the end."""
    path = os.pathsep.join([str(ROOT), *sys.path])
    owner = subprocess.Popen(
        [sys.executable, "-c", LEFT, *scheduler], cwd=ROOT, stdout=subprocess.PIPE, text=True,
        stderr=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    with owner:
        try:
            yield owner
        finally:
            owner.kill()


def line_of(owner):
    """Next line that a process says."""
    assert owner.stdout is not None
    return owner.stdout.readline()
