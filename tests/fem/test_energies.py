"""Every energy through the discrete equations: Tables A and B, patches, tangents, symmetries."""

from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.material.homogeneous import response
from study.mechanics.material.material import ENERGIES, Material
from study.mechanics.material.polynomial import ReducedPolynomial
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.newton import Options, solve_step
from study.mechanics.solver.system import State
from tests.fem.homogeneous import TIGHT, driven, force, held, system_of
from tests.fem.problems import MOONEY as MR
from tests.fem.problems import NEO_HOOKEAN as NH
from tests.fem.problems import RP2, YEOH, compression, cube, reached
from tests.material.modes import solid, uniaxial

OGDEN1 = Material("ogden", {"mu1": 1.0, "alpha1": 4.0}, bulk_modulus=1e3)
OGDEN3 = solid("ogden", 0.6, 1.3, 0.3, 5.0, 0.1, -2.0, bulk_modulus=1e3)
POLY2 = solid("polynomial", 0.35, 0.15, 0.03, 0.02, 0.01, bulk_modulus=1e3)
LINEAR = Material("linear-elastic", {"youngs_modulus": 3.0}, bulk_modulus=1e3)
BOYCE = solid("arruda-boyce", 1.0 / 1.0745501271215558, 3.0, bulk_modulus=1e3)
GENT = Material("gent", {"mu": 1.0, "Jm": 20.0}, bulk_modulus=1e3)
TUBE = solid("extended-tube", 0.5 / 0.98, 0.5, 0.6, 0.1, bulk_modulus=1e3)
WAALS = solid("van-der-waals", 1.0, 6.0, 0.3, 0.2, bulk_modulus=1e3)
SKIN = Material("veronda-westmann", {"C1": 1.0, "C2": 1.0}, bulk_modulus=1e3)
FUNG = Material("fung", {"mu": 1.0, "b": 0.3}, bulk_modulus=1e3)
OTHERS = [BOYCE, GENT, TUBE, WAALS, SKIN, FUNG]
HYPERELASTIC = [NH, MR, RP2, YEOH, POLY2, OGDEN1, OGDEN3]
ALL = [*HYPERELASTIC, LINEAR]

SPACES = ["axisymmetric", "3d"]


def name(value):
    return f"{value.model}-{len(value.names)}" if isinstance(value, Material) else None


def incompressible(material):
    return Material(material.model, material.constants, incompressible=True)


def lateral(system, x):
    """Stretch of the free side, where the reference radius (or side) is one."""
    side = np.abs(system.space.nodes[:, 0] - 1) < 1e-9
    return 1 + system.displacements(x)[side, 0]


@pytest.mark.parametrize("bulk", [1e2, 1e3])
@pytest.mark.parametrize("material", [NH, MR, RP2, YEOH, OGDEN1, OGDEN3], ids=name)
@pytest.mark.parametrize("order", ["linear", "quadratic"])
def test_table_b(material, bulk, order):
    """V04 on an irregular axisymmetric mesh: the affine field is in every space.

    Against the closed form, whose figures are those of ``validation/material_points.csv``.
    """
    material = replace(material, bulk_modulus=bulk)
    for formulation in ("mixed", "displacement"):
        system = system_of(material, element_order=order, formulation=formulation)
        for stretch in (0.7, 1.5):
            expected, result = (
                response(material, "uniaxial", stretch),
                driven(system, 1 - stretch, 8),
            )
            assert force(system, result) / np.pi == pytest.approx(-expected.stress[0], abs=5.1e-9)
            side = lateral(system, result.state.x)
            np.testing.assert_allclose(side, expected.free_stretch[0], rtol=0, atol=1e-9)
            assert result.assembly.min_j == pytest.approx(expected.volume_ratio[0], abs=1e-9)


@pytest.mark.parametrize("material", [POLY2, OGDEN1, OGDEN3, *OTHERS], ids=name)
@pytest.mark.parametrize("formulation", ["mixed", "displacement"])
def test_uniaxial_in_3d(material, formulation):
    """V04 on distorted tetrahedra, against the closed form of the same compressibility."""
    system = system_of(material, space="3d", element_order="linear", formulation=formulation)
    for stretch in (0.7, 1.5):
        found = force(system, driven(system, 1 - stretch, 6)) / 4  # a quarter is what is solved
        assert found == pytest.approx(-float(uniaxial(material, stretch)), rel=1e-9)


@pytest.mark.parametrize("material", [NH, MR, RP2, YEOH, OGDEN1, OGDEN3], ids=name)
def test_incompressible_limit(material):
    """V01 with 1/K = 0, not a large K: the volume is kept to rounding."""
    material = incompressible(material)
    system = system_of(material)
    for stretch in (0.7, 1.5, 2.0):
        result = driven(system, 1 - stretch, 10)
        expected = -float(uniaxial(material, stretch))
        assert force(system, result) / np.pi == pytest.approx(expected, rel=1e-9)
        assert result.assembly.min_j == pytest.approx(1.0, abs=1e-11)


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize(
    ("formulation", "nu"), [("mixed", 0.3), ("displacement", 0.3), ("mixed", 0.5)]
)
def test_linear_elastic_is_hooke(space, formulation, nu):
    """Force E eps A and lateral strain -nu eps at any strain, in one iteration."""
    kept = {"incompressible": True} if nu == 0.5 else {"poisson_ratio": nu}
    material = Material("linear-elastic", {"youngs_modulus": 3.0}, **kept)
    area = np.pi if space == "axisymmetric" else 4.0
    system = system_of(material, space=space, formulation=formulation)
    for shortening in (0.3, -0.5):
        result = driven(system, shortening, 1)
        assert force(system, result) == pytest.approx(3.0 * shortening * area, rel=1e-11)
        side = lateral(system, result.state.x)
        np.testing.assert_allclose(side, 1 + nu * shortening, rtol=0, atol=1e-11)
        assert result.iterations == 1
        assert result.assembly.min_j == pytest.approx(1 - (1 - 2 * nu) * shortening, abs=1e-11)


@pytest.mark.parametrize("order", ["linear", "quadratic"])
@pytest.mark.parametrize("material", [NH, MR, POLY2, OGDEN1, OGDEN3, LINEAR], ids=name)
def test_3d_patch_with_a_full_gradient(material, order):
    """V12: boundary u = (F - I) X; inside exact, p = K (J - 1) (small strain: K tr eps)."""
    F = np.eye(3) + 0.1 * np.random.default_rng(11).standard_normal((3, 3))
    if material is LINEAR:
        F -= (np.trace(F) - 3.0005) / 3 * np.eye(3)
    else:
        F *= (1.0005 / np.linalg.det(F)) ** (1 / 3)
    system = system_of(material, cube(3), space="3d", element_order=order)
    nodes = system.space.nodes
    rim = np.flatnonzero((np.abs(nodes * (1 - nodes)) < 1e-9).any(axis=1))
    field = (nodes @ (F - np.eye(3)).T).ravel()
    if order == "linear":  # a bubble is no nodal value: exact means that it vanishes
        field.reshape(-1, 3)[len(system.mesh.points) :] = 0.0
    dofs = (3 * rim[:, None] + np.arange(3)).ravel()
    system = held(system, dofs, field[dofs])
    start = system.start()
    result = solve_step(system, State(1.0, start.x), TIGHT, lifted_from=start)
    assert result.converged
    u, p = np.split(result.state.x, [system.space.n_displacement])
    np.testing.assert_allclose(u, field, atol=1e-10)
    np.testing.assert_allclose(p, 1e3 * 0.0005, rtol=1e-8)


def curve(material, displacement=4.0, **model):
    problem = compression(Cylinder(25, 30), displacement, material=material, steps=2,
                          mesh="coarse", **model)  # fmt: skip
    return solve(problem, gradients=False, options=Options(side_contact=False)).curve


@pytest.mark.parametrize("material", [OGDEN3, POLY2, LINEAR], ids=name)
def test_scaling_of_moduli_and_lengths(material):
    """P01: all moduli times c, force times c. P02: all lengths times s, force times s^2."""
    factors = {n: 1.0 if n.startswith("alpha") else 7.0 for n in material.names}
    scaled = {n: factors[n] * value for n, value in material.constants.items()}
    stiffer = Material(material.model, scaled, bulk_modulus=7e3)
    base = curve(material).force_N
    np.testing.assert_allclose(curve(stiffer).force_N, 7 * base, rtol=1e-10)
    larger = compression(Cylinder(75, 90), 12.0, material=material, steps=2, mesh="coarse")
    options = Options(side_contact=False)
    found = solve(larger, gradients=False, options=options).curve.force_N
    np.testing.assert_allclose(found, 9 * base, rtol=1e-9)


def test_equal_shear_modulus_gives_equal_initial_slope():
    """V38, P12, P13: of one mu0 and K all energies coincide at small strain, and are linear."""
    slopes = np.array([curve(m, 1e-5).force_N for m in (*HYPERELASTIC, *OTHERS, hooke(NH))])
    np.testing.assert_allclose(slopes, slopes[:1] * np.ones((14, 1)), rtol=3e-6)
    np.testing.assert_allclose(slopes[:, 1], 2 * slopes[:, 0], rtol=3e-6)


def hooke(material):
    """Linear elastic material of the same mu0 and K."""
    mu, bulk = material.mu0, material.bulk
    modulus = 9 * bulk * mu / (3 * bulk + mu)
    return Material("linear-elastic", {"youngs_modulus": modulus}, bulk_modulus=bulk)


@pytest.mark.parametrize("space", SPACES)
def test_linear_elastic_stays_linear_when_bonded(space):
    """Force and base reaction grow in proportion to 45 %, where corners have 1 + tr eps < 0."""
    material = Material("linear-elastic", {"youngs_modulus": 3.0}, poisson_ratio=0.2)
    problem = compression(
        Cylinder(25, 30), 13.5, material=material, steps=3, formulation="displacement",
        space=space, mesh_size_mm=6.0 if space == "3d" else 2.0,
    )  # fmt: skip
    solution = solve(problem, options=Options(side_contact=False))
    assert solution.converged
    np.testing.assert_allclose(solution.curve.force_N, solution.curve.force_N[0] * np.arange(1, 4),
                               rtol=1e-9)  # fmt: skip
    np.testing.assert_allclose(solution.base_reaction_N, solution.curve.force_N, rtol=1e-8)
    assert solution.min_j > 0


def test_displacement_formulation_needs_a_bulk_modulus():
    material = Material("ogden", {"mu1": 1.0, "alpha1": 2.0}, incompressible=True)
    with pytest.raises(InputError, match="mixed"):
        solve(compression(Cylinder(1, 1), 0.1, material=material, formulation="displacement"))


class Yeoh(ReducedPolynomial):
    """The reduced polynomial of third order with its own name."""

    name = "third-order"
    has_order = False

    def constant_names(self, order=1):
        """Three constants."""
        return ("C10", "C20", "C30")


def test_a_new_energy_takes_ten_lines(monkeypatch):
    """One class, and the solver, its gradients and the closed forms know it."""
    monkeypatch.setitem(ENERGIES, Yeoh.name, Yeoh())
    material = Material("third-order", YEOH.constants, bulk_modulus=1e3)
    np.testing.assert_array_equal(curve(material).force_N, curve(YEOH).force_N)
    assert uniaxial(material, 0.7) == uniaxial(YEOH, 0.7)


def test_a_load_step_beyond_the_end_of_chains_is_halved():
    """A first trial at 40 % would lie beyond Jm; smaller steps pass, and the force is the same."""
    material = Material("gent", {"mu": 1.0, "Jm": 1.2}, bulk_modulus=1e3)
    problem = compression(Cylinder(25, 30), 12.0, "frictionless", material=material, steps=1)
    solution = reached(problem)
    expected = -float(uniaxial(material, 0.6)) * np.pi * 25**2
    assert solution.curve.force_N[-1] == pytest.approx(expected, rel=1e-7)


def test_a_test_beyond_the_end_of_chains_is_an_honest_failure():
    """I1 - 3 is 0.69 at a stretch of 0.6, and Jm 0.5: that is said, and nothing is solved."""
    material = Material("gent", {"mu": 1.0, "Jm": 0.5}, bulk_modulus=1e3)
    problem = compression(Cylinder(25, 30), 12.0, "frictionless", material=material, steps=10)
    solution = solve(problem, gradients=False)
    assert solution.status == "unstable"
    # l^2 + 2/l = 3.5 at l = 0.6498
    assert "below stretch 0.6498, where its chains end" in solution.message
    assert solution.curve.force_N.size == 0


def test_chains_that_end_at_a_bonded_corner_end_the_curve():
    """The mean stretch is allowed, that of the rim is not: the curve stops, with no NaN in it."""
    material = Material("gent", {"mu": 1.0, "Jm": 0.75}, bulk_modulus=1e3)
    problem = compression(Cylinder(25, 30), 11.0, "bonded", material=material, steps=10)
    solution = solve(problem, gradients=False)
    assert solution.status == "not-converged"
    assert "the end of its chains" in solution.message
    assert 0 < solution.curve.displacement_mm.max() < 11.0
    assert np.isfinite(solution.curve.force_N).all()
