"""`study analyze --error reml` and `--contrast`, through the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.analysis.test_mixed_model import DYESTUFF
from tests.cli.small import study


@pytest.fixture
def dyestuff(tmp_path: Path) -> Path:
    rows = [f"{batch},{value}" for batch, values in DYESTUFF.items() for value in values]
    path = tmp_path / "dyestuff.csv"
    path.write_text("batch,yield\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.verify
def test_the_scatter_of_batches_as_lme4_has_it(dyestuff: Path) -> None:
    asked = ("analyze", str(dyestuff), "--response", "yield", "--block", "batch", "--error", "reml")
    found = study(*asked, "--json").json
    batch, within = found["components"]
    # Bates et al. 2015, J. Statist. Softw. 67, 1
    assert (batch["source"], batch["sd"]) == ("batch", pytest.approx(42.0006, abs=1e-4))
    # the profile of the restricted likelihood, as tests/analysis/test_mixed_model.py computes it
    assert (batch["low"], batch["high"]) == pytest.approx((15.6572, 101.0661), rel=1e-5)
    assert within["sd"] == pytest.approx(49.5101, abs=1e-4)
    assert batch["share"] == pytest.approx(42.0006**2 / (42.0006**2 + 49.5101**2), rel=1e-4)
    shown = study(*asked).out
    assert "batch" in shown
    assert "42" in shown
    assert "15.66 to 101.1" in shown


def covaried(path: Path) -> tuple[Path, pd.DataFrame]:
    """Two gels in eight specimens, each at its own temperature; one specimen lacks a gel."""
    random = np.random.default_rng(11)
    rows = [
        (f"s{k}", gel, 20 + 3.0 * j + k, 5.0 * k + 2.0 * (gel == "stiff") + 0.25 * (20 + 3 * j + k)
         + random.normal(0, 0.1))
        for k in range(8)
        for j, gel in enumerate(("soft", "stiff"))
    ][:-1]  # fmt: skip
    table = pd.DataFrame(rows, columns=["specimen", "gel", "celsius", "force"])
    table.to_csv(path, index=False)
    return path, table


def test_a_covariate_is_read_as_a_number(tmp_path: Path) -> None:
    path, table = covaried(tmp_path / "gels.csv")
    found = study(
            "analyze", str(path), "--response", "force", "--factors", "gel", "--block", "specimen",
            "--error", "reml", "--covariates", "celsius", "--json",
    ).json  # fmt: skip
    assert found["rows"] == len(table) == 15
    (slope,) = found["slopes"]
    assert found["components"][0]["sd"] == 0.0  # then REML is least squares
    x = np.column_stack([np.ones(15), table["gel"] == "stiff", table["celsius"]])
    expected = np.linalg.lstsq(x.astype(float), table["force"].to_numpy())[0][2]
    assert slope["value"] == pytest.approx(expected, rel=1e-6)
    assert slope["low"] < slope["value"] < slope["high"]
    assert {term["term"] for term in found["terms"]} == {"gel", "celsius"}


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--random", "gel"], "add --error reml"),
        (["--error", "reml", "--unit", "gel"], "no meaning for a mixed model"),
        (["--error", "reml", "--covariates", "celcius"], "celsius"),
        (["--contrast", "stiff"], "two settings"),
        (["--contrast", "stiff - sofd"], "soft"),
    ],
)
def test_what_cannot_be_asked_says_how_to_mend_it(
    tmp_path: Path, flags: list[str], said: str
) -> None:
    path, _ = covaried(tmp_path / "gels.csv")
    common = ("--response", "force", "--factors", "gel", "--block", "specimen")
    found = study("analyze", str(path), *common, *flags)
    assert found.code == 2
    assert said in found.err


def test_a_contrast_is_the_paired_difference_of_its_cells(tmp_path: Path) -> None:
    path, table = covaried(tmp_path / "gels.csv")
    table[table["specimen"] != "s7"].to_csv(path, index=False)  # the other specimens have both
    common = ("--response", "force", "--factors", "gel", "--block", "specimen")
    asked = ("analyze", str(path), *common, "--contrast", "stiff - soft", "--practical", "1")
    (found,) = study(*asked, "--json").json["contrasts"]
    wide = table.pivot_table("force", "specimen", "gel").dropna()
    difference = (wide["stiff"] - wide["soft"]).to_numpy()
    assert found["difference"] == pytest.approx(difference.mean(), rel=1e-12)
    low, high = stats.t.interval(0.95, 6, difference.mean(), stats.sem(difference))
    assert found["ci"] == pytest.approx([low, high], rel=1e-9)
    assert found["verdict"] == "matters"
    assert "stiff - soft" in study(*asked).out


def test_a_mixed_model_has_means_verdicts_and_contrasts(tmp_path: Path) -> None:
    path, table = covaried(tmp_path / "gels.csv")
    asked = (
        "analyze", str(path), "--response", "force", "--factors", "gel", "--block", "specimen",
        "--error", "reml", "--practical", "1", "--contrast", "stiff - soft", "--covariates",
        "celsius",
    )  # fmt: skip
    found = study(*asked, "--json").json
    (effect,), (contrast,) = found["effects"], found["contrasts"]
    assert effect["verdict"] == contrast["verdict"] == "matters"
    (simple,) = effect["simple_effects"]
    assert contrast["difference"] == pytest.approx(-simple["difference"])
    assert contrast["ci"] == pytest.approx([-end for end in simple["ci"][::-1]])
    shown = study(*asked).out
    assert "Means" in shown
    assert "stiff - soft" in shown
    assert len(table) == found["rows"]


def test_random_factors_alone_make_a_study_of_precision(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rows = [
        f"{day},{run},{50 + 2 * day % 3 + run + rng.normal():.4f}"
        for day in range(6) for run in range(2) for _ in range(2)
    ]  # fmt: skip
    path = tmp_path / "precision.csv"
    path.write_text("day,run,y\n" + "\n".join(rows) + "\n", encoding="utf-8")
    asked = ("analyze", str(path), "--response", "y", "--error", "reml")
    found = study(*asked, "--random", "day,day:run", "--json").json
    assert [c["source"] for c in found["components"]] == ["day", "day:run", "within"]
    assert found["effects"] == []
    refused = study(*asked)
    assert refused.code == 2
    assert "--random day,day:run" in refused.err
