"""`study plan` of designs other than the full factorial: their cells, counted another way."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.cli.small import study

BASE = """
schema = 1
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "bonded"
displacement = "5 mm"
[material]
model = "neo-hookean"
C10 = "5 kPa"
poisson_ratio = 0.45
[measurements]
file = "tests.csv"
columns = { displacement = "displacement_mm", force = "force_N" }
units = { displacement = "mm", force = "N" }
[[response]]
name = "work_error"
"""
SIX_RANGES = """
[factors]
specimen.radius = { low = "20 mm", high = "30 mm" }
specimen.height = { low = "25 mm", high = "35 mm" }
test.displacement = { low = "3 mm", high = "5 mm" }
material.C10 = { low = "4 kPa", high = "6 kPa" }
material.poisson_ratio = { low = 0.4, high = 0.48 }
model.mesh_size = { low = "2 mm", high = "4 mm" }
"""
FIVE_CHOICES = """
[factors]
model.space = ["axisymmetric", "3d"]
model.element_order = ["linear", "quadratic"]
model.element_shape = ["simplex", "tensor"]
model.formulation = ["mixed", "displacement"]
model.mesh = ["coarse", "fine"]
"""


@pytest.fixture
def design(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "data").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path / "design.toml"


def test_box_behnken_of_six_factors_is_the_published_one(design: Path) -> None:
    # Box and Behnken 1960: 48 runs beside the center, each factor in half of them at its ends,
    # which are three of the six blocks of eight runs
    design.write_text(f'{BASE}{SIX_RANGES}[design]\nkind = "box-behnken"\n')
    told = study("plan", design, "--data", "data", "--json").json["design"]
    assert told["cells"] == 49
    assert told["scheme"]["kind"] == "box-behnken"
    for factor in told["factors"]:
        counts = Counter(cell["levels"][factor["name"]] for cell in told["matrix"])
        assert [counts[label] for label in factor["levels"]] == [12, 25, 12]


def test_a_fraction_is_analyzed_for_what_it_can_tell(design: Path) -> None:
    # 2^(5-1) with I = ABCDE has 16 cells: 15 effects of one and two factors, and none of three
    table = '[design]\nkind = "fractional"\nresolution = 5\n'
    design.write_text(f"{BASE}{FIVE_CHOICES}{table}")
    told = study("plan", design, "--data", "data", "--json").json["design"]
    assert (told["cells"], told["scheme"]["resolution"]) == (16, 5)
    design.write_text(f'{BASE}{FIVE_CHOICES}{table}[analysis]\nmodel = "full"\n')
    answer = study("plan", design, "--data", "data")
    assert answer.code == 2
    assert "analysis.model: asks for 31 terms, of which 16 cells tell 15 apart" in answer.err
    assert "leave it out (model = 2), or list terms" in answer.err
