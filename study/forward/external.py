"""Forward models that are not ours, as a resolved table ``forward`` says them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.canonical import digest
from study.errors import Fault, RefusedError
from study.forward import command
from study.forward.command import Command, ProgramDocument
from study.forward.exchange import Answer, NoAnswer
from study.forward.python_function import PythonFunction
from study.setup.forward_model import ForwardModel
from study.setup.section import section_of
from study.setup.setup import Problem

#: digits of the name of a set of commands that a person compares and gives
DIGITS = 12

#: step of a finite difference, relative to a constant (or, where that is 0, to the largest):
#: programs print six digits or more, of which a step of 1e-3 leaves three
STEP = 1e-3


@dataclass(frozen=True)
class Solved:
    """Curve of an external forward model, and how it was found."""

    answer: Answer
    seconds: float
    program: ProgramDocument | None = None


@dataclass(frozen=True)
class External:
    """Forward model of a resolved table.

    Parameters
    ----------
    section : ForwardModel
        What the file says.
    contents : mapping of str to str
        Name and text of the files that go along.
    programs : mapping of str to str
        sha256 of every program on this machine; empty where it is missing.
    function : PythonFunction or None
        Of ``model = "python"``; None until :func:`study.run` is given one.
    """

    section: ForwardModel
    contents: Mapping[str, str]
    programs: Mapping[str, str]
    function: PythonFunction | None

    @classmethod
    def of(cls, tables: Mapping[str, object]) -> External | None:
        """Read the table ``forward`` of resolved tables; None where our own model predicts."""
        table = tables.get("forward")
        if not isinstance(table, Mapping):
            return None
        section = section_of("forward", ForwardModel, _tupled(table))
        if not section.is_external:
            return None
        text, version = str(table.get("function") or ""), str(table.get("function_version") or "")
        function = PythonFunction(text, version) if text else None
        return cls(section, _texts(table, "contents"), _texts(table, "programs"), function)

    @property
    def digest(self) -> str:
        """Name of commands, files and programs, or of the function, by their content."""
        if self.section.model == "python":
            version = None if self.function is None else self.function.version
            return digest(["python", version], DIGITS)
        one = self.section
        return digest(
            [one.argv, one.success, one.failure, one.version, dict(self.contents),
             dict(self.programs)],
            DIGITS,
        )  # fmt: skip

    @property
    def missing(self) -> tuple[str, ...]:
        """Programs that are not on this machine."""
        return tuple(name for name, sha in self.programs.items() if not sha)

    def lines(self) -> list[str]:
        """Say what it runs, for whoever has to allow it."""
        shown = [f"runs: {' '.join(argv)}" for argv in self.section.argv]
        return [*shown, *(f"with the file {name}" for name in self.contents)]

    def solve(self, problem: Problem, displacement_mm: Array) -> Solved:
        """Solve one problem.

        Parameters
        ----------
        problem : Problem
            What is simulated.
        displacement_mm : ndarray, shape (n,)
            Where the force is wanted, in mm, rising.

        Raises
        ------
        NoAnswer
            If there is no whole curve.
        """
        began = time.perf_counter()
        if self.section.model == "python":
            if self.function is None:
                raise NoAnswer("failed", "no function was given: study.run(..., forward=f)")
            found = self.function.solve(problem, displacement_mm)
            return Solved(found, time.perf_counter() - began)
        one = self.section
        made = Command(
            one.argv, self.contents, one.version, one.success, one.failure, self.digest,
            one.timeout_s,
        )  # fmt: skip
        found, document = command.solve(made, problem, displacement_mm)
        return Solved(found, time.perf_counter() - began, document)


def _texts(table: Mapping[str, object], key: str) -> dict[str, str]:
    found = table.get(key)
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, Mapping) else {}


def _tupled(table: Mapping[str, object]) -> dict[str, object]:
    """Make the lists of JSON the tuples that the section holds."""
    return {k: _deep(v) for k, v in table.items()}


def _deep(value: object) -> object:
    return tuple(_deep(v) for v in value) if isinstance(value, list | tuple) else value


def check_allowed(models: Iterable[External], allowed: bool | str) -> None:
    """Refuse to run what the person at the keyboard did not allow, or what is not there.

    Parameters
    ----------
    models : iterable of External
        Those of a study.
    allowed : bool or str
        Whether commands may run; a text allows those whose digest begins with it.

    Raises
    ------
    RefusedError
        With the commands, files and digest.
    """
    distinct = list({one.digest: one for one in models}.values())
    if any(one.section.model == "python" and one.function is None for one in distinct):
        raise RefusedError(
            "forward.model = 'python' stands for a function given in Python:\n"
            '    study.run(design, forward=function, version="1")'
        )
    commands = [one for one in distinct if one.section.model == "command"]
    name = common_digest(commands)
    if commands and not (allowed is True or (isinstance(allowed, str) and _fits(name, allowed))):
        raise RefusedError(_refusal(name, commands, allowed))
    for one in commands:
        if one.missing:
            install = one.section.install or "install it, or leave these cells out"
            rule = f"{', '.join(one.missing)}: there is no such program on this machine"
            raise RefusedError(str(Fault("forward.argv", rule, install)))


def common_digest(models: Sequence[External]) -> str:
    """Name of all commands of a study together, which a person allows at once.

    Parameters
    ----------
    models : sequence of External
        Models of kind ``"command"``, in any order.

    Returns
    -------
    str
        12 digits of a hash; empty without models.
    """
    return digest(sorted(one.digest for one in models), DIGITS) if models else ""


def _fits(name: str, prefix: str) -> bool:
    """Whether a digest begins with what was typed; fewer than six digits are a guess."""
    return len(prefix) >= 6 and name.startswith(prefix)


def _refusal(name: str, commands: Sequence[External], allowed: bool | str) -> str:
    changed = f"this study runs other commands than {allowed!r} allows" if allowed else ""
    begin = changed or "this study runs programs with your rights, which nobody allowed"
    what = "\n".join(f"    {line}" for one in commands for line in one.lines())
    mend = (
        "    read them; then add --allow-commands, or, for exactly these commands, files and\n"
        f"    programs, --allow-digest {name}"
    )
    return f"{begin}:\n{what}\n{mend}"


def steps_of(values: Array) -> Array:
    """Step of the finite difference by every constant, shape (p,).

    Parameters
    ----------
    values : ndarray, shape (p,)
        Constants where the difference is taken, in MPa (exponents plain).

    Returns
    -------
    ndarray, shape (p,)
        In the units of ``values``: 0.001 of each, and of the largest for a constant that is 0.
    """
    largest = float(np.abs(values).max(initial=0.0)) or 1.0
    return STEP * np.where(values != 0.0, np.abs(values), largest)
