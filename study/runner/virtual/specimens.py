"""Virtual specimens: measured curves with known truth, for the demo and for trying a design.

The generator, in full. A batch of silicone has the constants of one of the energies of
:mod:`study.runner.virtual.truth` (Ecoflex 00-10, mix EF10_0T: Dawood et al. 2026, data CC BY 4.0)
times a stiffness factor, and a shape of response that scatters besides; each specimen of a
batch has a further stiffness factor; each repeat on a specimen has load-cell noise, a
load-cell zero and position noise. The reference curve comes from finite elements with bonded
plates, quadratic elements and the fine mesh, so that no cell of a design generates its own
data; a block under an indenter is solved in 3D.

A design that reads several files reads several tests of the same specimens: each file then
holds its own test as the design describes it, of the same stiffness factors, on a mesh finer
than any of the design.

One solution serves all specimens: at a given Poisson's ratio the force is proportional to
a common factor on all moduli, which is exact, and the scatter of the shape enters through
the exact gradient of the reference curve, to first order. Of a specimen that has a weight, moduli
and density together are such a factor, and what its weight does is known to first order. What is
written is the truth of this generator, and p values on it describe this scatter and nothing else.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from study.arrays import Array
from study.curve import Curve
from study.design.spec import Design
from study.errors import Fault, InputError
from study.material.registry import unit_shown
from study.measurement.section import MeasurementSpec
from study.record.atomic_files import write_atomic
from study.runner import provenance
from study.runner.job import TRUTH_SUFFIX
from study.runner.tables import CalibrationTable, measurements_of
from study.runner.virtual.reference import reference_curve, reference_error
from study.runner.virtual.truth import TRUTHS, truth
from study.setup.setup import Setup, Tables
from study.units import parse

#: constants of the usual truth, MPa
ECOFLEX_00_10 = TRUTHS["yeoh"].constants
CITATION = (
    "virtual specimens with the constants of Dawood et al. (2026), Hyperelastic "
    "Characterisation of Silicone Tissue Phantoms, data CC BY 4.0"
)


@dataclass(frozen=True)
class Generator:
    """Numbers of the generator; everything random comes from ``seed``.

    Parameters
    ----------
    batches, repeats : int
        Number of batches (blocks), and of tests on one specimen.
    batch_sd, specimen_sd : float
        Standard deviation of the logarithm of the stiffness factors.
    shape_sd : float
        Relative standard deviation of each higher constant between batches.
    noise_N : float
        Standard deviation of the load cell.
    noise_share, zero_share : float
        Further noise, and the load cell's zero of a test, over the largest force of the test.
    position_mm : float
        Standard deviation of the position.
    truth : str
        Name of the material, see :mod:`study.runner.virtual.truth`.
    spacing_mm : float
        Distance between samples.
    """

    seed: int = 2011
    batches: int = 6
    repeats: int = 3
    batch_sd: float = 0.06
    specimen_sd: float = 0.02
    shape_sd: float = 0.15
    noise_N: float = 0.02
    noise_share: float = 0.0
    zero_share: float = 0.0
    position_mm: float = 0.0
    spacing_mm: float = 0.05
    truth: str = "yeoh"
    poisson_ratio: float = 0.4995


@dataclass(frozen=True)
class VirtualTest:
    """One generated test: labels of its groups, displacement (mm) and force (N), shape (n,)."""

    groups: Mapping[str, str]
    displacement_mm: Array
    force_N: Array


def usual_generator(
    design: Design, *, truth_name: str = "yeoh", blocks: int | None = None
) -> Generator:
    """Numbers that suit a design: an indentation is measured with a smaller load cell.

    Parameters
    ----------
    design : Design
        Its seed is that of the generator.
    truth_name : {"yeoh", "ogden", "humphrey"}
        Material of the specimens, see :mod:`study.runner.virtual.truth`.
    blocks : int, optional
        Number of batches; 6 by default.
    """
    usual = Generator(seed=design.seed, truth=truth_name)
    if any(Setup.of(c).kind.takes_indenter for _, c in _sources(design)):
        usual = replace(
            usual, noise_N=0.0, noise_share=0.003, zero_share=0.002, position_mm=0.005, repeats=1
        )
    return usual if blocks is None else replace(usual, batches=blocks)


def write_virtual(design: Design, out: Path, generator: Generator | None = None) -> list[Path]:
    """Write virtual measurements in the files, columns and groups that a design reads.

    Parameters
    ----------
    design : Design
        Gives specimen, test and ``[measurements]``.
    out : Path
        Data root: the files get their names below it.
    generator : Generator, optional
        By default that of :func:`usual_generator`.

    Returns
    -------
    list of Path
        Files written, the description of the generator among them.

    Raises
    ------
    InputError
        If the design has no measurements or the reference problem cannot be solved.
    """
    generator = generator or usual_generator(design)
    if design.measurements is None:
        raise InputError(Fault("measurements", "the design reads no measurements to imitate"))
    places = provenance.folders(design.source, out)
    sources = [(spec, provenance.located(config, places)) for spec, config in _sources(design)]
    written = []
    several = len(sources) > 1
    for number, (spec, config) in enumerate(sources):
        given = (config, truth(generator.truth), generator.poisson_ratio)
        reference = reference_curve(*given, as_designed=several, virtual=design.virtual)
        stated = {}
        if design.virtual is not None:
            change = reference_error(*given, reference, as_designed=several, virtual=design.virtual)
            stated = {"reference": {**asdict(design.virtual), "change_by_coarser_mesh": change}}
        weighs = Setup.of(config).test.gravity is not None
        which = number if several else None
        tests = list(generate(reference, generator, spec, noise=which, weighs=weighs))
        for name, rows in _files(spec, tests).items():
            path = out / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, rows.encode())
            note_of = {
                "generator": asdict(generator),
                "material": asdict(truth(generator.truth)),
                "citation": CITATION,
                **stated,
            }
            note = path.with_name(path.name + TRUTH_SUFFIX)
            write_atomic(note, json.dumps(note_of, indent=2, default=dict).encode())
            written += [path, note]
    return written


def _sources(design: Design) -> list[tuple[MeasurementSpec, Tables]]:
    """Each file that a design reads, with the deepest test and the finest mesh that read it."""
    found: dict[str, tuple[MeasurementSpec, Tables]] = {}
    for treatment in design.treatments:
        own = CalibrationTable.of(treatment.config).problem or {}
        for config in (treatment.config, own):
            spec = measurements_of(config)
            if spec is None:
                continue
            _depth(config)
            name = str(spec.file or spec.files)
            if name in found:  # every treatment reads its own range from the same file
                deepest = max(config, found[name][1], key=_depth)
                finest = min(found[name][1], config, key=_coarseness)
                config = {**deepest, "model": finest["model"]}
                spec = measurements_of(config) or spec
            found[name] = (spec, config)
    return list(found.values())


def _coarseness(tables: Tables) -> tuple[float, int]:
    """Order of meshes: a given size, else the named level."""
    model = Setup.of(tables).model
    size = model.mesh_size_mm
    return (np.inf if size is None else size, model.level)


def _depth(config: Tables) -> float:
    depth = Setup.of(config).test.displacement_mm
    if depth is None:
        rule = "is missing: measurements that are yet to be made cannot say how far a test goes"
        raise InputError(Fault("test.displacement", rule, 'write displacement = "10 mm"'))
    return float(depth)


def generate(
    reference: Curve,
    generator: Generator,
    spec: MeasurementSpec,
    noise: int | None = None,
    *,
    weighs: bool = False,
) -> Iterator[VirtualTest]:
    """Generate every test of every specimen, in a fixed order.

    Parameters
    ----------
    reference : Curve
        Force of a specimen with all factors 1, and its derivatives by the constants; a direction of
        scatter whose derivatives it lacks moves nothing. Tests end where it ends.
    generator : Generator
        Numbers of batches and repeats, scatter, noise, material and seed.
    spec : MeasurementSpec
        Says which groups specimens and repeats have; without a column for blocks there is one
        batch.
    noise : int, optional
        Number of one of several tests of the same specimens, from 0: its noise then is a random
        stream of its own, so that every test meets the same factors.
    weighs : bool
        Whether the reference is that of a specimen with a weight; it then needs its derivatives by
        all moduli.

    Examples
    --------
    >>> curve = Curve(np.array([1.0, 2.0]), np.array([3.0, 7.0]),
    ...               force_gradient={"C20": np.array([1.0, 2.0])})
    >>> from study.measurement.section import Columns, Units
    >>> spec = MeasurementSpec(columns=Columns("d", "F"), units=Units("mm", "N"),
    ...                        file="a.csv", block="batch", average=("repeat",))
    >>> tests = list(generate(curve, Generator(batches=2, repeats=2), spec))
    >>> [t.groups for t in tests][:2]
    [{'batch': '1', 'repeat': '1'}, {'batch': '1', 'repeat': '2'}]
    """
    random = np.random.default_rng(generator.seed)
    cell = random if noise is None else np.random.default_rng([generator.seed, 1 + noise])
    d = np.arange(0.0, float(reference.displacement_mm[-1]), generator.spacing_mm)
    force, slopes = reference.force_at(d), _shape_changes(reference, generator, d)
    by_weight = _weight_change(reference, generator, d) if weighs else 0.0 * d
    # without a column for them, further batches could not be told from the first
    batches = generator.batches if spec.block else 1
    for batch in range(1, batches + 1):
        numbers = generator.shape_sd * random.standard_normal(len(slopes))
        shape = sum((n * slope for n, slope in zip(numbers, slopes, strict=True)), 0.0 * d)
        stiffness = np.exp(generator.batch_sd * random.standard_normal())
        for groups in _specimens(spec, str(batch)):
            own = stiffness * np.exp(generator.specimen_sd * random.standard_normal())
            for labels in _repeats(spec, groups, generator.repeats):
                true = own * (force + shape) + (1 - own) * by_weight
                yield VirtualTest(labels, d, _measured(d, true, generator, cell))


def _shape_changes(reference: Curve, generator: Generator, d: Array) -> list[Array]:
    """Change of the force with each direction of the truth's scatter."""
    return [
        sum((rate * reference.gradient_at(n, d) for n, rate in direction.items()), 0.0 * d)
        for direction in truth(generator.truth).directions
        if set(direction) <= set(reference.force_gradient)
    ]


def _weight_change(reference: Curve, generator: Generator, d: Array) -> Array:
    """Change of the force with the logarithm of the density.

    The force is of the first degree in all moduli and the density together (Euler): what its
    derivatives by the moduli leave of it is the density's.
    """
    material = truth(generator.truth)
    moduli = [name for name in material.constants if unit_shown(name)]
    stiff = (material.constants[name] * reference.gradient_at(name, d) for name in moduli)
    return np.asarray(reference.force_at(d) - sum(stiff, 0.0 * d))


def _measured(d: Array, force: Array, generator: Generator, random: np.random.Generator) -> Array:
    """Force as a load cell at an uncertain position gives it."""
    largest = float(np.abs(force).max())
    spread = np.hypot(generator.noise_N, generator.noise_share * largest)
    measured = force + spread * random.standard_normal(d.size)
    if generator.zero_share:
        measured = measured + generator.zero_share * largest * random.standard_normal()
    if generator.position_mm:
        wrong = generator.position_mm * random.standard_normal(d.size)
        measured = measured + np.gradient(force, d) * wrong
    return np.asarray(measured)


def _specimens(spec: MeasurementSpec, batch: str) -> list[dict[str, str]]:
    """Specimens of a batch: one for each of the fit and score selections."""
    base = {spec.block: batch} if spec.block else {}
    chosen: list[dict[str, str]] = []
    for where in (spec.fit, spec.score):
        if where:
            labels = {k: str(v[0] if isinstance(v, (list, tuple)) else v) for k, v in where.items()}
            if {**base, **labels} not in chosen:
                chosen.append({**base, **labels})
    return chosen or [base]


def _repeats(
    spec: MeasurementSpec, groups: Mapping[str, str], repeats: int
) -> list[dict[str, str]]:
    if not spec.average:
        return [dict(groups)]
    first, rest = spec.average[0], spec.average[1:]
    return [{**groups, first: str(k), **dict.fromkeys(rest, "1")} for k in range(1, repeats + 1)]


def _files(spec: MeasurementSpec, tests: Sequence[VirtualTest]) -> dict[str, str]:
    """Text of each CSV file by its name below the data root."""
    if spec.file:
        if not spec.file.endswith(".csv"):
            rule = f"virtual measurements are written as plain .csv, got {spec.file!r}"
            raise InputError(Fault("measurements.file", rule))
        return {spec.file: _csv(spec, tests, list(tests[0].groups))}
    pattern = spec.files or ""
    sorted_tests: dict[str, list[VirtualTest]] = {}
    for test in tests:
        try:
            name = pattern.format_map(dict(test.groups))
        except (KeyError, IndexError, ValueError) as error:
            rule = f"needs the group {error} in {pattern!r}, which no table names"
            raise InputError(Fault("measurements.files", rule)) from None
        sorted_tests.setdefault(name, []).append(test)
    inside = [n for n in tests[0].groups if "{" + n + "}" not in pattern]
    return {name: _csv(spec, found, inside) for name, found in sorted_tests.items()}


def _csv(spec: MeasurementSpec, tests: Sequence[VirtualTest], groups: Sequence[str]) -> str:
    columns, units = spec.columns, spec.units
    length = parse(f"1 {units.displacement}", "length")
    newton = parse(f"1 {units.force}", "force")
    sign = -1.0 if spec.sign == "negative" else 1.0
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*groups, columns.displacement, columns.force])
    for test in tests:
        labels = [test.groups[name] for name in groups]
        for d, f in zip(test.displacement_mm, test.force_N, strict=True):
            writer.writerow([*labels, f"{d / length:.5f}", f"{sign * f / newton:.5f}"])
    return stream.getvalue()
