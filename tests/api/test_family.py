"""Families of tests, through the study that declares them."""

from __future__ import annotations

from pathlib import Path

import pytest
from statsmodels.stats.multitest import multipletests

from study import api
from study.ground.errors import InputError
from study.harness.design.load import load
from tests.conftest import ROOT

RANGES = str(ROOT / "designs" / "ecoflex-range.toml")


def p_of(folder: Path, data_dir: Path, *overrides: str) -> list[dict[str, object]]:
    found = api.run(RANGES, data=data_dir, results=folder, jobs=1, overrides=list(overrides))
    return found.verdicts


@pytest.mark.slow
@pytest.mark.verify
def test_all_responses_of_a_study_are_one_family(tmp_path: Path, data_dir: Path) -> None:
    if not (data_dir / "ecoflex_compression").is_dir():
        pytest.skip("the Ecoflex measurements are not in the data folder (set STUDY_DATA)")
    rows = p_of(tmp_path, data_dir, 'analysis.family="study"')
    expected = multipletests([row["p"] for row in rows], method="holm")[1]
    assert [row["p_holm"] for row in rows] == pytest.approx(expected)
    primary = p_of(tmp_path, data_dir, 'analysis.primary=["material"]')
    for row in primary:
        assert row["p_holm"] == (row["p"] if row["factor"] == "material" else None)


@pytest.mark.parametrize(
    ("override", "rule"),
    [
        ('analysis.family="world"', "world"),
        ('analysis.primary=["plates"]', "no factor 'plates'"),
        ('analysis.primary=["material","range","material:range","a"]', "at most 3"),
    ],
)
def test_a_wrong_family_is_named(override: str, rule: str) -> None:
    with pytest.raises(InputError, match=rule):
        load(RANGES, overrides=[override])
