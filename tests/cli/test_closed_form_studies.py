"""Studies in closed form, with and without measurements: every recorded number known by hand."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from study import run
from tests.cli.small import refusal, study, success
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


def force(sense: float, c10: float, c01: float) -> Callable[[float], float]:
    """Force of an incompressible Mooney-Rivlin specimen, N, in the sense of the test."""

    def at(d: float) -> float:
        stretch = 1 + sense * d / LENGTH_MM
        return sense * AREA_MM2 * 2 * (stretch - stretch**-2) * (c10 + c01 / stretch)

    return at


def by_hand(known: Callable[[float], float], depth_mm: float) -> dict[str, float]:
    h = 1e-4
    return {
        "peak_force": known(depth_mm),
        "force_at_7.3_mm": known(PLACE_MM),
        "stiffness_at_7.3_mm": (known(PLACE_MM + h) - known(PLACE_MM - h)) / (2 * h),
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


def contents(folder: Path) -> Iterator[dict[str, object]]:
    for path in sorted((folder / "results/formula/cases").glob("*/record.json")):
        yield json.loads(path.read_text())["content"]


def values(record: dict[str, object], name: str) -> dict[str, float]:
    found = record[name]
    assert isinstance(found, dict)
    return {key: one["value"] for key, one in found.items()}


@pytest.mark.parametrize("way", WAYS)
def test_a_simulation_in_closed_form_needs_no_measurement(way: str, inside: Path) -> None:
    specimen, sense, depth = WAYS[way]
    placed = specimen.replace("{depth}", f'displacement = "{depth:g} mm"\nsteps = 5')
    Path("formula.toml").write_text(DESIGN.format(specimen=placed, rest=GIVEN))
    success("run", "formula.toml", "--jobs", 1)
    found = list(contents(inside))
    assert len(found) == 2
    for record in found:
        c10 = 1e-3 * float(record["levels"]["material.C10"].split()[0])  # type: ignore[index]
        exact = by_hand(force(sense, c10, 0.05), depth)
        told = values(record, "responses")
        for name, value in exact.items():
            assert told[name] == pytest.approx(value, rel=1e-6), name


@pytest.mark.parametrize("way", WAYS)
def test_what_was_measured_is_predicted_at_its_own_rows(way: str, inside: Path) -> None:
    """Chords between ten load steps were a quarter of a percent of the work off."""
    specimen, sense, depth = WAYS[way]
    rows = ["mix,d_mm,f_N"]
    for number in range(3):
        known = force(sense, 0.1 + 0.01 * number, 0.05)
        rows += [f"M{number},{d!r},{known(d)!r}" for d in np.linspace(0, depth, 41).tolist()]
    Path("strip.csv").write_text("\n".join(rows) + "\n")
    rest = FITTED.format(0.0, 0.1 * depth, depth)
    Path("formula.toml").write_text(
        DESIGN.format(specimen=specimen.replace("{depth}", ""), rest=rest)
    )
    success("run", "formula.toml", "--jobs", 1)
    found = list(contents(inside))
    assert len(found) == 6
    for record in found:
        constants, told = values(record, "parameters"), values(record, "responses")
        number = int(str(record["block"])[1:])
        assert constants["C10"] == pytest.approx(100 + 10 * number, rel=1e-7)
        exact = by_hand(force(sense, 1e-3 * constants["C10"], 1e-3 * constants["C01"]), depth)
        for name, value in exact.items():
            assert told[name] == pytest.approx(value, rel=1e-5), name
        assert told["relative_rms_force_error"] < 1e-6


def test_a_sample_of_ranges_without_any_answer_is_reported(inside: Path) -> None:
    placed = STRETCHED.replace("{depth}", 'displacement = "30 mm"')
    Path("formula.toml").write_text(LOCKED.format(specimen=placed))
    answer = study("run", "formula.toml", "--jobs", 1)
    assert answer.code == 1
    assert "12 failed" in answer.out
    assert "no run with" not in answer.err
    page = both_pages(inside / "reports/formula/formula.html")
    assert "none has an answer, so no surface is fitted" in page


@pytest.mark.usefixtures("inside")
def test_where_a_range_fails_is_named_and_nothing_is_predicted_there() -> None:
    """Gent's strip has a state while l^2 + 2/l - 3 < Jm; at 2.5 times its length from 4.05 on."""
    text = LOCKED.format(specimen=STRETCHED.replace("{depth}", 'displacement = "30 mm"'))
    wide = text.replace("specimen.area = {", "material.Jm = {").replace('"50 mm^2"', "0.5")
    design = wide.replace('"150 mm^2"', "8").replace("runs = 12", "runs = 40")
    Path("formula.toml").write_text(design)
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
def test_forces_of_a_function_are_known_between_the_displacements_it_was_asked_for() -> None:
    """A function tells forces alone: tangents failed, and the work was that of five chords."""
    placed = STRETCHED.replace("{depth}", 'displacement = "30 mm"\nsteps = 8')
    placed += '[forward]\nmodel = "python"\n'
    Path("formula.toml").write_text(DESIGN.format(specimen=placed, rest=GIVEN))

    def model(problem: dict[str, Any]) -> list[float]:
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
def test_a_strip_becomes_a_force_law() -> None:
    placed = STRETCHED.replace("{depth}", 'displacement = "30 mm"')
    text = DESIGN.format(specimen=placed, rest=GIVEN).partition("[factors]")[0]
    Path("strip.toml").write_text(text.replace('[study]\nname = "formula"\n', ""))
    success("export", "strip.toml", "--json")
    law = runpy.run_path("reports/strip_force_law.py")
    known = force(1.0, 0.1, 0.05)
    for d in np.linspace(0, 30, 31).tolist():
        assert law["force"](d) == pytest.approx(known(d), abs=2e-3 * known(30.0))
    held = refusal(
        "export", "strip.toml", "--set", 'test.speed="1 mm/s"', "--set", 'test.hold="1 s"'
    )
    assert "leave hold and cycles out" in held.err


@pytest.mark.usefixtures("inside")
def test_virtual_measurements_need_to_know_how_far_a_test_goes() -> None:
    text = DESIGN.format(specimen=STRETCHED, rest=FITTED.format(0.0, 3.0, 30.0))
    ranges = next(line for line in text.splitlines() if line.startswith("measurements.range"))
    text = text.replace(ranges, 'material.model = ["mooney-rivlin", "neo-hookean"]')
    Path("formula.toml").write_text(text.replace("{depth}", ""))
    refused = refusal("virtual", ".", "--from", "formula.toml")
    assert 'write displacement = "10 mm"' in refused.err
    Path("formula.toml").write_text(text.replace("{depth}", 'displacement = "30 mm"'))
    assert study("virtual", ".", "--from", "formula.toml").code == 0
    assert Path("strip.csv").is_file()
