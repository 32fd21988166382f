"""Pages of the documentation name files, commands and tests that exist."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from study.cli.app import app
from study.harness.design import load
from study.laboratory.tracker.tracker_recording import is_tracking

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: files of this repository, as a command or a sentence names them
SHIPPED = re.compile(r"(?<![\w/.-])(?:designs|validation|scripts|benchmarks)/[\w/.-]*\w")


def named(page):
    """Files of the repository that a page names; a folder of results below one is none."""
    return set(SHIPPED.findall(page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_a_page_names_ships(page):
    assert [name for name in sorted(named(page)) if not (ROOT / name).exists()] == []


def test_some_page_names_files():
    assert len(set().union(*map(named, PAGES))) > 15


# Commands of docs/thesis.md: the verb, its options, the designs and their overrides exist.

THESIS = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for block in re.findall(r"^```sh\n(.*?)^```$", THESIS, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]


def parsed(line):
    """Parse a command as the program does, without running it."""
    name, verb, *rest = shlex.split(line)
    assert name == "study"
    commands = typer.main.get_command(app)
    command = commands.commands.get(verb)
    assert command is not None, f"no verb {verb!r}"
    return command.make_context(verb, rest)


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_is_understood(line):
    found = parsed(line)
    for word in shlex.split(line):
        if word.startswith("designs/"):
            assert (ROOT / word).is_file(), word
    if found.info_name == "virtual":
        # the overrides name keys of the design
        if is_tracking(ROOT / found.params["source"]):
            return
        load.load(ROOT / found.params["source"], found.params["settings"] or ())


def test_every_part_has_its_command():
    parts = re.split(r"^## \d\. ", THESIS, flags=re.MULTILINE)[1:]
    assert len(parts) == 9
    for part in parts:
        assert "```sh\nstudy " in part, part.splitlines()[0]
        assert "**Not comparable:**" in part, part.splitlines()[0]


@pytest.mark.parametrize("line", ["study calibrat a.toml", "study calibrate a.toml --bye test"])
def test_a_wrong_command_is_seen(line):
    with pytest.raises(Exception, match="no verb|[Nn]o such option"):
        parsed(line)


# The table of provoked faults: a row for each, and tests that exist.

FAULTS = ROOT / "docs" / "faults.md"
ROW = re.compile(r"^\| (F\d\d) .*\| (.*) \|$", re.MULTILINE)


def test_every_fault_has_a_test_that_exists():
    rows = dict(ROW.findall(FAULTS.read_text(encoding="utf-8")))
    assert list(rows) == [f"F{number:02}" for number in range(1, 39)]
    for fault, cell in rows.items():
        named = re.findall(r"`([\w/]+\.py)::(\w+)`", cell)
        assert named, fault
        for file, test in named:
            text = (ROOT / "tests" / file).read_text(encoding="utf-8")
            assert re.search(rf"^def {test}\(", text, re.MULTILINE), f"{fault}: {file}::{test}"
