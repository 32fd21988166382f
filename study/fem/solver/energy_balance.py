"""Work of the test against the energy that the specimen stores: what Newton's method cannot see.

An equilibrium is found wherever the residual vanishes, also on the other side of a limit
point, where the surface has jumped to another shape. The test then did work that the
specimen does not hold (or holds energy that nobody put in), and the sum shows it. On a path
without a jump the two differ by what the interpolation between two displacements is off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.curve import hermite_work
from study.fem.solver.internal_force import StoredEnergy

#: Share of the stored energy that may be missing, or too much, between two displacements
#: before the specimen is said to have jumped. Interpolation over a tenth of a cone's depth
#: is off by up to 0.2 % of it, jumps begin at about 0.5 %.
JUMP_SHARE = 0.005

#: The same under an indenter that sticks. Its steps are a part of the answer and cannot be taken
#: again in halves, so that what interpolation is off must not look like a jump.
STICKING_JUMP_SHARE = 0.02

#: Energy that is counted at least, over force times the whole displacement: at first touch
#: a few contact points close one after the other, and next to nothing is stored.
LEAST_ENERGY = 0.1


@dataclass(frozen=True)
class LoadedState:
    """A converged state as the energy balance sees it (whole specimen).

    Parameters
    ----------
    displacement_mm, force_N, stiffness_N_per_mm : float
        Of the test.
    stored : StoredEnergy
        N mm.
    """

    displacement_mm: float
    force_N: float
    stiffness_N_per_mm: float
    stored: StoredEnergy


def unexplained_work(before: LoadedState, after: LoadedState) -> float:
    """Work between two states, interpolated, less the energy stored meanwhile, N mm.

    Parameters
    ----------
    before, after : LoadedState
        Earlier and later state of one run.
    """
    work = hermite_work(
        np.array([before.displacement_mm, after.displacement_mm]),
        np.array([before.force_N, after.force_N]),
        np.array([before.stiffness_N_per_mm, after.stiffness_N_per_mm]),
    )
    return float(work[0]) - (after.stored.total - before.stored.total)


def jumped(
    before: LoadedState, after: LoadedState, whole_mm: float, share: float = JUMP_SHARE
) -> bool:
    """Whether energy was lost or won between two states.

    Parameters
    ----------
    before, after : LoadedState
        Earlier and later state of one run.
    whole_mm : float
        Displacement of the whole test.
    share : float
        Of the stored energy that may be missing, or too much.
    """
    least = LEAST_ENERGY * abs(after.force_N) * whole_mm
    held = max(after.stored.total, least)
    return abs(unexplained_work(before, after)) > share * held


@dataclass(frozen=True)
class EnergyBalance:
    """Energies of the requested displacements (whole specimen).

    Parameters
    ----------
    stored_Nmm, stabilization_Nmm : ndarray, shape (n,)
        Energy of the material, and of the resistance to uneven volume.
    mismatch : ndarray, shape (n,)
        Work so far, interpolated between the displacements, less the energy stored so far, over
        the largest energy stored. The work of the first interval, in which contact begins, is
        taken to be the energy stored there.
    jumps_mm : tuple of float
        Displacements at which the specimen jumped to another equilibrium.
    """

    stored_Nmm: Array
    stabilization_Nmm: Array
    mismatch: Array
    jumps_mm: tuple[float, ...] = ()

    def at_points(self, kept: NDArray[np.int64]) -> EnergyBalance:
        """Return the balance at some of the displacements, given by their places."""
        return EnergyBalance(
            self.stored_Nmm[kept], self.stabilization_Nmm[kept], self.mismatch[kept], self.jumps_mm
        )

    @property
    def largest_mismatch(self) -> float:
        """Largest share of the stored energy by which the work is off; 0 of an empty run."""
        return float(np.abs(self.mismatch).max(initial=0.0))

    @property
    def stabilization_share(self) -> float:
        """Largest share of the stored energy that the stabilization holds."""
        total = self.stored_Nmm + self.stabilization_Nmm
        held = np.divide(self.stabilization_Nmm, total, out=np.zeros_like(total), where=total > 0)
        return float(held.max(initial=0.0))


def balanced(
    states: list[LoadedState],
    jumps_mm: tuple[float, ...],
    whole_mm: float,
    share: float = JUMP_SHARE,
) -> tuple[EnergyBalance, Array]:
    """Energy balance of a run, and the work done up to each state, shape (n,), N mm.

    The work is what the specimen stores, but where it jumped: there it is interpolated. A jump
    that is known counts however little energy was lost in it: as a missing work it would bend
    the curve of a short interval by more than the whole change of force.

    Parameters
    ----------
    states : list of LoadedState
        In the order in which they were reached.
    jumps_mm : tuple of float
        Displacements from which the specimen is known to have jumped.
    whole_mm, share
        As for :func:`jumped`.
    """
    if not states:
        return EnergyBalance(np.zeros(0), np.zeros(0), np.zeros(0)), np.zeros(0)
    total = np.array([state.stored.total for state in states])
    pairs = list(zip(states[:-1], states[1:], strict=True))
    missing = np.array([unexplained_work(*pair) for pair in pairs])
    lost = np.array(
        [
            m if _holds(jumps_mm, *pair) or jumped(*pair, whole_mm, share) else 0.0
            for m, pair in zip(missing, pairs, strict=True)
        ]
    )
    largest = float(total.max())
    mismatch = np.r_[0.0, np.cumsum(missing)] / (largest if largest > 0 else np.inf)
    balance = EnergyBalance(
        np.array([state.stored.material for state in states]),
        np.array([state.stored.stabilization for state in states]),
        mismatch,
        jumps_mm,
    )
    return balance, total + np.r_[0.0, np.cumsum(lost)]


def _holds(jumps_mm: tuple[float, ...], before: LoadedState, after: LoadedState) -> bool:
    """Whether one of the jumps lies between two states."""
    return any(before.displacement_mm <= d < after.displacement_mm for d in jumps_mm)
