"""A run ends where the specimen gives way, at a limit point or by swaying, and says so."""

from dataclasses import replace

import meshio
import numpy as np
import pytest
import scipy.sparse as sp

from study.api import solving
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Block, Cylinder, Flat, Gravity, Sphere
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test, buckling_strain
from study.mechanics.solver import load_path
from study.mechanics.solver.equilibrium import (
    has_inertia_of_factors,
    is_unstable,
    least_stiffness,
    mirrored,
)
from study.mechanics.solver.finite_element_solution import follow, solve
from study.mechanics.solver.linear_solver import pardiso_available
from study.mechanics.solver.load_path import gives_way
from study.mechanics.solver.newton import Options
from study.simulation import plausibility
from study.simulation.cell import CellProblem
from tests.fem.problems import GEL, NEEDLE, compression, indentation, long_verification, reached

#: softens without losing its ellipticity
VARGA = Material("ogden", {"mu1": 1e-2, "alpha1": 1.0}, bulk_modulus=10.0)


def needle(material, depth):
    return indentation(NEEDLE, depth, material=material, steps=6, mesh="coarse")


def test_a_needle_in_a_softening_body_stops_at_a_limit_point():
    """At 2.79, 2.86 and 2.89 mm on the coarse, medium and fine mesh."""
    solution = solve(needle(VARGA, 5.0), gradients=False, options=Options(snaps=False))
    assert solution.status == "not-converged"
    assert 2.6 < solution.reached_mm < 3.0
    assert "(a limit point)" in solution.message
    assert "press less deep" in solution.message


def test_a_body_that_stiffens_does_not_give_way():
    solution = reached(needle(GEL, 3.0))
    steps = [step.state for step in solution.warm.steps]
    assert all(gives_way(solution.warm.system, steps[0], later) == "" for later in steps)


@pytest.mark.parametrize(
    ("specimen", "material", "share", "excess"),
    [(Cylinder(25.0, 3.0), Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.4995), 0.3, 0.04),
     (Cylinder(10.0, 15.0), Material("ogden", {"mu1": 1e-2, "alpha1": -12.0}, incompressible=True),
      0.4, 0.06)],
)  # fmt: skip
def test_a_mesh_too_coarse_for_its_deformation_is_named(specimen, material, share, excess):
    """Linear triangles hold their volume in the mean alone: force and energy add up, and are wrong.

    The truth is that of quadratic triangles, which are silent.
    """
    forces, notes = [], []
    for order, mesh in (("linear", "coarse"), ("quadratic", "medium")):
        found = reached(
            compression(
                specimen, share * specimen.height_mm, material=material, steps=10,
                element_order=order, mesh=mesh,
            )
        )  # fmt: skip
        forces.append(found.curve.force_N[-1])
        notes.append(found.message)
    assert forces[0] > (1 + excess) * forces[1]
    assert "volumes within the elements are off by" in notes[0]
    assert notes[1] == "every step converged"


@pytest.mark.parametrize(
    ("nu", "depth", "excess"), [(0.49, 0.2, 1.3), (0.49, 0.5, 1.3), (0.45, 0.3, 1.1)]
)
def test_a_layer_of_few_linear_elements_under_a_sticking_sphere_is_named(nu, depth, excess):
    """1.7 tetrahedra over a layer of 1.5 mm: .385 N where .267 is right, 4.7 where 3.0 is.

    Of a compressible layer .454 N where .399 is.

    A root mean square over the whole body saw nothing, since the layer is ten times as wide as what
    is pressed.
    """
    material = Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=nu)
    layer, sphere = Cylinder(12.0, 1.5), Sphere(25.0)
    forces, notes = [], []
    for model in (
        {"space": "3d", "element_order": "linear"},
        {"space": "axisymmetric", "element_order": "quadratic"},
    ):
        found = reached(
            indentation(
                sphere, depth, layer, material=material, steps=5, interface="bonded",
                mesh="coarse", **model,
            )
        )  # fmt: skip
        forces.append(found.curve.force_N[-1])
        notes.append(found.message)
    assert forces[0] > excess * forces[1]
    assert "uneven volumes within the elements stand for" in notes[0]
    assert "uneven volumes" not in notes[1]


def test_a_snap_that_takes_much_of_the_energy_ends_the_curve():
    """A surface that snaps loses some 1 %: this one lost 19 %, and its force is another's."""
    material = Material("ogden", {"mu1": 1e-2, "alpha1": -12.0}, poisson_ratio=0.49)
    found = solve(compression(Cylinder(10.0, 10.0), 4.0, material=material, steps=10))
    assert found.status == "unstable"
    assert found.curve.displacement_mm[-1] <= found.reached_mm < 4.0
    assert found.energy.largest_mismatch < 0.05
    assert "% of the energy was lost: the elements may have given way" in found.message


def test_a_thin_disc_whose_edge_gives_way_has_no_force_behind_it():
    """Mesh "medium" had 83 kN at .24 mm where "coarse", which goes on, has 110 kN."""
    material = Material("neo-hookean", {"C10": 0.05}, poisson_ratio=0.4995)
    found, other = (
        solve(
            compression(
                Cylinder(50.0, 1.0), 0.3, "frictionless", base="bonded", material=material,
                steps=5, mesh=mesh,
            )
        )
        for mesh in ("medium", "coarse")
    )  # fmt: skip
    assert found.status == "unstable"
    shared = len(found.curve.force_N)
    assert shared > 1
    np.testing.assert_allclose(found.curve.force_N, other.curve.force_N[:shared], rtol=2e-3)


@pytest.mark.parametrize(
    ("material", "order"),
    [(GEL, "quadratic"), (Material("neo-hookean", {"C10": 0.01}, incompressible=True), "linear")],
)
def test_factors_of_an_earlier_step_say_that_a_solid_stands(monkeypatch, material, order):
    """Solids use factors again; the last step had one factorization more, a fifth of the time.

    Of an incompressible one pivots are perturbed, and 40 vectors more were a tenth.
    """
    looked_at = list[float]()

    def spy(system, state):
        looked_at.append(state.displacement_mm)
        return is_unstable(system, state)

    monkeypatch.setattr(load_path, "is_unstable", spy)
    problem = compression(
        Block(20.0, 20.0, 20.0), 2.0, material=material, steps=5, space="3d", element_order=order,
        element_shape="tensor", mesh_size_mm=3.4,
    )  # fmt: skip
    found = reached(problem)
    assert looked_at == []
    assert not any(is_unstable(found.warm.system, step.state) for step in found.warm.steps)


def test_a_motion_that_the_load_does_not_excite_ends_a_run_with_factors_of_earlier_steps():
    """Between slippery plates the load moves the body evenly alone: its corrections see no crease.

    Factors of the last step itself have the negative pivot; its last factorization was of another.
    """
    problem = compression(
        Block(12.0, 12.0, 10.0), 4.794, "frictionless", material=VARGA, steps=10, space="3d",
        element_order="linear", element_shape="tensor", mesh_size_mm=1.0,
    )  # fmt: skip
    found = solve(problem, gradients=False)
    assert found.status == "unstable"
    assert found.instability.displacement_mm == pytest.approx(4.74, rel=0.01)


def test_perturbed_pivots_of_an_incompressible_body_have_the_signs_of_its_tangent():
    """Against all eigenvalues: one negative for each pressure before the column sways."""
    material = Material("neo-hookean", {"C10": 0.01}, incompressible=True)
    problem = compression(
        Block(20.0, 20.0, 20.0), 2.0, material=material, steps=2, space="3d",
        element_order="linear", element_shape="tensor", mesh_size_mm=5.0,
    )  # fmt: skip
    found = reached(problem)
    system, last = found.warm.system, found.warm.steps[-1].state
    system.assemble(last)
    system.factorize()
    pattern = system.pattern
    n = pattern.free.size
    upper = sp.csr_matrix((system.data, pattern.indices, pattern.indptr), shape=(n, n)).toarray()
    eigenvalues = np.linalg.eigvalsh(upper + np.triu(upper, 1).T)
    assert not system.solver.unperturbed() or not pardiso_available()
    assert system.solver.negative_pivots() in (None, np.count_nonzero(eigenvalues < 0))
    assert has_inertia_of_factors(system)


# Columns that sway: against Euler's load, on the whole body, and said before solving.

SOFT = Material("neo-hookean", {"C10": 0.01}, poisson_ratio=0.45)
COLUMN = Block(width_mm=12.0, depth_mm=8.0, height_mm=90.0)


def _column(depth, steps, interface="bonded", base="bonded", order="quadratic", size_mm=4.0):
    return compression(
        COLUMN, depth, interface, base=base, material=SOFT, steps=steps, space="3d",
        element_shape="tensor", element_order=order, mesh_size_mm=size_mm,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("interface", "base", "solver"),
    [("bonded", "bonded", "auto"), ("frictionless", "bonded", "auto"),
     ("frictionless", "frictionless", "superlu")],
)  # fmt: skip
def test_a_quarter_of_a_column_is_refused_at_eulers_load(interface, base, solver):
    critical = buckling_strain(Test("compression", 1.0, interface, base), COLUMN)
    depth = 1.25 * critical * COLUMN.height_mm
    options = Options(linear_solver=solver)
    found = solve(_column(depth, 5, interface, base), gradients=False, options=options)
    assert found.status == "unstable"
    assert found.instability.sway == "y"  # the thin direction
    assert found.instability.displacement_mm == pytest.approx(0.8 * depth, rel=0.03)
    assert found.curve.displacement_mm[-1] == found.reached_mm < found.instability.unstable_mm
    assert np.abs(found.instability.mode[:, 1]).max() == pytest.approx(1.0, abs=0.02)


def test_the_whole_straight_column_loses_stability_where_its_quarter_says():
    problem = _column(4.0, 10, order="linear")
    part = solve(problem, gradients=False).instability
    quarter = build_mesh(problem.setup)
    whole, _ = mirrored(quarter, np.zeros(quarter.points.shape), (1, 1, 1), COLUMN.height_mm)
    edges = whole.points[whole.cells[:, [1, 3, 4]]] - whole.points[whole.cells[:, :1]]
    volumes = np.linalg.det(edges)
    assert np.abs(volumes).sum() == pytest.approx(COLUMN.volume_mm3)
    assert (volumes > 0).all() or (volumes < 0).all()
    found = solve(problem, gradients=False, mesh=whole)
    assert found.status == "unstable"
    assert found.instability.sway is None
    assert found.instability.displacement_mm == pytest.approx(part.displacement_mm, rel=1e-3)


@pytest.mark.parametrize(("density", "status"), [(1.0, "converged"), (6e4, "unstable")])
def test_a_column_that_its_weight_has_buckled_does_not_stand_at_all(density, status):
    """Hardly pressed: the lower half of the heavy one carries twice Euler's load for its length."""
    problem = _column(0.05, 1, order="linear")
    heavy = replace(problem, test=replace(problem.test, gravity=Gravity(density)))
    found = solve(heavy, gradients=False)
    assert found.status == status
    if status == "unstable":
        assert found.instability.stable_mm == found.instability.unstable_mm == 0
        assert "under its weight is unstable before the test begins" in found.message


def test_a_linear_elastic_column_is_said_never_to_buckle():
    """Its caution does not send the user to ``--follow``, which has no instability to follow."""
    table = {
        "model": "linear-elastic",
        "constants": {"youngs_modulus": 0.03},
        "poisson_ratio": 0.45,
    }
    cell = CellProblem(COLUMN, Test("compression", 5.0, "bonded", steps=1),
                       MaterialSection.of(table), Model(space="3d", element_shape="tensor",
                       element_order="linear", mesh_size_mm=4.0))  # fmt: skip
    caution = " ".join(plausibility.cautions_of(cell))
    found = solve(cell.at(), gradients=False)
    for words in (caution, found.message):
        assert "never buckles" in words
        assert "--follow" not in words
    # E A d / H, a little more between bonded plates
    assert found.curve.force_N[-1] == pytest.approx(0.03 * 96 * 5 / 90, rel=0.05)


@long_verification
def test_the_branch_behind_is_followed_on_the_whole_body():
    problem = _column(4.5, 3, order="linear")
    euler = np.pi**2 * 2 * 1.45 * 2 * 0.01 * (12 * 8**3 / 12) / (90 / 2) ** 2
    found = follow(problem, gradients=False)
    assert found.converged
    assert found.instability is not None
    assert found.curve.displacement_mm[-1] == pytest.approx(4.5)
    # behind it the force hardly rises; the straight column would carry 1.6 times as much
    assert found.curve.force_N[-1] == pytest.approx(euler, rel=0.06)
    assert np.abs(found.displacement[:, 1]).max() > 2.0


SOLVERS = ("pardiso", "superlu") if pardiso_available() else ("superlu",)


@pytest.mark.parametrize("solver", SOLVERS)
def test_motions_that_pressures_hold_are_no_way_to_give_way(solver):
    """Few elements, all incompressible: compliances of zero, whose rounding has any sign."""
    material = Material("reduced-polynomial", {"C10": 5e-3, "C20": 1e-3}, incompressible=True)
    for size_mm in (5.0, 3.0):
        problem = compression(
            Cylinder(10.0, 10.0), 3.0, "frictionless", material=material, steps=2,
            element_order="linear", mesh_size_mm=size_mm,
        )  # fmt: skip
        found = solve(problem, options=Options(linear_solver=solver))
        assert found.converged, found.message
        # the softest way moves the whole body: no stiffness of rounding
        assert 0 < least_stiffness(found.warm.system)[0] < 100.0


def test_slender_columns_are_cautioned_about_before_solving():
    table = {"model": "neo-hookean", "constants": {"C10": 0.01}, "poisson_ratio": 0.45}
    material = MaterialSection.of(table)

    def said(height, share, interface):
        test = Test("compression", share * height, interface, interface)
        column = CellProblem(Cylinder(5.0, height), test, material, Model(space="axisymmetric"))
        return any("buckles" in one for one in plausibility.cautions_of(column))

    assert said(20.0, 0.30, "frictionless")
    assert not said(20.0, 0.02, "frictionless")
    assert not said(10.0, 0.10, "bonded")
    assert not said(6.0, 0.30, "frictionless")


def test_a_buckled_column_is_drawn_and_written_with_its_mode(tmp_path):
    found = solve(_column(5.0, 4, order="linear", size_mm=8.0), gradients=False)
    assert found.instability is not None
    solving.write_picture(found, tmp_path / "bent.svg")
    assert "<svg" in (tmp_path / "bent.svg").read_text()
    solving.write_vtu(found, tmp_path / "bent.vtu", whole=True)
    read = meshio.read(tmp_path / "bent.vtu")
    mode, z = read.point_data["buckling_mode"], read.points[:, 2]
    middle = np.abs(z - 45.0) < 1e-9  # sways to one side, the ends stand
    assert mode[middle, 1].min() > 0.9 or mode[middle, 1].max() < -0.9
    np.testing.assert_allclose(mode[(z < 1e-9) | (z > 90 - 1e-9)], 0.0, atol=1e-12)


def test_a_mode_that_has_yet_to_converge_is_none_of_the_whole_body():
    """Two modes of elements at the rim of a punch: a third of the body seemed to take part."""
    material = Material("mooney-rivlin", {"C10": 0.3, "C01": 0.2}, poisson_ratio=0.48)
    test = Test("indentation", 1.0, "frictionless", "bonded", 3, Flat(3.0, 0.5))
    model = Model("3d", "linear", "tensor", mesh="coarse")
    found = solve(Problem(Cylinder(20.0, 20.0), test, material, model), gradients=False)
    assert found.message == "every step converged"
    # quadratic hexahedra, whose factors show no negative stiffness
    assert found.curve.force_N[-1] == pytest.approx(24.208, rel=0.02)


def test_factors_of_the_last_newton_iterate_are_asked_for_nothing_more(monkeypatch):
    """Plane meshes factorize every tangent: a random load was 1 to 2 % of such a solve."""
    asked = list[str]()

    def spy(system):
        asked.append(system.solver.name)
        return has_inertia_of_factors(system)

    monkeypatch.setattr(load_path, "has_inertia_of_factors", spy)
    found = reached(compression(Cylinder(25.0, 30.0), 6.0, material=GEL, steps=5))
    assert asked == []
    assert not any(is_unstable(found.warm.system, step.state) for step in found.warm.steps)
