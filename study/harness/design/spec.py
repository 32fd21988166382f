"""What a study file holds: its tables, declared once, its factors, and the frozen design.

Values are in mm, N, MPa and deg. The tables of a problem are declared in
:mod:`study.simulation.problem_file` and in ``setup``, those of measured files in
:mod:`study.mechanics.measurement`; a :class:`Design` is made by :mod:`study.harness.design.load`.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Literal, cast

from study.external.forward_model import (
    Constraint,
    Value,
    is_parameter,
    number_and_unit,
    parameter_key,
    parameter_name,
    parameters_from,
    stands_alone,
    value_unit,
)
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
    name,
    noted,
    number,
    quoted,
    quoted_path,
    reason,
    section,
    shown,
    table_of,
    texts,
    with_values,
    written_keys,
)
from study.ground.errors import Fault, InputError, nearest
from study.ground.units import parse, split
from study.simulation import overlay
from study.simulation.cell import Case, Cell, Combination, Treatment, block_ids
from study.simulation.problem_file import (
    Converge,
    Identification,
    ProblemFile,
    Report,
    Virtual,
    resolve,
)
from study.simulation.response import RESPONSES, SCORED, SIMULATED, is_of_material
from study.statistics.surfaces.surface_factors import (
    DISTRIBUTION_KEYS,
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
        prefix = f"{set_name}." if set_name in overlay.TABLES else ""
        presets[set_name] = {
            label.strip(): _settings(level, prefix, f"{where}.{quoted(label)}", faults)
            for label, level in entries(levels, where, faults).items()
            if _readable(label, f"{where}.{quoted(label)}", faults)
        }
    return presets


def _settings(level: object, prefix: str, where: str, faults: Faults) -> Table:
    settings = flatten(entries(level, where, faults), prefix, overlay.WHOLE)
    for key in [key for key in settings if not overlay.may_vary(key)]:
        inner = quoted_path(key.removeprefix(prefix))
        faults.add(f"{where}.{inner}", "unknown key", overlay.suggestion(key))
        del settings[key]
    return settings


def _readable(value: str, where: str, faults: Faults) -> bool:
    try:
        return bool(name(value))
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
        if isinstance(value, Mapping) and key not in presets and overlay.may_vary(key):
            factors += _range(key, value, f"factors.{quoted_path(key)}", faults)
        elif levels := _levels(key, value, presets, faults):
            factors.append(Factor(key, levels))
    _check_overlap(factors, faults)
    return tuple(factors)


def _levels(key: str, value: object, presets: Presets, faults: Faults) -> tuple[Level, ...]:
    where = f"factors.{quoted_path(key)}"
    if key not in presets and not overlay.may_vary(key):
        table, _, rest = key.partition(".")
        if table == "parameters":  # whose names are the user's own
            noted(parameter_name, rest, where, faults)
            return ()
        valid = [*presets, *(k for k in overlay.VARYING if k.partition(".")[0] == table)]
        mend = nearest(key[:MAX_NAME], valid) if valid else overlay.suggestion(key)
        if table in written_keys(DesignFile) and table not in overlay.TABLES:
            mend = f"[{table}] is the same in every cell; keys of these may vary: "
            mend += ", ".join(overlay.TABLES)
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
        return name(raw)
    if isinstance(raw, (int, float)) and math.isfinite(raw):
        return repr(raw).removesuffix(".0")
    if isinstance(raw, list) and raw and len(raw) <= 9:
        return name(", ".join(level_label(item) for item in raw))
    mend = "give it a name: [presets.SET.LEVEL]" if isinstance(raw, Mapping) else ""
    raise Bad(f"is no level, got {shown(raw)}", mend)


def _check_overlap(factors: Sequence[Factor], faults: Faults) -> None:
    """Two factors that set one key would hide one another."""
    owner: dict[str, str] = {}
    for factor in factors:
        slots = set()
        for key in factor.keys:  # or the first of the keys that cannot stand beside it
            table, _, last = key.rpartition(".")
            alternatives = overlay.PLACES[table].alternatives if table in overlay.PLACES else ()
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
        if name and end in parts and not overlay.may_vary(key):
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
    dimension = overlay.dimension(key)
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
    if dimension == overlay.ANY:
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
    value, unit = _end(raw, overlay.dimension(factor.name) or "number")
    if unit != span.unit:
        raise Bad(f"{shown(raw)} is not in {span.unit!r}, the unit of its range")
    if not span.low <= value <= span.high:
        raise Bad(f"{shown(raw)} lies outside {span.low:g} to {span.high:g}, its range")
    return _range_level(factor.name, level_label(value), unit)
