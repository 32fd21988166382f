"""Any table of any quality: an answer in valid JSON, or a sentence that names what to mend."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.random_tables import random_table
from tests.cli.small import Answer, study

#: tables in the suite, and in `make verify`
FEW = 80
MANY = 10_000
#: every so many tables are shown as text, and as a page
TEXT = 3
PAGE = 50
NOT_A_NUMBER = re.compile(r"(?<!\w)(nan|-?inf)(?!\w)", re.ASCII)


def not_json(constant: str) -> float:
    raise AssertionError(f"{constant} in JSON")


def examine(seed: int, folder: Path, *, page: bool = False) -> int:
    """Analyze one table; give back the exit code."""
    page = page or seed % PAGE == 0
    table = random_table(seed)
    source = folder / "t.csv"
    source.write_bytes(table.data)
    arguments = ["analyze", source, *table.arguments]
    if page:
        answer = study(*arguments, "--report", folder / "page")
    else:
        answer = study(*arguments, *([] if seed % TEXT == 0 else ["--json"]))
    assert answer.code in (0, 2, 3), (seed, answer.err)
    if answer.code:
        assert not answer.out, seed
        assert len(answer.err.splitlines()) >= 2, seed  # "error:" and a sentence
    elif page:
        check_page(seed, answer)
    elif seed % TEXT == 0:
        assert not NOT_A_NUMBER.search(answer.out), seed
    else:
        json.loads(answer.out, parse_constant=not_json)
    return answer.code


def check_page(seed: int, answer: Answer) -> None:
    text = Path(answer.out.rpartition("report: ")[2].strip()).read_text(encoding="utf-8")
    assert "Figure missing" not in text, seed
    assert not re.search(r">\s*(nan|-?inf)\s*<", text), seed


def test_random_tables_are_answered_or_refused_in_words(tmp_path: Path) -> None:
    codes = [examine(seed, tmp_path) for seed in range(FEW)]
    # tables that only were refused would show nothing of the analysis
    assert codes.count(0) > FEW // 8


@pytest.mark.slow
@pytest.mark.verify
def test_many_random_tables(tmp_path: Path) -> None:
    codes = [examine(seed, tmp_path) for seed in range(FEW, MANY)]
    assert codes.count(0) > MANY // 4


def test_rows_that_are_fitted_exactly_have_a_page(tmp_path: Path) -> None:
    """Leverage one leaves 0 / 0 for Cook's distance: such rows once lost the figure."""
    assert examine(3135, tmp_path, page=True) == 0
