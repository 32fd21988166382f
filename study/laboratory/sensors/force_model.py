"""Force of a test at any displacement and constants, with its derivatives by both."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from study.ground import declaration, units
from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.declaration import Bad, Faults, Reads, integer, measured, number, section, shown
from study.ground.errors import Fault, InputError
from study.mechanics.calibration.residual_function import EvaluationFailed
from study.mechanics.forward import finite_element
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.material.homogeneous import response
from study.mechanics.setup.setup import Problem
from study.simulation.cell import CellProblem
from study.simulation.problem_file import StudyTable, default_name

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution


#: Half the distance of two places whose forces give the stiffness, over the depth: the curve is a
#: polynomial between its steps, of which this leaves 1e-8.
DIFFERENCE = 1e-4
#: Smallest load step over the largest: constants that need less are next to having no answer, and a
#: fit that asks there should hear so soon.
CUTBACKS = 0.12


@dataclass(frozen=True)
class ForceAt:
    """Force at some displacements."""

    #: shape (n,); on the whole specimen.
    force_N: Array
    #: shape (n,); dF/dd.
    stiffness_N_per_mm: Array
    #: shape (n, p); dF/dconstant, N per MPa (N for a plain exponent).
    jacobian: Array


def force_model(given: Problem, farthest_mm: float) -> ClosedForm | Simulated:
    """Model of a test: closed form where its deformation is homogeneous, else finite elements."""
    problem = replace(given, test=replace(given.test, displacement_mm=farthest_mm))
    if problem.material.relaxation:
        rule = "is not known to sensors: their rows have positions and forces, and no times"
        raise InputError(Fault("material.relaxation", rule, "leave it out"))
    if problem.setup.is_homogeneous:
        return ClosedForm(problem)
    return Simulated(problem)


class ClosedForm:
    """Compression between frictionless plates."""

    # Either model gives no force at negative displacements, before touch. Constants are in MPa
    # (exponents plain); where there is no answer it raises. ``notes`` say what is known of the
    # force once it has been asked for.

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.notes: tuple[str, ...] = ()

    def __call__(self, values: Array, displacement_mm: Array) -> ForceAt:
        """Force of the homogeneous deformation."""
        material = self.problem.material.with_constants(values)
        height, area = height_and_area(self.problem.specimen)
        sense = self.problem.setup.kind.sense
        touches = displacement_mm >= 0
        stretch = 1 + sense * np.where(touches, displacement_mm, 0.0) / height
        state = response(material, "uniaxial", stretch)
        jacobian = np.stack([sense * area * state.gradient[n] for n in material.names], axis=1)
        if not np.isfinite(state.stress).all():
            raise EvaluationFailed("the material has no equilibrium state at these constants")
        return ForceAt(
            np.where(touches, sense * area * state.stress, 0.0),
            np.where(touches, area / height * state.slope, 0.0),
            np.where(touches[:, None], jacobian, 0.0),
        )


class Simulated:
    """Finite elements: every set of constants is solved from the solution of the assumed ones.

    The force is then a function of the constants, whatever was solved before: contact remembers
    where a solution came from, and a fit that is led there by another finds no lower point.

    Between the steps the first solution is interpolated with its slopes and work; what others
    add to it by a spline that is linear in the solved forces. Gradient and force then belong to
    one function of the constants.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.notes: tuple[str, ...] = ()
        self._names = problem.material.names
        self._anchor: Solution | None = None
        self._known: dict[bytes, Curve] = {}

    def __call__(self, values: Array, displacement_mm: Array) -> ForceAt:
        """Force between the steps of the solution at these constants."""
        # all others start from this one, which is solved first
        first = self._solved(self.problem.material.values)
        curve = self._solved(values)
        knots = curve.displacement_mm
        d = np.clip(displacement_mm, 0.0, knots[-1])
        touches = displacement_mm >= 0
        more = (curve.force_N - first.force_at(knots))[:, None]

        def force(at: Array) -> Array:
            return np.asarray(first.force_at(at) + curve.splined(more, at)[:, 0])

        near = DIFFERENCE * float(knots[-1])
        below, above = np.maximum(d - near, 0.0), np.minimum(d + near, knots[-1])
        return ForceAt(
            np.where(touches, force(d), 0.0),
            np.where(touches, (force(above) - force(below)) / (above - below), 0.0),
            np.where(touches[:, None], curve.gradients_at(self._names, d), 0.0),
        )

    def _solved(self, values: Array) -> Curve:
        key = values.tobytes()
        if key in self._known:
            return self._known[key]
        try:
            problem = replace(self.problem, material=self.problem.material.with_constants(values))
            # where the assumed material snaps, its neighbors do, and must be allowed to
            cutbacks = None if self._anchor is None or self.notes else CUTBACKS
            solution = finite_element.solve(problem, warm=self._anchor, cutbacks=cutbacks)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        if not solution.converged:
            raise EvaluationFailed(f"{solution.status}: {solution.message}")
        if self._anchor is None:
            self._anchor, self.notes = solution, _notes(solution)
        self._known[key] = solution.curve
        return solution.curve


def _notes(solution: Solution) -> tuple[str, ...]:
    """Say where the force is no smooth function of the constants."""
    if not solution.energy.jumps_mm:
        return ()
    places = ", ".join(f"{jump_mm:.3g}" for jump_mm in sorted(solution.energy.jumps_mm))
    return (
        f"past {places} mm the surface snaps to another equilibrium: there the force is no smooth "
        "function of the constants; press less deep, or refine the mesh",
    )


# Tables ``[position]``, ``[force]``, ``[requirement]`` of a file for ``study require``.

#: Standard deviations of the noise that the simulated curve reaches beyond the test.
REACH = 5.0
#: Most multiples of the given errors at which a Monte Carlo simulation is made.
MOST_MULTIPLES = 6


def fraction(value: object) -> float:
    """Read a share that may be zero: a plain number below 1, or percent."""
    if isinstance(value, str):
        share = units.parse_percent(value) / 100
        if not 0 <= share < 1:
            raise Bad(f"must be from 0 % to below 100 %, got {shown(value)}")
        return share
    return float(number(0, 0.999, closed=True, mend='for example "0.5 %"')(value))


def _accuracy(value: object) -> float:
    share = fraction(value)
    if share == 0:
        raise Bad("must be above 0: no sensor reaches it", 'for example "5 %"')
    return share


def _multiples(value: object) -> tuple[float, ...]:
    items = value if isinstance(value, list) else [value]
    if not 0 < len(items) <= MOST_MULTIPLES:
        raise Bad(f"must be 1 to {MOST_MULTIPLES} numbers, got {shown(value)}", "[1, 3]")
    return tuple(dict.fromkeys(number(0, 100)(item) for item in items))


@section
class PositionAccuracy:
    """Errors of a tracker along the axis of the test, as standard uncertainties."""

    #: Of its zero, the same in all rows of a test.
    offset_mm: Annotated[float, measured("length", closed=True)] = 0.0
    #: Of its scale, a share of the displacement.
    scale: Annotated[float, Reads(fraction)] = 0.0
    #: Of every row on its own.
    noise_mm: Annotated[float, measured("length", closed=True)] = 0.0


@section
class ForceAccuracy:
    """Errors of a force sensor, as standard uncertainties."""

    #: Of its zero, the same in all rows of a test.
    zero_N: Annotated[float, measured("force", closed=True)] = 0.0
    #: Of its scale, a share of the force.
    scale: Annotated[float, Reads(fraction)] = 0.0
    #: Of every row on its own.
    noise_N: Annotated[float, measured("force", closed=True)] = 0.0


@section
class Requirement:
    """What is asked of the constants, and how it is checked."""

    #: Wanted expanded uncertainty over the value.
    accuracy: Annotated[float, Reads(_accuracy)] = 0.05
    #: Coverage factor k: expanded over standard uncertainty (JCGM 100:2008, 6.2).
    coverage: Annotated[float, Reads(number(0, 10))] = 2.0
    #: Rows of the test, even in displacement, that enter the fit with one weight.
    points: Annotated[int, Reads(integer(2, 100_000))] = 100
    #: Tests of each Monte Carlo simulation; 0 for none.
    samples: Annotated[int, Reads(integer(0, 1_000_000))] = 200
    #: Multiples of the given errors at which one is made.
    multiples: Annotated[tuple[float, ...], Reads(_multiples)] = (1.0, 3.0)


# Read a file for ``study require``: a problem with its constants, two sensors, what is asked.

#: Tables that only this verb knows.
OWN = ("position", "force", "requirement", "predict")
#: Tables of the problem that the prediction may replace.
REPLACEABLE = ("specimen", "test", "model")


@dataclass(frozen=True)
class RequirementFile:
    """What a file for ``study require`` says."""

    name: str
    question: str
    seed: int
    #: The test that gives the constants, and the one whose force counts.
    fitted: CellProblem
    predicted: CellProblem
    position: PositionAccuracy
    force: ForceAccuracy
    #: Wanted accuracy, and how it is checked.
    requirement: Requirement

    @property
    def rows_mm(self) -> Array:
        """Displacements of the rows of the fitted test, even, the last one at its depth, (n,)."""
        n, depth = self.requirement.points, self.fitted.at().test.depth_mm
        return np.asarray(depth * np.arange(1, n + 1) / n)

    @property
    def farthest_mm(self) -> float:
        """Largest displacement that a tracker may tell."""
        error, depth = self.position, self.fitted.at().test.depth_mm
        beyond = np.hypot(np.hypot(error.offset_mm, error.noise_mm), error.scale * depth)
        return depth + REACH * float(beyond)

    def multiplied(self, multiple: float) -> RequirementFile:
        """Copy with all errors of both sensors so many times as large."""
        both = (
            replace(sensor, **{name: multiple * error for name, error in asdict(sensor).items()})
            for sensor in (self.position, self.force)
        )
        return replace(self, **dict(zip(("position", "force"), both, strict=True)))  # type: ignore[arg-type]


#: reads the tables of a problem, told as those of a file, with overrides laid over
ReadsProblem = Callable[[Mapping[str, object], str, Sequence[str]], CellProblem]


def load_requirement(
    path: str | Path, reads_problem: ReadsProblem, overrides: Sequence[str] = ()
) -> RequirementFile:
    """Load a file for ``study require``."""
    source = str(path)
    needed = "sensor requirements (TOML: a problem with [requirement])"
    tables = declaration.parse_toml(declaration.read_text(path, needed), source)
    rest = []
    for override in overrides:
        keys, value = declaration.parse_override(override)
        if keys[0] in (*OWN, "study"):
            declaration.set_value(tables, keys, value)
        else:
            rest.append(override)
    faults = Faults()
    sections = {name: tables.pop(name, {}) for name in OWN}
    position = declaration.read_table(PositionAccuracy, sections["position"], "position", faults)
    force = declaration.read_table(ForceAccuracy, sections["force"], "force", faults)
    sensors = declaration.read_table(Requirement, sections["requirement"], "requirement", faults)
    errors = [*asdict(position).values(), *asdict(force).values()]
    if not faults and not any(errors):
        mend = 'give one, for example [position] noise = "0.1 mm"'
        faults.add("position, force", "neither sensor has an error: nothing to propagate", mend)
    renamed = [Fault(f"{source}: {f.where}", f.rule, f.mend) for f in faults]

    def problem_of(tables: declaration.Table, overrides: Sequence[str]) -> CellProblem | None:
        """Resolve a problem; None, and its faults, where it has any."""
        try:
            return reads_problem(tables, source, overrides)
        except InputError as error:
            renamed.extend(error.faults)
            return None

    fitted = problem_of(tables, rest)
    predicted = None
    if fitted is not None and isinstance(sections["predict"], Mapping):
        others = _check_replaced(sections["predict"], source, rest, renamed)
        before = len(renamed)
        predicted = problem_of({**tables, **sections["predict"]}, others)
        for k, fault in enumerate(renamed[before:], before):
            where = fault.where.replace(": ", ": predict.", 1)
            renamed[k] = Fault(where, fault.rule, fault.mend)
    elif fitted is not None:
        renamed.append(Fault(f"{source}: predict", "must be a table", "write [predict.test]"))
    if renamed or fitted is None or predicted is None:
        raise InputError(dict.fromkeys(renamed))
    study = declaration.read_table(StudyTable, tables.get("study", {}), "study", Faults())
    name = study.name or default_name(source)
    return RequirementFile(
        name, study.question, study.seed, fitted, predicted, position, force, sensors
    )


def _check_replaced(
    table: declaration.Table, source: str, overrides: Sequence[str], faults: list[Fault]
) -> list[str]:
    """Check what ``[predict]`` replaces whole; overrides of the tables that stay."""
    for key in table:
        if key not in REPLACEABLE:
            mend = f"one of {', '.join(REPLACEABLE)}; the material is the fitted one"
            faults.append(Fault(f"{source}: predict.{key}", "unknown key", mend))
    return [o for o in overrides if o.split("=")[0].split(".")[0].strip() not in table]
