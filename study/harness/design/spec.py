"""What a loaded file holds: frozen values, made by :mod:`study.harness.design.load` alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from study.external.forward_model import Value
from study.external.parameters import (
    Constraint,
    is_parameter,
    parameters_from,
    stands_alone,
)
from study.ground.canonical import Keyed
from study.ground.contrast import Expected
from study.ground.declaration import Bad, table_of
from study.ground.diagnostics import Faults, Table
from study.ground.errors import Fault, InputError
from study.ground.units import split
from study.harness.design.study_file import (
    Analysis,
    Exclusion,
    Replicates,
    ResponseSpec,
    Sequential,
)
from study.simulation import overlay
from study.simulation.cell import Case, Cell, Combination, Treatment, block_ids
from study.simulation.problem_file import Converge, Report, Virtual
from study.simulation.resolve import Identification, resolve
from study.simulation.response import SCORED, is_of_material
from study.statistics.surfaces.input_distribution import InputDistribution


@dataclass(frozen=True)
class Level:
    """One level of a factor: its label and the dotted keys that it lays over the file."""

    label: str
    settings: Table


@dataclass(frozen=True)
class Span:
    """Numeric range of a factor: ends in ``unit``, which may be empty.

    Equal shares of a range with ``log`` are equal ratios.
    """

    low: float
    high: float
    unit: str
    log: bool = False

    def at(self, share: float) -> float:
        """Value at a share of the range, 0 its low and 1 its high end."""
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)

    def step(self, value: float) -> float:
        """Difference from a value that is a ten-thousandth of the range."""
        return 1e-4 * (value * math.log(self.high / self.low) if self.log else self.high - self.low)


@dataclass(frozen=True)
class Factor:
    """A factor and its levels; the name is a dotted key or a preset set.

    A factor written as a range has a ``span``; its levels are those that the design needs.
    """

    name: str
    levels: tuple[Level, ...]
    span: Span | None = None

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
    def ranges(self) -> dict[str, Span]:
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
