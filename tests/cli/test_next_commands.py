"""What the program says to type next works when it is typed; so do --version and completion."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import study as package
from tests.cli.small import Answer, study

PROGRAM = "from study.cli import main; main()"


def commands(answer: Answer) -> list[str]:
    """Return the indented commands that follow the line of the next step."""
    assert answer.code in (0, 1), answer.err
    return [
        line.strip()
        for line in (answer.out + answer.err).splitlines()
        if line.startswith("  study ")
    ]


def typed(command: str) -> Answer:
    program, *arguments = shlex.split(command)
    assert program == "study"
    return study(*arguments)


def test_version_is_that_of_the_package() -> None:
    answer = study("--version")
    assert (answer.code, answer.out) == (0, f"study {package.__version__}\n")


def offered(words: str, folder: Path | None = None) -> list[str]:
    """What a shell shows after these words; the last one is not finished."""
    asked = {
        "_STUDY_COMPLETE": "complete_bash", "COMP_WORDS": words,
        "COMP_CWORD": str(words.count(" ")),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**os.environ, **asked}, text=True,
        capture_output=True, check=False, cwd=folder,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.parametrize(
    ("words", "expected"),
    [("study plan --au", ["--augment"]), ("study re", ["report", "require"])],
)
def test_a_shell_completes_verbs_and_options(words: str, expected: list[str]) -> None:
    assert offered(words) == expected


def test_a_shell_completes_studies_designs_tables_and_cases(tmp_path: Path) -> None:
    for name in ("designs/disc.toml", "discs.csv", "notes.txt", "results/disc/cases/0a1b/x"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert set(offered("study status d", tmp_path)) == {"designs/", "disc"}
    assert set(offered("study run designs/", tmp_path)) == {"designs/disc.toml"}
    assert set(offered("study analyze d", tmp_path)) == {"designs/", "disc", "discs.csv"}
    assert set(offered("study why 0", tmp_path)) == {"0a1b"}
    assert set(offered("study verify x", tmp_path)) == set()
    assert set(offered("study report --results designs d", tmp_path)) == {"designs/"}


def test_a_new_file_runs_with_the_commands_that_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From nothing to a plan with its cases, typing only what was printed."""
    monkeypatch.chdir(tmp_path)
    make, plan = commands(study("new", "mine.toml"))
    assert plan == "study plan mine.toml"
    # without measurements a plan names the same command that makes them
    assert commands(typed(plan)) == [make]
    assert commands(typed(make)) == [plan]
    planned = typed(plan)
    assert "48 cases: 0 done, 0 failed, 48 missing" in planned.out
    assert "8 cells in 6 blocks" in planned.out
    assert commands(planned) == ["study run mine.toml"]


def test_measurements_elsewhere_are_named_again(home: Path) -> None:
    (told,) = commands(study("virtual", "else where", "--from", "small.toml"))
    assert told == "study plan small.toml --data 'else where'"
    (run,) = commands(typed(told))
    assert run == "study run small.toml --data 'else where'"


@pytest.mark.parametrize("place", ["designs/measurements", "measurements", "designs"])
def test_measurements_are_found_beside_a_design(home: Path, place: str) -> None:
    """A folder that exists and lacks the file does not hide the one that has it."""
    for folder in ("designs/measurements", "measurements"):
        (home / folder).mkdir(parents=True)
    (home / "small.toml").rename(home / "designs" / "small.toml")
    (home / "data" / "tests.csv").rename(home / place / "tests.csv")
    planned = study("plan", "designs/small.toml", "--json")
    assert planned.json["blocks"] == ["M1", "M2", "M3"]
    assert planned.json["next"] == "study run designs/small.toml"


def test_the_first_of_two_complete_folders_is_taken(home: Path) -> None:
    rows = (home / "data" / "tests.csv").read_text()
    for folder, text in (("measurements", rows), ("designs/measurements", rows.replace("M1", "X"))):
        (home / folder).mkdir(parents=True)
        (home / folder / "tests.csv").write_text(text)
    (home / "small.toml").rename(home / "designs" / "small.toml")
    assert study("plan", "designs/small.toml", "--json").json["blocks"] == ["M1", "M2", "M3"]


def test_a_finished_study_names_what_checks_it(done: Path) -> None:
    planned = study("plan", "small.toml", "--data", "data")
    (again,) = commands(planned)
    assert again == "study report small"
    (page,) = commands(typed(again))  # the design asks for tables alone
    assert page == "study report small --format html"
    (check,) = commands(typed(page))
    assert check == "study verify small"
    checked = typed(check)
    assert checked.code == 0, checked.out
    assert "all agree" in checked.out


def test_a_study_that_was_named_by_its_folder_is_named_with_it(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (page,) = commands(study("report", done / "results/small", "--format", "csv"))
    assert page == f"study report small --results {done}/results --format html"


def test_settings_are_typed_again(home: Path) -> None:
    setting = "measurements.points=31"
    planned = study(
        "plan", "small.toml", "--data", "data", "--jobs", 1, "-s", setting, "--results", "r"
    )
    (run,) = commands(planned)
    assert run == f"study run small.toml --data data --jobs 1 -s {setting} --results r"
