"""``study export --as force-law``: the law, its files, its error bound, its refusals."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import study as package
from study.api import load as open_study
from study.laboratory.haptics import haptic_export
from study.laboratory.haptics.haptic_export import ForceLaw, force_table
from tests.cli.small import CALIBRATION, DESIGN, PROBLEM, Finished, study

AREA_MM2 = np.pi * 10**2
HEIGHT_MM = 10.0
INDENTATION = """
schema = 1
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "8 mm"
[test]
kind = "indentation"
interface = "frictionless"
displacement = "1 mm"
steps = 4
indenter = { shape = "sphere", radius = "4 mm" }
[material]
model = "reduced-polynomial"
C10 = "5 kPa"
C20 = "1 kPa"
poisson_ratio = 0.4995
[model]
mesh = "coarse"
"""
FLAT = 'indenter = { shape = "flat", radius = "4 mm", edge_radius = "1 mm" }'


def closed_form(displacement_mm: np.ndarray, c10: float = 0.01) -> np.ndarray:
    """Force in N between frictionless plates: nominal stress 2 C10 (1/l^2 - l) on the area."""
    stretch = 1 - displacement_mm / HEIGHT_MM
    return np.asarray(2 * c10 * (stretch**-2 - stretch) * AREA_MM2)


def module(path: Path) -> ModuleType:
    """The Python file, imported as a user would."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.fixture(scope="module")
def compressed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Law of the compression whose closed form is known; folder and document."""
    folder = tmp_path_factory.mktemp("compressed")
    (folder / "plates.toml").write_text(PROBLEM)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        answer = study("export", "plates.toml", "--as", "force-law", "--json")
    assert answer.code == 0, answer.err
    return folder / "reports", answer.json


@pytest.fixture(scope="module")
def indented(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ForceLaw]:
    folder = tmp_path_factory.mktemp("indented")
    (folder / "sphere.toml").write_text(INDENTATION)
    found = package.export(folder / "sphere.toml", out=folder, tolerance=0.005)
    return folder, found.law


def test_the_law_is_the_closed_form_within_its_bound(
    compressed: tuple[Path, dict[str, Any]],
) -> None:
    folder, document = compressed
    law = module(folder / "plates_force_law.py")
    places = np.random.default_rng(1).uniform(0, 1, 500)
    off = np.abs(np.array(law.forces(places)) - closed_form(places)).max()
    bound = document["error_bound"]
    # the bound is the deviation in the middle of the intervals, where a cubic is farthest
    assert off <= 1.05 * bound["force_N"]
    assert bound["relative"] == pytest.approx(bound["force_N"] / closed_form(np.array(1.0)))
    assert bound["relative"] <= 0.002
    assert document["monotone"] is True
    assert document["limited_mm"] == []


def test_other_constants_are_exact_where_the_force_is_linear_in_them(
    compressed: tuple[Path, dict[str, Any]],
) -> None:
    folder, document = compressed
    law = module(folder / "plates_force_law.py")
    knots = np.array(document["displacement_mm"])
    doubled = [law.force(d, C10=0.02) for d in knots]
    assert doubled == pytest.approx(closed_form(knots, 0.02), rel=1e-8)
    assert document["constant_ranges"][0]["low"] == pytest.approx(0.009)
    assert document["constant_ranges"][0]["largest_N"] < 0.01


def test_outside_it_continues_as_stated(compressed: tuple[Path, dict[str, Any]]) -> None:
    folder, document = compressed
    law = module(folder / "plates_force_law.py")
    assert law.force(-0.1) == law.stiffness(-0.1) == 0.0
    assert not law.is_tested(-0.1)
    assert law.is_tested(0.0)
    assert law.is_tested(1.0)
    assert not law.is_tested(1.01)
    last = law.force(1.0)
    assert law.force(1.5) == pytest.approx(last + 0.5 * law.stiffness(1.0), rel=1e-12)
    # slope of the closed form at the end: 2 C10 A (2/l^3 + 1)/H
    slope = 2 * 0.01 * AREA_MM2 * (2 / 0.9**3 + 1) / HEIGHT_MM
    assert law.stiffness(1.0) == pytest.approx(slope, rel=1e-6)
    assert document["continuation"] == {"below": "zero", "above": "linear", "simulated": False}


def test_every_form_gives_the_same_force(indented: tuple[Path, ForceLaw]) -> None:
    folder, law = indented
    python = module(folder / "sphere_force_law.py")
    places = np.linspace(-0.1, 1.2, 101)
    other = {"C10": 0.0047, "C20": 0.0012}
    assert python.forces(places) == pytest.approx(law.force_at(places), rel=1e-12, abs=1e-15)
    assert python.forces(places.tolist(), **other) == pytest.approx(
        law.force_at(places, other), rel=1e-12, abs=1e-15
    )
    assert [python.stiffness(d) for d in places] == pytest.approx(
        law.stiffness_at(places), rel=1e-10, abs=1e-12
    )
    rows = (folder / "sphere_force_law.csv").read_text().splitlines()
    assert rows[0] == "displacement_mm,force_N,stiffness_N_per_mm,dF_dC10,dF_dC20"
    assert [float(row.split(",")[1]) for row in rows[1:]] == law.force.values.tolist()


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_the_header_compiles_and_gives_the_same_force(indented: tuple[Path, ForceLaw]) -> None:
    folder, law = indented
    program = folder / "main.c"
    program.write_text(
        '#include <stdio.h>\n#include <stdlib.h>\n#include "sphere_force_law.h"\n'
        "int main(int argc, char **argv) {\n"
        "    const double other[2] = { 0.0047, 0.0012 };\n    int i;\n"
        "    for (i = 1; i < argc; ++i) {\n        const double d = atof(argv[i]);\n"
        '        printf("%.17g %.17g %.17g %d\\n", sphere_force_law_force(d),\n'
        "               sphere_force_law_force_with(d, other), sphere_force_law_stiffness(d),\n"
        "               sphere_force_law_is_tested(d));\n    }\n    return 0;\n}\n"
    )
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    made = folder / "law"
    subprocess.run(["gcc", *strict, str(program), "-o", str(made)], check=True)
    places = [-0.1, 0.0, 0.013, 0.25, 0.6, 1.0, 1.3]
    run = subprocess.run([made, *map(str, places)], capture_output=True, text=True, check=True)
    rows = np.array([[float(v) for v in line.split()] for line in run.stdout.splitlines()])
    other = {"C10": 0.0047, "C20": 0.0012}
    assert rows[:, 0] == pytest.approx(law.force_at(places), rel=1e-12, abs=1e-15)
    assert rows[:, 1] == pytest.approx(law.force_at(places, other), rel=1e-12, abs=1e-15)
    assert rows[:, 2] == pytest.approx(law.stiffness_at(places), rel=1e-10, abs=1e-12)
    assert rows[:, 3].tolist() == law.is_tested(places).tolist()


def test_the_bound_holds_at_displacements_that_nobody_solved_before(
    indented: tuple[Path, ForceLaw], tmp_path: Path
) -> None:
    """Steps of a seventh of the depth meet neither a knot nor a point kept out."""
    _, law = indented
    (tmp_path / "sphere.toml").write_text(INDENTATION)
    solved = package.solve(tmp_path / "sphere.toml", overrides=["test.steps=7"]).curve
    off = np.abs(law.force_at(solved.displacement_mm) - solved.force_N).max()
    assert off <= law.held_out.bound_N
    assert law.relative_error <= 0.005
    places = np.linspace(0, 1, 2001)
    assert np.all(np.diff(law.force_at(places)) > 0)


@pytest.mark.slow
@pytest.mark.verify
def test_the_bound_holds_on_a_path_of_four_times_as_many_points(tmp_path: Path) -> None:
    """Contact closes point by point under the edge of a punch: no smooth function."""
    text = re.sub("indenter.*", FLAT, INDENTATION).replace('"1 mm"\nsteps', '"3 mm"\nsteps')
    (tmp_path / "punch.toml").write_text(text)
    law = package.export(tmp_path / "punch.toml", out=tmp_path).law
    assert law.held_out.force_N.size == 3 * (law.force.values.size - 1)
    steps = 16 * (law.force.values.size - 1)
    solved = package.solve(tmp_path / "punch.toml", overrides=[f"test.steps={steps}"]).curve
    off = np.abs(law.force_at(solved.displacement_mm) - solved.force_N).max()
    assert 0.2 * law.held_out.bound_N < off <= law.held_out.bound_N


def test_it_is_smooth(indented: tuple[Path, ForceLaw]) -> None:
    _, law = indented
    knots = law.displacement_mm[1:]
    tiny = 1e-9
    below, above = law.stiffness_at(knots - tiny), law.stiffness_at(knots + tiny)
    assert below == pytest.approx(above, rel=1e-6)


def test_a_slope_that_overshoots_is_limited_and_told() -> None:
    table = force_table(1.0, np.array([0.0, 1.0, 1.1]), np.array([1.0, 4.0, 0.1]))
    assert table.slopes.tolist() == pytest.approx([1.0, 0.3, 0.1])
    assert np.all(np.diff(table.at(np.linspace(0, 2, 1001))) >= 0)


def test_a_calibration_gives_its_law_and_uncertainty(home: Path) -> None:
    (home / "calibration.toml").write_text(CALIBRATION)
    assert study("calibrate", "calibration.toml", "--data", "data").code == 0
    answer = study("export", "results/calibration/calibration.json", "--as", "force-law", "--json")
    assert answer.code == 0, answer.err
    law = answer.json
    known = json.loads((home / "results/calibration/calibration.json").read_text())["parameters"]
    c10, c01 = (known[name]["value"] / 1e3 for name in ("C10", "C01"))
    d = np.array(law["displacement_mm"])
    stretch = 1 - d / 30
    # Mooney-Rivlin, incompressible: 2 (l^-2 - l)(C10 + C01/l), and what each constant adds
    shape = 2 * np.pi * 25**2 * (stretch**-2 - stretch)
    assert law["force_N"] == pytest.approx(shape * (c10 + c01 / stretch), rel=1e-6, abs=1e-9)
    gradient = np.stack([shape, shape / stretch])
    assert law["force_gradient"]["C01"]["value"] == pytest.approx(gradient[1], rel=1e-6, abs=1e-6)
    assert law["standard_uncertainty_N"][0] == 0.0
    errors = np.array([known[n]["standard_error"] / 1e3 for n in ("C10", "C01")])
    # no correlation can make it more than this
    assert np.all(np.array(law["standard_uncertainty_N"]) <= np.abs(gradient.T) @ errors + 1e-12)
    assert law["standard_uncertainty_N"][-1] > 0


def test_a_case_of_a_study_gives_its_law(finished: Finished, tmp_path: Path) -> None:
    opened = open_study(finished.folder / "results/small")
    case = next(r for r in opened.records if r.levels["material"] == "neo-hookean")
    out = tmp_path / "laws"
    found = package.export(finished.folder / "results/small", case=case.case_id, out=out)
    value = case.parameters["C10"]["value"] / 1e3
    d = found.law.displacement_mm
    stretch = 1 - d / 30
    force = 2 * value * np.pi * 25**2 * (stretch**-2 - stretch)
    assert found.law.force.values == pytest.approx(force, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["nowhere.toml"], "no results of a study there"),
        (["problem.toml", "--as", "lookup"], "force-law"),
        (["problem.toml", "--tolerance", "0"], "between 0 and 1"),
        (["calibration.toml"], "study calibrate"),
        (["small.toml"], "--case"),
        (["broken.json"], "is not valid JSON"),
        (["other.json"], "no document of a calibration"),
        (["failed.json"], "ended as not-converged"),
        (["problem.toml", "-s", 'material.C10="-1 kPa"'], "C10"),
        (["problem.toml", "-s", 'test.displacement="11 mm"'], "height"),
    ],
)
def test_bad_input_is_told_and_nothing_is_written(
    home: Path,
    arguments: list[str],
    told: str,
) -> None:
    (home / "calibration.toml").write_text(CALIBRATION)
    (home / "small.toml").write_text(DESIGN)
    (home / "broken.json").write_text("{")
    (home / "other.json").write_text("{}")
    failed = {"status": "not-converged", "name": "x", "parameters": {}, "correlation": []}
    (home / "failed.json").write_text(json.dumps({**failed, "tests": []}))
    before = sorted(path.name for path in home.iterdir())
    answer = study("export", *arguments)
    assert answer.code == 2
    assert told in answer.err
    assert sorted(path.name for path in home.iterdir()) == before


def test_a_simulation_that_stops_makes_no_law(home: Path) -> None:
    """C20 so negative that the specimen softens without end."""
    deep = ["-s", 'test.displacement="6 mm"', "-s", 'material.model="reduced-polynomial"']
    answer = study("export", "problem.toml", *deep, "-s", 'material.C20="-9 kPa"')
    assert answer.code == 2
    assert not (home / "reports").exists()


def test_a_tolerance_that_is_not_met_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(haptic_export, "MOST_INTERVALS", 40)
    (tmp_path / "plates.toml").write_text(PROBLEM)
    found = package.export(tmp_path / "plates.toml", tolerance=1e-15, out=tmp_path)
    assert "not 1e-13 %" in found.warnings[0]
    page = next(path for path in found.paths if path.suffix == ".html").read_text()
    assert "1e-13" in page


def test_the_page_needs_no_network_and_shows_both_figures(
    compressed: tuple[Path, dict[str, Any]],
) -> None:
    folder, document = compressed
    page = (folder / "plates-force-law.html").read_text()
    assert page.count("<svg") == 2
    assert "Figure missing" not in page
    assert not re.search(r"(?:src|href)=\"https?:", page)
    for line in document["sentences"]:
        assert line.split(":")[0] in page
