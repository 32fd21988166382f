"""What a claim rests on, through the command line: simple effects, references, commas, planning."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from study.cli.app import run
from tests.conftest import ROOT

#: four effects of .9 (three main effects and their interaction), none of which matters alone
EFFECT = 0.9


def ask(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def eighth(folder: Path, *, interaction: bool) -> str:
    """2^3 cells on six specimens; a + ab + ac + abc, so that a reaches 3.6 at one setting."""
    random = np.random.default_rng(4)
    lines = ["a,b,c,specimen,y"]
    for a, b, c in product((-1, 1), repeat=3):
        size = a * (1 + b + c + b * c) if interaction else a
        for k in range(6):
            y = 10 + EFFECT / 2 * size + k + 0.01 * random.standard_normal()
            lines.append(f"{a},{b},{c},s{k},{y:.9f}")
    path = folder / "eighth.csv"
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.mark.parametrize(
    ("interaction", "verdict"), [(True, "matters"), (False, "no practical difference")]
)
def test_an_average_that_does_not_matter_may_hide_a_setting_at_which_it_does(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, interaction: bool, verdict: str
) -> None:
    path = eighth(tmp_path, interaction=interaction)
    found = ask(capsys, "analyze", path, "--response", "y", "--factors", "a,b,c",
                "--block", "specimen", "--practical", "1")  # fmt: skip
    a = next(effect for effect in found["effects"] if effect["term"] == "a")
    assert a["range"] == pytest.approx(EFFECT, abs=0.02)
    assert a["verdict"] == verdict
    largest = max(abs(one["difference"]) for one in a["simple_effects"])
    assert largest == pytest.approx(4 * EFFECT if interaction else EFFECT, abs=0.02)
    assert len(a["simple_effects"]) == 4


def test_a_reference_and_a_decimal_comma(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Differences from the reference are Dunnett's, as scipy gives them."""
    random = np.random.default_rng(8)
    groups = {name: mean + random.standard_normal(7) for name, mean in
              (("std", 10.0), ("soft", 10.5), ("hard", 13.0))}  # fmt: skip
    lines = ["t;y"] + [f"{t};{y:.6f}" for t, own in groups.items() for y in own]
    path = tmp_path / "comma.csv"
    path.write_text("\n".join(lines).replace(".", ",") + "\n")
    found = ask(capsys, "analyze", str(path), "--response", "y", "--factors", "t",
                "--decimal", ",", "--reference", "std", "--alpha", "0.1")  # fmt: skip
    theirs = stats.dunnett(groups["soft"], groups["hard"], control=groups["std"],
                           random_state=np.random.default_rng(2011))  # fmt: skip
    pairs = {pair["first"]: pair for pair in found["reference"]["pairs"]}
    for i, name in enumerate(("soft", "hard")):
        difference = groups[name].mean() - groups["std"].mean()
        assert pairs[name]["difference"] == pytest.approx(difference, abs=1e-5)
        assert pairs[name]["p"] == pytest.approx(theirs.pvalue[i], abs=2e-3)
    # 90 % intervals of three means, by the pooled variance
    pooled = np.sqrt(np.mean([own.var(ddof=1) for own in groups.values()]))
    half = stats.t.ppf(0.95, 18) * pooled / np.sqrt(7)
    mean_ci = next(e for e in found["effects"] if e["term"] == "t")["mean_ci95"][0]
    assert (mean_ci[1] - mean_ci[0]) / 2 == pytest.approx(half, rel=1e-4)
    assert run(["analyze", str(path), "--response", "y", "--factors", "t", "--decimal", ",",
                "--reference", "sdt"]) == 2  # fmt: skip
    assert "std" in capsys.readouterr().err


@pytest.mark.parametrize("error", ["auto", "pooled"])
def test_a_reference_of_a_log_response_gives_ratios(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, error: str
) -> None:
    """Over blocks and with one error alike: ratios of geometric means."""
    random = np.random.default_rng(4)
    blocks = random.normal(0, 0.3, 6)
    y = {
        (t, c, b): mean * k * np.exp(blocks[b] + random.normal(0, 0.1))
        for t, mean in (("x", 1.0), ("y", 2.0), ("z", 3.0))
        for c, k in (("u", 1.0), ("v", 1.3))
        for b in range(6)
    }
    path = tmp_path / "log.csv"
    rows = "".join(f"{t},{c},b{b},{value}\n" for (t, c, b), value in y.items())
    path.write_text(f"t,c,block,y\n{rows}")
    asked = ["analyze", str(path), "--response", "y", "--factors", "t,c", "--block", "block",
             "--transform", "log", "--reference", "x", "--error", error]  # fmt: skip
    found = ask(capsys, *asked)["reference"]
    assert found["scale"] == "ratio"
    logs = {t: np.mean([np.log(v) for (own, _, _), v in y.items() if own == t]) for t in "xyz"}
    for pair in found["pairs"]:
        assert pair["difference"] == pytest.approx(np.exp(logs[pair["first"]] - logs["x"]))
        assert 1 < pair["lower"] < pair["difference"] < pair["upper"]
    assert run(asked) == 0
    printed = capsys.readouterr().out
    assert "x / " in printed  # simple effects are ratios, too
    assert re.search(r"level +ratio", printed)


def test_holm_stands_beside_the_raw_p(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    found = ask(capsys, "analyze", eighth(tmp_path, interaction=False), "--response", "y",
                "--factors", "a,b,c", "--block", "specimen")  # fmt: skip
    raw = np.array([effect["p"] for effect in found["effects"]])
    order = np.argsort(raw)
    steps = np.minimum(np.maximum.accumulate(raw[order] * np.arange(raw.size, 0, -1)), 1)
    by_hand = np.empty_like(raw)
    by_hand[order] = steps
    adjusted = [effect["p_holm"] for effect in found["effects"]]
    assert adjusted == pytest.approx(by_hand.tolist(), abs=1e-12)


def test_how_many_specimens_a_claim_needs(capsys: pytest.CaptureFixture[str]) -> None:
    """Probability of the right claim against a simulation of t intervals."""
    design = str(ROOT / "designs" / "ecoflex-compression.toml")
    found = ask(capsys, "power", design, "--sd", "0.3", "-s", "study.seed=1")
    one = next(d for d in found["detections"] if d["response"] == "relative_rms_force_error")
    assert (one["practical"], one["sd"], one["source"]) == (0.5, 0.3, "as given")
    rows = {row["blocks"]: row for row in one["rows"]}
    assert rows[1]["equal"]["no_practical_difference"] == 0  # one specimen makes no claim
    random = np.random.default_rng(1)
    for b in (3, 6):
        y = 0.3 * random.standard_normal((20_000, b))
        half = stats.t.ppf(0.975, b - 1) * y.std(axis=1, ddof=1) / np.sqrt(b)
        none = np.mean(np.abs(y.mean(axis=1)) + half < 0.5)
        matters = np.mean(1.0 + y.mean(axis=1) - half > 0.5)
        assert rows[b]["equal"]["no_practical_difference"] == pytest.approx(none, abs=0.012)
        assert rows[b]["double"]["matters"] == pytest.approx(matters, abs=0.012)
    assert run(["power", design, "--sd", "-1"]) == 2
    assert "positive" in capsys.readouterr().err


def test_a_claim_that_rests_on_one_block_names_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """All six blocks put the interval beyond 1; without any one of the larger five it is not."""
    differences = [0.4, 1.9, 2.6, 3.2, 2.2, 2.9]
    rows = ["m,specimen,y"]
    for k, d in enumerate(differences):
        rows += [f"x,s{k},{10 + k}", f"y,s{k},{10 + k + d}"]
    path = tmp_path / "six.csv"
    path.write_text("\n".join(rows) + "\n")

    def verdict(kept: list[float], practical: float) -> bool:
        d = np.array(kept)
        half = stats.t.ppf(0.975, d.size - 1) * d.std(ddof=1) / np.sqrt(d.size)
        return bool(d.mean() - half > practical)

    assert verdict(differences, 1.0)
    expected = [
        f"s{k}" for k in range(6) if not verdict(differences[:k] + differences[k + 1 :], 1.0)
    ]
    found = ask(capsys, "analyze", str(path), "--response", "y", "--factors", "m",
                "--block", "specimen", "--practical", "1")  # fmt: skip
    (effect,) = found["effects"]
    assert effect["verdict"] == "matters"
    assert effect["lost_without"] == expected == [f"s{k}" for k in range(1, 6)]


def test_an_interaction_has_no_verdict_of_its_own(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found = ask(capsys, "analyze", eighth(tmp_path, interaction=True), "--response", "y",
                "--factors", "a,b,c", "--block", "specimen", "--practical", "1")  # fmt: skip
    for effect in found["effects"]:
        assert (effect["verdict"] == "see simple effects") is (":" in effect["term"])
        assert effect["p"] is not None
