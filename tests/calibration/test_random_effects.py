"""Specimens as the unit: coverage of the population's mean and of the next specimen."""

import json
from dataclasses import replace

import numpy as np
import pytest

from study.ground.curve import Curve
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.fit_influence import population, with_serial_correlation
from study.mechanics.calibration.residual_function import MeasuredCurve
from tests.calibration.cylinder import AREA, predictor
from tests.cli.small import success
from tests.fem.problems import LONG
from tests.runner.test_calibrate import case

C10, SCATTER, NOISE_N = 7e-3, 0.15, 0.1
PREDICT, D = predictor("neo-hookean", ("C10",), 9.0)
SLOPE = PREDICT(np.array([1.0]))[0].force_N  # of the force by C10, N per MPa


def specimen(c10, rng):
    """Fit of one virtual specimen."""
    force = c10 * SLOPE + NOISE_N * rng.normal(size=D.size)
    measured = [MeasuredCurve("virtual", Curve(D, force))]
    return with_serial_correlation(fit(PREDICT, measured, ("C10",), [C10]), measured)


@pytest.mark.parametrize(
    ("specimens", "studies", "least", "most"),
    [
        # 30 studies at 95 %: fewer than 25 in one of 300; independent rows would reach 8
        (8, 30, 25 / 30, 1.0),
        # one binomial standard deviation of 1500 studies is 0.6 points
        *(pytest.param(n, 1500, 0.92, 0.98, marks=LONG) for n in (3, 8)),
    ],
)
def test_intervals_cover_the_population_and_the_next_specimen(specimens, studies, least, most):
    rng, mean, following = np.random.default_rng(2011), 0, 0
    for _ in range(studies):
        true = C10 * (1 + SCATTER * rng.normal(size=specimens + 1))
        fits = [specimen(c10, rng) for c10 in true]
        (found,) = population(fits[:-1])
        mean += found.mean_ci95[0] <= C10 <= found.mean_ci95[1]
        following += found.next_ci95[0] <= fits[-1].values[0] <= found.next_ci95[1]
    assert least <= mean / studies <= most
    assert least <= following / studies <= most


def test_scatter_between_specimens_is_told_from_noise():
    """Of 100 specimens: 15 % between them, whatever the noise; none where all are alike."""
    rng = np.random.default_rng(2011)
    (apart,) = population([specimen(C10 * (1 + SCATTER * rng.normal()), rng) for _ in range(100)])
    # the standard deviation of 100 is known to 7 %
    assert apart.between == pytest.approx(SCATTER * C10, rel=0.2)
    (alike,) = population([specimen(C10, rng) for _ in range(100)])
    assert alike.between < 0.5 * alike.standard_deviation
    assert alike.standard_deviation == pytest.approx(NOISE_N / np.linalg.norm(SLOPE), rel=0.2)


def test_one_specimen_is_no_population():
    assert population([]) == ()
    assert population([specimen(C10, np.random.default_rng(2011))]) == ()


@pytest.mark.usefixtures("undrawn")
def test_verb_gives_the_mean_of_specimens_as_by_hand(tmp_path):
    """``study calibrate`` of 8 specimens: C10 of each by regression through the origin."""
    rng = np.random.default_rng(2011)
    forces = [C10 * (1 + SCATTER * rng.normal()) * SLOPE for _ in range(8)]
    forces = [f + NOISE_N * rng.normal(size=f.size) for f in forces]
    rows = [f"{k},{x:.9f},{y:.9f}" for k, f in enumerate(forces) for x, y in zip(D, f, strict=True)]
    (tmp_path / "a.csv").write_text("s,d,f\n" + "\n".join(rows) + "\n", encoding="utf-8")
    test = {"points": '"raw"', "range": '["0.4 %", "30 %"]', "more": ', block = "s"'}
    more = '[calibration]\nspecimens = "each"\n'
    path = case(tmp_path, [test], "neo-hookean", "", more)
    arguments = ("calibrate", path, "--data", tmp_path, "--results", tmp_path / "results")
    assert "95 % of the next specimen" in success(*arguments).out
    document = json.loads((tmp_path / "results/calibration/calibration.json").read_text())
    found = document["population"]["C10"]
    stretch = 1 - D / 30
    slope = 2 * AREA * (stretch**-2 - stretch)  # Treloar's uniaxial closed form
    own = np.array([1e3 * (slope @ f) / (slope @ slope) for f in forces])
    mean, deviation = own.mean(), own.std(ddof=1)
    assert found["specimens"] == 8
    # Poisson's ratio 0.4995 softens by 1e-3 at most
    assert found["mean"] == pytest.approx(mean, rel=1e-3)
    assert found["standard_deviation"] == pytest.approx(deviation, rel=1e-2)
    half = 2.3646 * deviation / np.sqrt(8)  # t of 7 degrees of freedom
    assert found["mean_ci95"] == pytest.approx([mean - half, mean + half], rel=5e-3)
    assert found["next_ci95"] == pytest.approx([mean - 3 * half, mean + 3 * half], rel=5e-3)
    pooled = success(*arguments, "--set", "calibration.specimens=pooled")
    assert 'write calibration.specimens = "each"' in pooled.out + pooled.err


def test_values_are_shrunk_to_the_mean_by_their_own_errors():
    """Two specimens known to 1 and one to 3: by hand, the variances of moments."""
    one = specimen(C10, np.random.default_rng(1))
    fits = [
        replace(one, values=np.array([value]), standard_error=np.array([error]))
        for value, error in ((10.0, 1.0), (14.0, 1.0), (18.0, 3.0))
    ]
    (found,) = population(fits)
    between = 16 - (1 + 1 + 9) / 3
    shares = [between / (between + error**2) for error in (1.0, 1.0, 3.0)]
    by_hand = [14 + share * (v - 14) for share, v in zip(shares, (10.0, 14.0, 18.0), strict=True)]
    assert found.shrunk == pytest.approx(by_hand, rel=1e-12)
