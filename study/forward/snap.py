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

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.forward.linear_solver import SingularMatrixError
from study.forward.newton import (
    NewtonResult,
    NewtonSettings,
    done,
    filtered,
    lifted,
    relative_residual,
)
from study.forward.switches import Switches
from study.forward.system import State, System

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
        As in :func:`study.forward.newton.solve_step`.
    """
    state, lift = guess, np.zeros(0)
    if lifted_from is not None:
        state, lift = lifted(system, guess, lifted_from)
    switches, shift = Switches(system, together=_TOGETHER), 0.0
    residuals: list[float] = []
    for iteration in range(_ITERATIONS + 1):
        state = switches.decided(state, calm=not residuals or residuals[-1] < 0.01)
        assembly = system.assemble(state)
        if not assembly.min_j > 0:
            return NewtonResult(state, False, iteration, "an element is inverted", ())
        right = -assembly.residual[system.pattern.free]
        if lift.size:
            right -= system.lift_product(lift)
        else:
            residuals.append(relative_residual(system, state, assembly))
            if done(system, residuals[-1], assembly, settings):
                return NewtonResult(state, True, iteration, "converged", tuple(residuals), assembly)
        try:
            if len(residuals) > _PLAIN:
                shift = _descending(system, shift)
            else:
                system.factorize()
        except SingularMatrixError as error:
            return NewtonResult(state, False, iteration, f"singular tangent: {error}", ())
        increment = np.zeros(system.space.n)
        increment[system.pattern.free] = system.back_substitute(right)
        if lift.size:
            increment[system.constraints.dofs] = lift
            state = replace(state, displacement_mm=guess.displacement_mm)
        elif len(residuals) > _PLAIN:
            increment *= _shortened(system, increment)
        moved = filtered(system, state, assembly, increment, settings, whole=bool(lift.size))
        if moved is None:
            return NewtonResult(state, False, iteration, "an element would be inverted", ())
        state, lift = moved, np.zeros(0)
    reason = f"no equilibrium after {_ITERATIONS} iterations of descent"
    return NewtonResult(state, False, _ITERATIONS, reason, tuple(residuals))


def _descending(system: System, shift: float) -> float:
    """Factorize with the smallest multiple of the diagonal that makes a step of descent."""
    shift = _DECAY * shift if shift > _NONE else 0.0
    system.factorize(shift)
    while (system.instabilities() or 0) > 0 and shift < _MOST:
        shift = max(_GROWTH * shift, _FIRST)
        system.factorize(shift)
    return shift


def _shortened(system: System, increment: Array) -> float:
    """Share of a step that moves no node further than it may."""
    if not np.isfinite(increment).all():
        raise SingularMatrixError("the step is not finite")
    furthest = float(np.abs(increment[: system.space.n_displacement]).max())
    return min(1.0, _REACH * system.mesh.size_mm / furthest) if furthest > 0 else 1.0
