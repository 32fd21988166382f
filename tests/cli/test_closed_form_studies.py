"""Studies in closed form: every recorded number known by hand."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from study import run
from study.api.opened_study import load as open_study
from tests.cli.small import (
    CSV,
    incompressible_force,
    measured,
    pressed,
    refusal,
    responses,
    study,
    success,
)
from tests.pages import both_pages

LENGTH_MM, AREA_MM2 = 20.0, 100.0
PLACE_MM = 7.3

#: a cylinder between frictionless plates, and a strip in tension, whose forces have a formula
PRESSED = """
[specimen]
shape = "cylinder"
radius = "{radius} mm"
height = "20 mm"
[test]
kind = "compression"
interface = "frictionless"
{depth}
[forward]
model = "closed-form"
""".replace("{radius}", repr(float(np.sqrt(AREA_MM2 / np.pi))))
STRETCHED = """
[specimen]
shape = "homogeneous"
area = "100 mm^2"
length = "20 mm"
[test]
kind = "tension"
{depth}
"""
DESIGN = """
schema = 1
[study]
name = "formula"
{specimen}
[material]
model = "mooney-rivlin"
incompressible = true
{rest}
[[response]]
name = "peak_force"
[[response]]
name = "force_at"
displacement = "7.3 mm"
[[response]]
name = "stiffness_at"
displacement = "7.3 mm"
[[response]]
name = "work"
[report]
format = ["csv"]
"""
GIVEN = """C10 = "100 kPa"
C01 = "50 kPa"
[factors]
material.C10 = ["100 kPa", "200 kPa"]
"""
FITTED = """[measurements]
file = "strip.csv"
columns = {{ displacement = "d_mm", force = "f_N" }}
units = {{ displacement = "mm", force = "N" }}
block = "mix"
points = "raw"
[calibration]
leave_out = "nothing"
[factors]
measurements.range = [["{0} mm", "{2} mm"], ["{1} mm", "{2} mm"]]
[[response]]
name = "relative_rms_force_error"
practical = "0.5 pp"
"""
WAYS = {"pressed": (PRESSED, -1.0, 12.0), "stretched": (STRETCHED, 1.0, 30.0)}


def force(sense, c10, c01, area=AREA_MM2):
    """Force of an incompressible Mooney-Rivlin specimen, N, in the sense of the test."""

    def at(d):
        stretch = 1 + sense * d / LENGTH_MM
        return sense * area * 2 * (stretch - stretch**-2) * (c10 + c01 / stretch)

    return at


def by_hand(known, depth_mm, place=PLACE_MM):
    h = 1e-4
    return {
        "peak_force": known(depth_mm),
        f"force_at_{place:g}_mm": known(place),
        f"stiffness_at_{place:g}_mm": (known(place + h) - known(place - h)) / (2 * h),
        "work": quad(known, 0, depth_mm, epsabs=1e-12)[0],
    }


#: strips of a rubber that locks long before the end of the test
LOCKED = """
schema = 1
[study]
name = "formula"
{specimen}
[material]
model = "gent"
mu = "100 kPa"
Jm = 0.5
incompressible = true
[factors]
material.mu = {{ low = "50 kPa", high = "150 kPa" }}
specimen.area = {{ low = "50 mm^2", high = "150 mm^2" }}
[design]
kind = "latin-hypercube"
runs = 12
[[response]]
name = "peak_force"
practical = "10 % of mean"
"""


def written(specimen, rest, depth="", name="formula"):
    """Write a design whose specimen goes so deep."""
    path = Path(f"{name}.toml")
    path.write_text(DESIGN.format(specimen=specimen.replace("{depth}", depth), rest=rest))
    return path


def contents(name="formula"):
    for path in sorted(Path("results", name, "cases").glob("*/record.json")):
        yield json.loads(path.read_text())["content"]


def values(record, name):
    found = record[name]
    assert isinstance(found, dict)
    return {key: one["value"] for key, one in found.items()}


@pytest.mark.parametrize("way", WAYS)
def test_a_simulation_in_closed_form_needs_no_measurement(way, inside):
    specimen, sense, depth = WAYS[way]
    written(specimen, GIVEN, f'displacement = "{depth:g} mm"\nsteps = 5')
    success("run", "formula.toml", "--jobs", 1)
    found = list(contents())
    assert len(found) == 2
    for record in found:
        c10 = 1e-3 * float(record["levels"]["material.C10"].split()[0])
        exact = by_hand(force(sense, c10, 0.05), depth)
        told = values(record, "responses")
        assert {name: told[name] for name in exact} == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_what_was_measured_is_predicted_at_its_own_rows(way, inside):
    """Chords between ten load steps were a quarter of a percent of the work off."""
    specimen, sense, depth = WAYS[way]
    rows = ["mix,d_mm,f_N"]
    for number in range(3):
        known = force(sense, 0.1 + 0.01 * number, 0.05)
        rows += [f"M{number},{d!r},{known(d)!r}" for d in np.linspace(0, depth, 41).tolist()]
    Path("strip.csv").write_text("\n".join(rows) + "\n")
    written(specimen, FITTED.format(0.0, 0.1 * depth, depth))
    said = success("run formula.toml --jobs 1 --json").json["verdicts"]
    scores = {row["scored_on"] for row in said if row["response"] == "relative_rms_force_error"}
    assert scores == {"the curve fitted"}
    found = list(contents())
    assert len(found) == 6
    for record in found:
        constants, told = values(record, "parameters"), values(record, "responses")
        number = int(str(record["block"])[1:])
        assert constants["C10"] == pytest.approx(100 + 10 * number, rel=1e-7)
        exact = by_hand(force(sense, 1e-3 * constants["C10"], 1e-3 * constants["C01"]), depth)
        assert {name: told[name] for name in exact} == pytest.approx(exact, rel=1e-5)
        assert told["relative_rms_force_error"] < 1e-6


def test_a_sample_of_ranges_without_any_answer_is_reported(inside):
    placed = STRETCHED.replace("{depth}", 'displacement = "30 mm"')
    Path("formula.toml").write_text(LOCKED.format(specimen=placed))
    answer = study("run", "formula.toml", "--jobs", 1)
    assert answer.code == 1
    assert "12 failed" in answer.out
    assert "no run with" not in answer.err
    page = both_pages(inside / "reports/formula/formula.html")
    assert "none has an answer, so no surface is fitted" in page


@pytest.mark.usefixtures("inside")
def test_where_a_range_fails_is_named_and_nothing_is_predicted_there():
    """Gent's strip has a state while l^2 + 2/l - 3 < Jm; at 2.5 times its length from 4.05 on."""
    text = LOCKED.format(specimen=STRETCHED.replace("{depth}", 'displacement = "30 mm"'))
    wide = text.replace("specimen.area = {", "material.Jm = {").replace('"50 mm^2"', "0.5")
    design = wide.replace('"150 mm^2"', "8").replace("runs = 12", "runs = 40")
    Path("formula.toml").write_text(design + CSV)
    answer = study("run", "formula.toml", "--jobs", 1)
    assert answer.code == 1
    said = " ".join(answer.out.split())
    assert "Where cases fail: Jm 0.5 to 2.375: 10 of 10; Jm 2.375 to 4.25: 9 of 10" in said
    assert "Failing depends on Jm (p = .001)" in said
    least = float(answer.err.partition("no run with material.Jm below ")[2].split()[0])
    limit = 2.5**2 + 2 / 2.5 - 3
    assert limit < least < limit + 0.4
    for line in answer.out.splitlines():
        if "predicted:" in line:
            assert float(line.rpartition("material.Jm = ")[2]) >= least - 1e-3


@pytest.mark.usefixtures("inside")
def test_forces_of_a_function_are_known_between_the_displacements_it_was_asked_for():
    """A function tells forces alone: tangents failed, and the work was that of five chords."""
    written(STRETCHED + '[forward]\nmodel = "python"\n', GIVEN, 'displacement = "30 mm"\nsteps = 8')

    def model(problem):
        c10 = 2 * problem["material"]["constants_MPa"]["C10"]
        ls = [1 + d / 20.0 for d in problem["displacement_mm"]]
        return [100.0 * 2 * (x - x**-2) * (c10 + 0.05 / x) for x in ls]

    found = run("formula.toml", forward=model, version="1", jobs=1)
    assert found.cases["done"] == 2
    for record in found.records:
        c10 = 2e-3 * float(record.levels["material.C10"].split()[0])
        for name, exact in by_hand(force(1.0, c10, 0.05), 30.0).items():
            known = record.responses[name]
            assert known["value"] == pytest.approx(exact, rel=5e-3), name
            assert abs(known["value"] - exact) <= known["u_steps"] + 1e-12 * exact
    assert len(repr(found)) < 4000
    assert "formula" in repr(found)


@pytest.mark.usefixtures("inside")
def test_a_strip_becomes_a_force_law():
    path = written(STRETCHED, GIVEN, 'displacement = "30 mm"', "strip")
    text = path.read_text().partition("[factors]")[0]
    path.write_text(text.replace('[study]\nname = "formula"\n', ""))
    success("export", "strip.toml", "--json")
    law = runpy.run_path("reports/strip_force_law.py")
    known = force(1.0, 0.1, 0.05)
    for d in np.linspace(0, 30, 31).tolist():
        assert law["force"](d) == pytest.approx(known(d), abs=2e-3 * known(30.0))
    held = refusal("export strip.toml --set 'test.speed=\"1 mm/s\"' --set 'test.hold=\"1 s\"'")
    assert "leave hold and cycles out" in held.err


@pytest.mark.usefixtures("inside")
def test_virtual_measurements_need_to_know_how_far_a_test_goes():
    rest = re.sub(
        r"measurements\.range.*", 'material.model = ["mooney-rivlin", "neo-hookean"]',
        FITTED.format(0.0, 3.0, 30.0),
    )  # fmt: skip
    written(STRETCHED, rest)
    refused = refusal("virtual", ".", "--from", "formula.toml")
    assert 'write displacement = "10 mm"' in refused.err
    written(STRETCHED, rest, 'displacement = "30 mm"')
    success("virtual", ".", "--from", "formula.toml")
    assert Path("strip.csv").is_file()


UNCERTAIN = (
    "schema = 1\n"
    + STRETCHED.replace("{depth}\n", "[material]\nincompressible = true\n")
    + measured("m.csv")
    + """block = "specimen"
range = ["1 %", "10 %"]
points = 10
[presets.energy.soft]
material = { model = "neo-hookean", C10 = "9.5 kPa" }
[presets.energy.stiff]
material = { model = "neo-hookean", C10 = "10.5 kPa" }
[factors]
energy = ["soft", "stiff"]
[uncertainty]
"specimen.area" = "2 mm^2"
"specimen.length" = "0.1 mm"
"""
    + responses(work_error="1 pp")
    + CSV
)


def strip_force(d, length=20.0):
    """Force over C10, mm^2, of 100 mm^2."""
    return 200 * (1 + d / length - (1 + d / length) ** -2)


@pytest.mark.usefixtures("inside")
def test_area_and_length_of_a_strip():
    Path("u.toml").write_text(UNCERTAIN)
    rows = [
        f"{name},{d:.4f},{scale * 0.01 * force:.6f}"
        for name, scale in (("a", 1.0), ("b", 1.02), ("c", 0.97))
        for d in np.linspace(0.1, 2.0, 21)
        for force in strip_force(np.array([d]))
    ]
    Path("m.csv").write_text("\n".join(["specimen,d,f", *rows, ""]))
    success("run", "u.toml", "--data", ".", "--jobs", "1", "--json")
    found = json.loads(Path("results/u/validation.json").read_text())["content"]
    assert len(found) == 6
    for row in found:
        d, simulated = np.array(row["displacement_mm"]), np.array(row["simulated_N"])
        by_area = 0.02 * simulated
        modulus = {"soft": 0.0095, "stiff": 0.0105}[row["levels"]["energy"]]
        by_length = modulus * (strip_force(d, 20.1) - strip_force(d))
        expected = np.hypot(by_area, by_length)
        # known at some places of the curve, and carried to the others as a share of the force
        assert np.array(row["u_input_N"]) == pytest.approx(expected, rel=0.02)


RAW = pressed(
    '[material]\nmodel = "neo-hookean"\npoisson_ratio = 0.49\n[model]\nmesh_size = "5 mm"\n'
    + measured("m.csv")
    + 'block = "specimen"\npoints = "raw"\n[factors]\n'
    + '"test.interface" = ["frictionless", "bonded"]\n'
    + responses(mu0="1 kPa"),
    study='[study]\nassumed = ["test.interface"]\n',
    height=10,
    test="steps = 3\n",
).replace('interface = "frictionless"\n', "", 1)
#: moduli of the three specimens, MPa
MODULI = {"a": 0.010, "b": 0.011, "c": 0.0095}


@pytest.mark.usefixtures("inside")
def test_the_rows_say_how_far_the_test_goes():
    """The modulus comes back between frictionless plates, and is less if they are bonded."""
    Path("raw.toml").write_text(RAW)
    rows = ["specimen,d,f"]
    for name, modulus in MODULI.items():
        d = np.linspace(0.1, 2.0, 12)
        stretch = 1 - d / 10.0
        # nearly incompressible: 2 C10 A (1 / l^2 - l) to the order of 1 - 2 nu
        force = modulus * np.pi * 100 * (stretch**-2 - stretch)
        rows += [f"{name},{x:.6f},{f:.9f}" for x, f in zip(d, force, strict=True)]
    Path("m.csv").write_text("\n".join(rows) + "\n")
    assert study("plan", "raw.toml", "--data", ".").code == 0
    answer = success("run", "raw.toml", "--data", ".", "--jobs", "1", "--json")
    assert answer.json["cases"] == {"total": 6, "done": 6, "failed": 0, "missing": 0}
    found = {
        (one.levels["test.interface"], one.block): one.responses["mu0"]["value"]
        for one in open_study("results/raw", Path("results")).records
    }
    for name, modulus in MODULI.items():
        assert found["frictionless", name] == pytest.approx(1e3 * modulus, rel=0.02)
        assert found["bonded", name] < 0.95 * found["frictionless", name]
    verdict = next(row for row in answer.json["verdicts"] if row["factor"] == "test.interface")
    assert verdict["u_num"] > 0  # finer meshes were solved, which ended in an error
    assert study("verify", "raw").code == 0


SCALES = {"A": 1.0, "B": 1.2, "C": 0.9, "D": 1.1, "E": 0.95}
C10_KPA = 5.0

CROSS = pressed(
    """[material]
incompressible = true
[presets.material.neo-hookean]
model = "neo-hookean"
[presets.material.mooney-rivlin]
model = "mooney-rivlin"
"""
    + measured("tests.csv", "d_mm", "f_N")
    + """block = "gel"
points = "raw"
[calibration]
method = "analytic"
[factors]
material = ["neo-hookean", "mooney-rivlin"]
"""
    + responses(relative_rms_force_error="2 pp", mu0=""),
    study='[study]\nname = "cross"\n',
    radius=25,
    height=30,
)


@pytest.mark.usefixtures("inside")
def test_a_score_is_that_of_the_other_specimens_and_a_constant_its_own():
    """Forces of s_k times one curve: constants to all but k have the mean of their s."""
    d = np.linspace(0.0, 6.0, 61)
    force = incompressible_force(C10_KPA, 0.0, d)
    rows = [f"{k},{x:.6f},{s * f:.12f}" for k, s in SCALES.items() for x, f in zip(d, force)]  # noqa: B905
    Path("tests.csv").write_text("\n".join(["gel,d_mm,f_N", *rows]) + "\n")
    Path("cross.toml").write_text(CROSS)
    said = success("run cross.toml --data . --jobs 1 --json").json
    records = list(contents("cross"))
    assert len(records) == 2 * len(SCALES)
    for record in records:
        told, gel = values(record, "responses"), str(record["block"])
        others = float(np.mean([s for name, s in SCALES.items() if name != gel]))
        expected = 100 * abs(others / SCALES[gel] - 1)
        assert told["relative_rms_force_error"] == pytest.approx(expected, rel=1e-6)
        assert told["mu0"] == pytest.approx(2 * C10_KPA * SCALES[gel], rel=1e-6)
    scores = {one["response"]: one["scored_on"] for one in said["verdicts"]}
    assert scores["relative_rms_force_error"] == "other specimen"
    page = both_pages(Path("reports/cross/cross.html"))
    assert "predicted by constants fitted to the other specimens" in page


#: the cylinder by finite elements: it stays a cylinder, so that contact is known by hand too
ALONE = pressed(
    """[material]
model = "neo-hookean"
C10 = "5 kPa"
incompressible = true
[model]
mesh_size = "5 mm"
[factors]
material.C10 = ["5 kPa", "10 kPa"]
specimen.radius = ["10 mm", "10.1 mm"]
"""
    + responses(peak_force="0.2 N", force_at="", stiffness_at="0.5 N/mm", work="10 N mm",
                peak_contact_pressure="0.5 kPa", contact_area="1 mm^2", dofs="")
    + CSV,
    study='[study]\nname = "alone"\n',
    test='displacement = "4 mm"\nsteps = 8\n',
)  # fmt: skip
for _name in ("force_at", "stiffness_at"):
    ALONE = ALONE.replace(f'"{_name}"\n', f'"{_name}"\ndisplacement = "2.5 mm"\n')


def pressed_by_hand(c10_kPa, radius_mm):  # noqa: N803
    area = np.pi * radius_mm**2
    known = force(-1.0, 1e-3 * c10_kPa, 0.0, area)
    pressure = 1e3 * (1 - 4.0 / LENGTH_MM) * known(4.0) / area
    return by_hand(known, 4.0, 2.5) | {"peak_contact_pressure": pressure}


@pytest.fixture
def alone(inside):
    (inside / "alone.toml").write_text(ALONE)
    return inside


def test_simulated_responses_are_those_of_the_closed_form(alone):
    found = success("run", "alone.toml", "--jobs", 1, "--json").json
    assert found["cases"] == {"total": 4, "done": 4, "failed": 0, "missing": 0}

    shown = {(row["response"], row["factor"]): row for row in found["verdicts"]}
    assert all(row["p"] is None and row["ci95"] is None for row in shown.values())
    for response in pressed_by_hand(5, 10):
        soft = np.mean([pressed_by_hand(5, radius)[response] for radius in (10, 10.1)])
        # twice the constant is twice the force, so the difference is the mean of the softer three;
        # between two of eight steps the polynomial of fourth degree misses 1e-4 of the tangent
        effect = shown[response, "material.C10"]["effect"]
        assert effect == pytest.approx(soft, rel=1e-3), response

    wider = np.pi * (10.1**2 - 10**2) / (1 - 4.0 / LENGTH_MM)
    assert shown["contact_area", "specimen.radius"]["effect"] == pytest.approx(wider, rel=1e-3)

    force = shown["peak_force", "material.C10"]
    assert force["verdict"] == "matters"
    assert force["practical"] == 0.2
    assert shown["force_at_2.5_mm", "material.C10"]["verdict"] is None  # no practical

    # 2 % of area at 10 kPa are 0.10 N, and 0.20 N is what matters
    assert pressed_by_hand(10, 10.1)["peak_force"] - pressed_by_hand(10, 10)["peak_force"] < 0.2
    assert shown["peak_force", "specimen.radius"]["verdict"] == "no practical difference"

    listed = (alone / "reports/alone/alone-data/cases.csv").read_text().splitlines()
    assert "work" in listed[0]

    # what is finished is read again by the verbs that compute nothing
    for verb in ("report", "status"):
        assert study(verb, "alone", "--json").json["cases"]["done"] == len(listed) - 1


@pytest.mark.slow
def test_two_studies_of_simulations_are_compared(alone):
    other = ALONE.replace('"alone"', '"harder"').replace('"5 kPa", "10 kPa"', '"5 kPa", "20 kPa"')
    (alone / "harder.toml").write_text(other)
    for name in ("alone", "harder"):
        assert study("run", f"{name}.toml", "--jobs", 1, "--json").code == 0
    found = success("diff", "alone", "harder", "--json")
    rows = [row for row in found.json["conclusions"] if row["response"] == "peak_force"]
    assert rows


def test_more_runs_of_a_simulation_are_not_advised(alone):
    """A simulation gives the same answer again; a finer mesh may give another."""
    design = alone / "alone.toml"
    text = design.read_text().replace('interface = "frictionless"', 'interface = "bonded"')
    design.write_text(text.replace('format = ["csv"]', 'format = ["html"]'))
    found = success("run", design, "--no-refine", "-j", "1")
    said = " ".join(found.out.split()).partition("What would change this?")[2][:400]
    assert "a refined mesh, which was not tried, could move every result" in said
    assert "replicate" not in said
    page = (alone / "reports" / "alone" / "alone-details.html").read_text()
    assert "none: every response is one of the simulation alone" in page
