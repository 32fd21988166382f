"""Bad input: every fault at once, each with its key, rule and mend; before anything is computed.

What is wrong with keys stands in ``faulty_files``; here is what no change of a key shows.
"""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import pytest

from study.ground.errors import InputError
from study.harness.design import load as load_module
from study.harness.design.load import (
    CALIBRATION,
    file_kind,
    load_calibration,
    load_problem,
    loads,
    loads_problem,
)
from study.mechanics.measurement.measurement_section import Range
from study.simulation import plausibility
from tests.cli.small import measured
from tests.design import faulty

PROBLEM = """
schema = 1
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "indentation"
interface = "frictionless"
displacement = "5 mm"
indenter = { shape = "cone", half_angle = "30 deg", tip_radius = "0.5 mm" }
[material]
model = "reduced-polynomial"
C10 = "5 kPa"
C20 = "1 kPa"
bulk_modulus = "10 MPa"
[model]
space = "axisymmetric"
mesh_size = "1.5 mm"
"""
DESIGN = (Path(__file__).parents[2] / "designs" / "ecoflex-compression.toml").read_text()


def faults(load, text, *args):
    with pytest.raises(InputError) as caught:
        load(text, "x.toml", *args)
    for fault in caught.value.faults:
        assert fault.where.startswith(("x.toml", "-s"))
    return {f.where.removeprefix("x.toml: "): f"{f.rule} | {f.mend}" for f in caught.value.faults}


def test_the_problem_itself_is_fine():
    config = loads_problem(PROBLEM).problem.document()
    assert config["material"] == {
        "model": "reduced-polynomial",
        "order": 2,
        "constants": {"C10": 0.005, "C20": 0.001},
        "bulk_modulus_MPa": 10.0,
    }
    assert config["model"]["mesh_size_mm"] == 1.5
    assert config["test"]["steps"] == 10
    assert config["test"]["base"] == "bonded"


def test_unstable_constants_name_the_stretch():
    # F26: a negative C20 softens with compression; Drucker's limit is that of
    # study.mechanics.material
    text = PROBLEM.replace('"indentation"', '"compression"').replace('C20 = "1', 'C20 = "-3')
    deep = text.replace('"5 mm"', '"15 mm"')
    assert loads_problem(deep.replace('"-3 kPa"', '"3 kPa"'))
    found = faults(loads_problem, deep)
    assert "uniaxial loading below stretch 0." in found["material"]
    assert loads_problem(text.replace('"5 mm"', '"1 mm"'))


def test_synonyms():
    text = PROBLEM.replace('"frictionless"', '"lubricated"')
    for written, meant in (
        ("triangle", "simplex"),
        ("tetrahedron", "simplex"),
        ("quadrilateral", "tensor"),
        ("hexahedron", "tensor"),
    ):
        config = loads_problem(text + f'element_shape = "{written}"\n').problem.document()
        assert config["model"]["element_shape"] == meant
        assert config["test"]["interface"] == "frictionless"


def test_uncertainty_is_in_internal_units():
    lines = '"specimen.height" = "1 cm"\nmaterial.poisson_ratio = 0.001\n'
    study = loads(f"{DESIGN}\n[uncertainty]\n{lines}")
    assert study.uncertainty == {"specimen.height": 10.0, "material.poisson_ratio": 0.001}


@pytest.mark.parametrize("size", [-0.1, 0])
def test_an_uncertainty_of_a_parameter_is_above_zero(size):
    text = (
        'schema = 1\n[forward]\nmodel = "python"\n[[response]]\nname = "y"\n[factors]\n'
        "parameters.k = { low = 1, high = 2 }\n[uncertainty]\nparameters.k = "
    )
    assert loads(f"{text}0.1").inputs["parameters.k"].numbers == (1.5, 0.1)
    assert "must be above 0" in faults(loads, f"{text}{size}")["uncertainty.parameters.k"]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("schema = 1\n[specimen\n", "x.toml:2:10"),
        ("schema = 1\nname = unquoted\n", "x.toml:2:8"),
        ("schema = 1\nschema = 1\n", "x.toml:2:11"),
        ('a = "never closed', "x.toml:1:18"),
    ],
)
def test_malformed_toml_says_file_line_and_column(text, place):
    ((where, rule),) = faults(loads, text).items()  # F24
    assert where == place
    assert "not valid TOML" in rule


def test_not_utf8():
    with pytest.raises(InputError, match=r"x\.toml:2: is not UTF-8"):
        loads(b"schema = 1\n# \xff\n", "x.toml")
    with pytest.raises(InputError, match=r"x\.toml:2: holds a NUL byte: it is no text file"):
        loads(b"schema = 1\n\0\xff", "x.toml")
    assert loads(b"\xef\xbb\xbf" + DESIGN.replace("\n", "\r\n").encode())


@pytest.mark.parametrize(
    "text",
    [
        "a" * 300_000,  # F33
        "# " + "x" * 5000,
        "a = " + "[" * 3000,
        "a = " + "[" * 300 + "]" * 300,
        ".".join("a" * 1500) + " = 1",
        "a = " + "9" * 3000,
        "a = 0x" + "f" * 3000,
        "\n".join(f"{'.'.join('abc' * 600)}.k{i} = 1" for i in range(60)),
    ],
)
def test_sizes_are_capped(text):
    faults(loads, text)


def test_a_factor_is_a_list_or_a_range():
    twice = '[factors]\n"specimen.height" = ["28 mm", "30 mm"]\nspecimen.height.low = "25 mm"\n'
    twice += 'specimen.height.high = "35 mm"\n'
    found = faults(loads, DESIGN.replace("[factors]", twice, 1))
    assert "stands twice" in found["factors.specimen.height"]


def test_files_that_cannot_be_read(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path, "a\0b", tmp_path / ("x" * 400)):
        for load in (load_module.load, load_problem, load_calibration, file_kind):
            with pytest.raises(InputError):
                load(path)


def test_files_of_another_kind_are_named():
    assert "use `study solve`" in faults(CALIBRATION.loads, PROBLEM)["x.toml"]
    assert "is a design" in faults(loads_problem, DESIGN)["x.toml"]
    assert "use `study solve`" in faults(loads, PROBLEM)["x.toml"]
    assert "factors" in faults(loads, PROBLEM + '[report]\nformat = ["csv"]\n')


def test_plausibility_warns_of_units():
    right = PROBLEM.replace('"1.5 mm"', '"0.9 mm"')
    wrong = right.replace('"5 kPa"', '"5 GPa"').replace('"10 MPa"', '"1 TPa"')
    told, none = (
        plausibility.cautions_of(loaded.problem) for loaded in map(loads_problem, (wrong, right))
    )
    assert "is the unit right?" in told[0]
    assert none == ()


STORED = faulty.stored()
GROUPS = {
    f"{base}: {table}": list(rows)
    for (base, table), rows in groupby(
        sorted(STORED, key=lambda one: (one.base, one.table)), lambda one: (one.base, one.table)
    )
}


@pytest.mark.parametrize("base", faulty.LOADERS | faulty.OF_SINGLE_RULES)
def test_the_sound_files_are_sound(base):
    assert faulty.faults_of(base, {}) == []


@pytest.mark.parametrize("group", GROUPS)
def test_faults_of_changed_files(group):
    differing, poorer = {}, {}
    for kept in GROUPS[group]:
        found = faulty.faults_of(kept.base, kept.change)
        if [fault[:2] for fault in found] != [fault[:2] for fault in kept.faults]:
            differing[str(kept.change)] = {"kept": kept.faults, "found": found}
        elif any(map(is_poorer, found, kept.faults)):
            poorer[str(kept.change)] = {"kept": kept.faults, "found": found}
    assert differing == {}
    assert poorer == {}


def is_poorer(found, kept):
    """Whether a mend is gone, or no longer names the nearest key."""
    named = re.match(r"did you mean '[^']*'", kept[2])
    return bool(kept[2] and not found[2]) or bool(named and named[0] not in found[2])


def test_every_key_is_changed():
    met = set()
    every = {(base, str(c)) for base in faulty.LOADERS for c in faulty.changes(base, met)}
    assert every <= {(one.base, str(one.change)) for one in STORED}


PRESSED = """[[tests]]
test = { kind = "compression", interface = "frictionless", displacement = "6 mm" }
role = "fit"
weight = "scatter"
"""
SMALLER = """[[tests]]
test = { kind = "compression", interface = "bonded" }
specimen = { shape = "cylinder", radius = "10 mm", height = "20 mm" }
role = "held-out"
weight = 2.5
"""
TEXT = (
    'schema = 1\nspecimen = { shape = "cylinder", radius = "25 mm", height = "30 mm" }\n'
    'model = { space = "axisymmetric", element_order = "quadratic" }\n'
    'material = { model = "reduced-polynomial", order = 2, poisson_ratio = 0.4995 }\n'
    + "".join(
        test + measured(file).replace("[m", "[tests.m") + 'range = ["1 %", "20 %"]\n'
        for test, file in ((PRESSED, "a.csv"), (SMALLER, "b.csv"))
    )
)
CONICAL = (Path(__file__).parents[2] / "designs" / "conical-indentation.toml").read_text()


def test_tests_inherit_specimen_and_model():
    found = load_module.CALIBRATION.loads(TEXT)
    fit, held_out = found.tests
    assert found.material.order == 2
    assert fit.problem.setup.model.mesh == held_out.problem.setup.model.mesh == "medium"
    assert (fit.role, fit.weight) == ("fit", "scatter")
    assert (held_out.role, held_out.weight) == ("held-out", 2.5)
    assert (fit.problem.setup.height_mm, held_out.problem.setup.height_mm) == (30.0, 20.0)
    assert fit.measurements.range == Range("percent", 1.0, 20.0)
    assert (fit.problem.setup.test.depth_mm, held_out.problem.setup.test.depth_mm) == (6.0, 4.0)
    assert held_out.problem.setup.test.base == "bonded"


def test_no_calibration_where_constants_are_given():
    start, end = CONICAL.index("[calibration]"), CONICAL.index("[factors]")
    text = CONICAL[:start] + CONICAL[end:]
    fixed = text.replace('model = "neo-hookean"\n', 'model = "neo-hookean"\nC10 = "5 kPa"\n')
    cells = load_module.loads(fixed).treatments
    assert not cells[0].cell.is_calibrated  # neo-Hookean: constants given
    assert cells[-1].cell.is_calibrated
