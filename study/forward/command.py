"""Programs as forward models: a fresh folder, files in, no shell, a time limit, files out."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from study.arrays import Array
from study.forward import exchange
from study.forward.exchange import Answer, NoAnswer
from study.setup.setup import Problem
from study.working_folder import environment

#: characters of the output of a program that its record keeps
TAIL = 4000

#: word that stands for the interpreter that runs this package
PYTHON = "python"

#: seconds that a program may take to say its version
_VERSION_S = 20.0


class StepDocument(TypedDict):
    """One command of a solution, for the record."""

    argv: list[str]
    code: int | None
    output: str


class ProgramDocument(TypedDict):
    """What ran, for the record."""

    version: str
    digest: str
    steps: list[StepDocument]


@dataclass(frozen=True)
class Command:
    """Commands that make one solution.

    Parameters
    ----------
    argv : tuple of tuple of str
        Run one after the other.
    contents : mapping of str to str
        Name and text of every file that they find in their folder.
    version : tuple of str
        Command that says the version of the program; may be empty.
    success, failure : str
        Text that one of the commands must say, and text that none may say.
    digest : str
        Name of commands, files and programs by their content.
    timeout_s : float or None
        Wall-clock limit of the solution.
    """

    argv: tuple[tuple[str, ...], ...]
    contents: Mapping[str, str]
    version: tuple[str, ...] = ()
    success: str = ""
    failure: str = ""
    digest: str = ""
    timeout_s: float | None = None


def solve(
    command: Command, problem: Problem, displacement_mm: Array
) -> tuple[Answer, ProgramDocument]:
    """Run the commands for one problem.

    Parameters
    ----------
    command : Command
        That the user allowed; nothing is asked here.
    problem : Problem
        What is simulated.
    displacement_mm : ndarray, shape (n,)
        Where the force is wanted.

    Returns
    -------
    Answer, ProgramDocument
        The curve, and what ran.

    Raises
    ------
    NoAnswer
        If a program is missing, fails, takes too long, or writes no whole curve.
    """
    document: ProgramDocument = {
        "version": said_version(command.version, command.contents),
        "digest": command.digest,
        "steps": [],
    }
    limit = None if command.timeout_s is None else time.monotonic() + command.timeout_s
    with tempfile.TemporaryDirectory(prefix="study-case-") as name:
        folder = Path(name)
        wanted = json.dumps(exchange.request(problem, displacement_mm), indent=1)
        _write(folder, {**command.contents, exchange.PROBLEM_FILE: wanted})
        for argv in command.argv:
            document["steps"].append(_step(argv, folder, command, limit))
            _check(document["steps"][-1], command)
        _check_success(document["steps"], command)
        return exchange.answer(_written(folder), displacement_mm), document


def program(word: str) -> str | None:
    """Path of a program on this machine; None where there is none.

    Parameters
    ----------
    word : str
        First word of a command: a name on the PATH or a path; ``"python"`` is the interpreter that
        runs this package.
    """
    return sys.executable if word == PYTHON else shutil.which(word)


def said_version(argv: tuple[str, ...], contents: Mapping[str, str]) -> str:
    """First line that a program says of itself, whatever its return code; ``ccx -v`` gives 201.

    Parameters
    ----------
    argv : tuple of str
        Command that asks for the version, ended after 20 s; may be empty.
    contents : mapping of str to str
        Name and text of every file that it finds in its folder, as the solution does.

    Returns
    -------
    str
        At most 200 characters; empty without a command or a program, or where it says nothing.
    """
    path = program(argv[0]) if argv else None
    if path is None:
        return ""
    with (
        contextlib.suppress(OSError, subprocess.TimeoutExpired),
        tempfile.TemporaryDirectory(prefix="study-version-") as name,
    ):
        _write(Path(name), contents)
        found = subprocess.run(
            [path, *argv[1:]], cwd=name, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, timeout=_VERSION_S, check=False,
            env=_environment(argv, contents),
        )  # fmt: skip
        lines = found.stdout.decode(errors="replace").splitlines()
        return next((line.strip()[:200] for line in lines if line.strip()), "")
    return ""


def _environment(argv: tuple[str, ...], contents: Mapping[str, str]) -> dict[str, str]:
    """Environment of a program; Python imports from its folder where it runs a file of the user."""
    runs_user_file = any(os.path.normpath(word) in contents for word in argv[1:])
    return environment(is_safe=argv[0] == PYTHON and not runs_user_file)


def _write(folder: Path, contents: Mapping[str, str]) -> None:
    for file, text in contents.items():
        (folder / file).write_text(text, encoding="utf-8")


def _step(
    argv: tuple[str, ...], folder: Path, command: Command, limit: float | None
) -> StepDocument:
    path = program(argv[0])
    if path is None:
        raise NoAnswer("failed", f"{argv[0]}: there is no such program on this machine")
    # a file and no pipe: what the program leaves behind may hold a pipe open for ever
    log = folder / ".output"
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [path, *argv[1:]], cwd=folder, stdin=subprocess.DEVNULL, stdout=stream,
            stderr=subprocess.STDOUT, env=_environment(argv, command.contents),
        )  # fmt: skip
        code = _waited(process, limit)
    said = _tail(log)
    log.unlink()
    return {"argv": list(argv), "code": code, "output": said}


def _waited(process: subprocess.Popen[bytes], limit: float | None) -> int | None:
    """Return code of a process; None where the limit came first, and all of it is ended then."""
    try:
        left = None if limit is None else max(limit - time.monotonic(), 0.0)
        return process.wait(timeout=left)
    except subprocess.TimeoutExpired:
        return None
    finally:
        if process.poll() is None:
            for pid in [*_descendants(process.pid), process.pid]:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(pid, signal.SIGKILL)
            process.wait()


def _descendants(pid: int) -> list[int]:
    """List what a process started, the last ones first; Linux alone tells."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            found += [*_descendants(int(child)), int(child)]
    return found


def _tail(log: Path) -> str:
    with log.open("rb") as stream:
        stream.seek(max(log.stat().st_size - 4 * TAIL, 0))
        return stream.read().decode(errors="replace")[-TAIL:]


def _check(step: StepDocument, command: Command) -> None:
    name, said = step["argv"][0], step["output"]
    if step["code"] is None:
        raise NoAnswer("timeout", f"{name}: stopped after {command.timeout_s:g} s")
    if step["code"] != 0:
        raise NoAnswer("failed", f"{name}: return code {step['code']}: {_last(said)}")
    if command.failure and command.failure in said:
        raise NoAnswer("failed", f"{name} said: {_last(said)}")


def _check_success(steps: list[StepDocument], command: Command) -> None:
    if command.success and not any(command.success in step["output"] for step in steps):
        rule = f"no command said {command.success!r}: {_last(steps[-1]['output'])}"
        raise NoAnswer("not-converged", rule)


def _last(said: str) -> str:
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    told = [line for line in lines if "ERROR" in line.upper()]
    return (told or lines or ["no output"])[-1][:200]


def _written(folder: Path) -> dict[str, str]:
    """Texts of the files of an answer; a link that leads out of the folder is not followed."""
    found = {}
    for name in (exchange.CURVE_FILE, exchange.FACTS_FILE):
        path = folder / name
        if not path.is_file() or path.is_symlink():
            continue
        if path.stat().st_size > exchange.MAX_BYTES:
            raise NoAnswer("failed", f"{name} is larger than {exchange.MAX_BYTES // 10**6} MB")
        found[name] = path.read_text(encoding="utf-8", errors="replace")
    return found
