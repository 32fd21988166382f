"""Table ``[design]``: which cells are run, what they can tell, and what is refused."""

from pathlib import Path

import pytest

from study.api.study import load_design
from study.ground.errors import InputError
from study.harness.design import overview, spec
from study.harness.design.load import dump, loads
from study.harness.design.overview import calibration_factors, inert_cells
from tests.design.faulty import BASE

DESIGNS = Path(__file__).parents[2] / "designs"
TWO = """
[factors]
model.space = ["axisymmetric", "3d"]
test.interface = ["frictionless", "bonded"]
model.element_order = ["linear", "quadratic"]
specimen.height = { low = "28 mm", high = "32 mm" }
"""
RANGES = """
[factors]
specimen.height = { low = "28 mm", high = "32 mm" }
specimen.radius = { low = "2.4 cm", high = "2.6 cm" }
material.poisson_ratio = { low = 0.49, high = 0.499 }
"""
HALF = 'kind = "fractional"\ngenerators = ["specimen.height = -model.space:test.interface"]\n'


def load(factors, table="", more=""):
    return loads(f"{BASE}{factors}[design]\n{table}{more}", "x.toml")


def faults(factors, table, more=""):
    with pytest.raises(InputError) as caught:
        load(factors, table, more)
    return {f.where.removeprefix("x.toml: "): f"{f.rule} | {f.mend}" for f in caught.value.faults}


def test_a_range_has_two_levels_in_a_factorial():
    study = load(TWO)
    assert len(study.treatments) == 16
    assert study.factors[-1].labels == ("28 mm", "32 mm")
    heights = {cell.cell.document()["specimen"]["height_mm"] for cell in study.treatments}
    assert heights == {28.0, 32.0}
    assert study.scheme.rows is None


def test_a_fraction_says_what_it_cannot_tell():
    study = load(TWO, HALF)
    cells = study.treatments
    assert len(cells) == 8
    sign = {"axisymmetric": -1, "3d": 1, "frictionless": -1, "bonded": 1, "28 mm": -1, "32 mm": 1}
    for cell in cells:
        level = {name: sign.get(label, 0) for name, label in cell.levels.items()}
        product = level["model.space"] * level["test.interface"]
        assert level["specimen.height"] == -product
    found = overview.overview(study).to_json()["scheme"]
    assert found["resolution"] == 3
    assert found["defining_relation"] == "I = -model.space:test.interface:specimen.height"
    assert "8 of 16 cells, resolution III, verified over all 15 products" in found["summary"]
    assert (
        "the effect of model.space cannot be told from the interaction of test.interface and "
        "specimen.height" in found["aliases"]
    )


@pytest.mark.parametrize(("resolution", "model"), [(3, 1), (4, 1)])
def test_the_model_has_the_terms_that_are_clear(resolution, model):
    study = load(TWO, f'kind = "fractional"\nresolution = {resolution}\n')
    assert study.scheme.resolution == resolution
    assert study.analysis.model == model


HALF_OF_16 = 'kind = "fractional"\nresolution = 4\n'


def test_two_aliases_are_refused_and_one_of_them_is_analyzed():
    # I = ABCD: AB = CD
    pairs = "model.space:model.element_order", "test.interface:specimen.height"
    both = f"[analysis]\nmodel = {list(pairs)}\n"
    assert (
        "2 terms, of which 8 cells tell 1 apart" in faults(TWO, HALF_OF_16, both)["analysis.model"]
    )
    alone = load(TWO, HALF_OF_16, f'[analysis]\nmodel = ["model.space", "{pairs[0]}"]\n')
    assert alone.analysis.model == ("model.space", "model.space:model.element_order")


@pytest.mark.parametrize(
    ("factors", "table", "cells"),
    [
        (TWO, HALF, 8),
        (TWO, 'kind = "plackett-burman"', 8),
        (RANGES, 'kind = "central-composite"', 15),
        (RANGES, 'kind = "central-composite"\nstar = "faced"', 15),
        (RANGES, 'kind = "box-behnken"', 13),
        (RANGES, 'kind = "latin-hypercube"\nruns = 12', 12),
        (RANGES, 'kind = "sobol"\nruns = 16', 16),
        (TWO, 'kind = "sobol"\nruns = 16', 16),
        (RANGES, 'kind = "morris"\ntrajectories = 4', 16),
        (TWO, 'zip = [["model.space", "test.interface"]]', 8),
    ],
)
def test_every_kind_loads_again_from_its_dump(factors, table, cells):
    study = load(factors, table)
    assert len(study.treatments) == cells
    again = loads(dump(study))
    assert again == study
    assert [c.case_id for c in spec.cases(again)] == [c.case_id for c in spec.cases(study)]
    assert len({c.case_id for c in spec.cases(study)}) == cells


def test_response_surfaces_stay_in_their_ranges():
    for kind in ("central-composite", "box-behnken"):
        for cell in load(RANGES, f'kind = "{kind}"').treatments:
            assert 28 <= cell.cell.document()["specimen"]["height_mm"] <= 32
            assert 24 <= cell.cell.document()["specimen"]["radius_mm"] <= 26
            assert 0.49 <= cell.cell.document()["material"]["poisson_ratio"] <= 0.499
    center = load(RANGES, 'kind = "box-behnken"')
    labels = [cell.label for cell in center.treatments]
    assert labels.count("30 mm / 2.5 cm / 0.4945") == 1


def test_draws_follow_the_seed():
    def cells(table, more=""):
        study = load(RANGES, f'kind = "latin-hypercube"\nruns = 8\n{table}', more)
        return [cell.label for cell in study.treatments]

    assert cells("") == cells("", "[study]\nseed = 2011\n")
    assert cells("") != cells("", "[study]\nseed = 7\n")
    assert cells("seed = 7\n") == cells("", "[study]\nseed = 7\n")


def test_zipped_factors_change_together():
    study = load(TWO, 'zip = ["model.space", "test.interface"]')
    pairs = {(c.levels["model.space"], c.levels["test.interface"]) for c in study.treatments}
    assert pairs == {("axisymmetric", "frictionless"), ("3d", "bonded")}
    terms = study.analysis.model
    assert isinstance(terms, tuple)
    # one name stands for both
    assert not any("test.interface" in term for term in terms)
    assert "nothing tells their effects apart" in study.scheme.aliases[0]


NESTED = """
[factors]
model.space = ["axisymmetric", "3d"]
model.mesh_size = ["4 mm", "5 mm", "6 mm", "7 mm"]
test.interface = ["frictionless", "bonded"]
[[design.nested]]
factor = "model.mesh_size"
within = "model.space"
levels = { axisymmetric = ["4 mm", "5 mm"], 3d = ["6 mm", "7 mm"] }
"""


def test_nested_levels_exist_in_one_level_of_their_parent():
    text = BASE.replace('mesh = "coarse"\n', "") + NESTED
    study = loads(text)
    cells = {(c.levels["model.space"], c.levels["model.mesh_size"]) for c in study.treatments}
    assert cells == {
        ("axisymmetric", "4 mm"), ("axisymmetric", "5 mm"), ("3d", "6 mm"), ("3d", "7 mm"),
    }  # fmt: skip
    assert len(study.treatments) == 8
    # a nested factor stands only beside its parent (Montgomery, chapter 14)
    assert study.analysis.model == (
        "model.space", "test.interface", "model.space:model.mesh_size",
        "model.space:test.interface", "model.space:model.mesh_size:test.interface",
    )  # fmt: skip


def test_listed_cells_are_those_and_no_others():
    rows = """kind = "listed"
treatments = [
  { model.space = "3d", test.interface = "bonded" },
  { model.space = "axisymmetric", test.interface = "bonded" },
  { model.space = "axisymmetric", test.interface = "frictionless" },
]
"""
    factors = "\n".join(TWO.splitlines()[:4]) + "\n"
    labels = [cell.label for cell in load(factors, rows).treatments]
    assert labels == ["3d / bonded", "axisymmetric / bonded", "axisymmetric / frictionless"]


def test_what_a_factor_can_do_is_asked_of_cells_that_are_not_run():
    # of a fraction no two cells differ in one factor only, yet the space matters where bonded
    text = BASE.replace('C10 = "5 kPa"\n', "").replace("seconds", "mu0") + TWO
    text += """
[measurements]
file = "a.csv"
columns = { displacement = "d", force = "f" }
units = { displacement = "mm", force = "N" }
"""
    half = 'generators = ["specimen.height = model.space:test.interface:model.element_order"]'
    whole = loads(text)
    part = loads(f'{text}[design]\nkind = "fractional"\n{half}')
    assert calibration_factors(part) == calibration_factors(whole)
    assert inert_cells(whole, "model.space") == 8
    assert inert_cells(part, "model.space") == 4
    assert inert_cells(part, "specimen.height") == 0


def test_a_sampled_range_is_compared_at_its_ends(monkeypatch):
    made = []
    resolve = spec.resolve

    def counted(*tables):
        made.append(1)
        return resolve(*tables)

    design = load_design(DESIGNS / "needle-geometry.toml")
    monkeypatch.setattr(spec, "resolve", counted)
    described = overview.overview(design)
    assert all(not one.calibrates and one.inert_cells == 0 for one in described.factors)
    # compared at each of their 120 levels, 7 factors made 87,000 cells
    assert len(made) <= 2 * len(design.treatments) * len(design.factors)


@pytest.mark.parametrize(
    ("key", "kind", "count", "says"),
    [
        ("mesh_seeds", "mesh-seeds", 5, ("5 meshes", "(E3)")),
        ("noise", "noise", 200, ("200 times", "(E2)")),
    ],
)
def test_replicates_are_described_dumped_and_overridden(key, kind, count, says):
    text = (DESIGNS / "ecoflex-compression.toml").read_text()
    assert overview.replication(loads(text)) is None
    study = loads(f"{text}\n[replicates]\n{key} = {count}\n")
    assert loads(dump(study)).replicates == study.replicates
    described = overview.overview(study).to_json()["replicates"]
    assert (described["kind"], described["count"]) == (kind, count)
    assert all(part in described["sentence"] for part in says)
    changed = loads(dump(study), overrides=[f"replicates.{key}={2 * count}"])
    assert getattr(changed.replicates, key) == 2 * count
