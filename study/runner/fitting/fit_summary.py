"""What became of a fit: constants with all that is known of them, or why there are none."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from study.arrays import Array
from study.calibration.fit import Fit
from study.calibration.iteration import Status
from study.curve import Curve
from study.errors import Fault, InputError
from study.material.stability import stability
from study.record.document import FitDocument
from study.runner.fitting.solution import Predicted
from study.setup.material_section import MaterialSection
from study.setup.setup import Setup, Tables

FitStatus = Literal["converged", "at-edge", "at-kink", "not-converged"]

#: ends of a fit that has constants
WITH_CONSTANTS: Collection[str] = ("converged", "at-edge", "at-kink")


def status_of(found: Fit) -> FitStatus:
    """How a fit ended, in the words of every verb.

    ``at-edge`` and ``at-kink`` are ends with constants that describe the data as well as the
    model can, and without standard errors.

    Parameters
    ----------
    found : Fit
        Also one that failed.

    Returns
    -------
    {"converged", "at-edge", "at-kink", "not-converged"}
    """
    if found.status is Status.at_edge:
        return "at-edge"
    if found.status is Status.at_kink:
        return "at-kink"
    return "converged" if found.converged else "not-converged"


@dataclass(frozen=True)
class FitResult:
    """Outcome of a fit, as the store keeps it and cases read it.

    Parameters
    ----------
    status : str
        ``"converged"``, ``"at-edge"``, ``"at-kink"``, or the reason why there are no constants.
    fit : FitDocument
        What is known of it; of a fit without constants its message alone.
    prediction : Predicted or None
        Last solution of an inverse fit of one test: the curve of the final constants.
    start_seconds : float
        What the fit took that gave the start.
    """

    status: str
    fit: FitDocument
    prediction: Predicted | None = None
    start_seconds: float = 0.0

    @classmethod
    def without_answer(cls, status: str, message: str) -> FitResult:
        """Outcome of a fit that could not be begun."""
        return cls(status, {"message": message})

    @property
    def converged(self) -> bool:
        """Whether it found constants, if without standard errors."""
        return self.status in WITH_CONSTANTS

    @property
    def usable(self) -> bool:
        """Whether its constants are stable over the range of the test."""
        return self.converged and self.fit.get("usable", True)

    @property
    def message(self) -> str:
        """How it ended."""
        return self.fit.get("message", "")

    @property
    def constants(self) -> dict[str, float]:
        """Constants in MPa, exponents plain; none where it did not converge."""
        return self.fit.get("values", {})

    @property
    def seconds(self) -> float:
        """What it took, the fit before it left out."""
        return self.fit.get("seconds", 0.0)

    def to_json(self) -> dict[str, object]:
        """Plain data with all keys side by side."""
        predicted = {} if self.prediction is None else self.prediction.to_json()
        plain = {"status": self.status, "start_seconds": self.start_seconds}
        return {**plain, **self.fit, **predicted}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> FitResult:
        """Inverse of :meth:`to_json`; a task that had no answer has a status and a message."""
        known = {k: v for k, v in document.items() if k in FitDocument.__annotations__}
        return cls(
            str(document["status"]),
            cast(FitDocument, known),
            Predicted.from_json(document) if "curve" in document else None,
            cast(float, document.get("start_seconds", 0.0)),
        )


def described(found: Fit, tables: Tables, measured: Sequence[Curve]) -> FitDocument:
    """Describe a fit.

    Parameters
    ----------
    found : Fit
        Constants in MPa; numbers that are not finite become None.
    tables : mapping
        Of the fitted test.
    measured : sequence of Curve
        Curves whose range decides whether the constants are stable enough.

    Returns
    -------
    FitDocument
        With mu0 (MPa) and stability where the fit has constants.

    Raises
    ------
    InputError
        If a usable fit ended at a shear modulus that is not positive.
    """
    names = found.names
    document: FitDocument = {
        "message": found.message,
        "names": list(names),  # JSON sorts keys; the matrices need their order
        "values": found.constants(),
        "standard_error": {n: _finite(v) for n, v in zip(names, found.standard_error, strict=True)},
        "ci95": {n: _row(pair) for n, pair in zip(names, found.ci95, strict=True)},
        "correlation": [_row(row) for row in found.correlation],
        "condition": _finite(found.condition),
        "rss": _finite(found.rss),
        "r_squared": _finite(found.r_squared),
        "aicc": _finite(found.aicc),
        "n": int(found.n),
        "identifiable": bool(found.identifiable) and found.converged,
        "reason": str(found.reason),
        "evaluations": int(found.evaluations),
    }
    if found.status.usable:
        document.update(_stability(tables, found.constants(), measured))
    return document


def _stability(
    tables: Tables, constants: Mapping[str, float], measured: Sequence[Curve]
) -> FitDocument:
    """Mu0 and whether the material is stable over the range that was measured."""
    material = MaterialSection.of(tables).material(constants)
    if material.mu0 <= 0:
        raise InputError(Fault("fit", f"ended at a shear modulus of {material.mu0:g} MPa"))
    setup = Setup.of(tables)
    height, is_pressed = setup.height_mm, setup.kind.compresses
    depth = max(float(curve.displacement_mm.max()) for curve in measured)
    if height is None or not is_pressed or depth >= height:
        judged = stability(material)
    else:
        judged = stability(material, stretches=np.linspace(1 - depth / height, 1.0, 41))
    # only uniaxial failure inside the range makes the answer itself meaningless; the other
    # modes are a warning about using the constants elsewhere
    return {
        "mu0": float(material.mu0),
        "stable": bool(judged.stable),
        "stability": str(judged.sentence),
        "usable": "uniaxial" not in judged.limits,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _row(values: Array) -> list[float | None]:
    return [_finite(value) for value in values]
