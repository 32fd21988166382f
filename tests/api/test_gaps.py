"""Cases that fail: what the report says of them, and what an effect is held against."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study import api
from study.ground.contrast import Threshold
from study.harness.design.load import loads
from study.harness.design.spec import ResponseSpec as Response
from study.harness.runner.record_analysis import analyze_records, numerical_bound, without_gaps
from study.harness.runner.study_refinement import CaseSeries
from study.record.record import Record, table
from study.statistics.convergence.contrast_bound import SeriesBounds
from study.statistics.convergence.grid_convergence import NumericalUncertainty
from tests.pages import both_pages
from tests.runner.conftest import DESIGN, make_data

CONSTANTS = {
    'model = "neo-hookean"': 'model = "neo-hookean"\nC10 = "5 kPa"',
    'model = "mooney-rivlin"': 'model = "mooney-rivlin"\nC10 = "4 kPa"\nC01 = "1 kPa"',
    '[[response]]\nname = "mu0"\ntransform = "log"\npractical = "10 % of mean"\n': "",
}
PYTHON = DESIGN + '[calibration]\nmethod = "none"\n[forward]\nmodel = "python"\n'
for old, new in CONSTANTS.items():
    PYTHON = PYTHON.replace(old, new)


def stubborn(problem):
    """A model that knows no bonded plates of a Mooney-Rivlin material."""
    test, material = problem["test"], problem["material"]
    assert isinstance(test, Mapping)
    assert isinstance(material, Mapping)
    if test["interface"] == "bonded" and material["model"] == "mooney-rivlin":
        raise ArithmeticError("no step was found")
    depths = problem["displacement_mm"]
    return [2.0 * float(d) for d in depths]


def hopeless(problem):
    raise ArithmeticError("no step was found")


def run(folder, forward):
    (folder / "small.toml").write_text(PYTHON)
    return api.run(
        folder / "small.toml", data=make_data(folder), results=folder / "results",
        reports=folder / "reports", forward=forward, version="1", jobs=2, refine=False,
    )  # fmt: skip


def test_the_report_says_which_settings_fail_and_blames_no_factor_for_one_cell(tmp_path):
    found = run(tmp_path, stubborn)
    assert found.cases == {"total": 12, "done": 9, "failed": 3, "missing": 0}
    assert found.report is not None
    page = both_pages(found.report)
    assert "Where cases fail: " in page
    assert "mooney-rivlin" in page
    assert "3 of 3; elsewhere 0 of 9." in page
    assert "Causes: 3 failed: ArithmeticError: no step was found." in page
    assert "What fails is the combination of material mooney-rivlin and plates bonded." in page
    assert "differ already by themselves" not in page  # by no more than chance explains
    csv = (found.report.parent / "small-data" / "table-failure-tests.csv").read_text()
    assert csv.startswith("factor,level,failed,cases,p,p_holm,method\n")
    assert "plates,bonded,3,6," in csv
    document = found.to_json()["failures"]
    assert isinstance(document, dict)
    assert document["rules"][0]["settings"] == {"material": "mooney-rivlin", "plates": "bonded"}
    assert document["causes"] == {"failed: ArithmeticError: no step was found": 3}


def test_a_study_in_which_every_case_failed_has_a_report_that_says_so(tmp_path):
    found = run(tmp_path, hopeless)
    assert found.cases["failed"] == 12
    assert found.report is not None, found.warnings
    page = both_pages(found.report)
    assert "Every case failed (12 failed: ArithmeticError: no step was found)" in page
    assert "All 12 cases failed, so there is nothing to compare." in page
    assert "ArithmeticError: no step was found" in page
    assert [warning for warning in found.warnings if "could not be written" in warning] == []


DESIGN = Path(__file__).parents[2] / "designs" / "conical-indentation.toml"


@pytest.fixture(scope="module")
def design():
    return loads(DESIGN.read_text(encoding="utf-8"), "cone.toml")


def rows(design, lost, blocks=3):
    """One row a case; the response is missing where it is ``lost``."""
    names = [f.name for f in design.factors]
    found = []
    for labels in product(*([level.label for level in f.levels] for f in design.factors)):
        levels = dict(zip(names, labels, strict=True))
        for block in range(blocks):
            y = np.nan if lost(levels, block) else 1.0 + block
            found.append({**levels, "block": str(block), "y": y})
    return pd.DataFrame(found)


def quadratic_ogden(levels, _):
    return levels["material"] == "ogden-1" and levels["model.element_order"] == "quadratic"


def ogden_3d(levels):
    return levels["material"] == "ogden-1" and levels["model.space"] == "3d"


def quadratic_3d(levels, _):
    return levels["model.space"] == "3d" and levels["model.element_order"] == "quadratic"


@pytest.mark.parametrize(
    ("lost", "model", "notes"),
    [
        (lambda levels, block: False, 2, []),
        (quadratic_ogden, 1, []),  # main effects alone need no combinations
        (quadratic_3d, 2, []),  # a factor keeps two levels
        # a cell counts that most specimens answer
        (lambda levels, block: levels["material"] == "ogden-1" and block < 1, 2, []),
        (lambda levels, block: levels["material"] == "ogden-1" and block < 2, 2, ["0 of 12"]),
        # half of its cells are compared with those of its siblings
        (quadratic_ogden, 2, []),
        (lambda levels, _: quadratic_ogden(levels, 0) or ogden_3d(levels), 2, ["3 of 12"]),
    ],
)
def test_a_level_that_leaves_a_combination_empty_goes(design, lost, model, notes):
    names = [factor.name for factor in design.factors]
    kept, told = without_gaps(design, rows(design, lost), "y", names, "block", model)
    assert [line.split(" cells")[0] for line in told] == [
        f"ogden-1 (material) has an answer in {share}" for share in notes
    ]
    assert set(kept["material"]) == {*TRUE} - ({"ogden-1"} if notes else set())
    assert kept["y"].notna().all() or not notes


def imported(folder, head, lines, factors, **asked):
    """Study of a table of runs."""
    (folder / "t.csv").write_text("\n".join([head, *lines]))
    return api.import_runs(folder / "t.csv", factors, "y=N", results=folder / "results", **asked)


def test_the_verb_analyze_leaves_out_what_the_report_leaves_out(tmp_path):
    """No run with level c has an answer."""
    cells = product(("a", "b", "c"), ("flat", "full"), range(3))
    lines = [
        f"{m},{s},{'' if m == 'c' else ord(m) - 90 + 0.1 * n + (s == 'full')}" for m, s, n in cells
    ]
    study = imported(tmp_path, "gel,plates,y", lines, "gel,plates", practical="y=1 N")
    reported = study.analyses[0].result
    assert reported is not None, study.analyses[0].refused
    found = api.analyze(study.folder, "y")
    assert "c (gel) has an answer in 0 of 2 cells: it is left out of this analysis" in found.notes
    assert found.effects == reported.effects
    assert found.effect("gel").range == pytest.approx(1.0)


def test_a_level_of_which_half_the_cells_failed_is_compared_where_it_has_answers(tmp_path):
    """It lies 0.3 above its siblings at the order at which it has answers; 0.2 matters."""
    cells = product(("axi", "flat", "full"), ("lin", "quad"), ("fine", "coarse"))
    lines = [
        f"{s},{o},{m},{'' if (s, o) == ('full', 'quad') else 10 + 0.3 * (s == 'full')}"
        for s, o, m in cells
    ]
    study = imported(tmp_path, "space,order,mesh,y", lines, "space,order,mesh", practical="y=.2 N")
    effect = study.analyses[0].result.effect("space")
    assert (effect.verdict, set(effect.levels)) == ("matters", {"axi", "flat", "full"})
    assert effect.range == pytest.approx(0.3)


@pytest.mark.usefixtures("undrawn")
def test_blocks_of_imported_runs_have_the_name_of_their_column_and_a_size_its_option(tmp_path):
    lines = [f"{m},s{n},{ord(m) + n + 0.1 * (n % 3) * (m == 'a')}" for m in "ab" for n in range(6)]
    study = imported(tmp_path, "gel,donor,y", lines, ["gel"], block="donor")
    (sentence,) = (line for line in study.answers if "No smallest difference" in line)
    assert sentence.endswith("Give one with --practical.")
    study = imported(tmp_path, "gel,donor,y", lines, "gel", block="donor", practical="y=0.5 N")
    page = both_pages(api.report(study.folder, reports=tmp_path, formats=["html"]).report)
    assert "Nothing speaks against equal effects in all donors" in page
    assert "6 (donor): s0" in page


# What an effect of a study whose meshes are a factor is held against: known truths.


NAME = "relative_rms_force_error"
#: sizes of the three meshes, by space: ratio 2 in one, 1.5 in the other
SIZES = {
    "axisymmetric": {"coarse": 0.4, "medium": 0.2, "fine": 0.1},
    "3d": {"coarse": 0.45, "medium": 0.3, "fine": 0.2},
}
TRUE = {"neo-hookean": 9.0, "reduced-polynomial-2": 5.0, "mooney-rivlin": 8.0, "ogden-1": 8.5}
ORDER = 2.0
PRACTICAL = Threshold(1.0)


def records_of(design, error, transform="none"):
    """Records of a true value by the material, plus ``error(levels) (h / h_fine)**2``."""
    found = []
    factors = {f.name: [level.label for level in f.levels] for f in design.factors}
    for labels in product(*factors.values()):
        levels = dict(zip(factors, labels, strict=True))
        sizes = SIZES[levels["model.space"]]
        size = sizes[levels["model.mesh"]]
        for k in range(5):
            y = TRUE[levels["material"]] + 0.2 * k + 0.003 * math.sin(17 * len(found))
            y += error(levels) * (size / sizes["fine"]) ** ORDER
            value = math.exp(y) if transform == "log" else y
            found.append(
                Record(
                    f"c{len(found)}", "cone", levels, f"S{k}",
                    responses={NAME: {"value": value, "unit": "%"}},
                    mesh={"mesh_size_mm": size}, input_hash=f"h{len(found)}",
                )
            )  # fmt: skip
    return found


def columns_of(records):
    """What refinement stores of the first block: every column with its own uncertainty."""
    found = {}
    for r in records:
        if r.block == "S0" and r.converged:
            key = tuple((k, v) for k, v in r.levels.items() if k != "model.mesh")
            found.setdefault(key, []).append((r.mesh["mesh_size_mm"], r.response(NAME)))
    rows = []
    for levels, pairs in found.items():
        sizes, values = zip(*sorted(pairs, reverse=True), strict=True)
        known = (None, None, "%", "not available", "")
        if len(values) == 3:
            behaviour, u = CaseSeries((), 1.5, "finest").half_width(values, sizes, ORDER)
            known = (values[-1], u, "%", behaviour, "", sizes, values, ORDER, "known")
        rows.append(NumericalUncertainty(dict(levels), NAME, *known))
    return rows


def analyzed(design, records, transform="none"):
    response = Response(NAME, unit="%", transform=transform)
    numerical = columns_of(records)
    return analyze_records(design, records, response, numerical), numerical


def u_of(result, term):
    u = result.effect(term).u_num
    assert u is not None
    return u


def test_an_error_that_the_materials_share_is_none_of_their_difference(design):
    """The columns are off by percentage points, the difference of the materials by nothing."""
    result, numerical = analyzed(design, records_of(design, lambda levels: 2.0))
    assert max(row.u_num or 0 for row in numerical) > 2.0
    # a tenth of the sum of the columns' own bounds, 1.25 x 2.0 on either side, is never fallen
    # below; the difference's own series would leave 0.02 (scatter between cells of 0.003)
    assert u_of(result, "material") == pytest.approx(0.5, rel=0.05)
    assert result.effect("material").range == pytest.approx(4.0, abs=0.01)
    assert result.effect("material").resolved == "resolved"
    # the mesh itself has no uncertainty
    for effect in result.effects:
        assert (effect.u_num == 0) == ("model.mesh" in effect.term)
    assert result.u_num_by_term


def of_one_material(levels):
    return 0.3 * (levels["material"] == "neo-hookean")


def test_an_error_of_one_material_is_covered_but_not_tenfold(design):
    """Error d h^2 of one material: 1.25 d at the finest mesh, and the way there from the mean."""
    result, _ = analyzed(design, records_of(design, of_one_material))
    # h/h_fine squared is 16, 4, 1 in one space and 5.0625, 2.25, 1 in the other
    mean = 0.3 * (16 + 4 + 1 + 5.0625 + 2.25 + 1) / 6
    effect = result.effect("material")
    assert effect.range == pytest.approx(4.0 + mean, abs=0.02)
    error = (effect.range or 0) - 4.0
    assert error < u_of(result, "material") < 4 * error


def test_a_factor_is_judged_at_each_kind_of_element_with_the_bound_of_its_own_series(design):
    """Linear elements with an error of slow, crooked decay; quadratic ones have almost none."""
    crooked = {"coarse": 2.0, "medium": 0.6, "fine": -0.5}
    records = records_of(design, lambda levels: 0.0)
    for record in records:
        levels = record.levels
        if (levels["material"], levels["model.element_order"]) == ("neo-hookean", "linear"):
            record.responses[NAME]["value"] += crooked[levels["model.mesh"]]
    result = analyze_records(
        design, records, Response(NAME, unit="%", practical=PRACTICAL), columns_of(records)
    )
    effect = result.effect("material")
    by_order = {"linear": [], "quadratic": []}
    for simple in effect.simple_effects:
        assert dict(simple.at)["model.mesh"] == "fine"  # the limit is asked for
        if "neo-hookean" in (simple.first, simple.second):
            assert simple.u is not None
            by_order[dict(simple.at)["model.element_order"]].append(simple.u)
    # no order, so thrice the range of the three meshes would bound it, were it not for the sum
    # of the cells' own bounds
    assert min(by_order["linear"]) > 2.5
    assert max(by_order["quadratic"]) < 0.1
    # the quadratic elements show what the linear ones cannot resolve
    assert effect.verdict == "matters"
    pairs = {e.verdict for e in effect.simple_effects
             if {e.first, e.second} == {"neo-hookean", "mooney-rivlin"}
             and dict(e.at)["model.element_order"] == "linear"}  # fmt: skip
    assert pairs == {"not resolved by the mesh"}


def test_an_error_of_one_space_counts_for_the_space_alone_and_one_of_a_pair_for_both(design):
    result, _ = analyzed(design, records_of(design, lambda levels: levels["model.space"] == "3d"))
    off = (5.0625 + 2.25 + 1) / 3
    assert result.effect("model.space").range == pytest.approx(off, abs=0.01)
    # no space truly differs from the other: the effect must not count as resolved
    assert u_of(result, "model.space") > off
    assert result.effect("model.space").resolved == "not resolved"
    # a tenth of the bounds of the columns in 3D, half the cells on either side
    assert u_of(result, "material") < 0.15

    def error(levels):
        return 0.5 * ((levels["material"], levels["model.space"]) == ("mooney-rivlin", "3d"))

    pair, _ = analyzed(design, records_of(design, error))
    term = "material:model.space"
    assert (pair.effect(term).range or 0) < u_of(pair, term)


def test_a_log_response_is_followed_on_the_log(design):
    """exp(y) on the log is y: the same effect, and the same times its uncertainty."""
    plain, log = (
        analyzed(design, records_of(design, of_one_material, transform), transform)[0]
        for transform in ("none", "log")
    )
    for term in ("material", "model.space"):
        mine, other = log.effect(term), plain.effect(term)
        assert math.log(mine.range or 1) == pytest.approx(other.range)
        assert mine.effect_over_u_num == pytest.approx(other.effect_over_u_num)


def test_a_material_without_a_whole_column_inherits_the_bound_of_the_others(design):
    # every combination of two levels has an answer, but no column of ogden-1 has three meshes
    lost = {("ogden-1", "linear", "fine"), ("ogden-1", "quadratic", "coarse")}
    names = ("material", "model.element_order", "model.mesh")
    records = [
        r
        for r in records_of(design, lambda levels: 2.0)
        if tuple(r.levels[name] for name in names) not in lost
    ]
    result, _ = analyzed(design, records)
    # the other columns share one error of 2.0 at the finest mesh: what scatters is 0.003, and a
    # fifth of their mean bound of 1.25 x 2.0 is added in each of four discretizations
    own = [
        e.u for e in result.effect("material").simple_effects if "ogden-1" in (e.first, e.second)
    ]
    assert own
    assert all(0.5 <= (u or 0) < 0.7 for u in own)


@pytest.mark.parametrize("error", [2.0, 3.0])
def test_a_material_without_the_finest_mesh_is_left_out(design, error):
    """Its mesh error, which may be half as large again, is no effect of a material."""
    records = [
        r
        for r in records_of(design, lambda levels: error if levels["material"] == "ogden-1" else 2)
        if (r.levels["material"], r.levels["model.mesh"]) != ("ogden-1", "fine")
    ]
    result, _ = analyzed(design, records)
    assert any("ogden-1 (material) has an answer in 8 of 12" in w for w in result.notes)
    assert result.effect("material").range == pytest.approx(4.0, abs=0.05)
    assert u_of(result, "material") == pytest.approx(0.5, rel=0.05)


def test_meshes_that_one_column_orders_in_another_way_are_no_series(design):
    """The columns refined in the first block are the series then."""
    records = records_of(design, lambda levels: 2.0)
    rows = columns_of(records)
    first = records[0]
    upset = [Record(first.case_id, "cone", first.levels, first.block, responses=first.responses,
                    mesh={"mesh_size_mm": 0.05}), *records[5:]]  # fmt: skip
    for some, only in ((records, {"model.mesh": "fine"}), (upset, {})):
        found = numerical_bound(design, rows, some, table(list(some)), NAME, "none")
        assert isinstance(found, SeriesBounds)
        assert found.only == only
