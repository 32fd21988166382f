"""Homogeneous states through the discrete equations, and systems with other constraints."""

from dataclasses import replace

from study.mechanics.element.function_space import Pattern
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver.internal_force import Tangent
from study.mechanics.solver.linear_solver import KeptFactors, make_solver
from study.mechanics.solver.newton import NewtonSettings, solve_step
from study.mechanics.solver.system import State, System
from tests.fem.problems import compression, cube, grid, irregular

#: K (J - 1) at each point leaves 3e-12 of the force to rounding where K is 1000 mu
TIGHT = NewtonSettings(tolerance=1e-11)


def system_of(material, mesh=None, **model):
    """Unit cylinder or cube of distorted elements between frictionless plates."""
    if mesh is None:
        shape = str(model.get("element_shape", "simplex"))
        solid = model.get("space") == "3d"
        mesh = cube(2, shape) if solid else irregular(grid(1, 1, 3, 3, shape))
    problem = compression(Cylinder(1, 1), 0.1, "frictionless", material=material, **model)
    return System.build(problem, mesh, folding=False)


def driven(system, displacement, pieces):
    """Converged state at a displacement, tension (negative) too, in equal steps."""
    state = system.start()
    for number in range(1, pieces + 1):
        goal = displacement * number / pieces
        result = solve_step(system, State(goal, state.x), TIGHT, lifted_from=state)
        assert result.converged, result.reason
        state = result.state
    return result


def force(system, result):
    """Force on the upper plate, positive in compression."""
    reactions = result.assembly.internal[system.constraints.dofs]
    return float(system.force_scale * reactions @ system.prescribed(1.0))


def held(system, dofs, values):
    """Return the same discretization with other prescribed unknowns."""
    pattern = Pattern.build(system.space.dofs, system.space.n, dofs)
    return replace(
        system,
        constraints=replace(system.constraints, dofs=dofs, rate=values),
        tangent=Tangent.of(pattern, system.space.dofs),
        factors=KeptFactors(make_solver(pattern), pattern),
    )
