"""``study calibrate --energies`` weighs foams where Poisson's ratio lets sides be free."""

import numpy as np
import pytest

from study.api.calibrating import choose_energy
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material
from tests.cli.small import case_file, gauge, recorded
from tests.fem.problems import long_verification


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
