"""The page of a surface over numeric factors, against closed forms and published coefficients."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.cli.small import Finished, study
from tests.cli.test_numeric_factors import _force, _shares


def _words(page: Path) -> str:
    text = re.sub(
        r"<svg.*?</svg>|<style.*?</style>|<script.*?</script>", "", page.read_text(), flags=re.S
    )
    plain = re.sub(r"<[^>]+>", " ", text).replace("\N{NARROW NO-BREAK SPACE}", " ")
    return re.sub(r"\s+", " ", plain.replace("\N{NO-BREAK SPACE}", " "))


@pytest.fixture
def ranged(ranges: Finished) -> Path:
    return ranges.folder / "reports" / "ranges"


def test_the_answer_names_the_factors_by_what_they_do(ranged: Path) -> None:
    words = _words(ranged / "ranges.html")
    answer = words[words.index("Answer Peak force") :].split("What would change")[0]
    found = re.search(
        r"C10 changes it by up to ([\d.]+) N, radius by up to ([\d.]+) N and height by up to "
        r"([\d.]+) N",
        answer,
    )
    assert found is not None, answer
    # the force is a product of three factors that grow or fall throughout, so the range along one
    # follows from its ends; 95 % of the settings of the other two stay below it
    rng = np.random.default_rng(1)
    c10, radius, height = rng.uniform([5, 9, 18], [10, 11, 22], (100_000, 3)).T
    exact = (
        _force(10, radius, height) - _force(5, radius, height),
        _force(c10, 11, height) - _force(c10, 9, height),
        _force(c10, radius, 18) - _force(c10, radius, 22),
    )
    for told, own in zip(found.groups(), exact, strict=True):
        assert float(told) == pytest.approx(float(np.quantile(own, 0.95)), rel=0.02)
    assert "C10, radius and height matter" in answer
    details = (ranged / "ranges-details.html").read_text()
    assert "Not analyzed" not in details
    assert "<h2>Error term" not in details


def test_its_pictures_hold_the_closed_form(ranged: Path) -> None:
    data = ranged / "ranges-data"
    along = pd.read_csv(data / "figure-surface-peak-force-profiles.csv")
    middle = {"material.C10": 7.5, "specimen.radius": 10.0, "specimen.height": 20.0}
    for name, part in along.groupby("factor"):
        at = {**{k: np.full(len(part), v) for k, v in middle.items()}}
        at[str(name)] = part["setting"].to_numpy() * (10 if name == "specimen.radius" else 1)
        exact = _force(*at.values())
        assert ((part["low"] <= exact) & (exact <= part["high"])).all(), name
    over = pd.read_csv(data / "figure-surface-peak-force-contours.csv")
    assert list(over.columns) == ["material.C10", "specimen.radius", "value"]
    exact = _force(over["material.C10"], 10 * over["specimen.radius"], 20.0)
    assert np.allclose(over["value"], exact, rtol=0.005)
    left = pd.read_csv(data / "figure-surface-peak-force-left-out.csv")
    assert len(left) == 30
    assert np.abs(left["simulated"] - left["predicted"]).max() < 0.01
    assert left["simulated"].nunique() == 30
    shares = pd.read_csv(data / "figure-surface-peak-force-shares.csv").set_index("factor")
    for name, share in zip(middle, _shares(), strict=True):
        assert shares.loc[name, "low"] <= share <= shares.loc[name, "high"]


#: Montgomery, Design and Analysis of Experiments, chapter 11: yield over time and temperature
YIELD = """time,temperature,yield
80,170,76.5
80,180,77.0
90,170,78.0
90,180,79.5
85,175,79.9
85,175,80.3
85,175,80.0
85,175,79.7
85,175,79.8
92.07,175,78.4
77.93,175,75.6
85,182.07,78.5
85,167.93,77.0
"""


def test_a_table_has_the_same_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "yield.csv").write_text(YIELD)
    answer = study(
        "analyze", "yield.csv", "--response", "yield", "--numeric",
        "time=80..90,temperature=170..180", "--report", "out", "--json",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    page = tmp_path / answer.json["report"]
    assert "The largest prediction in these ranges is 80.2" in _words(page)
    words = _words(page.with_stem(f"{page.stem}-details"))
    # published: 79.94 + .995 x1 + .515 x2 - 1.376 x1^2 - 1.001 x2^2 + .250 x1 x2, a maximum of
    # 80.21 at x1 = .389, x2 = .306 (87 minutes, 176.5 F)
    table = pd.read_csv(next(page.parent.glob("*-data/table-coefficients-yield.csv")))
    told = dict(zip(table["term"], table["coefficient"], strict=True))
    published = {"1": 79.94, "time": 0.995, "temperature": 0.515, "time^2": -1.376}
    for term, value in published.items():
        shown = float(str(told[term]).replace("\N{MINUS SIGN}", "-"))
        assert shown == pytest.approx(value, abs=0.002), term
    assert "level at a maximum of 80.2, inside the ranges: time 86.9 and temperature 177" in words
    assert "Failures" not in words
    assert "study analyze yield.csv" in words


def test_a_surface_that_cannot_rank_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(5)
    frame = pd.DataFrame(rng.uniform(size=(40, 2)), columns=["a", "b"]).assign(
        y=rng.normal(size=40)
    )
    frame.to_csv("noise.csv", index=False)
    answer = study("analyze", "noise.csv", "--response", "y", "--numeric", "a,b", "--report", "out")
    assert answer.code == 0, answer.err
    assert "fail Surface predicts runs left out" in _words(tmp_path / "out" / "noise.html")
    words = _words(tmp_path / "out" / "noise-details.html")
    assert "do not carry an emulator that could rank the factors: add runs" in words


def test_a_format_without_a_page_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "yield.csv").write_text(YIELD)
    asked = ["analyze", "yield.csv", "--response", "yield", "--numeric", "time,temperature"]
    answer = study(*asked, "--report", "out", "--format", "word")
    assert answer.code == 2
    assert "word" in answer.err
    assert not (tmp_path / "out").exists()
