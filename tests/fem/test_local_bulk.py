"""The local bulk modulus of quadratic tetrahedra: exact rates, and no locking as nu goes to 0.5."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Cone, Cylinder, Flat, Sphere
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.internal_force import split_bulk
from study.mechanics.solver.system import System
from tests.fem.problems import NEEDLE, indentation, long_verification, reached

CONE, SPHERE, FLAT = Cone(30, 1, 3), Sphere(5.0), Flat(3, 0.3)
RATIOS = (0.45, 0.49, 0.499, 0.4995, 0.4999, 0.49999, 0.499999, 0.5)


def pressed(indenter, depth, nu, space, mesh):
    """Neo-Hookean gel of a Poisson's ratio, 0.5 included."""
    volume = {"incompressible": True} if nu == 0.5 else {"poisson_ratio": nu}
    return indentation(
        indenter, depth, material=Material("neo-hookean", {"C10": 5e-3}, **volume),
        specimen=Cylinder(33.85, 40), steps=4, space=space, mesh=mesh, mesh_ratio=1.3,
    )  # fmt: skip


@pytest.mark.parametrize("bulk", [1e-3, 1.0, 1e3, 1e9, np.inf])
def test_the_local_bulk_modulus_is_bounded(bulk):
    local, compliance = split_bulk(bulk, 2.0)
    assert 0 < local <= min(bulk, 2.0)
    # both parts together are K; 1 / compliance is rounded at 1e-16 of K
    if np.isfinite(bulk):
        assert local + 1 / compliance == pytest.approx(bulk, rel=1e-12)
    else:
        assert (local, compliance) == (2.0, 0.0)
        np.testing.assert_allclose(split_bulk(1e12, 2.0), (2.0, 0.0), rtol=1e-11, atol=2e-12)
    assert split_bulk(bulk, 0.0) == (0.0, 1 / bulk)


@long_verification
def test_quadratic_tetrahedra_do_not_lock_at_nearly_constant_volume():
    """An unbounded share of K gave +7.8 % at 0.499999 under a sphere.

    A shallow one: the meshes of 2 mm take minutes. Forces of the two spaces differ by the error
    of the coarse mesh, and that error must not depend on Poisson's ratio.
    """
    errors = []
    for nu in (0.4995, 0.5):
        plane, solid = (
            solve(pressed(SPHERE, 1.0, nu, space, mesh), gradients=False)
            for space, mesh in (("axisymmetric", "fine"), ("3d", "coarse"))
        )
        assert solid.converged, solid.message
        errors.append(solid.curve.force_N[-1] / plane.curve.force_N[-1] - 1)
    assert np.abs(errors).max() < 0.01  # what a coarse mesh may be off by
    assert np.ptp(errors) < 1e-3  # an unbounded share: 8e-2


@pytest.mark.parametrize("nu", RATIOS)
@pytest.mark.parametrize(
    ("indenter", "depth", "mesh", "tolerance"),
    [
        pytest.param(CONE, 2.0, "coarse", 0.01, id="cone-coarse"),
        pytest.param(CONE, 2.0, "medium", 0.005, id="cone-medium"),
        pytest.param(SPHERE, 2.0, "coarse", 0.01, id="sphere-coarse"),
        pytest.param(SPHERE, 2.0, "medium", 0.005, id="sphere-medium"),
        pytest.param(FLAT, 1.0, "coarse", 0.006, id="flat-coarse"),
        pytest.param(FLAT, 1.0, "medium", 0.005, id="flat-medium"),
    ],
)
@long_verification
def test_no_poissons_ratio_locks(indenter, depth, nu, mesh, tolerance):
    problem = pressed(indenter, depth, nu, "3d", mesh)
    plane = replace(problem.model, space="axisymmetric", mesh="fine")
    expected = solve(replace(problem, model=plane), gradients=False).curve.force_N[-1]
    found = reached(problem)
    assert found.curve.force_N[-1] == pytest.approx(expected, rel=tolerance)


def test_which_elements_have_a_local_bulk_modulus():
    """Quadratic solids under an indenter have one; plane and linear elements have none."""
    shares = {}
    for space in ("axisymmetric", "3d"):
        for order in ("linear", "quadratic"):
            problem = indentation(NEEDLE, 0.6, mesh="coarse", space=space, element_order=order)
            shares[space, order] = System.build(
                problem, build_mesh(problem.setup)
            ).internal.local_bulk
    assert [key for key, share in shares.items() if share] == [("3d", "quadratic")]
