"""What users type: the key ``kind`` of a file, settings of an option that is repeated."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.cli.study_commands import settings
from study.ground.errors import InputError
from study.harness.design.load import file_kind, load, load_problem
from tests.cli.small import DESIGN

PROBLEM = """
schema = 1
kind = "problem"
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "10 mm"
[test]
kind = "compression"
interface = "frictionless"
displacement = "1 mm"
[material]
model = "neo-hookean"
C10 = "10 kPa"
incompressible = true
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "file.toml"
    path.write_text(text)
    return path


def test_a_declared_kind_changes_nothing_of_what_is_read(tmp_path: Path) -> None:
    plain = load(written(tmp_path, DESIGN))
    declared = load(written(tmp_path, f'kind = "study"\n{DESIGN}'))
    assert declared.config == plain.config
    problem = written(tmp_path, PROBLEM)
    assert file_kind(problem) == "problem"
    assert load_problem(problem).problem.height_mm == 10.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PROBLEM.replace('"problem"', '"studdy"'), "did you mean 'study'"),
        (PROBLEM.replace('kind = "problem"', 'kind = "calibration"'), "is a calibration, not a pr"),
        (f'kind = "problem"\n{DESIGN}', "is 'problem', and the tables are those of a design"),
    ],
)
def test_a_wrong_kind_gets_the_right_word(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_problem(written(tmp_path, text))
    assert said in str(caught.value)


def test_settings_of_a_repeated_option_all_hold() -> None:
    assert settings(["a=1,b=2 mm", "c=3"]) == {"a": "1", "b": "2 mm", "c": "3"}
    with pytest.raises(InputError, match="each once"):
        settings(["a=1", "a=2"])
