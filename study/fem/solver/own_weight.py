"""A specimen under its own weight, before it is touched: gravity comes on in shares."""

from __future__ import annotations

from study.fem.solver.newton import NewtonSettings, solve_step
from study.fem.solver.state import State
from study.fem.solver.system import System

#: smallest share of the weight that is tried at a time
_SMALLEST = 1 / 64

#: why there is no test
FALLS = "the specimen finds no equilibrium under its own weight: check test.gravity.density"


def sagged_state(system: System, settings: NewtonSettings) -> State | None:
    """Equilibrium under the weight alone, at no displacement of the test.

    Parameters
    ----------
    system : System
        With its weight.
    settings : NewtonSettings
        When Newton stops; the last share meets its tolerance.

    Returns
    -------
    State or None
        None where the weight is more than the specimen carries.
    """
    state, carried, share = system.start(), 0.0, 1.0
    while carried < 1.0:
        wanted = min(carried + share, 1.0)
        loose = settings if wanted == 1.0 else settings.passing()
        found = solve_step(system.weighing(wanted), state, loose)
        if found.converged:
            state, carried, share = found.state, wanted, 2 * share
            continue
        share /= 2
        if share < _SMALLEST:
            return None
    return state
