"""Bad input: exit 2, an error that says key, rule, value and mend, and nothing written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.small import Edit, refusal

Lines = Callable[[list[str]], list[str]]


def refused(home: Path, *arguments: object) -> str:
    """Run a command that must be refused, and give back what it says."""
    before = {p: p.stat().st_mtime_ns for p in home.rglob("*")}
    answer = refusal(*arguments)
    assert answer.out == ""
    assert "Traceback" not in answer.err
    assert {p: p.stat().st_mtime_ns for p in home.rglob("*")} == before
    return answer.err


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        # a missing unit
        (
            'radius = "25 mm"',
            "radius = 25",
            ["specimen.radius", "needs a unit", "25", 'write "25 mm"'],
        ),
        # a misspelt key
        ('height = "30', 'hieght = "30', ["specimen.hieght", "unknown", "did you mean 'height'?"]),
        # an unknown level
        (
            '["neo-hookean", "mooney-rivlin"]',
            '["neo-hookean", "mooney-rivlim"]',
            ["factors.material[1]", "'mooney-rivlim'", "did you mean 'mooney-rivlin'?"],
        ),
        # a negative modulus
        (
            "incompressible = true",
            'incompressible = true\nmodel = "neo-hookean"\nC10 = "-5 kPa"',
            ["material.C10", "must be positive", "-10 kPa", "check the signs"],
        ),
        # further than the specimen is high
        (
            "[material]",
            'displacement = "40 mm"\n[material]',
            ["test.displacement", "40 mm reaches the height of the specimen, 30 mm", "smaller"],
        ),
        # malformed TOML, with its place
        ("[specimen]", "[specimen", ["small.toml:7:10", "not valid TOML", "quotes"]),
        ('"tests.csv"', '"../tests.csv"', ["measurements.file", "must not climb"]),
    ],
    ids=["unit", "key", "level", "modulus", "depth", "toml", "path"],
)
def test_faulty_designs(home: Path, edit: Edit, old: str, new: str, says: list[str]) -> None:
    edit(old, new)
    words = refused(home, "plan", "small.toml", "--data", "data")
    assert "small.toml" in words
    for piece in says:
        assert piece in words


def comma(lines: list[str]) -> list[str]:
    return [lines[0].replace(",", ";"), *(x.replace(",", ";").replace(".", ",") for x in lines[1:])]


def unreadable_comma(lines: list[str]) -> list[str]:
    # both columns of numbers get one more comma in every row
    return [lines[0], *(line.replace(".", ",") for line in lines[1:])]


def not_a_number(lines: list[str]) -> list[str]:
    return [*lines[:4], lines[4].rsplit(",", 1)[0] + ",nan", *lines[5:]]


def empty_cell(lines: list[str]) -> list[str]:
    return [*lines[:4], lines[4].rsplit(",", 1)[0] + ",", *lines[5:]]


def too_short(lines: list[str]) -> list[str]:
    return [lines[0], *(x for x in lines[1:] if float(x.split(",")[3]) < 4)]


def several_tests_in_one(lines: list[str]) -> list[str]:
    return [lines[0], *(x.replace(",2,", ",1,", 1) for x in lines[1:])]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: [], ["tests.csv", "the file is empty", "header"]),
        (lambda lines: lines[:1], ["tests.csv", "no row of data", "one row a sample"]),
        (comma, ["column 'd_mm'", "decimal comma", 'write decimal = ","']),
        (unreadable_comma, ["tests.csv:2", "7 cells where the header has 5", "every row needs 5"]),
        (not_a_number, ["tests.csv:5", "column 'f_N'", "'nan'", "must be left out"]),
        (empty_cell, ["tests.csv:5", "column 'f_N'", "the cell is empty", "delete the row"]),
        (too_short, ["mix = M1", "ends at 3.9 mm (13 %)", "6 mm (20 %)", "shorten the range"]),
        (several_tests_in_one, ["starts again", "several tests in one", "`average`"]),
    ],
    ids=["empty", "header", "comma", "commas", "nan", "blank", "short", "unsorted"],
)
def test_faulty_measurements(home: Path, change: Lines, says: list[str]) -> None:
    path = home / "data" / "tests.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())))
    words = refused(home, "plan", "small.toml", "--data", "data")
    for piece in says:
        assert piece in words


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run", "small.toml", "--data", "nowhere"], ["--data", "no folder 'nowhere'"]),
        (["plan", "small.toml", "--data", "nowhere"], ["--data", "no folder 'nowhere'"]),
        (["run", "small.toml"], ["no file 'tests.csv' below", "--data DIR"]),
        (["plan", "smal.toml"], ["smal.toml", "no such file", "did you mean 'small.toml'?"]),
        (["solve", "small.toml"], ["is a design", "study plan"]),
        (["plan", "problem.toml"], ["factors"]),
        (["calibrate", "problem.toml"], ["study solve"]),
        (["solve", "problem.toml", "-s", "material.C10=5"], ["material.C10", "needs a unit"]),
        (["solve", "problem.toml", "-s", "nonsense"], ["-s", "key=value", "nonsense"]),
        (
            ["solve", "problem.toml", "-s", 'model.mesh_sice="2 mm"'],
            ["model.mesh_sice", "did you mean 'mesh_size'?"],
        ),
        (["converge"], ["--values", "--sizes"]),
        (["converge", "--values", "1,x", "--sizes", "1,2"], ["--values", "numbers", "'1,x'"]),
        (["converge", "--values", "1,2", "--sizes", "1"], ["sizes"]),
        (["converge", "problem.toml", "--values", "1"], ["not both"]),
        (["converge", "small.toml", "--data", "data", "--memory", "900"], ["--memory", "--jobs"]),
        (["analyze", "no.csv", "--response", "a", "--factors", "b"], ["no.csv"]),
        (["analyze", "data/tests.csv"], ["--response", "--factors"]),
        (
            ["analyze", "data/tests.csv", "--response", "fN", "--factors", "mix"],
            ["no such column", "did you mean 'f_N'?"],
        ),
        (["new", "small.toml"], ["small.toml", "exists already"]),
        (["run", "small.toml", "--dta", "data"], ["--dta", "--data"]),
        (["rnu", "small.toml"], ["rnu", "run"]),
    ],
)
def test_faulty_commands(home: Path, arguments: list[str], says: list[str]) -> None:
    words = refused(home, *arguments)
    for piece in says:
        assert piece in words


def test_all_faults_come_at_once(home: Path, edit: Edit) -> None:
    edit('radius = "25 mm"', "radius = 25")
    edit('kind = "compression"', 'kind = "compresion"')
    edit('practical = "0.5 pp"', 'practical = "0.5 N"')
    words = refused(home, "run", "small.toml", "--data", "data")
    assert words.startswith("3 errors:")
    for key in ("specimen.radius", "test.kind", "response[0].practical"):
        assert key in words


def test_equal_faults_are_told_once_with_their_places(home: Path) -> None:
    path = home / "data" / "tests.csv"
    path.write_text("\n".join(too_short(path.read_text().splitlines())))
    words = refused(home, "run", "small.toml", "--data", "data")
    assert words.count("shorten the range") == 1
    assert "the same at: " in words
    assert "and 8 more" in words


MEASURED = """
schema = 1
[specimen]
shape = "cylinder"
radius = "9 mm"
height = "20 mm"
[test]
kind = "compression"
[material]
model = "yeoh"
incompressible = true
[measurements]
file = "a.csv"
[calibration]
method = "auto"
"""


@pytest.mark.parametrize(
    ("text", "verbs", "mend"),
    [
        ("[recording]\nfile = 'a.csv'\n[factors]\na = 1", ("plan", "run"), "study tracking"),
        ("[material]\n[requirement]\naccuracy = '5 %'", ("plan", "solve"), "study require"),
        ("[specimen]\n[test]\n[material]\n[model]", ("plan", "run"), "study export"),
        (MEASURED, ("plan", "solve", "calibrate"), "[[tests]]"),
    ],
    ids=["tracker", "sensors", "problem", "single"],
)
def test_a_file_of_another_verb_names_that_verb(
    tmp_path: Path, text: str, verbs: tuple[str, ...], mend: str
) -> None:
    (tmp_path / "file.toml").write_text(text)
    for verb in verbs:
        message = refused(tmp_path, verb, tmp_path / "file.toml")
        assert message.startswith("error:")  # one fault, not a list of missing keys
        assert mend in message


def test_a_value_without_its_unit_names_its_option(tmp_path: Path) -> None:
    file = Path(__file__).parents[2] / "designs" / "tests-of-material.toml"
    message = refused(tmp_path, "calibrate", file, "--by", "test", "--difference", "5")
    assert "--difference: needs a unit" in message


@pytest.mark.parametrize("name", ["case.json", "problem.json"])
def test_a_file_that_every_case_gets_is_not_among_those_that_go_along(
    tmp_path: Path, name: str
) -> None:
    forward = f'[forward]\nmodel = "command"\nargv = [["true"]]\nfiles = ["{name}"]\n'
    text = f"""[study]\nname = "own"\n[parameters]\na = 1\n{forward}
[factors]\n"parameters.a" = [1, 2]\n[[response]]\nname = "peak"\nunit = "N"\n"""
    (tmp_path / "own.toml").write_text(text)
    assert f"holds {name}, which this package writes" in refused(
        tmp_path, "plan", tmp_path / "own.toml"
    )
