"""General biaxial tests: two stretches and two stresses in every row."""

import numpy as np
import pytest

import study
from study.ground.errors import InputError
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material
from tests.material.modes import equibiaxial, uniaxial

C10, C01 = 0.02, 0.005
TABLE = """measurements = { file = "b.csv", columns = { stretch_1 = "l1", stretch_2 = "l2", \
stress_1 = "P1", stress_2 = "P2" }, units = { stretch_1 = "1", stretch_2 = "1", \
stress_1 = "kPa", stress_2 = "kPa" } }"""


def stress(one, other):
    """Nominal stress of an incompressible Mooney-Rivlin sheet (Treloar 1975, eq. 5.28), MPa."""
    thickness = 1 / (one * other)
    return 2 * (one**2 - thickness**2) * (C10 + C01 * other**2) / one


def calibration(folder, changed=("", ""), compressibility=""):
    random = np.random.default_rng(3)
    one, other = (np.r_[1.0, random.uniform(0.8, 1.6, 30)] for _ in range(2))
    rows = zip(one, other, 1e3 * stress(one, other), 1e3 * stress(other, one), strict=True)
    text = "".join(",".join(f"{v:.9f}" for v in row) + "\n" for row in rows)
    (folder / "b.csv").write_text("l1,l2,P1,P2\n" + text)
    (folder / "c.toml").write_text(
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "10 mm^2"\nlength = "20 mm"\n'
        f'[material]\nmodel = "mooney-rivlin"\n{compressibility or "incompressible = true"}\n'
        '[[tests]]\ntest = { kind = "biaxial" }\n' + TABLE.replace(*changed)
    )
    return study.calibrate(folder / "c.toml", data=folder, results=folder / "results")


def test_constants_come_back_from_both_directions(tmp_path):
    found = calibration(tmp_path)
    assert found.fit.values == pytest.approx([C10, C01], rel=1e-6)
    document = found.to_json()
    assert document["n"] == 62
    assert document["rows"] == {"read": 31, "used": 31, "set_aside": []}
    assert document["curves"][0]["r_squared"] == pytest.approx(1.0, abs=1e-9)
    assert (tmp_path / "results/c/recording.svg").exists()


def test_a_finite_bulk_modulus_moves_them_little(tmp_path):
    found = calibration(tmp_path, compressibility="poisson_ratio = 0.4999")
    assert found.fit.values == pytest.approx([C10, C01], rel=2e-3)


def test_other_columns_are_refused(tmp_path):
    (tmp_path / "b.csv").write_text("d,f\n0,0\n1,1\n2,2\n3,3\n")
    (tmp_path / "c.toml").write_text(
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "10 mm^2"\nlength = "20 mm"\n'
        '[material]\nmodel = "neo-hookean"\nincompressible = true\n'
        '[[tests]]\ntest = { kind = "biaxial" }\nmeasurements = { file = "b.csv", '
        'columns = { displacement = "d", force = "f" }, '
        'units = { displacement = "mm", force = "N" } }'
    )
    with pytest.raises(InputError, match="stretch_1, stretch_2, stress_1 and stress_2"):
        study.calibrate(tmp_path / "c.toml", data=tmp_path)


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
COLUMNS = 'stress_1 = "P1", stress_2 = "P2"'


def noisy(folder, order, changed=("", "")):
    """Calibrate 60 rows: of stretches drawn at random, or of five ratios one after the other."""
    random = np.random.default_rng(11)
    if order == "random":
        one, other = (np.r_[1.0, random.uniform(0.8, 1.6, 59)] for _ in range(2))
    else:
        way = np.linspace(0, 0.6, 12)
        ratios = ((1, 1), (1, 0.75), (1, 0.5), (0.75, 1), (0.5, 1))
        one, other = (np.concatenate([1 + r[k] * way for r in ratios]) for k in (0, 1))
    forces = [
        1e3 * s + NOISE * random.normal(size=60) for s in (stress(one, other), stress(other, one))
    ]
    rows = zip(one, other, *forces, strict=True)
    text = "".join(",".join(f"{v:.9f}" for v in row) + "\n" for row in rows)
    (folder / "b.csv").write_text("l1,l2,P1,P2\n" + text)
    (folder / "c.toml").write_text(
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "10 mm^2"\nlength = "20 mm"\n'
        '[material]\nmodel = "mooney-rivlin"\nincompressible = true\n'.replace(*changed)
        + '[[tests]]\ntest = { kind = "biaxial" }\n'
        + TABLE.replace(*changed)
    )
    return study.calibrate(folder / "c.toml", data=folder)


@pytest.mark.parametrize("order", ["random", "ratios"])
@pytest.mark.parametrize(
    "changed",
    [
        (COLUMNS, 'stress_1 = "P2", stress_2 = "P1"'),
        ("mooney-rivlin", "neo-hookean"),
    ],
)
def test_a_misfit_is_seen_in_any_order_of_the_rows(tmp_path, order, changed):
    """Exchanged columns, and an energy that lacks C01, in rows whose neighbors are far apart."""
    document = noisy(tmp_path, order, changed).to_json()
    assert document["fit"]["verdict"] != "describes"
    right = noisy(tmp_path, order).to_json()
    assert right["fit"]["verdict"] == "describes"
    low, high = right["parameters"]["C10"]["ci95"]
    assert low <= 1e3 * C10 <= high
