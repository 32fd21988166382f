"""A run sheet through ``study plan``: complete, random within specimens, never overwritten."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

from study.cli.app import run
from tests.conftest import ROOT

DEMO = str(ROOT / "designs" / "demo.toml")


def test_each_specimen_meets_each_physical_condition_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "trials.csv"
    assert run(["plan", DEMO, "--run-sheet", str(out), "--specimens", "40", "--json"]) == 0
    assert "80 trials" in capsys.readouterr().err
    sheet = pd.read_csv(out)
    # energies and spaces are simulated: only the plates change in the laboratory
    assert [c for c in sheet if c in ("material", "plates", "model.space")] == ["plates"]
    assert Counter(zip(sheet["specimen"], sheet["plates"], strict=True)) == Counter(
        (k, p) for k in range(1, 41) for p in ("frictionless", "bonded")
    )
    first = sheet.groupby("specimen")["plates"].first().value_counts()
    # binomial(40, 1/2): 8 to 32 is four standard deviations
    assert 8 < first["bonded"] < 32
    assert sheet["run"].tolist() == list(range(1, 81))


def test_a_sheet_in_use_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "trials.csv"
    out.write_text("run\n1\n")
    assert run(["plan", DEMO, "--run-sheet", str(out)]) == 2
    assert "not overwritten" in capsys.readouterr().err
    assert out.read_text() == "run\n1\n"


def test_a_study_without_a_physical_factor_has_no_sheet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "trials.csv"
    noise = str(ROOT / "designs" / "noise.toml")
    assert run(["plan", noise, "--run-sheet", str(out)]) == 2
    assert "nothing to randomize" in capsys.readouterr().err
    assert not out.exists()
