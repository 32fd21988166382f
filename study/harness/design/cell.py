"""A cell resolved: its problems as sections with all defaults filled in, and as documents."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from typing import cast, overload

import numpy as np

from study.ground.canonical import Json
from study.ground.errors import Fault, InputError
from study.harness.design.forward_model import ForwardCell
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.setup import setup
from study.mechanics.setup.declaration import table_of, values_of
from study.mechanics.setup.geometry import Enclosed, Specimen, Surface
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Setup
from study.mechanics.setup.test_kind import Test
from study.mechanics.setup.test_section import TestSection

# Names made of content: the hash of plain values with one spelling.

ID_LENGTH = 16


def case_id(content: object) -> str:
    """Name made of content: 16 hex digits of the sha256 of canonical JSON.

    Numbers are coerced first (``1`` and ``1.0`` are one), keys sorted. Labels, names and
    citations are no content.

    Examples
    --------
    >>> case_id({"a": 1, "b": 2.5}) == case_id({"b": 2.5, "a": 1.0})
    True
    """
    return _name(_text(without_places(plain(content))))


def block_ids(content: Mapping[str, object], blocks: Sequence[str | None]) -> list[str]:
    """Names of some content in every block; the content is walked once.

    Examples
    --------
    >>> block_ids({"a": 1}, ["x"]) == [case_id({"a": 1, "block": "x"})]
    True
    """
    walked = without_places(plain(content))
    shared = walked if isinstance(walked, dict) else {}
    return [_name(_text({**shared, "block": block})) for block in blocks]


def _name(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]


def _text(named: Json) -> str:
    return json.dumps(named, sort_keys=True, allow_nan=False, separators=(",", ":"))


def without_places(value: Json) -> Json:
    """Content without ``path``: where a file lies on this machine names nothing."""
    if isinstance(value, dict):
        return {k: without_places(v) for k, v in value.items() if k != "path"}
    return [without_places(v) for v in value] if isinstance(value, list) else value


@overload
def plain(value: Mapping[str, object]) -> dict[str, Json]: ...


@overload
def plain(value: object) -> Json: ...


def plain(value: object) -> Json:
    """Plain JSON values of a configuration, numbers coerced."""
    if type(value) in _ATOMS:
        return cast("Json", value)
    if isinstance(value, MeasurementSpec):
        return plain({k: v for k, v in value.as_dict().items() if k != "citation"})
    if is_dataclass(value) and not isinstance(value, type):
        fields: dict[str, object] = vars(value)
        return plain(fields)
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(cast("object", value.tolist()))
    if isinstance(value, (str, int)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value.is_integer() and abs(value) < 2**53 else value
    raise InputError(Fault("case", f"cannot name the content {value!r}"))


#: types that are plain as they are, asked for first: nine values in ten
_ATOMS = frozenset({str, int, bool, type(None)})
#: Document of a cell or of a file, in mm, N, MPa and deg: what leaves this room, to be hashed and
#: to be computed. Inside the room a cell is a value of the classes below.
Config = dict[str, object]
#: keys of a test that few have: its course in time, a stretch before it; left out where they say
#: nothing
SELDOM = ("speed_mm_per_s", "hold_s", "cycles", "prestretch")


@dataclass(frozen=True)
class CellProblem(ForwardCell):
    """One test of a cell: what is pressed, how, and how it is discretized."""

    specimen: Specimen
    test: TestSection
    material: MaterialSection
    model: Model

    @property
    def calibrated_names(self) -> tuple[str, ...]:
        """Names of the constants that a fit may find."""
        return self.material.calibrated_names

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

    def faults_in_design(self) -> list[tuple[str, str, str]]:
        """Where, rule and mend of a course in time, of which a design has no response."""
        rule, faults = "has no place in a design", []
        mend = "responses compare curves over displacement: `study solve` follows a course"
        for key, value in (("hold", self.test.hold_s), ("cycles", self.test.cycles)):
            if value is not None:
                faults.append((f"test.{key}", rule, mend))
        if self.measurements is not None and self.measurements.columns.time is not None:
            mend = "give test.speed, or fit the course by `study calibrate`"
            faults.append(("measurements.columns.time", rule, mend))
        return faults

    @property
    def setup(self) -> Setup:
        """Specimen, test and discretization."""
        return Setup(self.specimen, self.test.loading(), self.model, self.height_mm)

    @property
    def height_mm(self) -> float | None:
        """Height of the specimen; only the file of a surface knows it."""
        return None if isinstance(self.specimen, Surface) else self.specimen.height_mm

    @property
    def is_homogeneous(self) -> bool:
        """Whether the deformation is the same everywhere: compression, both faces frictionless."""
        # The closed form is then exact, and space, mesh, order and element shape cannot matter.
        weight = self.test.gravity
        test = Test(self.test.kind, None, self.test.interface, self.test.held_below, gravity=weight)
        return setup.is_homogeneous(test, self.specimen.shape)

    @property
    def has_closed_form(self) -> bool:
        """Whether our own model predicts, and the closed form is its answer."""
        return self.is_homogeneous and self.forward is None

    def document(self) -> Config:
        """Plain values in internal units, without what is left open."""
        written = values_of(self.test)
        test = {k: v for k, v in written.items() if k not in SELDOM or v is not None}
        # what a kind of test does not have names no other
        for key in ("indenter", "motion", "gravity"):
            made = test.pop(key)
            if made is not None:
                test[key] = values_of(made)
        others: Config = {} if self.forward is None else {"forward": self.forward.document()}
        if self.parameters:
            others["parameters"] = dict(self.parameters)
        if self.units:
            others["units"] = dict(self.units)
        if self.markers is not None:
            others["markers"] = self.markers.as_dict()
        return {
            "specimen": values_of(self.specimen),
            "test": test,
            "material": _material(self.material),
            "model": _model(self.model),
            "measurements": self.measurements,
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


def _material(section: MaterialSection) -> Config:
    volume = section.compressibility
    document: Config = {
        "model": section.model,
        "order": section.order,
        "constants": dict(section.constants),
    }
    if section.relaxation:
        document["relaxation"] = [term.document() for term in section.relaxation]
    if volume.incompressible:
        return {**document, "incompressible": True}
    if volume.bulk_modulus_MPa is not None:
        return {**document, "bulk_modulus_MPa": volume.bulk_modulus_MPa}
    return {**document, "poisson_ratio": volume.poisson_ratio}


def _model(model: Model) -> Config:
    """Discretization with one size: that of its elements, or that of a named mesh."""
    named = ("mesh", "mesh_ratio") if model.mesh_size_mm is None else ("mesh_size_mm",)
    keys = ("space", "element_order", "element_shape", "formulation", *named)
    return {key: value for key, value in values_of(model).items() if key in keys}


@dataclass(frozen=True)
class Cell:
    """What a cell of a design computes."""

    problem: ForwardCell
    #: How the constants are found.
    method: str
    #: What is predicted by constants that were fitted
    #: without it.
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

    def document(self) -> Config:
        """Plain values in internal units."""
        other = self.fitted_elsewhere
        if not isinstance(self.problem, CellProblem):
            return self.problem.document()  # of parameters alone nothing is calibrated
        calibration = {
            "method": self.method,
            "problem": None if other is None else other.document(),
            "leave_out": self.leave_out,
        }
        return {**self.problem.document(), "calibration": calibration}

    @cached_property
    def calibration_key(self) -> str | None:
        """Name of its calibration problem: cells with one name share one fit a block."""
        if not self.is_calibrated:
            return None
        return case_id({**self.fitted.physical(), "method": self._distinct_method})

    @cached_property
    def physical_key(self) -> str:
        """Name of what it computes: cells with one name must agree physically."""
        other = self.fitted_elsewhere
        calibration = {
            "method": self._distinct_method,
            "problem": None if other is None else other.physical(),
            "leave_out": self.leave_out,
        }
        return case_id({**self.problem.physical(), "calibration": calibration})

    @cached_property
    def content_key(self) -> str:
        """Name of its document: cells with one name are one computation."""
        return case_id(self.document())

    @property
    def _distinct_method(self) -> str:
        """Method, where the closed form makes all methods one."""
        return "exact" if self.is_calibrated and self.fitted.has_closed_form else self.method
