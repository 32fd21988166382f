"""`study analyze`: printed analyses of variance, and every claim of a table by hand."""

import re
import shlex
from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import study as package
from study.ground.errors import InputError
from study.statistics.analysis.linear_model import read_formula
from tests.cli.small import refusal, success
from tests.conftest import ROOT

TABLES = ROOT / "validation" / "statistics"


def written(path, head, rows):
    """Write a table."""
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def analyzed(table, words):
    """Document of `study analyze TABLE WORDS --json`."""
    return success("analyze", table, *shlex.split(words), "--json").json


def rows(found):
    return {row["term"]: row for row in found["anova"]["rows"]}


#: table, question, and degrees of freedom, sum of squares and F as printed, with two decimals:
#: Montgomery, Design and Analysis of Experiments, 8th ed., tables 5.1 and 5.5, 3.1 and 3.4, 14.14
#: and 14.16; Box, Hunter and Hunter, Statistics for Experimenters, 2nd ed., table 4.4
PRINTED = {
    "battery_life": (
        "--response life --factors material,temperature",
        {"material": (2, 10683.72, 7.91), "temperature": (2, 39118.72, 28.97),
         "material:temperature": (4, 9613.78, 3.56), "residual": (27, 18230.75, None)},
    ),
    "etch_rate": (
        "--response etch_rate --factors power",
        {"power": (3, 66870.55, 66.80), "residual": (16, 5339.20, None)},
    ),
    "penicillin": (
        "--response yield --factors treatment --block blend --error pooled",
        {"blend": (4, 264.0, None), "treatment": (3, 70.0, 1.24), "residual": (12, 226.0, None)},
    ),
    # a split plot with whole-plot error 36.28; 36.43 and 3.15 from mean squares of two decimals
    "paper_strength": (
        "--response strength --factors method,temperature --block replicate --whole-plot method",
        {"method": (2, 128.39, 7.08), "replicate:method": (4, 36.28, None),
         "temperature": (3, 434.08, 36.43), "method:temperature": (6, 75.17, 3.15),
         "residual": (18, 71.50, None)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PRINTED)
def test_a_printed_analysis(name):
    words, printed = PRINTED[name]
    found = analyzed(TABLES / f"{name}.csv", words)
    for term, (df, ss, f) in printed.items():
        row = rows(found)[term]
        assert row["df"] == df
        assert row["ss"] == pytest.approx(ss, abs=0.0051)
        assert f is None or row["f"] == pytest.approx(f, abs=0.0051)
    summary, total = found["summary"], found["anova"]["ss_total"]
    if name == "battery_life":
        assert total == pytest.approx(77646.97, abs=0.0051)
        assert summary["r_sq_pred"] == pytest.approx(0.5826, abs=5e-5)
        assert summary["r_sq"] == pytest.approx(0.7652, abs=5e-5)
    if name == "etch_rate":
        # PRESS of the computer output of table 3.4
        assert (1 - summary["r_sq_pred"]) * total == pytest.approx(8342.50, abs=0.0051)
        # Tukey's critical difference, 33.09 from q = 4.05 of a table with two decimals
        pair = found["effects"][0]["pairs"][0]
        assert (pair["upper"] - pair["lower"]) / 2 == pytest.approx(33.09, abs=0.05)


@pytest.mark.parametrize("name", ["SiRstv", "AtmWtAg"])
def test_nist(data_dir, tmp_path, name):
    """NIST StRD, Analysis of Variance: certified F of the measured sets."""
    folder = data_dir / "nist_anova"
    certified = pd.read_csv(folder / "expected.csv").set_index("dataset").loc[name]
    lines = [line.split() for line in (folder / f"{name}.dat").read_text().splitlines()]
    pairs = [line for line in lines if len(line) == 2 and line[0].replace(".", "").isdigit()]
    pairs = pairs[-int(certified["n_obs"]) :]
    table = written(tmp_path / "nist.csv", "t,y", [f"{t},{y}" for t, y in pairs])
    found = analyzed(table, "--response y --factors t")
    row = rows(found)["t"]
    # digits of doubles that hold the data: NIST's "average" sets lose 1e7 of 1e16
    near = 1e-12 if certified["difficulty"] == "Lower" else 1e-10
    assert row["f"] == pytest.approx(certified["f_statistic"], rel=near)
    assert row["ss"] == pytest.approx(certified["ss_between"], rel=near)


#: four effects of .9 (three main effects and their interaction), none of which matters alone
EFFECT = 0.9


def eighth(folder, *, interaction):
    """2^3 cells on six specimens; a + ab + ac + abc, so that a reaches 3.6 at one setting."""
    random = np.random.default_rng(4)
    lines = []
    for a, b, c in product((-1, 1), repeat=3):
        size = a * (1 + b + c + b * c) if interaction else a
        for k in range(6):
            y = 10 + EFFECT / 2 * size + k + 0.01 * random.standard_normal()
            lines.append(f"{a},{b},{c},s{k},{y:.9f}")
    return written(folder / "eighth.csv", "a,b,c,specimen,y", lines)


@pytest.mark.parametrize(
    ("interaction", "verdict"), [(True, "matters"), (False, "no practical difference")]
)
def test_an_average_that_does_not_matter_may_hide_a_setting_at_which_it_does(
    tmp_path, interaction, verdict
):
    path = eighth(tmp_path, interaction=interaction)
    found = analyzed(path, "--response y --factors a,b,c --block specimen --practical 1")
    a = next(effect for effect in found["effects"] if effect["term"] == "a")
    assert a["range"] == pytest.approx(EFFECT, abs=0.02)
    assert a["verdict"] == verdict
    largest = max(abs(one["difference"]) for one in a["simple_effects"])
    assert largest == pytest.approx(4 * EFFECT if interaction else EFFECT, abs=0.02)
    assert len(a["simple_effects"]) == 4
    for effect in found["effects"]:
        assert (effect["verdict"] == "see simple effects") is (":" in effect["term"])
    # Holm's p by hand
    raw = np.array([effect["p"] for effect in found["effects"]])
    order = np.argsort(raw)
    steps = np.minimum(np.maximum.accumulate(raw[order] * np.arange(raw.size, 0, -1)), 1)
    adjusted = np.array([effect["p_holm"] for effect in found["effects"]])
    assert adjusted[order] == pytest.approx(steps, abs=1e-12)


def test_a_reference_and_a_decimal_comma(tmp_path):
    """Differences from the reference, whose p tests/analysis compares with scipy's Dunnett."""
    random = np.random.default_rng(8)
    groups = {name: mean + random.standard_normal(7) for name, mean in
              (("std", 10.0), ("soft", 10.5), ("hard", 13.0))}  # fmt: skip
    lines = ["t;y"] + [f"{t};{y:.6f}" for t, own in groups.items() for y in own]
    path = tmp_path / "comma.csv"
    path.write_text("\n".join(lines).replace(".", ",") + "\n")
    asked = "--response y --factors t --decimal , --reference"
    found = analyzed(path, f"{asked} std --alpha 0.1")
    pairs = {pair["first"]: pair for pair in found["reference"]["pairs"]}
    for name in ("soft", "hard"):
        difference = groups[name].mean() - groups["std"].mean()
        assert pairs[name]["difference"] == pytest.approx(difference, abs=1e-5)
    # 90 % intervals of three means, by the pooled variance
    pooled = np.sqrt(np.mean([own.var(ddof=1) for own in groups.values()]))
    half = stats.t.ppf(0.95, 18) * pooled / np.sqrt(7)
    mean_ci = next(e for e in found["effects"] if e["term"] == "t")["mean_ci95"][0]
    assert (mean_ci[1] - mean_ci[0]) / 2 == pytest.approx(half, rel=1e-4)
    assert "std" in refusal(f"analyze {path} {asked} sdt").err


@pytest.mark.parametrize("error", ["auto", "pooled"])
def test_a_reference_of_a_log_response_gives_ratios(tmp_path, error):
    """Over blocks and with one error alike: ratios of geometric means."""
    random = np.random.default_rng(4)
    blocks = random.normal(0, 0.3, 6)
    y = {
        (t, c, b): mean * k * np.exp(blocks[b] + random.normal(0, 0.1))
        for t, mean in (("x", 1.0), ("y", 2.0), ("z", 3.0))
        for c, k in (("u", 1.0), ("v", 1.3))
        for b in range(6)
    }
    rows = [f"{t},{c},b{b},{value}" for (t, c, b), value in y.items()]
    path = written(tmp_path / "log.csv", "t,c,block,y", rows)
    asked = (
        f"--response y --factors t,c --block block --transform log --reference x --error {error}"
    )
    found = analyzed(path, asked)["reference"]
    assert found["scale"] == "ratio"
    logs = {t: np.mean([np.log(v) for (own, _, _), v in y.items() if own == t]) for t in "xyz"}
    for pair in found["pairs"]:
        assert pair["difference"] == pytest.approx(np.exp(logs[pair["first"]] - logs["x"]))
        assert 1 < pair["lower"] < pair["difference"] < pair["upper"]
    printed = success(f"analyze {path} {asked}").out
    assert "x / " in printed  # simple effects are ratios, too
    assert re.search(r"level +ratio", printed)


def test_how_many_specimens_a_claim_needs():
    """Probability of the right claim against a simulation of t intervals."""
    design = ROOT / "designs" / "ecoflex-compression.toml"
    found = success(f"power {design} --sd 0.3 -s study.seed=1 --json").json
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
    assert "positive" in refusal(f"power {design} --sd -1").err
    each = "relative_rms_force_error=0.3,mu0=0.02"
    both = success(f"power {design} --sd {each} -s study.seed=1 --json").json["detections"]
    given = {d["response"]: d["sd"] for d in both if d["source"] == "as given"}
    assert given == {"relative_rms_force_error": 0.3, "mu0": 0.02}
    assert next(d for d in both if d["response"] == one["response"]) == one
    for faulty, says in (("mu=0.1", "'mu' is no response"), ("mu0=0.1 kPa", "must be a number")):
        assert says in refusal("power", str(design), "--sd", faulty).err


def test_a_claim_that_rests_on_one_block_names_it(tmp_path):
    """All six blocks put the interval beyond 1; without any one of the larger five it is not."""
    differences = [0.4, 1.9, 2.6, 3.2, 2.2, 2.9]
    rows = list[str]()
    for k, d in enumerate(differences):
        rows += [f"x,s{k},{10 + k}", f"y,s{k},{10 + k + d}"]
    path = written(tmp_path / "six.csv", "m,specimen,y", rows)

    def verdict(kept, practical):
        d = np.array(kept)
        half = stats.t.ppf(0.975, d.size - 1) * d.std(ddof=1) / np.sqrt(d.size)
        return bool(d.mean() - half > practical)

    assert verdict(differences, 1.0)
    expected = [
        f"s{k}" for k in range(6) if not verdict(differences[:k] + differences[k + 1 :], 1.0)
    ]
    found = analyzed(path, "--response y --factors m --block specimen --practical 1")
    (effect,) = found["effects"]
    assert effect["verdict"] == "matters"
    assert effect["lost_without"] == expected == [f"s{k}" for k in range(1, 6)]


@pytest.fixture
def rows_of_s(tmp_path):
    rows = pd.MultiIndex.from_product([range(4), list("pq"), list("xyz")], names=["s", "a", "b"])
    frame = rows.to_frame(index=False)
    noise = np.random.default_rng(8).normal(0, 0.3, len(frame))
    frame["y"] = 5 + (frame["a"] == "q") + 0.2 * frame["s"] + noise
    path = tmp_path / "rows.csv"
    frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("formula", "flags"),
    [
        ("y ~ a * b", ""),
        ("y ~ a + b", "--model a,b"),
        ("log(y) ~ (a + b)^2 - a:b", "--model 1 --transform log"),
        ("y ~ a * b + Error(s)", "--block s"),
        ("y ~ a * b + (1 | s)", "--block s"),
        ("y ~ a / b + Error(s/a)", "--model a,a:b --block s --whole-plot a"),
    ],
)
def test_a_formula_says_what_the_flags_say(rows_of_s, formula, flags):
    one = analyzed(rows_of_s, f"'{formula}'")
    other = analyzed(rows_of_s, f"--response y --factors a,b {flags}")
    assert one["anova"] == other["anova"]
    assert one["effects"] == other["effects"]


@pytest.mark.parametrize("type_", ["I", "II"])
def test_welch_is_no_other_type(rows_of_s, type_):
    with pytest.raises(InputError, match="which is III"):
        package.analyze(rows_of_s, "y", ["a", "b"], error="welch", type=type_)
    assert package.analyze(rows_of_s, "y", ["a"], error="welch", type="III").anova.type == "III"


@pytest.mark.parametrize(
    ("formula", "said"),
    [
        *((one, "leaves out the mean") for one in ("y ~ a - 1", "y ~ a + 0", "y ~ a*b - 1")),
        *((one, "formula") for one in ("y ~", "~ a", "y", "y ~ a %in% b", "y ~ (a + b", "y ~ a^7",
                                       "y ~ system('x')")),
    ],
)  # fmt: skip
def test_a_formula_that_is_none_is_refused(formula, said):
    with pytest.raises(InputError, match=said):
        read_formula(formula)


def test_terms_of_a_formula():
    found = read_formula("`my y` ~ a * b * c - a:b:c")
    assert (found.response, found.factors) == ("my y", ("a", "b", "c"))
    assert found.model == ("a", "b", "c", "a:b", "a:c", "b:c")
    assert read_formula("y ~ b:a + a + b").model == ("full",)


def test_moments_alone_are_compared(tmp_path):
    """Their tests and intervals are those of the rows (tests/analysis): here they have verdicts."""
    values = {"p": [1.0, 2.0, 4.0], "q": [6.0, 7.0, 9.5, 8.0], "r": [1.5, 2.5]}
    rows = [f"{k},{np.mean(v):.17g},{np.std(v, ddof=1):.17g},{len(v)}" for k, v in values.items()]
    path = written(tmp_path / "moments.csv", "mix,m,s,n", rows)
    asked = "--factors mix --summary m,s,n"
    found = analyzed(path, f"{asked} --practical 1")
    theirs = stats.f_oneway(*values.values())
    assert found["anova"]["f"] == pytest.approx(theirs.statistic, rel=1e-10)
    assert len(found["tukey_kramer"]) == 3
    assert found["verdicts"] == ["matters", "cannot tell", "matters"]
    written(path, "mix,m,s,n", ["p,1,0,3", "q,2,1,1"])
    refusal(f"analyze {path} {asked}")
    written(path, "mix,m,s,n,b", ["p,1,1,3,u", "q,2,1,4,v"])
    success(f"analyze {path} {asked}")
    for useless in ("--alpha 0", "--block b", "--welch", "'m ~ mix'"):
        refusal(f"analyze {path} {asked} {useless}")


GELS = "--response force --factors gel --block specimen"


def covaried(path):
    """Two gels in eight specimens, each at its own temperature; one specimen lacks a gel."""
    random = np.random.default_rng(11)
    rows = [
        (f"s{k}", gel, 20 + 3.0 * j + k, 5.0 * k + 2.0 * (gel == "stiff") + 0.25 * (20 + 3 * j + k)
         + random.normal(0, 0.1))
        for k in range(8)
        for j, gel in enumerate(("soft", "stiff"))
    ][:-1]  # fmt: skip
    table = pd.DataFrame(rows, columns=["specimen", "gel", "celsius", "force"])
    table.to_csv(path, index=False)
    return path, table


def test_a_covariate_is_read_as_a_number_beside_verdicts_and_contrasts(tmp_path):
    path, table = covaried(tmp_path / "gels.csv")
    asked = f"{GELS} --error reml --practical 1 --contrast 'stiff - soft' --covariates celsius"
    found = analyzed(path, asked)
    assert found["rows"] == len(table) == 15
    (slope,) = found["slopes"]
    assert found["components"][0]["sd"] == 0.0  # then REML is least squares
    x = np.column_stack([np.ones(15), table["gel"] == "stiff", table["celsius"]])
    expected = np.linalg.lstsq(x.astype(float), table["force"].to_numpy())[0][2]
    assert slope["value"] == pytest.approx(expected, rel=1e-6)
    assert slope["low"] < slope["value"] < slope["high"]
    assert {term["term"] for term in found["terms"]} == {"gel", "celsius"}
    (effect,), (contrast,) = found["effects"], found["contrasts"]
    assert effect["verdict"] == contrast["verdict"] == "matters"
    (simple,) = effect["simple_effects"]
    assert contrast["difference"] == pytest.approx(-simple["difference"])
    assert contrast["ci"] == pytest.approx([-end for end in simple["ci"][::-1]])
    shown = success(f"analyze {path} {asked}").out
    assert "Means" in shown
    assert "stiff - soft" in shown


def test_random_factors_alone_make_a_study_of_precision(tmp_path):
    rng = np.random.default_rng(5)
    lines = [
        f"{day},{run},{50 + 2 * day % 3 + run + rng.normal():.4f}"
        for day in range(6) for run in range(2) for _ in range(2)
    ]  # fmt: skip
    path = written(tmp_path / "precision.csv", "day,run,y", lines)
    asked = "--response y --error reml"
    found = analyzed(path, f"{asked} --random day,day:run")
    assert [c["source"] for c in found["components"]] == ["day", "day:run", "within"]
    assert found["effects"] == []
    assert "--random day,day:run" in refusal(f"analyze {path} {asked}").err


def test_a_row_of_units_holds_no_run_and_an_undeclared_comma_is_one_fault(tmp_path):
    """What instruments export: units below the header, a decimal comma, a cell that is missing."""
    lines = [
        f"{gel};{batch};{10 + 2 * (gel == 'B') + 0.1 * batch:.2f}".replace(".", ",")
        for gel, batch in product("ABC", range(5))
        if (gel, batch) != ("C", 3)
    ]
    plain = written(tmp_path / "plain.csv", "gel;batch;peak", lines)
    units = written(tmp_path / "units.csv", "gel;batch;peak", [";;[N]", *lines])
    words = "--response peak --factors gel --block batch --practical 1 --decimal ,"
    assert analyzed(units, words) == analyzed(plain, words)
    fault = refusal("analyze", units, *shlex.split(words)[:-2]).err
    assert fault.count("units.csv") == 1
    assert "holds a decimal comma ('10,00')" in fault
