"""Files between this package and another program: the problem in JSON, the curve in CSV.

``problem.json`` holds the resolved problem of one solution in mm, N and MPa. The program writes
``curve.csv`` (``displacement_mm``, ``force_N``, and ``dforce_C10`` in N per MPa for a constant
whose gradient it knows) and, if it likes, ``facts.json`` (``dofs``, ``elements``).
"""

from __future__ import annotations

import base64
import csv
import io
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from study.ground.arrays import Array
from study.ground.bounded_file import UnreadableError, parse_json
from study.ground.canonical import Json, plain
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.ground.working_folder import UserImports
from study.mechanics.setup.declaration import values_of
from study.mechanics.setup.setup import Problem

SCHEMA = 1
PROBLEM_FILE = "problem.json"
CURVE_FILE = "curve.csv"
FACTS_FILE = "facts.json"
DISPLACEMENT = "displacement_mm"
FORCE = "force_N"
GRADIENT = "dforce_"
#: rows that a curve may have, and bytes of an answer: more is a mistake
MAX_ROWS = 100_000
MAX_BYTES = 20_000_000
#: magnitude that no displacement in mm and no force in N has; powers of smaller ones are numbers
LARGEST = 1e30
#: unknowns and elements that no mesh has, beyond which a double is not exact
MOST_ELEMENTS = 2**53
#: characters of the reason for which there is no answer
_REASON = 500
#: share of the displacement asked for that a curve may end before: digits of a text file
_SHORT = 1e-6

Text = Mapping[str, str]


class NoAnswer(Exception):
    """The program has no answer; carries the status of the record."""

    def __init__(self, status: str, message: str) -> None:
        super().__init__(message if len(message) <= _REASON else f"{message[:_REASON]}...")
        self.status = status


@dataclass(frozen=True)
class ProgramAnswer:
    """What a program found."""

    #: Forces at the displacements that were asked for, with the gradients that it knows.
    curve: Curve
    #: Of its mesh; 0 where it does not say.
    dofs: int = 0
    elements: int = 0
    gradients: tuple[str, ...] = field(default=())


def request(problem: Problem, displacement_mm: Array) -> dict[str, Json]:
    """Document of a problem, complete in itself. Shapes: displacement_mm (n,)."""
    material, test = problem.material, problem.test
    bulk = material.bulk
    indenter = None if test.indenter is None else _section(test.indenter)
    return {
        "schema": SCHEMA,
        "specimen": _section(problem.specimen),
        "test": {
            "kind": test.kind,
            "interface": test.interface,
            "base": test.base,
            "displacement_mm": float(displacement_mm[-1]),
            "steps": test.steps,
            "indenter": indenter,
        },
        "material": {
            "model": material.model,
            "constants_MPa": {k: float(v) for k, v in material.constants.items()},
            "mu0_MPa": material.mu0,
            "bulk_modulus_MPa": bulk if math.isfinite(bulk) else None,
        },
        "model": {**_section(problem.model), "mesh_size_mm": _mesh_size(problem)},
        "displacement_mm": [float(d) for d in displacement_mm],
    }


def _section(value: object) -> dict[str, Json]:
    words = {"shape": getattr(value, "shape", None)}
    shaped = {k: v for k, v in words.items() if v is not None}
    return cast("dict[str, Json]", plain({**shaped, **values_of(value)}))


def _mesh_size(problem: Problem) -> float | None:
    """Element size in mm that our own mesh would have."""
    if problem.setup.has_no_elements:
        return None
    from study.mechanics.mesh.mesher import mesh_size

    return float(mesh_size(problem.setup))


def answer(files: Text, displacement_mm: Array) -> ProgramAnswer:
    """Read what a program wrote. Shapes: displacement_mm (n,)."""
    if CURVE_FILE not in files:
        raise NoAnswer("failed", f"the program wrote no {CURVE_FILE}")
    columns = _exchange_columns(files[CURVE_FILE])
    facts = _facts(files.get(FACTS_FILE, "{}"))
    return at_points(columns, displacement_mm, facts)


def at_points(
    columns: Mapping[str, Array], displacement_mm: Array, facts: Mapping[str, int]
) -> ProgramAnswer:
    """Curve of some columns at the displacements asked for."""
    # Shapes: columns (m,), MPa; displacement_mm (n,).
    reached, force = _checked(columns, float(displacement_mm[-1]))
    known = {k.removeprefix(GRADIENT): v for k, v in columns.items() if k.startswith(GRADIENT)}
    try:
        with np.errstate(all="ignore"):
            gradient = {k: between(reached, slope, displacement_mm) for k, slope in known.items()}
            forces = between(reached, force, displacement_mm)
        curve = Curve(displacement_mm, forces, force_gradient=gradient)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise NoAnswer("failed", f"no spline goes through the curve: {error}") from error
    return ProgramAnswer(curve, facts.get("dofs", 0), facts.get("elements", 0), tuple(known))


def between(knots: Array, values: Array, at: Array) -> Array:
    """Cubic spline from the unloaded origin; the very values where points are asked for."""
    # Shapes: knots, values (m,); at (n,); returns (n,).
    from scipy.interpolate import CubicSpline

    x, y = (knots, values) if knots[0] <= 0 else (np.r_[0.0, knots], np.r_[0.0, values])
    places = np.minimum(at, x[-1])
    if x.size < 3:
        return np.asarray(np.interp(places, x, y))
    return np.asarray(CubicSpline(x, y)(places))


def _exchange_columns(text: str) -> dict[str, Array]:
    lines = csv.reader(io.StringIO(text.lstrip("\ufeff")))
    filled = (row for row in lines if any(cell.strip() for cell in row))
    try:
        rows = list(itertools.islice(filled, MAX_ROWS + 2))
    except csv.Error as error:
        raise NoAnswer("failed", f"{CURVE_FILE}: {error}") from error
    if len(rows) < 2:
        raise NoAnswer("failed", f"{CURVE_FILE} holds no rows below its header")
    if len(rows) > MAX_ROWS + 1:
        raise NoAnswer("failed", f"{CURVE_FILE} has more than {MAX_ROWS} rows below its header")
    header = [cell.strip() for cell in rows[0]]
    for name in (DISPLACEMENT, FORCE):
        if header.count(name) != 1:
            some = ", ".join(header[:20])
            raise NoAnswer("failed", f"{CURVE_FILE} needs one column {name}, it has {some}")
    if any(len(row) != len(header) for row in rows):
        raise NoAnswer("failed", f"the rows of {CURVE_FILE} differ in length")
    try:
        table = np.array([[float(cell) for cell in row] for row in rows[1:]])
    except ValueError as error:
        raise NoAnswer("failed", f"{CURVE_FILE}: {error}") from error
    if not np.all(np.isfinite(table)):
        raise NoAnswer("not-converged", f"{CURVE_FILE} holds a number that is not finite")
    return dict(zip(header, table.T, strict=True))


def _checked(columns: Mapping[str, Array], end_mm: float) -> tuple[Array, Array]:
    for name, values in columns.items():
        if np.abs(values).max(initial=0.0) > LARGEST:
            raise NoAnswer("failed", f"{name} holds a number beyond {LARGEST:g}, which none can be")
    d, force = columns[DISPLACEMENT], columns[FORCE]
    if d.size == 0 or d[0] < 0 or np.any(np.diff(d) <= 0):
        raise NoAnswer("failed", f"{DISPLACEMENT} of the program does not rise from 0 on")
    if d[-1] < end_mm * (1 - _SHORT):
        raise NoAnswer("not-converged", f"the curve ends at {d[-1]:g} mm of {end_mm:g} mm")
    return d, force


def _facts(text: str) -> dict[str, int]:
    try:
        facts = parse_json(text, FACTS_FILE)
    except UnreadableError as error:
        raise NoAnswer("failed", str(error)) from error
    if not isinstance(facts, dict):
        raise NoAnswer("failed", f"{FACTS_FILE} must be an object")
    counts = {name: facts[name] for name in ("dofs", "elements") if facts.get(name) is not None}
    for name, count in counts.items():
        is_number = isinstance(count, int | float) and not isinstance(count, bool)
        if not is_number or not 0 <= count <= MOST_ELEMENTS or count != int(count):
            rule = f"must be a whole number that is not negative, got {str(count)[:80]}"
            raise NoAnswer("failed", f"{FACTS_FILE}: {name} {rule}")
    return {name: int(count) for name, count in counts.items()}


# A Python function as a forward model: given to ``study.run``, never named in a file.

#: problem (see ``request``) -> forces in N at its ``displacement_mm``,
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
            raise InputError(
                Fault("forward", f"cannot go to a worker process: {error}", mend)
            ) from error
        return cls(text, version.strip())

    def solve(self, problem: Problem, displacement_mm: Array) -> ProgramAnswer:
        """Curve of a problem; whatever the function raises is a case without an answer."""
        import cloudpickle

        with UserImports():
            function: Function = cloudpickle.loads(base64.b64decode(self.text))
        try:
            found = function(request(problem, displacement_mm))
        except Exception as error:  # noqa: BLE001 - a function of the user may raise anything
            raise NoAnswer("failed", f"{type(error).__name__}: {error}") from error
        return at_points(_python_function_columns(found, displacement_mm), displacement_mm, {})


def _python_function_columns(
    found: ArrayLike | Curve | Mapping[str, ArrayLike], displacement_mm: Array
) -> dict[str, Array]:
    if isinstance(found, Curve):
        made: Mapping[str, ArrayLike] = {
            DISPLACEMENT: found.displacement_mm,
            FORCE: found.force_N,
            **{GRADIENT + k: v for k, v in found.force_gradient.items()},
        }
    elif isinstance(found, Mapping):
        made = {DISPLACEMENT: displacement_mm, **found}
    else:
        made = {DISPLACEMENT: displacement_mm, FORCE: found}
    columns = {name: np.asarray(values, dtype=float) for name, values in made.items()}
    if FORCE not in columns:
        raise NoAnswer("failed", f"the function gives no {FORCE}")
    size = columns[DISPLACEMENT].shape
    for name, values in columns.items():
        if values.shape != size or values.ndim != 1:
            raise NoAnswer("failed", f"{name} of the function has the shape {values.shape}")
        if not np.all(np.isfinite(values)):
            raise NoAnswer("not-converged", f"{name} of the function is not finite everywhere")
    return columns
