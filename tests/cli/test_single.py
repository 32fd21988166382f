"""The verbs about one thing: new, solve, calibrate, converge, virtual, doctor, analyze a CSV."""

import csv
import os
import shutil
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from study import api
from study.ground.curve import Curve
from study.ground.errors import InputError, WriteError
from study.ground.files import write_atomic
from tests.cli.small import CSV, incompressible_force, pressed, refusal, responses, study, success

SOLVE_KEYS = {
    "status", "displacement_mm", "force_N", "stiffness_N_per_mm", "parameters", "force_gradient",
    "dofs", "elements", "newton_iterations", "seconds", "solver", "reached_mm", "min_j",
    "base_reaction_N",
}  # fmt: skip
CALIBRATE_KEYS = {
    "status", "model", "parameters", "rss", "r_squared", "aicc", "correlation", "condition",
    "identifiable", "stable", "evaluations", "curves",
}  # fmt: skip
CONVERGE_KEYS = {
    "qoi", "unit", "mesh_size", "value", "behaviour", "observed_order", "formal_order",
    "extrapolated", "gci_fine", "factor_of_safety", "u_num", "asymptotic_ratio", "verdict",
}  # fmt: skip
ANALYZE_KEYS = {"error_term", "anova", "normality", "variance", "effects", "warnings"}
ROW_KEYS = {
    "term", "df", "ss", "ms", "f", "p", "error", "df_error", "epsilon_gg", "p_gg", "omega_sq",
    "partial_eta_sq", "share",
}  # fmt: skip


@pytest.mark.drawings
def test_solve(home):
    drawn = ("--vtu", "out.vtu", "--picture", "mesh.svg")
    found = success("solve", "problem.toml", "--json", *drawn).json
    assert set(found) >= SOLVE_KEYS
    assert found["status"] == "converged"
    assert found["displacement_mm"] == [0.5, 1.0]
    assert found["parameters"] == {"C10": 0.01}
    stretch = 1 - np.array([0.05, 0.1])
    # closed form: nominal stress 2 C10 (1/l^2 - l) on the area of the cylinder; a homogeneous
    # field is in the space of the elements, so only rounding is left
    force = 2 * 0.01 * (stretch**-2 - stretch) * np.pi * 100
    assert found["force_N"] == pytest.approx(force, rel=1e-9)
    # the force is linear in its only constant
    assert found["force_gradient"]["C10"] == pytest.approx(force / 0.01, rel=1e-9)
    read = meshio.read("out.vtu")
    assert read.point_data["displacement_mm"].min() == pytest.approx(-0.5)  # the upper half
    assert set(read.cell_data) >= {"J", "cauchy_stress_MPa", "mean_stress_MPa"}
    drawing = Path("mesh.svg").read_text(encoding="utf-8")
    assert drawing.startswith("<svg")
    assert "<image" not in drawing


def test_solve_that_does_not_converge_exits_1_and_without_a_step_writes_no_fields(
    home, monkeypatch
):
    # a solver that gives up takes minutes to do so: the real answer of an easy problem, renamed
    solved = replace(api.solve("problem.toml"), status="not-converged", message="gave up at 1 mm")
    for found in (replace(solved, curve=Curve(*np.zeros((3, 0))), warm=None), solved):
        monkeypatch.setattr(api, "solve", lambda *_, found=found, **__: found, raising=False)
        answer = study("solve problem.toml --vtu out.vtu --json")
        assert (answer.code, answer.json["status"]) == (1, "not-converged")
        assert Path("out.vtu").exists() is (answer.json["displacement_mm"] != [])
    words = study("solve problem.toml")
    assert words.code == 1
    assert "not-converged: gave up at 1 mm" in words.out


@pytest.mark.parametrize(
    ("command", "said", "unsaid"),
    [
        ("solve problem.toml", "converged", "warning"),
        ("solve problem.toml -s 'material.C10=20 kPa'", "4.204", "warning"),  # 0.04 (l^-2 - l) A
        # V45: the surface of a neo-Hookean body is unstable below stretch 0.443746 (Biot 1963)
        ("solve problem.toml -s 'test.displacement=5.5 mm'", "converged", "Biot"),
        ("solve problem.toml -s 'test.displacement=5.6 mm'", "Biot", "not-converged"),
        ("solve problem.toml -s 'model.mesh_size=50 mm'",
         "50 mm is larger than the specimen (10 mm", "not-converged"),
        ("solve problem.toml -s 'specimen.radius=10 m'", "20000 mm is no usual size", "GPa"),
        ("solve problem.toml -s 'material.C10=10 GPa'", "window of tissue and silicone", "usual"),
        ("plan small.toml -s 'model.mesh_size=40 mm'",
         "40 mm is larger than the specimen (25 mm", "soft material"),
        ("converge --values 1.0,1.1,1.5 --sizes 1,2,4 --tolerance 0.005",
         "do not carry an order", "order 2"),
        ("converge --values 1.0,1.1,1.25 --sizes 1,1.1,1.2", "below 1.3", "order -"),
        # f = 1.4 - 0.4 h: the finest of h = 1, 2, 4 is 0.4 from 1.4, 28.6 %
        ("converge --values 1.0,0.6,-0.2 --sizes 1,2,4", "28.6 % from its extrapolated", "below"),
        ("converge --values 0.97050,0.96854,0.96178 --sizes 1,2,4", "order 1.786", "warning"),
        # the same with the finest value beside the largest size, and with numbers of elements
        ("converge --values 0.97050,0.96854,0.96178 --sizes 4,2,1", "with order 1.79", "GCI 0."),
        ("converge --values 3.64,3.16,3.04 --sizes 10,20,40", "numbers of elements", "GCI 0."),
        ("converge --values 3,2,1 --sizes 1,2,4", "do not shrink", "numbers of elements"),
        ("converge --values 5,5,5 --sizes 1,2,4", "state with --tolerance", "numbers of elements"),
        ("converge --values 5,5,5 --sizes 1,2,4 --tolerance .05", " 0.0500", "warning"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("home")
def test_what_is_hardly_meant_is_warned_of(command, said, unsaid):
    answer = success(command)
    words = answer.out + answer.err
    assert said in words
    assert unsaid not in words


def test_converge_of_numbers_is_the_published_example():
    # NASA's tutorial "Examining Spatial (Grid) Convergence": p = 1.786, 0.97130, GCI 0.103 %
    series = ("converge", "--values", "0.97050,0.96854,0.96178", "--sizes", "1,2,4")
    found = success(*series, "--formal-order", "2", "--json").json
    assert set(found) >= CONVERGE_KEYS
    assert found["observed_order"] == pytest.approx(1.786170, abs=1e-6)
    assert found["extrapolated"] == pytest.approx(0.971300, abs=1e-6)
    assert found["gci_fine"] == pytest.approx(0.00103083, abs=1e-8)


def test_virtual_measurements_reach_the_deepest_range(home, edit):
    shutil.rmtree("data")
    answer = success("virtual", "data", "--from", "small.toml")
    assert answer.out.split() == ["data/tests.csv", "data/tests.csv.virtual.json"]
    assert answer.err.startswith("simulating the test of tests.csv: 1 of 1\n")
    with Path("data/tests.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert set(rows[0]) == {"mix", "specimen", "repeat", "d_mm", "f_N"}
    # one factor asks for 3 mm, the other for 6 mm: both read this file
    assert max(float(row["d_mm"]) for row in rows) > 6
    plan = success("plan", "small.toml", "--data", "data", "--json")
    assert len(plan.json["blocks"]) == 6


def test_doctor():
    answer = study("doctor", "--json")
    found = answer.json
    assert answer.code == 0, found
    assert found["ok"] is True
    names = {check["name"] for check in found["checks"]}
    assert {"python", "gmsh", "a solved compression", "a worker process"} <= names
    assert {check["outcome"] for check in found["checks"]} <= {"pass", "caution"}


@pytest.mark.usefixtures("inside")
def test_analyze_a_table():
    """Two factors in four blocks: material adds 2, plates nothing, each block its own height."""
    noise = np.random.default_rng(3).normal(0, 0.05, (4, 2, 3))
    table = ["specimen,material,plates,force"] + [
        f"{i},{m},{p},{10 + height + 2 * j + noise[i, j, k]:.6f}"
        for i, height in enumerate((0.0, 1.0, -1.0, 0.5))
        for j, m in enumerate("AB")
        for k, p in enumerate("xyz")
    ]
    Path("tidy.csv").write_text("\n".join(table) + "\n")
    asked = "analyze tidy.csv --response force --factors material,plates --block specimen"
    found = success(f"{asked} --practical 0.5 --json").json
    assert set(found) >= ANALYZE_KEYS
    assert set(found["error_term"]) >= {"source", "question", "df"}
    rows = {row["term"]: row for row in found["anova"]["rows"]}
    assert all(set(row) >= ROW_KEYS for row in rows.values())
    # every effect has its own error, its interaction with the specimens
    strata = {f"specimen:{term}" for term in ("material", "plates", "material:plates")}
    assert {"material", "plates", "material:plates"} | strata <= set(rows)
    assert rows["material"]["p"] < 1e-5  # own interactions have fewer degrees of freedom
    assert rows["plates"]["p"] > 0.01
    verdicts = {effect["term"]: effect["verdict"] for effect in found["effects"]}
    assert verdicts["plates"] == "no practical difference"
    words = success(asked)
    assert "material × plates" in words.out
    assert "Ryan-Joiner" in words.out
    assert "--practical" in words.err


def test_solve_refuses_a_file_that_cannot_be_written_before_it_solves(home, monkeypatch):
    monkeypatch.setattr(api, "solve", lambda *_, **__: pytest.fail("solved"), raising=False)
    answer = refusal("solve", "problem.toml", "--vtu", "nowhere/out.vtu", "--picture", ".")
    assert "there is no folder nowhere" in answer.err
    assert "is a folder" in answer.err
    # as root a file took the place of the device
    os.mkfifo(home / "pipe")
    (home / "link").symlink_to("pipe")
    for name in ("pipe", "link"):
        assert "is a device or a pipe" in refusal("solve", "problem.toml", "--vtu", name).err
        with pytest.raises(WriteError, match="is a device or a pipe, which stays as it is"):
            write_atomic(home / name, b"")
    assert (home / "pipe").is_fifo()
    assert (home / "link").is_symlink()


def test_a_name_that_is_too_long_is_told(home):
    long = "x" * 300
    for words in (
        ("solve", "problem.toml", "--vtu", long),
        ("analyze", long, "--response", "y", "--factors", "a"),
        ("converge", long),
        ("demo", "--results", long),
    ):
        assert "too long" in refusal(*words).err
    assert not any(path.name.startswith("x") for path in home.iterdir())


def test_a_name_that_is_too_long_is_bad_input_of_every_function_in_python():
    long = "x" * 300
    of_one_file = (
        "load load_design run report solve calibrate inspect converge power require tracking export"
    )
    asked = dict.fromkeys(of_one_file.split(), ()) | {
        "analyze": ("y", ["a"]), "predict": ({"a": 1},), "invert": (long,), "shape": (long,),
    }  # fmt: skip
    for name, more in asked.items():
        with pytest.raises(InputError):  # not OSError
            getattr(api, name)(long, *more)
    with pytest.raises(InputError, match="a name of 300 characters is too long"):
        api.converge(long)
    assert api.run is api.run


BONDED = (
    "-s", 'test.interface="bonded"', "-s", "test.steps=2", "-s", 'model.mesh_size="4 mm"',
)  # fmt: skip


def test_a_bonded_problem_is_refined_and_kept(home):
    found = success("converge", "problem.toml", *BONDED, "--json").json
    assert set(found) >= CONVERGE_KEYS
    # 2 lambda of the bonded corner, nu close to 0.5 (Williams 1952)
    assert found["formal_order"] == pytest.approx(1.19, abs=0.02)
    assert set(found["quantities"]) == {"peak_force", "curve_rms", "work"}
    assert {row["source"] for row in found["sources"]} == {"mesh", "load steps", "solver tolerance"}
    assert [m["unknowns"] for m in found["meshes"]] == sorted(
        (m["unknowns"] for m in found["meshes"]), reverse=True
    )
    page = Path(found["report"]).read_text(encoding="utf-8")
    assert "Figure missing" not in page
    stored = sorted(Path("results/problem/solves").iterdir())
    again = success("converge", "problem.toml", *BONDED)
    assert sorted(Path("results/problem/solves").iterdir()) == stored
    for words in ("formal order 1.19", "error by source", "stopped: 3 meshes", "report: "):
        assert words in again.out


HEAVY = pressed(
    """gravity = { density = "0.98 g/cm^3", direction = "down" }
[material]
model = "neo-hookean"
C10 = "2.5 kPa"
poisson_ratio = 0.499
[model]
mesh_size = "6 mm"
""",
    height=40,
    interface="bonded",
    test='displacement = "4 mm"\nsteps = 4\n',
)
FACTOR = (
    '[study]\nname = "gravity"\n[factors]\n"test.gravity.direction" = ["none", "down", "up"]\n'
    "[converge]\nlevels = 2\n" + responses(peak_force="0.01 N") + CSV
)
WEIGHT = 980e-9 * 9.80665 * np.pi * 10**2 * 40


def test_gravity_is_a_factor(tmp_path):
    (tmp_path / "d.toml").write_text(HEAVY + FACTOR, encoding="utf-8")
    success("run", tmp_path / "d.toml", "--jobs", 1, "--results", tmp_path / "results",
            "--reports", tmp_path / "reports")  # fmt: skip
    rows = next((tmp_path / "reports").rglob("cases.csv")).read_text().splitlines()
    names = rows[0].split(",")
    peak = {
        row.split(",")[names.index("test.gravity.direction")]:
            float(row.split(",")[names.index("peak_force")])
        for row in rows[1:]
    }  # fmt: skip
    # between like plates the plate above carries about half of the weight, one way or the other
    assert peak["up"] - peak["down"] == pytest.approx(WEIGHT, rel=0.1)
    assert (peak["up"] + peak["down"]) / 2 == pytest.approx(peak["none"], rel=0.01)


def scaled(home, force=1.0, add=0.0):
    """Write the forces of the measurements multiplied and shifted."""
    path = home / "data" / "tests.csv"
    head, *rows = path.read_text().splitlines()
    cells = [row.rsplit(",", 1) for row in rows]
    path.write_text("\n".join([head, *(f"{a},{force * float(b) + add}" for a, b in cells)]))


def test_forces_in_another_unit_and_a_load_cell_offset(home):
    asked = "plan small.toml --data data"
    assert success(asked).err == ""
    scaled(home, add=2.0)
    said = success(asked).err
    assert "a load-cell offset?" in said
    assert "12 of 12 tests" in said
    assert "offset" not in success(f"{asked} -s 'measurements.zero=\"first\"'").err
    scaled(home, force=1e4, add=-2e4)
    said = success(asked).err
    assert "that of no soft material" in said
    assert "a force 1000 times smaller would be one" in said


def test_calibration_uses_the_loading_branch_and_says_so(home):
    d = np.linspace(0.0, 6.5, 66)
    force = incompressible_force(8.0, 0.5, d)
    rows = [*zip(d, force, strict=True), *zip(d[-2::-1], 0.7 * force[-2::-1], strict=True)]
    text = ["repeat,d_mm,f_N", *(f"1,{x:.4f},{f:.10f}" for x, f in rows)]
    (home / "data" / "one.csv").write_text("\n".join(text))
    answer = success("calibrate", "calibration.toml", "--data", "data", "--json")
    assert set(answer.json) >= CALIBRATE_KEYS
    assert answer.json["stable"] is True
    constants = answer.json["parameters"]
    # the constants of the way in; the mean of both ways would give 0.85 of them
    assert constants["C10"]["value"] == pytest.approx(8.0, rel=2e-3)
    assert constants["C01"]["value"] == pytest.approx(0.5, rel=3e-2)
    for entry in constants.values():
        assert set(entry) >= {"value", "unit", "standard_error", "ci95"}
        assert entry["unit"] == "kPa"
    (curve,) = answer.json["curves"]
    assert (curve["file"], curve["role"]) == ("one.csv", "fit")
    assert curve["rms_force_error"] < 1e-2
    assert any("65 rows after the first loading left out" in w for w in answer.json["warnings"])


TABLE = """material,Space,specimen,Force
soft,2d,1,1.00
soft,3d,1,1.10
stiff,2d,1,2.00
stiff,3d,1,2.20
soft,2d,2,1.05
soft,3d,2,1.15
{stiff},2d,2,2.10
stiff,3d,2,2.30
"""
ASKED = ("--response", "Force", "--factors", "material,Space", "--block", "specimen")


@pytest.mark.parametrize("label", ["Stiff", "st iff", "stiff"])
def test_levels_that_differ_in_capitals_or_spaces_alone_are_named(home, label):
    (home / "t.csv").write_text(TABLE.format(stiff=label))
    answer = success("analyze", "t.csv", *ASKED, "--error", "pooled", "--model", "1", "--json")
    named = [one for one in answer.json["warnings"] if "differ in capitals or spaces" in one]
    assert len(named) == (label != "stiff")  # once, not by two rules
    assert all(f"'stiff' and '{label}'" in one for one in named)


def test_a_format_is_checked_before_anything_is_computed(home, monkeypatch):
    from study import api

    def compute(*_, **__):
        raise AssertionError("something was computed")

    (home / "t.csv").write_text(TABLE.format(stiff="stiff"))
    for verb in ("analyze", "load"):
        monkeypatch.setattr(api, verb, compute, raising=False)
    words = ("--report", "out", "--format", "htm")
    for command in (("analyze", "t.csv", *ASKED, *words), ("report", "small", "--format", "htm")):
        answer = refusal(*command)
        assert "did you mean 'html'?" in answer.err
    assert not (home / "out").exists()
