"""Commands of docs/thesis.md: the verb, its options, the designs and their overrides exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from study.cli.app import app
from study.harness.design import load
from study.laboratory.tracker.tracker_recording import is_tracking

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for block in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]


def parsed(line: str) -> Any:
    """Parse a command as the program does, without running it."""
    name, verb, *rest = shlex.split(line)
    assert name == "study"
    commands: Any = typer.main.get_command(app)
    command = commands.commands.get(verb)
    assert command is not None, f"no verb {verb!r}"
    return command.make_context(verb, rest)


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_is_understood(line: str) -> None:
    found = parsed(line)
    for word in shlex.split(line):
        if word.startswith("designs/"):
            assert (ROOT / word).is_file(), word
    if found.info_name == "virtual":
        # the overrides name keys of the design
        if is_tracking(ROOT / found.params["source"]):
            return
        load.load(ROOT / found.params["source"], found.params["settings"] or ())


def test_every_part_has_its_command() -> None:
    parts = re.split(r"^## \d\. ", PAGE, flags=re.MULTILINE)[1:]
    assert len(parts) == 9
    for part in parts:
        assert "```sh\nstudy " in part, part.splitlines()[0]
        assert "**Not comparable:**" in part, part.splitlines()[0]


@pytest.mark.parametrize("line", ["study calibrat a.toml", "study calibrate a.toml --bye test"])
def test_a_wrong_command_is_seen(line: str) -> None:
    with pytest.raises(Exception, match="no verb|[Nn]o such option"):
        parsed(line)
