"""Hostile names in the files beside a page: SVG, CSV, LaTeX and the printed PDF."""

import csv
import io
import re
import shutil
import subprocess
import zlib
from xml.etree import ElementTree

import pytest

from study.reporting.figures.axes import data_alone
from study.reporting.output import write
from tests.reporting.test_page import ALL_IN_ONE, CORPUS, hostile

#: one name that speaks to every language; the whole of the corpus is slow
FEW = ALL_IN_ONE[:1]
SLOW = [pytest.param(evil, marks=[pytest.mark.slow, pytest.mark.verify]) for evil in CORPUS]
RUNS = re.compile(r"^[\s\ufeff]*[=+\-@\t\r|%]")
#: what a name in LaTeX may become, and what a document has besides
COMMANDS = re.compile(r"\\([a-zA-Z]+|[^a-zA-Z])")


def number(text):
    try:
        float(text.replace("\u2212", "-").replace(",", ""))
    except ValueError:
        return False
    return True


@pytest.fixture(scope="module")
def sound_commands(data, tmp_path_factory):
    """Commands that the LaTeX of a harmless report holds."""
    with data_alone():
        paper = write.write(data, tmp_path_factory.mktemp("sound"), ("tex",))
    return set(COMMANDS.findall(paper.read_text("utf-8")))


@pytest.mark.parametrize("evil", [*FEW, *SLOW], ids=range(len(FEW) + len(SLOW)))
def test_no_file_beside_the_page_runs_a_name(tmp_path, data, sound_commands, evil):
    report = write.write(hostile(data, evil), tmp_path / "report", ("html", "tex", "csv"))
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    # a name such as ../../x leads nowhere else
    assert all(path.is_relative_to(tmp_path / "report") for path in files)
    assert report.parent == tmp_path / "report"
    assert "Figure missing" not in report.read_text("utf-8")
    kinds = {path.suffix for path in files}
    assert {".svg", ".csv", ".tex", ".html"} <= kinds
    for path in files:
        if path.suffix == ".svg":
            check_svg(path.read_text("utf-8"))
        elif path.suffix == ".csv":
            check_csv(path.read_text("utf-8"))
        elif path.suffix == ".tex":
            check_latex(path.read_text("utf-8"), sound_commands)


def check_svg(text):
    """Well formed, drawn, and without anything that runs or asks for something."""
    assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\u202a-\u202e\u2066-\u2069]", text)
    for element in ElementTree.fromstring(text).iter():
        name = element.tag.rpartition("}")[2]
        assert name not in {"script", "foreignObject", "image", "iframe", "a", "animate", "set"}
        for key, value in element.attrib.items():
            plain = key.rpartition("}")[2]
            assert not plain.lower().startswith("on")
            assert plain != "href" or value.startswith("#")
            assert "javascript:" not in value
            assert not re.search(r"url\((?!#)", value)


def check_csv(text):
    """As many cells in every row, none of which a spreadsheet would run."""
    rows = list(csv.reader(io.StringIO(text)))
    assert len({len(row) for row in rows if row}) <= 1
    for row in rows:
        for cell in row:
            assert not RUNS.match(cell) or number(cell), cell
            assert "\x00" not in cell


def check_latex(text, sound):
    """No command that a harmless report has not, no formula but a sign, braces that close."""
    escaped = set(COMMANDS.findall("".join(write._SPECIAL.values())))
    assert set(COMMANDS.findall(text)) <= sound | escaped
    plain = COMMANDS.sub("", text)
    assert plain.count("{") == plain.count("}")
    formulas = re.findall(r"\$([^$]*)\$", re.sub(r"\\\$", "", text))
    assert set(formulas) <= {"-", r"\times"}


@pytest.mark.parametrize(
    ("check", "bad"),
    [
        (check_svg, ("<svg xmlns='http://www.w3.org/2000/svg'><script>x</script></svg>",)),
        (check_svg, ("<svg xmlns='http://www.w3.org/2000/svg' onload='x'/>",)),
        (check_csv, ("a,b\n1,=1+1\n",)),
        (check_latex, (r"\input{/etc/passwd}", {"textbf"})),
        (check_latex, ("$x$", set())),
    ],
)
def test_the_checks_see_what_is_wrong(check, bad):
    with pytest.raises(AssertionError):
        check(*bad)


@pytest.mark.slow
@pytest.mark.skipif(
    not any(map(shutil.which, write.BROWSERS)), reason="no Chromium or Chrome is installed"
)
def test_a_printed_page_runs_nothing(tmp_path, data):
    evil = "<script>document.title='run'</script> =cmd|' /C calc'!A0 $\\frac{a}{b}$"
    write.write(hostile(data, evil), tmp_path, ("html", "pdf"))
    (path,) = tmp_path.glob("*.pdf")
    raw = path.read_bytes()
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", raw, re.DOTALL)
    opened = b"".join(inflated(stream) for stream in streams)
    for action in (b"/JavaScript", b"/JS", b"/Launch", b"/EmbeddedFile", b"/OpenAction"):
        assert action not in raw
        assert action not in opened
    if shutil.which("pdftotext"):
        text = subprocess.run(["pdftotext", path, "-"], capture_output=True, check=True).stdout
        assert "document.title='run'" in " ".join(text.decode().split())


def inflated(stream):
    try:
        return zlib.decompress(stream)
    except zlib.error:
        return b""
