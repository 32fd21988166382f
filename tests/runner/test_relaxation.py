"""Relaxation through the verbs: solved, calibrated from courses in time, a speed as a factor."""

import numpy as np
import pytest

from study import api
from study.ground.errors import InputError
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import RelaxationTerm
from study.mechanics.material.viscoelasticity import relaxing
from tests.cli.small import CSV, case_file, gauge, recorded, responses, study, success

SERIES = (RelaxationTerm(0.3, 1.0), RelaxationTerm(0.2, 20.0))
GEL = Material("neo-hookean", {"C10": 0.02}, poisson_ratio=0.49, relaxation=SERIES)
#: ramp of one second and a hold of 100 s
TIME = np.r_[np.linspace(0, 1, 11), 1 + np.geomspace(0.05, 100, 39)]
STRETCH = 1 + 0.4 * np.minimum(TIME, 1.0)
NEO_HOOKEAN = 'model = "neo-hookean"\npoisson_ratio = 0.49\n'
ONE_TERM = NEO_HOOKEAN + 'relaxation = [{ time = "1 s" }]'


def course(folder, name, loading, measure, material, noise=0.0, seed=0):
    """Table of a test whose rows have times."""
    exact = 1e3 * relaxing(material, loading, TIME, measure).stress
    rng = np.random.default_rng(seed)
    stress = exact + noise * np.abs(exact).max() * rng.standard_normal(exact.size)
    column = "strain" if loading == "simple-shear" else "stretch"
    columns = {"time": ("s", TIME), column: ("1", measure), "stress": ("kPa", stress)}
    kind = "tension" if loading == "uniaxial" else loading
    return recorded(folder, name, f'kind = "{kind}"', columns)


def calibration(folder, material, tests):
    return case_file(folder, gauge(material), tests)


@pytest.mark.drawings
def test_constants_shares_and_times_come_back_through_the_command(tmp_path):
    tests = course(tmp_path, "pulled", "uniaxial", STRETCH, GEL)
    tests += course(tmp_path, "sheared", "simple-shear", STRETCH - 1, GEL)
    series = 'relaxation = [{ time = ["0.2 s", "5 s"] }, { time = ["5 s", "100 s"] }]'
    path = calibration(tmp_path, NEO_HOOKEAN + series, tests)
    answer = success("calibrate", str(path), "--data", str(tmp_path), "--json")
    found = answer.json
    assert found["status"] == "converged"
    values = {name: one["value"] for name, one in found["parameters"].items()}
    expected = {"C10": 20.0, "share1": 0.3, "time1": 1.0, "share2": 0.2, "time2": 20.0}
    assert values == pytest.approx(expected, rel=1e-5)
    assert found["parameters"]["time1"]["unit"] == "s"
    assert found["parameters"]["share1"]["unit"] == ""
    assert found["shear_moduli"]["instantaneous"] == pytest.approx(40.0, rel=1e-5)
    assert found["shear_moduli"]["long_term"] == pytest.approx(20.0, rel=1e-5)
    text = study("calibrate", str(path), "--data", str(tmp_path), "--results", str(tmp_path))
    assert "40 kPa at once, 20 kPa after all relaxation" in text.out
    assert "time (s)" in (tmp_path / "case" / "calibration.svg").read_text()
    fitted = str(tmp_path / "case" / "calibration.json")
    written = success("export", fitted, "--as", "abaqus", "--reports", str(tmp_path), "--json")
    prony = written.json["text"].split("*Viscoelastic, time=prony\n")[1].splitlines()
    rows = [[float(v) for v in line.split(",")] for line in prony]
    assert np.array(rows) == pytest.approx(np.array([[0.3, 0, 1], [0.2, 0, 20]]), rel=1e-5)


def test_shares_on_a_fixed_grid_of_times(tmp_path):
    """Times 1 and 20 s are on the grid, the third one has nothing to do."""
    three = 'relaxation = { from = "0.05 s", to = "20 s", terms = 3 }'
    tests = course(tmp_path, "pulled", "uniaxial", STRETCH, GEL)
    path = calibration(tmp_path, NEO_HOOKEAN + three, tests)
    found = api.calibrate(path, data=tmp_path)
    assert found.converged, found.message
    assert found.fit.constants() == pytest.approx(
        {"C10": 0.02, "share1": 0.0, "share2": 0.3, "share3": 0.2}, rel=1e-6, abs=1e-6
    )


def test_intervals_cover_the_true_constants(tmp_path):
    """95 % intervals of three constants in 30 courses with 1 % noise: 85.5 +- 2.1 of 90."""
    material = (
        'model = "neo-hookean"\nincompressible = true\n'
        'relaxation = [{ time = "1 s" }, { time = "20 s" }]'
    )
    solid = Material("neo-hookean", {"C10": 0.02}, incompressible=True, relaxation=SERIES)
    inside, truth = 0, {"C10": 0.02, "share1": 0.3, "share2": 0.2}
    for seed in range(30):
        tests = course(tmp_path, "pulled", "uniaxial", STRETCH, solid, 0.01, seed)
        fit = api.calibrate(calibration(tmp_path, material, tests), data=tmp_path).fit
        assert fit.converged
        inside += sum(
            low <= truth[name] <= high
            for name, (low, high) in zip(fit.names, fit.ci95, strict=True)
        )
    # a binomial count of 90 at 95 % is 85.5 +- 2.1; the three of a fit are correlated
    assert 80 <= inside <= 90


def test_an_elastic_energy_may_be_fitted_to_a_course(tmp_path):
    slow = Material("neo-hookean", {"C10": 0.02}, poisson_ratio=0.49)
    tests = course(tmp_path, "pulled", "uniaxial", STRETCH, slow)
    path = calibration(tmp_path, NEO_HOOKEAN, tests)
    assert api.calibrate(path, data=tmp_path).fit.values == pytest.approx([0.02], rel=1e-9)


def problem(folder, test='speed = "10 mm/s"\nhold = "100 s"'):
    path = folder / "pull.toml"
    material = (
        'model = "neo-hookean"\nC10 = "20 kPa"\nincompressible = true\n'
        'relaxation = [{ share = 0.3, time = "1 s" }, { share = 0.2, time = "20 s" }]'
    )
    pulled = f'[test]\nkind = "tension"\ndisplacement = "8 mm"\nsteps = 8\n{test}\n'
    path.write_text(gauge(material, 'area = "4 mm^2"\nlength = "20 mm"\n') + pulled)
    return path


def test_a_ramp_and_hold_is_solved(tmp_path):
    answer = study("solve", str(problem(tmp_path)), "--json")
    assert answer.code == 0, answer.err
    time, force = (np.array(answer.json[key]) for key in ("time_s", "force_N"))
    assert time[[7, -1]] == pytest.approx([0.8, 100.8])
    assert answer.json["displacement_mm"][7:] == pytest.approx([8.0] * 9)
    # five times the longest time of the series: half of the stress is gone
    elastic = 2 * 0.02 * (1.4 - 1.4**-2)
    faded = 1 - 0.3 - 0.2 * (1 - np.exp(-100.4 / 20))
    assert force[-1] == pytest.approx(4 * elastic * faded, rel=2e-3)
    assert (np.diff(force[7:]) < 0).all()
    shown = study("solve", str(problem(tmp_path)))
    assert shown.out.split()[:6] == ["time", "[s]", "displacement", "[mm]", "force", "[N]"]


def test_a_fast_cycle_needs_more_force_and_loses_work(tmp_path):
    peaks, losses = [], []
    for speed in (0.0008, 0.08, 0.8, 8, 8000):
        path = problem(tmp_path, f'speed = "{speed:.4f} mm/s"\ncycles = 1')
        curve = api.solve(path, overrides=["test.steps=200"]).curve
        d, f = np.r_[0.0, curve.displacement_mm], np.r_[0.0, curve.force_N]
        peaks.append(f.max())
        losses.append(np.trapezoid(f, d))
    assert (np.diff(peaks) > 0).all()
    # nothing is lost at either end, most in between
    assert max(losses) > 5 * max(losses[0], losses[-1]) > 0
    assert losses[-1] < 1e-3 * peaks[-1] * 8


def test_the_speed_of_a_test_is_a_factor(tmp_path):
    """Peak forces of a study at three speeds are those of `study solve` at each."""
    path = problem(tmp_path, 'speed = "10 mm/s"')
    design = tmp_path / "speeds.toml"
    speeds = ["1 mm/s", "10 mm/s", "100 mm/s"]
    design.write_text(
        path.read_text() + f'[factors]\n"test.speed" = {speeds}\n"material.C10" = '
        '["20 kPa", "40 kPa"]\n' + responses(peak_force="0.01 N") + CSV
    )
    answer = success("run", str(design), "--results", str(tmp_path / "r"), "--json")
    assert answer.json["cases"]["done"] == 6
    forces = [
        api.solve(path, overrides=[f'test.speed="{speed}"']).curve.force_N[-1] for speed in speeds
    ]
    (verdict,) = (v for v in answer.json["verdicts"] if v["factor"] == "test.speed")
    # averaged over moduli of 20 and 40 kPa, in which the force is linear
    assert verdict["effect"] == pytest.approx(1.5 * (forces[-1] - forces[0]), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("share = 0.3, ", ""), "share of term 1 is not known"),
        (('time = "1 s"', 'time = ["1 s", "3 s"]'), "is a range"),
    ],
)
def test_what_cannot_be_is_told(tmp_path, change, words):
    path = problem(tmp_path)
    path.write_text(path.read_text().replace(*change, 1))
    with pytest.raises(InputError, match=words):
        api.solve(path)


def test_a_course_that_does_not_resist_is_refused(tmp_path):
    tests = course(tmp_path, "pulled", "uniaxial", STRETCH, GEL)
    tests = tests.replace('"kPa" }', '"kPa" }, sign = "negative"', 1)
    with pytest.raises(InputError, match="does not resist"):
        api.calibrate(calibration(tmp_path, ONE_TERM, tests), data=tmp_path)


def test_times_that_do_not_increase_are_told_with_their_line(tmp_path):
    tests = course(tmp_path, "pulled", "uniaxial", STRETCH, GEL)
    file = tmp_path / "pulled.csv"
    lines = file.read_text().splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"pulled\.csv:7.*time does not increase"):
        api.calibrate(calibration(tmp_path, ONE_TERM, tests), data=tmp_path)
