"""Files: the data beside the page, safe CSV, LaTeX, PDF, terminal tables."""

import csv
import gc
import io
import json
import re
import shutil
from dataclasses import replace

import pandas as pd
import pytest
from matplotlib.figure import Figure as Drawing

from study.ground.errors import InputError
from study.reporting.content import tables
from study.reporting.content.blocks import Figure, Heading, Table
from study.reporting.content.report_facts import facts
from study.reporting.output import write
from study.reporting.output.terminal import say
from tests.reporting.example import unreplicated


@pytest.fixture
def quick(monkeypatch, contents):
    """Reuse the report of the session: these tests are about files."""
    monkeypatch.setattr(write, "prepare", lambda data, worker: contents)


@pytest.mark.usefixtures("quick")
def test_writes_pages_and_data_beside(tmp_path, data, both):
    main = write.write(data, tmp_path / "new folder", ("csv", "tex", "html"))
    assert main == tmp_path / "new folder" / "ecoflex-compression.html"
    written = (main, main.with_stem("ecoflex-compression-details"))
    assert tuple(path.read_text("utf-8") for path in written) == both
    beside = main.parent / "ecoflex-compression-data"
    names = {path.name for path in beside.iterdir()}
    assert {"numbers.json", "cases.csv", "table-verdicts.csv", "figure-curves.csv"} <= names
    assert not [name for name in names if name.endswith(".part")]
    linked = set(re.findall(r'href="ecoflex-compression-data/([^"]+)"', "".join(both)))
    assert "figure-curves.svg" in linked
    assert linked <= names
    numbers = json.loads((beside / "numbers.json").read_text())
    assert set(numbers["responses"]) == {"relative_rms_force_error", "mu0"}
    assert len(pd.read_csv(beside / "cases.csv")) == 288


def test_no_drawing_outlives_its_report(tmp_path):
    before = drawings()
    write.write(unreplicated(), tmp_path)
    assert drawings() <= before


def drawings():
    gc.collect()
    return {id(one) for one in gc.get_objects() if isinstance(one, Drawing)}


@pytest.mark.usefixtures("quick")
def test_reference_cycles_are_looked_for_again_after_a_report(tmp_path, data, monkeypatch):
    def broken(data, beside):
        assert not gc.isenabled()
        raise OSError("disk full")

    monkeypatch.setattr(write, "write_numbers", broken)
    with pytest.raises(OSError, match="disk full"):
        write.write(data, tmp_path)
    assert gc.isenabled()


def test_pdf_without_a_browser_says_how_to_mend(monkeypatch, tmp_path, data):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="apt-get install chromium"):
        write.write(data, tmp_path / "x", ("html", "pdf"))
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    "evil", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "  =1+1", "=cmd|' /C calc'!A0"]
)
def test_text_cells_are_no_formulas(evil):
    rows = list(csv.reader(io.StringIO(write.of_rows([evil], [[evil]]))))
    assert all(cell.startswith("'") for row in rows for cell in row)


def test_numbers_stay_numbers_in_csv():
    frame = pd.DataFrame({
        "a": [-1.5, float("nan"), float("inf")], "b": ["x,y", 'q"', None], "c": [1, "-x", 2.5],
        "d": pd.Categorical(["u", "-v", "u"]), "e": pd.array([1, None, 3], dtype="Int64"),
        "f": [True, False, True],
    })  # fmt: skip
    assert write.of_frame(frame) == (
        'a,b,c,d,e,f\n-1.5,"x,y",1,u,1,True\n,"q""",\'-x,\'-v,,False\n,,2.5,u,3,True\n'
    )


def test_tex_has_no_command_of_a_user():
    text = write.escape(r"\input{/etc/passwd} $x$ 50% & #1 ~ ^ _")
    assert r"\input" not in text
    assert text.startswith(r"\textbackslash{}input\{")
    made = write.table(Table("t", ("a_b", "n"), (("x&y", "1"),)), "50 %", "t")
    assert r"a\_b & n \\" in made
    assert r"\begin{tabular}{lr}" in made
    assert r"\label{tab:t}" in made


def test_latex_of_two_reports_has_no_label_twice_and_no_cell_that_is_a_command():
    """Behind the end of a row a bracket or an asterisk is read as an option of that end."""
    table = Table("anova", ("depth", 'plate 5"'), (("[0, 5)", "1"), ("*", "2")))
    first, second = (write.document([("ANOVA", table)], "", stem) for stem in ("wool", "npk"))
    labels = [re.findall(r"\\label\{(.*)\}", text) for text in (first, second)]
    assert labels == [["tab:wool-anova"], ["tab:npk-anova"]]
    assert not re.search(r"\\\\\s*[\[*]", first)
    assert r"\textquotedbl" not in first  # no command of the usual encoding


def test_a_terminal_has_a_table_for_each_response(data, capsys):
    whole = tables.verdicts(facts(data), data)
    say([Heading("a\N{NO-BREAK SPACE}b"), whole, Figure("f", "no place here"), None])
    shown = capsys.readouterr().out
    titles = ["relative RMS force error", "initial shear modulus"]
    assert [line.strip() for line in shown.splitlines() if line.strip() in titles] == titles
    assert shown.count(whole.columns[3]) == len(titles)
    assert whole.columns[0] not in shown
    assert shown.startswith("\na b\n")
    assert "no place here" not in shown
    assert "\N{NO-BREAK SPACE}" not in shown
    for row in whole.rows:
        assert row[3].replace("\N{NO-BREAK SPACE}", " ") in shown


def test_matrix_survives_colons_in_levels(data):
    table = data.table.assign(plates=data.table["plates"].str.replace("bonded", "a:b"))
    factors = {**data.factors, "plates": ("frictionless", "a:b")}
    changed = replace(data, table=table, factors=factors)
    rows = tables.matrix(changed, facts(changed)).rows
    assert {row[1] for row in rows} == {"frictionless", "a:b"}


# From a mean to the records behind it: the matrix leads to the cases of a cell.


def test_every_cell_leads_to_its_own_cases(data, contents):
    cells, records = contents.tables["cells"], contents.tables["records"]
    factors = len(data.factors)
    assert len(records.rows) == len(data.table)
    firsts = {name: k for k, name in enumerate(records.anchors) if name}
    for row, link in zip(cells.rows, cells.links, strict=True):
        start = firsts[link]
        count = int(row[factors].split(" of ")[1])
        mine = records.rows[start : start + count]
        assert {one[:factors] for one in mine} == {row[:factors]}
        # and no other case is of this cell
        assert sum(one[:factors] == row[:factors] for one in records.rows) == count


def test_cells_stand_in_the_order_of_the_design(data):
    shuffled = replace(data, table=data.table.sample(frac=1.0, random_state=1))
    plain, mixed = (tables.case_records(d, facts(d)) for d in (data, shuffled))
    assert mixed is not None
    assert plain.rows == mixed.rows
    order = [
        [levels.index(label) for label, levels in zip(row, data.factors.values(), strict=False)]
        for row in mixed.rows
    ]
    assert order == sorted(order)


def test_a_page_lists_no_more_than_it_can_hold(data, monkeypatch):
    monkeypatch.setattr(tables, "MOST", len(data.table) - 1)
    assert tables.case_records(data, facts(data)) is None
