"""A specimen under its own weight: closed form, equilibrium, energy, and gradients."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import STANDARD_GRAVITY, Block, Cylinder, Gravity, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve
from tests.fem.problems import GEL

RHO = 980.0
PER_VOLUME = STANDARD_GRAVITY * RHO * 1e-9
TALL = Cylinder(10, 40)
SOLID = Model(space="3d", element_shape="tensor", mesh_size_mm=6.0)


def column(direction="down", **changes):
    """A column that nobody reaches: it slides on its base and its sides are free."""
    test = Test("indentation", 0.4, "frictionless", "frictionless", steps=2, indenter=Sphere(3),
                gravity=Gravity(RHO, direction))  # fmt: skip
    soft = Material("linear-elastic", {"youngs_modulus": 0.0153}, poisson_ratio=0.0)
    problem = Problem(TALL, test, soft, Model(mesh_size_mm=8.0))
    return replace(problem, **changes)


def between_plates(direction="down", **changes):
    test = Test("compression", 6.0, "bonded", "bonded", steps=6, gravity=Gravity(RHO, direction))
    return replace(Problem(TALL, test, GEL, Model(mesh_size_mm=6.0)), **changes)


@pytest.mark.parametrize("model", [
    Model(mesh_size_mm=8.0),
    Model(mesh_size_mm=8.0, element_shape="tensor"),
    Model(mesh_size_mm=8.0, formulation="displacement"),
    SOLID,
])  # fmt: skip
def test_a_column_sags_by_half_its_weight(model):
    # without lateral strain u(z) = -rho g (H z - z^2 / 2) / E (Timoshenko and Goodier, art. 96):
    # quadratic elements hold it exactly
    found = solve(column(model=model))
    z = found.points[:, -1]
    wanted = -PER_VOLUME * (40.0 * z - z**2 / 2) / 0.0153
    np.testing.assert_allclose(found.displacement[:, -1], wanted, atol=1e-9)
    assert wanted.min() < -0.4  # deeper than the sphere came down
    np.testing.assert_allclose(found.curve.force_N, 0.0, atol=1e-12)


@pytest.mark.parametrize("changes", [
    {},
    {"model": Model(mesh_size_mm=6.0, element_order="linear")},
    {"model": SOLID},
    {"model": SOLID, "specimen": Block(16, 24, 40)},
    {"direction": "up"},
])  # fmt: skip
def test_forces_differ_by_the_weight(changes):
    problem = between_plates(**changes)
    found = solve(problem)
    assert found.converged
    weight = PER_VOLUME * problem.specimen.volume_mm3 * (-1 if "direction" in changes else 1)
    # Newton's tolerance is 1e-8 of what the base carries, which is more than the weight at the end
    out_of_balance = found.base_reaction_N - found.curve.force_N - weight
    assert np.abs(out_of_balance).max() < 1e-8 * found.base_reaction_N.max()
    assert found.energy.largest_mismatch < 1e-5


def test_small_weights_change_nothing_and_none_is_none():
    bare = between_plates()
    none, without, light = (
        solve(replace(bare, test=replace(bare.test, gravity=gravity)), mesh=build_mesh(bare.setup))
        for gravity in (Gravity(RHO, "none"), None, Gravity(1.0))
    )
    np.testing.assert_array_equal(none.curve.force_N, without.curve.force_N)
    # half of what a thousandth of the usual weight is, and no more, over the least force
    share = PER_VOLUME / RHO * TALL.volume_mm3 / 2 / without.curve.force_N[0]
    np.testing.assert_allclose(light.curve.force_N, without.curve.force_N, rtol=1.2 * share)


def test_a_heavy_gel_is_held_up_by_the_plates():
    # between held plates the weight is shared: the plate above pulls at first
    heavy = solve(between_plates(test=replace(between_plates().test, displacement_mm=1e-6)))
    weight = PER_VOLUME * TALL.volume_mm3
    assert -heavy.curve.force_N[-1] == pytest.approx(weight / 2, rel=0.05)


def test_gradients_see_the_sag():
    problem = between_plates()
    c10, step = GEL.constants["C10"], 1e-4
    low, high = (
        solve(replace(problem, material=replace(GEL, constants={"C10": c10 * (1 + s)})))
        for s in (-step, step)
    )
    slope = (high.curve.force_N - low.curve.force_N) / (2 * step * c10)
    found = solve(problem).curve.force_gradient["C10"]
    np.testing.assert_allclose(found, slope, rtol=1e-5, atol=1e-6 * np.abs(slope).max())


def test_an_indenter_meets_the_sagged_surface():
    # a sphere that is lowered by d touches once the surface has not sagged as far
    problem = between_plates(test=Test(
        "indentation", 4.0, "frictionless", "bonded", steps=4, indenter=Sphere(4),
        gravity=Gravity(RHO)))  # fmt: skip
    heavy = solve(problem)
    light = solve(replace(problem, test=replace(problem.test, gravity=None)))
    weight = PER_VOLUME * TALL.volume_mm3
    np.testing.assert_allclose(heavy.base_reaction_N - heavy.curve.force_N, weight, rtol=1e-8)
    assert (heavy.curve.force_N < light.curve.force_N).all()


def test_a_drop_does_not_stand():
    soft = Material("neo-hookean", {"C10": 1e-6}, bulk_modulus=1e-2)
    found = solve(between_plates(material=soft))
    assert found.status == "not-converged"
    assert "own weight" in found.message


def test_a_body_that_sags_away_is_no_converged_test():
    found = solve(column(), gradients=False)
    assert found.status == "lost-contact"
    assert "sagged" in found.message
    assert found.equilibria.contact[-1].area_mm2 == 0
    held = solve(column("up"), gradients=False)  # it rises to meet the sphere
    assert held.converged
    assert held.equilibria.contact[-1].area_mm2 > 0
