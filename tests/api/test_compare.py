"""Two studies beside each other, cells that must agree, tests that are one family."""

import json
from types import SimpleNamespace

import pytest
from statsmodels.stats.multitest import multipletests

from study import api
from study.api import assemble
from study.api.comparison import compare
from study.ground.errors import InputError
from study.harness.design.load import load
from study.harness.runner.batch import read_truths
from study.reporting.content import comparison_content
from study.reporting.results import study_answers
from tests.api.made import made
from tests.conftest import ROOT


def row(beside, term):
    return next(row for row in beside.conclusions if row.term == term)


def beside(folder, first=None, **second):
    """Compare two studies that are made."""
    return compare(made(folder, **(first or {})), made(folder, **{"name": "second"} | second))


def test_conclusions_that_hold_under_both(tmp_path):
    found = compare(made(tmp_path), made(tmp_path, name="second", material=(5.0, 7.5, 5.1)))
    material, space = row(found, "material"), row(found, "space")
    assert (material.conclusion, material.holds) == (study_answers.MATTERS, True)
    assert (space.conclusion, space.holds) == (study_answers.NO_DIFFERENCE, True)
    # the means are made: 7.0 - 5.0 and 7.5 - 5.0; 12 values each with a deviation of 0.02
    assert material.effects[0].range == pytest.approx(2.0, abs=0.05)
    assert material.effects[1].range == pytest.approx(2.5, abs=0.05)
    assert material.best == ("soft", "soft")
    said = comparison_content.summary(found)
    assert said[0] == "Of 2 conclusions about single factors, 2 hold under both first and second."


def test_each_number_is_that_of_its_own_study(tmp_path):
    studies = made(tmp_path), made(tmp_path, name="second", noise=0.05, practical="0.4 pp")
    found = compare(*studies)
    for which, study in enumerate(studies):
        for row_ in found.conclusions:
            effect = study.analyses[0].result.effect(row_.term)
            one = row_.effects[which]
            assert (one.strength, one.range, one.p) == (effect.strength, effect.range, effect.p)
            assert (one.low, one.high) == effect.ci95
            assert one.practical == effect.practical
    assert "the smallest difference that matters is not the same in both" in found.warnings[0]


@pytest.mark.parametrize(
    ("first", "second", "holds", "same_best", "conclusion"),
    [
        # matters in one only
        ({}, {"material": (5.0, 5.1, 5.05)}, False, True,
         "differs: matters under first; no practical difference under second"),
        # the other way round
        ({}, {"material": (7.0, 5.0, 7.0)}, False, False,
         "differs: matters in both, but the lowest is with soft under first and stiff under"),
        # "other" leads by 0.1 pp in the second study, where 0.5 pp matters
        ({}, {"material": (5.1, 7.0, 5.0)}, True, True, study_answers.MATTERS),
        ({}, {"noise": 3.0}, None, None, study_answers.ONE_CANNOT_TELL),
        ({"noise": 3.0}, {"noise": 3.0}, None, None, study_answers.NONE_CAN_TELL),
    ],
)  # fmt: skip
def test_a_conclusion_of_both(tmp_path, first, second, holds, same_best, conclusion):
    material = row(beside(tmp_path, first, **second), "material")
    assert material.holds is holds
    assert same_best is None or material.same_best is same_best
    assert material.conclusion.startswith(conclusion)


def test_ratios_are_compared_as_ratios(tmp_path):
    log = {"transform": "log", "practical": "10 % of mean", "better": "", "response": "mu0"}
    material = row(beside(tmp_path, log, **log), "material")
    assert material.ratio
    assert material.effects[0].range == pytest.approx(7.0 / 5.0, rel=0.02)
    # without a better end the highest level is named, and nothing is called best
    assert material.end == "highest"
    assert material.best[0] == "stiff"


def test_what_only_one_study_has_is_named(tmp_path):
    found = beside(tmp_path, rename={"space": "plates", "other": "third"})
    named = {(item.what, item.name, item.study) for item in found.only}
    assert named >= {
        ("factor", "space", "first"), ("factor", "plates", "second"),
        ("term", "material:space", "first"), ("term", "material:plates", "second"),
        ("level", "material = other", "first"), ("level", "material = third", "second"),
    }  # fmt: skip
    assert [item.term for item in found.conclusions] == ["material"]
    said = " ".join(comparison_content.only_lines(found))
    assert "Only in first: level material = other." in said


def test_differing_inputs_are_listed(tmp_path):
    found = beside(
        tmp_path, height="31 mm", practical="0.4 pp", files={"a.csv": "1" * 64},
        versions={"study": "2"}, virtual=True, truths={"a.csv": {"generator": {"truth": "ogden"}}},
    )  # fmt: skip
    assert {c.key: (c.kind, c.values) for c in found.changes} == {
        "specimen.height": ("design", ("30 mm", "31 mm")),
        "response.relative_rms_force_error.practical": ("design", ("0.5 pp", "0.4 pp")),
        "sha256 of a.csv": ("measurements", ("0" * 12, "1" * 12)),
        "kind": ("measurements", ("measured", "virtual specimens")),
        "truth of the specimens": ("truth", ("measured, not generated", "of virtual specimens")),
        "version of study": ("code", ("1", "2")),
    }
    first, second = (
        {"virtual": True, "truths": {"a.csv": {"generator": {"truth": truth, "seed": 2011}}}}
        for truth in ("yeoh", "ogden")
    )
    (change,) = beside(tmp_path, first, **second).changes  # key by key
    assert (change.key, change.values) == ("truth.generator.truth", ("yeoh", "ogden"))


def test_truths_are_read_from_beside_the_measurements(tmp_path):
    (tmp_path / "a.csv.virtual.json").write_text('{"generator": {"seed": 7}}')
    found = read_truths(tmp_path, {"a.csv": "0" * 64, "b.csv": "1" * 64})
    assert found == {"a.csv": {"generator": {"seed": 7}}}


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"response": "rms_force_error"}, r"(?s)no analyzed response.*rms_force_error.*share a \["),
        ({"rename": {"space": "plates", "material": "energy"}}, "with a factor in common"),
        ({"name": "first"}, "same study"),
    ],
)
def test_nothing_in_common_or_itself_is_refused_with_the_mend(tmp_path, other, said):
    with pytest.raises(InputError, match=said):
        beside(tmp_path, **other)


def test_studies_of_one_name_are_told_apart_by_their_folders(tmp_path):
    found = compare(made(tmp_path / "a"), made(tmp_path / "b"))
    assert found.names[0] != found.names[1]
    assert str(tmp_path / "b") in found.names[1]


def test_the_document_is_plain_json(tmp_path):
    found = compare(made(tmp_path), made(tmp_path, name="second", noise=3.0)).to_json()
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert set(found) == {"summary", "changes", "conclusions", "only_in_one"}
    first = found["conclusions"][0]
    assert set(first) >= {"response", "factor", "conclusion", "holds", "same_best", "found"}
    assert set(first["found"][0]) >= {
        "verdict", "effect", "ci95", "p", "u_num", "effect_over_u_num", "practical", "best",
    }  # fmt: skip


# Cells that must agree: how far they may differ.


@pytest.mark.parametrize(
    ("difference", "u_steps", "outcome"),
    [
        (0.0, None, "pass"),
        (5e-6, None, "pass"),
        (5e-5, None, "fail"),
        # both curves say that their interpolation between load steps may be off by this much
        (5e-5, 3e-5, "pass"),
        (5e-5, 1e-5, "fail"),
    ],
)
def test_they_may_differ_by_solver_and_interpolation(monkeypatch, difference, u_steps, outcome):
    cells = [SimpleNamespace(levels={"space": space}) for space in ("axisymmetric", "3d")]
    monkeypatch.setattr(assemble, "equivalent_groups", lambda _: [cells])

    def record(space, value):
        response = {"value": value, "unit": "N", "u_steps": u_steps}
        return SimpleNamespace(
            levels={"space": space}, block="1", converged=True,
            responses={"rms_force_error": response}, value=lambda _: value,
        )  # fmt: skip

    records = (record("axisymmetric", 1.0), record("3d", 1.0 + difference))
    (check,) = assemble._controls(SimpleNamespace(), records)
    assert check.outcome == outcome


# Families of tests, through the study that declares them.


RANGES = str(ROOT / "designs" / "ecoflex-range.toml")


def p_of(folder, data_dir, *overrides):
    found = api.run(RANGES, data=data_dir, results=folder, jobs=1, overrides=list(overrides))
    return found.verdicts


@pytest.mark.slow
def test_all_responses_of_a_study_are_one_family(tmp_path, data_dir):
    if not (data_dir / "ecoflex_compression").is_dir():
        pytest.skip("the Ecoflex measurements are not in the data folder (set STUDY_DATA)")
    rows = p_of(tmp_path, data_dir, 'analysis.family="study"')
    expected = multipletests([row["p"] for row in rows], method="holm")[1]
    assert [row["p_holm"] for row in rows] == pytest.approx(expected)
    primary = p_of(tmp_path, data_dir, 'analysis.primary=["material"]')
    for row in primary:
        assert row["p_holm"] == (row["p"] if row["factor"] == "material" else None)


@pytest.mark.parametrize(
    ("override", "rule"),
    [
        ('analysis.family="world"', "world"),
        ('analysis.primary=["plates"]', "no factor 'plates'"),
        ('analysis.primary=["material","range","material:range","a"]', "at most 3"),
    ],
)
def test_a_wrong_family_is_named(override, rule):
    with pytest.raises(InputError, match=rule):
        load(RANGES, overrides=[override])
