"""`study calibrate --by test`: the Wald test by hand, from the rows of every test."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from tests.cli.small import case_file, gauge, recorded, refusal, success

pytestmark = pytest.mark.usefixtures("undrawn")

SIZE = 'area = "20 mm^2"\nlength = "25 mm"\n'
HEAD = gauge('model = "neo-hookean"\nincompressible = true', SIZE)
DESIGNS = Path(__file__).parents[2] / "designs"
MU_KPA = 30.0
NOISE_KPA = 0.4


def stress(kind, stretch):
    """Nominal stress over mu of an incompressible neo-Hookean solid."""
    exponent = {"tension": -2, "planar": -3, "equibiaxial": -5}[kind]
    return np.asarray(stretch - stretch**exponent)


def measure(folder, mu, rng, n=15, zero=0.0):
    stretch = np.linspace(1.05, 1.8, n)
    for kind, value in mu.items():
        s = value * stress(kind, stretch) + NOISE_KPA * rng.normal(size=n) + zero
        columns = {"stretch": ("1", stretch), "stress": ("kPa", s)}
        table = recorded(folder, kind, f'kind = "{kind}"', columns)
        (folder / f"{kind}.toml").write_text(table)


def written(folder, kinds):
    return case_file(folder, HEAD, *((folder / f"{kind}.toml").read_text() for kind in kinds))


def calibrated(path, *more):
    return success(
        "calibrate", path, "--data", path.parent, "--results", path.parent / "r", "--json", *more
    ).json


def by_hand(folder, kinds):
    """Statistic, common mu, mean weights, and p: from the rows, with whole covariance matrices.

    Given the correlations of the rows of three tests, a sum of weighted squares over 2 is an F; p
    is its mean over 61 ranges of correlations of each test, all 61^3 together.
    """
    value, variances, weights, likely = [], [], [], []
    for kind in kinds:
        stretch, s = np.loadtxt(folder / f"{kind}.csv", delimiter=",", skiprows=1).T
        x = stress(kind, stretch)
        mu, n = float(x @ s / (x @ x)), len(x)
        z = np.linspace(-1.8, 3.8, 400)
        log_weight, variance = np.empty(z.size), np.empty(z.size)
        for k, rho in enumerate(np.tanh(z)):
            V = rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / (1 - rho**2)
            inner = np.linalg.inv(V)
            normal = x @ inner @ x
            left = s - x * (x @ inner @ s / normal)
            square = left @ inner @ left
            log_weight[k] = (
                -0.5 * (n - 1) * np.log(square) - 0.5 * np.linalg.slogdet(V)[1]
                - 0.5 * np.log(normal) + 0.5 * np.log(1 - rho**2)
            )  # fmt: skip
            variance[k] = square / (n - 1) * (x @ V @ x) / (x @ x) ** 2
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        value.append(mu)
        weights.append(float(weight @ (1 / variance)))
        bins = np.array_split(np.flatnonzero(weight > 1e-7), 61)
        likely.append(np.array([weight[k].sum() for k in bins]))
        variances.append(np.array([weight[k] @ variance[k] / weight[k].sum() for k in bins]))
    v = np.stack(np.meshgrid(*variances, indexing="ij")).reshape(3, -1)
    each, df = np.array(value)[:, None], 14
    common = (each / v).sum(axis=0) / (1 / v).sum(axis=0)
    contrasts = np.array([[1, 0, -1], [0, 1, -1]])
    d, turn = np.linalg.eigh(np.einsum("ai,im,bi->mab", contrasts, v, contrasts))
    shares = np.einsum("mac,ai->mic", turn, contrasts) ** 2 * v.T[:, :, None]
    nu = d**2 / (shares**2 / df).sum(axis=1)
    e = (nu / (nu - 2)).sum(axis=1) / (1 / (nu - 2)).sum(axis=1)
    mass = np.prod(np.stack(np.meshgrid(*likely, indexing="ij")).reshape(3, -1), axis=0)
    p = mass @ stats.f.sf(((each - common) ** 2 / v).sum(axis=0) / 2, 2, e)
    w = np.array(weights)
    middle = float(w @ value / w.sum())
    return float(w @ (np.array(value) - middle) ** 2), middle, w, float(p)


@pytest.mark.parametrize(
    ("off", "difference", "verdict"),
    [(1.0, 0.05, "agree"), (1.0, 0.01, "undecided"), (1.06, 0.04, "differ")],
)
def test_wald_statistic_and_power_of_three_separate_calibrations(
    tmp_path, off, difference, verdict
):
    kinds = ["tension", "equibiaxial", "planar"]
    mu = {**dict.fromkeys(kinds, MU_KPA), "planar": off * MU_KPA}
    measure(tmp_path, mu, np.random.default_rng(7))
    wald, common, weight, p = by_hand(tmp_path, kinds)
    asked = ["--by", "test", "--difference", f"{100 * difference:g} %"]
    found = calibrated(written(tmp_path, kinds), *asked)
    assert found["verdict"] == verdict
    (name,) = found["common"]
    assert 2 * found["common"][name]["value"] == pytest.approx(common, rel=1e-4)
    assert found["statistic"] == pytest.approx(wald, rel=0.02)
    assert found["df"] == 2
    assert found["p"] == pytest.approx(p, rel=0.03)
    # one constant that is off by d has the noncentrality d^2 w (1 - w / sum of w)
    for i, one in enumerate(found["groups"]):
        lam = (difference * common) ** 2 * weight[i] * (1 - weight[i] / weight.sum())
        limit = stats.f.isf(0.05, 2, found["df_error"])
        power = stats.ncf.sf(limit, 2, found["df_error"], lam)
        assert one["power"] == pytest.approx(power, abs=0.01)
        again = (one["detectable"] / difference) ** 2 * lam
        assert stats.ncf.sf(limit, 2, found["df_error"], again) == pytest.approx(0.8, abs=0.01)


def test_two_tests_of_one_constant_are_welchs_t(tmp_path):
    kinds = ["tension", "planar"]
    measure(tmp_path, dict.fromkeys(kinds, MU_KPA), np.random.default_rng(3), n=6)
    alone = [calibrated(written(tmp_path, [kind])) for kind in kinds]
    (name,) = alone[0]["parameters"]
    value = np.array([one["parameters"][name]["value"] for one in alone])
    variance = np.array([one["parameters"][name]["standard_error"] ** 2 for one in alone])
    wald = float(np.ptp(value) ** 2 / variance.sum())
    found = calibrated(written(tmp_path, kinds), "--by", "test")
    welch = variance.sum() ** 2 / np.sum(variance**2 / 5)
    assert found["df_error"] == pytest.approx(welch, rel=1e-7)
    assert found["p"] == pytest.approx(2 * stats.t.sf(np.sqrt(wald), welch), rel=1e-6)


def test_a_zero_of_the_load_cell_is_no_other_material(tmp_path):
    kinds = ["tension", "planar"]
    rng = np.random.default_rng(5)
    measure(tmp_path, {"tension": MU_KPA}, rng, n=200, zero=1.0)
    measure(tmp_path, {"planar": MU_KPA}, rng, n=200, zero=-1.0)
    path = written(tmp_path, kinds)
    assert calibrated(path, "--by", "test")["verdict"] == "differ"
    known = calibrated(path, "--by", "test", "--zero", "2 %")
    assert known["p"] > 0.05
    # a shift z of all stresses moves mu by z sum(g) / sum(g^2), g the stress over mu
    stretch = np.linspace(1.05, 1.8, 200)
    g = stress("tension", stretch)
    largest = max(
        float(row.split(",")[1]) for row in (tmp_path / "tension.csv").read_text().split()[1:]
    )
    (name,) = known["common"]
    # C10 = mu / 2
    half = 0.5 * 0.02 * largest * g.sum() / (g @ g)
    assert known["groups"][0]["zero_error"][name] == pytest.approx(half, rel=1e-5)


def test_words_and_refusals(tmp_path):
    kinds = ["tension", "planar"]
    measure(tmp_path, dict.fromkeys(kinds, MU_KPA), np.random.default_rng(3))
    asked = f"--data {tmp_path} --by"
    command = f"calibrate {written(tmp_path, kinds)} {asked}"
    words = success(f"{command} test").out
    for word in ("tension", "planar", "common", "power", "agree: one set of constants"):
        assert word in words
    alone = refusal(f"calibrate {written(tmp_path, ['planar'])} {asked} test")
    assert "second [[tests]]" in alone.err
    written(tmp_path, kinds)
    for wrong in ("batch", "test --difference '0 %'", "test --zero '100 %'"):
        refusal(f"{command} {wrong}")


@pytest.mark.slow
@pytest.mark.parametrize(("points", "least"), [(15, 0.0), (60, 0.03)])
def test_five_percent_of_equal_materials_are_told_apart(tmp_path, points, least):
    """600 materials of three tests; a share of 0.05 +- 0.009 is expected of 60 points each.

    Of 15 points nobody knows how strongly they are correlated: it may be less, never more.
    """
    kinds = ["tension", "equibiaxial", "planar"]
    rng = np.random.default_rng(2011)
    path, p = written(tmp_path, kinds), []
    for _ in range(600):
        measure(tmp_path, dict.fromkeys(kinds, MU_KPA), rng, points)
        p.append(calibrated(path, "--by", "test")["p"])
    share = float(np.mean(np.array(p) < 0.05))
    print(json.dumps({"points": points, "rejected": share}))
    assert least <= share <= 0.07


@pytest.mark.slow
@pytest.mark.parametrize(("truth", "verdict"), [("bonded", "agree"), ("frictionless", "differ")])
def test_the_design_tells_two_truths_apart(tmp_path, truth, verdict):
    """Plates that are bonded as the calibration says, and plates that slip: mu0 tells it, too."""
    slip = f"presets.way.bonded-compression.test.interface={truth}"
    success("virtual", tmp_path, "--from", DESIGNS / "same-specimen.toml", "-s", slip)
    found = success(
        f"calibrate {DESIGNS}/one-material.toml --by test --zero '0.2 %' --data {tmp_path} --json"
    )
    assert found.json["verdict"] == verdict
    mu0 = {one["label"]: one["mu0"] for one in found.json["groups"]}
    others = (mu0["lubricated-compression"] + mu0["flat-indentation"]) / 2
    # the same files but one: the other two tests agree under both truths
    assert mu0["lubricated-compression"] == pytest.approx(mu0["flat-indentation"], rel=0.02)
    assert (mu0["bonded-compression"] == pytest.approx(others, rel=0.05)) is (verdict == "agree")
    # docs/thesis.md holds what these commands print
    told = (DESIGNS.parent / "docs" / "thesis.md").read_text("utf-8")
    if verdict == "agree":
        numbers = r"agree: F\(6, ([\d.]+)\) = ([\d.]+), p = ([\d.]+), mu0 within ([\d.]+)"
        printed = re.search(numbers, told)
        keys = [found.json[key] for key in ("df_error", "f", "p", "mu0_spread")]
    else:
        printed = re.search(r"mu0 then spreads over ([\d.]+) %", told)
        keys = [found.json["mu0_spread"]]
    assert printed is not None
    keys[-1] *= 100
    assert [float(number) for number in printed.groups()] == pytest.approx(keys, rel=0.01)


def test_shear_that_cannot_tell_the_sign_of_an_exponent_agrees(tmp_path):
    """One Ogden solid with alpha = -3; its shear is even in alpha and is fitted at either sign."""
    alpha, share, rng = -3.0, np.linspace(0.02, 0.5, 25), np.random.default_rng(3)
    noisy = {
        kind: exact * (1 + 0.01 * rng.normal(size=share.size))
        for kind, exact in ogden_stresses(share, alpha).items()
    }
    text = written_tests(tmp_path, share, noisy)
    path = tmp_path / "ogden.toml"
    for start in ("4.0", "-4.0"):
        started = f'mu = ["2 kPa"]\nalpha = [{start}]\n'
        path.write_text(text.replace("order = 1\n", "order = 1\n" + started), encoding="utf-8")
        found = calibrated(path, "--by", "test")
        alphas = [one["parameters"]["alpha1"]["value"] for one in found["groups"]]
        assert alphas == pytest.approx([alpha, alpha], rel=0.2)
        assert found["verdict"] != "differ", found["sentence"]
        assert found["p"] > 0.05


def ogden_stresses(share, alpha):
    """Stresses of an Ogden solid with mu = 2 kPa, at strains of each test."""
    mu, stretch = 2.0, 1 + share
    longest = 0.5 * (share + np.sqrt(share**2 + 4))
    return {
        "tension": 2 * mu / alpha * (stretch ** (alpha - 1) - stretch ** (-alpha / 2 - 1)),
        "simple-shear": 2 * mu / alpha * (longest**alpha - longest**-alpha)
        / (longest + 1 / longest),
    }  # fmt: skip


def written_tests(folder, share, stresses):
    """Write a CSV of each test, and give the calibration of one Ogden solid to all of them."""
    text = HEAD.replace("neo-hookean", "ogden") + "order = 1\n"
    for kind, s in stresses.items():
        columns = {"strain": ("1", share), "stress": ("kPa", s)}
        text += recorded(folder, kind, f'kind = "{kind}"', columns)
    return text


def ogden_solid(folder, alpha, rng):
    """Tension and simple shear of one Ogden solid, 1 % of noise."""
    share = np.linspace(0.01, 0.3, 25)
    noisy = {
        kind: exact + 0.01 * np.abs(exact).max() * rng.normal(size=share.size)
        for kind, exact in ogden_stresses(share, alpha).items()
    }
    return case_file(folder, written_tests(folder, share, noisy))


def test_a_test_that_stops_at_a_higher_minimum_is_fitted_from_the_others(tmp_path):
    """From its own start tension ends near alpha = 0, with five times the sum of squares."""
    path = ogden_solid(tmp_path, -8.0, np.random.default_rng(11))
    found = calibrated(path, "--by", "test")
    for one in found["groups"]:
        alpha = one["parameters"]["alpha1"]
        assert abs(alpha["value"] + 8) < 4 * alpha["standard_error"]
    assert found["form"] == "score"
    assert found["verdict"] != "differ", found["sentence"]


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [-8.0, -3.0, 3.0, 8.0])
def test_one_ogden_solid_is_told_apart_at_the_nominal_rate(tmp_path, alpha):
    """200 materials; at 0.05, three binomial standard deviations are 0.046."""
    rng = np.random.default_rng(11)
    p = [calibrated(ogden_solid(tmp_path, alpha, rng), "--by", "test")["p"] for _ in range(200)]
    assert np.mean(np.array(p) < 0.05) <= 0.05 + 0.046
