"""Any bytes, any damage, any name: a clean InputError or a valid object (P24, P25)."""

import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from study.ground.declaration import dump_toml, parse_toml
from study.ground.errors import InputError
from study.harness.design import spec
from study.harness.design.load import CALIBRATION, dump, loads, loads_problem
from tests.design.faulty import FOLDER

DESIGN = (Path(__file__).parents[2] / "designs" / "ecoflex-compression.toml").read_text()
SMALL = """
schema = 1
specimen = { shape = "cylinder", radius = "25 mm", height = "30 mm" }
test = { kind = "compression", interface = "bonded", displacement = "3 mm" }
material = { model = "neo-hookean", C10 = "5 kPa", poisson_ratio = 0.45 }
"""
LOADERS = (loads, loads_problem, CALIBRATION.loads)
quick = settings(suppress_health_check=[HealthCheck.too_slow])


def survives(text):
    for load in LOADERS:
        try:
            load(text, "x.toml")
        except InputError as error:
            told = str(error)
        else:
            told = "a valid object"
        assert told


@quick
@given(st.binary(max_size=300))
def test_any_bytes(raw):
    survives(raw)


@quick
@given(st.binary(max_size=8), st.integers(0, len(DESIGN)), st.integers(0, 40))
def test_a_damaged_design(patch, at, cut):
    raw = DESIGN.encode()
    survives(raw[:at] + patch + raw[at + cut :])


VALUES = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=8)
    ),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


def paths(node, at=()):
    items = enumerate(node) if isinstance(node, list) else ()
    items = node.items() if isinstance(node, dict) else items
    return [at] * bool(at) + [path for k, v in items for path in paths(v, (*at, k))]


WHERE = paths(parse_toml(DESIGN, "x"))


def without_none(value):
    if isinstance(value, dict):
        return {k: without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, list):
        return [without_none(v) for v in value if v is not None]
    return value


@quick
@given(st.sampled_from(WHERE), VALUES)
def test_any_value_at_any_key(path, value):
    tables = parse_toml(DESIGN, "x")
    node = tables
    for part in path[:-1]:
        node = node[part]
    if value is None:
        del node[path[-1]]
    else:
        node[path[-1]] = without_none(value)
    survives(dump_toml(tables))


@quick
@given(st.dictionaries(st.text(max_size=6), VALUES, max_size=4))
def test_dumped_tables_are_read_back(tables):
    plain = without_none(tables)
    assert isinstance(plain, dict)
    text = dump_toml(plain)
    try:
        again = parse_toml(text, "x")
    except InputError as error:
        assert "64 bits" in str(error) or "deep" in str(error)  # noqa: PT017
        return
    # by their text, for nan; the order of keys is not kept where tables follow values
    assert json.dumps(again, sort_keys=True) == json.dumps(plain, sort_keys=True)


def test_the_slowest_file_that_the_caps_let_through():
    key = ".".join("ab" * 15)
    survives("\n".join(f"{key}.k{i} = 1" for i in range(3800)))
    survives("\n".join(f"k{i}.{key} = 1" for i in range(3700)))


#: names that no table, page or CSV file can hold, and others that only look dangerous
REFUSED = (
    *("=cmd|' /C calc'!A0", "+1+1", "-1+1", "@SUM(A1)", "\u202egnp.exe", "\ufeffx"),
    *("a\x00b", "a\nb", "a\tb", "x" * 10_000, "", "  "),
)
HARMLESS = (
    *("<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "$\\frac{1}{0}$"),
    *("'); import os; os.system('x')", "../../x", "{{ 7*7 }}", "${HOME}", "Q('a') + C(b)"),
    *("__class__", "NUL"),
)
CORPUS = (*REFUSED, *HARMLESS)
toml = json.dumps


@pytest.mark.parametrize("name", CORPUS)
def test_names_of_levels_and_of_factors(name):
    for factor, level in (("set", name), (name, "a")):
        presets = "".join(
            f"[presets.{toml(factor)}.{toml(label)}]\ntest.steps = {steps}\n"
            for label, steps in ((level, 5), ("b", 7))
        )
        factors = f'[factors]\n{toml(factor)} = [{toml(level)}, "b"]\n'
        text = f'{SMALL}{presets}{factors}[[response]]\nname = "seconds"\n'
        if name in REFUSED:
            with pytest.raises(InputError):
                loads(text)
            continue
        study = loads(text)
        (read,) = study.factors
        assert (read.name, read.labels) == (factor, (level, "b"))  # who draws it escapes it
        assert loads(dump(study)) == study
        assert all(set(c.case_id) <= set("0123456789abcdef") for c in spec.cases(study))


@pytest.mark.parametrize("name", CORPUS)
def test_names_of_studies_are_folder_names(name):
    text = DESIGN.replace('"ecoflex-compression"', toml(name))
    if name in ("__class__", "NUL"):
        assert loads(text).name == name
        return
    with pytest.raises(InputError):
        loads(text)


@pytest.mark.parametrize("name", CORPUS)
def test_names_elsewhere_never_run(name):
    few_cells = (FOLDER / "design.toml").read_text(encoding="utf-8")
    for old in ('"II"', '"mu0"', '"phantom"', '"force_N"', '"auto"', '"cylinder"', '"B"'):
        assert old in few_cells
        survives(few_cells.replace(old, toml(name), 1))
    survives(few_cells.replace("[specimen]", f"[{toml(name)}]", 1))
    survives(few_cells.replace("[model]", f"[model]\n{toml(name)} = 1", 1))
