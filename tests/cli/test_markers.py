"""Markers inside a block by `study run`: virtual ones of a known plate, and the Truth Cube."""

import json
from pathlib import Path

import numpy as np
import pytest

from study.mechanics.element.function_space import interpolation
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Block, FaceMotion
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve
from tests.cli.small import CSV, refusal, responses, success

DESIGN = Path(__file__).parents[2] / "designs" / "truth-cube.toml"
NOISE_MM = 0.05
#: down, x, y (mm), tilts and twist (deg), spread (%) of the virtual plate, in the state that
#: is said to be 3 mm deep
TRUTH = {
    "down": 3.6, "x": 0.5, "y": -0.8, "tilt_x": 0.9, "tilt_y": -0.6, "twist": 1.1, "spread": 4.0,
}  # fmt: skip

VIRTUAL = (
    """
schema = 1
[study]
name = "virtual-markers"
[specimen]
shape = "block"
width = "40 mm"
depth = "40 mm"
height = "40 mm"
[test]
kind = "plate-motion"
interface = "bonded"
steps = 1
[material]
model = "neo-hookean"
C10 = "5 kPa"
poisson_ratio = 0.499
[model]
element_shape = "hexahedron"
mesh_size = "20 mm"
[markers]
file = "markers.csv"
rest = ["x0", "y0", "z0"]
layer = "k"
fit = [1, 5]
states.low = { columns = ["x1", "y1", "z1"], displacement = "3 mm" }
[factors]
"material.poisson_ratio" = [0.499, 0.3]
[converge]
levels = 2
ratio = 1.2
"""
    + responses(marker_error="0.05 mm", predicted_marker_error="0.05 mm")
    + CSV
)


def virtual_rows(rng):
    """Markers of a cube whose plate did not do what was said; another mesh, and noise."""
    motion = FaceMotion(
        TRUTH["x"], TRUTH["y"], TRUTH["tilt_x"], TRUTH["tilt_y"], TRUTH["twist"],
        TRUTH["spread"] / 100,
    )  # fmt: skip
    test = Test("plate-motion", TRUTH["down"], "bonded", "bonded", steps=1, motion=motion)
    gel = Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.499)
    model = Model(space="3d", element_shape="tensor", mesh_size_mm=14.0)
    problem = Problem(Block(40, 40, 40), test, gel, model)
    system = solve(problem, gradients=False).warm
    assert system is not None
    line = np.linspace(-16, 16, 5)
    x, y, z = (grid.ravel() for grid in np.meshgrid(line, line, line, indexing="ij"))
    rest = np.column_stack([x, y, z + 20])
    state = system.steps[-1].state
    moved = interpolation(system.system.mesh, model, rest)(system.system.displacements(state.x))
    found = rest + moved + NOISE_MM * rng.normal(size=rest.shape)
    layer = np.searchsorted(line, z) + 1
    rows = [
        ",".join([str(k), *(f"{v:.6f}" for v in (*a, *b))])
        for k, a, b in zip(layer, rest + 7.0, found + 7.0, strict=True)
    ]
    return ["k,x0,y0,z0,x1,y1,z1", *rows]


def documents(folder):
    """Records of a study, as they lie on the disk."""
    files = sorted(folder.rglob("record.json"))
    return [json.loads(path.read_text(encoding="utf-8"))["content"] for path in files]


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    folder = tmp_path_factory.mktemp("virtual")
    (folder / "design.toml").write_text(VIRTUAL, encoding="utf-8")
    rows = virtual_rows(np.random.default_rng(7))
    (folder / "markers.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    kept = ["--results", folder / "results", "--reports", folder / "reports"]
    # a coarser mesh is solved in the long verification alone, with the Truth Cube
    success("run", folder / "design.toml", "--data", folder, "--jobs", 1, *kept, "--json",
            "--no-refine")  # fmt: skip
    return folder


def test_a_plate_that_moves_as_said_predicts_too(virtual, tmp_path):
    """Both errors are known where nothing is fitted: the plate can be a factor."""
    kept = ["--results", tmp_path / "results", "--reports", tmp_path / "reports"]
    success("run", virtual / "design.toml", "--data", virtual, "--jobs", 1, *kept,
            "-s", 'markers.plate="nominal"', "-s", 'model.mesh_size="40 mm"', "--json",
            "--no-refine")  # fmt: skip
    for record in documents(tmp_path):
        every, *_, others = record["extra"]["markers"][0]["fits"]
        answers = record["responses"]
        assert answers["marker_error"]["value"] == every["error_mm"]
        assert answers["predicted_marker_error"]["value"] == others["error_mm"]
        # what is left of the sum of squares belongs to the layers
        squares = every["markers"] * every["error_mm"] ** 2 - 75 * others["error_mm"] ** 2
        assert others["markers"] == 75
        assert squares > 0


def test_the_plate_is_recovered_within_its_stated_error(virtual):
    true, other = (
        next(
            r
            for r in documents(virtual)
            if r["levels"]["material.poisson_ratio"] == nu and "of" not in r["extra"]
        )
        for nu in ("0.499", "0.3")
    )
    nominal, rigid, slipping, ends = true["extra"]["markers"][0]["fits"]
    for fit in (slipping, ends):
        for name, wanted in TRUTH.items():
            value, error = fit["motion"][name]
            # 4 standard errors, and what the coarser mesh makes of 3.6 mm
            assert abs(value - wanted) < 4 * error + 0.02 * abs(wanted), (name, value, error)
    floor = np.sqrt(3) * NOISE_MM
    assert slipping["error_mm"] == pytest.approx(floor, rel=0.15)
    assert ends["markers"] == 75
    assert ends["error_mm"] == pytest.approx(floor, rel=0.15)
    # a rigid plate cannot spread by 4 % of 20 mm, and the one that was said is 1 mm off
    assert nominal["error_mm"] > 2 * rigid["error_mm"]
    assert rigid["error_mm"] > 1.5 * slipping["error_mm"]
    assert nominal["motion"]["down"] == [3.0, 0.0]
    assert true["responses"]["marker_error"]["value"] == slipping["error_mm"]
    assert true["responses"]["predicted_marker_error"]["value"] == ends["error_mm"]
    assert other["responses"]["marker_error"]["value"] > 1.5 * slipping["error_mm"]


def test_the_report_has_the_motion_beside_the_error(virtual):
    table = (virtual / "reports").rglob("table-marker-errors.csv")
    lines = next(table).read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 2 * 4
    assert {"error_mm", "down_value", "spread_standard_error"} <= set(lines[0].split(","))


def test_a_wrong_unit_is_seen(virtual, tmp_path):
    found = refusal("run", virtual / "design.toml", "--data", virtual, "-s", "markers.unit=cm",
                    "--results", tmp_path, "--reports", tmp_path)  # fmt: skip
    assert "lie outside the block" in found.err
    assert not list(tmp_path.iterdir())  # nothing was begun


@pytest.fixture(scope="module")
def truth_cube(tmp_path_factory, data_dir):
    if not (data_dir / "truth_cube").is_dir():
        pytest.skip(f"no Truth Cube in {data_dir}")
    folder = tmp_path_factory.mktemp("cube")
    text = DESIGN.read_text(encoding="utf-8").split("[[expected]]")[0]
    for line in ('"model.element_order" = ["linear", "quadratic"]\n',
                 '"model.mesh_size" = ["36 mm", "24 mm"]\n'):  # fmt: skip
        assert line in text  # the levels that are left out are those of the shipped file
        text = text.replace(line, "")
    text = text.replace("[model]\n", '[model]\nmesh_size = "36 mm"\n')
    (folder / "cube.toml").write_text(text + "[converge]\nlevels = 2\n", encoding="utf-8")
    success("run", folder / "cube.toml", "--data", data_dir, "--jobs", 1, "--results",
            folder / "results", "--reports", folder / "reports")  # fmt: skip
    return documents(folder)


def errors(records, material, state):
    (marked,) = (
        r["extra"]["markers"][0]
        for r in records
        if r["levels"]["material"] == material and r["block"] == state and "of" not in r["extra"]
    )
    nominal, rigid, slipping, predicted = (fit["error_mm"] for fit in marked["fits"])
    return {"nominal": nominal, "rigid": rigid, "slipping": slipping, "predicted": predicted,
            "floor": marked["floor_mm"]}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("state", "known"),
    [
        ("5 %", (0.99, 0.38, 0.33, 0.35, 0.30)),
        ("12.5 %", (1.36, 0.51, 0.37, 0.39, 0.31)),
        ("18.25 %", (1.64, 0.63, 0.45, 0.46, 0.32)),
    ],
)
def test_the_truth_cube(truth_cube, state, known):
    nominal, *most, floor = known
    found = errors(truth_cube, "neo-hookean", state)
    assert found["nominal"] == pytest.approx(nominal, abs=0.01)  # as the plate was said to move
    assert found["floor"] == pytest.approx(floor, abs=0.005)
    for name, largest in zip(("rigid", "slipping", "predicted"), most, strict=True):
        assert found[name] <= largest
    assert found["slipping"] > found["floor"]  # no model comes below
    if state == "18.25 %":  # wrong materials are told
        linear, soft = (
            errors(truth_cube, name, state)["slipping"]
            for name in ("linear-elastic", "compressible")
        )
        assert linear - found["slipping"] > 0.2
        assert soft - found["slipping"] > 0.1
