"""What a study file holds: its tables, declared once, and the frozen design that they make.

Values are in mm, N, MPa and deg. The tables of a problem are declared in
:mod:`study.simulation.problem_file` and in ``setup``, those of measured files in
:mod:`study.mechanics.measurement`; a :class:`Design` is made by :mod:`study.harness.design.load`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Literal

from study.external.forward_model import Value, value_unit
from study.external.parameters import (
    Constraint,
    is_parameter,
    parameter_key,
    parameters_from,
    stands_alone,
)
from study.ground.arrays import gathered
from study.ground.canonical import Keyed
from study.ground.contrast import Expected, Threshold
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
    table_of,
    texts,
)
from study.ground.diagnostics import Faults, Table, flatten
from study.ground.errors import Fault, InputError, nearest
from study.ground.units import split
from study.simulation import overlay
from study.simulation.cell import Case, Cell, Combination, Treatment, block_ids
from study.simulation.problem_file import Converge, ProblemFile, Report, Virtual
from study.simulation.resolve import Identification, resolve
from study.simulation.response import RESPONSES, SCORED, SIMULATED, is_of_material
from study.statistics.surfaces.surface_factors import InputDistribution, NumericFactor

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


# A loaded study.


@dataclass(frozen=True)
class Level:
    """One level of a factor: its label and the dotted keys that it lays over the file."""

    label: str
    settings: Table


@dataclass(frozen=True)
class Factor:
    """A factor and its levels; the name is a dotted key or a preset set.

    A factor written as a range has a ``span``; its levels are those that the design needs.
    """

    name: str
    levels: tuple[Level, ...]
    span: NumericFactor | None = None

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the levels, in order."""
        return tuple(level.label for level in self.levels)

    @property
    def keys(self) -> frozenset[str]:
        """Dotted keys that its levels lay over the file."""
        return frozenset(key for level in self.levels for key in level.settings)

    @property
    def settings(self) -> dict[str, float]:
        """Setting of every label of a range, in the unit of its span."""
        settings = {level.label: level.settings[self.name] for level in self.levels}
        return {
            label: split(value)[0] if isinstance(value, str) else float(str(value))
            for label, value in settings.items()
        }


@dataclass(frozen=True)
class Scheme(Keyed):
    """Which combinations of levels are run."""

    KEYS = "kind summary resolution defining_relation aliases"

    kind: str = "full"
    #: Index of the level of every factor, one tuple a cell; None for the full factorial.
    rows: tuple[tuple[int, ...], ...] | None = None
    summary: str = ""
    #: What it cannot tell apart, in words.
    aliases: tuple[str, ...] = ()
    #: Verified by brute force; None where nothing is aliased or the word has no meaning.
    resolution: int | None = None
    #: Such as ``"I = A:B:C"``.
    defining_relation: str = ""
    #: What it was made to tell apart; empty where its kind says so.
    terms: tuple[str, ...] = ()
    #: How cells are added while it runs.
    sequential: Sequential | None = None


@dataclass(frozen=True)
class Design:
    """A validated study."""

    name: str
    question: str
    #: The file's tables as written (strings with their units), overrides applied, dotted keys of
    #: ``[factors]`` and ``[uncertainty]`` joined; :func:`study.design.dump` writes it.
    config: Table
    #: What varies, what is left out, what is answered.
    factors: tuple[Factor, ...]
    exclusions: tuple[Exclusion, ...]
    responses: tuple[ResponseSpec, ...]
    #: Of every random draw of the study.
    seed: int
    #: Inputs that nobody measured.
    assumed: tuple[str, ...]
    #: Measured curves and the way to the constants, as the file itself says them.
    identification: Identification
    analysis: Analysis
    converge: Converge
    #: Standard uncertainty of inputs, in internal units, by dotted key.
    uncertainty: Mapping[str, float]
    report: Report
    #: Inequalities of parameters; cells that break one are left out.
    constraints: tuple[Constraint, ...] = ()
    #: Distributions of inputs that are ranges, by dotted key.
    inputs: Mapping[str, InputDistribution] = field(default_factory=dict)
    #: Which combinations of the levels are run.
    scheme: Scheme = field(default_factory=Scheme)
    #: What is computed several times, for an error term.
    replicates: Replicates = field(default_factory=Replicates)
    #: What is changed of a case without an answer, by its cause.
    retry: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    #: What the study's owner expected before it ran.
    expected: tuple[Expected, ...] = ()
    #: How carefully the curve of virtual specimens is solved.
    virtual: Virtual | None = None
    #: The file it was read from; no part of the study's identity.
    source: str = field(default="<string>", compare=False)
    #: The file's text, for the report; no part of the study's identity.
    text: str = field(default="", compare=False, repr=False)

    @cached_property
    def ranges(self) -> dict[str, NumericFactor]:
        """Ranges of the factors that are numbers."""
        return {f.name: f.span for f in self.factors if f.span is not None}

    @cached_property
    def lists(self) -> dict[str, tuple[str, ...]]:
        """Labels of the factors that are no ranges."""
        return {f.name: f.labels for f in self.factors if f.span is None}

    @property
    def asks_for_scores(self) -> bool:
        """Whether predicted curves are compared with measured ones."""
        return any(response.name in SCORED for response in self.responses)

    @property
    def asks_for_constants(self) -> bool:
        """Whether constants of the material are responses."""
        names = [response.name for response in self.responses]
        return not self.is_alone and any(map(is_of_material, names))

    @cached_property
    def is_alone(self) -> bool:
        """Whether it describes parameters alone, for a program or function of somebody else."""
        return stands_alone(self.config)

    @cached_property
    def is_measured(self) -> bool:
        """Whether the predicted curves of all cells stand beside measured ones."""
        return all(cell.cell.problem.measurements is not None for cell in self.treatments)

    @cached_property
    def combinations(self) -> tuple[tuple[Combination, tuple[Level, ...], str | None], ...]:
        """Labels and levels of every cell, and why it is left out; the last factor is fastest."""
        names = [factor.name for factor in self.factors]
        every = itertools.product(*(range(len(factor.levels)) for factor in self.factors))
        listed = []
        for row in self.scheme.rows or every:
            levels = tuple(f.levels[i] for f, i in zip(self.factors, row, strict=True))
            labels = {n: level.label for n, level in zip(names, levels, strict=True)}
            listed.append((Combination(labels), levels, self._why_excluded(labels, levels)))
        return tuple(listed)

    def _why_excluded(self, labels: Mapping[str, str], levels: Sequence[Level]) -> str | None:
        reason = next((e.why for e in self.exclusions if e.matches(labels)), None)
        if reason is not None or not self.constraints:
            return reason
        values = self._parameters_at(levels)
        try:
            broken = [constraint for constraint in self.constraints if not constraint.holds(values)]
        except Bad as bad:
            raise InputError(Fault("constraint", bad.rule, bad.mend)) from None
        return f"{broken[0].why} ({broken[0].rule})" if broken else None

    def _parameters_at(self, levels: Sequence[Level]) -> Mapping[str, Value]:
        """Values of the parameters of a cell; of faulty ones, told elsewhere, none."""
        first = table_of(self.config, "parameters")
        settings = {k: v for level in levels for k, v in level.settings.items() if is_parameter(k)}
        here = {key.partition(".")[2]: value for key, value in settings.items()}
        return parameters_from({**first, **here}, first, Faults())[0]

    @property
    def excluded(self) -> tuple[tuple[Combination, str], ...]:
        """Cells left out and why; they are not resolved, for they may be impossible."""
        return tuple((cell, why) for cell, _, why in self.combinations if why is not None)

    def resolved(self, levels: Sequence[Level], faults: Faults) -> Cell:
        """Resolve one cell, once where it is sound; faults name the keys of the merged file."""
        sound, level_ids = self._sound, tuple(map(id, levels))
        if level_ids in sound:
            return sound[level_ids]
        settings = {k: v for level in levels for k, v in level.settings.items()}
        tables = {k: v for k, v in self.config.items() if k in overlay.TABLES}
        cell_faults = Faults()
        cell = resolve(overlay.lay(tables, settings), self.config, self.converge, cell_faults)
        if not cell_faults:
            sound[level_ids] = cell
        for fault in cell_faults:
            faults.add(fault.where, fault.rule, fault.mend)
        return cell

    @cached_property
    def _sound(self) -> dict[tuple[int, ...], Cell]:
        """Cells that were resolved without a fault, by the levels, which are the design's own."""
        return {}

    @cached_property
    def treatments(self) -> tuple[Treatment, ...]:
        """Cells of the design without those left out."""
        faults = Faults()
        cells = tuple(
            Treatment(combination.levels, self.resolved(levels, faults))
            for combination, levels, why in self.combinations
            if why is None
        )
        if faults:
            raise InputError(faults)
        return cells

    @property
    def duplicates(self) -> tuple[tuple[Treatment, ...], ...]:
        """Groups of two or more cells with different labels and the same content."""
        groups = gathered((t.cell.content_key, t) for t in self.treatments).values()
        return tuple(tuple(group) for group in groups if len(group) > 1)

    @property
    def roles(self) -> dict[str, str]:
        """Role of every factor: as declared, else unknown where all its keys are assumed."""
        usual: dict[str, str] = {}
        assumed = tuple(f"{key}." for key in self.assumed)
        for factor in self.factors:
            covered = [f"{key}.".startswith(assumed) for key in factor.keys]
            usual[factor.name] = "unknown" if covered and all(covered) else "choice"
        return usual | dict(self.analysis.roles)


# Cells -> cases: every cell in every block, named by its content.

MAX_CASES = 100_000


def cases(design: Design, blocks: Sequence[str] = ()) -> tuple[Case, ...]:
    """Every cell in every block; one case a cell where there are no blocks."""
    if len(set(blocks)) < len(blocks):
        raise InputError(Fault("measurements.block", f"labels must be distinct, got {blocks}"))
    cells = design.treatments
    if len(cells) * max(1, len(blocks)) > MAX_CASES:
        rule = f"{len(cells)} cells in {len(blocks)} blocks are more than {MAX_CASES} cases"
        raise InputError(Fault("factors", rule, "use fewer levels, or several studies"))
    places = tuple(blocks) or (None,)
    return tuple(
        Case(treatment.levels, treatment.cell, block, name)
        for treatment in cells
        for block, name in zip(places, block_ids(treatment.cell.document(), places), strict=True)
    )
