"""Ogden and Hill's foam: the formula of Abaqus' manual, invariance, small strain, closed forms."""

import numpy as np
import pytest

from study import api
from study.mechanics.material.homogeneous import LOADINGS, MODES, first_piola, response
from study.mechanics.material.material import Material
from study.mechanics.material.stability import stability
from tests.cli.small import case_file, gauge, recorded, success
from tests.material.modes import FOAM

NU, CONSTANTS = FOAM.poisson_ratio, FOAM.constants
RIGID = Material("ogden-hill", CONSTANTS, poisson_ratio=0.0)


def states(count=20):
    """Random deformation gradients, shape (3, 3, count)."""
    rng = np.random.default_rng(11)
    F = np.eye(3)[..., None] + rng.uniform(-0.3, 0.3, (3, 3, count))
    assert (np.linalg.det(np.moveaxis(F, -1, 0)) > 0.1).all()
    return F


def manual(values, F):
    """W of *Hyperfoam from its data line (Abaqus Theory Guide, hyperfoam), stretches of C."""
    terms = len(values) // 3
    stretch = np.sqrt(np.linalg.eigvalsh(F.T @ F))
    J, total = float(np.linalg.det(F)), 0.0
    for k in range(terms):
        mu, alpha, nu = values[2 * k], values[2 * k + 1], values[2 * terms + k]
        beta = nu / (1 - 2 * nu)
        swelling = (J ** (-alpha * beta) - 1) / beta if beta else -alpha * np.log(J)
        total += 2 * mu / alpha**2 * ((stretch**alpha).sum() - 3 + swelling)
    return total


def by_differences(energy, F, h=1e-5):
    """Derivative by every component, of fourth order."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            step = np.zeros((3, 3))
            step[i, j] = h
            near = energy(F + step) - energy(F - step)
            far = energy(F + 2 * step) - energy(F - 2 * step)
            out[i, j] = (8 * near - far) / (12 * h)
    return out


def problem(folder, nu=NU):
    foam = 'model = "ogden-hill"\nmu = ["30 kPa", "10 kPa"]\nalpha = [4.0, -2.5]\n'
    pressed = '[test]\nkind = "compression"\ndisplacement = "10 mm"\nsteps = 5\n'
    size = 'area = "100 mm^2"\nlength = "20 mm"\n'
    return case_file(folder, gauge(f"{foam}poisson_ratio = {nu}", size), pressed)


@pytest.mark.parametrize("poisson_ratio", [NU, 0.0, 0.45, -0.2])
def test_abaqus_has_the_same_stress_at_20_states(tmp_path, poisson_ratio):
    """From the exported text."""
    path = problem(tmp_path, nu=poisson_ratio)
    answer = success("export", path, "--as", "abaqus", "--reports", tmp_path, "--json")
    lines = answer.json["text"].splitlines()
    values = [float(v) for v in lines[lines.index("*Hyperfoam, n=2") + 1].split(",")]
    assert len(values) == 6
    foam, F = Material("ogden-hill", CONSTANTS, poisson_ratio=poisson_ratio), states()
    ours = first_piola(foam, F)
    for k in range(F.shape[-1]):
        theirs = by_differences(lambda G: manual(values, G), F[..., k])
        assert ours[..., k] == pytest.approx(theirs, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("foam", [FOAM, RIGID])
def test_small_strain_is_hookes_law(foam):
    nu, mu = foam.poisson_ratio or 0.0, 0.04
    young = 2 * mu * (1 + nu)
    moduli = {
        "uniaxial": young,
        "equibiaxial": young / (1 - nu),
        "planar": young / (1 - nu**2),
        "confined": young * (1 - nu) / ((1 + nu) * (1 - 2 * nu)),
        "volumetric": young / (1 - 2 * nu),
    }
    e = 1e-7
    for name, modulus in moduli.items():
        assert LOADINGS[name].nominal(foam, np.array([1 + e])).stress[0] == pytest.approx(
            modulus * e, rel=1e-5
        )
    shear = LOADINGS["simple-shear"].nominal(foam, np.array([e])).stress[0]
    assert shear == pytest.approx(mu * e, rel=1e-5)
    assert foam.bulk == pytest.approx(young / (3 * (1 - 2 * nu)))


@pytest.mark.parametrize("foam", [FOAM, RIGID])
def test_uniaxial_stress_is_its_closed_form(foam):
    """One Poisson's ratio: l2 = l^-nu exactly, and P = sum 2 mu/alpha (l^a - J^-ab) / l."""
    nu = foam.poisson_ratio or 0.0
    stretch = np.linspace(0.3, 2.0, 9)
    found = response(foam, "uniaxial", stretch)
    assert found.free_stretch == pytest.approx(stretch**-nu, rel=1e-12)
    J, b = stretch ** (1 - 2 * nu), nu / (1 - 2 * nu)
    exact = sum(
        2 * CONSTANTS[f"mu{k}"] / a * (stretch**a - J ** (-a * b)) / stretch
        for k in (1, 2)
        for a in (CONSTANTS[f"alpha{k}"],)
    )
    assert found.stress == pytest.approx(exact, rel=1e-10, abs=1e-15)


@pytest.mark.parametrize("name", MODES)
def test_sides_are_free_in_every_mode(name):
    stretch = np.array([0.6, 0.9, 1.3])
    found = response(FOAM, name, stretch)
    mode = MODES[name]
    for k, one in enumerate(stretch):
        sides = one ** np.array(mode.loaded) * found.free_stretch[k] ** np.array(mode.free)
        P = first_piola(FOAM, np.diag(sides))
        assert P[0, 0] == pytest.approx(found.stress[k], rel=1e-9)
        if any(mode.free):
            assert abs(P[mode.free_axis, mode.free_axis]) < 1e-13


def test_stability_counts_the_volume():
    assert stability(FOAM, [0.5, 2.0]).stable
    # negative exponents alone give way in tension: H loses its sign with l^alpha
    soft = Material("ogden-hill", {"mu1": 0.05, "alpha1": 2.0, "mu2": -0.04, "alpha2": 8.0},
                    poisson_ratio=0.1)  # fmt: skip
    judged = stability(soft, [0.5, 2.0])
    assert not judged.stable
    limit = judged.limits["uniaxial"]
    assert limit > 1
    for side, wanted in ((limit * 0.99, True), (limit * 1.01, False)):
        free = float(response(soft, "uniaxial", [side]).free_stretch[0])
        sides, eye = np.array([[side], [free], [free]]), np.eye(3)
        foam = soft.compressible
        H = np.array(
            [
                foam.kirchhoff_slope(soft.constants, soft.compressibility, sides, u)[:, 0]
                for u in eye
            ]
        )
        assert bool(np.linalg.eigvalsh(H)[0] > 0) is wanted


def test_a_foam_is_solved_and_calibrated(tmp_path):
    """Constants of two terms come back from compression, shear and tension of the same foam."""
    stress = response(FOAM, "uniaxial", np.linspace(0.9, 0.5, 5)).stress
    solved = success("solve", problem(tmp_path), "--json").json
    assert solved["force_N"] == pytest.approx(-100 * stress)
    tests = ""
    for kind, loading, measure in (
        ("tension", "uniaxial", np.linspace(1, 1.6, 20)),
        ("compression", "uniaxial", np.linspace(1, 0.4, 20)),
        ("simple-shear", "simple-shear", np.linspace(0, 0.6, 20)),
    ):
        stress = 1e3 * LOADINGS[loading].nominal(FOAM, measure).stress
        column = "strain" if kind == "simple-shear" else "stretch"
        columns = {column: ("1", measure), "stress": ("kPa", stress)}
        sign = ', sign = "negative"' if kind == "compression" else ""
        tests += recorded(tmp_path, kind, f'kind = "{kind}"', columns, sign)
    head = gauge(f'model = "ogden-hill"\norder = 2\npoisson_ratio = {NU}')
    found = api.calibrate(case_file(tmp_path, head, tests), data=tmp_path)
    assert found.converged, found.message
    assert found.fit.constants() == pytest.approx(CONSTANTS, rel=1e-6)
