"""Numeric factors through the verb: a textbook, known functions, and whatever a table may hold."""

import numpy as np
import pandas as pd
import pytest

import study as public
from study.ground.errors import InputError
from tests.cli.small import study
from tests.conftest import ROOT
from tests.response_surface import functions

#: Montgomery, 8th ed., example 11.2: yield over time and temperature
CHEMICAL = ROOT / "validation" / "statistics" / "chemical_process.csv"


def write(path, columns):
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def table(path, function, k, n):
    x = functions.hypercube(k, n, 1)
    columns = {f"x{j + 1}": x[:, j] for j in range(k)}
    return write(path, columns | {"y": function(x)})


def analyze(path, numeric, *more):
    return study("analyze", path, "--response", "y", "--numeric", numeric, *more)


def test_montgomery_example_11_2():
    """Its coefficients and test of lack of fit: `tests/analysis/test_reference_packages.py`."""
    numeric = "time_min=80..90,temperature_F=170..180"
    asked = ("analyze", CHEMICAL, "--response", "yield", "--numeric", numeric)
    found = study(*asked, "--json").json
    surface = found["surface"]
    assert surface["kind"] == "quadratic"
    assert surface["error"] == "replicates"
    point = surface["stationary"]
    assert point["kind"] == "maximum"
    assert point["at"] == pytest.approx({"time_min": 86.95, "temperature_F": 176.53}, abs=0.01)
    assert point["value"] == pytest.approx(80.21, abs=0.005)
    assert point["established"]
    assert found["sensitivity"] == []
    level = "level at a maximum of 80.2, inside the ranges: time_min 86.9 and temperature_F 177."
    assert level in " ".join(study(*asked).out.split())


def test_no_p_is_printed_of_a_deterministic_surface(tmp_path):
    x = np.array([[a, b] for a in (1.0, 2.0, 3.0) for b in (1.0, 2.0, 3.0)])
    path = write(tmp_path / "t.csv", {"a": x[:, 0], "b": x[:, 1], "y": np.exp(x[:, 0]) + x[:, 1]})
    answer = analyze(path, "a,b")
    assert "interval" not in answer.out.partition("Every factor runs")[0]
    # these runs have no noise, but neither the table nor the program can know it
    assert "no p: each setting was run once" in " ".join(answer.err.split())
    assert "simulation" not in answer.out
    terms = analyze(path, "a,b", "--json").json["surface"]["terms"]
    assert [t["p"] for t in terms] == [None] * 6


def test_few_runs_give_no_indices(tmp_path):
    answer = analyze(table(tmp_path / "t.csv", functions.ishigami, 3, 50), "x1,x2,x3", "--json")
    assert answer.json["sensitivity"] == []
    assert answer.json["surface"]["indices"] == "refused"
    assert "add runs, 100 in all" in answer.err


def test_practical_difference_decides_ranges(tmp_path):
    path = table(tmp_path / "t.csv", lambda x: 10 * x[:, 0] + 0.1 * x[:, 1] + x[:, 0] ** 3, 2, 40)
    answer = analyze(path, "x1,x2", "--practical", "2", "--json").json
    first, second = answer["sensitivity"]
    assert first["verdict"] == "matters, if confirmed"
    assert len(first["confirm"]) == 2
    assert second["verdict"] == "no practical difference"
    assert second["confirm"] == []
    low, high = (10 * at["x1"] + at["x1"] ** 3 for at in first["confirm"])
    assert high - low == pytest.approx(first["range"], abs=first["range_bound"])
    text = " ".join(analyze(path, "x1,x2", "--practical", "2").out.split())
    assert "matters, if confirmed" in text
    assert "x1 matters if these two runs confirm it: x1 " in text


def test_a_quadratic_in_blocks_is_judged_by_the_blocks(tmp_path):
    x = np.linspace(-1.0, 1.0, 5)
    slopes = np.array([1.0, 1.2, 0.9, 1.3, 1.1])
    rng = np.random.default_rng(4)
    y = [s * x - 2.0 * x**2 + 0.01 * rng.standard_normal(5) for s in slopes]
    columns = {
        "x": np.tile(x, 5), "b": np.repeat(list("pqrst"), 5), "y": np.concatenate(y)
    }  # fmt: skip
    path = write(tmp_path / "t.csv", columns)
    surface = analyze(path, "x", "--block", "b", "--json").json["surface"]
    term = {t["term"]: t for t in surface["terms"]}["x"]
    # each block's slope by least squares: their mean and t with four degrees of freedom
    fitted = np.array([np.polyfit(x, own, 2)[1] for own in y])
    half = 2.7764 * fitted.std(ddof=1) / 5**0.5
    assert term["ci95"] == pytest.approx([fitted.mean() - half, fitted.mean() + half], rel=1e-4)
    assert surface["error"] == "blocks"
    assert surface["lack_of_fit"]["p"] > 0.05
    region = surface["stationary"]["region"]
    assert region["low"]["x"] < fitted.mean() / 4.0 < region["high"]["x"]
    assert not region["leaves_the_box"]
    assert "All terms of x: F(" in analyze(path, "x", "--block", "b").out


def test_emulators_of_blocks_are_compared_over_blocks(tmp_path):
    x = functions.hypercube(2, 25, 1)
    slopes = [9.0, 10.0, 11.0, 10.5]
    y = [s * x[:, 0] + np.sin(3 * x[:, 1]) for s in slopes]
    columns = {
        "x1": np.tile(x[:, 0], 4), "x2": np.tile(x[:, 1], 4),
        "b": np.repeat(["p", "q", "r", "s"], 25), "y": np.concatenate(y),
    }  # fmt: skip
    path = write(tmp_path / "t.csv", columns)
    found = analyze(path, "x1=0..1,x2=0..1", "--block", "b", "--practical", "5", "--json").json
    first, second = found["sensitivity"]
    # the range along x1 is the slope of each block: their mean, and t with three degrees
    t = 3.182 * np.std(slopes, ddof=1) / 2.0
    assert first["range"] == pytest.approx(np.mean(slopes), abs=0.05)
    assert first["range_bound"] == pytest.approx(t, abs=0.1)
    assert first["verdict"] == "matters, if confirmed"
    assert second["range"] == pytest.approx(1.0, abs=0.05)  # the sine has its top inside
    share = np.array(slopes) ** 2 / 12
    share /= share + np.var(np.sin(3 * np.linspace(0, 1, 100_001)))
    assert first["S"] == pytest.approx(share.mean(), abs=0.01)
    assert list(found["surface"]["blocks"]) == ["p", "q", "r", "s"]
    two = write(tmp_path / "two.csv", {name: np.asarray(c)[:50] for name, c in columns.items()})
    answer = analyze(two, "x1,x2", "--block", "b")
    assert answer.code == 3
    assert "one block at a time" in answer.err


def test_no_surface_is_the_table_of_levels(tmp_path):
    levels = np.repeat([1.0, 2.0, 3.0], 4)
    y = levels + np.random.default_rng(1).normal(0, 0.1, 12)
    path = write(tmp_path / "t.csv", {"a": levels, "y": y})
    found = analyze(path, "a", "--surface", "none", "--json").json
    assert found == study("analyze", path, "--response", "y", "--factors", "a", "--json").json


def test_prediction_from_python():
    found = public.fit_surface(CHEMICAL, "yield", ["time_min", "temperature_F"])
    at = found.predict({"time_min": [85.0, 86.95], "temperature_F": [175.0, 176.53]})
    assert at.value == pytest.approx([79.94, 80.21], abs=0.01)
    assert (at.low < at.value).all()
    with pytest.raises(InputError, match=r"lies outside.*77.93 to 92.07"):
        found.predict({"time_min": 95.0, "temperature_F": 175.0})


def test_a_prediction_where_nothing_was_run_says_so(tmp_path):
    """Runs fill three quarters of the box; the exponential rises steepest in the fourth."""
    x = np.array([[a, b] for a in range(7) for b in range(7) if a <= 3 or b <= 3])
    path = write(tmp_path / "t.csv", {"a": x[:, 0], "b": x[:, 1], "y": np.exp(x.sum(axis=1) / 6)})
    found = public.fit_surface(path, "y", ["a", "b"], surface="quadratic")
    (said,) = found.predict({"a": [1.0, 6.0], "b": [1.0, 6.0]}).notes
    assert "never run: a above 3 with b above 3" in said
    assert found.predict({"a": 6.0, "b": 1.0}).notes == ()
    (best,) = public.optimize(path, maximize="y", numeric=["a", "b"], surface="quadratic")
    assert best.notes.count(said) == 1


def test_failed_runs_are_left_out_and_said(tmp_path):
    x = np.linspace(0, 1, 12)
    y = ["nan", *[str(v) for v in np.sin(5 * x[1:])]]
    path = write(tmp_path / "t.csv", {"x": x, "y": y})
    answer = analyze(path, "x", "--json")
    assert answer.json["runs"] == 11
    assert "1 run without a response left out: lines 2" in answer.err


def test_a_log_scale_makes_a_power_law_of_logarithms_a_parabola(tmp_path):
    x = np.array([1.0, 10.0, 100.0, 1000.0, 10000.0])
    path = write(tmp_path / "t.csv", {"x": x, "y": np.log10(x) ** 2})
    found = analyze(path, "x log", "--json").json
    coefficients = {t["term"]: t["coefficient"] for t in found["surface"]["terms"]}
    # u = 2 + 2 c with c in [-1, 1]: u^2 = 4 + 8 c + 4 c^2
    assert coefficients == pytest.approx({"1": 4.0, "x": 8.0, "x^2": 4.0})
    assert found["surface"]["q2"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("numeric", "more", "code", "said"),
    [
        ("tima", (), 2, "did you mean 'time'"),
        ("time,time", (), 2, "stands twice"),
        ("time=9..8", (), 2, "is empty"),
        ("time=0..40", (), 2, "not extrapolated: time=0..23"),
        ("time=a..b", (), 2, "cannot read the range"),
        ("flat", (), 2, "range 1..1 is empty"),
        ("time", ("--surface", "quadratc"), 2, "did you mean 'quadratic'"),
        ("time", ("--unit", "temp"), 2, "has no meaning for a surface"),
        ("time", ("--transform", "log"), 2, "has no meaning for a surface"),
        ("time", ("--alpha", "0.1"), 2, "intervals are 95 %"),
        ("word", (), 2, "must be a finite number, got 'a'"),
        ("zero log", (), 2, "a logarithm needs positive settings"),
        ("two,time", ("--surface", "emulator"), 3, "has 2 settings"),
        ("time,same", ("--surface", "emulator"), 3, "change together"),
    ],
)
def test_bad_input(tmp_path, numeric, more, code, said):
    n = np.arange(24.0)
    columns = {
        "time": n, "temp": n**2, "flat": n * 0 + 1, "word": ["a"] * 24, "zero": n, "two": n % 2,
        "same": 2 * n, "y": np.sin(n),
    }  # fmt: skip
    answer = analyze(write(tmp_path / "t.csv", columns), numeric, *more)
    assert answer.code == code
    assert said in " ".join(answer.err.split())


X = functions.hypercube(2, 30, 1)


def rows(**columns):
    """Thirty runs in two columns that fill the box, with others beside."""
    return {"a": X[:, 0], "b": X[:, 1], **columns, "y": np.sin(3 * X[:, 0]) + X[:, 1]}


WITH_UNITS = [f"{v:.3f} mm" if i % 2 else f"{0.1 * v:.4f} cm" for i, v in enumerate(X[:, 0])]


@pytest.mark.parametrize(
    ("columns", "asked", "code", "said"),
    [
        # of three columns no two are alike, but each follows from the others
        (rows(c=X[:, 0] + X[:, 1]), ("--numeric", "a,b,c"), 3, "'a', 'b' and 'c' change together"),
        (rows(c=X[:, 0] + X[:, 1]), ("--numeric", "a,b,c", "--surface", "quadratic"), 0,
         "what one does is not told from the others"),
        (rows(c=[5.0] * 30), ("--numeric", "a,b,c"), 2, "a constant column is no factor"),
        (rows(c=np.arange(30) % 2), ("--numeric", "a,b,c"), 0, "c has two settings: linear only"),
        (rows(c=np.arange(30) % 2), ("--numeric", "a,b,c"), 0, "needs at least 4 settings"),
        (rows(c=["nan", *X[1:, 0]]), ("--numeric", "b,c"), 2, "must be left out, with its row"),
        (rows(c=["", *X[1:, 0]]), ("--numeric", "b,c"), 2, "t.csv:2: column 'c'"),
        (rows(c=["inf", *X[1:, 0]]), ("--numeric", "b,c"), 2, "must be a finite number"),
        (rows(c=WITH_UNITS), ("--numeric", "b,c"), 2, "units in its cells: cm, mm"),
        (rows(c=WITH_UNITS), ("--numeric", "b,c"), 2, "name it in the header: c_cm"),
        (rows(c=np.arange(30) % 3 * 10), ("--factors", "c"), 0, "--numeric c asks for a surface"),
        (rows(), (), 2, "--factors for labels, --numeric for numbers"),
        (rows(), ("--numeric", "a=0..3,b"), 2, "a surface is not extrapolated"),
    ],
)  # fmt: skip
def test_what_a_table_may_hold(tmp_path, columns, asked, code, said):
    path = write(tmp_path / "t.csv", columns)
    answer = study("analyze", path, "--response", "y", *asked)
    assert answer.code == code
    assert said in " ".join(answer.err.split())


def test_a_saturated_surface_has_no_error_and_says_so(tmp_path):
    path = write(tmp_path / "t.csv", {"x": [1.0, 2.0, 3.0], "y": [1.0, 4.0, 9.0]})
    answer = analyze(path, "x", "--json")
    assert answer.json["surface"]["best"]["largest"]["half_width"] is None
    assert answer.json["surface"]["q2"] is None
    assert "as many coefficients as runs" in answer.err
    assert "nan" not in analyze(path, "x").out
