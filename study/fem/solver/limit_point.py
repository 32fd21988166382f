"""Past a limit point: the specimen creeps to the next equilibrium through something viscous.

A surface that a sharp indenter stretches can lose its equilibrium at a load and find the next
one some way off: it snaps. Full Newton steps then jump to and fro for ever. Here the motion is
resisted by a drag in proportion to it, so that a state nearby balances (a backward Euler step of
the gradient flow, or pseudo-transient continuation: Kelley and Keyes 1998, SIAM J. Numer. Anal.
35, 508). Step by step the drag falls, and the last step is one of plain Newton without it: the
equilibrium that is found is one of the specimen alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from study.arrays import Array
from study.fem.element.function_space import deformation_gradient
from study.fem.solver.linear_solver import SingularMatrixError
from study.fem.solver.newton import NewtonResult, NewtonSettings, solve_step
from study.fem.solver.state import State
from study.fem.solver.system import System
from study.material.ellipticity import always_elliptic, ellipticity

#: steps in all, and plain solves that may fail before it is given up
_STEPS = 60
_TRIALS = 6

#: drag over the diagonal of the tangent: at first, where it hardly counts, and where it is hopeless
_FIRST = 0.05
_LITTLE = 1e-4
_MOST = 1e3

#: it falls after an easy step, grows after a hard one and more so after one that failed
_EASY = 6
_HARD = 10
_LESS = 0.25
_MORE = 1.5
_MUCH_MORE = 5.0

#: tolerances of a step that leads to the next, and its iterations, also while contact changes
_TOLERANCE = 1e-3
_GAP = 2e-5
_ITERATIONS = 15
_SWITCHING = 25

#: motion over the size of an element below which a place is nearly one of equilibrium
_STILL = 1e-3

#: largest diagonal that counts, over the median: springs of the contact are no part of it
_OUTSTANDING = 3.0


def solve_through(
    system: System, guess: State, settings: NewtonSettings, *, lifted_from: State | None = None
) -> NewtonResult:
    """Equilibrium at ``guess.displacement_mm``, however far from the last one.

    Parameters
    ----------
    system : System
        Without a drag of its own.
    guess, lifted_from : State
        As in :func:`study.fem.solver.newton.solve_step`.
    settings : NewtonSettings
        Of the last solve, which is without a drag; those that lead to it are rougher.
    """
    weights = _weights(system, lifted_from or guess)
    rough = replace(
        settings, tolerance=_TOLERANCE, gap=_GAP, max_iterations=_ITERATIONS,
        max_switching=_SWITCHING,
    )  # fmt: skip
    (place, lift), spent = _lifted(system, guess, rough, lifted_from)
    drag, trials = _FIRST, 0
    for _ in range(_STEPS):
        result = solve_step(system.dragged(drag * weights, place.x), place, rough, lifted_from=lift)
        spent += result.iterations
        if not result.converged:
            drag *= _MUCH_MORE
            if drag > _MOST:
                break
            continue
        moved = float(np.abs(result.state.x - place.x)[: system.space.n_displacement].max())
        place, lift = replace(result.state, closed=()), None
        still = drag <= _FIRST and moved < _STILL * system.mesh.contact_size_mm
        if drag < _LITTLE or still:
            result = solve_step(system, place, settings)
            spent, trials = spent + result.iterations, trials + 1
            if result.converged or trials == _TRIALS:
                return replace(result, iterations=spent)
            rough = replace(rough, tolerance=max(0.1 * rough.tolerance, settings.tolerance))
            drag = max(drag, _LITTLE)
        drag *= _LESS if result.iterations <= _EASY else _MORE if result.iterations > _HARD else 1.0
    return replace(result, converged=False, iterations=spent)


def _lifted(
    system: System, guess: State, settings: NewtonSettings, before: State | None
) -> tuple[tuple[State, State | None], int]:
    """Place to begin at, the state to lift it from where it has yet to be lifted, and iterations.

    A plate's motion spreads through the specimen as it is: drag would keep it near the plate.
    """
    if before is None:
        return (guess, None), 0
    once = replace(settings, max_iterations=1, max_switching=1)
    tried = solve_step(system, guess, once, lifted_from=before)
    there = tried.state.displacement_mm == guess.displacement_mm
    return (tried.state, None) if there else (guess, before), tried.iterations


def _weights(system: System, state: State) -> Array:
    """Diagonal of the tangent at the displacements, zero where nothing moves freely."""
    system.assemble(state)
    free = system.pattern.free
    moving = free < system.space.n_displacement
    diagonal = np.abs(system.data[system.pattern.indptr[:-1]])[moving]
    weights = np.zeros(system.space.n)
    weights[free[moving]] = np.minimum(diagonal, _OUTSTANDING * np.median(diagonal))
    return weights


#: inverse iterations: the smallest stiffness of a state that gives way stands out
_INVERSE_ITERATIONS = 12

#: share of the first stiffness below which a specimen gives way
_VANISHED_SHARE = 0.2


def gives_way(system: System, first: State, last: State) -> str:
    """Say that the smallest stiffness has nearly vanished at a state; empty where it has not.

    Parameters
    ----------
    system : System
        Of both states; its tangent is overwritten.
    first, last : State
        Converged states, near the start of a run and at its end.
    """
    before, after = smallest_stiffness(system, first), smallest_stiffness(system, last)
    if not after < _VANISHED_SHARE * before:
        return ""
    return (
        "no equilibrium is near: the specimen's smallest stiffness has fallen to "
        f"{100 * after / before:.2g} % (a limit point); see whether a finer mesh goes further, "
        "press less deep, or use another energy"
    )


def smallest_stiffness(system: System, state: State) -> float:
    """Force over motion, in the norm of all nodes, of the way that costs least; 0 if singular.

    Parameters
    ----------
    system : System
        Its tangent is assembled and factorized here.
    state : State
        Converged.

    Returns
    -------
    float
        In N/mm, of the part of the specimen that is modelled.
    """
    system.assemble(state)
    free = system.pattern.free
    moves = free < system.space.n_displacement
    v = moves.astype(float)
    largest = 0.0
    try:
        system.factorize()
        for _ in range(_INVERSE_ITERATIONS):
            v = np.where(moves, system.back_substitute(v / np.linalg.norm(v)), 0.0)
            largest = float(np.linalg.norm(v))
    except SingularMatrixError:
        return 0.0
    return 1.0 / largest if np.isfinite(largest) else 0.0


#: points that are looked at: where an energy gives way it does so where it is stretched most
_LOOKED_AT = 500


def lost_ellipticity(system: System, state: State) -> str:
    """Say where the energy has lost its ellipticity at a state; empty where it has not.

    The place that is said is the one furthest beyond, among the points of quadrature that are
    stretched most.

    Parameters
    ----------
    system : System
        Its material is judged.
    state : State
        Converged.
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
