"""Force-displacement curves, measured or predicted: one type, so a residual is a subtraction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """Force against displacement of a whole specimen.

    Parameters
    ----------
    displacement_mm : ndarray, shape (n,)
        Displacement of the plate or indenter, positive into the specimen, increasing.
    force_N : ndarray, shape (n,)
        Force on the whole specimen, positive when it resists.
    stiffness_N_per_mm : ndarray, shape (n,), optional
        Tangent dF/dd; with it the curve is interpolated by cubic Hermite polynomials.
    force_gradient : mapping of str to ndarray, shape (n,)
        dF/dtheta for each material constant, in N per MPa (N for a plain exponent).
    """

    displacement_mm: Array
    force_N: Array
    stiffness_N_per_mm: Array | None = None
    force_gradient: Mapping[str, Array] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.displacement_mm.size)

    def force_at(self, displacement_mm: ArrayLike) -> Array:
        """Force in N at given displacements; an unloaded origin (0, 0) is part of the curve.

        Raises
        ------
        ValueError
            If a displacement lies beyond the end of the curve.
        """
        d = np.asarray(displacement_mm, dtype=float)
        knots, force, slope = self._with_origin()
        if d.size and (d.min() < -1e-12 or d.max() > knots[-1] * (1 + 1e-9) + 1e-12):
            raise ValueError(
                f"the curve ends at {knots[-1]:.6g} mm, asked for {d.min():.6g} to {d.max():.6g} mm"
            )
        if slope is None:
            return np.asarray(np.interp(d, knots, force))
        return _hermite(np.clip(d, 0, knots[-1]), knots, force, slope)

    def gradient_at(self, name: str, displacement_mm: ArrayLike) -> Array:
        """dF/dtheta at given displacements (monotone cubic through the solved steps)."""
        from scipy.interpolate import CubicSpline

        knots, values = self.displacement_mm, self.force_gradient[name]
        if knots[0] > 0:
            knots, values = np.r_[0.0, knots], np.r_[0.0, values]
        d = np.clip(np.asarray(displacement_mm, dtype=float), 0, knots[-1])
        if knots.size < 3:
            return np.asarray(np.interp(d, knots, values))
        return np.asarray(CubicSpline(knots, values)(d))

    def as_dict(self) -> dict[str, Any]:
        """Plain lists, for JSON."""
        out: dict[str, Any] = {
            "displacement_mm": self.displacement_mm.tolist(),
            "force_N": self.force_N.tolist(),
        }
        if self.stiffness_N_per_mm is not None:
            out["stiffness_N_per_mm"] = self.stiffness_N_per_mm.tolist()
        if self.force_gradient:
            out["force_gradient"] = {k: v.tolist() for k, v in self.force_gradient.items()}
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Curve:
        """Inverse of :meth:`as_dict`."""
        stiffness = data.get("stiffness_N_per_mm")
        return cls(
            np.asarray(data["displacement_mm"], float),
            np.asarray(data["force_N"], float),
            None if stiffness is None else np.asarray(stiffness, float),
            {k: np.asarray(v, float) for k, v in data.get("force_gradient", {}).items()},
        )

    def _with_origin(self) -> tuple[Array, Array, Array | None]:
        d, f, s = self.displacement_mm, self.force_N, self.stiffness_N_per_mm
        if d[0] <= 0:
            return d, f, s
        if s is None:
            return np.r_[0.0, d], np.r_[0.0, f], None
        # the slope at the origin that makes the first interval's cubic a parabola
        return np.r_[0.0, d], np.r_[0.0, f], np.r_[2 * f[0] / d[0] - s[0], s]


def _hermite(x: Array, knots: Array, value: Array, slope: Array) -> Array:
    from scipy.interpolate import CubicHermiteSpline

    return np.asarray(CubicHermiteSpline(knots, value, slope)(x))
