"""The page of `study analyze`: its numbers a second way, its command line, any table."""

import csv
import hashlib
import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import study, success
from validation import fuzz
from validation.fuzz_inputs import Place, tables

TABLES = Path(__file__).parents[2] / "validation" / "statistics"
BATTERY = ("--response", "life", "--factors", "material,temperature")


@pytest.fixture(scope="module")
def battery(tmp_path_factory):
    """Folder with the page of Montgomery's battery experiment."""
    folder = tmp_path_factory.mktemp("battery")
    shutil.copy(TABLES / "battery_life.csv", folder)
    answer = success("analyze", "battery_life.csv", *BATTERY, "--practical", "10",
                     "--reference", "material=1", "--report", "out", folder=folder)  # fmt: skip
    assert answer.out.splitlines()[-1] == "report: out/battery-life-life.html"
    return folder


def records(folder, name):
    path = folder / "out" / "battery-life-life-data" / name
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.drawings
def test_the_page_answers_first_and_shows_every_part(battery):
    first = (battery / "out" / "battery-life-life.html").read_text(encoding="utf-8")
    assert first.index('<section id="answer"') < first.index('<section id="effects"')
    assert 'href="battery-life-life-details.html"' in first
    assert first.count("<svg") == 1
    page = (battery / "out" / "battery-life-life-details.html").read_text(encoding="utf-8")
    parts = ["answer", "data", "error", "anova", "means", "pairs", "residuals", "assumptions",
             "methods", "provenance"]  # fmt: skip
    places = [page.index(f'<section id="{part}"') for part in parts]
    assert places == sorted(places)
    assert page.count("<svg") == 6
    assert "Figure missing" not in first + page
    assert "http://" not in page.replace("http://www.w3.org/", "")  # nothing is loaded
    for shown in ("10,684", "39,119", "9,613.8", "18,231", "76.52", "58.26",
                  "normal probability plot", "versus order", "RJ = 0.9869"):  # fmt: skip
        assert shown in page.replace("\N{NO-BREAK SPACE}", " "), shown


@pytest.mark.drawings
def test_pairs_are_tukeys_and_dunnetts(battery):
    """Montgomery's Tukey comparisons a second way: scipy's studentized range."""
    from scipy.stats import studentized_range

    pairs = {
        (r["first"], r["second"]): r for r in records(battery, "table-pairwise-comparisons.csv")
    }
    mse, df, n = 18230.75 / 27, 27, 12
    means = {"1": 83.16666667, "2": 108.33333333, "3": 125.08333333}
    for first, second in (("1", "2"), ("1", "3"), ("2", "3")):
        q = abs(means[first] - means[second]) / np.sqrt(mse / n)
        row = pairs[first, second]
        assert float(row["p"]) == pytest.approx(studentized_range.sf(q, 3, df), abs=1e-6)
        half = studentized_range.ppf(0.95, 3, df) * np.sqrt(mse / n)
        width = float(row["upper"]) - float(row["lower"])
        assert width == pytest.approx(2 * half, rel=1e-6)
    # Dunnett's two-sided 5 % point for 2 comparisons and 27 df, printed for 24 and 30 df
    # (Montgomery 2017, table VI: 2.35, 2.32). The other factor is in the model: its effects are
    # not in the error, as they would be in the scatter of the raw groups.
    one = records(battery, "table-material-against-1.csv")[0]
    point = (float(one["upper"]) - float(one["lower"])) / 2 / np.sqrt(2 * mse / n)
    assert 2.31 < point < 2.36


@pytest.mark.drawings
def test_coefficients_and_rows_are_those_of_least_squares(battery):
    """The standard error of a level's coefficient is s sqrt((k - 1) / N), by hand."""
    table = {r["term"]: r for r in records(battery, "table-coefficients.csv")}
    assert float(table["Constant"]["estimate"]) == pytest.approx(105.5278, abs=5e-5)
    assert float(table["material[1]"]["estimate"]) == pytest.approx(83.1667 - 105.5278, abs=1e-4)
    s = np.sqrt(18230.75 / 27)
    assert float(table["material[1]"]["standard_error"]) == pytest.approx(s * np.sqrt(2 / 36))
    assert float(table["Constant"]["standard_error"]) == pytest.approx(s / 6)
    # the columns of one factor correlate by 1/2, so the variance inflation factor is 4/3
    assert float(table["material[1]"]["vif"]) == pytest.approx(4 / 3)
    # leverage of a balanced cell is 1/4, so PRESS is e / (3/4); Cook's distance by its formula
    rows = records(battery, "rows.csv")
    assert len(rows) == 36
    for row in rows:
        e = float(row["residual"])
        assert float(row["leverage"]) == pytest.approx(0.25)
        assert float(row["press"]) == pytest.approx(e / 0.75, abs=1e-9)
        assert float(row["cook"]) == pytest.approx(e**2 / (9 * s**2) * 0.25 / 0.75**2, abs=1e-12)


@pytest.mark.drawings
def test_the_line_to_reproduce_works_when_pasted(battery):
    written = battery / "out" / "battery-life-life-details.html"
    page = written.read_text(encoding="utf-8")
    text = page[page.index("<pre>") + 5 : page.index("</pre>")]
    check, again = text.replace("&#39;", "'").replace("&amp;", "&").splitlines()
    done = subprocess.run(
        check, shell=True, cwd=battery, capture_output=True, text=True, check=False
    )  # noqa: S602
    assert done.returncode == 0, done.stderr
    assert hashlib.sha256((battery / "battery_life.csv").read_bytes()).hexdigest() in check
    success(*shlex.split(again)[1:], folder=battery)
    assert written.read_text(encoding="utf-8") == page


@pytest.mark.drawings
def test_json_names_the_page_and_other_formats_stand_beside(tmp_path):
    answer = success("analyze", TABLES / "penicillin.csv", "--response", "yield", "--factors",
                     "treatment", "--block", "blend", "--error", "pooled", "--report", tmp_path,
                     "--format", "html,csv,tex", "--json")  # fmt: skip
    found = json.loads(answer.out)
    page = Path(found["report"])
    assert page.is_file()
    assert page.with_suffix(".tex").read_text().startswith("% Generated by study")
    stored = json.loads((tmp_path / f"{page.stem}-data" / "numbers.json").read_text())
    assert stored["anova"] == found["anova"]
    assert (tmp_path / f"{page.stem}-data" / "figure-yield-four-in-one.svg").is_file()


@pytest.mark.drawings
def test_blocks_have_residual_plots_too(tmp_path):
    """Where each effect has its own error no p rests on the residuals, yet they are shown."""
    success("analyze", TABLES / "blocked.csv", "--response", "y", "--factors", "a,b",
            "--block", "s", "--report", tmp_path)  # fmt: skip
    page = (tmp_path / "blocked-y-details.html").read_text(encoding="utf-8")
    assert "versus order" in page
    assert "No p of this page rests on them" in page
    with (tmp_path / "blocked-y-data" / "rows.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    # additive fit of 6 cells and 5 blocks: leverage 1/6 + 1/5 - 1/30 in every row
    assert {round(float(row["leverage"]), 9) for row in rows} == {round(1 / 3, 9)}


def test_an_interaction_alone_with_a_cell_missing_is_told_in_words(tmp_path):
    """The column of a cell without rows is zero."""
    rows = [f"{a},{b},{9 + k + (a == b)}" for a in "xyz" for b in "xyq" for k in range(3)]
    rows = [row for row in rows if not row.startswith("z,q")]
    (tmp_path / "t.csv").write_text("\n".join(["a,b,y", *rows]))
    flags = ["--response", "y", "--factors", "a,b", "--model", "a:b"]
    answer = success("analyze", tmp_path / "t.csv", *flags)
    assert "a:b at z q" in answer.err
    assert "Box-Cox exponent" in answer.out


def test_a_result_shows_itself_in_a_notebook(tmp_path):
    import study as package

    found = package.analyze(TABLES / "battery_life.csv", "life", ["material", "temperature"],
                            practical=10)  # fmt: skip
    frame = found.to_frame()
    assert frame.loc[frame["term"] == "material", "ss"].item() == pytest.approx(
        10683.72, abs=0.0051
    )
    assert "matters" in found._repr_html_()
    axes = found.plot().axes[0]
    assert "largest difference" in axes.get_xlabel()
    assert found.report(tmp_path).name == "table-life.html"
    assert {"analyze", "anova"} <= set(dir(package))
    assert found.warn("said").notes[-1] == "said"


NOT_A_NUMBER = re.compile(r"(?<!\w)(nan|-?inf)(?!\w)", re.ASCII)


def answered(seed, folder, monkeypatch):
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
        assert answer.json is not None  # a bare NaN is none
    else:
        assert not NOT_A_NUMBER.search(answer.out), seed
    return answer.code == 0


LONG = pytest.param(range(30, 10_000), marks=[pytest.mark.slow, pytest.mark.verify])


@pytest.mark.parametrize("seeds", [range(30), LONG])
def test_random_tables_are_answered_or_refused_in_words(tmp_path, monkeypatch, seeds):
    good = sum(answered(seed, tmp_path, monkeypatch) for seed in seeds)
    # tables that only were refused would show nothing of the analysis
    assert good > len(seeds) // 8


def test_rows_that_are_fitted_exactly_have_a_page(tmp_path):
    """Leverage one leaves 0 / 0 for Cook's distance: such rows once lost the figure."""
    rows = ["a,b,y", "p,u,1", "p,v,2.5", "p,v,3", "q,u,4", "q,u,5.5", "q,v,6", "q,v,7"]
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    answer = success("analyze", tmp_path / "t.csv", "y ~ a * b", "--report", tmp_path / "page")
    page = Path(answer.out.rpartition("report: ")[2].strip())
    assert "Figure missing" not in page.with_stem(f"{page.stem}-details").read_text("utf-8")


@pytest.mark.parametrize(("copies", "hangs"), [(4, True), (16, False)])
def test_a_claim_that_hangs_on_missing_responses_says_so_in_the_answer(tmp_path, copies, hangs):
    """Beside a claim that another answer of two missing rows takes away, every check passed."""
    rng = np.random.default_rng(11)
    rows = [
        f"{t},{gel},{5 + 2 * (t == 37) + (gel == 'B') + rng.normal(0, 0.3):.3f}"
        for t in (20, 37) for gel in "ABC" for _ in range(copies)
    ]  # fmt: skip
    rows[0], rows[-3] = rows[0].rsplit(",", 1)[0] + ",", rows[-3].rsplit(",", 1)[0] + ",-"
    (tmp_path / "t.csv").write_text("\n".join(["t,gel,y", *rows]) + "\n")
    answer = success("analyze", tmp_path / "t.csv", "y ~ t * gel", "--practical", 0.5,
                     "--report", tmp_path, "--json")  # fmt: skip
    page = Path(answer.json["report"]).read_text("utf-8")
    bounds = {bound["term"]: bound["verdicts"] for bound in answer.json["failure_bounds"]}
    assert (len(bounds["gel"]) > 1) == hangs
    assert {e["verdict"] for e in answer.json["effects"] if e["term"] == "gel"} == {"matters"}
    assert ("only if the missing responses are like the others" in page) == hangs
    assert ("It stands only if they are like the others." in page) == hangs
    assert ("No claim hangs on them." in page) != hangs


def test_an_interval_beyond_what_matters_without_a_claim_says_why(tmp_path):
    """One level scatters by 20, three by .1: pooled intervals claim what Welch's do not."""
    levels = {"x": (20, 60, 25, 55), "y": (9.9, 10.1, 10, 10.02), "z": (12, 12.1, 11.9, 12.03),
              "w": (11, 11.1, 10.9, 11.04)}  # fmt: skip
    rows = [f"{level},{value}" for level, values in levels.items() for value in values]
    (tmp_path / "spread.csv").write_text("\n".join(["a,y", *rows]) + "\n")
    asked = ("--response", "y", "--factors", "a", "--practical", "2", "--report", "out")
    success("analyze", "spread.csv", *asked, folder=tmp_path)
    first = (tmp_path / "out" / "spread-y.html").read_text(encoding="utf-8")
    assert re.search(r"; a lies beyond what matters, but [^;]*Welch", first)
