"""Bad input: exit 2, an error that says key, rule, value and mend, and nothing written."""

import re
import shlex

import numpy as np
import pytest

from study.laboratory.tracker.tracker_recording import Errors
from tests.cli import test_analytic
from tests.cli.small import DESIGN, pressed, refusal, study, success
from tests.cli.test_require import PLATES
from tests.conftest import ROOT
from tests.fem.surfaces import sphere, write
from tests.registration.bodies import egg, scan
from tests.shape_validation.test_shape import MOTION, cylinder, problem, write_csv, write_ply
from tests.tracker_accuracy import virtual
from tests.tracker_accuracy.test_tracking import DISPLACEMENT, distance_study


def refused(home, command, says=()):
    """Run a command that must be refused in words; give back all that it says."""
    before = {p: p.stat().st_mtime_ns for p in home.rglob("*")}
    answer = refusal(*shlex.split(command))
    assert answer.out == ""
    assert {p: p.stat().st_mtime_ns for p in home.rglob("*")} == before
    for piece in says:
        assert piece in answer.err
    return answer.err


#: files that are sound, and the verb that reads them
SOUND = {
    "small": (DESIGN, "plan small.toml --data data"),
    "plates": (PLATES, "require plates.toml"),
    "sphere": (test_analytic.text(), "calibrate sphere.toml"),
    "cone": (
        test_analytic.text('{ shape = "cone", half_angle = "30 deg" }'), "calibrate cone.toml"
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("small", 'radius = "25 mm"', "radius = 25",
         ["small.toml", "specimen.radius", "needs a unit", "25", 'write "25 mm"']),
        ("small", "incompressible", 'model = "neo-hookean"\nC10 = "-5 kPa"\nincompressible',
         ["material.C10", "must be positive", "-10 kPa", "check the signs"]),
        ("small", "[material]", 'displacement = "40 mm"\n[material]',
         ["test.displacement", "40 mm reaches the height of the specimen, 30 mm", "smaller"]),
        ("small", "[specimen]", "[specimen", ["small.toml:7:10", "not valid TOML", "quotes"]),
        ("small", '"tests.csv"', '"../tests.csv"', ["measurements.file", "must not climb"]),
        ("plates", 'noise = "0.05 mm"', "noise = 0.05", ["needs a unit"]),
        ("plates", 'noise = "0.05 mm"', 'nose = "0.05 mm"', ["did you mean 'noise'"]),
        ("plates", 'scale = "1 %"', 'scale = "100 %"', ["below 100 %"]),
        ("plates", 'zero = "0.02 N"', 'zero = "-0.02 N"', ["at least 0"]),
        ("plates", "points = 50", "points = 1", ["from 2"]),
        ("plates", "points = 50", "accuracy = 0", ["above 0"]),
        ("plates", "points = 50", "multiples = []", ["1 to 6 numbers"]),
        ("plates", 'C10 = "10 kPa"', "", ["has no constants"]),
        ("plates", "[requirement]", "[predict]\nmaterial = 1\n[requirement]", ["predict.material"]),
        ("plates", "[requirement]", "[predict.test]\nkind = 'pull'\n[requirement]",
         ["predict.test.kind"]),
        ("plates", "samples = 0", "samples = 9\nmultiples = [90]", ["specimen's height"]),
        ("plates", "schema = 1", "schema = 2", ["schema"]),
        ("plates", PLATES[PLATES.index("[position]"):], "", ["nothing to propagate"]),
        ("sphere", '"indentation"', '"compression"', ["analytic is for indentation"]),
        ("sphere", '"frictionless"', '"bonded"', ["takes the indenter for frictionless"]),
        ("sphere", "incompressible = true", 'bulk_modulus = "1 MPa"', ["needs Poisson's ratio"]),
        ("sphere", 'force = "f" }\nunits = { displacement = "mm", force = "mN"',
         'stress = "f" }\nunits = { displacement = "mm", stress = "kPa"',
         ["needs displacement and force"]),
        ("cone", '"analytic"', '"analytic"\ntheory = "dimitriadis"',
         ["dimitriadis is a series for spheres"]),
    ],
)  # fmt: skip
def test_faulty_files(home, name, old, new, says):
    """By the verb; what else a file may have wrong: `tests/design/faulty_files`."""
    text, command = SOUND[name]
    assert old in text
    (home / f"{name}.toml").write_text(text.replace(old, new, 1))
    (home / "curves.csv").write_text("curve,d,f\na,0,0\na,0.1,1\na,0.2,2\na,0.3,3")
    refused(home, command, says)


@pytest.mark.parametrize(
    ("verb", "needed"),
    [
        ("require", "the file of sensor requirements (TOML: a problem with [requirement])"),
        ("tracking", "the file of a tracker study (TOML, which names the table in [recording])"),
        ("converge", "the file of a study"),
        ("solve", "the file of a problem"),
    ],
)
def test_a_table_of_data_is_told_from_a_broken_file(home, verb, needed):
    (home / "curves.csv").write_text("curve,d,f\na,0,0\n")
    says = refused(home, f"{verb} curves.csv", [f"is a table, not {needed}", "study analyze"])
    assert "TOML:" not in says.replace(needed, "")


def edited(home, *changes):
    """Change the measurements by patterns and what takes their place."""
    path = home / "data" / "tests.csv"
    text = path.read_text()
    for pattern, new in changes:
        text, count = re.subn(pattern, new, text)
        assert count, pattern
    path.write_text(text)


#: rows beyond 4 mm, the last cell of the fifth line, and the second repeat of each specimen
DEEP, LAST, SECOND = r"(?m)^\w+,\w+,\d,[4-6]\.\d+,.*\n", r"\A((?:.*\n){4}.*,).*", r"(?m)^(\w+,\w),2"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ([("(?s).+", "")], ["tests.csv", "the file is empty", "header"]),
        ([("(?s)\n.+", "")], ["tests.csv", "no row of data", "one row a sample"]),
        ([(",", ";"), (r"\.", ",")],
         ["column 'd_mm'", "decimal comma", 'write decimal = ","']),
        # both columns of numbers get one more comma in every row
        ([(r"\.", ",")], ["tests.csv:2", "7 cells where the header has 5", "every row needs 5"]),
        ([(LAST, r"\1nan")], ["tests.csv:5", "column 'f_N'", "'nan'", "must be left out"]),
        ([(LAST, r"\1")], ["tests.csv:5", "column 'f_N'", "the cell is empty", "delete the row"]),
        ([(DEEP, "")],
         ["mix = M1", "ends at 3.9 mm (13 %)", "6 mm (20 %)", "shorten the range"]),
        ([(SECOND, r"\1,1")], ["starts again", "several tests in one", "`average`"]),
    ],
    ids=["empty", "header", "comma", "commas", "nan", "blank", "short", "unsorted"],
)  # fmt: skip
def test_faulty_measurements(home, changes, says):
    edited(home, *changes)
    refused(home, "plan small.toml --data data", says)


#: what is on disk beside the small study
STRAY = {
    "broken.json": "{",
    "other.json": "{}",
    "failed.json": '{"status": "not-converged", "name": "x", "parameters": {}, "correlation": [],'
    ' "tests": []}',
    "sphere.toml": test_analytic.text(),
}
TABLE = "analyze data/tests.csv --response f_N"
GELS = f"{TABLE} --factors specimen --block mix"
RUN = "run small.toml --data data"


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("run small.toml --data nowhere", ["--data", "no folder 'nowhere'"]),
        ("plan small.toml --data nowhere", ["--data", "no folder 'nowhere'"]),
        ("run small.toml", ["no file 'tests.csv' below", "--data DIR"]),
        (f"{RUN} --timeout nan", ["positive number of seconds"]),
        (f"{RUN} --timeout 0", ["positive number of seconds"]),
        (f"{RUN} --timeout -1", ["positive number of seconds"]),
        (f"{RUN} -s 'report.format = [\"docx\"]'", ["docx"]),
        (f"{RUN} -s 'specimen.radius = 1e200 mm'", ["too large for any test"]),
        (f"{RUN} -s 'specimen.radius = 1e-200 mm'", ["too small for any test"]),
        ("plan smal.toml", ["smal.toml", "no such file", "did you mean 'small.toml'?"]),
        ("solve small.toml", ["is a design", "study plan"]),
        ("plan problem.toml", ["factors"]),
        ("calibrate problem.toml", ["study solve"]),
        ("calibrate sphere.toml --energies", ["--energies"]),
        ("solve problem.toml -s material.C10=5", ["material.C10", "needs a unit"]),
        ("solve problem.toml -s nonsense", ["-s", "key=value", "nonsense"]),
        ("solve problem.toml -s 'model.mesh_sice=\"2 mm\"'",
         ["model.mesh_sice", "did you mean 'mesh_size'?"]),
        ("converge", ["--values", "--sizes"]),
        ("converge --values 1,x --sizes 1,2", ["--values", "numbers", "'1,x'"]),
        ("converge --values 1,2 --sizes 1", ["sizes"]),
        ("converge --values 1,2 --sizes 1,2", ["at least three meshes"]),
        ("converge --values 1,2,3 --sizes 1,2,2", ["must be distinct"]),
        ("converge problem.toml --values 1", ["not both"]),
        ("converge small.toml --data data --memory 900", ["--memory", "--jobs"]),
        ("analyze no.csv --response a --factors b", ["no.csv"]),
        ("analyze data/tests.csv", ["--response", "--factors"]),
        ("analyze data/tests.csv --response fN --factors Mix",
         ["no such column", "did you mean 'f_N'?", "did you mean 'mix'"]),
        (f"{TABLE} --numeric d_mm --factors d_mm",
         ["'d_mm' stands twice among factors, numbers, response and block"]),
        (f"{TABLE} --numeric d_mm --factors mix,mix", ["'mix' stands twice"]),
        (f"{TABLE} --numeric d_mm --factors mixs", ["did you mean 'mix'"]),
        (f"{TABLE} --numeric d_mm --report out --format word", ["word"]),
        (f"{GELS} --random specimen", ["add --error reml"]),
        (f"{GELS} --error reml --unit specimen", ["no meaning for a mixed model"]),
        (f"{GELS} --error reml --covariates d_m", ["d_mm"]),
        (f"{GELS} --contrast A", ["two settings"]),
        (f"{GELS} --contrast 'A - BB'", ["no level 'BB'"]),
        (f"{GELS} --format pdf", ["add --report DIR"]),
        (f"{GELS} --report out --format htm", ["did you mean 'html'"]),
        (f"{GELS} --report data/tests.csv", ["name a folder"]),
        ("analyze data --report out", ["study report STUDY"]),
        ("status small", ["looked in small, results/small", "run the design first"]),
        ("report small", ["looked in small, results/small", "run the design first"]),
        ("analyze small", ["looked in small, results/small", "run the design first"]),
        ("export nowhere.toml", ["no results of a study there"]),
        ("export problem.toml --as lookup", ["force-law"]),
        ("export problem.toml --tolerance 0", ["between 0 and 1"]),
        ("export calibration.toml", ["study calibrate"]),
        ("export small.toml", ["--case"]),
        ("export broken.json", ["is not valid JSON"]),
        ("export other.json", ["no document of a calibration"]),
        ("export failed.json", ["ended as not-converged"]),
        ("export problem.toml -s 'material.C10=\"-1 kPa\"'", ["C10"]),
        ("export problem.toml -s 'test.displacement=\"11 mm\"'", ["height"]),
        ("virtual data/tests.csv --from small.toml", ["could not be written (Not a directory)"]),
        ("virtual data/tests.csv", ["could not be written (Not a directory)"]),
        ("demo --results data/tests.csv", ["could not be written (Not a directory)"]),
        (f"plan {ROOT}/designs/demo.toml --run-sheet small.toml", ["not overwritten"]),
        (f"plan {ROOT}/designs/noise.toml --run-sheet trials.csv", ["nothing to randomize"]),
        (f"calibrate {ROOT}/designs/tests-of-material.toml --by test --difference 5",
         ["--difference: needs a unit"]),
        (f"run {ROOT}/designs/truth-cube.toml --data data",
         ["truth_cube/uniaxial_positions.csv", "Kerdok"]),
        ("new small.toml", ["small.toml", "exists already"]),
        ("run small.toml --dta data", ["--dta", "--data"]),
        ("rnu small.toml", ["rnu", "run"]),
    ],
)  # fmt: skip
def test_faulty_commands(home, command, says):
    for name, text in STRAY.items():
        (home / name).write_text(text)
    refused(home, command, says)


def test_all_faults_come_at_once(home, edit):
    edit('radius = "25 mm"', "radius = 25")
    edit('kind = "compression"', 'kind = "compresion"')
    edit('practical = "0.5 pp"', 'practical = "0.5 N"')
    words = refused(home, RUN, ("specimen.radius", "test.kind", "response[0].practical"))
    assert words.startswith("3 errors:")


def test_equal_faults_are_told_once_with_their_places(home):
    edited(home, (DEEP, ""))
    words = refused(home, RUN)
    assert words.count("shorten the range") == 1
    assert "the same at: " in words
    assert "and 8 more" in words


MEASURED = pressed(
    '[material]\nmodel = "yeoh"\nincompressible = true\n[measurements]\nfile = "a.csv"\n'
    '[calibration]\nmethod = "auto"\n'
)


@pytest.mark.parametrize(
    ("text", "verbs", "mend"),
    [
        ("[recording]\nfile = 'a.csv'\n[factors]\na = 1", ("plan", "run"), "study tracking"),
        ("[material]\n[requirement]\naccuracy = '5 %'", ("plan", "solve"), "study require"),
        ("[specimen]\n[test]\n[material]\n[model]", ("plan", "run"), "study export"),
        (MEASURED, ("plan", "solve", "calibrate"), "[[tests]]"),
    ],
    ids=["tracker", "sensors", "problem", "single"],
)
def test_a_file_of_another_verb_names_that_verb(tmp_path, text, verbs, mend):
    (tmp_path / "file.toml").write_text(text)
    for verb in verbs:
        message = refused(tmp_path, f"{verb} {tmp_path}/file.toml")
        assert message.startswith("error:")  # one fault, not a list of missing keys
        assert mend in message


@pytest.mark.parametrize("name", ["case.json", "problem.json"])
def test_a_file_that_every_case_gets_is_not_among_those_that_go_along(tmp_path, name):
    forward = f'[forward]\nmodel = "command"\nargv = [["true"]]\nfiles = ["{name}"]\n'
    text = f"""[study]\nname = "own"\n[parameters]\na = 1\n{forward}
[factors]\n"parameters.a" = [1, 2]\n[[response]]\nname = "peak"\nunit = "N"\n"""
    (tmp_path / "own.toml").write_text(text)
    words = refused(tmp_path, f"plan {tmp_path}/own.toml")
    assert f"holds {name}, which this package writes" in words


def test_a_study_without_series_says_why_it_has_no_convergence(done):
    """All its plates are frictionless: exact on every mesh, so nothing was refined."""
    words = refused(done, "converge results/small --json")
    assert "no refinement is stored" in words
    assert "no mesh matters" in words


SOLVE = """
schema = 1
[specimen]
shape = "surface"
file = "organ.stl"
unit = "{unit}"
clamp_below = "-2 mm"
[test]
kind = "indentation"
interface = "frictionless"
displacement = "0.4 mm"
steps = 1
indenter = {{ shape = "sphere", radius = "8 mm" }}
[material]
model = "neo-hookean"
C10 = "5 kPa"
poisson_ratio = 0.495
[model]
space = "3d"
element_order = "linear"
mesh = "coarse"
"""


def solving(folder, *, factor=1.0, left_out=0, unit="mm"):
    points, triangles = sphere(10, 3)
    write(folder / "organ.stl", (factor * points, triangles[left_out:]))
    (folder / "organ.toml").write_text(SOLVE.format(unit=unit))
    return ["solve", str(folder / "organ.toml")]


def shaping(folder, change, *, markers=0):
    whole = egg()
    cloud = MOTION(change(scan(whole, 1500, np.random.default_rng(5))))
    command = ["shape", str(write_ply(folder / "body.ply", whole))]
    command += ["--scan", str(write_csv(folder / "scan.csv", cloud))]
    if markers:
        command += ["--markers", str(write_csv(folder / "marks.csv", cloud[:markers]))]
    return [*command, "--reports", str(folder / "reports")]


def another_state(folder):
    cloud = write_csv(folder / "scan.csv", MOTION(cylinder(20.0, 30.0, 2000, 7)))
    return ["shape", str(problem(folder)), "--scan", str(cloud), "--reports", str(folder)]


def tracked(folder, file):
    return ["tracking", str(file), "--data", str(folder), "--reports", str(folder / "reports")]


def in_metres(folder):
    file = distance_study(folder, 1)
    file.write_text(file.read_text().replace('unit = "mm"', 'unit = "m"', 1))
    return tracked(folder, file)


def two_stops(folder):
    rows = [row for row in virtual.rows_of(Errors(1)) if row[2] in (0.0, 50.0)]
    virtual.write(folder / "stage.csv", "time,stop,commanded,x,y,z", rows)
    (folder / "stage.toml").write_text(DISPLACEMENT)
    return tracked(folder, folder / "stage.toml")


def same(points):
    return points


CASES = {
    "solve, a hole": (
        lambda f: solving(f, left_out=3), 2, "is not closed", "fill the holes"),
    "solve, metres for millimetres": (
        lambda f: solving(f, factor=1e-3), 2, "0.02 mm large if its file is in mm", 'unit = "m"'),
    "solve, millimetres for metres": (
        lambda f: solving(f, unit="m"), 2, "2e+04 mm large if its file is in m", 'unit = "mm"'),
    "shape, metres for millimetres": (
        lambda f: shaping(f, lambda p: p / 1000), 2, "the simulated body", '--unit "m"'),
    "shape, a mirrored cloud": (
        lambda f: shaping(f, lambda p: p * [1, -1, 1]), 2, "is mirrored", "negate one coordinate"),
    "shape, too few markers": (
        lambda f: shaping(f, same, markers=2), 2, "has 2 markers, 3 or more", "mark more points"),
    "shape, no surface in the cloud": (
        lambda f: shaping(f, lambda p: p[:20]), 2, "has 20 points", "scan more of the body"),
    "shape, another state": (another_state, 3, "another state", "--any-state"),
    "tracking, metres for millimetres": (in_metres, 2, "mm apart", '"m" instead of "mm"'),
    "tracking, two stops": (two_stops, 2, "2 commanded positions", "stop at more positions"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_it_is_refused_with_a_way_to_mend_it(case, tmp_path):
    make, code, rule, mend = CASES[case]
    answer = study(*make(tmp_path))
    assert answer.code == code
    told = " ".join(answer.err.split())
    assert rule in told
    assert mend in told
    assert not (tmp_path / "reports").exists()  # nothing is written


def test_outliers_are_counted_in_the_answer(tmp_path):
    strewn = np.random.default_rng(3).uniform(-300, 300, (90, 3))
    answer = success(*shaping(tmp_path, lambda p: np.vstack([p, strewn])))
    assert "90 isolated points left out" in " ".join(answer.out.split())
