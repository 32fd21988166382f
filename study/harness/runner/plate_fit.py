"""The motion of a plate that markers inside a specimen tell, and what they are off.

How a plate moved is rarely known as well as the places of markers: its motion is fitted by
Gauss and Newton's method, on derivatives of the displacements that one factorization of the
converged tangent gives. What is left is the model's error, and that of the markers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Flags
from study.ground.errors import Fault, InputError, RefusedError
from study.harness.record.document import PlateFitDocument
from study.mechanics.measurement.marker_states import MarkerStates
from study.mechanics.measurement.measurement_section import MarkerSpec
from study.mechanics.setup.setup import Problem

if TYPE_CHECKING:
    from study.mechanics.solver.load_path import MovedPlate, PrescribedMotion
    from study.mechanics.solver.solution import Solution


#: names of the components of a motion, and their units
COMPONENTS = {
    "down": "mm",
    "x": "mm",
    "y": "mm",
    "tilt_x": "deg",
    "tilt_y": "deg",
    "twist": "deg",
    "spread": "%",
}

#: in units of the components: mm, rad and plain numbers become what is printed
_SHOWN = np.array([1.0, 1.0, 1.0, np.degrees(1), np.degrees(1), np.degrees(1), 100.0])

#: how many components a plate has, by what it is taken to do
_FREE = {"nominal": 0, "rigid": 6, "slipping": 7}

#: change of the motion, over the size of the specimen, at which it has settled
_SETTLED = 1e-6
_MOST_STEPS = 15


@dataclass(frozen=True)
class PlateFit:
    """Errors of markers under one motion of the plate."""

    #: {"nominal", "rigid", "slipping"}: what it is taken to do.
    plate: str
    #: Markers that told its motion: ``"none"``, ``"all"``, or layers.
    fitted: str
    #: shape (7,); as :data:`COMPONENTS`; standard errors treat the coordinates of one marker
    #: together.
    motion: Array
    standard_error: Array
    #: shape (n, 3); measured less predicted displacement of every marker, mm.
    errors: Array
    #: shape (n,); markers that are judged.
    scored: Flags

    @property
    def rms_mm(self) -> float:
        """Root mean square of the distances, over the markers that are judged."""
        return rms(self.errors[self.scored])

    def to_json(self, layers: tuple[str, ...]) -> PlateFitDocument:
        """Plain values, for a record and a report."""
        shown = zip(COMPONENTS, self.motion, self.standard_error, strict=True)
        own = np.array(layers) if layers else np.full(len(self.errors), "")
        names = dict.fromkeys(own[self.scored].tolist()) if layers else {}
        by_axis = np.sqrt((self.errors[self.scored] ** 2).mean(axis=0))
        return {
            "plate": self.plate,
            "fitted": self.fitted,
            "markers": int(self.scored.sum()),
            "error_mm": self.rms_mm,
            "error_by_axis_mm": [float(v) for v in by_axis],
            "error_by_layer_mm": {
                str(k): rms(self.errors[self.scored & (own == k)]) for k in names
            },
            "motion": {name: [float(value), float(error)] for name, value, error in shown},
        }


def rms(errors: Array) -> float:
    """Root mean square length of vectors.

    Shapes: errors (n, 3), mm.
    """
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def plate_fits(
    spec: MarkerSpec, markers: MarkerStates, label: str, problem: Problem, solution: Solution
) -> tuple[PlateFit, ...]:
    """Compare a simulated block with markers, by what its plate is taken to do."""
    fitter = _Fitter.of(markers, label, problem, solution)
    every = np.ones(len(markers.rest), dtype=bool)
    fits = [fitter.fitted(plate, "all", every, every) for plate in _FREE]
    if spec.fit:
        chosen = markers.within(spec.fit)
        fits.append(fitter.fitted(spec.plate, f"layers {', '.join(spec.fit)}", chosen, ~chosen))
    return tuple(fits)


@dataclass
class _Fitter:
    """Fits to one state; each begins where the last one ended."""

    motion: PrescribedMotion
    interpolated: Callable[[Array], Array]
    measured: Array
    size_mm: float
    at: MovedPlate

    @classmethod
    def of(cls, markers: MarkerStates, label: str, problem: Problem, solution: Solution) -> _Fitter:
        from study.mechanics.element.function_space import interpolation
        from study.mechanics.solver.load_path import PrescribedMotion

        plate = PrescribedMotion(problem, solution)
        interpolated = interpolation(plate.system.mesh, problem.model, markers.rest)
        height = plate.system.height_mm
        return cls(plate, interpolated, markers.moved[label], height, plate.start)

    def fitted(self, plate: str, name: str, chosen: Flags, scored: Flags) -> PlateFit:
        """Fit the motion to some markers and judge it on others."""
        free = _FREE[plate]
        if not free:
            at = self.motion.start
            return PlateFit(
                plate, "none", at.motion * _SHOWN, np.zeros(7), self._errors(at), scored
            )
        length = np.array([1.0, 1.0, 1.0, *[self.size_mm / 2] * 4])[:free]
        for _ in range(_MOST_STEPS):
            slope = self._slope(self.at, free, chosen)
            change = _solved(slope * (1 / length), self._errors(self.at)[chosen].ravel()) / length
            moved = self.at.motion.copy()
            moved[:free] += change
            if free < 7:
                moved[6] = self.motion.start.motion[6]
            self.at = self.motion.at(moved, self.at)
            if np.abs(change * length).max() < _SETTLED * self.size_mm:
                break
        else:
            rule = f"the motion of the {plate} plate has not settled in {_MOST_STEPS} steps"
            mend = "see whether the markers belong to this test and to this displacement"
            raise RefusedError(str(Fault("markers", rule, mend)))
        errors = self._errors(self.at)
        spread = np.zeros(7)
        spread[:free] = _standard_errors(self._slope(self.at, free, chosen), errors[chosen])
        return PlateFit(plate, name, self.at.motion * _SHOWN, spread * _SHOWN, errors, scored)

    def _errors(self, at: MovedPlate) -> Array:
        return np.asarray(self.measured - self.interpolated(at.displacement))

    def _slope(self, at: MovedPlate, free: int, chosen: Flags) -> Array:
        """Differentiate the displacements of markers, shape (3 n, free)."""
        each = [self.interpolated(at.rates[:, :, k]) for k in range(free)]
        return np.stack(each, axis=-1)[chosen].reshape(-1, free)


def _solved(slope: Array, errors: Array) -> Array:
    found, _, rank, _ = np.linalg.lstsq(slope, errors, rcond=1e-10)
    if rank < slope.shape[1]:
        rule = "the markers that are fitted do not tell every component of the plate's motion"
        raise InputError(Fault("markers.fit", rule, "fit more layers, or another plate"))
    return np.asarray(found)


def _standard_errors(slope: Array, errors: Array) -> Array:
    """Errors of a fit, robust to unequal coordinates of a marker (Liang and Zeger 1986, eq. 11)."""
    inverse = np.linalg.inv(slope.T @ slope)
    scores = np.einsum("nik,ni->nk", slope.reshape(len(errors), 3, -1), errors)
    share = len(errors) / max(len(errors) - slope.shape[1] / 3, 1.0)
    return np.asarray(np.sqrt(np.diag(inverse @ (share * scores.T @ scores) @ inverse)))
