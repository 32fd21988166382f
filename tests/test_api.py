"""The functions of ``import study``: what a notebook does in three lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import study
from study import api
from study.api.folders import data_root
from study.ground.errors import InputError, RefusedError
from tests.cli.small import DESIGN, write_files


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("api")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def outcome(home: Path) -> api.study.StudyResult:
    return study.run(
        home / "small.toml", data=home / "data", jobs=1, results=home / "results", reports=None
    )


def test_run_gives_every_number_without_a_report(outcome: api.study.StudyResult) -> None:
    assert outcome.report is None
    assert len(outcome.table) == outcome.total == 12
    assert outcome.failed == 0
    assert {row["factor"] for row in outcome.verdicts} >= {"material", "range"}


def test_running_again_computes_nothing(home: Path, outcome: api.study.StudyResult) -> None:
    cases = home / "results" / "small" / "cases"
    before = {p: p.stat().st_mtime_ns for p in cases.rglob("*")}
    steps: list[object] = []
    again = study.run(
        home / "small.toml", data=home / "data", jobs=2, results=home / "results", reports=None,
        progress=steps.append,
    )  # fmt: skip
    assert steps == []
    assert {p: p.stat().st_mtime_ns for p in cases.rglob("*")} == before
    pd.testing.assert_frame_equal(again.table, outcome.table)
    # what was measured of the first run is kept
    assert again.manifest["timings"] == outcome.manifest["timings"]


def test_a_loaded_design_is_the_same_study(home: Path, outcome: api.study.StudyResult) -> None:
    design = study.load_design(home / "small.toml")
    plan = api.plan(design, data=home / "data", results=home / "results")
    assert (plan.cases["total"], plan.cases["missing"], plan.fits) == (12, 0, 0)
    other = api.plan(
        home / "small.toml", data=home / "data", results=home / "results",
        overrides=["measurements.points=31"],
    )  # fmt: skip
    assert other.cases["missing"] == 12


def test_analyze_a_study_and_a_table_agree(home: Path, outcome: api.study.StudyResult) -> None:
    own = study.analyze(home / "results" / "small", "work_error")
    named = study.analyze(outcome.folder, "work_error", ["material", "range"])
    assert own.to_json() == named.to_json()
    assert own.anova.row("range").df == 1


def test_analyze_a_frame() -> None:
    noise = np.random.default_rng(5).normal(0, 0.1, 12)
    frame = pd.DataFrame(
        {
            "material": ["A", "B"] * 6,
            "space": [s for s in ("x", "y", "z") for _ in range(4)],
            "force": [1.0, 3.0] * 6 + noise,
        }
    )
    found = study.analyze(frame, "force", ["material", "space"])
    assert found.anova.row("material").p < 1e-6
    with pytest.raises(InputError, match="did you mean 'force'"):
        study.analyze(frame, "forse", ["material"])
    with pytest.raises(InputError, match="--factors"):
        study.analyze(frame, "force")


def test_fake_replicates_are_refused() -> None:
    frame = pd.DataFrame({"material": list("AAABBB"), "force": [1.0] * 3 + [2.0] * 3})
    with pytest.raises(RefusedError, match="fake replicates"):
        study.analyze(frame, "force", ["material"])


def test_the_numbers_of_the_readme() -> None:
    table = study.grid_convergence(sizes=[1, 2, 4], values=[0.97050, 0.96854, 0.96178])
    # NASA's tutorial on grid convergence
    assert table.observed_order == pytest.approx(1.786170, abs=1e-6)


def test_solve_a_file_a_mapping_and_a_problem(home: Path) -> None:
    from study.harness.design.load import load_problem

    problem = load_problem(home / "problem.toml").problem
    forces = [
        study.solve(given, gradients=False).curve.force_N[-1]
        for given in (home / "problem.toml", problem.document(), problem.at())
    ]
    # 2 C10 (1/l^2 - l) on the area of the cylinder at stretch 0.9
    exact = 2 * 0.01 * (0.9**-2 - 0.9) * np.pi * 100
    assert forces == pytest.approx([exact] * 3, rel=1e-9)


def test_solve_refuses_an_unstable_material(home: Path) -> None:
    # C20 = -3 C10 softens before the stretch that the test reaches
    given = ['material.model="reduced-polynomial"', 'material.C20="-30 kPa"']
    with pytest.raises(InputError, match="material"):
        study.solve(home / "problem.toml", overrides=[*given, 'test.displacement="4 mm"'])


def test_calibrate_gives_numbers_with_their_errors(home: Path) -> None:
    found = study.calibrate(home / "calibration.toml", data=home / "data").to_json()
    assert found["parameters"]["C10"]["value"] == pytest.approx(8.0, rel=2e-3)


def test_why_finds_a_case_by_its_beginning(home: Path, outcome: api.study.StudyResult) -> None:
    record = outcome.records[0]
    found = api.explain(record.case_id[:10], results=home / "results").record
    assert found.case_id == record.case_id
    ids = [r.case_id for r in outcome.records]
    first = next(a for a in "0123456789abcdef" if sum(i[0] == a for i in ids) > 1)
    with pytest.raises(InputError, match="begins several ids"):
        api.explain(first, results=home / "results")


def test_data_stand_in_the_named_folder_else_beside_the_design(tmp_path: Path) -> None:
    (tmp_path / "designs").mkdir()
    source = tmp_path / "designs" / "x.toml"
    assert data_root(source) == source.parent
    (tmp_path / "measurements").mkdir()
    assert data_root(source) == tmp_path / "measurements"
    assert data_root(source, tmp_path) == tmp_path
    with pytest.raises(InputError, match="no folder"):
        data_root(source, tmp_path / "nowhere")


def test_a_design_without_measurements_is_no_study(tmp_path: Path) -> None:
    start, end = DESIGN.index("[measurements]"), DESIGN.index("[calibration]")
    text = DESIGN[:start] + DESIGN[end:]
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(InputError):
        study.run(tmp_path / "x.toml", results=tmp_path / "results")
    assert not (tmp_path / "results").exists()
