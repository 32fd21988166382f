"""Forward models that are not ours: programs, in a fresh folder without a shell, and functions."""

from __future__ import annotations

import base64
import contextlib
import functools
import io
import itertools
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from study.external.answers import (
    CASE_FILE,
    DISPLACEMENT,
    FORCE,
    GRADIENT,
    PROBLEM_FILE,
    NoAnswer,
    PredictedCurve,
    at_points,
    checked_curve,
    curve_answered,
    curve_of,
    quantity_in,
    rendered,
    values_of_files,
)
from study.external.forward_model import ForwardCell, ForwardFiles, ForwardModel, target_and_source
from study.ground.arrays import Array
from study.ground.canonical import Json, digest
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, RefusedError, StoreError
from study.ground.files import read_regular
from study.ground.working_folder import UserImports, environment
from study.record.record import ProgramDocument, SolverDocument, StepDocument

# One run of a program: supervised, within limits of time, output and disk, with nothing left.

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
    #: The first and the last characters that it said, of which there may be fewer.
    beginning: str = ""
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
    heard, output = os.pipe()
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
        return _watched(folder, answer, heard, until, output_bytes)
    except OSError as error:  # of a folder that is gone, or more words than the system takes
        return Ended(None, excess=f"it could not be run ({error.strerror})")
    finally:
        for end in (held, answer, heard, lifeline, status, output):
            if end >= 0:
                os.close(end)
        if process is not None:  # it ends all, for its lifeline is closed
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_LAUNCHER_S)
            process.kill()
            process.wait()


def _watched(
    folder: Path, answer: int, heard: int, until: float | None, output_bytes: int
) -> Ended:
    """Follow a program by its two pipes until it ends, or comes to a limit."""
    head, tail, size, code, excess = b"", b"", 0, b"", ""
    look = time.monotonic() + _LOOK_S
    pipes = [answer, heard]
    while not excess:
        now = time.monotonic()
        if until is not None and now >= until:
            break
        if now >= look:
            excess = _excess_of(folder)
            look = time.monotonic() + max(_LOOK_S, 10 * (time.monotonic() - now))
        wait = look if until is None else min(look, until)
        ready, _, _ = select.select(pipes, [], [], max(wait - time.monotonic(), 0.0))
        if heard in ready:
            part = os.read(heard, 1 << 16)
            head = head + part if len(head) < TAIL else head
            tail, size = (tail + part)[-4 * LOG :], size + len(part)
            if not part:
                pipes.remove(heard)
            if size > output_bytes:
                excess = f"it said more than {output_bytes / 1e6:g} MB"
        elif answer in ready:
            code = os.read(answer, 64)
            excess = "" if code else "the process that supervised it was killed"
            break
    first, last = head.decode(errors="replace"), tail.decode(errors="replace")
    return Ended(int(code) if code else None, first[:TAIL], last[-LOG:], excess)


def _entries(folder: Path) -> Iterator[os.DirEntry[str]]:
    """Files and folders in a folder of any depth; links are not followed."""
    waiting = [str(folder)]
    while waiting:
        # what was there a moment ago may be gone
        with (
            contextlib.suppress(FileNotFoundError, NotADirectoryError),
            os.scandir(waiting.pop()) as inside,
        ):
            for entry in inside:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
                yield entry


def _excess_of(folder: Path) -> str:
    """Which limit what lies in a folder is beyond; empty for none."""
    size = 0
    try:
        for number, entry in enumerate(_entries(folder), 1):
            with contextlib.suppress(FileNotFoundError):
                size += 512 * entry.stat(follow_symlinks=False).st_blocks
            if size > FOLDER_BYTES:
                return f"its folder holds more than {FOLDER_BYTES / 1e9:g} GB"
            if number > FOLDER_ENTRIES:
                return f"its folder holds more than {FOLDER_ENTRIES} files"
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


#: word that stands for the interpreter that runs this package
PYTHON = "python"
#: seconds that a program may take to say its version, and bytes that it may say
_VERSION_S = 20.0
_VERSION_BYTES = 65_536
#: how the return code of a program that wrote a larger file than it may is seen
_FILE_TOO_LARGE = -25  # SIGXFSZ
#: bytes of the files of a folder that is kept
_KEPT_BYTES = 50_000_000


def run_commands(
    command: ForwardModel,
    contents: Mapping[str, str],
    read: Callable[[Path, str], PredictedCurve],
    digest: str = "",
) -> PredictedCurve:
    """Run the commands in a fresh folder and read their answer; the folder goes along if kept.

    ``contents`` are names and texts of the files of that folder. ``read`` gets the folder and what
    the commands said. A :class:`NoAnswer` carries the report and the folder, too.
    """
    document: ProgramDocument = {
        "version": said_version(command.version, contents),
        "digest": digest,
        "steps": [],
    }
    limit = None if command.timeout_s is None else time.monotonic() + command.timeout_s
    with fresh_folder() as folder:
        _write(folder, contents)
        try:
            logs = []
            for argv in command.argv:
                step, log = _step(argv, folder, contents, limit)
                document["steps"].append(step)
                logs.append(log)
                _check(step, command)
            if command.success and not any(command.success in log for log in logs):
                text = _last(document["steps"][-1]["output"])
                raise NoAnswer("not-converged", f"no command said {command.success!r}: {text}")
            answer = read(folder, "\n".join(logs))
        except NoAnswer as error:
            error.program = document
            error.folder = _packed(folder) if command.keep in ("all", "failed") else b""
            raise
        solver: SolverDocument = {"name": document["version"] or command.argv[0][0]}
        packed = _packed(folder) if command.keep == "all" else b""
        return replace(answer, solver={**solver, "program": document}, folder=packed)


def _packed(folder: Path) -> bytes:
    """Zip of the regular files of a folder, as far as they have room."""
    packed, left = io.BytesIO(), _KEPT_BYTES
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        paths: list[str] = []
        with contextlib.suppress(OSError):  # a folder that cannot be read
            paths.extend(entry.path for entry in itertools.islice(_entries(folder), FOLDER_ENTRIES))
        for path in sorted(paths):
            with contextlib.suppress(StoreError):  # no file, or too large
                content = read_regular(path, left, follow=False)
                if content is not None:
                    left -= len(content)
                    name = os.path.relpath(path, folder).encode(errors="replace").decode()
                    archive.writestr(name, content)
    return packed.getvalue()


def path_of(word: str) -> str | None:
    """Path of a program on this machine; None where there is none."""
    return sys.executable if word == PYTHON else shutil.which(word)


def said_version(argv: tuple[str, ...], contents: Mapping[str, str]) -> str:
    """First line that a program says of itself, whatever its return code; ``ccx -v`` gives 201."""
    path = path_of(argv[0]) if argv else None
    if path is None:
        return ""
    with fresh_folder() as folder:
        _write(folder, contents)
        until = time.monotonic() + _VERSION_S
        ended = run([path, *argv[1:]], folder, until, _VERSION_BYTES, _environment(argv, contents))
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
    argv: tuple[str, ...], folder: Path, contents: Mapping[str, str], limit: float | None
) -> tuple[StepDocument, str]:
    """Run one command; more of what it said stands beside its report."""
    path = path_of(argv[0])
    if path is None:
        raise NoAnswer("failed", f"{argv[0]}: there is no such program on this machine")
    ended = run([path, *argv[1:]], folder, limit, environment=_environment(argv, contents))
    if ended.excess:
        raise NoAnswer("failed", f"{argv[0]}: was ended, for {ended.excess}")
    return {"argv": list(argv), "code": ended.code, "output": ended.log[-TAIL:]}, ended.log


def _check(step: StepDocument, command: ForwardModel) -> None:
    name, text = step["argv"][0], step["output"]
    if step["code"] is None:
        raise NoAnswer("timeout", f"{name}: stopped after {command.timeout_s:g} s")
    if step["code"] == _FILE_TOO_LARGE:
        most = f"{FOLDER_BYTES / 1e9:g} GB"
        raise NoAnswer("failed", f"{name}: was ended, for it wrote a file of more than {most}")
    if step["code"] != 0:
        raise NoAnswer("failed", f"{name}: return code {step['code']}: {_last(text)}")
    if command.failure and command.failure in text:
        raise NoAnswer("failed", f"{name} said: {_last(text)}")


def _last(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if "ERROR" in line.upper()]
    return (errors or lines or ["no output"])[-1][:200]


# A Python function as a forward model: given to ``study.run``, never named in a file.

#: problem (see ``fit_problem.request``) -> forces in N at its ``displacement_mm``,
#: a curve, or columns such as ``displacement_mm``, ``force_N`` and ``dforce_C10``
Function = Callable[[Mapping[str, Json]], "ArrayLike | Curve | Mapping[str, ArrayLike]"]


@dataclass(frozen=True)
class PythonFunction:
    """A function that goes to worker processes."""

    #: The function as cloudpickle wrote it, in base 64; it lives in memory alone.
    text: str
    #: Its identity, part of the name of every result: a source text is none.
    version: str

    @classmethod
    def of(cls, function: Function, version: str) -> PythonFunction:
        """Make it of a function."""
        import cloudpickle

        if not version.strip():
            mend = 'give version = "1", and another one whenever the function changes'
            raise InputError(Fault("version", "is missing: it is part of every key", mend))
        try:
            text = base64.b64encode(cloudpickle.dumps(function)).decode("ascii")
        except Exception as error:  # it may hold anything
            mend = "define it in a module, without open files or locks"
            rule = f"cannot go to a worker process: {error}"
            raise InputError(Fault("forward", rule, mend)) from error
        return cls(text, version.strip())

    def __call__(self, case: Mapping[str, object]) -> object:
        """Call it; whatever it raises is a case without an answer."""
        import cloudpickle

        with UserImports():  # made anew: a case knows nothing of what another one left in it
            function: Function = cloudpickle.loads(base64.b64decode(self.text))
        try:
            return function(_attributed(case))  # type: ignore[arg-type]
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a user's may raise anything
            raise NoAnswer("failed", f"{type(error).__name__}: {error}") from error

    def solve(
        self, request: Mapping[str, object], displacement_mm: Array, units: Mapping[str, str]
    ) -> PredictedCurve:
        """Curve and further values of a problem."""
        returned = self(request)
        values = {}
        if isinstance(returned, Mapping):
            values = {k: quantity_in(returned[k], u, str(k)) for k, u in units.items()
                      if k in returned}  # fmt: skip
            returned = {k: v for k, v in returned.items() if k not in values}
        columns = _python_function_columns(cast("ArrayLike", returned), displacement_mm)
        return replace(at_points(columns, displacement_mm), values=values)

    def values(self, case: Mapping[str, object], units: Mapping[str, str]) -> PredictedCurve:
        """Values of parameters alone, or the curve; a value has the unit of its response."""
        returned = self(case)
        if isinstance(returned, Curve):
            whole = checked_curve(returned.displacement_mm, returned.force_N, "the function")
            return PredictedCurve(whole)
        if not isinstance(returned, Mapping) or not returned:
            rule = f"the function returned {type(returned).__name__}, not names with numbers"
            columns_of = f'{{"{DISPLACEMENT}": [..], "{FORCE}": [..]}}'
            raise NoAnswer("failed", f'{rule}: return {{"peak": 1.5}}, or a curve as {columns_of}')
        answered = PredictedCurve()
        if {DISPLACEMENT, FORCE} <= set(returned):
            d, force = (np.asarray(returned[name], dtype=float) for name in (DISPLACEMENT, FORCE))
            if d.ndim != 1 or d.shape != force.shape:
                raise NoAnswer("failed", "the columns of the function's curve differ in length")
            answered = PredictedCurve(checked_curve(d, force, "the function's curve"))
            returned = {k: v for k, v in returned.items() if k not in (DISPLACEMENT, FORCE)}
        scalars = {str(k): getattr(v, "item", lambda v=v: v)() if np.ndim(v) == 0 else v
                   for k, v in returned.items()}  # fmt: skip
        values = {}
        for name, value in scalars.items():
            try:
                values[name] = quantity_in(value, units.get(name, ""), name)
            except NoAnswer:  # what else it returns may be no number
                if name in units:
                    raise
        return replace(answered, values=values)


class _Attributed(dict[str, object]):
    """A case whose keys are attributes, too: ``case.parameters.mass``."""

    def __getattr__(self, name: str) -> object:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"the case has no {name!r}: it has {', '.join(self)}") from None


def _attributed(value: object) -> object:
    if isinstance(value, Mapping):
        return _Attributed({str(k): _attributed(v) for k, v in value.items()})
    return value


def _python_function_columns(
    given: ArrayLike | Curve | Mapping[str, ArrayLike], displacement_mm: Array
) -> dict[str, Array]:
    if isinstance(given, Curve):
        slopes = {GRADIENT + name: slope for name, slope in given.force_gradient.items()}
        given = {DISPLACEMENT: given.displacement_mm, FORCE: given.force_N, **slopes}
    elif not isinstance(given, Mapping):
        given = {FORCE: given}
    given_columns: Mapping[str, ArrayLike] = {DISPLACEMENT: displacement_mm, **given}
    columns = {name: np.asarray(values, dtype=float) for name, values in given_columns.items()}
    if FORCE not in columns:
        raise NoAnswer("failed", f"the function gives no {FORCE}")
    size = columns[DISPLACEMENT].shape
    for name, values in columns.items():
        if values.shape != size or values.ndim != 1:
            raise NoAnswer("failed", f"{name} of the function has the shape {values.shape}")
    return columns


# Forward models that are not ours, as a resolved table ``forward`` says them.

#: digits of the name of a set of commands that a person compares and gives
DIGITS = 12
#: step of a finite difference, relative to a constant (or, where that is 0, to the largest):
#: programs print six digits or more, of which a step of 1e-3 leaves three
STEP = 1e-3


@dataclass(frozen=True)
class External:
    """Forward model that is not ours, with what it is on this machine."""

    section: ForwardModel
    #: Name and text of the files that go along.
    contents: Mapping[str, str]
    #: sha256 of every program on this machine; empty where it is missing.
    programs: Mapping[str, str]
    #: Of ``model = "python"``; None until :func:`study.run` is given one.
    function: PythonFunction | None

    @classmethod
    def of(cls, problem: ForwardCell) -> External | None:
        """Forward model of a cell; None where our own predicts."""
        section = problem.forward
        return None if section is None or not section.is_external else _external(section)

    @cached_property
    def digest(self) -> str:
        """Name of commands, files and programs, or of the function, by their content."""
        if self.section.model == "python":
            version = None if self.function is None else self.function.version
            return digest(["python", version], DIGITS)
        section = self.section
        later = {k: v for k, v in section.document().items() if k in ("curve", "values", "reaches")}
        if section.rendered:  # the same text is another file where it is copied
            later["rendered"] = section.rendered
        return digest(
            [section.argv, section.success, section.failure, section.version, dict(self.contents),
             dict(self.programs), *([later] if later else [])],
            DIGITS,
        )  # fmt: skip

    @property
    def is_function_missing(self) -> bool:
        """Whether it is a function in Python that nobody has given."""
        return self.section.model == "python" and self.function is None

    @property
    def missing(self) -> tuple[str, ...]:
        """Programs that are not on this machine."""
        return tuple(name for name, sha in self.programs.items() if not sha)

    def lines(self) -> list[str]:
        """Say what it runs, for whoever has to allow it."""
        shown = [f"runs: {' '.join(argv)}" for argv in self.section.argv]
        return [*shown, *(f"with the file {name}" for name in self.contents)]

    def solve(
        self,
        request: Mapping[str, object],
        displacement_mm: Array,
        context: Callable[[], Mapping[str, object]],
    ) -> PredictedCurve:
        """Solve one problem, whose document a program gets and whose names its templates."""
        # Shapes: displacement_mm (n,).
        section = self.section

        def read(folder: Path) -> PredictedCurve:
            if section.curve is None:
                return curve_answered(folder, displacement_mm, section.reaches)
            given = curve_of(section.curve, folder)
            columns = {DISPLACEMENT: given.displacement_mm, FORCE: given.force_N}
            return at_points(columns, displacement_mm, section.reaches)

        def call(function: PythonFunction) -> PredictedCurve:
            return function.solve(request, displacement_mm, section.units)

        return self._asked(call, context, (PROBLEM_FILE, request), read)

    def answer(self, case: Mapping[str, object], units: Mapping[str, str]) -> PredictedCurve:
        """Ask for the values and the curve of parameters alone, responses in their units."""
        section = self.section

        def read(folder: Path) -> PredictedCurve:
            curve = section.curve
            return PredictedCurve() if curve is None else PredictedCurve(curve_of(curve, folder))

        def call(function: PythonFunction) -> PredictedCurve:
            return function.values(case, {**units, **section.units})

        return self._asked(call, lambda: case, (CASE_FILE, case), read)

    def _asked(
        self,
        call: Callable[[PythonFunction], PredictedCurve],
        context: Callable[[], Mapping[str, object]],
        file: tuple[str, Mapping[str, object]],
        read: Callable[[Path], PredictedCurve],
    ) -> PredictedCurve:
        """Call the function, or run the commands with their templates and the file of the case."""
        began, section = time.perf_counter(), self.section

        def all_read(folder: Path, text: str) -> PredictedCurve:
            values = values_of_files(section.values, folder, text)
            return replace(read(folder), values=values)

        if section.model == "python":
            if self.function is None:
                raise NoAnswer("failed", "no function was given: study.run(..., forward=f)")
            solver: SolverDocument = {"name": f"Python function, version {self.function.version}"}
            answer = call(self.function)
            return replace(answer, solver=solver, seconds=time.perf_counter() - began)
        contents, rendered = self.rendered(context())
        contents[file[0]] = json.dumps(file[1], indent=1)
        answer = run_commands(section, contents, all_read, self.digest)
        return replace(answer, seconds=time.perf_counter() - began, rendered=rendered)

    def rendered(self, case: Mapping[str, object]) -> tuple[dict[str, str], dict[str, str]]:
        """Files of the folder of a case, and those that were rendered."""
        templates = dict(map(target_and_source, self.section.files))
        rendered_files = {
            target: rendered(self.contents[target], case, templates[target])
            for target in self.section.rendered
        }
        return {**self.contents, **rendered_files}, rendered_files


@functools.lru_cache(maxsize=1000)  # it is asked for several times a case
def _external(section: ForwardModel) -> External:
    files = section.installed or ForwardFiles()
    function = PythonFunction(files.function, files.function_version) if files.function else None
    return External(section, dict(files.contents), dict(files.programs), function)


def check_allowed(models: Iterable[External], allowed: bool | str) -> None:
    """Refuse to run what the person at the keyboard did not allow, or what is not there."""
    distinct = list({model.digest: model for model in models}.values())
    if any(model.is_function_missing for model in distinct):
        raise RefusedError(
            "forward.model = 'python' stands for a function given in Python:\n"
            '    study.run(design, forward=function, version="1")'
        )
    commands = [model for model in distinct if model.section.model == "command"]
    name = common_digest(commands)
    is_named = isinstance(allowed, str) and len(allowed) >= 6 and name.startswith(allowed)
    if commands and allowed is not True and not is_named:
        raise RefusedError(_refusal(name, commands, allowed))
    for model in commands:
        if model.missing:
            install = model.section.install or "install it, or leave these cells out"
            rule = f"{', '.join(model.missing)}: there is no such program on this machine"
            raise RefusedError(str(Fault("forward.argv", rule, install)))


def common_digest(models: Sequence[External]) -> str:
    """Name of all commands of a study together, which a person allows at once."""
    return digest(sorted(model.digest for model in models), DIGITS) if models else ""


def _refusal(name: str, commands: Sequence[External], allowed: bool | str) -> str:
    changed = f"this study runs other commands than {allowed!r} allows" if allowed else ""
    begin = changed or "this study runs programs with your rights, which nobody allowed"
    what = "\n".join(f"    {line}" for model in commands for line in model.lines())
    mend = (
        "    read them; then add --allow-commands, or, for exactly these commands, files and\n"
        f"    programs, --allow-digest {name}"
    )
    return f"{begin}:\n{what}\n{mend}"


def steps_of(values: Array) -> Array:
    """Step of the finite difference by every constant, shape (p,). Units: values MPa."""
    largest = float(np.abs(values).max(initial=0.0)) or 1.0
    return STEP * np.where(values != 0.0, np.abs(values), largest)
