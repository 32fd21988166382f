"""What a study file holds and asks: its tables, declared once, its factors, the frozen design.

Values are in mm, N, MPa and deg. The tables of a problem are declared in
:mod:`study.simulation.problem_file` and in ``setup``, those of measured files in
:mod:`study.mechanics.measurement`; a :class:`Design` is made by :mod:`study.harness.design.load`.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Literal, cast

import numpy as np

from study.external.forward_model import (
    TAKEN,
    Constraint,
    Value,
    is_parameter,
    number_and_unit,
    number_in,
    parameter_key,
    parameter_name,
    parameters_from,
    stands_alone,
    value_unit,
)
from study.ground import units
from study.ground.arrays import gathered
from study.ground.canonical import Keyed
from study.ground.contrast import Expected, Threshold
from study.ground.declaration import (
    MAX_NAME,
    AsWritten,
    Bad,
    Faults,
    Length,
    Reads,
    Rows,
    Table,
    as_written,
    choice,
    entries,
    flatten,
    integer,
    is_known,
    noted,
    number,
    quantity,
    quoted,
    quoted_path,
    read_table,
    reason,
    section,
    shown,
    table_of,
    text,
    texts,
    with_values,
    written_keys,
)
from study.ground.declaration import name as read_name
from study.ground.errors import Fault, InputError, UnitError, nearest
from study.ground.tabular import NUMBER
from study.ground.units import parse, split
from study.harness.design.generators import Word, model_columns
from study.simulation.cell import Case, Cell, Combination, Treatment, block_ids
from study.simulation.problem_file import (
    ANY,
    PLACES,
    TABLES,
    VARYING,
    WHOLE,
    Converge,
    Identification,
    ProblemFile,
    Report,
    Virtual,
    dimension_of,
    lay,
    may_vary,
    resolve,
    suggestion,
    value_at,
)
from study.simulation.response import (
    AT_DISPLACEMENT,
    RESPONSES,
    SCORED,
    SIMULATED,
    is_of_material,
    is_simulated,
    response_unit,
)
from study.statistics.surfaces.surface_factors import (
    DISTRIBUTION_KEYS,
    PARAMETERS,
    InputDistribution,
    NumericFactor,
)

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
        tables = {k: v for k, v in self.config.items() if k in TABLES}
        cell_faults = Faults()
        cell = resolve(lay(tables, settings), self.config, self.converge, cell_faults)
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


# Factors, preset sets and exclusions of a design, as they are written.


MAX_FACTORS = 20
MAX_LEVELS = 100
#: set -> label -> dotted keys laid over the file
Presets = Mapping[str, Mapping[str, Table]]


def presets_from(table: object, faults: Faults) -> Presets:
    """Read ``[presets.SET.LEVEL]``: dotted keys of the whole file for every level."""
    # A set named like a table of the file is laid over that table.
    presets: dict[str, dict[str, Table]] = {}
    for set_name, levels in entries(table, "presets", faults).items():
        where = f"presets.{quoted(set_name)}"
        if not _readable(set_name, where, faults):
            continue
        prefix = f"{set_name}." if set_name in TABLES else ""
        presets[set_name] = {
            label.strip(): _settings(level, prefix, f"{where}.{quoted(label)}", faults)
            for label, level in entries(levels, where, faults).items()
            if _readable(label, f"{where}.{quoted(label)}", faults)
        }
    return presets


def _settings(level: object, prefix: str, where: str, faults: Faults) -> Table:
    settings = flatten(entries(level, where, faults), prefix, WHOLE)
    for key in [key for key in settings if not may_vary(key)]:
        inner = quoted_path(key.removeprefix(prefix))
        faults.add(f"{where}.{inner}", "unknown key", suggestion(key))
        del settings[key]
    return settings


def _readable(value: str, where: str, faults: Faults) -> bool:
    try:
        return bool(read_name(value))
    except Bad as bad:
        faults.add(where, f"this name {bad.rule}", bad.mend)
        return False


def factors_from(table: object, presets: Presets, faults: Faults) -> tuple[Factor, ...]:
    """Read ``[factors]`` with the levels of every factor; a faulty factor is left out."""
    written = entries(table, "factors", faults)
    if not written:
        faults.add("factors", "is missing", 'for example model.space = ["axisymmetric", "3d"]')
    if len(written) > MAX_FACTORS:
        faults.add("factors", f"has {len(written)} factors, the limit is {MAX_FACTORS}")
        return ()
    parted = [key.rpartition(".") for key in written]
    for key in sorted(set(written) & {start for start, _, end in parted if end in RANGE_KEYS}):
        rule = "stands twice, with levels and with an end of a range"
        faults.add(f"factors.{quoted_path(key)}", rule, "keep one of the two")
    factors: list[Factor] = []
    for key, value in grouped(written).items():
        if isinstance(value, Mapping) and key not in presets and may_vary(key):
            factors += _range(key, value, f"factors.{quoted_path(key)}", faults)
        elif levels := _levels(key, value, presets, faults):
            factors.append(Factor(key, levels))
    _check_overlap(factors, faults)
    return tuple(factors)


def _levels(key: str, value: object, presets: Presets, faults: Faults) -> tuple[Level, ...]:
    where = f"factors.{quoted_path(key)}"
    if key not in presets and not may_vary(key):
        table, _, rest = key.partition(".")
        if table == "parameters":  # whose names are the user's own
            noted(parameter_name, rest, where, faults)
            return ()
        valid = [*presets, *(k for k in VARYING if k.partition(".")[0] == table)]
        mend = nearest(key[:MAX_NAME], valid) if valid else suggestion(key)
        if table in written_keys(DesignFile) and table not in TABLES:
            mend = f"[{table}] is the same in every cell; keys of these may vary: "
            mend += ", ".join(TABLES)
        faults.add(where, "is neither a key that may vary nor a preset set", mend)
        return ()
    if not isinstance(value, list):
        faults.add(where, f"must be a list of levels, got {shown(value)}", "write [.., ..]")
        return ()
    if not 2 <= len(value) <= MAX_LEVELS:
        rule = f"needs 2 to {MAX_LEVELS} levels, got {len(value)}"
        faults.add(where, rule, "a factor with one level is no factor: set the key itself")
        return ()
    levels: dict[str, Level] = {}
    for i, raw in enumerate(value):
        at, label = f"{where}[{i}]", noted(level_label, raw, f"{where}[{i}]", faults)
        if label in levels:
            rule = f"levels must be distinct, got {label!r} again ({shown(raw)})"
            faults.add(at, rule, "leave one out")
        elif label is not None and label not in presets.get(key, {label}):
            mend = nearest(label, presets[key])
            faults.add(at, f"no preset {label!r} in presets.{key}", mend)
        elif label is not None:
            levels[label] = Level(label, presets[key][label] if key in presets else {key: raw})
    return tuple(levels.values())


def level_label(raw: object) -> str:
    """Label of a level's value: ``"1"``, ``1`` and ``1.0`` have the same.

    Examples
    --------
    >>> level_label(1.0), level_label(" 1"), level_label(["1 %", "20 %"])
    ('1', '1', '1 %, 20 %')
    """
    if isinstance(raw, bool):
        return "true" if raw else "false"
    if isinstance(raw, str):
        return read_name(raw)
    if isinstance(raw, (int, float)) and math.isfinite(raw):
        return repr(raw).removesuffix(".0")
    if isinstance(raw, list) and raw and len(raw) <= 9:
        return read_name(", ".join(level_label(item) for item in raw))
    mend = "give it a name: [presets.SET.LEVEL]" if isinstance(raw, Mapping) else ""
    raise Bad(f"is no level, got {shown(raw)}", mend)


def _check_overlap(factors: Sequence[Factor], faults: Faults) -> None:
    """Two factors that set one key would hide one another."""
    owner: dict[str, str] = {}
    for factor in factors:
        slots = set()
        for key in factor.keys:  # or the first of the keys that cannot stand beside it
            table, _, last = key.rpartition(".")
            alternatives = PLACES[table].alternatives if table in PLACES else ()
            slots.add(f"{table}.{alternatives[0]}" if last in alternatives else key)
        for slot in slots:
            if owner.setdefault(slot, factor.name) != factor.name:
                rule = f"sets {slot}, which the factor {owner[slot]!r} sets too"
                faults.add(f"factors.{factor.name}", rule, "let one of the two set it")


def exclusions_from(
    tables: Sequence[Exclusion],
    factors: Sequence[Factor],
    declared: Collection[str],
    faults: Faults,
) -> tuple[Exclusion, ...]:
    """Say of every ``[[exclude]]`` which cells it leaves out."""
    by_name = {factor.name: factor for factor in factors}
    exclusions = []
    for i, table in enumerate(tables):
        before, where = len(faults), f"exclude[{i}].when"
        if not is_known(table.why, table.when):
            continue
        written, labels = entries(table.when, where, faults), {}
        if isinstance(table.when, Mapping) and not written:
            faults.add(where, "is empty: it would leave out every cell")
        for key, raw in written.items():
            if key in by_name:
                labels[key] = noted(partial(_chosen, by_name[key]), raw, f"{where}.{key}", faults)
            elif key not in declared:
                faults.add(f"{where}.{quoted(key)}", "unknown key", nearest(key, declared))
        if faults.mentions == before:
            exclusions.append(with_values(table, when=labels))
    return tuple(exclusions)


def _chosen(factor: Factor, raw: object) -> tuple[str, ...]:
    """Labels of the levels of a factor that one label, or a list of labels, names."""
    items = raw if isinstance(raw, list) and raw else [raw]
    return tuple(dict.fromkeys(known_level(item, factor) for item in items))


def known_level(raw: object, factor: Factor) -> str:
    """Label of a level, which the factor must have."""
    label = level_label(raw)
    if label not in factor.labels:
        raise Bad(f"no level {label!r} of {factor.name!r}", nearest(label, factor.labels))
    return label


ENDS = ("low", "high")
RANGE_KEYS = (*ENDS, "scale")
SCALES = ("linear", "log")
_QUANTITY = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(\S.*?)\s*")


def grouped(table: Table, parts: Collection[str] = RANGE_KEYS) -> dict[str, object]:
    """Join the keys of a range or a distribution, which joining dotted keys took apart, to ``KEY``.

    Examples
    --------
    >>> grouped({"a.low": 1, "a.high": 2, "b": [3, 4]})
    {'a': {'low': 1, 'high': 2}, 'b': [3, 4]}
    """
    joined: dict[str, object] = {}
    ends: dict[str, dict[str, object]] = {}
    for key, value in table.items():
        name, _, end = key.rpartition(".")
        if name and end in parts and not may_vary(key):
            joined[name] = ends.setdefault(name, {})
            ends[name][end] = value
        else:
            joined[key] = value
    return joined


def set_whole(table: Table, key: str, value: object) -> dict[str, object]:
    """Copy of a table with a key set, in the place of its old value or of the parts of a range."""
    old = {key, *(f"{key}.{part}" for part in (*RANGE_KEYS, *DISTRIBUTION_KEYS))}
    copied: dict[str, object] = {}
    for old_key, old_value in table.items():
        copied |= {key: value} if old_key in old else {old_key: old_value}
    return {**copied, key: value}


def _range(key: str, value: Table, where: str, faults: Faults) -> list[Factor]:
    """Factor of a range, with its two ends as levels; none where it is faulty."""
    dimension = dimension_of(key)
    if dimension is None:
        faults.add(where, "is no number, so it has no range", "list its levels: [.., ..]")
        return []
    missing = [end for end in ENDS if end not in value]
    if missing:
        faults.add(where, f"has no {missing[0]}", "write { low = .., high = .. }")
        return []
    scale = noted(choice(*SCALES), value.get("scale", "linear"), f"{where}.scale", faults)
    log = scale == "log"
    span = noted(
        lambda _: _span(key, value["low"], value["high"], dimension, log), value, where, faults
    )
    return [] if span is None else [Factor(key, levels_at(span, (0.0, 1.0)), span)]


def _span(name: str, low: object, high: object, dimension: str, log: bool) -> NumericFactor:
    (first, unit), (last, other) = _end(low, dimension), _end(high, dimension)
    if unit != other:
        raise Bad(f"mixes {unit!r} and {other!r}", "write both ends in one unit")
    if not first < last:
        mend = "exchange low and high" if last < first else "give two ends that differ"
        raise Bad(f"must rise, got {shown(low)} to {shown(high)}", mend)
    if log and first <= 0:
        rule = f"has a logarithm of positive numbers alone, got {shown(low)}"
        raise Bad(rule, 'begin above 0, or leave scale = "log" out')
    return NumericFactor(name, first, last, log, unit)


def _end(raw: object, dimension: str) -> tuple[float, str]:
    """Value and unit of one end, the unit as written."""
    if dimension == "number":
        return number()(raw), ""
    if dimension == ANY:
        return number_and_unit(raw)
    parse(raw, dimension)
    match = _QUANTITY.fullmatch(str(raw))
    if match is None:
        raise Bad(f"must be a number and its unit, got {shown(raw)}", 'for example "28 mm"')
    return float(match[1]), match[2]


def levels_at(span: NumericFactor, shares: Sequence[float]) -> tuple[Level, ...]:
    """Levels at shares of a range, 0 its low and 1 its high end, in as few digits as tell them.

    Examples
    --------
    >>> [level.label for level in levels_at(NumericFactor("a", 1.0, 2.0, unit="mm"), [0, 1 / 3, 1])]
    ['1 mm', '1.3333 mm', '2 mm']
    >>> [level.label for level in levels_at(NumericFactor("a", 1.0, 100.0, log=True), [0, 0.5, 1])]
    ['1', '10', '100']
    """
    values = [span.at(share) for share in shares]
    for digits in range(1, 17):
        texts = [f"{value:.{digits}g}" for value in values]
        near = all(math.isclose(float(t), v, rel_tol=0, abs_tol=span.step(v))
                   for t, v in zip(texts, values, strict=True))  # fmt: skip
        if near and len(set(texts)) == len(set(values)):
            break
    return tuple(_range_level(span.name, _plain(text), span.unit) for text in texts)


def _plain(text: str) -> str:
    """Write a number of few digits without a power of ten, unless it is long: 1e+02 is 100."""
    return f"{float(text):g}" if "e" in text and float(f"{float(text):g}") == float(text) else text


def _range_level(key: str, text: str, unit: str) -> Level:
    written = f"{text} {unit}" if unit else float(text)
    return Level(f"{text} {unit}".strip(), {key: written})


def setting_in(factor: Factor, raw: object) -> Level:
    """Level of a factor with a range at one setting, as it is written: a number with its unit."""
    span = cast("NumericFactor", factor.span)
    value, unit = _end(raw, dimension_of(factor.name) or "number")
    if unit != span.unit:
        raise Bad(f"{shown(raw)} is not in {span.unit!r}, the unit of its range")
    if not span.low <= value <= span.high:
        raise Bad(f"{shown(raw)} lies outside {span.low:g} to {span.high:g}, its range")
    return _range_level(factor.name, level_label(value), unit)


# The tables ``[[response]]``: what is answered, and the smallest difference that matters.

_DIMENSION = {
    "N": "force",
    "kPa": "pressure",
    "s": "time",
    "mm": "length",
    "N/mm": "stiffness",
    "N mm": "work",
    "mm^2": "area",
}


def responses_from(
    tables: Sequence[ResponseSpec], declared: Mapping[str, str], alone: bool, faults: Faults
) -> tuple[ResponseSpec, ...]:
    """Responses with their units; a faulty one has no name.

    ``declared`` has the units of the values that a program leaves; a function of parameters alone
    may return others, whose unit stands in the table of the response.
    """
    responses = [
        _response(table, f"response[{i}]", declared, alone, faults)
        for i, table in enumerate(tables)
    ]
    given = [response.name for response in responses if response.name]
    for name in sorted({n for n in given if given.count(n) > 1}):
        faults.add("response", f"{name} stands {given.count(name)} times", "once is enough")
    return tuple(responses)


def _response(
    table: ResponseSpec, where: str, declared: Mapping[str, str], alone: bool, faults: Faults
) -> ResponseSpec:
    name, unit = _name(table, where, faults), None
    if name in declared:
        unit = declared[name]
    elif name and (not alone or is_simulated(name) or name == "seconds"):
        unit = response_unit(name)
        if unit is None:
            valid = (*declared, *RESPONSES, *SIMULATED, "or a constant such as C10")
            rule = f"unknown response {shown(name)}"
            faults.add(f"{where}.name", rule, nearest(name[:80], valid))
            name = ""
    elif name in TAKEN:
        rule = f"{name!r} is a column of the table of cases"
        faults.add(f"{where}.name", rule, f"call it, for example, {name}_value")
        name = ""
    if is_known(table.unit) and name:
        if unit is not None and unit != table.unit:
            rule = f"{name} is in {unit or 'no unit'}, not in {table.unit or 'no unit'}"
            faults.add(f"{where}.unit", rule, "leave it out, or name the value's own unit")
        unit = table.unit
    unit, practical = unit or "", None
    if name and table.practical is not None:
        read = partial(_practical, unit)
        practical = noted(read, table.practical, f"{where}.practical", faults)
    return with_values(table, name=name, unit=unit, practical=practical)


def _name(table: ResponseSpec, where: str, faults: Faults) -> str:
    """Name of a response; one at a displacement carries it, so that every table says it."""
    name, displacement_mm = table.name or "", table.displacement
    if name in AT_DISPLACEMENT:
        at = f"{where}.displacement"
        if displacement_mm is None:
            if all(fault.where != at for fault in faults):
                faults.add(at, "is missing", 'for example displacement = "2 mm"')
            return ""
        return f"{name}_{displacement_mm:g}_mm"
    if name and displacement_mm is not None:
        rule = f"{name} is not taken at a displacement"
        mend = f"leave it out, or ask for {' or '.join(AT_DISPLACEMENT)}"
        faults.add(f"{where}.displacement", rule, mend)
    return name


def _practical(unit: str, value: object) -> Threshold:
    """Read the smallest difference that matters, in the response's unit or "5 % of mean"."""
    example = {"%": "2 pp", "": "0.1"}.get(unit, f"0.05 {unit}")
    mend = f'write, for example, "{example}" or "5 % of mean"'
    if unit == "" and isinstance(value, str) and NUMBER.fullmatch(value.strip()):
        value = float(value)
    if unit == "" and isinstance(value, (int, float)):
        return Threshold(number(0)(value))
    if not isinstance(value, str):
        raise Bad(f"needs a unit, got {shown(value)}", mend)
    try:
        amount, written = units.split(value)
    except UnitError as error:
        raise Bad(error.faults[0].rule, mend) from error
    if amount <= 0:
        raise Bad(f"must be positive, got {shown(value)}", mend)
    if written == "% of mean":
        return Threshold(amount / 100, relative=True)
    if unit == "%" and written == "pp":
        return Threshold(amount)
    if unit == "%":
        raise Bad(f"is not in percentage points, got {shown(value)}", mend)
    if unit not in _DIMENSION:
        return Threshold(number_in(value, unit))
    inside = units.parse(value, _DIMENSION[unit])
    return Threshold(1000.0 * inside if unit == "kPa" else inside)


# Table ``[uncertainty]``: standard uncertainties of inputs, and distributions over ranges.
#     [uncertainty]
#     specimen.radius = "0.1 mm"         # a standard uncertainty: normal about the file's value
#     material.C10 = { distribution = "normal", mean = "7 kPa", sd = "0.5 kPa" }
#     material.C20 = { distribution = "lognormal", median = "1 kPa", factor = 1.3 }
#     specimen.height = { distribution = "uniform", low = "19 mm", high = "21 mm" }
#     test.indenter.tip_radius = { distribution = "triangular", low = .., mode = .., high = .. }

#: most of a distribution that may lie outside of the range that is run, and is cut off
MOST_OUTSIDE = 0.05

_EXAMPLE = '{ distribution = "normal", mean = "7 kPa", sd = "0.5 kPa" }'


def uncertainty_from(
    table: object, factors: Sequence[Factor], config: Table, faults: Faults
) -> tuple[dict[str, float], dict[str, InputDistribution]]:
    """Read ``[uncertainty]``, dotted keys already joined."""
    plain: dict[str, float] = {}
    distributions: dict[str, InputDistribution] = {}
    spans = {factor.name: factor.span for factor in factors if factor.span is not None}
    for key, raw in grouped(entries(table, "uncertainty", faults), DISTRIBUTION_KEYS).items():
        where, kind, span = f"uncertainty.{key}", dimension_of(key), spans.get(key)
        if kind is None:
            faults.add(where, "names no input with a value", suggestion(key))
            continue
        if isinstance(raw, Mapping):
            read = _distribution(key, raw, kind, span, list(spans), faults)
        else:
            in_range = _number_of("sd", kind, "" if span is None else span.unit)
            read_size = in_range if kind in ("number", ANY) else quantity(kind)
            size, read = noted(read_size, raw, where, faults), None
            if size is not None:
                plain[key] = size
            if size is not None and span is not None:
                about = usual_value(key, span, config), in_range(raw)
                read = InputDistribution("normal", about, span.low, span.high)
        if read is not None and read.outside > MOST_OUTSIDE:
            rule = (
                f"{100 * read.outside:.0f} % of it lies outside the range that is run, "
                f"{read.low:g} to {read.high:g}"
            )
            faults.add(where, rule, "widen the range in [factors], or narrow the distribution")
        elif read is not None:
            distributions[key] = read
    return plain, distributions


def _distribution(
    key: str,
    raw: Table,
    kind: str,
    span: NumericFactor | None,
    ranges: Sequence[str],
    faults: Faults,
) -> InputDistribution | None:
    where = f"uncertainty.{key}"
    if span is None:
        rule = "has a distribution and is no range of [factors], which alone a surface knows"
        mend = nearest(key, ranges) if ranges else "give it a range, or a standard uncertainty"
        faults.add(where, rule, mend)
        return None
    word = noted(choice(*PARAMETERS), raw.get("distribution"), f"{where}.distribution", faults)
    if word is None:
        return None
    needed = PARAMETERS[word]
    for name in (n for n in needed if n not in raw):
        faults.add(f"{where}.{name}", "is missing", f"for example {_EXAMPLE}")
    for name in (n for n in raw if n not in (*needed, "distribution")):
        rule = f"is no number of a {word} distribution"
        faults.add(f"{where}.{name}", rule, nearest(name, needed))
    if set(raw) != {"distribution", *needed}:
        return None
    values = [
        noted(_number_of(name, kind, span.unit), raw[name], f"{where}.{name}", faults)
        for name in needed
    ]
    nums = tuple(value for value in values if value is not None)
    if len(nums) < len(needed):
        return None
    if word in ("uniform", "triangular") and (list(nums) != sorted(nums) or nums[0] == nums[-1]):
        faults.add(where, f"must rise, got {', '.join(shown(raw[n]) for n in needed)}",
                   "from low to high")  # fmt: skip
        return None
    return InputDistribution(word, nums, span.low, span.high)


def _number_of(name: str, kind: str, unit: str) -> Callable[[object], float]:
    """Reader of a number of a distribution over a range of some dimension, in the range's unit."""
    if name == "factor":
        return number(1.0)
    low = 0.0 if name in ("sd", "median") else -math.inf
    if kind == "number":
        return number(low)

    def read(value: object) -> float:
        if kind == ANY:
            size = number_in(value, unit)
        else:
            size = units.parse(value, kind) / units.parse(f"1 {unit}", kind)
        if size <= low:
            raise Bad(f"must be above 0, got {shown(value)}")
        return size

    return read


def usual_value(key: str, span: NumericFactor, config: Table) -> float:
    """Value that a file gives to a range beside its ends, else the middle of the range."""
    node = value_at(config, key)
    middle = span.at(0.5)
    if isinstance(node, bool) or not isinstance(node, str | int | float):
        return middle
    try:
        value = _number_of("mean", dimension_of(key) or "number", span.unit)(node)
    except (UnitError, ValueError):  # told where the value stands
        return middle
    return value if span.low <= value <= span.high else middle


# What was expected before the study ran, so that the report can say whether it came true.

MAX_EXPECTED = 50


@section
class Expectation:
    """One ``[[expected]]``: who said it, and of which response; its kind has keys besides."""

    source: Annotated[str, Reads(text)] = ""
    response: AsWritten = None


#: word for every level of a material factor but the linear one
HYPERELASTIC = "hyperelastic"
_LINEAR = "linear-elastic"
_MEND = 'for example matters = "material", or larger = "material" with than = "model.space"'


def expected_from(
    value: object, factors: Sequence[Factor], responses: Sequence[ResponseSpec], faults: Faults
) -> tuple[Expected, ...]:
    """Read every ``[[expected]]``: one kind of :data:`KINDS` each, ``source`` and ``response``."""
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) > MAX_EXPECTED:
        faults.add("expected", f"must be tables, got {shown(value)}", "write [[expected]]")
        return ()
    named, names = {f.name: f for f in factors}, [r.name for r in responses if r.name]
    read = [
        _expected(table, f"expected[{i}]", named, names, faults) for i, table in enumerate(value)
    ]
    return tuple(expectation for expectation in read if expectation is not None)


def _expected(
    table: object, where: str, named: Mapping[str, Factor], responses: Sequence[str], faults: Faults
) -> Expected | None:
    before = faults.mentions
    kinds = [kind for kind in KINDS if isinstance(table, Mapping) and kind in table]
    if isinstance(table, Mapping) and len(kinds) != 1:
        rule = f"must hold one of {', '.join(KINDS)}" + (f", got {len(kinds)}" if kinds else "")
        faults.add(where, rule, _MEND)
    kind, others = kinds[0] if kinds else "", [key for k in kinds[1:] for key in KINDS[k]]
    section = read_table(_SECTIONS.get(kind, Expectation), table, where, faults, others)
    response = responses[0] if responses else ""
    if section.response is not None:
        response = noted(_one_of(responses), section.response, f"{where}.response", faults) or ""
    values = [
        noted(partial(read, named), value, f"{where}.{key}", faults)
        for key, (read, _) in KINDS.get(kind, {}).items()
        if (value := getattr(section, key)) is not None
    ]
    if faults.mentions > before:
        return None
    cells = tuple(value for value in values if isinstance(value, dict))
    names = tuple(name for value in values if isinstance(value, tuple) for name in value)
    return Expected(kind, names, cells, response, section.source)


def _one_of(valid: Sequence[str]) -> Callable[[object], str]:
    def read(value: object) -> str:
        if not isinstance(value, str) or value not in valid:
            raise Bad(f"is none of the study's: {shown(value)}", nearest(str(value)[:80], valid))
        return value

    return read


def _factor(named: Mapping[str, Factor], value: object) -> tuple[str, ...]:
    return (_one_of(list(named))(value),)


def _factors(named: Mapping[str, Factor], value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) != 2:
        raise Bad(f"must be a list of two factors, got {shown(value)}")
    return tuple(_one_of(list(named))(item) for item in value)


def _cell(named: Mapping[str, Factor], value: object) -> dict[str, str]:
    """Labels of the levels of some factors."""
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must name levels, got {shown(value)}", '{ material = "neo-hookean" }')
    cell = {}
    for name, label in flatten(value).items():
        factor = named[_one_of(list(named))(name)]
        cell[name] = _one_of(factor.labels)(str(label))
    return cell


def _levels_named(named: Mapping[str, Factor], value: object) -> dict[str, str]:
    """Levels of one factor, by their labels; the labels are joined by a tab."""
    labels = [value] if isinstance(value, str) else value
    if not isinstance(labels, list) or not labels or not all(isinstance(v, str) for v in labels):
        raise Bad(f"must name levels, got {shown(value)}", 'write "quadratic", or a list of levels')
    for name, factor in named.items():
        if set(labels) <= set(factor.labels):
            return {name: "\t".join(labels)}
        others = [label for label in factor.labels if label != _LINEAR]
        if labels == [HYPERELASTIC] and len(others) < len(factor.labels):
            return {name: "\t".join(others)}
    every = [label for factor in named.values() for label in factor.labels]
    raise Bad(f"are no levels of one factor: {shown(value)}", nearest(str(labels[0])[:80], every))


#: Reader of what is said of factors, and what to write where it is missing; "" where it may be.
Said = tuple[Callable[[Mapping[str, Factor], object], tuple[str, ...] | dict[str, str]], str]

_FACTOR: Said = (_factor, 'name a factor, such as "material"')
_CELL: Said = (_cell, '{ material = "neo-hookean" }')
_LEVELS: Said = (_levels_named, 'one level or several, such as "quadratic"')
#: keys of every kind, the first of which names it
KINDS: Mapping[str, Mapping[str, Said]] = {
    # a factor has an effect that matters, or a larger one than another factor
    "matters": {"matters": _FACTOR},
    "larger": {"larger": _FACTOR, "than": _FACTOR},
    "interact": {"interact": (_factors, 'two factors, such as ["material", "plates"]')},
    # a cell, mean over all other factors, is the best; two cells differ by less than what matters
    "best": {"best": _CELL},
    "close": {"close": _CELL, "to": _CELL},
    # levels of a factor score better, or need less, than its others, or than those named
    "better": {"better": _LEVELS, "than": (_levels_named, "")},
    "fewer": {"fewer": _LEVELS, "than": (_levels_named, "")},
}


def _section_of(keys: Mapping[str, Said]) -> type[Expectation]:
    """Section of a kind: an expectation with the keys of the kind."""
    types = {key: Annotated[object, as_written(mend)] for key, (_, mend) in keys.items()}
    return section(type("Kind", (Expectation,), {"__annotations__": types} | dict.fromkeys(keys)))


_SECTIONS = {kind: _section_of(keys) for kind, keys in KINDS.items()}


# The terms of the analysis: those asked for, or those that a design can tell.

MAX_TERMS = 1000
#: kinds of a design whose cells do not tell every term
_FRACTIONS = ("fractional", "plackett-burman", "d-optimal", "listed")


def analysis_from(
    table: Analysis,
    factors: Sequence[Factor],
    declared: Sequence[str],
    scheme: Scheme,
    faults: Faults,
) -> Analysis:
    """Complete ``[analysis]``: terms are names of factors, never code."""
    model = default_model(scheme, factors)
    if table.model is not None:
        read = partial(_model, declared)
        model = noted(read, table.model, "analysis.model", faults) or model
        if not faults:
            _check_told_apart(model, factors, scheme, faults)
    for name, _ in table.roles or ():
        if name not in declared:
            faults.add("analysis.roles", f"no factor {shown(name)}", nearest(name[:80], declared))
    if table.surface in ("quadratic", "emulator") and all(f.span is None for f in factors):
        mend = 'write one as { low = "28 mm", high = "32 mm" }'
        faults.add("analysis.surface", "no factor is a range", mend)
    if scheme.sequential is not None and table.surface in ("quadratic", "none"):
        rule = "an adaptive design adds cells where an emulator is unsure"
        faults.add("analysis.surface", rule, 'write surface = "emulator", or leave it out')
    for term in table.primary or ():
        noted(partial(_term, factors=declared), term, "analysis.primary", faults)
    return with_values(table, model=model)


def default_model(scheme: Scheme, factors: Sequence[Factor]) -> Terms:
    """Terms that a design can tell, where the file does not ask for others."""
    if scheme.kind == "full":
        terms = terms_of(scheme, factors)
        return "full" if terms is None else terms
    if scheme.terms:
        return scheme.terms
    if scheme.kind == "fractional":
        if scheme.resolution is None:
            return "full"
        return min(max(1, (scheme.resolution - 1) // 2), len(factors))  # free of one another
    return 1


def _model(factors: Sequence[str], value: object) -> Terms:
    if value == "full":
        return "full"
    if isinstance(value, list):
        if not value or len(value) > MAX_TERMS:
            raise Bad(f"must list 1 to {MAX_TERMS} terms")
        return tuple(dict.fromkeys(_term(term, factors) for term in value))
    if isinstance(value, int) and not isinstance(value, bool):
        return integer(1, max(1, len(factors)))(value)
    raise Bad(f'must be "full", a number or a list of terms, got {shown(value)}')


def _term(value: object, factors: Sequence[str]) -> str:
    return ":".join(factors[k] for k in word_of(factors, value))


def _check_told_apart(
    model: Terms, factors: Sequence[Factor], scheme: Scheme, faults: Faults
) -> None:
    """Refuse terms that no analysis of a fraction can tell apart."""
    # Each would be judged by what the others leave of it, which is nothing.
    if scheme.rows is None or scheme.kind not in _FRACTIONS:
        return
    names = [factor.name for factor in factors]
    most = min(model, len(names)) if isinstance(model, int) else len(names)
    words = words_of(names, list(model) if isinstance(model, tuple) else most)
    runs = np.array(scheme.rows)
    columns = model_columns(runs, [len(factor.levels) for factor in factors], words)
    rank, columns_asked = int(np.linalg.matrix_rank(columns)) - 1, columns.shape[1] - 1
    if rank == columns_asked:
        return
    what = "terms" if columns_asked == len(words) else "numbers"
    rule = f"asks for {columns_asked} {what}, of which {len(runs)} cells tell {rank} apart"
    usual = default_model(scheme, factors)
    aliased = f": {scheme.aliases[0]}" if scheme.aliases else ""
    faults.add("analysis.model", rule + aliased, f"leave it out (model = {usual}), or list terms")


def terms_of(scheme: Scheme, factors: Sequence[Factor]) -> tuple[str, ...] | None:
    """Terms of zipped and nested factors; None for a full factorial."""
    # Of zipped factors the first stands for all; a nested factor stands only beside its parent.
    if scheme.rows is None:
        return None
    columns = {f.name: c for f, c in zip(factors, zip(*scheme.rows, strict=True), strict=True)}
    independent: list[str] = []
    for factor in factors:
        column = columns[factor.name]
        others = [columns[other] for other in independent]
        if not any(_determines(column, other) and _determines(other, column) for other in others):
            independent.append(factor.name)
    parents = {
        child: parent
        for child in independent
        for parent in independent
        if child != parent and _determines(columns[child], columns[parent])
    }
    terms = [
        term
        for order in range(1, len(independent) + 1)
        for term in itertools.combinations(independent, order)
        if all(parents[n] in term for n in term if n in parents)
    ]
    return tuple(":".join(term) for term in terms)


def _determines(column: Sequence[int], other: Sequence[int]) -> bool:
    """Whether the level of one factor says the level of another."""
    pairs = set(zip(column, other, strict=True))
    return len(pairs) == len(set(column))


def words_of(names: Sequence[str], value: object) -> tuple[Word, ...]:
    """Read an order of interaction or a list of terms as the numbers of their factors."""
    if isinstance(value, list) and value:
        return tuple(dict.fromkeys(word_of(names, term) for term in value))
    highest = integer(1, len(names))(value)
    orders = range(1, highest + 1)
    return tuple(w for order in orders for w in itertools.combinations(range(len(names)), order))


def word_of(names: Sequence[str], term: object) -> Word:
    """Read a term such as ``"A:B"`` as the numbers of its factors."""
    parts = [part.strip() for part in term.split(":")] if isinstance(term, str) else [term]
    for part in parts:
        if part not in names:
            raise Bad(f"no factor {shown(part)}", nearest(str(part)[:80], names))
    if len(set(parts)) < len(parts):
        raise Bad(f"a factor stands twice in {shown(term)}")
    return tuple(k for k, name in enumerate(names) if name in parts)
