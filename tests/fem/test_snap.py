"""Past limit points: creeping there, and the part of K that acts at every point."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Block, Cone, Cylinder, Flat
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.newton import NewtonSettings, Options, solve_through
from study.mechanics.solver.system import System
from tests.fem.problems import (
    NEEDLE,
    RUBBER,
    indentation,
    long_verification,
    reached,
    taylor_slopes,
)

TOUGHER = Material("reduced-polynomial", {"C10": 5e-3, "C20": 1e-3}, incompressible=True)
#: with Poisson's ratio given, K follows the constants
BY_RATIO = Material("reduced-polynomial", {"C10": 5e-3, "C20": 1e-3}, poisson_ratio=0.4995)


def needle(depth=0.6, **changes):
    problem = indentation(NEEDLE, depth, mesh="coarse", **changes)
    return System.build(problem, build_mesh(problem.setup))


def test_creeping_finds_the_same_equilibrium():
    """Where Newton has no trouble both go to one state: the first touch of a cone."""
    system = needle()
    state = replace(system.start(), displacement_mm=0.1)
    found = solve_through(system, state, NewtonSettings())
    assert found.converged, found.reason
    problem = indentation(NEEDLE, 0.1, steps=1, mesh="coarse")
    own = solve(problem, gradients=False, mesh=system.mesh)
    # both end below a relative residual of 1e-8
    expected = own.warm.steps[-1].state.x
    np.testing.assert_allclose(found.state.x, expected, atol=1e-6 * np.abs(expected).max())


def test_a_flat_end_that_meets_a_face_all_at_once_is_no_snap():
    """Many points close in the first step, which only creeping ends: nothing was stored before."""
    material = Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.4995)
    problem = indentation(
        Flat(3.0, 0.5), 0.01, material=material, specimen=Cylinder(20.0, 20.0), steps=5
    )
    found = reached(problem)
    assert found.message == "every step converged"
    assert found.energy.jumps_mm == ()
    # fine quadratic quadrilaterals
    assert found.curve.force_N[-1] == pytest.approx(0.00225058, rel=3e-3)


def test_a_local_bulk_modulus_changes_no_patch():
    """A homogeneous state has J = const, so that the split of K cannot be seen."""
    system = needle(space="3d", element_order="quadratic")
    assert system.internal.local_bulk > 0
    n_u, nodes = system.space.n_displacement, system.space.nodes
    F = np.diag([1.05, 0.97, 0.99])
    J = float(np.linalg.det(F))
    x = np.zeros(system.space.n)
    x[:n_u] = (nodes @ (F - np.eye(3))).ravel()
    forces = []
    for bound in (0.0, 3.0):
        internal = replace(system.internal, local_bulk=bound)
        x[n_u:] = (RUBBER.bulk - internal.split(RUBBER).local) * (J - 1)
        internal.evaluate(RUBBER, x)
        forces.append(internal.gathered())
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-12 * np.abs(forces[0]).max() + 1e-15)
    assert np.abs(forces[0][n_u:]).max() < 1e-12


@long_verification
@pytest.mark.parametrize("material", [RUBBER, BY_RATIO], ids=["bulk given", "ratio given"])
def test_taylor_through_3d_contact(material):
    """V41 in 3D: |F(p + h dp) - F(p) - h g.dp| falls with slope 2 while contact stays."""
    problem = indentation(
        NEEDLE, 0.4, steps=2, mesh="coarse", material=material, space="3d",
        element_order="quadratic",
    )  # fmt: skip
    base = solve(problem)
    direction = np.array([0.3, -0.2]) * material.values
    slopes = taylor_slopes(problem, base, direction, (0.08, 0.04, 0.02))
    assert 1.9 <= slopes.min() <= slopes.max() <= 2.1


@long_verification
def test_a_block_under_a_deep_cone_snaps_and_goes_on():
    """Linear solids lose their equilibrium at 2.57 mm and find it again."""
    soft = Material("neo-hookean", {"C10": 6e-3}, poisson_ratio=0.4995)
    problem = indentation(
        Cone(30, 1, 3), 4.0, material=soft, specimen=Block(60, 60, 40), mesh="medium",
        mesh_ratio=1.3, space="3d", element_order="linear",
    )  # fmt: skip
    stopped = solve(problem, gradients=False, options=Options(snaps=False))
    assert not stopped.converged
    found = reached(problem)
    assert "snapped to another equilibrium" in found.message
    assert np.all(np.diff(found.curve.force_N) > 0)


@long_verification
@pytest.mark.parametrize(
    ("element_order", "mesh"), [("linear", "coarse"), ("quadratic", "coarse"), ("linear", "medium")]
)
def test_a_solid_under_a_flat_end_goes_on_to_its_radius(element_order, mesh):
    """Deeper than half the radius the surface slips over the edge, facet by facet."""
    problem = indentation(
        Flat(3, 0.3), 3.0, material=TOUGHER, mesh=mesh, space="3d",
        element_order=element_order,
    )  # fmt: skip
    found = solve(problem)
    assert found.converged, found.message
    assert np.all(np.diff(found.curve.force_N) > 0)
    # equilibrium of the specimen alone: what drags on the way is gone
    np.testing.assert_allclose(found.base_reaction_N, found.curve.force_N, rtol=1e-6)


@long_verification
def test_a_neo_hookean_solid_under_a_flat_end_goes_on_to_its_radius():
    """The run that asks most of the local bulk modulus: with 3 shear moduli 420 s did not do."""
    soft = Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.4995)
    problem = indentation(
        Flat(3, 0.3), 3.0, material=soft, mesh="coarse", space="3d", steps=8,
        element_order="quadratic",
    )  # fmt: skip
    found = reached(problem)
    assert np.all(np.diff(found.curve.force_N) > 0)
