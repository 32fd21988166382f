"""`study analyze CSV --report DIR`: the page, its numbers a second way, its command line."""

from __future__ import annotations

import csv
import hashlib
import json
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import Answer, refusal, success

TABLES = Path(__file__).parents[2] / "validation" / "statistics"
BATTERY = ("--response", "life", "--factors", "material,temperature")


@pytest.fixture(scope="module")
def battery(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the page of Montgomery's battery experiment."""
    folder = tmp_path_factory.mktemp("battery")
    shutil.copy(TABLES / "battery_life.csv", folder)
    answer = success("analyze", "battery_life.csv", *BATTERY, "--practical", "10",
                     "--reference", "material=1", "--report", "out", folder=folder)  # fmt: skip
    assert answer.out.splitlines()[-1] == "report: out/battery-life-life.html"
    return folder


def records(folder: Path, name: str) -> list[dict[str, str]]:
    path = folder / "out" / "battery-life-life-data" / name
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_the_page_answers_first_and_shows_every_part(battery: Path) -> None:
    first = (battery / "out" / "battery-life-life.html").read_text(encoding="utf-8")
    assert first.index('<section id="answer"') < first.index('<section id="effects"')
    assert 'href="battery-life-life-details.html"' in first
    assert first.count("<svg") == 1
    page = (battery / "out" / "battery-life-life-details.html").read_text(encoding="utf-8")
    parts = ["answer", "data", "error", "anova", "means", "pairs", "residuals", "assumptions",
             "methods", "provenance"]  # fmt: skip
    places = [page.index(f'<section id="{part}"') for part in parts]
    assert places == sorted(places)
    assert page.count("<svg") == 7
    assert "Figure missing" not in first + page
    assert "http://" not in page.replace("http://www.w3.org/", "")  # nothing is loaded
    for shown in ("10,684", "39,119", "9,613.8", "18,231", "76.52", "58.26",
                  "normal probability plot", "versus order", "RJ = 0.9868"):  # fmt: skip
        assert shown in page.replace("\N{NO-BREAK SPACE}", " "), shown


def test_pairs_are_tukeys(battery: Path) -> None:
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


def test_dunnett_takes_the_error_of_the_model(battery: Path) -> None:
    """Dunnett's two-sided 5 % point for 2 comparisons and 27 df lies between 2.35 and 2.32.

    Printed for 24 and 30 df (Montgomery 2017, table VI: 2.35, 2.32). The other factor is in the
    model: its effects are not in the error, as they would be in the scatter of the raw groups.
    """
    one = records(battery, "table-material-against-1.csv")[0]
    error = np.sqrt(2 * 18230.75 / 27 / 12)
    point = (float(one["upper"]) - float(one["lower"])) / 2 / error
    assert 2.31 < point < 2.36


def test_coefficients_are_those_of_least_squares(battery: Path) -> None:
    """The standard error of a level's coefficient is s sqrt((k - 1) / N), by hand."""
    table = {r["term"]: r for r in records(battery, "table-coefficients.csv")}
    assert float(table["Constant"]["estimate"]) == pytest.approx(105.5278, abs=5e-5)
    assert float(table["material[1]"]["estimate"]) == pytest.approx(83.1667 - 105.5278, abs=1e-4)
    s = np.sqrt(18230.75 / 27)
    assert float(table["material[1]"]["standard_error"]) == pytest.approx(s * np.sqrt(2 / 36))
    assert float(table["Constant"]["standard_error"]) == pytest.approx(s / 6)
    # the columns of one factor correlate by 1/2, so the variance inflation factor is 4/3
    assert float(table["material[1]"]["vif"]) == pytest.approx(4 / 3)


def test_rows_have_press_and_cook(battery: Path) -> None:
    """Leverage of a balanced cell is 1/4, so PRESS is e / (3/4); Cook's distance by its formula."""
    rows = records(battery, "rows.csv")
    assert len(rows) == 36
    s2 = 18230.75 / 27
    for row in rows:
        e = float(row["residual"])
        assert float(row["leverage"]) == pytest.approx(0.25)
        assert float(row["press"]) == pytest.approx(e / 0.75, abs=1e-9)
        assert float(row["cook"]) == pytest.approx(e**2 / (9 * s2) * 0.25 / 0.75**2, abs=1e-12)


def test_the_line_to_reproduce_works_when_pasted(battery: Path) -> None:
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


def test_json_names_the_page_and_other_formats_stand_beside(tmp_path: Path) -> None:
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


def test_blocks_have_residual_plots_too(tmp_path: Path) -> None:
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


def refused(*arguments: object) -> Answer:
    answer = refusal("analyze", *arguments)
    assert answer.out == ""
    return answer


def test_a_page_that_cannot_be_written_is_refused(
    tmp_path: Path,
) -> None:
    table = TABLES / "battery_life.csv"
    assert "add --report DIR" in refused(table, *BATTERY, "--format", "pdf").err
    assert "study report STUDY" in refused(tmp_path, *BATTERY, "--report", "out").err
    assert "did you mean 'html'" in refused(table, *BATTERY, "--report", tmp_path / "x",
                                            "--format", "htm").err  # fmt: skip
    assert "name a folder" in refused(table, *BATTERY, "--report", table).err


def test_a_column_that_differs_in_case_is_suggested() -> None:
    err = refused(TABLES / "battery_life.csv", "--response", "LIFE", "--factors", "Material").err
    assert "did you mean 'life'" in err
    assert "did you mean 'material'" in err


def test_an_interaction_alone_with_a_cell_missing_is_told_in_words(tmp_path: Path) -> None:
    """The column of a cell without rows is zero."""
    rows = [f"{a},{b},{9 + k + (a == b)}" for a in "xyz" for b in "xyq" for k in range(3)]
    rows = [row for row in rows if not row.startswith("z,q")]
    (tmp_path / "t.csv").write_text("\n".join(["a,b,y", *rows]))
    flags = ["--response", "y", "--factors", "a,b", "--model", "a:b"]
    answer = success("analyze", tmp_path / "t.csv", *flags)
    assert "a:b at z q" in answer.err
    assert "Box-Cox exponent" in answer.out


def test_a_result_shows_itself_in_a_notebook(tmp_path: Path) -> None:
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
    assert found.noted("said").notes[-1] == "said"
