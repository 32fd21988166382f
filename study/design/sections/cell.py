"""A cell resolved: its problems as sections with all defaults filled in, and as documents."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from study.design.sections.content import case_id
from study.measurement.marker_section import MarkerSpec
from study.measurement.section import MeasurementSpec
from study.setup import setup
from study.setup.forward_model import ForwardModel
from study.setup.geometry import Enclosed, Specimen, Surface
from study.setup.material_section import MaterialSection
from study.setup.section import table_of, values_of
from study.setup.setup import Model, Setup
from study.setup.test_kind import Test
from study.setup.test_section import TestSection

#: Document of a cell or of a file, in mm, N, MPa and deg: what leaves this room, to be hashed and
#: to be computed. Inside the room a cell is a value of the classes below.
Config = dict[str, object]

#: keys of a test that few have: its course in time, a stretch before it; left out where they say
#: nothing
SELDOM = ("speed_mm_per_s", "hold_s", "cycles", "prestretch")


@dataclass(frozen=True)
class CellProblem:
    """One test of a cell: what is pressed, how, and how it is discretized.

    Parameters
    ----------
    specimen, test, material, model
        Sections of the study file.
    measurements : MeasurementSpec, optional
        Where its measured curves are.
    forward : ForwardModel, optional
        What predicts its curves; None for the built-in finite elements.
    markers : MarkerSpec, optional
        Where the places of markers inside the specimen are.
    """

    specimen: Specimen
    test: TestSection
    material: MaterialSection
    model: Model
    measurements: MeasurementSpec | None = None
    forward: ForwardModel | None = None
    markers: MarkerSpec | None = None

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
        """Whether the deformation is the same everywhere: compression, both faces frictionless.

        The closed form is then exact, and space, mesh, order and element shape cannot matter.
        """
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
        beside: Config = {} if self.forward is None else {"forward": values_of(self.forward)}
        if self.markers is not None:
            beside["markers"] = self.markers.as_dict()
        return {
            "specimen": values_of(self.specimen),
            "test": test,
            "material": _material(self.material),
            "model": _model(self.model),
            "measurements": self.measurements,
        } | beside

    def physical(self) -> Config:
        """Part of the document that can change a curve.

        In homogeneous compression the closed form is exact: of the specimen its area and
        height count, and nothing of the discretisation.
        """
        kept, specimen = self.document(), self.specimen
        if isinstance(specimen, Enclosed) or not self.has_closed_form:
            return kept
        test = {k: v for k, v in table_of(kept, "test").items() if k != "steps"}
        area = float(f"{specimen.area_mm2:.12g}")
        reduced = {"area_mm2": area, "height_mm": specimen.height_mm}
        return {**kept, "specimen": reduced, "test": test, "model": None}


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
    kept = ("space", "element_order", "element_shape", "formulation", *named)
    return {key: value for key, value in values_of(model).items() if key in kept}


@dataclass(frozen=True)
class Cell:
    """What a cell of a design computes.

    Parameters
    ----------
    problem : CellProblem
        What is predicted.
    method : {"auto", "analytic", "inverse-fem", "none"}
        How the constants are found.
    leave_out : {"specimen", "test", "nothing"}, optional
        What is predicted by constants that were fitted without it.
    fitted_elsewhere : CellProblem, optional
        Test that the constants are fitted to, where it is another one.
    """

    problem: CellProblem
    method: str
    leave_out: str | None = None
    fitted_elsewhere: CellProblem | None = None

    @property
    def fitted(self) -> CellProblem:
        """Test that the constants are fitted to."""
        return self.fitted_elsewhere or self.problem

    @property
    def is_calibrated(self) -> bool:
        """Whether constants are fitted at all."""
        return self.method != "none"

    def document(self) -> Config:
        """Plain values in internal units."""
        other = self.fitted_elsewhere
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
