"""Virtual tests of material: what `study new --calibration` writes beside its file.

The solid is Gent's with the constants of :data:`TRUTH`; every stress has the normal noise of one
load cell, from a fixed seed, so that the files are always the same.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import factorial
from pathlib import Path
from typing import Protocol, cast

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, nearest
from study.ground.files import write_atomic, write_new
from study.ground.tabular import csv_text
from study.ground.units import parse, times
from study.mechanics.material.energy import Compressibility
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material, unit_shown
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.setup.geometry import Block, Enclosed
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import MeshName, Model, Order, Setup
from study.simulation.cell import CellProblem, Treatment
from study.simulation.job import TRUTH_SUFFIX, folders, located
from study.simulation.plausibility import half_width
from study.simulation.problem_file import Identification, Virtual
from study.simulation.solve_task import SolveTask, by_workers
from study.simulation.tasks import processes

#: what a fit should find
TRUTH = Material("gent", {"mu": 0.03, "Jm": 8.0}, poisson_ratio=0.495)

#: standard deviation of the noise, kPa: 0.6 % of the largest stress
NOISE_KPA = 0.5

#: elements along the axis of a compressed column: its plates matter within a radius, and the force
#: between them, to (radius / height)^2
_ALONG = 500

#: length of such an element over half the width beyond which no solution is tried
_SLENDEREST = 20.0

_SEED = 20261123
_LENGTH_MM = 25.0


def write_tests(folder: Path) -> list[Path]:
    """Write tension, simple shear and compression of one solid."""
    rng = np.random.default_rng(_SEED)
    stretch, shear = np.linspace(1.0, 2.2, 25), np.linspace(0.0, 1.0, 21)
    shortened = np.linspace(1.0, 0.7, 16)
    folder.mkdir(parents=True, exist_ok=True)
    tests = {
        "tension": ("stretch", stretch, "uniaxial", stretch),
        "simple-shear": ("shear", 100 * shear, "simple-shear", shear),
        "compression": ("displacement_mm", _LENGTH_MM * (1 - shortened), "uniaxial", shortened),
    }
    paths = []
    for name, (column, shown, loading, measure) in tests.items():
        exact = 1e3 * LOADINGS[loading].nominal(TRUTH, measure).stress
        stress_kPa = exact + NOISE_KPA * rng.standard_normal(exact.size)  # noqa: N806
        rows = [f"{m:.5f},{p:.4f}" for m, p in zip(shown, stress_kPa, strict=True)]
        paths.append(folder / f"{name}.csv")
        write_new(paths[-1], "\n".join(["# virtual", f"{column},stress_kPa", *rows]) + "\n")
    return paths


# Materials behind virtual specimens: energies with published constants, and how they scatter.
#
# The truth of a virtual specimen should lie in no family that a design compares; otherwise
# the member of that family wins by birth. Constants are those of Ecoflex 00-10, mix EF10_0T
# (``hyperelastic_parameters_ef10.json`` of Dawood et al. 2026, data CC BY 4.0).

Constants = Mapping[str, float]


@dataclass(frozen=True)
class Truth:
    """A material and the ways in which its shape of response scatters."""

    #: Energy as the solver knows it.
    model: str
    #: Its constants, MPa (exponents plain).
    constants: Constants
    #: Each is a change of the constants per unit of one standard normal number, before it is
    #: multiplied by the generator's ``shape_sd``; the stiffness scatters besides.
    directions: tuple[Constants, ...]
    #: What it is, for the record.
    words: str
    #: Standard deviation of the same number between the specimens of a batch.
    specimen_sd: float = 0.0


_YEOH = {"C10": 7.7021e-3, "C20": -0.0628e-3, "C30": 0.2479e-3}

#: two terms, published as classical moduli m = 2 mu / alpha, and their exponents
_CLASSICAL = ((0.12417390e-3, 10.490170), (10.288743e-3, 2.8092082))
_OGDEN = {
    name: value
    for i, (m, alpha) in enumerate(_CLASSICAL, start=1)
    for name, value in ((f"mu{i}", m * alpha / 2), (f"alpha{i}", alpha))
}

#: W = b (exp(c (I1 - 3)) - 1) (Humphrey and Yin 1987), as its power series: what nine terms leave
#: out is below 4e-5 of the stress up to I1 - 3 = 6; a stretch of 2.5 has 4
_HUMPHREY = {f"C{k}0": 24.913774e-3 * 0.25632133**k / factorial(k) for k in range(1, 10)}

TRUTHS: Mapping[str, Truth] = {
    "yeoh": Truth(
        "reduced-polynomial",
        _YEOH,
        tuple({n: _YEOH[n]} for n in ("C20", "C30")),
        "reduced polynomial of order 3",
    ),
    "ogden": Truth(
        "ogden",
        _OGDEN,
        tuple({n: _OGDEN[n]} for n in ("alpha1", "alpha2")),
        "Ogden's energy of two terms",
    ),
    "humphrey": Truth(
        "reduced-polynomial",
        _HUMPHREY,
        # the exponent scatters at fixed initial modulus 2 b c
        ({f"C{k}0": (k - 1) * _HUMPHREY[f"C{k}0"] for k in range(2, 10)},),
        "Humphrey's exponential energy",
        # .046 between the specimens A and B of the nine measured phantoms, up to 35 %
        specimen_sd=0.05,
    ),
}


def truth(name: str) -> Truth:
    """Find a truth by its name."""
    if name not in TRUTHS:
        raise InputError(Fault("--truth", f"no truth {name!r}", nearest(name, TRUTHS)))
    return TRUTHS[name]


# Reference curve of virtual specimens: a finer model than any cell of the design.


def reference_curve(
    problem: CellProblem,
    truth: Truth,
    poisson_ratio: float,
    *,
    as_designed: bool,
    virtual: Virtual,
    coarser: bool = False,
) -> Curve:
    """Solve for the reference force and its gradient, or the force on the next coarser mesh."""
    from study.mechanics.mesh.mesher import mesh_size

    setup = problem.setup
    loaded = problem if as_designed else problem.loaded(interface="bonded", base="bonded")
    # the grid runs a little past the range, as a real test does
    loaded = loaded.loaded(steps=virtual.steps, displacement_mm=1.03 * setup.test.depth_mm)
    volume = Compressibility(poisson_ratio=poisson_ratio)
    solid = MaterialSection(truth.model, None, truth.constants, volume)
    model = _reference_model(setup, virtual, as_designed)
    loaded = replace(loaded.alone(), material=solid, model=model, forward=None)
    finer = as_designed and not virtual.chooses_mesh and not setup.is_homogeneous
    if refined := finer - coarser:  # no cell of the design generates its own data
        loaded = loaded.on_mesh(mesh_size_mm=mesh_size(loaded.setup) / model.mesh_ratio**refined)
    # in a worker of one thread
    ((_, result),) = by_workers(processes(1))([SolveTask(loaded, gradients=not coarser)])
    if not result.converged:
        what = "the reference curve" + " on the next coarser mesh" * coarser
        raise InputError(Fault("virtual specimens", f"{what} failed: {result.message}"))
    return result.curve


def _reference_model(setup: Setup, virtual: Virtual, as_designed: bool) -> Model:
    """3D where the specimen is no body of revolution and that matters; the mesh of ``[virtual]``.

    Without one, and where every test is as the design has it, the mesh is the finest that the
    design uses, to be made finer still.
    """
    designed = setup.model
    corners = isinstance(setup.specimen, Block) and setup.kind.takes_indenter
    solid = isinstance(setup.specimen, Enclosed) or corners
    model = Model(
        space="3d" if solid else "axisymmetric", element_order=cast(Order, virtual.element_order)
    )
    if not as_designed and not virtual.chooses_mesh:
        from study.mechanics.mesh.mesher import mesh_size

        model = replace(model, mesh="fine")
        height = getattr(setup.specimen, "height_mm", 0.0)
        coarsest = height / _ALONG if setup.kind.compresses else 0.0
        half = half_width(setup.specimen)
        if half is not None and coarsest > _SLENDEREST * half:
            rule = f"{height:g} mm is {times(height / half)} half the width ({half:.3g} mm)"
            raise InputError(Fault("specimen.height", rule, "check the units of both"))
        if coarsest > mesh_size(replace(setup, model=model)):
            return replace(model, mesh_size_mm=coarsest)
        return model
    model = replace(model, mesh_ratio=designed.mesh_ratio)
    if virtual.mesh_size_mm is not None:
        return replace(model, mesh_size_mm=virtual.mesh_size_mm)
    if virtual.mesh is not None:
        return replace(model, mesh=cast(MeshName, virtual.mesh))
    return replace(model, mesh=designed.mesh, mesh_size_mm=designed.mesh_size_mm)


# Virtual specimens: measured curves with known truth, for the demo and for trying a design.
#
# The generator, in full. A batch of silicone has the constants of one of the energies of
# ``virtual_specimens`` (Ecoflex 00-10, mix EF10_0T: Dawood et al. 2026, data CC BY 4.0)
# times a stiffness factor, and a shape of response that scatters besides; each specimen of a
# batch has a further stiffness factor; each repeat on a specimen has load-cell noise, a
# load-cell zero and position noise. The reference curve comes from finite elements with bonded
# plates, quadratic elements and the fine mesh, so that no cell of a design generates its own
# data; a block under an indenter is solved in 3D.
#
# A design that reads several files reads several tests of the same specimens: each file then
# holds its own test as the design describes it, of the same stiffness factors, on a mesh finer
# than any of the design.
#
# One solution serves all specimens: at a given Poisson's ratio the force is proportional to
# a common factor on all moduli, which is exact, and the scatter of the shape enters through
# the exact gradient of the reference curve, to first order. Of a specimen that has a weight, moduli
# and density together are such a factor, and what its weight does is known to first order. What is
# written is the truth of this generator, and p values on it describe this scatter and nothing else.

CITATION = (
    "virtual specimens with the constants of Dawood et al. (2026), Hyperelastic "
    "Characterisation of Silicone Tissue Phantoms, data CC BY 4.0"
)


@dataclass(frozen=True)
class Generator:
    """Numbers of the generator; everything random comes from ``seed``."""

    seed: int = 2011
    #: Number of batches (blocks), and of tests on one specimen.
    batches: int = 6
    repeats: int = 3
    #: Standard deviation of the logarithm of the stiffness factors.
    batch_sd: float = 0.06
    specimen_sd: float = 0.02
    #: Relative standard deviation of each higher constant between batches.
    shape_sd: float = 0.15
    #: Standard deviation of the load cell.
    noise_N: float = 0.02
    #: Further noise, and the load cell's zero of a test, over the largest force of the test.
    noise_share: float = 0.0
    zero_share: float = 0.0
    position_mm: float = 0.0
    spacing_mm: float = 0.05
    #: Name of the material, see :mod:`study.simulation.virtual_specimens`.
    truth: str = "yeoh"
    poisson_ratio: float = 0.4995


@dataclass(frozen=True)
class VirtualTest:
    """One generated test: labels of its groups, displacement (mm) and force (N), shape (n,)."""

    groups: Mapping[str, str]
    displacement_mm: Array
    force_N: Array


class ImitatedDesign(Protocol):
    """What virtual specimens need of a design whose measurements they stand for."""

    @property
    def seed(self) -> int:
        """Of every random draw."""

    @property
    def source(self) -> str:
        """File that it was read from."""

    @property
    def identification(self) -> Identification:
        """Measurements of the file itself."""

    @property
    def virtual(self) -> Virtual | None:
        """How carefully the reference curve is solved."""

    @property
    def treatments(self) -> tuple[Treatment, ...]:
        """Cells of the design."""


def usual_generator(
    design: ImitatedDesign, *, truth_name: str = "yeoh", blocks: int | None = None
) -> Generator:
    """Numbers that suit a design: an indentation is measured with a smaller load cell."""
    usual = Generator(seed=design.seed, truth=truth_name)
    if any(problem.setup.kind.takes_indenter for _, problem in _sources(design)):
        usual = replace(
            usual, noise_N=0.0, noise_share=0.003, zero_share=0.002, position_mm=0.005, repeats=1
        )
    return usual if blocks is None else replace(usual, batches=blocks)


def write_virtual(
    design: ImitatedDesign,
    out: Path,
    generator: Generator | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write virtual measurements in the files, columns and groups that a design reads."""
    generator = generator or usual_generator(design)
    if design.identification.measurements is None:
        raise InputError(Fault("measurements", "the design reads no measurements to imitate"))
    places = folders(design.source, out)
    sources = [(spec, located(problem, places)) for spec, problem in _sources(design)]
    written = []
    several = len(sources) > 1
    for number, (spec, problem) in enumerate(sources):
        of = partial(
            reference_curve, problem, truth(generator.truth), generator.poisson_ratio,
            as_designed=several, virtual=design.virtual or Virtual(),
        )  # fmt: skip
        file = spec.file or spec.files
        progress(f"simulating the test of {file}: {number + 1} of {len(sources)}")
        reference = of()
        note_of = {
            "generator": asdict(generator),
            "material": asdict(truth(generator.truth)),
            "citation": CITATION,
        }
        if design.virtual is not None:
            apart = of(coarser=True).force_at(reference.displacement_mm) - reference.force_N
            change = float(np.abs(apart).max() / np.abs(reference.force_N).max())
            note_of["reference"] = {**asdict(design.virtual), "change_by_coarser_mesh": change}
        weighs, which = problem.test.gravity is not None, number if several else None
        tests = list(generate(reference, generator, spec, noise=which, weighs=weighs))
        for name, rows in _files(spec, tests).items():
            paths = [out / name, out / f"{name}{TRUTH_SUFFIX}"]
            write_atomic(paths[0], rows.encode())
            write_atomic(paths[1], json.dumps(note_of, indent=2, default=dict).encode())
            written += paths
    return written


def _sources(design: ImitatedDesign) -> list[tuple[MeasurementSpec, CellProblem]]:
    """Each file that a design reads, with the deepest test and the finest mesh that read it."""
    sources: dict[str, tuple[MeasurementSpec, CellProblem]] = {}
    for treatment in design.treatments:
        for problem in (treatment.cell.problem, treatment.cell.fitted_elsewhere):
            if not isinstance(problem, CellProblem) or problem.measurements is None:
                continue
            _depth(problem)
            spec = problem.measurements
            name = str(spec.file or spec.files)
            if name in sources:  # every treatment reads its own range from the same file
                pair = (sources[name][1], problem)
                deepest = max(problem, pair[0], key=_depth)
                # a given size, else the named level
                sizes = [(p.model.mesh_size_mm or np.inf, p.model.level) for p in pair]
                finest = pair[1] if sizes[1] < sizes[0] else pair[0]
                problem = replace(deepest, model=finest.model)
                spec = deepest.measurements or spec
            sources[name] = (spec, problem)
    return list(sources.values())


def _depth(problem: CellProblem) -> float:
    depth = problem.depth_mm
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

    Examples
    --------
    >>> curve = Curve(np.array([1.0, 2.0]), np.array([3.0, 7.0]),
    ...               force_gradient={"C20": np.array([1.0, 2.0])})
    >>> from study.mechanics.measurement.measurement_section import Columns, Units
    >>> spec = MeasurementSpec(columns=Columns("d", "F"), units=Units("mm", "N"),
    ...                        file="a.csv", block="batch", average=("repeat",))
    >>> tests = list(generate(curve, Generator(batches=2, repeats=2), spec))
    >>> [t.groups for t in tests][:2]
    [{'batch': '1', 'repeat': '1'}, {'batch': '1', 'repeat': '2'}]
    """
    random = np.random.default_rng(generator.seed)
    cell = random if noise is None else np.random.default_rng([generator.seed, 1 + noise])
    d = np.arange(0.0, float(reference.displacement_mm[-1]), generator.spacing_mm)
    material, force, by_weight = truth(generator.truth), reference.force_at(d), 0.0 * d
    # change of the force with each direction of the truth's scatter
    slopes = [
        sum((rate * reference.gradient_at(n, d) for n, rate in direction.items()), 0.0 * d)
        for direction in material.directions
        if set(direction) <= set(reference.force_gradient)
    ]
    if weighs:  # change with the logarithm of the density, as the force's degree 1 (Euler) gives it
        moduli = [name for name in material.constants if unit_shown(name)]
        stiff = (material.constants[name] * reference.gradient_at(name, d) for name in moduli)
        by_weight = force - sum(stiff, 0.0 * d)
    # without a column for them, further batches could not be told from the first
    batches = generator.batches if spec.block else 1
    for batch in range(1, batches + 1):
        numbers = generator.shape_sd * random.standard_normal(len(slopes))
        stiffness = np.exp(generator.batch_sd * random.standard_normal())
        for groups in _specimens(spec, str(batch)):
            factor = stiffness * np.exp(generator.specimen_sd * random.standard_normal())
            # no number is drawn where none is needed: the other truths keep their specimens
            further = random.standard_normal(len(slopes)) if material.specimen_sd else 0.0
            at = numbers + material.specimen_sd * further
            shape = sum((n * slope for n, slope in zip(at, slopes, strict=True)), 0.0 * d)
            for labels in _repeats(spec, groups, generator.repeats):
                true = factor * (force + shape) + (1 - factor) * by_weight
                yield VirtualTest(labels, d, _measured(d, true, generator, cell))


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
    for where in filter(None, (spec.fit, spec.score)):
        first = {k: str(v[0] if isinstance(v, (list, tuple)) else v) for k, v in where.items()}
        if {**base, **first} not in chosen:
            chosen.append({**base, **first})
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
    return {name: _csv(spec, tests, inside) for name, tests in sorted_tests.items()}


def _csv(spec: MeasurementSpec, tests: Sequence[VirtualTest], groups: Sequence[str]) -> str:
    columns, units = spec.columns, spec.units
    length = parse(f"1 {units.displacement}", "length")
    newton = parse(f"1 {units.force}", "force")
    sign = -1.0 if spec.sign == "negative" else 1.0
    far, hard = (
        _decimals(max(float(np.abs(getattr(test, key)).max()) for test in tests) / unit)
        for key, unit in (("displacement_mm", length), ("force_N", newton))
    )
    rows = [
        [*(test.groups[name] for name in groups),
         f"{d / length:.{far}f}", f"{sign * f / newton:.{hard}f}"]
        for test in tests
        for d, f in zip(test.displacement_mm, test.force_N, strict=True)
    ]  # fmt: skip
    if not spec.header:  # columns are named by their number
        return csv_text(rows[0], rows[1:])
    return csv_text([*groups, columns.displacement, columns.force], rows)


def _decimals(largest: float) -> int:
    """Digits after the point that show a column: five, and more where its numbers are small."""
    return 5 if not largest > 0 else max(5, 4 - math.floor(math.log10(largest)))
