"""The contract: the designs that ship, the template, and what they resolve to."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from study.ground.contrast import Threshold
from study.harness.design import load, overview
from study.harness.design import spec as cases
from study.laboratory.sensors.force_model import load_requirement
from study.laboratory.tracker.tracker_recording import load_tracking

DESIGNS = Path(__file__).parents[2] / "designs"
SHIPPED = ("ecoflex-compression", "conical-indentation", "ecoflex-range", "flat-punch")


@pytest.fixture(scope="module")
def ecoflex():
    return load.load(DESIGNS / "ecoflex-compression.toml")


@pytest.fixture(scope="module")
def conical():
    return load.load(DESIGNS / "conical-indentation.toml")


def test_responses(ecoflex, conical):
    first, second = ecoflex.responses
    assert (first.name, first.unit, first.transform) == ("relative_rms_force_error", "%", "none")
    assert first.practical == Threshold(0.5)
    assert (second.name, second.unit, second.transform) == ("mu0", "kPa", "log")
    assert second.practical == Threshold(0.1, relative=True)
    assert conical.responses[1].unit == "N"


def test_frictionless_plates_are_four_answers_in_sixteen_cells(ecoflex):
    # a homogeneous deformation is in every finite element space
    groups = overview.equivalent_groups(ecoflex)
    assert len(groups) == 20
    assert sorted(len(group) for group in groups) == [1] * 16 + [4] * 4
    for group in groups:
        if len(group) == 4:
            assert {cell.levels["plates"] for cell in group} == {"frictionless"}
            assert len({cell.levels["material"] for cell in group}) == 1
    assert len(overview.calibration_groups(ecoflex)) == 20
    assert overview.inert_cells(ecoflex, "model.space") == 16
    assert overview.inert_cells(ecoflex, "plates") == 0


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_designs_have_no_warnings_and_describe_themselves(name):
    study = load.load(DESIGNS / f"{name}.toml")
    told = overview.overview(study).to_json()
    if name == "ecoflex-range":  # to stretch 0.4, beyond Biot's 0.4437
        told["warnings"] = [one for one in told["warnings"] if "Biot 1963" not in one]
        assert len(overview.warnings(study)) == 1
    assert told["warnings"] == []
    assert told["duplicates"] == []
    assert len(told["matrix"]) == told["cells"]
    json.dumps(told, allow_nan=False)


def test_the_template_loads_as_it_stands():
    study = load.loads(load.template())
    assert len(study.treatments) == 8
    assert not overview.warnings(study)


def test_the_commented_lines_of_the_template_are_valid_too():
    text = load.template()
    for line in ('toe = "0.02 N"', 'zero = "first"', 'displacement = "6 mm"'):
        assert f"# {line}" in text
        load.loads(text.replace(f"# {line}", line))
    start = text.index("# [[exclude]]")
    end = text.index("[[response]]")
    block = "\n".join(line.removeprefix("# ") for line in text[start:end].splitlines())
    study = load.loads(text[:start] + block + "\n\n" + text[end:])
    assert len(study.excluded) == 2


@pytest.mark.parametrize("name", [*SHIPPED, "template"])
def test_round_trip(name):
    text = load.template() if name == "template" else (DESIGNS / f"{name}.toml").read_text()
    study = load.loads(text)
    again = load.loads(load.dump(study))
    assert again == study
    assert load.dump(again) == load.dump(study)
    ids = [case.case_id for case in cases.cases(study, ("a", "b"))]
    assert ids == [case.case_id for case in cases.cases(again, ("a", "b"))]


def test_loading_is_quick_and_light():
    code = (
        "import sys; from study.harness.design.load import load; load(sys.argv[1]);"
        "heavy = {'pint', 'pandas', 'scipy', 'matplotlib', 'gmsh', 'skfem', 'statsmodels'};"
        "print(*(heavy & set(sys.modules)))"
    )
    args = [sys.executable, "-c", code, str(DESIGNS / "ecoflex-compression.toml")]
    done = subprocess.run(args, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "\n", "")


@pytest.mark.parametrize("path", sorted(DESIGNS.glob("*.toml")), ids=lambda p: p.stem)
def test_every_design_that_ships_is_read(path):
    kind = load.file_kind(path)
    if kind == "calibration":
        assert load.load_calibration(path).tests
    elif kind == "question to sensors":
        assert load_requirement(path, load.problem_of).fitted
    elif kind == "tracker study":
        assert load_tracking(path).distance
    elif kind == "problem":
        assert load.load_problem(path).problem
    else:
        assert load.load(path).treatments


def test_what_nobody_measured_is_unknown_unless_said_otherwise():
    plain = load.load(DESIGNS / "demo.toml").roles
    assert plain == {"material": "choice", "plates": "unknown", "model.space": "choice"}
    override = 'analysis.roles={ plates = "condition" }'
    assert load.load(DESIGNS / "demo.toml", [override]).roles["plates"] == "condition"
