"""What ``study analyze`` can be asked in one line: a formula, Welch's analysis, moments alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import study
from study.cli.app import run
from study.ground.errors import InputError
from study.statistics.analysis.linear_model import read_formula


@pytest.fixture
def table(tmp_path: Path) -> Path:
    rows = pd.MultiIndex.from_product([range(4), list("pq"), list("xyz")], names=["s", "a", "b"])
    frame = rows.to_frame(index=False)
    noise = np.random.default_rng(8).normal(0, 0.3, len(frame))
    frame["y"] = 5 + (frame["a"] == "q") + 0.2 * frame["s"] + noise
    path = tmp_path / "rows.csv"
    frame.to_csv(path, index=False)
    return path


def asked(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    assert run(["analyze", *words, "--json"]) == 0
    document: dict[str, object] = json.loads(capsys.readouterr().out)
    return document


@pytest.mark.parametrize(
    ("formula", "flags"),
    [
        ("y ~ a * b", ["--factors", "a,b"]),
        ("y ~ a + b", ["--factors", "a,b", "--model", "a,b"]),
        ("log(y) ~ (a + b)^2 - a:b", ["--factors", "a,b", "--model", "1", "--transform", "log"]),
        ("y ~ a * b + Error(s)", ["--factors", "a,b", "--block", "s"]),
        ("y ~ a * b + (1 | s)", ["--factors", "a,b", "--block", "s"]),
        ("y ~ a / b + Error(s/a)", ["--factors", "a,b", "--model", "a,a:b", "--block", "s",
                                    "--whole-plot", "a"]),
    ],
)  # fmt: skip
def test_a_formula_says_what_the_flags_say(
    table: Path, capsys: pytest.CaptureFixture[str], formula: str, flags: list[str]
) -> None:
    one = asked(capsys, str(table), formula)
    other = asked(capsys, str(table), "--response", "y", *flags)
    assert one["anova"] == other["anova"]
    assert one["effects"] == other["effects"]


@pytest.mark.parametrize("formula", ["y ~ a - 1", "y ~ a + 0", "y ~ a*b - 1 + Error(s)"])
def test_a_formula_without_a_mean_is_refused(formula: str) -> None:
    with pytest.raises(InputError, match="leaves out the mean"):
        read_formula(formula)


@pytest.mark.parametrize("type_", ["I", "II"])
def test_welch_is_no_other_type(table: Path, type_: str) -> None:
    with pytest.raises(InputError, match="which is III"):
        study.analyze(table, "y", ["a", "b"], error="welch", type=type_)
    assert study.analyze(table, "y", ["a"], error="welch", type="III").anova.type == "III"


def test_a_formula_in_python(table: Path) -> None:
    one = study.analyze(table, "y ~ a*b + Error(s)", practical=0.5)
    other = study.analyze(table, "y", ["a", "b"], block="s", practical=0.5)
    assert one.effects == other.effects


def test_terms_of_a_formula() -> None:
    found = read_formula("`my y` ~ a * b * c - a:b:c")
    assert found.response == "my y"
    assert found.factors == ("a", "b", "c")
    assert found.model == ("a", "b", "c", "a:b", "a:c", "b:c")
    assert read_formula("y ~ b:a + a + b").model == ("full",)
    for bad in ("y ~", "~ a", "y", "y ~ a %in% b", "y ~ (a + b", "y ~ a^7", "y ~ system('x')"):
        with pytest.raises(InputError, match="formula"):
            read_formula(bad)


def test_moments_alone_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = {"p": [1.0, 2.0, 4.0], "q": [6.0, 7.0, 9.5, 8.0], "r": [1.5, 2.5]}
    path = tmp_path / "moments.csv"
    rows = [f"{k},{np.mean(v):.17g},{np.std(v, ddof=1):.17g},{len(v)}" for k, v in values.items()]
    path.write_text("\n".join(["mix,m,s,n", *rows]), encoding="utf-8")
    found = asked(capsys, str(path), "--factors", "mix", "--summary", "m,s,n", "--practical", "1")
    raw = tmp_path / "raw.csv"
    lines = [f"{k},{v}" for k, vs in values.items() for v in vs]
    raw.write_text("\n".join(["mix,y", *lines]), encoding="utf-8")
    whole = asked(capsys, str(raw), "y ~ mix")
    row = whole["anova"]["rows"][0]
    assert found["anova"]["f"] == pytest.approx(row["f"], rel=1e-10)
    for ours, theirs in zip(found["tukey_kramer"], whole["effects"][0]["pairs"], strict=True):
        assert ours["lower"] == pytest.approx(theirs["lower"], rel=1e-8)
    welch = asked(capsys, str(raw), "y ~ mix", "--welch")["anova"]["rows"][0]
    assert found["welch"]["f"] == pytest.approx(welch["f"], rel=1e-10)
    assert found["verdicts"] == ["matters", "cannot tell", "matters"]
    path.write_text("mix,m,s,n\np,1,0,3\nq,2,1,1\n", encoding="utf-8")
    assert run(["analyze", str(path), "--factors", "mix", "--summary", "m,s,n"]) == 2


@pytest.mark.parametrize("extra", [["--alpha", "0"], ["--block", "b"], ["--welch"], ["m ~ mix"]])
def test_what_moments_have_no_use_for_is_refused(tmp_path: Path, extra: list[str]) -> None:
    path = tmp_path / "moments.csv"
    path.write_text("mix,m,s,n,b\np,1,1,3,u\nq,2,1,4,v\n", encoding="utf-8")
    asked_for = ["analyze", str(path), "--factors", "mix", "--summary", "m,s,n"]
    assert run(asked_for) == 0
    assert run([*asked_for, *extra]) == 2
