"""The study file: every table with fixed keys, declared once; values in mm, N, MPa and deg.

The tables of a problem are declared in :mod:`study.simulation.problem_file` and in ``setup``,
those of measured files in :mod:`study.mechanics.measurement`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal

from study.external.forward_model import value_unit
from study.external.parameters import Constraint, parameter_key
from study.ground.contrast import Threshold
from study.ground.declaration import (
    AsWritten,
    Bad,
    Length,
    Reads,
    Rows,
    as_written,
    choice,
    integer,
    number,
    reason,
    section,
    shown,
    texts,
)
from study.ground.diagnostics import flatten
from study.ground.errors import nearest
from study.simulation.problem_file import ProblemFile, Virtual
from study.simulation.response import RESPONSES, SIMULATED

MAX_RESPONSES = 50
MAX_EXCLUSIONS = 4096
#: cells of a design that draws them
MAX_RUNS = 1024
#: terms that may be declared primary before the run
MOST_PRIMARY = 3
#: what a factor is: decided by the analyst; a part of the question, answered at each level; a
#: fact that nobody measured, never recommended
ROLES = ("choice", "condition", "unknown")
RESPONSES_MEND = '[[response]] with name = "relative_rms_force_error"'
#: least and most meshes of a cell (below five their scatter is not known well enough), and
#: resamples of a fit (the scatter of 20 is known to 16 %, of 200 to 5 %)
SEEDS = (5, 1000)
MOST_SEEDS = 10_000
RESAMPLES = (20, 10_000)
#: what may be changed of a case that has no answer
SMALLER_STEPS = "smaller-steps"
FINER_MESH = "finer-mesh"
LONGER_LIMIT = "longer-limit"
MORE_MEMORY = "more-memory"
#: causes of which something can be tried, and what may help
REMEDIES = {
    "not-converged": (SMALLER_STEPS, FINER_MESH),
    "unstable": (SMALLER_STEPS, FINER_MESH),
    "mesh-failed": (FINER_MESH,),
    "timeout": (LONGER_LIMIT,),
    "out-of-memory": (MORE_MEMORY,),
    "crashed": (MORE_MEMORY,),
}


def _response_name(value: object) -> str:
    """Read a name; whether there is such a response is asked where the forward model is known."""
    if not isinstance(value, str) or not value.replace("-", "_").isidentifier():
        valid = (*RESPONSES, *SIMULATED, "or a constant such as C10")
        raise Bad(f"unknown response {shown(value)}", nearest(str(value)[:80], valid))
    return value


_seed_key = partial(parameter_key, 'key = "parameters.seed"')


def _count(low: int, high: int, why: str, value: object) -> int:
    """Read a number of repeats; below ``low`` the reason is told."""
    count = integer(0, high)(value)
    if count < low:
        raise Bad(f"must be at least {low}, got {shown(value)}: with fewer {why}")
    return count


_seeds = partial(_count, *SEEDS, "the scatter of the mesh is not known")
_resamples = partial(_count, *RESAMPLES, "the scatter of the fits is not known")


def _primary(value: object) -> tuple[str, ...]:
    """Read the terms that were declared before the run; three at most, or they are no choice."""
    terms = texts("terms", "material")(value)
    if len(terms) > MOST_PRIMARY:
        raise Bad(f"has {len(terms)} terms, at most {MOST_PRIMARY} are a choice before the run")
    return terms


def _roles(value: object) -> tuple[tuple[str, str], ...]:
    """Read the role of every factor that has one."""
    if not isinstance(value, Mapping):
        mend = 'for example { plates = "unknown", range = "condition" }'
        raise Bad(f"must be a table of factors, got {shown(value)}", mend)
    return tuple((name, choice(*ROLES)(role)) for name, role in flatten(value).items())


def _retry(value: object) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Read what is tried of every cause."""
    if not isinstance(value, Mapping):
        mend = f'for example {{ not-converged = ["{SMALLER_STEPS}", "{FINER_MESH}"] }}'
        raise Bad(f"must be a table of causes, got {shown(value)}", mend)
    read_causes = []
    for cause, remedies in value.items():
        read = choice(*REMEDIES[choice(*REMEDIES)(cause)])
        changes = remedies if isinstance(remedies, list) else [remedies]
        read_causes.append((cause, tuple(dict.fromkeys(map(read, changes)))))
    return tuple(read_causes)


@section
class Replicates:
    """What is computed several times for an error term; at most one of the two."""

    mesh_seeds: Annotated[int, Reads(_seeds)] = 0
    noise: Annotated[int, Reads(_resamples)] = 0
    #: Parameter that is the seed of a stochastic simulation, and how many a cell has.
    key: Annotated[str | None, Reads(_seed_key)] = None
    n: Annotated[int, Reads(integer(2, MOST_SEEDS))] = 2


def _added(value: object) -> tuple[tuple[float, ...], ...]:
    """Read cells that a run has added, as shares of every range."""
    if not isinstance(value, list):
        raise Bad(f"must be a list of cells, got {shown(value)}", "leave it to `study run`")
    share = number(0.0, 1.0, closed=True)
    return tuple(tuple(share(x) for x in (c if isinstance(c, list) else [c])) for c in value)


#: number of cells, as a kind of design asks for it
CellCount = Annotated[int, Reads(integer(2, MAX_RUNS), mend="say how many, for example 32")]


@section
class Sequential:
    """How cells are added to a design while it runs."""

    #: Cells of the Latin hypercube that it begins with, equally many at every combination of the
    #: factors that are no ranges.
    start: CellCount
    #: Most cells in all.
    budget: CellCount
    kind: Literal["adaptive"] = "adaptive"
    #: Cells added at a time; it decides the result, the number of workers does not.
    batch: Annotated[int, Reads(integer(1, 100))] = 4
    #: What ends it before the budget does: every response has this Q2, or every factor a verdict.
    until: Annotated[str, Reads(choice("q2", "verdict"))] = "q2"
    #: Leave-one-out Q2 that is enough.
    q2: Annotated[float, Reads(number(0.5, 1.0))] = 0.95
    #: Of the draw; that of ``[study]`` by default.
    seed: Annotated[int, Reads(integer(0, 2**32 - 1))] = None  # type: ignore[assignment]
    #: Cells that a run has added: the share of every factor's range, in the order of the factors.
    added: Annotated[tuple[tuple[float, ...], ...], Reads(_added)] = ()


@section
class Execution:
    """What is tried of a case without an answer, by its cause; the report lists such cases."""

    retry: Annotated[tuple[tuple[str, tuple[str, ...]], ...], Reads(_retry)] = ()


#: Terms of an analysis: all, those up to an order, or those listed, ``"A"`` or ``"A:B"``.
Terms = str | int | tuple[str, ...]


@section
class Analysis:
    """How the table of cases is analyzed; ``model`` is by default what the design can tell."""

    model: Annotated[Terms, as_written()] = None  # type: ignore[assignment]
    #: Of the sums of squares.
    type: Annotated[str, Reads(choice("I", "II", "III"))] = "II"
    #: What effects are compared with.
    error: Annotated[str, Reads(choice("auto", "pooled", "own", "replicates"))] = "auto"
    alpha: Annotated[float, Reads(number(0, 1))] = 0.05
    #: What a factor is to the question (:data:`ROLES`).
    roles: Annotated[tuple[tuple[str, str], ...], Reads(_roles)] = ()
    #: Tests that Holm's adjustment takes together: of one response, or of all.
    family: Annotated[str, Reads(choice("response", "study"))] = "response"
    #: Terms declared before the run, which then are the family; all terms where it is empty.
    primary: Annotated[tuple[str, ...], Reads(_primary)] = ()
    #: What is fitted over the factors that are ranges.
    surface: Annotated[str, Reads(choice("auto", "quadratic", "emulator", "none"))] = "auto"
    #: Differences of two settings that every response is asked for.
    contrasts: Annotated[tuple[str, ...], Reads(texts("contrasts", "stiff - soft"))] = ()


@section
class ResponseSpec:
    """One ``[[response]]``: ``practical`` in its unit, a force or stiffness at ``displacement``."""

    name: Annotated[str, Reads(_response_name, mend="for example relative_rms_force_error")]
    displacement: Length | None = None
    #: Smallest difference that matters, in its unit or as a share: "0.05 N", "2 pp", "5 % of mean".
    practical: Annotated[Threshold | None, as_written()] = None
    #: Scale on which it is analyzed.
    transform: Annotated[str, Reads(choice("none", "log"))] = "none"
    #: Of a value that a Python function returns, or a program that says none.
    unit: Annotated[str, Reads(value_unit)] = None  # type: ignore[assignment]


@section
class Exclusion:
    """One ``[[exclude]]``: labels of levels by factor, and why their cells are left out."""

    why: Annotated[str, Reads(reason, mend='say why: why = "..."')]
    when: Annotated[Mapping[str, tuple[str, ...]], as_written('when = { material = "ogden-1" }')]

    def matches(self, levels: Mapping[str, str]) -> bool:
        """Whether a cell is left out: every factor named takes one of its labels."""
        return all(levels[name] in labels for name, labels in self.when.items())


_Responses = Annotated[tuple[ResponseSpec, ...], Rows(1, MAX_RESPONSES, RESPONSES_MEND)]
_Exclusions = Annotated[tuple[Exclusion, ...], Rows(0, MAX_EXCLUSIONS, "write [[exclude]]")]
_Constraints = Annotated[tuple[Constraint, ...], Rows(0, MAX_EXCLUSIONS, "write [[constraint]]")]


@section
class DesignFile(ProblemFile):
    """A file of a study. Tables that cells may vary are read for each of them."""

    presets: AsWritten = None
    factors: AsWritten = None
    design: AsWritten = None
    exclude: _Exclusions = ()
    measurements: AsWritten = None
    markers: AsWritten = None
    calibration: AsWritten = None
    forward: AsWritten = None
    parameters: AsWritten = None
    constraint: _Constraints = ()
    response: _Responses = ()
    analysis: Analysis = Analysis()
    replicates: Replicates = Replicates()
    execution: Execution = Execution()
    expected: AsWritten = None
    virtual: Virtual | None = None
