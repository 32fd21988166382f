"""REML against lme4's published figures, statsmodels, and designs whose answer is known exactly."""

from __future__ import annotations

import warnings
from itertools import product

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from scipy.stats import multivariate_normal

import study
from study.analysis.error.restricted_likelihood import Likelihood
from study.errors import InputError

#: yield of dyestuff by batch (Davies 1947, Statistical Methods in Research and Production)
DYESTUFF = {
    "A": [1545, 1440, 1440, 1520, 1580],
    "B": [1540, 1555, 1490, 1560, 1495],
    "C": [1595, 1550, 1605, 1510, 1560],
    "D": [1445, 1440, 1595, 1465, 1545],
    "E": [1595, 1630, 1515, 1635, 1625],
    "F": [1520, 1455, 1450, 1480, 1445],
}


def test_the_dyestuff_of_davies_as_lme4_has_it() -> None:
    """Bates et al. 2015, J. Statist. Softw. 67: REML 42.00 and 49.51, criterion 319.6543.

    Their criterion leaves out log |X'X| = log 30. Intervals are those of R's confint.
    """
    rows = [(batch, value) for batch, values in DYESTUFF.items() for value in values]
    table = pd.DataFrame(rows, columns=["batch", "y"])
    found = study.mixed_model(table, "y", [], block="batch")
    batch, within = found.components
    assert (batch.sd, within.sd) == pytest.approx((42.0006, 49.5101), abs=1e-4)
    assert (batch.low, batch.high) == pytest.approx((12.1975, 84.0634), rel=2e-4)
    assert (within.low, within.high) == pytest.approx((38.2300, 67.6577), rel=2e-4)
    assert found.deviance == pytest.approx(319.6543 - np.log(30), abs=1e-4)


def blocked(seed: int = 1, blocks: int = 8) -> pd.DataFrame:
    random = np.random.default_rng(seed)
    rows = [
        (a, k, 3.0 * (a == "z") + scatter + random.normal(0, 1))
        for k, scatter in enumerate(random.normal(0, 2, blocks))
        for a in "xyz"
    ]
    return pd.DataFrame(rows, columns=["a", "block", "y"])


def test_complete_blocks_give_the_table_of_randomized_blocks() -> None:
    table = blocked()
    (term,) = study.mixed_model(table, "y", ["a"], block="block").terms
    row = study.anova(table, "y", ["a"], block="block", error="pooled", exact=False).anova.row("a")
    assert (term.f, term.df_error, term.p) == pytest.approx((row.f, 14, row.p), rel=1e-5)


def test_incomplete_blocks_as_statsmodels_fits_them() -> None:
    """A balanced incomplete design: four treatments in blocks of three."""
    random = np.random.default_rng(4)
    scatter = random.normal(0, 1.5, 8)
    rows = [
        ("wxyz"[a], k, a + scatter[k] + random.normal(0, 0.7))
        for k, a in product(range(8), range(4))
        if a != k % 4
    ]
    table = pd.DataFrame(rows, columns=["a", "block", "y"])
    found = study.mixed_model(table, "y", ["a"], block="block")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = smf.mixedlm("y ~ C(a)", table, groups=table["block"]).fit(
            reml=True, method="bfgs", gtol=1e-8
        )
    block, within = found.components
    assert block.sd**2 == pytest.approx(float(other.cov_re.iloc[0, 0]), rel=2e-4)
    assert within.sd**2 == pytest.approx(float(other.scale), rel=1e-4)
    # its standard errors are those of the joint Hessian: the covariance is formed here
    x, z = other.model.exog, np.eye(8)[table["block"]]
    v = other.scale * np.eye(len(table)) + float(other.cov_re.iloc[0, 0]) * z @ z.T
    c = np.linalg.inv(x.T @ np.linalg.solve(v, x))[1:, 1:]
    beta = other.fe_params.to_numpy()[1:]
    (term,) = found.terms
    assert term.f == pytest.approx(float(beta @ np.linalg.solve(c, beta)) / 3, rel=3e-4)
    # between the intrablock 24 - 8 - 3 and all rows
    assert 13 <= term.df_error <= 20


def test_no_scatter_between_blocks_is_the_boundary() -> None:
    table = blocked(3)
    table["y"] -= table.groupby("block")["y"].transform("mean")
    block, within = study.mixed_model(table, "y", ["a"], block="block").components
    assert (block.sd, block.low) == (0.0, 0.0)
    assert block.high > 0
    assert within.share == 1.0


def test_an_interaction_with_the_blocks_is_a_component() -> None:
    """The mean square of the interaction exceeds that within by 4 times its variance."""
    random = np.random.default_rng(6)
    own = random.normal(0, 1.0, (10, 3))
    rows = [
        ("xyz"[a], k, own[k, a] + random.normal(0, 0.5))
        for k, a, _ in product(range(10), range(3), range(4))
    ]
    table = pd.DataFrame(rows, columns=["a", "block", "y"])
    found = study.mixed_model(table, "y", ["a"], block="block", random=["a"])
    cells = table.groupby(["block", "a"])["y"]
    within = float(cells.var().mean())
    by = {c.source: c for c in found.components}
    assert by["within"].sd ** 2 == pytest.approx(within, rel=1e-4)
    assert by["block:a"].low < 1.0 < by["block:a"].high
    # the term is tested against the interaction: 2 and 18 degrees of freedom
    assert found.terms[0].df_error == pytest.approx(18, rel=0.2)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"block": "none"}, "none"),
        ({"random": ["b"]}, "'b' is no factor"),
    ],
)
def test_what_cannot_be_fitted_is_named(change: dict[str, object], rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        study.mixed_model(blocked(), "y", ["a"], **({"block": "block"} | change))


def test_two_blocks_are_too_few() -> None:
    with pytest.raises(InputError, match="needs three"):
        study.mixed_model(blocked(blocks=2), "y", ["a"], block="block")


def test_a_covariate_within_blocks_has_the_slope_of_least_squares() -> None:
    """Blocks as fixed effects tell the same slope where the covariate is balanced over them."""
    random = np.random.default_rng(7)
    x = np.array([-1.0, 0.0, 2.0, 5.0])
    rows = [
        (a, k, value, 2.0 * value + 3.0 * (a == "z") + 4 * k + random.normal(0, 0.5))
        for k, a, value in product(range(6), "yz", x)
    ]
    table = pd.DataFrame(rows, columns=["a", "block", "x", "y"])
    found = study.mixed_model(table, "y", ["a"], block="block", covariates=["x"])
    other = smf.ols("y ~ C(a) + C(block) + x", table).fit()
    (slope,) = found.slopes
    low, high = other.conf_int().loc["x"]
    assert (slope.value, slope.low, slope.high) == pytest.approx(
        (other.params["x"], low, high), rel=1e-6
    )
    assert [term.term for term in found.terms] == ["a", "x"]
    assert found.terms[1].f == pytest.approx(other.tvalues["x"] ** 2, rel=1e-6)


@pytest.mark.parametrize(
    ("column", "rule"),
    [
        ("tx", "no such column"),
        ("a", "already"),
        ("text", "text"),
        ("gap", "row 3"),
        ("flat", "never"),
    ],
)
def test_a_covariate_that_is_none_is_refused(column: str, rule: str) -> None:
    table = blocked().assign(text="warm", flat=1.0, gap=1.0)
    table.loc[2, "gap"] = np.nan
    with pytest.raises(InputError, match=rule):
        study.mixed_model(table, "y", ["a"], block="block", covariates=[column])


@pytest.mark.parametrize("alpha", [float("nan"), 0.0, 1.0, 1e-300])
def test_an_impossible_error_probability_is_refused(alpha: float) -> None:
    table = pd.DataFrame({"a": ["x", "y"] * 4, "b": list("ppqqrrss"), "y": np.arange(8.0)})
    with pytest.raises(InputError, match="alpha: must be between"):
        study.mixed_model(table, "y", ["a"], block="b", alpha=alpha)


def test_a_response_that_never_changes_is_refused_in_words() -> None:
    table = pd.DataFrame({"a": ["x", "y"] * 4, "b": list("ppqqrrss"), "y": 1e9})
    with pytest.raises(InputError, match="response: is the same in every row"):
        study.mixed_model(table, "y", ["a"], block="b")


@pytest.mark.parametrize("kept", [slice(None), slice(0, 45)])
def test_the_likelihood_is_that_of_a_normal_vector(kept: slice) -> None:
    """The rows are turned block by block; the density of all rows at once needs none of that."""
    rng = np.random.default_rng(5)
    block, part = np.divmod(np.repeat(np.arange(12), 5)[kept], 3)
    x = np.column_stack([np.ones(block.size), part, rng.normal(size=block.size)])
    random = (np.eye(block.max() + 1)[block], np.eye(12)[block * 3 + part])
    y = 3.0 + rng.normal(size=block.size)
    likelihood = Likelihood(y, x, random)
    for sd in ([0.7, 0.4, 1.1], [0.0, 2.0, 0.05], [0.0, 0.0, 1.0]):
        v = likelihood.covariance(np.array(sd))
        beta = np.linalg.solve(x.T @ np.linalg.solve(v, x), x.T @ np.linalg.solve(v, y))
        dense = -2 * multivariate_normal(x @ beta, v).logpdf(y)
        assert likelihood.deviance(np.array(sd), restricted=False) == pytest.approx(dense, rel=1e-9)
