"""From a file to a force for every energy, and foams, which are weighed where sides are free."""

from __future__ import annotations

import numpy as np
import pytest

from study.api.calibrating import choose_energy
from study.api.solving import solve
from study.ground.errors import InputError
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from tests.cli.small import case_file, gauge, pressed, recorded
from tests.fem.problems import long_verification
from tests.material.modes import uniaxial

ENERGIES = {
    "linear-elastic": 'model = "linear-elastic"\nyoungs_modulus = "30 kPa"',
    "neo-hookean": 'model = "neo-hookean"\nC10 = "5 kPa"',
    "mooney-rivlin": 'model = "mooney-rivlin"\nC10 = "4 kPa"\nC01 = "1 kPa"',
    "reduced-polynomial": 'model = "reduced-polynomial"\nC10 = "5 kPa"\nC20 = "1 kPa"',
    "polynomial": 'model = "polynomial"\nC10 = "4 kPa"\nC01 = "1 kPa"\nC11 = "200 Pa"',
    "ogden": 'model = "ogden"\nmu = ["6 kPa", "3 kPa", "1 kPa"]\nalpha = [1.3, 5.0, -2.0]',
}
COMPRESSIBILITY = {
    "nearly": "poisson_ratio = 0.4995",
    "bulk": 'bulk_modulus = "10 MPa"',
    "fully": "incompressible = true",
}


def write(folder, material, compressibility, space="axisymmetric"):
    solid = f"[material]\n{material}\n{compressibility}\n"
    model = f'[model]\nspace = "{space}"\nmesh_size = "5 mm"\nelement_order = "linear"\n'
    test = 'displacement = "3 mm"\nsteps = 2\n'
    return case_file(folder, pressed(solid + model, height=10, test=test))


#: every energy and volume law in the section, and each energy once in space
CASES = [
    *((energy, kept, "axisymmetric") for energy in ENERGIES for kept in COMPRESSIBILITY),
    *(
        (energy, kept, "3d")
        for energy, kept in zip(ENERGIES, 2 * list(COMPRESSIBILITY), strict=True)
    ),
]


@pytest.mark.parametrize(("energy", "kept", "space"), CASES)
def test_solve_from_a_file(energy, kept, space, tmp_path):
    """Force of the closed form, one gradient for every constant, and plain JSON."""
    path = write(tmp_path, ENERGIES[energy], COMPRESSIBILITY[kept], space)
    solution = solve(path)
    assert solution.warm is not None
    material = solution.warm.system.material
    stress = uniaxial(material, np.array([0.85, 0.7]))
    np.testing.assert_allclose(solution.curve.force_N, -stress * np.pi * 100, rtol=1e-8)
    found = solution.to_json()
    assert found["status"] == "converged"
    assert list(found["force_gradient"]) == list(material.names) == list(found["parameters"])
    assert np.isfinite(list(found["force_gradient"].values())).all()


def test_refused_before_meshing(tmp_path):
    """F26; what else is refused: `tests/design/faulty_files`."""
    material = 'model = "ogden"\nmu = ["12 kPa", "-2 kPa"]\nalpha = [2.0, 9.0]'
    with pytest.raises(InputError, match="unstable"):
        solve(write(tmp_path, material, COMPRESSIBILITY["nearly"]))


@pytest.mark.parametrize(
    ("model", "constants", "said"),
    [
        ("ogden", {"mu1": 12.0, "alpha1": 2.0, "mu2": -2.0, "alpha2": 9.0}, "unstable"),
        ("linear-elastic", {"youngs_modulus": 0.0}, "positive"),
    ],
)
def test_a_problem_made_in_python_is_judged_too(model, constants, said):
    made = Material(model, constants, incompressible=True)
    with pytest.raises(InputError, match=said):
        solve(Problem(Cylinder(10, 10), Test("compression", 3.0), made, Model(mesh_size_mm=5.0)))


def written(folder, compressibility):
    """Tension and compression of a foam with 1 % of noise; mu = 20 kPa, alpha = 8."""
    foam = Material("ogden-hill", {"mu1": 0.02, "alpha1": 8.0}, poisson_ratio=0.2)
    rng, tests = np.random.default_rng(3), ""
    for kind, end, more in (("tension", 1.5, ""), ("compression", 0.5, ', sign = "negative"')):
        stretch = np.linspace(1 + 0.04 * (end - 1), end, 25)
        stress = 1e3 * LOADINGS["uniaxial"].nominal(foam, stretch).stress
        stress += 0.01 * np.abs(stress).max() * rng.normal(size=stress.size)
        columns = {"stretch": ("1", stretch), "stress": ("kPa", stress)}
        tests += recorded(folder, kind, f'kind = "{kind}"', columns, more)
    return case_file(folder, gauge(f'model = "neo-hookean"\n{compressibility}'), tests)


@long_verification
@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_a_foam_is_known_among_all_energies(tmp_path):
    found = choose_energy(written(tmp_path, "poisson_ratio = 0.2"), data=tmp_path)
    assert found.best == "ogden-hill-1"
    # 1 % of noise in 50 rows
    assert found.fits["ogden-hill-1"].fit.values == pytest.approx([0.02, 8.0], rel=0.01)


@long_verification
def test_an_incompressible_solid_is_no_foam(tmp_path):
    found = choose_energy(written(tmp_path, "incompressible = true"), data=tmp_path)
    assert not [k for k in (*found.fits, *found.failures) if k.startswith("ogden-hill")]
