"""Cells, cases, names made of content, keys that may vary and levels laid over a file."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.ground.declaration import keys_of, written_keys
from study.ground.errors import InputError
from study.harness.design import load, overview, spec
from study.mechanics.material.material import ENERGIES
from study.simulation import cell as content
from study.simulation import problem_file
from study.statistics.surfaces.surface_factors import NumericFactor
from tests.design import faulty


@pytest.mark.parametrize("name", problem_file.PLACES)
def test_keys_that_rule_exclude_or_vary_are_declared(name):
    place = problem_file.PLACES[name]
    declared = {key for kind in place.sections for key in written_keys(kind)}
    assert {*place.varying, *place.alternatives, place.ruling} - {""} <= declared
    assert all(problem_file.may_vary(f"{name}.{key}") for key in place.keys)


@pytest.mark.parametrize("name", [name for name in problem_file.PLACES if name != "measurements"])
def test_a_key_has_the_dimension_of_its_declaration(name):
    # keys of several tables share a name, such as the radius of a specimen and of an indenter
    for kind in problem_file.PLACES[name].sections:
        for key in keys_of(kind):
            if problem_file.may_vary(f"{name}.{key.written}"):
                said = key.reads.dimension if key.reads is not None else ""
                assert problem_file.dimension_of(f"{name}.{key.written}") == (said or None), (
                    key.written
                )


@pytest.mark.parametrize("energy", ENERGIES.values(), ids=list(ENERGIES))
def test_constants_of_every_energy_may_vary_and_take_the_place_of_others(energy):
    keys = energy.list_keys or energy.constant_names(1)
    for key in keys:
        assert problem_file.may_vary(f"material.{key}")
        plain = energy.is_dimensionless(key)
        assert problem_file.dimension_of(f"material.{key}") == ("number" if plain else "pressure")
    laid = problem_file.lay(
        {"material": {"model": "another", **dict.fromkeys(keys, 1), "no_constant": 1}},
        {"material.model": energy.name},
    )
    assert set(laid["material"]) == {"model", "no_constant", *keys}
    for other in ENERGIES.values():
        left = problem_file.lay(laid, {"material.model": other.name})["material"]
        assert all(other.has_key(key) for key in keys if key in left)


BASE = faulty.BASE.replace('"bonded"', '"frictionless"')
SPACES = '[factors]\nmodel.space = ["axisymmetric", "3d"]\n'


def test_quoted_and_unquoted_keys_are_one():
    quoted = BASE + '[factors]\n"model.space" = ["axisymmetric", "3d"]\n'
    assert load.loads(BASE + SPACES) == load.loads(quoted)


def test_ids_ignore_names_and_see_values():
    def ids(text):
        return [case.case_id for case in spec.cases(load.loads(text))]

    text = BASE + SPACES
    named = text + '[study]\nname = "other"\nquestion = "why?"\nseed = 7\n# a comment\n'
    assert ids(text) == ids(named)
    assert ids(text) == ids(text.replace('"25 mm"', '"2.5 cm"'))
    assert ids(text) == ids(text.replace('"5 kPa"', '"0.005 MPa"'))
    assert ids(text) == ids(text.replace('"frictionless"', '"lubricated"'))
    assert ids(text) == ids(text + "[analysis]\nalpha = 0.01\n")
    assert set(ids(text)).isdisjoint(ids(text.replace('"25 mm"', '"25.1 mm"')))
    assert set(ids(text)).isdisjoint(ids(text.replace('mesh = "coarse"', 'mesh = "fine"')))
    assert all(len(i) == 16 and set(i) <= set("0123456789abcdef") for i in ids(text))


@given(st.integers(-(2**52), 2**52))
def test_whole_numbers_have_one_name(value):
    assert content.case_id({"a": value}) == content.case_id({"a": float(value)})


def test_nan_has_no_name():
    with pytest.raises(InputError):
        content.case_id({"a": float("nan")})


def test_cases_are_cells_in_blocks():
    study = load.loads(BASE + SPACES)
    found = spec.cases(study, ("A", "B", "C"))
    assert len(found) == 6
    assert len({case.case_id for case in found}) == 6
    assert found[0].label == "axisymmetric / A"
    assert [case.block for case in spec.cases(study)] == [None, None]
    with pytest.raises(InputError, match="distinct"):
        spec.cases(study, ("A", "A"))


def test_exclusions_say_why():
    text = BASE + (
        '[factors]\nmodel.space = ["axisymmetric", "3d"]\n'
        'model.mesh = ["coarse", "medium", "fine"]\n'
        '[[exclude]]\nwhen = { model.space = "3d", model.mesh = ["medium", "fine"] }\n'
        'why = "too large"\n'
    )
    study = load.loads(text)
    assert [cell.label for cell in study.treatments] == [
        "axisymmetric / coarse",
        "axisymmetric / medium",
        "axisymmetric / fine",
        "3d / coarse",
    ]
    assert [(cell.label, why) for cell, why in study.excluded] == [
        ("3d / medium", "too large"),
        ("3d / fine", "too large"),
    ]
    assert load.loads(load.dump(study)) == study


def test_an_impossible_cell_may_be_excluded():
    text = BASE + (
        "[presets.bulk.exact]\nmaterial.incompressible = true\n"
        "[presets.bulk.near]\nmaterial.poisson_ratio = 0.499\n"
        '[factors]\nbulk = ["exact", "near"]\nmodel.formulation = ["mixed", "displacement"]\n'
    )
    with pytest.raises(InputError, match="displacement formulation cannot hold"):
        load.loads(text)
    left_out = '[[exclude]]\nwhen = { bulk = "exact", model.formulation = "displacement" }\n'
    study = load.loads(text + left_out + 'why = "locks"\n')
    assert len(study.treatments) == 3


def test_duplicates_are_reported():
    text = BASE + '[factors]\nmodel.mesh_size = ["10 mm", "1 cm", "5 mm"]\n'
    study = load.loads(text)
    (group,) = study.duplicates
    assert [cell.label for cell in group] == ["10 mm", "1 cm"]
    assert any("no replicates: 10 mm = 1 cm" in line for line in overview.warnings(study))


def test_a_preset_of_a_table_is_laid_over_it():
    text = BASE + (
        '[presets.material.soft]\nC10 = "1 kPa"\n'
        '[presets.material.ogden]\nmodel = "ogden"\nmu = ["5 kPa"]\nalpha = [3]\n'
        '[factors]\nmaterial = ["soft", "ogden"]\n'
    )
    soft, ogden = load.loads(text).treatments
    assert soft.cell.document()["material"]["constants"] == {"C10": 0.001}
    assert soft.cell.document()["material"]["poisson_ratio"] == 0.4995
    assert ogden.cell.document()["material"]["constants"] == {"mu1": 0.005, "alpha1": 3.0}


def test_indenters_as_presets():
    text = BASE.replace('"compression"', '"indentation"') + (
        '[presets.tip.cone]\ntest.indenter = { shape = "cone", half_angle = "30 deg" }\n'
        '[presets.tip.ball]\ntest.indenter = { shape = "sphere", radius = "5 mm" }\n'
        '[factors]\ntip = ["cone", "ball"]\n'
    )
    base = text.replace("[material]", 'indenter = { shape = "flat", radius = "5 mm" }\n[material]')
    for source in (text, base):
        cone, ball = load.loads(source).treatments
        assert cone.cell.document()["test"]["indenter"] == {
            "shape": "cone",
            "half_angle_deg": 30.0,
            "tip_radius_mm": 0.0,
            "shaft_radius_mm": None,
        }
        assert ball.cell.document()["test"]["indenter"] == {"shape": "sphere", "radius_mm": 5.0}


@pytest.mark.parametrize(
    ("override", "section", "key", "value"),
    [
        ('model.mesh_size="2 mm"', "model", "mesh_size_mm", 2.0),
        ("model.mesh_size=2 mm", "model", "mesh_size_mm", 2.0),
        ("test.steps=5", "test", "steps", 5),
        ("test.displacement=3 mm", "test", "displacement_mm", 3.0),
        ("material.C10=1 kPa", "material", "constants", {"C10": 0.001}),
    ],
)
def test_overrides(override, section, key, value):
    text = BASE.replace("[model]\nmesh", "[model]\nelement_order = 'linear'\n# mesh") + SPACES
    study = load.loads(text, overrides=[override])
    for cell in study.treatments:
        assert cell.cell.document()[section][key] == value
        assert key != "mesh_size_mm" or "mesh" not in cell.cell.document()[section]


def test_levels_and_lists_can_be_overridden():
    overrides = ['factors.model.space=["3d", "axisymmetric"]', "response.0.transform=log"]
    study = load.loads(BASE + SPACES, overrides=overrides)
    assert study.factors[0].labels == ("3d", "axisymmetric")
    assert study.responses[0].transform == "log"


RANGED = (
    BASE + '[factors]\nmaterial.C10 = { low = "1 kPa", high = "2 kPa", scale = "log" }\n'
    'specimen.radius = { low = "9 mm", high = "11 mm" }\n[design]\nkind = "latin-hypercube"\n'
    'runs = 12\n[uncertainty]\nmaterial.C10 = { distribution = "uniform", low = "1.1 kPa", '
    'high = "1.9 kPa" }\n'
)


def test_a_range_and_a_distribution_can_be_overridden_in_part_and_whole():
    def span(*overrides):
        return load.loads(RANGED, overrides=overrides).factors[0].span

    whole = 'factors.material.C10={ low = "1.1 kPa", high = "4 kPa" }'
    levels = 'factors.material.C10=["1 kPa", "2 kPa"]', "uncertainty.material.C10=0.1 kPa"
    assert span(whole) == NumericFactor("material.C10", 1.1, 4.0, unit="kPa")
    assert span("factors.material.C10.low=1.1 kPa") == NumericFactor(
        "material.C10", 1.1, 2.0, log=True, unit="kPa"
    )
    assert span(*levels) is None
    assert span(*levels, whole) is not None
    normal = '{ distribution = "normal", mean = "1.5 kPa", sd = "0.1 kPa" }'
    changed = load.loads(RANGED, overrides=[f"uncertainty.material.C10={normal}"])
    assert changed.inputs["material.C10"].kind == "normal"


PRESET = BASE + (
    "[presets.bulk.a]\nmaterial.poisson_ratio = 0.49\n"
    '[presets.bulk.b]\nmaterial.poisson_ratio = 0.499\n[factors]\nbulk = ["a", "b"]\n'
)


@pytest.mark.parametrize(
    ("text", "override"),
    [(RANGED, "material.C10=1.5 kPa"), (PRESET, "material.poisson_ratio=0.3")],
)
def test_an_override_that_a_level_hides_is_refused(text, override):
    with pytest.raises(InputError, match="would hide this"):
        load.loads(text, overrides=[override])


@pytest.mark.parametrize(
    "override",
    ["model.space=3d", "nonsense", "=3", "a b=3", "response.7.name=mu0", "schema.x=1", "model.x=1"],
)
def test_bad_overrides(override):
    with pytest.raises(InputError):
        load.loads(BASE + SPACES, overrides=[override])
