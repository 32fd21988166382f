"""Certified and published figures. Every expected value is external unless said otherwise."""

import json
import math
from fractions import Fraction
from itertools import product

import numpy as np
import pandas as pd
import pytest
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.outliers_influence import OLSInfluence

from study.statistics.analysis.anova import anova
from study.statistics.analysis.data import prepare
from study.statistics.analysis.equal_variance import bartlett, levene
from study.statistics.analysis.linear_model import model_matrix, terms_of
from study.statistics.analysis.normality import critical_values, ryan_joiner, shapiro_wilk
from study.statistics.analysis.sums_of_squares import factor, influence
from study.statistics.analysis.unreplicated import lenth_of

pytestmark = pytest.mark.verify


def log_relative_error(got, certified):
    digits = 15.0
    if got != certified:
        digits = min(15.0, -math.log10(abs(got - certified) / abs(certified)))
    print(f"\nexpected {certified:.15g}, got {got:.15g}, error {got - certified:.1e}: {digits:.1f}")
    return digits


@pytest.mark.parametrize("name", ["SmLs01", "SmLs04", "SmLs07", "SmLs09"])
def test_influence_keeps_the_digits_of_nist(data_dir, name):
    """Cook's distance and PRESS against rational arithmetic on the stored doubles."""
    lines = (data_dir / "nist_anova" / f"{name}.dat").read_text().splitlines()[60:]
    rows = [line.split() for line in lines if line.strip()]
    table = pd.DataFrame({"treatment": [r[0] for r in rows], "y": [float(r[1]) for r in rows]})
    values = table["y"].to_numpy()
    groups = [g.to_numpy() for _, g in table.groupby("treatment", sort=False)["y"]]
    residual = np.concatenate([_deviations(g) for g in groups])
    left = np.concatenate([np.full(g.size, 1 - 1 / g.size) for g in groups])
    k = len(groups)
    mse = math.fsum(residual**2) / (values.size - k)
    cook = residual**2 * (1 - left) / (mse * k * left**2)

    data = prepare(table, "y", ["treatment"])
    fit = factor(model_matrix(data.layout, terms_of(["treatment"])), data.y)
    found = influence(fit)
    press = math.fsum((residual / left) ** 2)
    assert log_relative_error(float(found.cook.max()), float(cook.max())) >= 12
    assert log_relative_error(math.fsum(found.press**2), press) >= 12
    if name == "SmLs09":
        plain = OLSInfluence(OLS(values, fit.q).fit()).cooks_distance[0].max()
        assert log_relative_error(float(plain), float(cook.max())) < 2  # so the shift is needed


def _deviations(values):
    exact = [Fraction(v) for v in values.tolist()]
    mean = sum(exact, Fraction(0)) / len(exact)
    return np.array([float(v - mean) for v in exact])


def test_ceramic_effects_and_lenth(data_dir):
    """NIST e-Handbook, 2^5 ceramic strength: the effects as printed there."""
    table = pd.read_csv(data_dir / "nist_handbook" / "ceramic_2p5.csv")
    factors = ["X1", "X2", "X3", "X4", "X5"]
    data = prepare(table, "Y", factors)
    found = lenth_of(data, data.y, terms_of(factors), seed=0)
    effects = dict(zip(found.names, found.values, strict=True))
    printed = {"X4": -198.473, "X5": -64.859, "X3": -39.787, "X1:X2:X4": 27.147}
    printed |= {"X1:X2": 24.679, "X2": 20.908}
    assert {name: effects[name] for name in printed} == pytest.approx(printed, abs=6e-4)
    result = anova(table, "Y", factors)
    assert result.error_term.source == "E6"
    assert {"X3", "X4", "X5"} <= set(result.lenth.active)
    assert result.effect("X4").range == pytest.approx(198.473, abs=6e-4)
    assert result.effect("X1:X2:X4").range == pytest.approx(27.147, abs=6e-4)
    assert result.assumptions.normality is None
    assert result.anova.row("X4").f is None
    assert sum(result.shares.values()) == pytest.approx(1, rel=1e-12)


def test_rounding_of_a_deterministic_function_is_no_scatter():
    grid = np.array(list(product((0, 1), repeat=3)), dtype=float)
    table = pd.DataFrame(grid, columns=list("abc"))
    table["y"] = 10 + 0.1 * (grid @ [2.0, 0.7, 0.3])
    data = prepare(table, "y", list("abc"))
    found = lenth_of(data, data.y, terms_of(list("abc")), seed=0)
    assert found.pse == 0
    assert found.p[3:] == (1.0,) * 4


def test_gear_variance(data_dir):
    """NIST e-Handbook 1.3.5.7 and scipy; the handbook's last two digits are single precision."""
    table = pd.read_csv(data_dir / "nist_handbook" / "gear.csv")
    groups = {str(b): g["DIAMETER"].to_numpy() for b, g in table.groupby("BATCH")}
    result = bartlett(groups)
    assert result.statistic == pytest.approx(20.78587342806484, rel=1e-10)
    assert result.p == pytest.approx(0.0136358632781, rel=1e-10)
    assert result.statistic == pytest.approx(20.78580, rel=1e-5)
    median = levene(groups)
    assert median.center == "median"
    assert median.statistic == pytest.approx(1.7059176930008939, rel=1e-10)
    assert median.p == pytest.approx(0.0990829755522, rel=1e-10)
    mean = levene(groups, center="mean")
    assert mean.statistic == pytest.approx(2.1594598564728518, rel=1e-10)


def test_ryan_joiner_published(data_dir):
    cases = json.loads((data_dir / "ryan_joiner" / "published_cases.json").read_text())["cases"]
    for case in cases:
        result = ryan_joiner(case["data"], exact=False)
        assert result.rj == pytest.approx(case["rj_published"], abs=6e-4), case["id"]
        published = case["p_published"]
        if isinstance(published, int | float):
            assert float(result.p_minitab) == pytest.approx(published, abs=6e-4), case["id"]
        elif published is not None:
            assert result.p_minitab.replace(" ", "")[:1] == published.lstrip("p ")[:1]


def test_ryan_joiner_worked_example():
    weights = [148, 154, 158, 160, 161, 162, 166, 170, 182, 195, 236]
    assert critical_values(11) == pytest.approx((0.93872, 0.92301, 0.88798), abs=6e-6)
    assert critical_values(40) == pytest.approx((0.97670384, 0.97148399, 0.95968573), abs=1e-8)
    assert ryan_joiner(weights).p_minitab == "< 0.010"
    shapiro = shapiro_wilk(weights)
    assert shapiro.statistic == pytest.approx(0.78881, abs=1e-5)
    assert shapiro.p == pytest.approx(0.00670, abs=1e-5)


def test_real_factorial_against_r(data_dir):
    """R 4.2.2 aov, bartlett.test and sf.test of the log force (naive: 10 'independent' tests)."""
    folder = data_dir / "ecoflex_compression"
    table = pd.read_csv(folder / "factorial_3x5_force6mm.csv")
    table["y"] = np.log(table["F_at_6mm_N"])
    expected = dict(pd.read_csv(folder / "factorial_3x5_logforce_expected_R.csv").to_numpy())
    result = anova(table, "y", ["family", "thinner_pct"], exact=False)
    rows = {"family": "family", "thinner": "thinner_pct", "interaction": "family:thinner_pct"}
    for key, term in rows.items():
        assert result.anova.row(term).ss == pytest.approx(expected[f"anova_{key}_ss"], rel=1e-8)
        assert result.anova.row(term).f == pytest.approx(expected[f"anova_{key}_F"], rel=1e-8)
    assert result.assumptions.bartlett.statistic == pytest.approx(expected["bartlett_K2"], rel=1e-8)
    assert result.assumptions.bartlett.df == expected["bartlett_df"]
    # R's sf.test is the same statistic squared, with ppoints(): 3/8 and 1/4 as here
    rj = result.assumptions.normality.rj
    assert rj == pytest.approx(expected["ryan_joiner_residuals"], rel=1e-7)


def simon_lesage(pairs, large):
    """Simon and Lesage sets of NIST (SmLs): nine treatments, ``1 + 2 * pairs`` values each.

    A treatment is ``c, c - 0.1, c + 0.1, ...`` about 1.4, then 1.3 and 1.5 in turn, plus a
    large integer; the values are the doubles nearest to the printed decimals.
    """
    rows = []
    for treatment in range(9):
        center = 4 if treatment == 0 else 3 if treatment % 2 else 5
        tenths = [center, *([center - 1, center + 1] * pairs)]
        rows += [(str(treatment + 1), float(f"{large + 1:.0f}.{t}")) for t in tenths]
    return pd.DataFrame(rows, columns=["treatment", "y"])


@pytest.mark.parametrize(("large", "digits"), [(0.0, 12), (999_999.0, 10), (999_999_999_999.0, 4)])
@pytest.mark.parametrize(("pairs", "f"), [(10, 21.0), (100, 201.0), (1000, 2001.0)])
def test_the_whole_nist_family(pairs, f, large, digits):
    """Certified F of all nine sets: 12 digits of the lower, 10 of the average, 4 of the higher."""
    table = simon_lesage(pairs, large)
    row = anova(table, "y", ["treatment"], exact=False).anova.row("treatment")
    assert row.f is not None
    assert log_relative_error(row.f, f) >= digits
