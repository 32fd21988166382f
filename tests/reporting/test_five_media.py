"""A table, a study, a calibration: page, terminal, notebook, files hold equal numbers."""

import csv
import json
import re
from pathlib import Path

import pytest

import study
from study import analyze
from study.reporting.output import write
from tests.cli.small import CSV, DESIGN, success, write_files
from tests.reporting.example import data_alone, words_of

TABLE = Path(__file__).parents[2] / "validation" / "statistics" / "battery_life.csv"
ASKED = ("--response", "life", "--factors", "material,temperature", "--practical", "10")
STEM = "battery-life-life"
#: signs as LaTeX writes them
SIGNS = {
    "$-$": "\N{MINUS SIGN}", r"$\times$": "\N{MULTIPLICATION SIGN}", r"\textless{}": "<",
    r"\textgreater{}": ">",
}  # fmt: skip


@pytest.fixture(scope="module")
def media(tmp_path_factory):
    """What each medium says of one analysis."""
    folder = tmp_path_factory.mktemp("media")
    files = ("--report", folder, "--format", "html,tex,csv")
    with data_alone():
        shown = success("analyze", TABLE, *ASKED, *files)
        document = success("analyze", TABLE, *ASKED, "--json")
    page = (folder / f"{STEM}-details.html").read_text("utf-8")
    result = analyze(TABLE, "life", ["material", "temperature"], practical="10")
    return {
        "page": words_of(page),
        "notebook": words_of(result._repr_html_()),
        "prompt": re.sub(r"\s+", " ", repr(result)),
        "terminal": re.sub(r"\s+", " ", shown.out),
        "latex": (folder / f"{STEM}.tex").read_text("utf-8"),
        "json": document.out,
        **{name: (folder / f"{STEM}-data" / f"table-{name}.csv").read_text("utf-8")
           for name in ("anova", "verdicts", "means")},
    }  # fmt: skip


def latex_rows(text, label):
    """Cells of a table, as they are escaped."""
    body = text.partition(rf"\label{{tab:{STEM}-{label}}}")[2].partition(r"\end{tabular}")[0]
    body = body.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
    return [[cell.strip() for cell in row.split("&")] for row in body.split(r"\\") if row.strip()]


@pytest.mark.parametrize("name", ["anova", "verdicts", "means"])
def test_every_number_that_is_shown_is_shown_alike(media, name):
    rows = latex_rows(media["latex"], name)
    assert rows
    for row in rows:
        cells = [cell.replace("~", " ") for cell in row]
        for written, character in SIGNS.items():
            cells = [cell.replace(written, character) for cell in cells]
        # a page groups rows by the first cell, and both leave out what an empty cell holds
        line = " ".join(cell.replace("--", "\N{EN DASH}") for cell in cells[1:] if cell)
        for medium in ("page", "terminal", "notebook", "prompt"):
            assert line in media[medium], (medium, line)


def test_every_number_that_is_stored_is_equal_to_the_last_digit(media):
    document = json.loads(media["json"])
    stored = {row["term"]: row for row in csv.DictReader(media["anova"].splitlines())}
    for row in document["anova"]["rows"]:
        for key in ("df", "ss", "ms", "f", "p"):
            text = stored[row["term"]][key]
            assert (None if text == "" else float(text)) == row[key], (row["term"], key)
    sizes = {row["factor"]: row for row in csv.DictReader(media["verdicts"].splitlines())}
    for effect in document["effects"]:
        if ":" not in effect["term"]:
            row = sizes[effect["term"]]
            assert float(row["effect"]) == effect["range"]
            assert [float(row["low"]), float(row["high"])] == effect["ci95"]
            assert row["verdict"] == effect["verdict"]


def test_latex_has_a_label_and_the_rules_of_booktabs_for_each_table(media):
    count = media["latex"].count(r"\begin{table}")
    assert count >= 4
    labels = re.findall(r"\\label\{tab:([a-z0-9-]+)\}", media["latex"])
    assert len(set(labels)) == len(labels) == count
    for rule in ("toprule", "midrule", "bottomrule"):
        assert media["latex"].count(f"\\{rule}") == count


def test_a_p_is_written_one_way(media):
    for medium in ("page", "terminal", "notebook", "latex"):
        assert not re.search(r"\bp(-value)? ?(=|<|>) ?0\.\d", media[medium]), medium


#: one result on three ways: the command, the same in Python, the folder of its pages
SHOWN = {
    "study": (
        "run small.toml --data data --jobs 1",
        lambda: study.load("results/small"),
        "reports/small",
    ),
    "calibration": (
        "calibrate calibration.toml --data data",
        lambda: study.calibrate("calibration.toml", data="data", results="again"),
        "",
    ),
    "simulation": ("solve problem.toml", lambda: study.solve("problem.toml"), ""),
    # the page draws the solutions that the other two list
    "convergence": ("converge problem.toml", lambda: study.converge("problem.toml"), ""),
}
NUMBER = re.compile(
    r"(?<![\w.])[\N{MINUS SIGN}-]?\d*\.\d+(?:e[\N{MINUS SIGN}-]?\d+)?|\d+e\N{MINUS SIGN}\d+"
)


def numbers_of(text):
    """Numbers with a point: counts, levels and seconds of a run have none, or differ."""
    return NUMBER.findall(re.sub(r"\b[\d.]+ m?s\b", "", text.replace("\N{NO-BREAK SPACE}", " ")))


@pytest.mark.parametrize("name", SHOWN)
def test_a_notebook_shows_the_numbers_of_terminal_and_page(tmp_path, monkeypatch, name):
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(DESIGN.removesuffix(CSV), "utf-8")
    command, opened, folder = SHOWN[name]
    with data_alone():
        terminal = success(*command.split()).out
    result = opened()
    notebook = numbers_of(words_of(result._repr_html_()))
    assert len(notebook) > 5
    media = {"terminal": terminal, "prompt": repr(result)}
    if folder:  # a calibration and a simulation have no page
        pages = (path.read_text("utf-8") for path in Path(folder).glob("*.html"))
        media["page"] = " ".join(map(words_of, pages))
    for medium, text in media.items():
        assert not set(notebook) - set(numbers_of(text)), medium


def test_a_convergence_has_equal_numbers_in_six_media(tmp_path, monkeypatch):
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    with data_alone():
        terminal = success("converge", "problem.toml").out
        document = json.loads(success("converge", "problem.toml", "--json").out)
    result = study.converge("problem.toml")
    stem = Path("reports/problem/problem-convergence")
    page = words_of(stem.with_suffix(".html").read_text("utf-8"))
    (table,) = [block for block in result.blocks() if getattr(block, "name", "") == "quantities"]
    latex = write.table(table, "quantities", "quantities")
    for row in table.rows:
        cells = [cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row]
        texts = {"page": page, "terminal": terminal, "notebook": words_of(result._repr_html_()),
                 "prompt": repr(result)}  # fmt: skip
        for medium, text in texts.items():
            shown = re.sub(r"\s+", " ", text)
            assert all(cell in shown for cell in cells), (medium, cells)
        assert all(write.escape(cell) in latex for cell in row)
    stored = csv.DictReader(
        Path(f"{stem}-data", "table-series.csv").read_text("utf-8").splitlines()
    )
    for row in stored:
        of = document["quantities"][row["quantity"]]
        for key in ("u_num", "extrapolated", "observed_order", "formal_order", "gci_fine"):
            assert (float(row[key]) if row[key] else None) == of[key], key
        assert float(row["finest_value"]) == of["value"][0]
