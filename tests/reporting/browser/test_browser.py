"""The report in a real browser: quiet, whole, within the screen, and deaf to hostile names."""

import json
import shutil
import subprocess

import pytest

from study.reporting.output import write
from tests.reporting.browser.devtools import IN_A_BROWSER, OVERFLOW
from tests.reporting.example import build
from tests.reporting.test_page import hostile

pytestmark = IN_A_BROWSER

EMPTY_FIGURES = """
[...document.querySelectorAll("figure svg, figure img")].filter((one) => {
  const box = one.getBoundingClientRect();
  return box.width < 50 || box.height < 50;
}).length
"""
FIGURES = 'document.querySelectorAll("figure").length'
DRAWN = 'document.querySelectorAll("figure svg, figure img").length'
# The first column of a table as written, and after each of two presses on its head.
SORT = """
(() => {
  const table = [...document.querySelectorAll(".scroll table")].find(
    (one) => one.querySelector("th button"));
  const column = () => [...table.tBodies[0].rows].map((row) => row.cells[0].textContent.trim());
  const before = column();
  const press = () => {
    table.querySelector("th button").click();
    return [column(), table.querySelector("th").getAttribute("aria-sort")];
  };
  return [before, press(), press()];
})()
"""
# Names that would change the title of the page if any of them ran.
HOSTILE = (
    "<script>document.title='run'</script>",
    '"><img src=x onerror="document.title=`run`">',
    "</style><script>document.title='run'</script>",
    "=cmd|' /C calc'!A0",
    r"$\frac{a}{b}$",
    "\u05e9\u05dc\u05d5\u05dd",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, both):
    """Folder with both pages under the names by which they lead to each other."""
    made = tmp_path_factory.mktemp("report")
    for name, text in zip(write.page_names("ecoflex-compression"), both, strict=True):
        (made / name).write_text(text, "utf-8")
    return made


@pytest.fixture(scope="module")
def page(folder):
    return folder / "ecoflex-compression-details.html"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 1280, 390])
def test_pages_are_quiet_whole_and_within_the_screen(tab, folder, width, scheme):
    for page in sorted(folder.glob("*.html")):
        tab.open(page, width, scheme)
        assert tab.ask("innerWidth") == width
        assert tab.ask(f'matchMedia("(prefers-color-scheme: {scheme})").matches')
        assert tab.complaints() == []
        assert tab.requests() == []
        assert tab.ask(OVERFLOW) <= 0
        assert tab.ask(DRAWN) >= tab.ask(FIGURES) > 0
        assert tab.ask(EMPTY_FIGURES) == 0


def test_effects_and_curves_stand_on_the_first_screen(tab, folder):
    """Beside each other at 1280 pixels; below each other, as wide as the phone, at 390."""
    places = """["overview", "few-curves"].map((name) => {
      const box = document.querySelector(`#f-${name} svg`).getBoundingClientRect();
      return [box.left, box.right, box.top, box.bottom];
    })"""
    first = folder / "ecoflex-compression.html"
    tab.open(first, 1280, "light")
    (_, right, top, _), (left, end, of_curves, bottom) = tab.ask(places)
    assert right < left < end <= 1280
    assert top == of_curves
    assert bottom <= 800
    tab.open(first, 390, "light")
    (_, right, _, bottom), (left, end, of_curves, _) = tab.ask(places)
    assert 0 <= left < right == end <= 390
    assert bottom < of_curves


def test_the_first_page_has_three_screens_at_most(tab, folder):
    tab.open(folder / "ecoflex-compression.html", 1280, "light")
    assert tab.ask("document.documentElement.scrollHeight") <= 3 * 800
    words = "document.body.innerText.split(/\\s+/).filter((one) => /[\\p{L}\\p{N}]/u.test(one))"
    assert tab.ask(f"{words}.length") <= 700
    tab.ask("document.querySelector('footer a').click();0")
    assert str(tab.ask("location.pathname")).endswith(".html")


@pytest.mark.parametrize("width", [1400, 390])
def test_words_written_above_leave_the_parts_that_hold_them(tab, page, width):
    tab.open(page, width, "light")
    shown = "[...document.querySelectorAll('main > section')].filter((one) => !one.hidden).length"
    tab.ask("const box = document.querySelector('.filter input');0")

    def write_words(words):
        tab.ask(f"box.value = {json.dumps(words)}; box.dispatchEvent(new Event('input'));0")
        return tab.ask(shown)

    every = tab.ask(shown)
    assert write_words("no such word") == 0
    few = write_words("Greenhouse")
    assert 0 < few < every
    assert write_words("") == every


def test_pressed_head_sorts_its_table(tab, page):
    tab.open(page, 1400, "light")
    before, (up, first), (down, second) = tab.ask(SORT)
    assert (first, second) == ("ascending", "descending")
    assert up == sorted(before, key=str.lower)
    assert down == sorted(before, key=str.lower, reverse=True)
    assert up != down


def test_faults_of_a_page_are_seen(tab, tmp_path):
    path = tmp_path / "bad.html"
    path.write_text(
        "<title>x</title><div style='width:3000px'>x</div><img src='http://127.0.0.1:9/x.png'>"
        "<script>document.title='run'; console.error('x')</script>"
    )
    tab.open(path, 390, "light")
    assert tab.complaints()
    assert tab.requests() == ["http://127.0.0.1:9/x.png"]
    assert tab.ask(OVERFLOW) > 2000
    assert tab.ask("document.title") == "run"


@pytest.mark.parametrize("name", HOSTILE, ids=range(len(HOSTILE)))
def test_hostile_names_run_nothing(tab, tmp_path, data, name):
    path = tmp_path / "hostile.html"
    path.write_text(build(hostile(data, name)), "utf-8")
    tab.open(path, 1400, "light")
    assert tab.complaints() == []
    assert tab.requests() == []
    assert tab.ask("document.title") != "run"
    assert tab.ask(f"document.body.textContent.includes({json.dumps(name)})")


def test_printed_page_has_an_outline(tmp_path, page):
    write.print_page(page, tmp_path / "r.pdf")
    assert b"/Outlines" in (tmp_path / "r.pdf").read_bytes()


@pytest.mark.skipif(not shutil.which("pdftotext"), reason="pdftotext (poppler) is not installed")
def test_printed_page_holds_the_answer(tmp_path, tab, page):
    tab.open(page, 1400, "light")
    answer = str(tab.ask('document.querySelector("#answer p").textContent')).split()
    write.print_page(page, tmp_path / "r.pdf")
    text = subprocess.run(
        ["pdftotext", tmp_path / "r.pdf", "-"], capture_output=True, check=True, text=True
    )
    assert " ".join(answer[:4]) in " ".join(text.stdout.split())
