"""A plate that shifts, turns and lets the face slip: closed forms, symmetry, derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Block, Cylinder, FaceMotion
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import NoEquilibrium, PrescribedMotion, solve
from study.simulation.response import simulated
from tests.fem.problems import GEL, long_verification

MODEL = Model(space="3d", element_shape="tensor", mesh_size_mm=10.0)
CUBE = Block(20, 20, 20)


def moved(depth, motion=None, **changes):
    test = Test("plate-motion", depth, "bonded", "bonded", steps=1, motion=motion)
    return replace(Problem(CUBE, test, GEL, MODEL), **changes)


@pytest.mark.parametrize("shape", ["tensor", "simplex"])
def test_a_true_plate_is_bonded_compression(shape):
    # the whole is meshed as four mirrored quarters; tetrahedra cut the quarters otherwise
    problem = moved(3.0, model=replace(MODEL, element_shape=shape))
    quarter = replace(problem, test=Test("compression", 3.0, "bonded", "bonded", steps=1))
    whole, known = (solve(p, gradients=False) for p in (problem, quarter))
    assert whole.points[:, 0].min() == -10
    exact = shape == "tensor"  # hexahedra of a half height are those of the whole one
    rel = 1e-6 if exact else 0.02
    np.testing.assert_allclose(whole.curve.force_N, known.curve.force_N, rtol=rel)
    np.testing.assert_allclose(whole.base_reaction_N, whole.curve.force_N, rtol=1e-6)


def test_a_wide_layer_is_sheared_by_its_modulus():
    # F = mu A s / h but for the free edges, over a depth that is nothing beside the shift
    down, shift = 1e-5, 1e-2
    thin = moved(down, FaceMotion(x_mm=shift), specimen=Block(120, 120, 3),
                 model=replace(MODEL, mesh_size_mm=15.0))  # fmt: skip
    found = solve(thin, gradients=False)
    force = found.equilibria.plate[-1].side[0]
    sheared = 2 * GEL.constants["C10"] * 120 * 120 * shift / 3
    # free edges do not carry the shear that acts along them: about h over the width
    assert force == pytest.approx(sheared, rel=0.02)
    assert force < sheared
    # the same as responses of a study, on the plate and on the base
    assert simulated("side_force", found.curve) == pytest.approx(force, rel=1e-6)
    assert simulated("base_side_force", found.curve) == pytest.approx(force, rel=1e-6)
    # both moments hold what the force turns by its arm of 3 mm; the axial force has one of .01 mm
    turned = simulated("moment", found.curve) + simulated("base_moment", found.curve)
    assert turned == pytest.approx(3 * force, rel=2e-3)


def test_a_twisted_layer_has_its_polar_moment():
    angle = np.radians(0.5)
    thin = moved(1e-5, FaceMotion(twist_deg=0.5), specimen=Block(120, 120, 3),
                 model=replace(MODEL, mesh_size_mm=15.0))  # fmt: skip
    curve = solve(thin, gradients=False).curve
    polar = 120**4 / 6
    for response in ("moment", "base_moment"):
        torque = 2 * GEL.constants["C10"] * polar * angle / 3
        assert simulated(response, curve) == pytest.approx(torque, rel=0.05)


def test_rates_are_those_of_neighboring_equilibria():
    problem = moved(2.0, FaceMotion(y_mm=0.5, twist_deg=1.0))
    plate = PrescribedMotion(problem, solve(problem, gradients=False))
    step = np.array([1e-3, -1e-3, 2e-3, 1e-4, -1e-4, 2e-4, 1e-4])
    there, back = (plate.at(plate.start.motion + s * step, plate.start) for s in (1, -1))
    change = (there.displacement - back.displacement) / 2
    wanted = plate.start.rates @ step
    assert np.abs(change - wanted).max() < 1e-4 * np.abs(wanted).max()


def test_the_way_does_not_matter():
    # the same motion by a load path of its own, and from another equilibrium
    far = moved(3.0, FaceMotion(x_mm=1.0, tilt_x_deg=1.5, spread=0.08))
    own = PrescribedMotion(far, solve(far, gradients=False)).start
    problem = moved(2.0)
    plate = PrescribedMotion(problem, solve(problem, gradients=False))
    found = plate.at(own.motion, plate.start)
    np.testing.assert_allclose(found.displacement, own.displacement, atol=1e-6)


def test_what_is_not_modelled_is_refused():
    with pytest.raises(InputError, match="block"):
        solve(moved(1.0, specimen=Cylinder(10, 20)))
    problem = moved(1.0)
    plate = PrescribedMotion(problem, solve(problem, gradients=False))
    with pytest.raises(NoEquilibrium, match="off the specimen"):
        plate.at(-plate.start.motion, plate.start)


def test_forces_and_moments_of_plate_and_base_balance():
    motion = FaceMotion(x_mm=2.0, y_mm=-1.0, tilt_y_deg=2.0, twist_deg=5.0)
    found = solve(moved(2.0, motion, test=replace(moved(2.0, motion).test, steps=4)))
    above, below = found.equilibria.plate[-1], found.equilibria.base[-1]
    assert above.axial == pytest.approx(below.axial, rel=1e-6)
    np.testing.assert_allclose(above.side, -below.side, rtol=1e-6)
    down = np.r_[above.side, -above.axial]
    arm = np.array([2.0, -1.0, 18.0])
    left = above.moment + below.moment + np.cross(arm, down)
    assert np.abs(left).max() < 1e-5 * np.abs(above.moment).max()
    # the force is the axial reaction, not the work of the whole motion, and so are its slopes
    curve = found.curve
    np.testing.assert_allclose(curve.force_N, [r.axial for r in found.equilibria.plate], rtol=1e-6)
    rising = (curve.force_N[3] - curve.force_N[1]) / 1.0
    assert curve.stiffness_N_per_mm[2] == pytest.approx(rising, rel=0.02)
    stiffer = Material("neo-hookean", {"C10": 5.01e-3}, bulk_modulus=GEL.bulk)
    other = solve(moved(2.0, motion, material=stiffer), gradients=False).curve.force_N[-1]
    softer = Material("neo-hookean", {"C10": 4.99e-3}, bulk_modulus=GEL.bulk)
    change = other - solve(moved(2.0, motion, material=softer), gradients=False).curve.force_N[-1]
    assert curve.force_gradient["C10"][-1] == pytest.approx(change / 2e-5, rel=1e-3)


@long_verification
def test_a_shifted_plate_presses_with_its_axial_reaction_alone():
    thin = moved(0.01, FaceMotion(x_mm=1.0), specimen=Block(24, 24, 6),
                 model=replace(MODEL, mesh_size_mm=3.0))  # fmt: skip
    found = solve(thin, gradients=False)
    sheared = 2 * GEL.constants["C10"] * 24 * 24 / 6
    assert found.equilibria.plate[-1].side[0] == pytest.approx(sheared, rel=0.2)
    # a shear of g = 1/6 pulls the plates together by the Poynting effect: of the order mu g^2 A
    assert abs(found.curve.force_N[-1]) < 0.3 * sheared
