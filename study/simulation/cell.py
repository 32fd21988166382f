"""A cell resolved: its problems as sections with all defaults filled in, and as documents."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, cast

from study.external.forward_model import ForwardCell, PlacedFile
from study.ground.canonical import Json, canonical, digest, hashed
from study.ground.declaration import document_of, field_named, section_of, table_of, values_of
from study.ground.errors import Fault, InputError
from study.mechanics.forward.closed_form import height_and_area
from study.mechanics.measurement.recording import Gauge
from study.mechanics.setup.geometry import (
    INDENTERS,
    SPECIMENS,
    Block,
    Cylinder,
    Enclosed,
    Specimen,
    Surface,
)
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Problem, Setup
from study.mechanics.setup.test_kind import Test

# Names made of content: the hash of plain values with one spelling.

ID_LENGTH = 16


def folder_name(text: str, otherwise: str) -> str:
    """Name of a folder from any text."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:80] or otherwise


def case_id(content: object) -> str:
    """Name made of content: 16 hex digits of the sha256 of canonical JSON.

    Numbers are coerced first (``1`` and ``1.0`` are one), keys sorted. Labels, names and
    citations are no content.
    """
    return hashed(canonical(content, _whole), ID_LENGTH)


def block_ids(content: Mapping[str, object], blocks: Sequence[str | None]) -> list[str]:
    """Names of some content in every block; the content is walked once."""
    shared = cast("dict[str, Json]", canonical(content, _whole))
    return [hashed({**shared, "block": block}, ID_LENGTH) for block in blocks]


def _whole(value: float) -> Json:
    """Spell a number: without decimals where it has none."""
    if not math.isfinite(value):
        raise InputError(Fault("case", f"cannot name the content {value!r}"))
    is_whole = isinstance(value, float) and value.is_integer() and abs(value) < 2**53
    return int(value) if is_whole else value


#: Document of a cell or of a file, in mm, N, MPa and deg: what is hashed and what lies on a disk.
#: Everywhere else a cell is a value of the classes below.
Config = dict[str, object]
#: keys of a test that few have: a body that presses, a motion besides, its course in time
_SELDOM = ("indenter", "motion", "gravity", "speed_mm_per_s", "hold_s", "cycles", "prestretch")


@dataclass(frozen=True)
class CellProblem(ForwardCell):
    """One test of a cell: what is pressed, how, and how it is discretized."""

    specimen: Specimen
    test: Test
    material: MaterialSection
    model: Model
    #: File of a surface; None where nobody has looked for it.
    surface_file: PlacedFile | None = None

    @classmethod
    def of(cls, document: Mapping[str, object]) -> CellProblem:
        """Read a problem back from its document: what lies on a disk, or is given as numbers."""
        table, test = table_of(document, "specimen"), dict(table_of(document, "test"))
        placed = {key: table[key] for key in ("path", "sha256", "height_mm") if key in table}
        if pressed := table_of(test, "indenter"):
            kind = INDENTERS[str(pressed["shape"])]
            test["indenter"] = section_of("test.indenter", kind, pressed)
        return cls(
            section_of("specimen", SPECIMENS[str(table["shape"])], table),
            section_of("test", Test, test),
            MaterialSection.of(table_of(document, "material")),
            section_of("model", Model, table_of(document, "model")),
            PlacedFile(**placed) if placed.get("path") else None,  # type: ignore[arg-type]
        )

    @property
    def calibrated_names(self) -> tuple[str, ...]:
        """Names of the constants that a fit may find."""
        return self.material.calibrated_names

    @cached_property
    def test_name(self) -> str:
        """Name of its specimen, test and measurements, whatever the steps."""
        spec, test = self.measurements, values_of(replace(self.test, steps=1))
        return digest([self.specimen, test, None if spec is None else spec.as_dict()])

    @property
    def depth_mm(self) -> float | None:
        """How far its test goes; None where that is open."""
        return self.test.displacement_mm

    @property
    def discretization(self) -> str:
        """Kind of its elements; nothing where no mesh matters."""
        if self.is_homogeneous:
            return ""
        names = ("space", "element_order", "element_shape", "formulation")
        return " ".join(str(getattr(self.model, name)) for name in names)

    @cached_property
    def setup(self) -> Setup:
        """Specimen, test and discretization; a surface is read from where it was found."""
        specimen, file = self.specimen, self.surface_file
        if isinstance(specimen, Surface) and file is not None:
            specimen = replace(specimen, file=file.path)
        return Setup(specimen, self.test, self.model, self.height_mm)

    @cached_property
    def gauge(self) -> Gauge | None:
        """Return what turns recorded strain and stress into displacement and force."""
        setup = self.setup
        if setup.height_mm is None:
            return None
        height, area = height_and_area(setup.specimen)
        power, indenter = 1.0, setup.test.indenter
        if indenter is not None:
            # the slope of the force is in proportion to the radius of contact (Sneddon 1965)
            shallow = 0.1 * (setup.test.displacement_mm or height)
            radii = [indenter.contact_radius_mm(depth) for depth in (shallow, 2 * shallow)]
            power += math.log2(radii[1] / radii[0])
        return Gauge(area, height, setup.kind.mode, setup.kind.sense, setup.is_homogeneous, power)

    @property
    def is_meshed_freely(self) -> bool:
        """Whether its mesh fills a closed surface, so that no other mesh is nested in it."""
        return isinstance(self.specimen, Enclosed)

    def as_cylinder(self) -> Self:
        """Copy of a block's problem with a cylinder of the same cross-section and height."""
        block = self.specimen
        if not isinstance(block, Block):
            raise TypeError(f"a {block.shape} has no cylinder like it")
        radius = math.sqrt(block.volume_mm3 / block.height_mm / math.pi)
        return replace(self, specimen=Cylinder(radius, block.height_mm))

    @property
    def height_mm(self) -> float | None:
        """Height of the specimen; only the file of a surface knows it."""
        if isinstance(self.specimen, Surface):
            return None if self.surface_file is None else self.surface_file.height_mm
        return self.specimen.height_mm

    def at(
        self, constants: Mapping[str, float] | None = None, depth_mm: float | None = None
    ) -> Problem:
        """Problem with given or fitted constants in MPa, and another depth of its test."""
        return self.setup.problem(self.material.material(constants), depth_mm)

    def with_placeholder(self, depth_mm: float | None = None, C10_MPa: float = 1.0) -> Problem:  # noqa: N803
        """Problem with a neo-Hookean material in place of the material to be fitted."""
        solid = replace(self.material, model="neo-hookean", order=None, constants={})
        return self.setup.problem(solid.material({"C10": C10_MPa}), depth_mm)

    def on_mesh(self, **changes: object) -> Self:
        """Copy with other values of its discretization."""
        return replace(self, model=replace(self.model, **changes))  # type: ignore[arg-type]

    def loaded(self, **changes: object) -> Self:
        """Copy with other values of its test."""
        return replace(self, test=replace(self.test, **changes))  # type: ignore[arg-type]

    def alone(self) -> Self:
        """Copy without measurements and markers: the problem that a solver gets."""
        return replace(self, measurements=None, markers=None, parameters={}, units={})

    def value_at(self, key: str) -> float | None:
        """Return the number under a dotted key of the file, in internal units; None without one."""
        table, *within, name = key.split(".")
        if table == "material":
            return self.material.value_at(name)
        if table not in ("specimen", "test", "model"):
            return super().value_at(key)
        value: object = getattr(self, table)
        for part in (*within, name):
            field = None if value is None else field_named(value, part)
            value = None if field is None else getattr(value, field)
        return float(value) if isinstance(value, (int, float)) else None

    def with_value(self, key: str, value: float) -> Self:
        """Copy with another number under a dotted key that has one."""
        table, *path = key.split(".")
        if table == "material":
            return replace(self, material=self.material.with_value(path[-1], value))
        if table == "parameters":
            return super().with_value(key, value)
        return replace(self, **{table: _with_number(getattr(self, table), path, value)})  # type: ignore[arg-type]

    @property
    def is_homogeneous(self) -> bool:
        """Whether the deformation is the same everywhere: compression, both faces frictionless."""
        return self.setup.is_homogeneous

    @property
    def has_closed_form(self) -> bool:
        """Whether our own model predicts, and the closed form is its answer."""
        return self.is_homogeneous and self.forward is None

    def document(self) -> Config:
        """Plain values in internal units, without what is left open."""
        others: Config = {} if self.forward is None else {"forward": self.forward.document()}
        if self.parameters:
            others["parameters"] = dict(self.parameters)
        if self.units:
            others["units"] = dict(self.units)
        if self.markers is not None:
            marker = {} if self.marker_file is None else self.marker_file.document()
            others["markers"] = {**self.markers.as_dict(), **marker}
        surface = {} if self.surface_file is None else self.surface_file.document()
        spec = {} if self.measurements is None else self.measurements.as_dict()
        measured = {key: value for key, value in spec.items() if key != "citation"} or None
        return {
            "specimen": {**document_of(self.specimen), **surface},
            "test": document_of(self.test, _SELDOM),
            "material": _material(self.material),
            "model": _model(self.model),
            "measurements": measured,
        } | others

    def physical(self) -> Config:
        """Part of the document that can change a curve."""
        # In homogeneous compression the closed form is exact: of the specimen its area and height
        # count, and nothing of the discretisation.
        document, specimen = self.document(), self.specimen
        if isinstance(specimen, Enclosed) or not self.has_closed_form:
            return document
        test = {k: v for k, v in table_of(document, "test").items() if k != "steps"}
        area = float(f"{specimen.area_mm2:.12g}")
        reduced = {"area_mm2": area, "height_mm": specimen.height_mm}
        return {**document, "specimen": reduced, "test": test, "model": None}


def _with_number(section: object, path: Sequence[str], value: float) -> object:
    """Copy a section with another number under a path of keys, all of which it has."""
    name = field_named(section, path[0]) or path[0]
    inner = _with_number(getattr(section, name), path[1:], value) if path[1:] else value
    return replace(section, **{name: inner})  # type: ignore[type-var]


def tested(problem: ForwardCell) -> CellProblem:
    """Take a problem for that of a specimen; raises :class:`TypeError` of parameters alone."""
    if not isinstance(problem, CellProblem):
        raise TypeError("parameters alone have no specimen, test or material")
    return problem


def _material(section: MaterialSection) -> Config:
    document: Config = {
        "model": section.model,
        "order": section.order,
        "constants": dict(section.constants),
    }
    if section.relaxation:
        document["relaxation"] = [term.document() for term in section.relaxation]
    # of the ways to say how volume changes a material has one
    return {**document, **document_of(section.compressibility, values_of(section.compressibility))}


def _model(model: Model) -> Config:
    """Discretization with one size: the element size in mm, or the name of a mesh."""
    named = ("mesh", "mesh_ratio") if model.mesh_size_mm is None else ("mesh_size_mm",)
    seeded = () if model.mesh_seed is None else ("mesh_seed",)
    keys = ("space", "element_order", "element_shape", "formulation", *named, *seeded)
    return {key: value for key, value in document_of(model).items() if key in keys}


@dataclass(frozen=True)
class Cell:
    """What a cell of a design computes."""

    problem: ForwardCell
    #: How the constants are found.
    method: str
    #: What is predicted by constants that were fitted without it.
    leave_out: str | None = None
    #: Test that the constants are fitted to, where it is another one.
    fitted_elsewhere: ForwardCell | None = None

    @property
    def fitted(self) -> ForwardCell:
        """Test that the constants are fitted to."""
        return self.fitted_elsewhere or self.problem

    @property
    def is_calibrated(self) -> bool:
        """Whether constants are fitted at all."""
        return self.method != "none"

    def changed(self, change: Callable[[CellProblem], CellProblem]) -> Cell:
        """Copy with the change made to its test and to the test that it is fitted to."""
        pair = (self.problem, self.fitted_elsewhere)
        problems = [change(p) if isinstance(p, CellProblem) else p for p in pair]
        return replace(self, problem=problems[0], fitted_elsewhere=problems[1])  # type: ignore[arg-type]

    def on_mesh(self, **changes: object) -> Cell:
        """Copy with other values of its discretization."""
        return self.changed(lambda problem: problem.on_mesh(**changes))

    def document(self) -> Config:
        """Plain values in internal units."""
        if not isinstance(self.problem, CellProblem):
            return self.problem.document()  # of parameters alone nothing is calibrated
        return self._calibrated(self.method, lambda problem: problem.document())

    def _calibrated(self, method: str, described: Callable[[ForwardCell], Config]) -> Config:
        """Describe what is predicted, with the way to its constants."""
        other = None if self.fitted_elsewhere is None else described(self.fitted_elsewhere)
        calibration = {"method": method, "problem": other, "leave_out": self.leave_out}
        return {**described(self.problem), "calibration": calibration}

    @cached_property
    def calibration_key(self) -> str | None:
        """Name of its calibration problem: cells with one name share one fit a block."""
        if not self.is_calibrated:
            return None
        return case_id({**self.fitted.physical(), "method": self._distinct_method})

    @cached_property
    def physical_key(self) -> str:
        """Name of what it computes: cells with one name must agree physically."""
        return case_id(self._calibrated(self._distinct_method, lambda p: p.physical()))

    @cached_property
    def content_key(self) -> str:
        """Name of its document: cells with one name are one computation."""
        return case_id(self.document())

    @property
    def _distinct_method(self) -> str:
        """Method, where the closed form makes all methods one."""
        return "exact" if self.is_calibrated and self.fitted.has_closed_form else self.method


@dataclass(frozen=True)
class Combination:
    """A label for every factor."""

    levels: Mapping[str, str]

    @property
    def label(self) -> str:
        """Labels of the levels, such as ``"neo-hookean / bonded / 3d / linear"``."""
        return " / ".join(self.levels.values())


@dataclass(frozen=True)
class Treatment(Combination):
    """One cell of the design: a label for every factor, and what they make of the file."""

    cell: Cell


@dataclass(frozen=True)
class Case(Treatment):
    """One treatment in one block; of files found and meshes seeded it has a cell of its own."""

    block: str | None
    #: A hash of what decides its numbers.
    case_id: str

    @property
    def problem(self) -> ForwardCell:
        """What is predicted."""
        return self.cell.problem

    @property
    def tested(self) -> CellProblem:
        """What is predicted, of a case that is a test of a specimen."""
        return tested(self.cell.problem)

    @property
    def label(self) -> str:
        """Labels of the levels, and the block."""
        return super().label if self.block is None else f"{super().label} / {self.block}"
