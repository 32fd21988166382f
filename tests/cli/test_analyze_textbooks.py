"""Printed analyses of variance through `study analyze CSV --json`; every figure with its source."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small import success

TABLES = Path(__file__).parents[2] / "validation" / "statistics"


def analyzed(table: Path, *arguments: str) -> dict[str, Any]:
    answer = success("analyze", table, *arguments, "--json")
    found: dict[str, Any] = json.loads(answer.out)
    return found


def rows(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["term"]: row for row in found["anova"]["rows"]}


def check(found: dict[str, Any], term: str, df: int, ss: float, f: float | None) -> None:
    """Compare with figures of two printed decimals."""
    row = rows(found)[term]
    assert row["df"] == df
    assert row["ss"] == pytest.approx(ss, abs=0.0051)
    if f is not None:
        assert row["f"] == pytest.approx(f, abs=0.0051)


def test_battery_life() -> None:
    """Montgomery, Design and Analysis of Experiments, 8th ed., tables 5.1 and 5.5."""
    found = analyzed(
        TABLES / "battery_life.csv", "--response", "life", "--factors", "material,temperature"
    )
    check(found, "material", 2, 10683.72, 7.91)
    check(found, "temperature", 2, 39118.72, 28.97)
    check(found, "material:temperature", 4, 9613.78, 3.56)
    check(found, "residual", 27, 18230.75, None)
    assert found["anova"]["ss_total"] == pytest.approx(77646.97, abs=0.0051)
    assert found["summary"]["r_sq_pred"] == pytest.approx(0.5826, abs=5e-5)
    assert found["summary"]["r_sq"] == pytest.approx(0.7652, abs=5e-5)


def test_etch_rate() -> None:
    """Montgomery, 8th ed., tables 3.1 and 3.4; PRESS = 8342.50 from its computer output."""
    found = analyzed(TABLES / "etch_rate.csv", "--response", "etch_rate", "--factors", "power")
    check(found, "power", 3, 66870.55, 66.80)
    check(found, "residual", 16, 5339.20, None)
    press = (1 - found["summary"]["r_sq_pred"]) * found["anova"]["ss_total"]
    assert press == pytest.approx(8342.50, abs=0.0051)
    # Tukey's critical difference, 33.09 from q = 4.05 of a table with two decimals
    pair = found["effects"][0]["pairs"][0]
    half = (pair["upper"] - pair["lower"]) / 2
    assert half == pytest.approx(33.09, abs=0.05)


def test_penicillin_yield() -> None:
    """Box, Hunter and Hunter, Statistics for Experimenters, 2nd ed., table 4.4 and its ANOVA."""
    found = analyzed(
        TABLES / "penicillin.csv", "--response", "yield", "--factors", "treatment",
        "--block", "blend", "--error", "pooled",
    )  # fmt: skip
    check(found, "blend", 4, 264.0, None)
    check(found, "treatment", 3, 70.0, 1.24)
    check(found, "residual", 12, 226.0, None)


def test_strength_of_paper() -> None:
    """Montgomery, 8th ed., tables 14.14 and 14.16: a split plot with whole-plot error 36.28."""
    found = analyzed(
        TABLES / "paper_strength.csv", "--response", "strength", "--factors", "method,temperature",
        "--block", "replicate", "--whole-plot", "method",
    )  # fmt: skip
    check(found, "method", 2, 128.39, 7.08)
    check(found, "replicate:method", 4, 36.28, None)
    # printed 36.43 and 3.15, from mean squares of two decimals
    check(found, "temperature", 3, 434.08, 36.43)
    check(found, "method:temperature", 6, 75.17, 3.15)
    check(found, "residual", 18, 71.50, None)


@pytest.mark.parametrize("name", ["SiRstv", "SmLs01", "SmLs03", "SmLs04", "AtmWtAg"])
def test_nist(data_dir: Path, tmp_path: Path, name: str) -> None:
    """NIST StRD, Analysis of Variance: certified F, from data of up to 18,009 rows."""
    import pandas as pd

    folder = data_dir / "nist_anova"
    certified = pd.read_csv(folder / "expected.csv").set_index("dataset").loc[name]
    lines = [line.split() for line in (folder / f"{name}.dat").read_text().splitlines()]
    pairs = [line for line in lines if len(line) == 2 and line[0].replace(".", "").isdigit()]
    pairs = pairs[-int(certified["n_obs"]) :]
    table = tmp_path / "nist.csv"
    table.write_text("t,y\n" + "".join(f"{t},{y}\n" for t, y in pairs))
    found = analyzed(table, "--response", "y", "--factors", "t")
    row = rows(found)["t"]
    # digits of doubles that hold the data: NIST's "average" sets lose 1e7 of 1e16
    near = 1e-9 if certified["difficulty"] == "Lower" else 1e-7
    assert row["f"] == pytest.approx(certified["f_statistic"], rel=near)
    assert row["ss"] == pytest.approx(certified["ss_between"], rel=near)
