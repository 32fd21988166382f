"""study plan of designs: their cells counted another way, their meshes, their run sheet."""

import itertools
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.solver import solution_cost
from study.mechanics.solver.solution_cost import expected_unknowns
from study.simulation.tasks import _PATIENCE_S
from tests.cli.small import measured, pressed, refusal, responses, study, success
from tests.conftest import ROOT
from tests.fem.surfaces import box, write
from tests.runner.test_surfaces import DESIGN as SURFACE

BASE = pressed(
    '[material]\nmodel = "neo-hookean"\nC10 = "5 kPa"\npoisson_ratio = 0.45\n'
    + measured("tests.csv", "displacement_mm", "force_N")
    + responses(work_error=""),
    radius=25,
    height=30,
    interface="bonded",
    test='displacement = "5 mm"\n',
)
FIVE_CHOICES = """
[factors]
model.space = ["axisymmetric", "3d"]
model.element_order = ["linear", "quadratic"]
model.element_shape = ["simplex", "tensor"]
model.formulation = ["mixed", "displacement"]
model.mesh = ["coarse", "fine"]
"""


@pytest.fixture
def design(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path / "design.toml"


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
D_OPTIMAL = f'{BASE.replace(UNSAID, "")}{MIXED}[design]\nkind = "d-optimal"\nruns = 12\n'


def counted(told, *names):
    return Counter(tuple(cell["levels"][name] for name in names) for cell in told["matrix"])


def test_a_d_optimal_design_is_the_orthogonal_array_where_there_is_one(design):
    """2^3 x 3 in 12 cells: main effects are orthogonal where every pair of levels is balanced."""
    design.write_text(D_OPTIMAL)
    told = success("plan design.toml --data data --json").json["design"]
    assert told["cells"] == 12
    names = ["model.space", "model.element_order", "model.formulation", "material"]
    for first, second in itertools.combinations(names, 2):
        assert len(set(counted(told, first, second).values())) == 1
    assert "100.0 % of the precision" in told["scheme"]["summary"]


def test_further_cells_complete_a_half_fraction(design):
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


def test_further_cells_of_a_published_fraction_do_what_its_fold_over_does(design):
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
    answer = success(*asked, "--json")
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


def test_a_full_factorial_has_no_further_cell(design):
    design.write_text(f"{BASE}{FIVE_CHOICES}")
    answer = refusal("plan", design, "--data", "data", "--augment", 4)
    assert "runs every combination" in answer.err


def test_each_specimen_meets_each_physical_condition_once(tmp_path):
    out = tmp_path / "trials.csv"
    answer = success(f"plan {ROOT}/designs/demo.toml --run-sheet {out} --specimens 40 --json")
    assert "80 trials" in answer.err
    sheet = pd.read_csv(out)
    # energies and spaces are simulated: only the plates change in the laboratory
    assert [c for c in sheet if c in ("material", "plates", "model.space")] == ["plates"]
    assert Counter(zip(sheet["specimen"], sheet["plates"], strict=True)) == Counter(
        (k, p) for k in range(1, 41) for p in ("frictionless", "bonded")
    )
    first = sheet.groupby("specimen")["plates"].first().value_counts()
    # binomial(40, 1/2): 8 to 32 is four standard deviations
    assert 8 < first["bonded"] < 32
    assert sheet["run"].tolist() == list(range(1, 81))


NEEDLE = Path(__file__).parents[2] / "designs" / "needle-geometry.toml"


def surface_design(folder, more="", size=(24, 24, 34)):
    write(folder / "box.stl", box(*size))
    rows = [f"{s},{d:.3f},{0.45 * d:.5f}" for s in "ab" for d in np.linspace(0, 0.7, 15)]
    (folder / "tests.csv").write_text("\n".join(["specimen,d,f", *rows, ""]))
    path = folder / "design.toml"
    clamped = f'unit = "mm"\nclamp_below = "1 mm"\n{more}'
    path.write_text(SURFACE.replace('unit = "mm"', clamped, 1))
    return path


PRESSED_BESIDE = [
    f"specimen.press_{k}: {place} mm is beside the specimen, which reaches from -12 to 12 mm"
    for k, place in (("x", "1e+09"), ("y", "-12.5"))
] + ["choose press_x and press_y inside its outline"]


@pytest.mark.parametrize(
    ("more", "size", "command", "says"),
    [
        # Gmsh ended with the process: the body lay 1e9 mm beside the axis
        *(('press_x = "1e9 mm"\npress_y = "-12.5 mm"', (24, 24, 34), verb, PRESSED_BESIDE)
          for verb in ("plan", "run")),
        ("", (5000, 5000, 1.0), "plan -s 'model.mesh_size=1 mm'",
         ["model.mesh_size: 1 mm gives about", 'mm" or more']),
    ],
)  # fmt: skip
def test_a_surface_that_cannot_be_meshed_is_refused(inside, more, size, command, says):
    surface_design(inside, more, size)
    answer = refusal(f"{command} design.toml --data .")
    for piece in says:
        assert piece in answer.err


def test_a_plan_of_a_surface_makes_no_mesh(inside, monkeypatch):
    def never(_):
        raise AssertionError("a mesh was made")

    monkeypatch.setattr(solution_cost, "build_mesh", never)
    surface_design(inside, 'press_x = "11 mm"')
    assert "predicted: " in success("plan design.toml --data .").out


def test_a_plan_of_many_meshes_counts_but_a_few(monkeypatch):
    """120 needles with 0.05 mm took more than 10 s to be meshed: 40,000 unknowns each."""
    meshed = []
    monkeypatch.setattr(
        solution_cost, "build_mesh", lambda one: meshed.append(one) or build_mesh(one)
    )
    solution_cost._count.cache_clear()
    answer = success("plan", NEEDLE, "-s", "model.mesh_size=0.05 mm")
    assert "predicted: " in answer.out
    # 4 us for each unknown, in the costs of the cells and in those of their refinement
    assert 0 < sum(map(expected_unknowns, meshed)) < 4 * _PATIENCE_S / 4e-6
    assert max(map(expected_unknowns, meshed)) < 0.5 / 4e-6
