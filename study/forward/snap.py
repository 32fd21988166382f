"""Newton's method past a limit point: descent steps of bounded length.

A surface that a sharp indenter stretches can lose its equilibrium at a load and find the next
one some way off: it snaps. Full Newton steps then jump to and fro for ever. Here a multiple of
its own diagonal is added to the displacement part of the tangent until the matrix has exactly
as many negative eigenvalues as there are pressures, which makes the step one of descent of the
potential energy at the given volume (inertia correction: Waechter and Biegler 2006, algorithm
IC), and no step moves a node by more than a share of an element. Both begin when plain Newton
has had its chance, and fall away at the new equilibrium.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.newton import ROUGH, NewtonResult, NewtonSettings, iterate
from study.forward.switches import Switches
from study.forward.system import Assembly, State, System

Array = NDArray[np.float64]

#: iterations in all, those of plain Newton before, and those in which contact points all decide
#: at once
_ITERATIONS, _PLAIN, _TOGETHER = 160, 8, 12
#: longest motion of a node in one iteration, over the size of an element
_REACH = 0.1
#: first multiple of the diagonal, its growth while the step is no descent, its decay after
_FIRST, _GROWTH, _DECAY, _NONE = 1e-3, 4.0, 0.25, 1e-5
_MOST = 1e3


def solve_through(
    system: System, guess: State, settings: NewtonSettings, *, lifted_from: State | None = None
) -> NewtonResult:
    """Equilibrium at ``guess.displacement_mm``, however far from the last one.

    Parameters
    ----------
    guess, lifted_from : State
        As in :func:`study.forward.newton.iterate`.
    """
    return iterate(system, guess, settings, Descent(), lifted_from=lifted_from)


class Descent:
    """Short steps that lower the potential energy, after a few of plain Newton."""

    def __init__(self) -> None:
        self._shift = 0.0

    def switches(self, system: System) -> Switches:
        """No point is held closed before the others have had their say."""
        return Switches(system, together=_TOGETHER, holding=_TOGETHER)

    def ended(
        self, iteration: int, residuals: list[float], changing: bool, settings: NewtonSettings
    ) -> bool:
        """After so many iterations."""
        return iteration >= _ITERATIONS

    def solve(
        self, system: System, residuals: list[float], right: Array, at: tuple[State, Assembly]
    ) -> Array:
        """Solve with a tangent that makes a step of descent."""
        self._factorize(system, residuals)
        return system.solve_afresh(right, ROUGH)

    def _factorize(self, system: System, residuals: list[float]) -> None:
        """Add the smallest multiple of the diagonal that makes a step of descent."""
        if len(residuals) <= _PLAIN:
            system.factorize()
            return
        self._shift = _DECAY * self._shift if self._shift > _NONE else 0.0
        system.factorize(self._shift, exact=True)
        while (system.instabilities() or 0) > 0 and self._shift < _MOST:
            self._shift = max(_GROWTH * self._shift, _FIRST)
            system.factorize(self._shift, exact=True)

    def share(self, system: System, residuals: list[float], increment: Array) -> float:
        """Move no node further than it may."""
        furthest = float(np.abs(increment[: system.space.n_displacement]).max())
        if len(residuals) <= _PLAIN or furthest == 0:
            return 1.0
        return min(1.0, _REACH * system.mesh.contact_size_mm / furthest)
