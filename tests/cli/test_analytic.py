"""``study calibrate --method analytic``: moduli of small indentations in closed form."""

import json
from pathlib import Path

import numpy as np
import pytest

from study import api
from study.ground.errors import InputError
from tests.cli.small import study, success

#: files are written into the working folder
pytestmark = pytest.mark.usefixtures("inside")

TRUTH_KPA = 6.0
PARABOLOID = 'profile = "paraboloid"'

SPHERE = '{ shape = "sphere", radius = "5 mm" }'
FILE = """
schema = 1
[specimen]
shape = "cylinder"
radius = "{radius} mm"
height = "{height} mm"
[material]
model = "neo-hookean"
{volume}
[calibration]
method = "analytic"
{options}
[[tests]]
test = {{ kind = "indentation", interface = "frictionless", base = "{base}", displacement = "{depth} mm", indenter = {indenter} }}
[tests.measurements]
{files}
columns = {{ displacement = "d", force = "f" }}
units = {{ displacement = "mm", force = "mN" }}
"""  # noqa: E501


def text(
    indenter=SPHERE,
    *,
    files='file = "curves.csv"\nblock = "curve"',
    options="",
    volume="incompressible = true",
    radius=60,
    height=20,
    depth=0.5,
    base="bonded",
):
    return FILE.format(
        indenter=indenter, files=files, options=options, volume=volume, radius=radius,
        height=height, depth=depth, base=base,
    )  # fmt: skip


def calibrated(design, lines, head="curve,d,f"):
    """Calibrate with the rows of a table in the working folder."""
    Path("file.toml").write_text(design)
    Path("curves.csv").write_text("\n".join([head, *lines]))
    return study("calibrate", "file.toml", "--json")


def rows(label, depth, force_mN):
    return [f"{label},{d:.6g},{f:.8g}" for d, f in zip(depth, force_mN, strict=True)]


def sphere_mN(depth, height):
    """Hertz's paraboloid of 5 mm at 1 kPa, times what the bonded incompressible layer adds.

    That is known within .15 % to chi = .3 (Garcia and Garcia 2018).
    """
    chi = np.sqrt(5 * depth) / height
    added = 1 + 1.133 * chi + 1.497 * chi**2 + 1.469 * chi**3 + 0.755 * chi**4
    return 16 / 9 * 5**0.5 * depth**1.5 * added


PROBLEM = """
schema = 1
[specimen]
shape = "cylinder"
radius = "60 mm"
height = "50 mm"
[material]
model = "neo-hookean"
C10 = "1 kPa"
poisson_ratio = 0.4999
[model]
mesh = "medium"
[test]
kind = "indentation"
interface = "frictionless"
base = "bonded"
displacement = "0.25 mm"
steps = 8
indenter = { shape = "sphere", radius = "5 mm" }
"""

# forces at E = 1 kPa, written down from the textbook
TEXTBOOK = {
    "sphere": (SPHERE, lambda d: sphere_mN(d, 20)),
    # kappa of a/h = 2/20 is 1.12599 at nu = 0.5 (validation of the layer's integral equation)
    "flat": ('{ shape = "flat", radius = "2 mm" }', lambda d: 2 * 2 * d / 0.75 * 1.12599),
    # Sneddon and Love, with the first terms of the layer's series in x = d tan/h
    "cone": (
        '{ shape = "cone", half_angle = "75 deg" }',
        lambda d: (
            2 / np.pi / 0.75 * np.tan(np.radians(75)) * d**2
            * (1 + 0.7174 * d * np.tan(np.radians(75)) / 20
               + 0.73 * (d * np.tan(np.radians(75)) / 20) ** 2)
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", TEXTBOOK)
def test_formulas_with_noise_give_the_modulus_back(kind, inside):
    """Twenty curves with 2 % of noise; the interval of the median holds the truth."""
    indenter, force = TEXTBOOK[kind]
    rng, lines = np.random.default_rng(5), list[str]()
    depth = np.linspace(0.005, 0.25, 50)
    for k in range(20):
        clean = TRUTH_KPA * force(depth)
        lines += rows(f"c{k}", depth, clean + 0.02 * clean[-1] * rng.normal(size=50))
    design = text(indenter, options=PARABOLOID, depth=0.25)
    answer = calibrated(design, lines)
    assert answer.code == 0, answer.err
    (test,) = answer.json["tests"]
    low, high = test["youngs_modulus"]["ci95_kPa"]
    assert low <= TRUTH_KPA <= high
    assert high - low < 0.02 * TRUTH_KPA
    assert test["shear_modulus"]["median_kPa"] == pytest.approx(
        test["youngs_modulus"]["median_kPa"] / 3
    )
    holds = [c["ci95_kPa"][0] <= TRUTH_KPA <= c["ci95_kPa"][1] for c in test["curves"]]
    assert sum(holds) >= 17
    assert (test["rows"], test["rows_outside"]) == (1000, 0)
    assert answer.err == ""
    kept = json.loads((inside / "results" / "file" / "analytic.json").read_text())
    assert kept["tests"] == answer.json["tests"]
    table = (inside / "results" / "file" / "moduli.csv").read_text().splitlines()
    assert len(table) == 21
    assert table[1].startswith("0,curves.csv: curve = c0,fitted,")


CONE = '{ shape = "cone", half_angle = "60 deg", tip_radius = "0.5 mm" }'
#: what the file says, what else the simulation is told, its modulus, and how near that is
SIMULATED = {
    "a neo-Hookean block of 10 radii": (
        text(volume="poisson_ratio = 0.4999", height=50, depth=0.25), {},
        4 * 1.4999, 0.03, "",  # E = 2 mu (1 + nu) with mu = 2 C10
    ),
    "a rounded cone on a layer on oil": (
        text(CONE, volume="poisson_ratio = 0.3", height=4, depth=0.3, base="frictionless"),
        {'"50 mm"': '"4 mm"', "0.4999": "0.3", '"neo-hookean"': '"linear-elastic"',
         'C10 = "1 kPa"': 'youngs_modulus = "6 kPa"', '"bonded"': '"frictionless"',
         '"0.25 mm"': '"0.3 mm"', SPHERE: CONE, "medium": "fine"},
        TRUTH_KPA, 5e-3, "strains by the same amount at any depth",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", SIMULATED)
def test_the_modulus_of_a_simulated_indentation(inside, kind):
    design, changes, modulus, near, warned = SIMULATED[kind]
    problem = PROBLEM
    for old, new in changes.items():
        problem = problem.replace(old, new)
    (inside / "problem.toml").write_text(problem)
    found = api.solve("problem.toml")
    assert found.status == "converged"
    answer = calibrated(design, rows("s", found.curve.displacement_mm, 1e3 * found.curve.force_N))
    estimate = answer.json["tests"][0]["youngs_modulus"]["median_kPa"]
    assert estimate == pytest.approx(modulus, rel=near)
    assert warned in answer.err


def test_rows_beyond_the_limit_of_depth_are_left_out_and_a_limit_that_is_lifted_is_said():
    """Forces tripled beyond 0.8 mm change nothing."""
    depth = np.linspace(0.01, 1.0, 100)
    force = TRUTH_KPA * sphere_mN(depth, 60)
    force[depth > 0.8 + 1e-9] *= 3
    lines = rows("a", depth, force)
    limited = calibrated(text(options=PARABOLOID, height=60, depth=1.0), lines)
    assert "50 % of the rows in contact (50 of 100) lie deeper than 0.5 mm (d/R <= 0.1)" in (
        " ".join(limited.err.split())
    )
    words = success("calibrate", "file.toml").out
    assert "6.00" in words
    assert "it knows nothing of the scatter between curves" in words
    options = f'{PARABOLOID}\ndepth_limit = "0.8 mm"'
    lifted = calibrated(text(options=options, height=60, depth=1.0), lines)
    for answer, outside in ((limited, 50), (lifted, 20)):
        (test,) = answer.json["tests"]
        assert test["rows_outside"] == outside
        assert test["youngs_modulus"]["median_kPa"] == pytest.approx(TRUTH_KPA, rel=2e-3)
    assert test["limits"][0] == {"limit": "calibration.depth_limit", "depth_mm": 0.8}
    assert "lifts the limit from 0.5 to 0.8 mm" in lifted.err
    assert "d/R <= 0.1" in lifted.err


def test_many_curves(inside):
    """A folder of 200 curves with their contacts: the median is that of the truth."""
    (inside / "curves").mkdir()
    files, options = 'files = "curves/{curve}.csv"', f'contact = "fitted"\n{PARABOLOID}'
    rng, depth = np.random.default_rng(2), np.linspace(0.0, 0.5, 60)
    moduli = TRUTH_KPA * np.exp(0.2 * rng.normal(size=200))
    contacts = rng.uniform(0, 0.1, size=200)
    for k, (modulus, contact) in enumerate(zip(moduli, contacts, strict=True)):
        clean = modulus * sphere_mN(np.maximum(depth - contact, 0), 20)
        lines = [
            f"{d:.6g},{f:.8g}" for d, f in zip(depth, clean + rng.normal(size=60) * 0.05,
                                               strict=True)
        ]  # fmt: skip
        (inside / "curves" / f"{k}.csv").write_text("\n".join(["d,f", *lines]))
    answer = calibrated(text(files=files, options=options, depth=0.6), [])
    (test,) = answer.json["tests"]
    assert test["curves_fitted"] == 200
    # the scatter of the fits is far below that between curves
    assert test["youngs_modulus"]["median_kPa"] == pytest.approx(np.median(moduli), rel=0.01)
    found = {int(c["groups"]["curve"]): c["contact_mm"] for c in test["curves"]}
    assert np.median([abs(found[k] - c) for k, c in enumerate(contacts)]) < 2e-3


def test_curves_of_one_specimen_are_repeats(inside):
    """Six specimens of 3 curves each: the interval is that of six medians."""
    files = 'file = "curves.csv"\nblock = "specimen"\naverage = ["site"]'
    depth, lines = np.linspace(0.01, 0.5, 30), list[str]()
    for k in range(6):
        for site, factor in enumerate((0.9, 1.0, 1.3)):
            lines += rows(f"s{k},{site}", depth, (k + 1) * factor * sphere_mN(depth, 20))
    answer = calibrated(text(files=files, options=PARABOLOID), lines, "specimen,site,d,f")
    estimate = answer.json["tests"][0]["youngs_modulus"]
    assert estimate["units"] == 6
    assert estimate["ci95_kPa"] == pytest.approx([1.0, 6.0], rel=2e-3)
    assert estimate["median_kPa"] == pytest.approx(3.5, rel=2e-3)


def test_no_row_within_the_range_is_no_answer():
    depth = np.linspace(0.01, 0.4, 40)
    answer = calibrated(text(height=2, radius=3), rows("a", depth, depth))
    assert answer.code == 1
    (test,) = answer.json["tests"]
    assert test["youngs_modulus"] is None
    assert test["curves"][0]["status"] == "outside"
    assert test["limits"][0]["limit"].startswith("shortening of the whole specimen")


def test_published_series_says_how_far_it_is_off(inside):
    """At chi = 0.48694 the layer's table has 2.10558 times Hertz, the series 1.9393 times."""
    design = text(SPHERE.replace('"5 mm"', '"50 mm"'), radius=100, height=6.25, depth=0.2,
                  options=f'theory = "dimitriadis"\n{PARABOLOID}')  # fmt: skip
    depth = np.linspace(0.01, (0.48694 * 6.25) ** 2 / 50, 30)
    answer = calibrated(design, rows("a", depth, depth**1.5))
    assert f"{100 * (2.10558 / 1.9393 - 1):+.1f} %" in answer.err
    assert "integral-equation" in answer.err


def test_one_bad_curve_does_not_stop_the_others(inside):
    depth = np.linspace(0.01, 0.5, 30)
    good = rows("good", depth, TRUTH_KPA * sphere_mN(depth, 20))
    answer = calibrated(text(options=PARABOLOID), [*good, *rows("flat", depth, np.ones(30))])
    assert answer.code == 0
    with pytest.raises(InputError, match=r"study\.indentation_modulus"):
        api.calibrate("file.toml")
    assert [c["status"] for c in answer.json["tests"][0]["curves"]] == ["fitted", "unreadable"]
    assert "1 of 2 curves are unreadable" in answer.err
    assert "the force is constant" in answer.err
