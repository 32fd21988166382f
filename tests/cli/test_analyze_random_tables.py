"""Any table of any quality: an answer in valid JSON, or a sentence that names what to mend."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import study, success
from validation import fuzz
from validation.fuzz_inputs import Place, tables

#: tables in the suite, and in `make verify`
FEW = 30
MANY = 10_000
NOT_A_NUMBER = re.compile(r"(?<!\w)(nan|-?inf)(?!\w)", re.ASCII)


def not_json(constant: str) -> float:
    raise AssertionError(f"{constant} in JSON")


def answered(seed: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Analyze one table of the fuzz campaign; whether there was an answer, and no refusal."""
    project = folder / str(seed)
    project.mkdir()
    monkeypatch.chdir(project)
    (words, *_), _ = tables(np.random.default_rng(seed), project, Place(str(folder), str(folder)))
    answer = study(*words)
    assert not list(fuzz.wrong(answer.code, answer.out, answer.err)), (seed, answer.err)
    assert not list(fuzz.written(project)), seed
    if answer.code > 1:
        assert not answer.out, seed
    elif "--json" in words:
        json.loads(answer.out, parse_constant=not_json)
    else:
        assert not NOT_A_NUMBER.search(answer.out), seed
    return answer.code == 0


def test_random_tables_are_answered_or_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = sum(answered(seed, tmp_path, monkeypatch) for seed in range(FEW))
    # tables that only were refused would show nothing of the analysis
    assert good > FEW // 8


@pytest.mark.slow
@pytest.mark.verify
def test_many_random_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = sum(answered(seed, tmp_path, monkeypatch) for seed in range(FEW, MANY))
    assert good > MANY // 8


def test_rows_that_are_fitted_exactly_have_a_page(tmp_path: Path) -> None:
    """Leverage one leaves 0 / 0 for Cook's distance: such rows once lost the figure."""
    rows = ["a,b,y", "p,u,1", "p,v,2.5", "p,v,3", "q,u,4", "q,u,5.5", "q,v,6", "q,v,7"]
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    answer = success("analyze", tmp_path / "t.csv", "y ~ a * b", "--report", tmp_path / "page")
    page = Path(answer.out.rpartition("report: ")[2].strip())
    assert "Figure missing" not in page.with_stem(f"{page.stem}-details").read_text("utf-8")
