"""Effects over less of the test: the curves are kept, so no simulation is needed."""

from dataclasses import replace

import numpy as np
import pytest

import study
from study.harness.runner.record_analysis import effects_by_depth, effects_of_records
from study.statistics.convergence.grid_convergence import NumericalUncertainty
from tests.cli.small import DESIGN, write_files
from tests.reporting.example import build


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    home = tmp_path_factory.mktemp("depths")
    write_files(home)
    text = DESIGN.replace('range = ["small", "large"]\n', "")
    text = text[: text.index("[presets.range.small]")] + text[text.index("[measurements]") :]
    text = text.replace("points = 30", 'points = 30\nrange = ["1 %", "20 %"]')
    (home / "one.toml").write_text(text)
    return study.run(
        home / "one.toml", data=home / "data", jobs=1, results=home / "results", reports=None
    )


def depths_of(study):
    return effects_by_depth(study.design, study.records, study.numerical)


def error(measured, predicted, depth_mm):
    d = measured.displacement_mm
    inside = d <= depth_mm * (1 + 1e-9)
    force = measured.force_N[inside]
    apart = predicted.force_at(d[inside]) - force
    return float(100 * np.sqrt(np.mean(apart**2) / np.mean(force**2)))


def test_whole_depth_is_the_study_itself(outcome):
    (own,) = [v for v in outcome.verdicts if v["factor"] == "material"]
    row = depths_of(outcome)[-1]
    assert row.effect.term == "material"
    assert row.depth_mm == pytest.approx(6.0)
    assert row.effect.range == pytest.approx(own["effect"], rel=1e-12)


def test_half_the_depth_scores_half_the_curve(outcome):
    (row,) = [r for r in depths_of(outcome) if r.depth_mm == pytest.approx(3.0)]
    means = {
        level: np.mean(
            [
                error(*r.first_pair(), 3.0)
                for r in outcome.records
                if r.levels["material"] == level
                for label in [r.scores[0]["score"]]
            ]
        )
        for level in ("neo-hookean", "mooney-rivlin")
    }
    assert row.effect.range == pytest.approx(max(means.values()) - min(means.values()), rel=1e-9)
    assert row.effect.highest == max(means, key=lambda level: means[level])


@pytest.mark.drawings
def test_the_page_draws_it(outcome):
    from study.api.assemble import report_data

    data = replace(report_data(outcome), depths=depths_of(outcome))
    page = build(data)
    assert "Effects against the depth of the test" in page
    assert "f-relative-rms-force-error-depth" in page
    assert "was not drawn" not in page
    assert "Effects against the depth of the test" not in build(replace(data, depths=()))


def test_verdicts_are_held_against_the_numerical_uncertainty(outcome, monkeypatch):
    (response,) = outcome.design.responses
    rough = NumericalUncertainty({}, response.name, 10.0, 50.0, "%", "two meshes", "a rough mesh",
                      mesh_size=(2.0, 1.0), series=(10.0, 60.0))  # fmt: skip
    problem = type(outcome.design.treatments[0].cell.problem)
    monkeypatch.setattr(problem, "is_homogeneous", False)
    found = []

    def noted(*given):
        effects = effects_of_records(*given)
        found.extend(e.u_num for e in effects if e.is_main)
        return effects

    monkeypatch.setattr("study.harness.runner.record_analysis.effects_of_records", noted)
    effects_by_depth(outcome.design, outcome.records, (rough,))
    # an order of .7 and a factor of 3 bound the finer mesh, whose distance is 50; a cell that was
    # not refined is taken to be at most three times as far off, on either side of a difference
    of_one = 3 * 50 / (2**0.7 - 1) + 50
    assert found == pytest.approx([3 * 2 * of_one] * 4)
