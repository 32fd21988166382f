"""A fit in plain values, as the store keeps it: numbers, names and None, never NaN."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from study.curve import Curve
from study.errors import Fault, InputError
from study.material.stability import stability
from study.setup.material_section import MaterialSection
from study.setup.setup import known_height_mm

Config = Mapping[str, Any]


def described(
    found: Any, config: Config, names: Sequence[str], measured: Sequence[Curve]
) -> dict[str, Any]:
    """Plain description of a fit for the store."""
    values = [float(v) for v in found.values]
    constants = dict(zip(names, values, strict=True))
    good = bool(found.status.usable)
    result: dict[str, Any] = {
        "status": "converged" if good else "not-converged",
        "message": str(found.message),
        "names": list(names),  # JSON sorts keys; the matrices need their order
        "values": constants,
        "standard_error": _numbers(names, found.standard_error),
        "ci95": _intervals(names, found.ci95),
        "correlation": _matrix(found.correlation),
        "condition": _number(found.condition),
        "rss": _number(found.rss),
        "r_squared": _number(found.r_squared),
        "aicc": _number(found.aicc),
        "n": int(found.n),
        "identifiable": bool(found.identifiable) and bool(found.status.converged),
        "reason": str(found.reason) if found.status.converged else str(found.status.sentence),
        "evaluations": int(found.evaluations),
    }
    if good:
        result |= _stability(config, constants, measured)
    return result


def _stability(
    config: Config, constants: Mapping[str, float], measured: Sequence[Curve]
) -> dict[str, Any]:
    """Mu0 and whether the material is stable over the range that was measured."""
    material = MaterialSection.of(config["material"]).material(constants)
    outcome: dict[str, Any] = {"mu0": float(material.mu0)}
    height = known_height_mm(config["specimen"])
    depth = max(float(curve.displacement_mm.max()) for curve in measured)
    if height is None or config["test"]["kind"] != "compression" or depth >= height:
        judged = stability(material)
    else:
        judged = stability(material, stretches=np.linspace(1 - depth / height, 1.0, 41))
    # only uniaxial failure inside the range makes the answer itself meaningless; the other
    # modes are a warning about using the constants elsewhere
    outcome |= {
        "stable": bool(judged.stable),
        "stability": str(judged.sentence),
        "usable": "uniaxial" not in judged.limits,
    }
    if material.mu0 <= 0:
        raise InputError(Fault("fit", f"ended at a shear modulus of {material.mu0:g} MPa"))
    return outcome


def _number(value: Any) -> float | None:
    if value is None:
        return None
    number = float(value)
    return number if np.isfinite(number) else None


def _numbers(names: Sequence[str], values: Any) -> dict[str, float | None]:
    if values is None:
        return dict.fromkeys(names)
    return {n: _number(v) for n, v in zip(names, values, strict=True)}


def _intervals(names: Sequence[str], values: Any) -> dict[str, list[float | None] | None]:
    if values is None:
        return dict.fromkeys(names)
    return {n: [_number(v) for v in pair] for n, pair in zip(names, values, strict=True)}


def _matrix(values: Any) -> list[list[float | None]] | None:
    if values is None:
        return None
    return [[_number(v) for v in row] for row in np.asarray(values)]
