"""Programs as forward models: a fresh folder, files in, no shell, a time limit, files out."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from study.arrays import Array
from study.bounded_file import UnreadableError, read_regular
from study.forward import exchange, program
from study.forward.exchange import Answer, NoAnswer
from study.setup.setup import Problem
from study.working_folder import environment

#: word that stands for the interpreter that runs this package
PYTHON = "python"

#: seconds that a program may take to say its version, and bytes that it may say
_VERSION_S = 20.0
_VERSION_BYTES = 65_536

#: how the return code of a program that wrote a larger file than it may is seen
_FILE_TOO_LARGE = -25  # SIGXFSZ


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
    with program.fresh_folder() as folder:
        wanted = json.dumps(exchange.request(problem, displacement_mm), indent=1)
        _write(folder, {**command.contents, exchange.PROBLEM_FILE: wanted})
        for argv in command.argv:
            document["steps"].append(_step(argv, folder, command, limit))
            _check(document["steps"][-1], command)
        _check_success(document["steps"], command)
        return exchange.answer(_written(folder), displacement_mm), document


def path_of(word: str) -> str | None:
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
        Command that asks for the version, ended after 20 s or 64 kB; may be empty.
    contents : mapping of str to str
        Name and text of every file that it finds in its folder, as the solution does.

    Returns
    -------
    str
        At most 200 characters; empty without a command or a program, or where it says nothing.
    """
    path = path_of(argv[0]) if argv else None
    if path is None:
        return ""
    with program.fresh_folder() as folder:
        _write(folder, contents)
        until = time.monotonic() + _VERSION_S
        ended = program.run(
            [path, *argv[1:]], folder, until, _VERSION_BYTES, _environment(argv, contents)
        )
    lines = ended.beginning.splitlines()
    return next((line.strip()[:200] for line in lines if line.strip()), "")


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
    path = path_of(argv[0])
    if path is None:
        raise NoAnswer("failed", f"{argv[0]}: there is no such program on this machine")
    ended = program.run(
        [path, *argv[1:]], folder, limit, environment=_environment(argv, command.contents)
    )
    if ended.excess:
        raise NoAnswer("failed", f"{argv[0]}: was ended, for {ended.excess}")
    return {"argv": list(argv), "code": ended.code, "output": ended.output}


def _check(step: StepDocument, command: Command) -> None:
    name, said = step["argv"][0], step["output"]
    if step["code"] is None:
        raise NoAnswer("timeout", f"{name}: stopped after {command.timeout_s:g} s")
    if step["code"] == _FILE_TOO_LARGE:
        most = f"{program.FOLDER_BYTES / 1e9:g} GB"
        raise NoAnswer("failed", f"{name}: was ended, for it wrote a file of more than {most}")
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
    """Texts of the files of an answer; a link, a pipe or a device is none."""
    texts = {}
    for name in (exchange.CURVE_FILE, exchange.FACTS_FILE):
        try:
            data = read_regular(folder / name, exchange.MAX_BYTES, follow=False)
        except UnreadableError as error:
            rule = f"the program wrote no {name}: what stands there {error.rule}"
            raise NoAnswer("failed", rule) from error
        if data is not None:
            texts[name] = data.decode(errors="replace")
    return texts
