"""study export: force laws and functions of surfaces, their files, bounds and refusals."""

import json
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import study as package
from study.api import load as open_study
from study.laboratory.haptics import haptic_export
from tests.cli.small import PROBLEM, refusal, success
from tests.cli.test_numeric_factors import DESIGN, _force

pytestmark = pytest.mark.usefixtures("undrawn")

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


def closed_form(displacement_mm, c10=0.01):
    """Force in N between frictionless plates: nominal stress 2 C10 (1/l^2 - l) on the area."""
    stretch = 1 - displacement_mm / HEIGHT_MM
    return np.asarray(2 * c10 * (stretch**-2 - stretch) * AREA_MM2)


def module(path):
    """The Python file, run as a user would import it."""
    return SimpleNamespace(**runpy.run_path(str(path)))


@pytest.fixture(scope="module")
def compressed(tmp_path_factory):
    """Law of the compression whose closed form is known; folder and document."""
    folder = tmp_path_factory.mktemp("compressed")
    (folder / "plates.toml").write_text(PROBLEM)
    answer = success("export", "plates.toml", "--as", "force-law", "--json", folder=folder)
    return folder / "reports", answer.json


@pytest.fixture(scope="module")
def indented(tmp_path_factory):
    folder = tmp_path_factory.mktemp("indented")
    (folder / "sphere.toml").write_text(INDENTATION)
    found = package.export(folder / "sphere.toml", out=folder, tolerance=0.005)
    return folder, found.law


def test_the_law_is_the_closed_form_within_its_bound_and_continues_as_stated(compressed):
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
    # other constants are exact where the force is linear in them
    knots = np.array(document["displacement_mm"])
    doubled = [law.force(d, C10=0.02) for d in knots]
    assert doubled == pytest.approx(closed_form(knots, 0.02), rel=1e-8)
    assert document["constant_ranges"][0]["low"] == pytest.approx(0.009)
    assert document["constant_ranges"][0]["largest_N"] < 0.01
    # outside of what was simulated
    assert law.force(-0.1) == law.stiffness(-0.1) == 0.0
    assert [law.is_tested(d) for d in (-0.1, 0.0, 1.0, 1.01)] == [False, True, True, False]
    last = law.force(1.0)
    assert law.force(1.5) == pytest.approx(last + 0.5 * law.stiffness(1.0), rel=1e-12)
    # slope of the closed form at the end: 2 C10 A (2/l^3 + 1)/H
    slope = 2 * 0.01 * AREA_MM2 * (2 / 0.9**3 + 1) / HEIGHT_MM
    assert law.stiffness(1.0) == pytest.approx(slope, rel=1e-6)
    assert document["continuation"] == {"below": "zero", "above": "linear", "simulated": False}


def test_every_form_gives_the_same_force(indented):
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
def test_the_header_compiles_and_gives_the_same_force(indented):
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


def test_the_bound_holds_at_displacements_that_nobody_solved_before(indented, tmp_path):
    """Steps of a seventh of the depth meet neither a knot nor a point kept out."""
    _, law = indented
    (tmp_path / "sphere.toml").write_text(INDENTATION)
    solved = package.solve(tmp_path / "sphere.toml", overrides=["test.steps=7"]).curve
    off = np.abs(law.force_at(solved.displacement_mm) - solved.force_N).max()
    assert off <= law.held_out.bound_N
    assert law.relative_error <= 0.005
    places = np.linspace(0, 1, 2001)
    assert np.all(np.diff(law.force_at(places)) > 0)
    knots, tiny = law.displacement_mm[1:], 1e-9  # it is smooth
    below, above = law.stiffness_at(knots - tiny), law.stiffness_at(knots + tiny)
    assert below == pytest.approx(above, rel=1e-6)


@pytest.mark.slow
def test_the_bound_holds_on_a_path_of_four_times_as_many_points(tmp_path):
    """Contact closes point by point under the edge of a punch: no smooth function."""
    text = re.sub("indenter.*", FLAT, INDENTATION).replace('"1 mm"\nsteps', '"3 mm"\nsteps')
    (tmp_path / "punch.toml").write_text(text)
    law = package.export(tmp_path / "punch.toml", out=tmp_path).law
    assert law.held_out.force_N.size == 3 * (law.force.values.size - 1)
    steps = 16 * (law.force.values.size - 1)
    solved = package.solve(tmp_path / "punch.toml", overrides=[f"test.steps={steps}"]).curve
    off = np.abs(law.force_at(solved.displacement_mm) - solved.force_N).max()
    assert 0.2 * law.held_out.bound_N < off <= law.held_out.bound_N


def test_a_calibration_gives_its_law_and_uncertainty(home):
    success("calibrate calibration.toml --data data")
    law = success("export results/calibration/calibration.json --as force-law --json").json
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


def test_a_case_of_a_study_gives_its_law(finished, tmp_path):
    opened = open_study(finished.folder / "results/small")
    case = next(r for r in opened.records if r.levels["material"] == "neo-hookean")
    out = tmp_path / "laws"
    found = package.export(finished.folder / "results/small", case=case.case_id, out=out)
    value = case.parameters["C10"]["value"] / 1e3
    d = found.law.displacement_mm
    stretch = 1 - d / 30
    force = 2 * value * np.pi * 25**2 * (stretch**-2 - stretch)
    assert found.law.force.values == pytest.approx(force, rel=1e-6, abs=1e-9)


def test_a_simulation_that_stops_makes_no_law(home):
    """C20 so negative that the specimen softens without end."""
    deep = ["-s", 'test.displacement="6 mm"', "-s", 'material.model="reduced-polynomial"']
    refusal("export", "problem.toml", *deep, "-s", 'material.C20="-9 kPa"')
    assert not (home / "reports").exists()


def test_a_tolerance_that_is_not_met_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(haptic_export, "MOST_INTERVALS", 40)
    (tmp_path / "plates.toml").write_text(PROBLEM)
    found = package.export(tmp_path / "plates.toml", tolerance=1e-15, out=tmp_path)
    assert "not 1e-13 %" in found.warnings[0]
    page = next(path for path in found.paths if path.suffix == ".html").read_text()
    assert "1e-13" in page


def test_the_page_needs_no_network_and_shows_both_figures(compressed):
    folder, document = compressed
    page = (folder / "plates-force-law.html").read_text()
    assert page.count("<svg") == 2
    assert "Figure missing" not in page
    assert not re.search(r"(?:src|href)=\"https?:", page)
    for line in document["sentences"]:
        assert line.split(":")[0] in page


LOG = DESIGN.replace('high = "10 kPa" }', 'high = "10 kPa", scale = "log" }')
QUADRATIC = DESIGN.replace('kind = "latin-hypercube"\nruns = 30', 'kind = "central-composite"')


@pytest.mark.parametrize(("text", "kind"), [(LOG, "emulator"), (QUADRATIC, "quadratic")])
def test_the_function_gives_what_the_surface_predicts(inside, text, kind):
    (inside / "ranges.toml").write_text(text)
    ran = success("run", "ranges.toml", "--jobs", 1, "--json")
    (surface,) = ran.json["surfaces"]
    assert surface["surface"]["kind"] == kind
    if kind == "quadratic":
        # the force is linear in C10: half the range times its slope, at the centre of the others
        linear = {row["term"]: row["coefficient"] for row in surface["surface"]["terms"]}
        assert linear["material.C10"] == pytest.approx(_force(10, 10, 20) / 4, rel=0.01)
        assert all(row["p"] is None for row in surface["surface"]["terms"])
    answer = success("export", "ranges", "--as", "emulator", "--json")
    (told,) = answer.json["functions"]
    assert told["kind"] == kind
    assert told["inputs"][0]["log"] == (text == LOG)
    module = Path(next(name for name in answer.json["files"] if name.endswith(".py")))
    rng = np.random.default_rng(3)
    points = rng.uniform([5.4, 0.93, 18.4], [9.6, 1.07, 21.6], (50, 3))
    at = dict(zip(("material.C10", "specimen.radius", "specimen.height"), points.T, strict=True))
    (known,) = package.predict("ranges", at)
    head = "import sys; sys.path.insert(0, '.'); import {0} as m; "
    asked = head + "print([m.peak_force(*p) for p in {1}])"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", asked.format(module.stem, points.tolist())],
        cwd=module.parent, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = np.array([float(x) for x in done.stdout.strip("[]\n").split(",")])
    assert found == pytest.approx(known.value, rel=1e-9)
    exact = _force(points[:, 0], 10 * points[:, 1], points[:, 2])
    assert np.mean(np.abs(found - exact) <= told["error_bound"]) >= 0.95
    assert told["error_bound"] < 0.05 * exact.mean()
    outside = head + "m.peak_force(4.0, 1.0, 20.0)"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", outside.format(module.stem)],
        cwd=module.parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "C10 = 4.0 is outside of 5.0 to 10.0" in done.stderr
    refused = refusal("export", "ranges", "--as", "emulator", "--response", "peak_farce", "--json")
    assert "peak_force" in refused.err
