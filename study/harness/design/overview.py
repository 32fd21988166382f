"""What a design can and cannot tell, before anything runs: the data of ``study plan``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.ground.arrays import gathered
from study.ground.canonical import Keyed
from study.ground.declaration import Bad, Faults, table_of
from study.ground.errors import Fault, InputError
from study.harness.design.generators import d_optimal, efficiency
from study.harness.design.load import load_design
from study.harness.design.spec import Design, Factor, words_of
from study.simulation.cell import Cell, Combination, Treatment
from study.simulation.plausibility import cautions_of

Groups = tuple[tuple[Treatment, ...], ...]
Key = Callable[[Cell], Hashable]


def _grouped(treatments: Sequence[Treatment], key: Key) -> Groups:
    return tuple(map(tuple, gathered((key(t.cell), t) for t in treatments).values()))


def equivalent_groups(design: Design) -> Groups:
    """Cells that must agree physically, grouped: one group is one distinct computation."""
    # In compression with both faces frictionless the deformation is the same everywhere, so that
    # space, order, mesh and element shape cannot matter: those cells are controls.
    return _grouped(design.treatments, lambda cell: cell.physical_key)


def calibration_groups(design: Design) -> Groups:
    """Cells that share one calibration problem (one fit a block); none where nothing is fitted."""
    calibrated = [t for t in design.treatments if t.cell.is_calibrated]
    return _grouped(calibrated, lambda cell: cell.calibration_key)


def calibration_factors(design: Design) -> tuple[str, ...]:
    """Names of the factors that enter the calibration problem of some cell."""
    return tuple(f.name for f in design.factors if _calibrates(design, f.name))


def _calibrates(design: Design, factor: str) -> bool:
    """Whether a factor enters the calibration problem of some cell; none where nothing is fitted.

    The cells of a sample of ranges, each with levels of its own, would be made tens of thousands
    of times to find that out.
    """
    fitted = any(t.cell.is_calibrated for t in design.treatments)
    return fitted and _separated(design, factor, lambda cell: cell.calibration_key) > 0


def _separated(design: Design, factor: str, key: Key) -> int:
    """Count the cells in which the factor changes the key."""
    if design.scheme.rows is not None:
        return sum(_changes(design, t, factor, key) for t in design.treatments)
    slices = gathered(
        (tuple(label for name, label in t.levels.items() if name != factor), key(t.cell))
        for t in design.treatments
    )
    return sum(len(keys) for keys in slices.values() if len(set(keys)) > 1)


def _changes(design: Design, t: Treatment, factor: str, key: Key) -> bool:
    """Whether another level of one factor alone changes the key of a cell."""
    # A part of the full factorial may hold no two cells that differ in one factor only, so the
    # other cell is made for the comparison.
    own_key, index = key(t.cell), [f.name for f in design.factors].index(factor)
    levels = [f.levels[f.labels.index(t.levels[f.name])] for f in design.factors]
    factor_levels = design.factors[index].levels
    if design.factors[index].span is not None and len(factor_levels) > 3:  # a sampled range
        factor_levels = tuple(factor_levels[i] for i in (0, len(factor_levels) // 2, -1))
    for other in factor_levels:
        faults = Faults()
        other_cell = design.resolved([*levels[:index], other, *levels[index + 1 :]], faults)
        if not faults and key(other_cell) != own_key:
            return True
    return False


def inert_cells(design: Design, factor: str) -> int:
    """Count the cells in which a factor cannot change a force: its controls."""
    return len(design.treatments) - _separated(design, factor, lambda cell: cell.physical_key)


@dataclass(frozen=True)
class FactorOverview:
    """What a factor can tell."""

    name: str
    levels: tuple[str, ...]
    #: Whether it enters the calibration problem of some cell.
    calibrates: bool
    #: Cells in which it cannot change a force.
    inert_cells: int
    note: str


@dataclass(frozen=True)
class CellOverview:
    """One row of the design matrix."""

    label: str
    #: Label by factor.
    levels: Mapping[str, str]
    #: Number of its computation: cells with one number must agree.
    group: int
    #: Number of its calibration problem; None where nothing is fitted.
    calibration: int | None
    #: Whether its deformation is the same everywhere.
    homogeneous: bool


@dataclass(frozen=True)
class Replication:
    """What is computed several times, and which question that answers."""

    kind: str
    count: int
    sentence: str


@dataclass(frozen=True)
class Overview(Keyed):
    """What a design can and cannot tell."""

    KEYS = (
        "study=design.name question=design.question cells=matrix.__len__ distinct calibrations "
        "factors matrix excluded=_excluded scheme=design.scheme replicates duplicates=_duplicates "
        "warnings"
    )

    design: Design
    #: Computations and calibration problems that differ.
    distinct: int
    calibrations: int
    #: What each of them can tell.
    factors: tuple[FactorOverview, ...]
    matrix: tuple[CellOverview, ...]
    #: Cells left out, and why.
    excluded: tuple[tuple[Combination, str], ...]
    replicates: Replication | None
    #: Cells with different labels and the same content.
    duplicates: Groups
    #: What is allowed and probably not meant.
    warnings: tuple[str, ...]

    @property
    def _excluded(self) -> list[dict[str, str]]:
        return [{"label": cell.label, "why": why} for cell, why in self.excluded]

    @property
    def _duplicates(self) -> list[list[str]]:
        return [[cell.label for cell in group] for group in self.duplicates]


def overview(design: Design) -> Overview:
    """Describe a design: matrix, exclusions, groups, what each factor can tell."""
    groups, fitted = equivalent_groups(design), calibration_groups(design)
    return Overview(
        design,
        len(groups),
        len(fitted),
        tuple(_factor(design, factor) for factor in design.factors),
        _matrix(design, groups, fitted),
        design.excluded,
        replication(design),
        design.duplicates,
        warnings(design),
    )


def replication(design: Design) -> Replication | None:
    """Say what is computed several times, and which question that answers."""
    repeats = design.replicates
    kinds = (
        (
            "mesh-seeds",
            repeats.mesh_seeds,
            f"every cell is solved on {repeats.mesh_seeds} meshes of its size that differ by a "
            "seed: is an effect larger than the mesh noise at this size? (E3)",
        ),
        (
            "seeds",
            0 if repeats.key is None else repeats.n,
            f"every cell is computed {repeats.n} times with other values of {repeats.key}, no two "
            "cells with one: is an effect larger than the scatter of the simulation itself? (E0)",
        ),
        (
            "noise",
            repeats.noise,
            f"every fit is made {repeats.noise} times more, to its curve with resampled residuals: "
            "is an effect larger than the noise in the measured data alone would give? (E2)",
        ),
    )
    return next((Replication(*kind) for kind in kinds if kind[1]), None)


def _factor(design: Design, factor: Factor) -> FactorOverview:
    total, calibrates = len(design.treatments), _calibrates(design, factor.name)
    inert, parts = inert_cells(design, factor.name), []
    if design.identification.calibration.method != "none" and not design.is_alone:
        parts.append("enters the fit" if calibrates else "does not enter the fit")
    if inert:
        parts.append(f"cannot matter in {inert} of {total} cells, which are controls")
    if inert == total:
        parts = ["cannot change any force: every cell is a control"]
    return FactorOverview(factor.name, factor.labels, calibrates, inert, "; ".join(parts))


def _matrix(design: Design, groups: Groups, fitted: Groups) -> tuple[CellOverview, ...]:
    group = {member.label: i for i, members in enumerate(groups, 1) for member in members}
    fit = {member.label: i for i, members in enumerate(fitted, 1) for member in members}
    return tuple(
        CellOverview(
            t.label, t.levels, group[t.label], fit.get(t.label), t.cell.problem.is_homogeneous
        )
        for t in design.treatments
    )


def warnings(design: Design) -> tuple[str, ...]:
    """Sentences about what is allowed and probably not meant."""
    notes: dict[str, None] = {}
    for t in design.treatments:
        problem = t.cell.problem
        notes.update(dict.fromkeys(cautions_of(problem)))
        spec = problem.measurements
        if spec is not None and spec.fit is not None and spec.fit == spec.score:
            notes["cells are scored on the rows they were fitted to: fit, not prediction"] = None
    for group in design.duplicates:
        labels = " = ".join(t.label for t in group)
        notes[f"cells with the same content are one computation, no replicates: {labels}"] = None
    unused = set(table_of(design.config, "presets")) - {factor.name for factor in design.factors}
    for name in sorted(unused):
        notes[f"the preset set {name!r} is no factor and is not used"] = None
    if design.converge.ratio < 1.3:
        notes[f"converge.ratio {design.converge.ratio:g} is below 1.3: orders will be noise"] = None
    return tuple(notes)


# Further cells for a fraction that leaves a doubt: those that tell more terms apart.

#: kinds of a design whose factors are samples of ranges, not levels
SAMPLED = ("central-composite", "box-behnken", "latin-hypercube", "sobol", "morris", "adaptive")


@dataclass(frozen=True)
class Augmentation(Keyed):
    """Cells to be run besides those of a design."""

    KEYS = "cells terms efficiency design=table"

    #: Level of every factor, by its label.
    cells: tuple[Mapping[str, str], ...]
    present: tuple[Mapping[str, str], ...]
    #: What all cells together tell apart.
    terms: tuple[str, ...]
    #: D-efficiency for these terms, 0 where some of them are one another.
    before: float
    after: float

    @property
    def efficiency(self) -> dict[str, float]:
        """D-efficiency without and with the further cells."""
        return {"before": self.before, "after": self.after}

    def table(self) -> str:
        """Write the table ``[design]`` with all cells: records of those that are done are kept."""

        def key(name: str) -> str:
            bare = name.replace("_", "").replace("-", "").isalnum()
            return name if bare else json.dumps(name)

        lines = [
            "    { " + ", ".join(f"{key(k)} = {json.dumps(v)}" for k, v in cell.items()) + " },"
            for cell in (*self.present, *self.cells)
        ]
        return "\n".join(["[design]", 'kind = "listed"', "treatments = [", *lines, "]"])


def augment(
    design: Design | str | Path, cells: int, *, terms: int | Sequence[str] = 2
) -> Augmentation:
    """Choose further cells of a fraction by D-optimality, for terms such as ``"a:b"`` or an order.

    A design that runs every combination or samples ranges has none, and is refused.
    """
    loaded = load_design(design)
    rows, factors = loaded.scheme.rows, loaded.factors
    sizes = [len(factor.levels) for factor in factors]
    every = math.prod(sizes)
    if rows is None or loaded.scheme.kind == "full":
        rule = "runs every combination: there is no further cell"
        raise InputError(Fault("design", rule, "add a level or a factor"))
    if loaded.scheme.kind in SAMPLED:
        rule = f"a {loaded.scheme.kind} design samples ranges"
        raise InputError(Fault("design.kind", rule, "ask it for more runs"))
    names = [factor.name for factor in factors]
    try:
        words = words_of(names, terms if isinstance(terms, int) else list(terms))
    except Bad as error:
        raise InputError(Fault("terms", error.rule, error.mend)) from None
    unknowns = 1 + sum(math.prod(sizes[k] - 1 for k in word) for word in words)
    least = max(1, unknowns - len(rows))
    if not least <= cells <= every - len(rows):
        rule = f"{cells} further cells, of which there are {every - len(rows)}"
        mend = (
            f"{least} to {every - len(rows)}: {len(rows)} cells run, {unknowns} numbers are asked"
        )
        raise InputError(Fault("augment", rule, mend))
    chosen_cells = d_optimal(sizes, words, cells, loaded.seed, rows)

    def labels(row: Sequence[int]) -> dict[str, str]:
        return {f.name: f.labels[k] for f, k in zip(factors, row, strict=True)}

    return Augmentation(
        tuple(map(labels, chosen_cells)),
        tuple(map(labels, rows)),
        tuple(":".join(names[k] for k in word) for word in words),
        efficiency(rows, sizes, words),
        efficiency((*rows, *chosen_cells), sizes, words),
    )
