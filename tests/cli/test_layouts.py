"""`study plan` of designs other than the full factorial: their cells, counted another way."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from pathlib import Path

import numpy as np
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


#: three factors of two levels and one of three: 24 combinations
MIXED = """
[presets.material.nh]
model = "neo-hookean"
C10 = "5 kPa"
[presets.material.mr]
model = "mooney-rivlin"
C10 = "4 kPa"
C01 = "1 kPa"
[presets.material.yeoh]
model = "yeoh"
C10 = "5 kPa"
C20 = "1 kPa"
C30 = "0.1 kPa"
[factors]
model.space = ["axisymmetric", "3d"]
model.element_order = ["linear", "quadratic"]
model.formulation = ["mixed", "displacement"]
material = ["nh", "mr", "yeoh"]
"""
UNSAID = 'model = "neo-hookean"\nC10 = "5 kPa"\n'


def counted(told: dict, *names: str) -> Counter[tuple[str, ...]]:
    return Counter(tuple(cell["levels"][name] for name in names) for cell in told["matrix"])


def test_a_d_optimal_design_is_the_orthogonal_array_where_there_is_one(design: Path) -> None:
    """2^3 x 3 in 12 cells: main effects are orthogonal where every pair of levels is balanced."""
    table = '[design]\nkind = "d-optimal"\nruns = 12\n'
    design.write_text(f"{BASE.replace(UNSAID, '')}{MIXED}{table}")
    told = study("plan", design, "--data", "data", "--json").json["design"]
    assert told["cells"] == 12
    names = ["model.space", "model.element_order", "model.formulation", "material"]
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            assert len(set(counted(told, first, second).values())) == 1
    assert "100.0 % of the precision" in told["scheme"]["summary"]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("runs = 5", "at least 6"),
        ("runs = 30", "24"),
        ('runs = 12\nterms = ["space:material"]', "model.space"),
        ("runs = 12\nterms = 9", "design.terms"),
        ('runs = 12\n[analysis]\nmodel = "full"', "of which 12 cells tell"),
    ],
)
def test_a_d_optimal_design_that_cannot_be_says_why(design: Path, table: str, said: str) -> None:
    text = f'{BASE.replace(UNSAID, "")}{MIXED}[design]\nkind = "d-optimal"\n{table}\n'
    design.write_text(text)
    answer = study("plan", design, "--data", "data")
    assert answer.code == 2
    assert said in answer.err


def test_further_cells_complete_a_half_fraction(design: Path) -> None:
    """2^(3-1) and four further cells are the whole 2^3, which tells all terms apart."""
    names = ["model.space", "model.element_order", "model.element_shape"]
    three = FIVE_CHOICES.split("model.formulation")[0]
    fraction = '[design]\nkind = "fractional"\nresolution = 3\n'
    design.write_text(f"{BASE}{three}{fraction}")
    asked = ("plan", design, "--data", "data", "--augment", 4, "--terms", 3)
    told = study(*asked, "--json").json
    added = told["augment"]
    assert added["efficiency"] == {"before": 0.0, "after": pytest.approx(1.0, abs=1e-12)}
    assert "[design]" in study(*asked).out
    # the table that it writes plans the eight cells, of which four are those of the fraction
    own = counted(told["design"], *names)
    design.write_text(f"{BASE}{three}{added['design']}\n[analysis]\nmodel = 3\n")
    whole = study("plan", design, "--data", "data", "--json").json["design"]
    assert whole["cells"] == 8
    assert own < counted(whole, *names)
    assert set(counted(whole, *names).values()) == {1}


#: Montgomery, Design and Analysis of Experiments, section 8.5: what the combined 16 runs of a
#: 2^(7-4) with D = AB, E = AC, F = BC, G = ABC and its full fold-over leave together
FOLDOVER_ALIASES = (
    ("BD", "CE", "FG"), ("AD", "CF", "EG"), ("AE", "BF", "DG"), ("AB", "CG", "EF"),
    ("AC", "BG", "DF"), ("BC", "AG", "DE"), ("CD", "BE", "AF"),
)  # fmt: skip


def test_further_cells_of_a_published_fraction_do_what_its_fold_over_does(design: Path) -> None:
    """Eight runs leave main effects in doubt; eight more clear them and one of each alias set."""
    choices = dict(line.split(" = ") for line in FIVE_CHOICES.strip().splitlines()[1:])
    choices |= {"test.interface": '["bonded", "frictionless"]',
                "specimen.height": '["30 mm", "40 mm"]'}  # fmt: skip
    names = dict(zip("ABCDEFG", choices, strict=True))
    levels = {name: json.loads(text) for name, text in choices.items()}
    signs = [(a, b, c, a * b, a * c, b * c, a * b * c)
             for a, b, c in itertools.product((-1, 1), repeat=3)]  # fmt: skip
    runs = [{n: levels[n][s > 0] for n, s in zip(choices, row, strict=True)} for row in signs]
    listed = ",\n".join(
        "{ " + ", ".join(f'"{n}" = {json.dumps(v)}' for n, v in run.items()) + " }" for run in runs
    )
    factors = "\n".join(f"{name} = {text}" for name, text in choices.items())
    design.write_text(
        f'{BASE}[factors]\n{factors}\n[design]\nkind = "listed"\ntreatments = [\n{listed}\n]\n'
    )
    both = np.array([*signs, *(tuple(-s for s in row) for row in signs)])
    column = {letter: both[:, k] for k, letter in enumerate("ABCDEFG")}
    for alike in FOLDOVER_ALIASES:
        products = [column[i] * column[j] for i, j in alike]
        assert all(abs(int(p @ products[0])) == 16 for p in products)
    words = [*choices, *(f"{names[i]}:{names[j]}" for (i, j), *_ in FOLDOVER_ALIASES)]
    asked = ("plan", design, "--data", "data", "--augment", 8, "--terms", ",".join(words))
    answer = study(*asked, "--json")
    assert answer.code == 0, answer.err
    added = answer.json["augment"]
    assert added["efficiency"] == {"before": 0.0, "after": pytest.approx(1.0, abs=1e-12)}
    # 16 cells with 15 effects and a mean that are orthogonal: the fold-over has no better
    cells = [*runs, *added["cells"]]
    codes = np.array([[2 * levels[n].index(cell[n]) - 1 for n in choices] for cell in cells])
    effects = [codes[:, k] for k in range(7)]
    effects += [codes[:, "ABCDEFG".index(i)] * codes[:, "ABCDEFG".index(j)]
                for (i, j), *_ in FOLDOVER_ALIASES]  # fmt: skip
    x = np.column_stack([np.ones(16), *effects])
    assert np.array_equal(x.T @ x, 16 * np.eye(15))
    assert len({tuple(row) for row in codes.tolist()}) == 16


def test_a_full_factorial_has_no_further_cell(design: Path) -> None:
    design.write_text(f"{BASE}{FIVE_CHOICES}")
    answer = study("plan", design, "--data", "data", "--augment", 4)
    assert answer.code == 2
    assert "runs every combination" in answer.err
