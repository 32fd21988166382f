"""General biaxial tests: two stretches and two stresses in every row."""

import numpy as np
import pytest

import study
from study.ground.errors import InputError
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material
from tests.cli.small import case_file, gauge, recorded
from tests.material.modes import equibiaxial, uniaxial

C10, C01 = 0.02, 0.005
SIZE = 'area = "10 mm^2"\nlength = "20 mm"\n'


def stress(one, other):
    """Nominal stress of an incompressible Mooney-Rivlin sheet (Treloar 1975, eq. 5.28), MPa."""
    thickness = 1 / (one * other)
    return 2 * (one**2 - thickness**2) * (C10 + C01 * other**2) / one


def calibrated(folder, stretches, stresses, material='model = "mooney-rivlin"', volume="", **more):
    """Calibration by rows of two stretches and two stresses, kPa."""
    columns = {f"stretch_{k}": ("1", one) for k, one in enumerate(stretches, 1)}
    columns |= {f"stress_{k}": ("kPa", one) for k, one in enumerate(stresses, 1)}
    head = gauge(f"{material}\n{volume or 'incompressible = true'}", SIZE)
    path = case_file(folder, head, recorded(folder, "b", 'kind = "biaxial"', columns))
    return study.calibrate(path, data=folder, **more)


def exact(one, other):
    """Stretches and their stresses, kPa."""
    return (one, other), (1e3 * stress(one, other), 1e3 * stress(other, one))


def drawn(rows, seed):
    """Stretches from 1 on, in no order."""
    random = np.random.default_rng(seed)
    return [np.r_[1.0, random.uniform(0.8, 1.6, rows)] for _ in range(2)]


def test_constants_come_back_from_both_directions(tmp_path):
    rows = exact(*drawn(30, 3))
    found = calibrated(tmp_path, *rows, results=tmp_path / "results")
    assert found.fit.values == pytest.approx([C10, C01], rel=1e-6)
    document = found.to_json()
    assert document["n"] == 62
    assert document["rows"] == {"read": 31, "used": 31, "set_aside": []}
    assert document["curves"][0]["r_squared"] == pytest.approx(1.0, abs=1e-9)
    assert (tmp_path / "results/case/recording.svg").exists()
    # a finite bulk modulus moves them little
    soft = calibrated(tmp_path, *rows, volume="poisson_ratio = 0.4999")
    assert soft.fit.values == pytest.approx([C10, C01], rel=2e-3)


def test_other_columns_are_refused(tmp_path):
    columns = {"displacement": ("mm", range(4)), "force": ("N", range(4))}
    test = recorded(tmp_path, "b", 'kind = "biaxial"', columns)
    head = gauge('model = "neo-hookean"\nincompressible = true', SIZE)
    with pytest.raises(InputError, match="stretch_1, stretch_2, stress_1 and stress_2"):
        study.calibrate(case_file(tmp_path, head, test), data=tmp_path)


@pytest.mark.parametrize("volume", [{"incompressible": True}, {"poisson_ratio": 0.45}])
@pytest.mark.parametrize("model", ["mooney-rivlin", "ogden"])
def test_limits_and_slopes_of_the_closed_form(model, volume):
    constants = (
        {"C10": C10, "C01": C01} if model == "mooney-rivlin" else {"mu1": 0.03, "alpha1": -4.0}
    )
    made = Material(model, constants, **volume)
    nominal = LOADINGS["biaxial"].nominal
    stretch = np.array([0.8, 1.3, 1.9])
    both = nominal(made, np.r_[stretch, stretch]).stress
    assert both == pytest.approx(np.tile(equibiaxial(made, stretch), 2), rel=1e-9)
    if made.incompressible:  # the free direction of a uniaxial test carries nothing
        pair = nominal(made, np.r_[stretch, stretch**-0.5]).stress
        assert pair[:3] == pytest.approx(uniaxial(made, stretch), rel=1e-9)
        assert pair[3:] == pytest.approx(0.0, abs=1e-12)
    rows, h = np.r_[1.2, 0.9, 1.5, 1.1], 1e-6
    slopes = nominal(made, rows).gradient
    for name, value in constants.items():
        ends = [
            nominal(Material(model, {**constants, name: value * f}, **volume), rows).stress
            for f in (1 + h, 1 - h)
        ]
        assert slopes[name] == pytest.approx((ends[0] - ends[1]) / (2 * h * value), rel=1e-5)


def test_an_odd_number_of_stretches_is_no_biaxial_test():
    with pytest.raises(InputError, match="as many of each"):
        LOADINGS["biaxial"].nominal(
            Material("neo-hookean", {"C10": 1.0}, incompressible=True), np.ones(3)
        )


NOISE = 0.25  # kPa, .5 % of the largest stress


@pytest.mark.parametrize("order", ["random", "ratios"])
def test_a_misfit_is_seen_in_any_order_of_the_rows(tmp_path, order):
    """Exchanged columns, and an energy that lacks C01, in rows whose neighbors are far apart."""
    random = np.random.default_rng(11)
    one, other = drawn(59, 11)
    if order == "ratios":
        ratios = np.array([(1, 1), (1, 0.75), (1, 0.5), (0.75, 1), (0.5, 1)]).T
        one, other = (1 + np.outer(r, np.linspace(0, 0.6, 12)).ravel() for r in ratios)
    stretches, stresses = exact(one, other)
    read = [each + NOISE * random.normal(size=60) for each in stresses]
    for wrong in (
        calibrated(tmp_path, stretches, read[::-1]),
        calibrated(tmp_path, stretches, read, 'model = "neo-hookean"'),
    ):
        assert wrong.to_json()["fit"]["verdict"] != "describes"
    right = calibrated(tmp_path, stretches, read).to_json()
    assert right["fit"]["verdict"] == "describes"
    low, high = right["parameters"]["C10"]["ci95"]
    assert low <= 1e3 * C10 <= high
