"""Nuisance parameters: covariances by hand, coverage with nuisances drawn from their priors."""

import json
import tomllib

import numpy as np
import pytest

from study import api
from study.ground.curve import Curve
from study.ground.errors import InputError
from study.harness.design.load import load_calibration
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.residual_function import MeasuredCurve, Prior
from study.mechanics.forward import closed_form
from study.mechanics.material.homogeneous import response
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cylinder
from study.simulation.calibration import nuisance as propagation
from study.simulation.calibration.calibrate_tests import calibrate
from tests.cli.small import case_file, recorded, success
from tests.fem.problems import long_verification
from tests.runner.test_calibrate import RP2, SPECIMEN, case, write

RAW = {"points": '"raw"', "range": '["1 %", "30 %"]'}


def line(u, noise, rng, k=3.0, zero=0.0, rows=7):
    """Fit slope and zero of a line; 7 rows count as independent, so all is known by hand."""
    d = np.linspace(1.0, 4.0, rows)
    force = k * d + zero + noise * rng.normal(size=rows)
    grid = np.r_[0.0, d]

    def predict(x):
        one = {"k": grid, "zero": np.ones_like(grid)}
        return [Curve(grid, x[0] * grid + x[1], force_gradient=one)]

    measured = [MeasuredCurve("line", Curve(d, force))]
    priors = [Prior("zero", 0.0, u, noise)]
    plain = fit(predict, measured, ("k", "zero"), [1.0, 0.0], priors=priors)
    return d, force, with_serial_correlation(plain, measured)


def test_slope_and_zero_of_a_line_are_those_of_generalized_least_squares():
    """Normal equations of the rows and the prior written out; s^2 from both."""
    noise, u = 0.1, 0.05
    d, force, found = line(u, noise, np.random.default_rng(3), zero=0.08)
    design = np.stack([d, np.ones_like(d)], axis=1)
    inverse = np.linalg.inv(design.T @ design + np.diag([0.0, (noise / u) ** 2]))
    estimate = inverse @ design.T @ force
    assert found.values == pytest.approx(estimate, rel=1e-9)
    left = force - design @ estimate
    penalty = (noise / u * estimate[1]) ** 2
    # the prior determines this share of the zero, and leaves as much to the rows
    leverage = (noise / u) ** 2 * inverse[1, 1]
    variance = (left @ left + penalty) / (len(d) - 2 + leverage)
    own = variance * inverse @ (design.T @ design) @ inverse
    error = inverse[:, 1] * (noise / u) ** 2 * u
    assert found.covariance == pytest.approx(own + np.outer(error, error), rel=1e-6)
    assert found.rss == pytest.approx(left @ left, rel=1e-9)
    assert found.degrees_of_freedom == 6


def test_a_prior_that_is_exact_leaves_one_constant_and_none_leaves_two():
    d, force, exact = line(1e-7, 0.1, np.random.default_rng(3))
    assert exact.values[0] == pytest.approx(d @ force / (d @ d), rel=1e-6)
    residual = force - exact.values[0] * d
    by_hand = np.sqrt(residual @ residual / 6 / (d @ d))
    assert exact.standard_error[0] == pytest.approx(by_hand, rel=1e-5)
    d, force, vague = line(1e6, 0.1, np.random.default_rng(3))
    slope, intercept = np.polyfit(d, force, 1)
    assert vague.values == pytest.approx([slope, intercept], rel=1e-6)
    residual = force - np.polyval([slope, intercept], d)
    by_hand = np.sqrt(residual @ residual / 5 / np.sum((d - d.mean()) ** 2))
    assert vague.standard_error[0] == pytest.approx(by_hand, rel=1e-5)


def nuisance(tmp_path, text, rows=RAW, model="reduced-polynomial", order="order = 2"):
    return case(tmp_path, [rows], model, order, f"[nuisance]\n{text}\n")


def write_rows(folder, d, force, noise, seed):
    """Write a recording with noise, N."""
    read = force + noise * np.random.default_rng(seed).normal(size=d.size)
    rows = "".join(f"A,0,{x:.9g},{y:.9g}\n" for x, y in zip(d, read, strict=True))
    (folder / "a.csv").write_text("s,r,d,f\n" + rows, encoding="utf-8")


def pressed(model, constants, d):
    """Force of the cylinder between plates that slip, N."""
    material = Material(model, constants, poisson_ratio=0.4995)
    return closed_form.homogeneous(SPECIMEN, material, d).force_N


@pytest.mark.usefixtures("undrawn")
def test_sizes_are_propagated_as_the_closed_form_says(tmp_path):
    """C10 goes with 1 / r^2: 1 % of the radius is 2 % of C10, whatever the noise."""
    write(tmp_path / "a.csv", "neo-hookean", {"C10": 7e-3}, noise=1e-4)
    path = nuisance(tmp_path, 'specimen.radius = "1 %"', model="neo-hookean", order="")
    said = success("calibrate", path, "--data", tmp_path, "--results", tmp_path / "results").out
    assert "specimen.radius" in said
    assert "share in C10" in said
    document = json.loads((tmp_path / "results/calibration/calibration.json").read_text())
    found = document["parameters"]["C10"]
    assert found["standard_error"] == pytest.approx(0.02 * found["value"], rel=1e-3)
    one = document["nuisance"]["specimen.radius"]
    assert one["treated"] == "propagated"
    assert one["shares"]["C10"] == pytest.approx(1.0, abs=1e-4)
    # of an uncertainty that is known, the interval is that of a normal error
    assert found["ci95"][1] - found["value"] == pytest.approx(1.96 * 0.02 * 7.0, rel=3e-3)


def test_a_contact_that_the_rows_show_is_in_the_intervals(tmp_path):
    """Twelve recordings in the coordinate of the machine, .3 % noise; the truth is 7 kPa.

    Intervals that took the contact found for exact held it in a tenth of such draws.
    """
    rng, held = np.random.default_rng(7), 0
    for _ in range(12):
        d = np.linspace(-6.0 * rng.uniform(0.1, 0.4), 6.0, 140)
        force = np.where(d > 0, pressed("neo-hookean", {"C10": 7e-3}, np.maximum(d, 0.0)), 0.0)
        force += 0.003 * force.max() * rng.normal(size=d.size)
        write_rows(tmp_path, d + rng.uniform(3, 9), force, 0.0, 1)
        rows = {**RAW, "range": '["1 %", "20 %"]', "more": ', displacement_zero = "contact"'}
        found = api.calibrate(case(tmp_path, [rows], "neo-hookean", ""), data=tmp_path)
        (offset,) = found.fit.nuisance
        assert (offset.key, offset.is_fitted) == ("displacement_offset", True)
        held += found.fit.ci95[0, 0] <= 7e-3 <= found.fit.ci95[0, 1]
    assert held >= 10


def test_a_specimen_was_met_before_it_carried_the_toe(tmp_path):
    d = np.linspace(0.0, 6.0, 121)
    write_rows(tmp_path, d, pressed("neo-hookean", {"C10": 7e-3}, d), 0.0, 1)
    rows = {**RAW, "range": '["1 %", "20 %"]', "more": ', toe = "0.1 N"'}
    found = api.calibrate(case(tmp_path, [rows], "neo-hookean", ""), data=tmp_path)
    assert found.fit.values[0] == pytest.approx(7e-3, rel=1e-4)
    assert found.fit.nuisance[0].value == pytest.approx(
        0.1 / (6 * 7e-3 * 25**2 * np.pi / 30), rel=0.01
    )


@pytest.mark.usefixtures("undrawn")
def test_offset_and_zero_of_a_test_are_found(tmp_path):
    """A test begun 0.3 mm late by a cell that reads 0.2 N too much."""
    d = np.linspace(0.0, 8.6, 173)
    write_rows(tmp_path, d, pressed("reduced-polynomial", RP2, d + 0.3) + 0.2, 0.02, 7)
    declared = 'displacement_offset = "0.3 mm"\nforce_zero = "0.3 N"'
    rows = {**RAW, "range": '["1 %", "28 %"]'}
    path = nuisance(tmp_path, declared, rows)
    said = success("calibrate", path, "--data", tmp_path, "--results", tmp_path / "r").out
    assert "pseudo-observation" in said
    found = api.calibrate(path, data=tmp_path, profiles=True)
    assert found.converged
    for one, true in zip(found.fit.nuisance, (0.3, 0.2), strict=True):
        assert one.ci95[0] <= true <= one.ci95[1]
        assert one.ci95 == pytest.approx(found.profiles[one.name].interval, abs=0.1 * abs(true))
    for pair, true in zip(found.fit.ci95, RP2.values(), strict=True):
        assert pair[0] <= true <= pair[1]
    # without them the constants are beside the truth by many of their errors
    blind = api.calibrate(case(tmp_path, [rows]), data=tmp_path).fit
    assert not blind.ci95[0, 0] <= 7e-3 <= blind.ci95[0, 1]


def test_weights_that_have_not_settled_are_no_answer(tmp_path, monkeypatch):
    """Of the first of several fits the noise, and so the weight of a prior, is a guess."""
    write(tmp_path / "a.csv", "reduced-polynomial", RP2, noise=0.02)
    path = nuisance(tmp_path, 'force_zero = "0.3 N"', {**RAW, "range": '["1 %", "28 %"]'})
    assert api.calibrate(path, data=tmp_path).converged
    monkeypatch.setattr(propagation, "_ROUNDS", 1)
    monkeypatch.setattr(propagation, "_SETTLED", 0.0)
    found = api.calibrate(path, data=tmp_path).fit
    assert not found.converged
    assert "has not settled in 1 fits" in found.message


def test_friction_between_two_plates_is_the_mixture_of_both(tmp_path):
    """Rows made of 70 % of the closed form and 30 % of a bonded simulation."""
    rows = {**RAW, "range": '["1 %", "20 %"]'}
    declared = "friction = { value = 0.2, uncertainty = 0.2 }"
    path = nuisance(tmp_path, declared, rows, "neo-hookean", "")
    head = path.read_text().partition("[[tests]]")[0]
    (tmp_path / "problem.toml").write_text(
        head.replace('"neo-hookean"', '"neo-hookean"\nC10 = "7 kPa"')
        + '[test]\nkind = "compression"\ninterface = "bonded"\ndisplacement = "6 mm"\nsteps = 40\n'
    )
    bonded = api.solve(tmp_path / "problem.toml").curve
    free = pressed("neo-hookean", {"C10": 7e-3}, bonded.displacement_mm)
    write_rows(tmp_path, bonded.displacement_mm, 0.7 * free + 0.3 * bonded.force_N, 0.01, 7)
    found = api.calibrate(path, data=tmp_path)
    (friction,) = found.fit.nuisance
    # a simulation of 10 steps interpolates one of 40; the rest is noise
    assert friction.value == pytest.approx(0.3, abs=3 * friction.standard_error + 2e-3)
    assert found.fit.ci95[0, 0] <= 7e-3 <= found.fit.ci95[0, 1]
    assert friction.shares["C10"] > 0.5  # bonded plates and a stiffer solid are much alike


@long_verification
def test_coverage_is_92_to_98_percent(tmp_path):
    """Share of intervals that hold the truth, offset, zero and radius drawn from their priors."""
    rng, hits, studies = np.random.default_rng(2011), np.zeros(2), 1000
    declared = 'displacement_offset = "0.1 mm"\nforce_zero = "0.1 N"\nspecimen.radius = "0.1 mm"'
    path = nuisance(tmp_path, declared, {**RAW, "range": '["1 %", "28 %"]'})
    config, truth = load_calibration(path), np.array(list(RP2.values()))
    material, d = (
        Material("reduced-polynomial", RP2, poisson_ratio=0.4995),
        np.linspace(0.0, 8.6, 60),
    )
    for _ in range(studies):
        offset, zero, radius = rng.normal(size=3) * [0.1, 0.1, 0.1]
        specimen = Cylinder(25.0 + radius, 30.0)
        force = closed_form.homogeneous(specimen, material, d + offset).force_N + zero
        write_rows(tmp_path, d, force, 0.1, rng)
        found = calibrate(config, tmp_path).fit
        hits += (found.ci95[:, 0] <= truth) & (truth <= found.ci95[:, 1])
    found = hits / studies
    assert np.all((found >= 0.92) & (found <= 0.98)), found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('specimen.area = "1 %"', "is no input of this test"),
        ("material.poisson_ratio = 0.001", "reaches 0.5"),
    ],
)
def test_what_means_nothing_is_refused_with_its_mend(tmp_path, text, said):
    write(tmp_path / "a.csv", "reduced-polynomial", RP2)
    path = nuisance(tmp_path, text)
    tomllib.loads(path.read_text(encoding="utf-8"))
    with pytest.raises(InputError, match=said):
        api.calibrate(path, data=tmp_path)


def test_a_radius_of_an_indenter_moves_the_modulus_as_hertz_says(tmp_path):
    """F = 4/3 E* sqrt(R) d^1.5: 2 % of the radius is 1 % of C10, to the order of the strain."""
    loaded = 'kind = "indentation", interface = "frictionless", displacement = "0.6 mm"'
    loaded += ', indenter = { shape = "sphere", radius = "10 mm" }'
    head = f"schema = 1\ntest = {{ {loaded} }}\n" + '[model]\nmesh = "coarse"\n'
    head += '[specimen]\nshape = "cylinder"\nradius = "25 mm"\nheight = "30 mm"\n'
    head += '[material]\nmodel = "neo-hookean"\npoisson_ratio = 0.495\n'
    curve = api.solve(case_file(tmp_path, head, 'C10 = "7 kPa"\n')).curve
    force = curve.force_N * (1 + 1e-4 * np.random.default_rng(1).normal(size=len(curve)))
    columns = {"displacement": ("mm", curve.displacement_mm), "force": ("N", force)}
    test = recorded(tmp_path, "a", loaded, columns, ', points = "raw"')
    declared = '[nuisance]\n"test.indenter.radius" = "0.2 mm"\n'
    head = head.replace(f"test = {{ {loaded} }}\n", "")
    found = api.calibrate(case_file(tmp_path, head, test, declared), data=tmp_path).fit
    assert found.standard_error[0] / found.values[0] == pytest.approx(0.01, rel=0.1)
    assert found.nuisance[0].shares["C10"] > 0.99


def soft(d):
    """Force of an incompressible cylinder of 5 kPa, N."""
    material = Material("neo-hookean", {"C10": 5e-3}, incompressible=True)
    return -np.pi * 25**2 * response(material, "uniaxial", 1 - d / 30).stress


def shifted(tmp_path, offset, rng):
    """Compression of 5 kPa with an offset of the plate and a zero of the load cell, .02 N noise."""
    d = np.linspace(0.1, 9.0, 60)
    write_rows(tmp_path, d, soft(d + offset) + 0.15, 0.02, rng)
    text = 'displacement_offset = "0.5 mm"\nforce_zero = "0.2 N"'
    path = nuisance(tmp_path, text, {"points": '"raw"'}, "neo-hookean", "")
    return api.calibrate(path, data=tmp_path)


@pytest.mark.parametrize("sigmas", [-2, -1, 0.4, 1, 2])
def test_an_offset_is_found_wherever_its_prior_lets_it_be(tmp_path, sigmas):
    found = shifted(tmp_path, 0.5 * sigmas, np.random.default_rng(int(10 + sigmas)))
    offset, zero = found.fit.nuisance
    assert found.converged
    # noise of .02 N against .2 N: the rows find all three; four standard errors
    assert abs(offset.value - 0.5 * sigmas) < 4 * offset.standard_error
    assert abs(zero.value - 0.15) < 4 * zero.standard_error
    assert abs(found.fit.values[0] - 5e-3) < 4 * found.fit.standard_error[0]
    assert found.fit.standard_error[0] < 0.03 * 5e-3


def test_a_test_may_begin_late_where_its_offset_is_fitted(tmp_path):
    """Contact is 1 mm behind the recorded zero, two standard deviations; 12.5 mm is a position."""
    text, d = 'displacement_offset = "0.5 mm"', np.linspace(0.05, 9.0, 60)
    path = nuisance(tmp_path, text, {"points": '"raw"'}, "neo-hookean", "")
    write_rows(tmp_path, d + 1.0, soft(d), 0.02, 1)
    found = api.calibrate(path, data=tmp_path).fit
    (offset,) = found.nuisance
    assert abs(offset.value + 1.0) < 4 * offset.standard_error
    assert abs(found.values[0] - 5e-3) < 4 * found.standard_error[0]
    write_rows(tmp_path, d + 12.5, soft(d), 0.02, 1)
    with pytest.raises(InputError, match="no specimen that is unloaded at 0 mm"):
        api.calibrate(path, data=tmp_path)
