"""Differences that a design names, from the file to JSON, terminal and report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.cli.small import Edit, study

ASKED = (
    '[analysis]\ncontrasts = ["material=neo-hookean, range=large - '
    'material=mooney-rivlin, range=large", "small - large"]\n'
)


@pytest.fixture
def asked(edit: Edit, home: Path) -> Path:
    """Working folder of a design that names two differences."""
    edit("[report]", f"{ASKED}[report]")
    edit('format = ["csv"]', 'format = ["html", "csv"]')
    return home


def by_hand(cases: pd.DataFrame, first: dict[str, str], second: dict[str, str]) -> np.ndarray:  # type: ignore[type-arg]
    """Difference of two settings in every block, from the table of cases."""

    def mean(setting: dict[str, str]) -> pd.Series:
        kept = cases
        for name, level in setting.items():
            kept = kept[kept[name] == level]
        return kept.groupby("block")["relative_rms_force_error"].mean()

    return (mean(first) - mean(second)).to_numpy()


def test_a_study_answers_the_differences_that_it_names(asked: Path) -> None:
    run = study("run", "small.toml", "--data", "data", "--jobs", 1, "--json")
    assert run.code == 0, run.err
    report = Path(run.json["report"])
    cases = pd.read_csv(report.with_name("small-data") / "cases.csv", dtype={"block": str})
    settings = [
        ({"material": "neo-hookean", "range": "large"},
         {"material": "mooney-rivlin", "range": "large"}),
        ({"range": "small"}, {"range": "large"}),
    ]  # fmt: skip
    found = run.json["contrasts"]
    assert len(found) == 2
    for one, (first, second) in zip(found, settings, strict=True):
        # three mixes: Student's t of the difference in each of them
        d = by_hand(cases, first, second)
        half = stats.t.ppf(0.975, 2) * d.std(ddof=1) / np.sqrt(3)
        assert one["response"] == "relative_rms_force_error"
        assert one["difference"] == pytest.approx(d.mean(), rel=1e-9)
        assert one["ci"] == pytest.approx([d.mean() - half, d.mean() + half], rel=1e-9)
        assert one["p"] == pytest.approx(stats.ttest_1samp(d, 0).pvalue, rel=1e-9)
        assert one["ci_simultaneous"][0] <= one["ci"][0]

    page = report.read_text(encoding="utf-8")
    assert "Differences that were asked for" in page
    raw = pd.read_csv(
        report.with_name("small-data") / "table-contrasts-relative-rms-force-error.csv"
    )
    assert raw["difference"].tolist() == [one["difference"] for one in found]
    said = study("report", "small").out
    assert "relative RMS force error: asked for" in said
    assert "small - large" in said


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ('["small - huge"]', "no level 'huge'"),
        ('["small"]', "needs two settings with ' - ' between"),
        ('["small - small"]', "compares a setting with itself"),
        ('"small - large"', "must be a list of contrasts"),
    ],
)
def test_a_difference_that_the_design_has_not_is_refused(edit: Edit, text: str, rule: str) -> None:
    edit("[report]", f"[analysis]\ncontrasts = {text}\n[report]")
    found = study("plan", "small.toml", "--data", "data")
    assert found.code == 2
    assert "analysis.contrasts" in found.err
    assert rule in found.err


def test_a_difference_of_cells_left_out_is_refused_before_anything_runs(edit: Edit) -> None:
    edit(
        "[report]",
        f"{ASKED}[[exclude]]\n"
        'when = { material = "mooney-rivlin", range = "large" }\nwhy = "not measured"\n[report]',
    )
    found = study("run", "small.toml", "--data", "data", "--jobs", 1)
    assert found.code == 2
    assert "no cell that is run has material=mooney-rivlin, range=large" in found.err
    assert not Path("results").exists()
