"""Indentation: layer tables, other codes' forces, complementarity, gradients, bad input."""

from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Cone, Cylinder, Flat, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test, unresolved_contact
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.system import System
from tests.fem.problems import (
    LONG,
    NEEDLE,
    PUNCH,
    RUBBER,
    hooke,
    indentation,
    long_verification,
    reached,
    taylor_slopes,
)


# --- EXTERNAL: V29, Table D: integral equation for a flat punch on a bonded layer, h = 1
@pytest.mark.parametrize(
    ("radius", "nu", "kappa"),
    [(0.1, 0.5, 1.12599), (0.4, 0.495, 1.67356), (1.0, 0.5, 3.61874), (1.0, 0.45, 3.09141),
     (1.0, 0.30, 2.48352), (2.0, 0.5, 9.14945)],
)  # fmt: skip
def test_flat_punch_on_a_bonded_layer(radius, nu, kappa):
    depth = 1e-3 * radius
    layer = Cylinder(8 * max(1.0, radius), 1.0)
    problem = indentation(
        Flat(radius), depth, material=hooke(nu), specimen=layer, steps=1, mesh="fine"
    )
    force = solve(problem, gradients=False).curve.force_N[-1]
    assert force / (4 * radius * depth / (1 - nu)) == pytest.approx(kappa, rel=2e-3)


# --- EXTERNAL: V32 and V34, Table E: sphere and cone on a bonded incompressible layer, h = 1; over
# the forces of Hertz and Sneddon with E* = 4 mu
@pytest.mark.parametrize(
    ("indenter", "x", "ratio", "mesh", "apart"),
    [
        (Sphere(10), 0.04905, 1.05903, "fine", 5e-3),
        (Sphere(10), 0.18507, 1.26977, "fine", 5e-3),
        (Sphere(10), 0.48694, 2.10558, "fine", 5e-3),
        (Cone(60), 0.07633, 1.05874, "medium", 1e-2),
        (Cone(60), 0.28026, 1.26435, "medium", 1e-2),
    ],
)
def test_sphere_and_cone_on_a_bonded_layer(indenter, x, ratio, mesh, apart):
    depth = x**2 / 10 if isinstance(indenter, Sphere) else x / np.sqrt(3)
    problem = indentation(
        indenter, depth, material=hooke(0.5), specimen=Cylinder(8, 1), steps=1, mesh=mesh
    )
    alone = 2 / np.pi * 4 * np.sqrt(3) * depth**2
    if isinstance(indenter, Sphere):
        alone = 4 / 3 * 4 * np.sqrt(10) * depth**1.5
    found = solve(problem, gradients=False).curve.force_N[-1] / alone
    assert found == pytest.approx(ratio, rel=apart)


# --- OTHER-MODEL: hard-contact forces of another code, within 0.5 % on the fine mesh
@pytest.mark.parametrize(
    ("indenter", "steps", "expected"),
    [
        (NEEDLE, 3, {0: 0.04634, 2: 0.23555}),
        pytest.param(PUNCH, 30, {0: 0.02133, 29: 0.6560}, marks=LONG),
    ],
    ids=["cone", "punch"],
)
def test_hard_contact_forces(indenter, steps, expected):
    force = solve(indentation(indenter, 3, steps=steps, mesh="fine"), gradients=False).curve.force_N
    assert {k: force[k] for k in expected} == pytest.approx(expected, rel=5e-3)


@long_verification
@pytest.mark.parametrize("order", ["linear", "quadratic"])
@pytest.mark.parametrize("shape", ["simplex", "tensor"])
@pytest.mark.parametrize("mesh", ["coarse", "medium", "fine"])
def test_every_element_reaches_the_depth(mesh, shape, order):
    """As those under a cone do (``test_depth``)."""
    reached(indentation(PUNCH, 3.0, mesh=mesh, element_shape=shape, element_order=order))


def test_complementarity_and_balance():
    """V37: no penetration, no pull, no pressure at a distance; the base carries the force."""
    solution = solve(indentation(NEEDLE, 1.5, steps=5, mesh="coarse"))
    system, step = solution.warm.system, solution.warm.steps[-1]
    touch = system.touching(step.state)[0]
    assert touch.active.any()
    assert not touch.active.all()
    assert touch.gap.min() > -1e-7
    assert touch.pressure.min() >= 0
    np.testing.assert_allclose(solution.base_reaction_N, solution.curve.force_N, rtol=1e-7)


def test_forces_do_not_depend_on_the_stiffness_of_the_regularization(monkeypatch):
    from study.mechanics.contact import contact

    problem = indentation(NEEDLE, 1.0, steps=4, mesh="coarse")
    usual = solve(problem, gradients=False).curve.force_N
    monkeypatch.setattr(contact, "STIFFNESS", contact.STIFFNESS / 30)
    np.testing.assert_allclose(solve(problem, gradients=False).curve.force_N, usual, rtol=1e-5)


@pytest.mark.parametrize(
    "material",
    [
        RUBBER,
        Material("ogden", {"mu1": 8e-3, "alpha1": 3.0}, poisson_ratio=0.4995),
        Material("mooney-rivlin", {"C10": 4e-3, "C01": 1e-3}, incompressible=True),
    ],
    ids=lambda m: m.model,
)
def test_taylor_through_contact(material):
    """V41 with an active set that stays the same over the increments."""
    problem = indentation(NEEDLE, 1.2, steps=4, mesh="coarse", material=material)
    direction = np.array([0.3, -0.2])[: len(material.names)] * material.values
    slopes = taylor_slopes(problem, solve(problem), direction, (0.04, 0.02, 0.01))
    assert 1.9 <= slopes.min() <= slopes.max() <= 2.1


def test_a_bonded_punch_is_stiffer_and_no_contact_problem():
    forces = [
        solve(indentation(Flat(3), 0.3, steps=2, mesh="coarse", interface=i)).curve.force_N[-1]
        for i in ("frictionless", "bonded")
    ]
    # V28: equal for nu = 0.5 on a half-space at small depth
    assert forces[0] < forces[1] < 1.05 * forces[0]


@long_verification
@pytest.mark.parametrize("shape", ["simplex", "tensor"])
@pytest.mark.parametrize("order", ["linear", "quadratic"])
@pytest.mark.parametrize(
    ("indenter", "depth"), [(NEEDLE, 2.0), (PUNCH, 1.0)], ids=["cone", "punch"]
)
def test_3d_agrees_with_axisymmetric(indenter, depth, order, shape):
    problem = indentation(
        indenter, 0.4 * depth, steps=4, mesh="medium", mesh_ratio=1.3, element_order=order,
        element_shape=shape,
    )  # fmt: skip
    flat = solve(problem, gradients=False)
    solid = reached(replace(problem, model=replace(problem.model, space="3d")))
    tolerance = 0.015 if order == "quadratic" else 0.06
    assert solid.curve.force_N[-1] == pytest.approx(flat.curve.force_N[-1], rel=tolerance)


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (indentation(Cone(90, 1), 1), "not between 0 and 90 deg"),
        (indentation(Cone(0, 1), 1), "not between 0 and 90 deg"),
        (indentation(NEEDLE, 50), "reaches the height of the specimen"),
        (indentation(Flat(30), 1), "beyond 25 mm"),
        (indentation(Flat(3, 4), 1), "edge_radius"),
    ],
)
def test_impossible_indentations_are_refused(problem, words):
    with pytest.raises(InputError, match=words):
        solve(problem)


def test_an_incompressible_body_without_diagonal_is_solved():
    """Discontinuous pressures leave zeros on the diagonal, where pivots alone fail (V29)."""
    problem = indentation(
        Flat(0.2), 2e-4, material=hooke(0.5), specimen=Cylinder(8, 1), steps=1, mesh="fine",
        element_shape="tensor",
    )  # fmt: skip
    solution = solve(problem, gradients=False)
    assert solution.curve.force_N[-1] / (4 * 0.2 * 2e-4 / 0.5) == pytest.approx(1.28064, rel=2e-3)
    assert sum(solution.newton_iterations) < 10


@pytest.mark.parametrize("pressed", [Sphere(4.0), Cone(45.0, 0.5), Cone(60.0, 0.0)])
@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
def test_a_first_contact_is_seen_by_meshes_as_coarse_as_the_contact(space, pressed):
    """Elements of 3.5 mm: quadratic ones felt nothing, or let the tip pass and then stopped."""
    problem = Problem(
        Cylinder(10.0, 15.0),
        Test("indentation", 1.0, "frictionless", "bonded", 10, pressed),
        Material("neo-hookean", {"C10": 0.005}, poisson_ratio=0.4999),
        Model(space, "quadratic", mesh_size_mm=3.5),
    )
    found = reached(problem)
    assert (np.diff(found.curve.force_N, prepend=0.0) > 0).all()
    # at this size linear elements are up to four times too stiff (0.24 N for 0.07 N)
    linear = replace(problem, model=replace(problem.model, element_order="linear"))
    other = solve(linear, gradients=False).curve.force_N[-1]
    assert 0.2 * other < found.curve.force_N[-1] < 2 * other


def test_the_point_on_the_axis_yields_to_the_first_that_touches():
    """On meshes that see the contact it changes no digit: it is closed before the first touch."""
    problem = indentation(Sphere(4.0), 0.5, mesh="coarse")
    system = System.build(problem, build_mesh(problem.setup))
    (points,), nodes = system.contact, system.space.nodes
    assert np.flatnonzero(points.first_touch) == points.size - 1
    for depth, alone in ((1e-6, True), (0.4, False)):
        met = points.meet(nodes, np.zeros_like(nodes), depth)
        closed = points.evaluate(met, np.zeros(points.size)).closing
        assert closed[-1] == alone
        assert closed[:-1].any() != alone


# --- CLOSED FORM: Hertz 1881: contact of a sphere with a half-space
@pytest.mark.parametrize(("order", "off"), [("quadratic", 0.03), ("linear", 0.05)])
def test_pressure_and_area_under_a_sphere_are_those_of_hertz(order, off):
    nu, radius, depth = 0.3, 10.0, 0.1
    problem = indentation(
        Sphere(radius), depth, material=hooke(nu), specimen=Cylinder(60, 60), steps=2,
        mesh="fine", element_order=order,
    )  # fmt: skip
    found = solve(problem, gradients=False)
    stiffness = 2 * (1 + nu) / (1 - nu**2)
    force, area = 4 / 3 * stiffness * np.sqrt(radius * depth**3), np.pi * radius * depth
    figures = found.equilibria.contact[-1]
    assert found.curve.force_N[-1] == pytest.approx(force, rel=off)  # of a body, no half-space
    assert figures.peak_pressure_MPa == pytest.approx(1.5 * force / area, rel=off)
    ring = 2 * np.pi * np.sqrt(radius * depth) * found.mesh_size_mm  # at the rim, closed or not
    assert figures.area_mm2 == pytest.approx(area, abs=ring)
    chord = found.mesh_size_mm**2 / (8 * radius)  # of a straight facet under the sphere
    assert 0 <= figures.penetration_mm <= 1.5 * chord
    assert 0 <= figures.gap_mm < 1e-2 * depth
    below = found.equilibria.base[-1]
    assert found.equilibria.plate[-1].axial == pytest.approx(below.axial, rel=1e-7)


def test_nodes_that_slip_through_a_punch_are_no_equilibrium():
    """At 6 of 10 mm four meshes had 1.35 to 4.4 N, with nodes up to 1.5 mm inside the punch."""
    problem = indentation(
        Flat(4, edge_radius_mm=0.5), 6, specimen=Cylinder(20, 10), steps=12,
        material=Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.49),
        mesh="coarse", element_order="quadratic",
    )  # fmt: skip
    found = solve(problem, gradients=False)
    assert found.status == "not-converged"
    assert "inside the moving one, past its contact points" in found.message
    assert max(c.penetration_mm for c in found.equilibria.contact) < 0.2 * 6


@pytest.mark.parametrize(
    ("indenter", "depth", "law", "size_mm", "is_resolved"),
    [
        (Sphere(4.0), 0.08, lambda e, d: 4 / 3 * e * np.sqrt(4.0 * d**3), 2.0, False),
        (Sphere(4.0), 0.08, lambda e, d: 4 / 3 * e * np.sqrt(4.0 * d**3), 0.1, True),
        (Cone(45.0), 0.4, lambda e, d: 2 / np.pi * e * d**2, 1.5, False),
        (Cone(45.0), 0.4, lambda e, d: 2 / np.pi * e * d**2, 0.05, True),
    ],
)
def test_a_contact_smaller_than_the_elements_is_named(indenter, depth, law, size_mm, is_resolved):
    """Hertz and Sneddon: elements of twice the contact radius give many times their force."""
    problem = indentation(
        indenter, depth, material=hooke(0.3), specimen=Cylinder(12.0, 12.0), steps=1,
        mesh_size_mm=size_mm,
    )  # fmt: skip
    found = solve(problem, gradients=False)
    ratio = found.curve.force_N[-1] / law(2 * 1.3 / 0.91, depth)
    assert (abs(ratio - 1) < 0.1) == is_resolved
    assert ("too large for the contact" in found.message) != is_resolved


def test_elements_are_measured_by_what_is_touched():
    def said(indenter, size_mm, depth=0.5, interface="frictionless"):
        test = Test("indentation", depth, interface, indenter=indenter)
        return unresolved_contact(test, size_mm)

    assert "0.5 mm at most" in said(Sphere(2.0), 1.0)  # contact radius sqrt(2 * 0.5) = 1 mm
    assert not said(Sphere(2.0), 0.5)
    assert not said(Sphere(2.0), None)  # a mesh by name is made for the contact
    assert said(Flat(2.0, 0.3), 0.7)
    assert not said(Flat(2.0, 0.3), 0.4)
    assert not said(Flat(2.0, 0.9), 0.8)
    assert not said(Flat(2.0), 1.5)
    assert not said(Flat(2.0, 0.3), 3.0, interface="bonded")
    assert not said(Sphere(2.0), 1.0, depth=None)


@pytest.mark.parametrize("depth", [1e-5, 5e-6, 1e-8])
def test_a_sphere_hardly_touching_has_hertz_force_or_says_that_rounding_decides(depth):
    """It stopped at 0 mm; below the allowed gap, 5e-10 of the height, forces were 1e4 too small."""
    test = Test("indentation", depth, "frictionless", "bonded", 3, Sphere(5.0))
    material = Material("neo-hookean", {"C10": 0.5}, poisson_ratio=0.45)
    found = solve(Problem(Cylinder(20.0, 20.0), test, material, Model(mesh="medium")))
    assert found.converged
    modulus = 2 * (1 + 0.45) / (1 - 0.45**2)
    hertz = 4 / 3 * modulus * np.sqrt(5.0) * found.curve.displacement_mm**1.5
    is_sure = depth > 1e-6
    assert found.curve.force_N == pytest.approx(hertz, rel=0.01 if is_sure else 0.5)
    assert ("rounding of the nodal forces" in found.message) == (not is_sure)
    assert "snapped" not in found.message
