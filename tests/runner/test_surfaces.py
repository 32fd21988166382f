"""Files of surfaces: where they are looked for, what names a case, what a plan says of them."""

from dataclasses import replace

import numpy as np
import pytest

from study import api
from study.ground.errors import InputError
from study.harness.design.load import load, load_problem
from study.harness.runner.batch import expand
from study.harness.runner.study_refinement import chosen_series, refinement_work
from study.record.record import Record
from study.simulation.calibration import model_comparison
from study.simulation.fit_task import FitPart as Part
from study.simulation.fit_task import cheaper
from study.simulation.job import find, fit_problem, folders
from tests.cli.small import case_file, measured, recorded, responses
from tests.fem.surfaces import box, write

PROBLEM = """
schema = 1
[specimen]
shape = "surface"
file = "box.stl"
unit = "mm"
[test]
kind = "compression"
interface = "frictionless"
displacement = "0.6 mm"
steps = 1
[material]
model = "neo-hookean"
C10 = "5 kPa"
bulk_modulus = "10 MPa"
[model]
mesh_size = "3 mm"
"""
DESIGN = (
    PROBLEM.replace('displacement = "0.6 mm"\n', "").replace('C10 = "5 kPa"\n', "")
    + """
[factors]
"test.interface" = ["frictionless", "bonded"]
"""
    + measured("tests.csv")
    + 'block = "specimen"\nrange = ["0.1 mm", "0.6 mm"]\npoints = 5\n'
    + responses(mu0="")
)


@pytest.fixture
def home(tmp_path):
    """Folder of a design, its measurements beside it, the surface with the design."""
    designs, data = tmp_path / "designs", tmp_path / "measurements"
    designs.mkdir()
    data.mkdir()
    write(designs / "box.stl", box(10, 8, 6))
    (designs / "problem.toml").write_text(PROBLEM)
    (designs / "design.toml").write_text(DESIGN)
    rows = [f"{s},{d:.3f},{0.45 * d:.5f}" for s in "ab" for d in np.linspace(0, 0.7, 15)]
    (data / "tests.csv").write_text("\n".join(["specimen,d,f", *rows, ""]))
    return designs


def places(home):
    return folders(home / "design.toml", home.parent / "measurements")


def test_solve_reads_a_problem_with_a_surface(home):
    solution = api.solve(home / "problem.toml", gradients=False)
    assert solution.status == "converged"
    # the closed form of 10 % compression: 2 C10 (l - l^-2), next to incompressible
    assert solution.curve.force_N[-1] == pytest.approx(-80 * 0.01 * (0.9 - 0.9**-2), rel=2e-3)


def test_the_data_root_comes_first(home):
    assert find("box.stl", places(home)).parent == home.resolve()
    write(home.parent / "measurements" / "box.stl", box(10, 8, 7))
    found = find("box.stl", places(home))
    assert found.parent.name == "measurements"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("bx.stl", "did you mean 'box.stl'"),
        ("../box.stl", "must not climb"),
        ("/box.stl", "must be relative"),
        ("link.stl", "through a link"),
    ],
)
def test_files_elsewhere_are_refused(home, name, said):
    outside = home.parent / "outside.stl"
    write(outside, box(10, 8, 6))
    (home / "link.stl").symlink_to(outside)
    with pytest.raises(InputError, match=said):
        find(name, (home,))


def test_the_table_arrives(home):
    path = home / "problem.toml"
    more = 'unit = "cm"\naxis = "-x"\nclamp_below = "-3 mm"\npress_x = "1 mm"\n'
    path.write_text(PROBLEM.replace('unit = "mm"\n', more))
    made = load_problem(path).problem.specimen
    assert (made.unit, made.axis, made.clamp_below_mm) == ("cm", "-x", -3)
    assert (made.press_x_mm, made.press_y_mm) == (1, None)


def test_a_plan_checks_the_surface_and_says_what_was_mended(home):
    plan = api.plan(home / "design.toml", results=home / "results")
    assert (plan.cases["total"], plan.cases["missing"]) == (4, 4)
    assert plan.memory_MB is not None
    assert plan.memory_MB > 0
    assert plan.warnings == ()
    points, triangles = box(10, 8, 6)
    triangles[0] = triangles[0, ::-1]
    write(home / "box.stl", (points, triangles))
    plan = api.plan(home / "design.toml", results=home / "results")
    assert any("1 of 12 triangles" in warning for warning in plan.warnings)
    write(home / "box.stl", (points, triangles[1:]))
    with pytest.raises(InputError, match="3 open edges"):
        api.plan(home / "design.toml", results=home / "results")


def test_content_names_a_case_and_its_place_does_not(home, tmp_path):
    def hashes(folder):
        data = home.parent / "measurements"
        return expand(load(folder / "design.toml"), data).input_hashes

    before = hashes(home)
    moved = tmp_path / "elsewhere"
    home.rename(moved)
    assert hashes(moved) == before
    write(moved / "box.stl", box(10, 8, 6.5))
    after = hashes(moved)
    assert after.keys() == before.keys()
    assert not set(after.values()) & set(before.values())


def test_a_fit_of_a_surface_starts_from_no_cylinder(home):
    work = expand(load(home / "design.toml"), home.parent / "measurements")
    problem = fit_problem(work.jobs[0].case.cell).tests[0].problem
    # whatever the plates: only the file knows the shape
    assert not problem.setup.is_homogeneous
    assert problem.height_mm == pytest.approx(6)
    part = cheaper(Part("inverse-fem", problem.on_mesh(mesh="fine", mesh_size_mm=None), ()))
    assert part is not None
    assert (part.problem.model.space, part.problem.model.mesh) == ("3d", "coarse")


@pytest.mark.slow
def test_energies_are_weighed_on_a_surface(home, monkeypatch):
    """The surface is found for the choice of an energy as it is for a calibration."""
    data, d = home.parent / "measurements", np.linspace(0, 0.7, 15)
    columns = {"displacement": ("mm", d), "force": ("N", 0.45 * d)}
    bonded = 'kind = "compression", interface = "bonded", steps = 1'
    more = ', range = ["0.1 mm", "0.6 mm"], points = 3'
    start, end = DESIGN.index("[test]"), DESIGN.index("[material]")
    head = DESIGN[:start] + DESIGN[end : DESIGN.index("[factors]")]
    path = case_file(home, head, recorded(data, "one", bonded, columns, more))
    monkeypatch.setattr(model_comparison, "CANDIDATES", (("neo-hookean", None, "neo-hookean"),))
    chosen = api.choose_energy(path, data=data)
    assert chosen.failures == {}
    assert chosen.best == "neo-hookean"
    alone = api.calibrate(path, data=data)
    assert chosen.fits["neo-hookean"].fit.values == pytest.approx(alone.fit.values, rel=1e-9)


def test_numerical_uncertainty_knows_how_far_two_meshes_of_a_size_differ(home):
    """One value on the study's mesh, its refinements, and the other mesh: by the closed rules."""
    work = expand(load(home / "design.toml"), home.parent / "measurements")
    series = chosen_series(work)[0]
    assert series.other is not None
    base, again = (job.case.tested.model for job in (series.base, series.other))
    assert again == replace(base, mesh_seed=1)
    assert series.other in refinement_work(work).jobs

    def record(job, mu0):
        responses = {"mu0": {"value": mu0, "unit": "kPa"}}
        return Record(job.case.case_id, "surface", responses=responses)

    for number, job in enumerate(series.jobs):
        series.records[job.case.case_id] = record(job, 10.0 + 0.4 * 0.5**number)
    assert [j for j in series.every if j.case.case_id not in series.records] == [series.other]
    alone = series.uncertainty("mu0", "kPa")
    assert alone.u_num is not None
    assert "no other mesh" in alone.note
    series.records[series.other.case.case_id] = record(series.other, 10.4 - 0.3)
    both = series.uncertainty("mu0", "kPa")
    assert both.u_num == pytest.approx(np.hypot(alone.u_num, 3 * 0.3))
    assert "another mesh of the study's own size gives 10.1 kPa" in both.note
