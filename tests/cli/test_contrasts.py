"""Differences that a design names, from the file to JSON, terminal and report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from tests.cli.small import Edit, refusal, study, success
from tests.pages import both_pages

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
    run = success("run", "small.toml", "--data", "data", "--jobs", 1, "--json")
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

    page = both_pages(report)
    assert "Differences that were asked for" in page
    raw = pd.read_csv(
        report.with_name("small-data") / "table-contrasts-relative-rms-force-error.csv"
    )
    assert raw["difference"].tolist() == [one["difference"] for one in found]
    said = study("report", "small").out
    assert "relative RMS force error: asked for" in said
    assert "Holm's p" in said
    assert "small - large" in said


def test_the_page_of_a_table_has_them_and_its_line_makes_it_again(tmp_path: Path) -> None:
    rows = ["a,b,y", *(f"{a},{b},{x + 2 * y + e}" for x, a in enumerate("pq")
                       for y, b in enumerate("uv") for e in (-0.1, 0.1))]  # fmt: skip
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    out = tmp_path / "out"
    asked = ("a=p, b=v - a=p, b=u", "q - p")
    flags = [word for text in asked for word in ("--contrast", text)]
    found = success("analyze", tmp_path / "t.csv", "--response", "y", "--factors", "a,b",
                    *flags, "--report", out)  # fmt: skip
    raw = pd.read_csv(next(out.rglob("table-contrasts-y.csv")))
    assert raw["contrast"].tolist() == list(asked)
    # by construction: two of b, one of a; four runs a side, pooled variance .02 on 4 df
    assert raw["difference"].tolist() == pytest.approx([2.0, 1.0])
    half = stats.t.ppf(1 - 0.025 / 2, 4) * np.sqrt(0.02 * (1 / 2 + 1 / 2))
    assert raw["high"][0] - raw["difference"][0] == pytest.approx(half, rel=1e-9)
    # Holm of two: the smaller p counts twice, and the larger one is never below that
    p = raw["p"].to_numpy()
    assert raw["p_holm"].tolist() == pytest.approx([2 * p[0], max(2 * p[0], p[1])], rel=1e-12)
    assert "Holm's p" in found.out
    page = both_pages(min(out.glob("*.html"), key=lambda path: len(path.name)))
    assert "Holm&#39;s p" in page or "Holm's p" in page
    assert "--contrast" in page
    assert "Differences that were asked for" in page


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
    found = refusal("plan", "small.toml", "--data", "data")
    assert "analysis.contrasts" in found.err
    assert rule in found.err


def test_a_difference_of_cells_left_out_is_refused_before_anything_runs(edit: Edit) -> None:
    edit(
        "[report]",
        f"{ASKED}[[exclude]]\n"
        'when = { material = "mooney-rivlin", range = "large" }\nwhy = "not measured"\n[report]',
    )
    found = refusal("run", "small.toml", "--data", "data", "--jobs", 1)
    assert "no cell that is run has material=mooney-rivlin, range=large" in found.err
    assert not Path("results").exists()
