"""What of a specimen has been stretched beyond what its energy can carry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.fields import deformation_gradient
from study.forward.system import State, System
from study.material.ellipticity import always_elliptic, ellipticity

Array = NDArray[np.float64]

#: points that are looked at: where an energy gives way it does so where it is stretched most
_LOOKED_AT = 500


def lost_ellipticity(system: System, state: State) -> str:
    """Say where the energy has lost its ellipticity at a state; empty where it has not.

    The place that is said is the one furthest beyond, among the points of quadrature that are
    stretched most.
    """
    if always_elliptic(system.material):
        return ""
    F = deformation_gradient(system.space, system.displacements(state.x))
    F = F.reshape(3, 3, -1)
    most = np.argsort(-np.einsum("ijq,ijq->q", F, F))[:_LOOKED_AT]
    found = np.linalg.svd(np.moveaxis(F[:, :, most], -1, 0), compute_uv=False)
    stretches: Array = np.array(found.T, dtype=np.float64)
    margin = ellipticity(system.material, stretches)
    if margin.min() > 0:
        return ""
    largest = " x ".join(f"{s:.3g}" for s in stretches[:, margin.argmin()])
    return f"with these constants the energy is no longer elliptic where it is stretched {largest}"
