"""Bad input: every fault at once, each with its key, rule and mend; before anything is computed.

What is wrong with keys stands in ``faulty_files``; here is what no change of a key shows.
"""

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
from study.simulation import plausibility

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
