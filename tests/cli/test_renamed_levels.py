"""A level that got another name computes nothing again, and is shown under its new one."""

from __future__ import annotations

from pathlib import Path

import pytest

from study import api
from tests.cli.small import DESIGN, study


def means(home: Path) -> dict[tuple[str, str], float]:
    """Mean score of every cell, by its labels."""
    table = api.load(home / "results" / "small").table
    found = table.groupby(["material", "range"])["relative_rms_force_error"].mean()
    return {(str(a), str(b)): float(mean) for (a, b), mean in found.items()}


def run_again(home: Path, text: str) -> str:
    """Change the design and run it; what the run said."""
    (home / "small.toml").write_text(text)
    answer = study("run", "small.toml", "--data", "data", "--jobs", 1)
    assert answer.code == 0, answer.err
    return answer.out + answer.err


@pytest.mark.parametrize(
    ("small", "large"),
    [("short", "large"), ("large", "small")],
    ids=["a new name", "names that change places"],
)
def test_labels_are_those_of_the_design_not_of_the_records(
    done: Path, small: str, large: str
) -> None:
    """Names are no content: records that name the former ones stay, and must not be believed."""
    before = means(done)
    records = {path: path.read_bytes() for path in done.rglob("record.json")}
    text = DESIGN.replace("[presets.range.small]", f"[presets.range.{small}-]")
    text = text.replace("[presets.range.large]", f"[presets.range.{large}]").replace("-]", "]")
    text = text.replace('range = ["small", "large"]', f'range = ["{small}", "{large}"]')
    said = run_again(done, text)
    assert "could not be written" not in said
    assert {path: path.read_bytes() for path in done.rglob("record.json")} == records
    new = {"small": small, "large": large}
    assert means(done) == {(a, new[b]): mean for (a, b), mean in before.items()}


def test_a_renamed_factor_is_shown_under_its_new_name(done: Path) -> None:
    text = DESIGN.replace("presets.range.", "presets.depth.").replace('range = ["s', 'depth = ["s')
    run_again(done, text)
    table = api.load(done / "results" / "small").table
    assert set(table["depth"]) == {"small", "large"}
    assert "range" not in table
