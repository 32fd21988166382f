"""Whether a run ended at a limit point of the specimen rather than at a weakness of the iteration.

At a limit point one way of moving costs no force any more, and no equilibrium is near beyond it
(Crisfield 1991, sec. 9.1). The smallest stiffness is that of the displacements with the pressures
and the contact as they follow: the inverse of what the inverse tangent does to forces.
"""

from __future__ import annotations

import numpy as np

from study.forward.linear_solver import SingularMatrixError
from study.forward.system import State, System

#: inverse iterations: the smallest stiffness of a state that gives way stands out
_ITERATIONS = 12
#: share of the first stiffness below which a specimen gives way
_LITTLE = 0.2


def gives_way(system: System, first: State, last: State) -> str:
    """Say that the smallest stiffness has nearly vanished at a state; empty where it has not.

    Parameters
    ----------
    first, last : State
        Converged states, near the start of a run and at its end.
    """
    before, after = smallest_stiffness(system, first), smallest_stiffness(system, last)
    if not after < _LITTLE * before:
        return ""
    return (
        "no equilibrium is near: the specimen's smallest stiffness has fallen to "
        f"{100 * after / before:.2g} % (a limit point); see whether a finer mesh goes further, "
        "press less deep, or use another energy"
    )


def smallest_stiffness(system: System, state: State) -> float:
    """Force over motion, in the norm of all nodes, of the way that costs least; 0 if singular."""
    system.assemble(state)
    free = system.pattern.free
    moves = free < system.space.n_displacement
    v = moves.astype(float)
    largest = 0.0
    try:
        system.factorize()
        for _ in range(_ITERATIONS):
            v = np.where(moves, system.back_substitute(v / np.linalg.norm(v)), 0.0)
            largest = float(np.linalg.norm(v))
    except SingularMatrixError:
        return 0.0
    return 1.0 / largest if np.isfinite(largest) else 0.0
