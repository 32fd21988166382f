"""The verbs about one thing: new, solve, calibrate, converge, virtual, doctor, analyze a CSV."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from study import api
from study.ground.curve import Curve
from tests.cli.small import Edit, study

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


def test_solve(home: Path) -> None:
    drawn = ("--vtu", "out.vtu", "--picture", "mesh.svg")
    answer = study("solve", "problem.toml", "--json", *drawn)
    assert answer.code == 0, answer.err
    found = answer.json
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


def test_solve_in_words(home: Path) -> None:
    answer = study("solve", "problem.toml", "-s", 'material.C10="20 kPa"')
    assert answer.code == 0, answer.err
    assert "force [N]" in answer.out
    assert "converged" in answer.out
    # 2 x 0.02 (1/0.9^2 - 0.9) pi 100
    assert "4.2040" in answer.out or "4.204" in answer.out


def test_a_compression_beyond_the_smooth_surface_is_told_of(home: Path) -> None:
    """V45: the surface of a neo-Hookean body is unstable below stretch 0.443746 (Biot 1963)."""
    for depth, warned in (("5.5 mm", False), ("5.6 mm", True)):  # of a height of 10 mm
        answer = study("solve", "problem.toml", "-s", f'test.displacement="{depth}"')
        assert answer.code == 0, answer.err
        assert ("Biot" in answer.err) is warned


def test_solve_that_does_not_converge_exits_1(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # a solver that gives up takes minutes to do so: the real answer of an easy problem, renamed
    found = replace(api.solve("problem.toml"), status="not-converged", message="gave up at 1 mm")
    monkeypatch.setattr(api, "solve", lambda *_, **__: found, raising=False)
    answer = study("solve", "problem.toml", "--json")
    assert answer.code == 1
    assert answer.json["status"] == "not-converged"
    words = study("solve", "problem.toml")
    assert words.code == 1
    assert "not-converged: gave up at 1 mm" in words.out


def test_calibrate_finds_the_constants(home: Path) -> None:
    answer = study("calibrate", "calibration.toml", "--data", "data", "--json")
    assert answer.code == 0, answer.err
    found = answer.json
    assert set(found) >= CALIBRATE_KEYS
    assert found["status"] == "converged"
    assert found["stable"] is True
    # the two repeats average to the curve of these constants; ten decimals are stored and the
    # straight lines between samples change the force by some 1e-5
    assert found["parameters"]["C10"]["value"] == pytest.approx(8.0, rel=2e-3)
    assert found["parameters"]["C01"]["value"] == pytest.approx(0.5, rel=3e-2)
    for entry in found["parameters"].values():
        assert set(entry) >= {"value", "unit", "standard_error", "ci95"}
        assert entry["unit"] == "kPa"
    (curve,) = found["curves"]
    assert curve["file"] == "one.csv"
    assert curve["role"] == "fit"
    assert curve["rms_force_error"] < 1e-2


def test_converge_of_numbers_is_the_published_example() -> None:
    # NASA's tutorial "Examining Spatial (Grid) Convergence": p = 1.786, 0.97130, GCI 0.103 %
    series = ("converge", "--values", "0.97050,0.96854,0.96178", "--sizes", "1,2,4")
    answer = study(*series, "--formal-order", "2", "--json")
    assert answer.code == 0
    found = answer.json
    assert set(found) >= CONVERGE_KEYS
    assert found["observed_order"] == pytest.approx(1.786170, abs=1e-6)
    assert found["extrapolated"] == pytest.approx(0.971300, abs=1e-6)
    assert found["gci_fine"] == pytest.approx(0.00103083, abs=1e-8)
    words = study("converge", "--values", "0.97050,0.96854,0.96178", "--sizes", "1,2,4").out
    assert "order 1.786" in words


def test_virtual_measurements_reach_the_deepest_range(home: Path, edit: Edit) -> None:
    shutil.rmtree("data")
    answer = study("virtual", "data", "--from", "small.toml")
    assert answer.code == 0, answer.err
    assert answer.out.split() == ["data/tests.csv", "data/tests.csv.virtual.json"]
    with Path("data/tests.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert set(rows[0]) == {"mix", "specimen", "repeat", "d_mm", "f_N"}
    # one factor asks for 3 mm, the other for 6 mm: both read this file
    assert max(float(row["d_mm"]) for row in rows) > 6
    plan = study("plan", "small.toml", "--data", "data", "--json")
    assert plan.code == 0, plan.err
    assert len(plan.json["blocks"]) == 6


def test_doctor() -> None:
    answer = study("doctor", "--json")
    found = answer.json
    assert answer.code == 0, found
    assert found["ok"] is True
    names = {check["name"] for check in found["checks"]}
    assert {"python", "gmsh", "a solved compression", "a worker process"} <= names
    assert {check["outcome"] for check in found["checks"]} <= {"pass", "caution"}


@pytest.fixture
def tidy(home: Path) -> Path:
    """Two factors in four blocks: material adds 2, plates nothing, each block its own height."""
    noise = np.random.default_rng(3).normal(0, 0.05, (4, 2, 3))
    rows = ["specimen,material,plates,force"]
    for i, height in enumerate((0.0, 1.0, -1.0, 0.5)):
        for j, m in enumerate("AB"):
            rows += [
                f"{i + 1},{m},{p},{10 + height + 2 * j + noise[i, j, k]:.6f}"
                for k, p in enumerate("xyz")
            ]
    path = home / "tidy.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_analyze_a_table(tidy: Path) -> None:
    arguments = ("analyze", tidy, "--response", "force", "--factors", "material,plates",
                 "--block", "specimen")  # fmt: skip
    answer = study(*arguments, "--practical", "0.5", "--json")
    assert answer.code == 0, answer.err
    found = answer.json
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
    words = study(*arguments)
    assert words.code == 0, words.err
    assert "material × plates" in words.out
    assert "Ryan-Joiner" in words.out
    assert "--practical" in words.err


def test_fake_replicates_are_refused(home: Path) -> None:
    rows = ["run,material,force"]
    rows += [f"{k},{m},{v}" for m, v in (("A", 10.0), ("B", 12.0)) for k in range(3)]
    (home / "fake.csv").write_text("\n".join(rows) + "\n")
    answer = study("analyze", "fake.csv", "--response", "force", "--factors", "material")
    assert answer.code == 3
    assert answer.out == ""
    assert "fake replicates" in answer.err
    assert "Instead:" in answer.err


def test_solve_refuses_a_file_that_cannot_be_written_before_it_solves(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api, "solve", lambda *_, **__: pytest.fail("solved"), raising=False)
    answer = study("solve", "problem.toml", "--vtu", "nowhere/out.vtu", "--picture", ".")
    assert answer.code == 2
    assert "there is no folder nowhere" in answer.err
    assert "is a folder" in answer.err


def test_solve_without_a_converged_step_writes_no_fields(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = replace(
        api.solve("problem.toml"), status="not-converged", curve=Curve(*np.zeros((3, 0))), warm=None
    )
    monkeypatch.setattr(api, "solve", lambda *_, **__: found, raising=False)
    answer = study("solve", "problem.toml", "--vtu", "out.vtu", "--json")
    assert answer.code == 1
    assert answer.json["displacement_mm"] == []
    assert not Path("out.vtu").exists()
