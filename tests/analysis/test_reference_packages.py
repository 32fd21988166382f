"""Simple effects, named contrasts, variance components and a surface against packages of R.

Other code: emmeans 1.8.4, lme4 1.1.31 and lm of R 4.2.2; figures of
validation/statistics/reference_packages.R. What is solved directly is compared at 1e-8; variance
components come from two optimizers, at 1e-5.
"""

from __future__ import annotations

from functools import cache

import pandas as pd
import pytest
from scipy import stats

import study
from tests.conftest import ROOT

FOLDER = ROOT / "validation" / "statistics"
SAME = 1e-8


@cache
def reference() -> dict[tuple[str, ...], float]:
    table = pd.read_csv(FOLDER / "reference_packages.csv", comment="#", keep_default_na=False)
    keys = table[["design", "analysis", "term", "quantity"]].itertuples(index=False, name=None)
    return dict(zip(keys, table["value"].astype(float), strict=True))


def crossed(design: str) -> pd.DataFrame:
    table = pd.read_csv(FOLDER / "crossed.csv")
    return table[table["keep"] == 1] if design.endswith("unbalanced") else table


@pytest.mark.parametrize("design", ["crossed", "crossed-unbalanced"])
def test_simple_effects_are_those_of_emmeans(design: str) -> None:
    found = study.anova(crossed(design), "y", ["a", "b", "c"], practical=1.0, exact=False)
    effects = found.effect("a").simple_effects
    assert len(effects) == 3 * 4  # three pairs at four settings
    for one in effects:
        at = dict(one.at)
        term = f"{one.first}-{one.second}|{at['b']}|{at['c']}"
        r = {q: reference()[design, "simple", term, q] for q in ("difference", "error", "df")}
        assert one.difference == pytest.approx(r["difference"], rel=SAME)
        assert one.ci is not None
        half = stats.t.ppf(0.975, r["df"]) * r["error"]
        assert (one.ci[1] - one.ci[0]) / 2 == pytest.approx(half, rel=SAME)


@pytest.mark.parametrize("design", ["crossed", "crossed-unbalanced"])
def test_a_named_contrast_is_that_of_emmeans(design: str) -> None:
    found = study.anova(crossed(design), "y", ["a", "b", "c"], practical=1.0, exact=False)
    (one,) = study.contrasts(found, "a=a1, b=b1 - a=a1, b=b2")
    r = {q: reference()[design, "contrast", "a1|b1-a1|b2", q] for q in ("estimate", "p.value")}
    assert one.difference == pytest.approx(r["estimate"], rel=SAME)
    assert one.p == pytest.approx(r["p.value"], rel=SAME)


def test_variance_components_of_incomplete_blocks_are_those_of_lme4() -> None:
    table = pd.read_csv(FOLDER / "incomplete.csv")
    blocks, within = study.mixed_model(table, "y", ["t"], block="k").components
    assert blocks.sd == pytest.approx(reference()["incomplete", "reml", "k", "sd"], rel=1e-5)
    assert within.sd == pytest.approx(reference()["incomplete", "reml", "within", "sd"], rel=1e-5)


def test_a_second_order_surface_is_that_of_lm() -> None:
    ranges = ["time_min=80..90", "temperature_F=170..180"]
    surface = study.fit_surface(FOLDER / "chemical_process.csv", "yield", ranges).to_json()
    found = surface["surface"]
    told = {t["term"].replace("time_min", "x").replace("temperature_F", "z"): t["coefficient"]
            for t in found["terms"]}  # fmt: skip
    names = {"1": "1", "x": "x", "z": "z", "x^2": "x^2", "z^2": "z^2", "x:z": "x*z"}

    def of_r(term: str, quantity: str) -> float:
        return reference()["chemical_process", "surface", term, quantity]

    expected = {ours: of_r(theirs, "coefficient") for ours, theirs in names.items()}
    assert told == pytest.approx(expected, rel=SAME)
    point = found["stationary"]
    assert point["coded"] == pytest.approx([of_r(n, "stationary") for n in "xz"], rel=SAME)
    eigenvalues = [of_r(k, "eigenvalue") for k in "12"]
    assert sorted(point["eigenvalues"]) == pytest.approx(eigenvalues, rel=SAME)
    assert found["lack_of_fit"]["F"] == pytest.approx(of_r("", "lack_of_fit_F"), rel=SAME)
    assert found["lack_of_fit"]["p"] == pytest.approx(of_r("", "lack_of_fit_p"), rel=SAME)
