"""``study require``: uncertainty by sensors, what they must be, and where first order holds."""

import re
from pathlib import Path

import numpy as np
import pytest

import study as package
from tests.cli.small import pressed, study, success

RADIUS_MM = 10.0
HEIGHT_MM = 10.0
DEPTH_MM = 2.0
POINTS = 50
C10_MPA = 0.01
PLATES = pressed(
    """[material]
model = "neo-hookean"
C10 = "10 kPa"
incompressible = true
[position]
offset = "0.02 mm"
scale = "0.5 %"
noise = "0.05 mm"
[force]
zero = "0.02 N"
scale = "1 %"
noise = "0.02 N"
[requirement]
points = 50
samples = 0
""",
    study='[study]\nname = "plates"\nseed = 3\n',
    height=10,
    test='displacement = "2 mm"\n',
)
ERRORS = {
    "position.offset": 0.02,
    "position.scale": 0.005,
    "position.noise": 0.05,
    "force.zero": 0.02,
    "force.scale": 0.01,
    "force.noise": 0.02,
}


def shape(displacement_mm):
    """Force over C10 between frictionless plates, mm^2: 2 A (1/l^2 - l)."""
    stretch = 1 - displacement_mm / HEIGHT_MM
    return np.asarray(2 * np.pi * RADIUS_MM**2 * (stretch**-2 - stretch))


def shape_slope(displacement_mm):
    """Its derivative by the displacement, mm."""
    stretch = 1 - displacement_mm / HEIGHT_MM
    return np.asarray(2 * np.pi * RADIUS_MM**2 * (2 * stretch**-3 + 1) / HEIGHT_MM)


def known_parts():
    """dC10/C10 by every error: C10 is the sum of s F over that of s^2, with s the shape."""
    d = DEPTH_MM * np.arange(1, POINTS + 1) / POINTS
    s, slope = shape(d), shape_slope(d)
    square = float(s @ s)
    return {
        "position.offset": 0.02 * float(s @ slope) / square,
        "position.scale": 0.005 * float(s @ (slope * d)) / square,
        "position.noise": 0.05 * float(np.linalg.norm(s * slope)) / square,
        "force.zero": 0.02 * float(s.sum()) / square / C10_MPA,
        "force.scale": 0.01,
        "force.noise": 0.02 / np.sqrt(square) / C10_MPA,
    }


def asked(folder, text=PLATES, *settings):
    (folder / "plates.toml").write_text(text)
    overrides = [part for setting in settings for part in ("-s", setting)]
    out = str(folder / "reports")
    return success(
        "require", str(folder / "plates.toml"), "--json", "--reports", out, *overrides
    ).json


def named(document, name):
    return next(one for one in document["quantities"] if one["name"] == name)


@pytest.mark.usefixtures("undrawn")
def test_every_error_does_what_the_closed_form_says(tmp_path):
    found = asked(tmp_path)
    parts = known_parts()
    c10, force = named(found, "C10"), named(found, "force")
    assert c10["parts"] == pytest.approx(parts, rel=1e-9)
    together = np.sqrt(sum(part**2 for part in parts.values()))
    assert c10["relative_standard_uncertainty"] == pytest.approx(together, rel=1e-9)
    assert c10["relative_expanded_uncertainty"] == pytest.approx(2 * together, rel=1e-9)
    # the force is in proportion to C10
    assert force["value"] == pytest.approx(C10_MPA * float(shape(np.array(DEPTH_MM))), rel=1e-9)
    assert force["relative_standard_uncertainty"] == pytest.approx(together, rel=1e-9)


@pytest.mark.usefixtures("undrawn")
def test_tests_simulated_by_hand_scatter_so(tmp_path):
    """20,000 tests, each fitted by its one-line least squares, without any gradient."""
    n, random = 20_000, np.random.default_rng(8)
    d = DEPTH_MM * np.arange(1, POINTS + 1) / POINTS
    force, draw = C10_MPA * shape(d), random.standard_normal
    told = d * (1 + 0.005 * draw((n, 1))) + 0.02 * draw((n, 1)) + 0.05 * draw((n, POINTS))
    felt = force * (1 + 0.01 * draw((n, 1))) + 0.02 * draw((n, 1)) + 0.02 * draw((n, POINTS))
    s = np.where(told >= 0, shape(told), 0.0)
    fitted = (s * felt).sum(axis=1) / (s * s).sum(axis=1)
    found = asked(tmp_path)
    first_order = C10_MPA * named(found, "C10")["relative_standard_uncertainty"]
    # a standard deviation of 20,000 tests is known to 0.5 %
    assert fitted.std(ddof=1) == pytest.approx(first_order, rel=0.05)
    simulated = asked(tmp_path, PLATES, "requirement.samples=400", "requirement.multiples=[1]")
    (one,) = simulated["monte_carlo"]
    scatter = one["quantities"][0]
    assert one["linear"] is True
    assert one["failed"] == 0
    assert scatter["standard_deviation"] / 1e3 == pytest.approx(fitted.std(ddof=1), rel=0.02)
    # noise of the position makes a soft fit: what is told has more curvature than is there
    shift = (fitted.mean() - C10_MPA) / fitted.std(ddof=1)
    assert scatter["bias"] == pytest.approx(shift, abs=0.03)
    assert shift < -0.05


@pytest.mark.usefixtures("undrawn")
def test_errors_of_the_force_alone_are_exactly_linear(tmp_path):
    none = ['position.offset="0 mm"', 'position.scale="0 %"', 'position.noise="0 mm"']
    found = asked(tmp_path, PLATES, *none, "requirement.samples=50", "requirement.multiples=[1,10]")
    for one in found["monte_carlo"]:
        for quantity in one["quantities"]:
            assert quantity["ratio"] == pytest.approx(1.0, abs=1e-6)
            assert quantity["bias"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.usefixtures("undrawn")
def test_what_is_allowed_is_just_enough(tmp_path):
    found, parts = asked(tmp_path), known_parts()
    allowed = {}
    for row in found["required"]:
        key = f"{row['sensor']}.{row['error']}"
        # in proportion: alone an error makes 5 % where its part is 2.5 %
        alone = ERRORS[key] * 0.025 / parts[key]
        assert row["allowed_alone"] == pytest.approx(alone, rel=1e-9)
        others = sum(part**2 for name, part in parts.items() if name != key)
        allowed[key] = row["allowed_beside_the_others"]
        beside = ERRORS[key] * np.sqrt(0.025**2 - others) / parts[key]
        assert allowed[key] == pytest.approx(beside, rel=1e-9)
    again = asked(tmp_path, PLATES, f'position.noise="{allowed["position.noise"]!r} mm"')
    assert named(again, "C10")["relative_expanded_uncertainty"] == pytest.approx(0.05, rel=1e-9)
    nothing = asked(tmp_path, PLATES, 'position.offset="0.5 mm"')
    assert nothing["met"] is False
    rows = {f"{row['sensor']}.{row['error']}": row for row in nothing["required"]}
    assert rows["force.noise"]["allowed_beside_the_others"] is None
    assert rows["position.offset"]["allowed_beside_the_others"] < 0.5
    times = found["needed_multiple"]
    assert times * named(found, "C10")["relative_expanded_uncertainty"] == pytest.approx(0.05)
    assert found["met"] is (times >= 1)


@pytest.mark.usefixtures("undrawn")
def test_where_first_order_fails_it_says_so(tmp_path):
    found = asked(
        tmp_path, PLATES, 'position.noise="0.4 mm"', "requirement.samples=100",
        "requirement.multiples=[1]",
    )  # fmt: skip
    (one,) = found["monte_carlo"]
    assert one["linear"] is False
    assert any("first order does not hold" in line for line in found["sentences"])
    assert "first order does not hold" in found["warnings"][0]
    assert "take scatter and shift" in Path(found["report"]).read_text()


@pytest.mark.usefixtures("undrawn")
def test_a_force_is_predicted_in_another_test(tmp_path):
    other = '[predict.test]\nkind = "compression"\ninterface = "frictionless"\n'
    wider = '[predict.specimen]\nshape = "cylinder"\nradius = "20 mm"\nheight = "10 mm"\n'
    found = asked(tmp_path, f'{PLATES}{other}displacement = "1 mm"\n{wider}')
    # four times the area, half the depth
    expected = 4 * C10_MPA * float(shape(np.array(1.0)))
    force, c10 = named(found, "force"), named(found, "C10")
    assert force["value"] == pytest.approx(expected, rel=1e-9)
    assert force["parts"] == pytest.approx(c10["parts"], rel=1e-9)


BONDED = (
    PLATES[: PLATES.index("[position]")]
    .replace('[study]\nname = "plates"\nseed = 3\n', "")
    .replace('"frictionless"\ndisplacement = "2 mm"', '"bonded"\ndisplacement = "1 mm"\nsteps = 4')
    .replace("incompressible = true", 'poisson_ratio = 0.4995\n[model]\nmesh = "coarse"')
    + PLATES[PLATES.index("[force]") : PLATES.index("points = 50")]
    + "points = 20\nsamples = 10\nmultiples = [1]\n"
)


@pytest.mark.usefixtures("undrawn")
def test_finite_elements_in_processes(tmp_path):
    """The force is in proportion to C10, so that the fit is linear: s F over s^2 once more."""
    found = asked(tmp_path, BONDED)
    # the same problem without what only `require` knows
    (tmp_path / "problem.toml").write_text(BONDED[: BONDED.index("[force]")])
    solved = package.solve(tmp_path / "problem.toml", overrides=["test.steps=20"]).curve
    s = solved.force_gradient["C10"]
    known = {
        "force.zero": 0.02 * s.sum() / (s @ s) / C10_MPA,
        "force.scale": 0.01,
        "force.noise": 0.02 / np.sqrt(s @ s) / C10_MPA,
    }
    parts = named(found, "C10")["parts"]
    # 4 steps, interpolated at 20 rows
    assert {name: parts[name] for name in known} == pytest.approx(known, rel=1e-4)
    (one,) = found["monte_carlo"]
    assert one["failed"] == 0
    for quantity in one["quantities"]:
        # a fit ends where its next step is a thousandth of the scatter
        assert quantity["ratio"] == pytest.approx(1.0, abs=1e-3)


def test_the_page_needs_no_network_and_shows_the_map(tmp_path):
    """The seed decides the simulated tests, and nothing else does."""
    wanted = ("requirement.samples=60", "requirement.multiples=[1]")
    again, other, found = (
        asked(tmp_path, PLATES, *wanted, f"study.seed={seed}") for seed in (3, 4, 3)
    )
    assert found["monte_carlo"] == again["monte_carlo"]
    assert found["monte_carlo"] != other["monte_carlo"]
    page = Path(found["report"]).read_text()
    assert page.count("<svg") == 2
    assert "Figure missing" not in page
    assert "Simulated tests" in page
    assert not re.search(r"(?:src|href)=\"https?:", page)
    assert found["sentences"][0] in page
    beside = Path(found["report"]).with_name("plates-requirement-data")
    rows = (beside / "figure-requirement-map.csv").read_text().splitlines()
    as_given = next(row for row in rows if row.startswith("1.0,1.0,"))
    percent = 100 * named(found, "C10")["relative_expanded_uncertainty"]
    assert float(as_given.split(",")[2]) == pytest.approx(percent, rel=1e-9)
    words = success("require", tmp_path / "plates.toml", "--reports", tmp_path / "words").out
    assert "is met" in words
    alone = 0.02 * 0.025 / known_parts()["position.offset"]
    assert f"{alone:.3g} mm" in words


def test_constants_that_no_sensor_tells_apart_are_refused(tmp_path):
    """Two terms with one exponent: only their sum is in the force."""
    twins = 'model = "ogden"\nmu = ["10 kPa", "10 kPa"]\nalpha = [2.0, 2.0]'
    text = PLATES.replace('model = "neo-hookean"\nC10 = "10 kPa"', twins)
    (tmp_path / "plates.toml").write_text(text)
    answer = study("require", str(tmp_path / "plates.toml"), "--reports", str(tmp_path / "r"))
    assert answer.code == 3
    assert "no accuracy of a sensor tells them apart" in answer.err
    assert not (tmp_path / "r").exists()
