"""Many cases with a fake solver: sharing, resuming, failing, and F01, F08, F13, F34, F37."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import study
from study.cli.output import progress_line
from study.execution.local import Loky
from study.ground.errors import StoreError
from study.harness.design.load import loads
from study.harness.runner import batch
from study.harness.runner.batch import Progress, expand, in_phase, run_batch
from study.mechanics.forward.closed_form import homogeneous
from study.record.record import table
from study.record.store import Store
from study.simulation import provenance

from . import fake_worker
from .conftest import DESIGN, SPECIMEN, TRUTH, fake, make_data, material


def run(work, folder, executor=None):
    store = Store(folder)
    computed = run_batch(work, store, executor or fake())
    return computed, store.records(work.input_hashes)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """One undisturbed run, for the tests that only read it."""
    home = tmp_path_factory.mktemp("clean")
    work = expand(loads(DESIGN, "small.toml"), make_data(home))
    computed, records = run(work, home / "results")
    return work, home / "results", computed, records


def value(records, name, **levels):
    """Response of a cell by block."""
    return {
        str(r.block): r.response(name)
        for r in records
        if all(r.levels[k] == v for k, v in levels.items())
    }


def test_every_case_becomes_a_record_and_fits_are_shared(clean):
    work, folder, computed, records = clean
    # 2 materials x 2 plates x 3 mixes; a fit for each with each of two specimens
    assert len(work.jobs) == 12
    assert len(work.fits) == 24
    assert (computed, len(list((folder / "fits").iterdir()))) == (12, 24)
    assert {r.status for r in records} == {"converged"}


def test_constants_and_scores_are_those_of_the_data(clean):
    records = clean[-1]
    found = value(records, "mu0", material="mooney-rivlin", plates="frictionless")
    for mix, mu0 in found.items():
        # exact data of the same energy: mu0 = 2 (C10 + C01), averaged over the two
        # specimens; the file holds ten decimals, which leaves some 1e-6 of ill condition
        expected = 1e3 * np.mean([2 * sum(TRUTH[mix, s]) for s in "AB"])
        assert mu0 == pytest.approx(expected, rel=1e-4)
    errors = value(
        records, "relative_rms_force_error", material="mooney-rivlin", plates="frictionless"
    )
    for mix, error in errors.items():
        # with exact constants each specimen's curve is the prediction of the other's
        assert error == pytest.approx(_cross_error(mix), rel=1e-4)


def _cross_error(mix):
    d = np.linspace(0.3, 6.0, 50)
    a, b = (homogeneous(SPECIMEN, material(*TRUTH[mix, s]), d).force_N for s in "AB")
    difference = np.sqrt(np.mean((a - b) ** 2))
    return float(50 * (difference / np.sqrt(np.mean(a**2)) + difference / np.sqrt(np.mean(b**2))))


def test_bonded_constants_are_softer_by_the_factor_of_the_fake_solver(clean):
    records = clean[-1]
    free = value(records, "mu0", material="neo-hookean", plates="frictionless")
    bonded = value(records, "mu0", material="neo-hookean", plates="bonded")
    for mix in free:
        # the spline between ten solved steps costs some 1e-5
        assert free[mix] / bonded[mix] == pytest.approx(1.4 * 1.00417, rel=1e-3)


def test_table_does_not_depend_on_the_number_of_workers(clean, tmp_path):
    two = run(clean[0], tmp_path / "results", Loky(fake_worker.perform, 2))[1]
    assert comparable(two) == comparable(clean[-1])


def comparable(records):
    frame = table(records).drop(columns=["seconds"])
    return str(frame.to_json(double_precision=15))


@pytest.mark.parametrize(
    ("wish", "status", "words"),
    [
        ("mooney-rivlin", "not-converged", "no answer"),
        ("mooney-rivlin die", "crashed", "signal 9"),
        ("mooney-rivlin bug", "failed", "a bug in the solver"),
    ],
)
def test_a_failure_is_a_record_and_stops_nothing_else(
    one_mix, tmp_path, monkeypatch, wish, status, words
):
    (tmp_path / "wish").write_text(wish)
    monkeypatch.setenv("FAKE_WISH", str(tmp_path / "wish"))
    # one direction, and death between bonded plates alone
    work = expand(loads(DESIGN.replace("swap = true", ""), "small.toml"), one_mix)
    _, records = run(work, tmp_path / "results")
    bad = [r for r in records if not r.converged]
    # every Mooney-Rivlin case meets the solver: bonded in its fit, frictionless when predicted
    assert {r.levels["material"] for r in bad} == {"mooney-rivlin"}
    assert len(bad) == 2
    assert any(r.status == status for r in bad)
    assert any(words in r.message for r in bad), {r.message for r in bad}
    assert all(entry["value"] is None for r in bad for entry in r.responses.values())
    frame = table(records)
    assert frame["mu0"].isna().sum() == 2
    assert sorted(os.listdir(tmp_path / "results" / "cases")) == sorted(work.input_hashes)
    # a crash is tried again by the next run, an answer of the solver is not
    (tmp_path / "wish").unlink()
    again, records = run(work, tmp_path / "results")
    assert again == (1 if status == "crashed" else 0)
    assert sum(r.converged for r in records) == 2 + again


def test_records_of_other_code_are_not_used(clean, monkeypatch):
    for module in ("harness.runner.batch", "simulation.job"):
        monkeypatch.setattr(f"study.{module}.code_version", lambda: "another")
    other = expand(clean[0].design, clean[0].data.root)
    store = Store(clean[1])
    assert len(batch.missing(other, store)) == 12
    assert "another version" in store.warnings[0]


def test_the_kept_code_version_follows_the_sources(tmp_path, monkeypatch):
    """A version kept on the disk is that of the sources, or it is made anew."""
    root = tmp_path / "study"
    shutil.copytree(Path(study.__file__).parent, root, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(provenance, "__file__", str(root / "simulation" / "provenance.py"))
    # a task that imports little: the sources of the real ones take seconds to read
    monkeypatch.setattr(provenance, "_TASKS", ("study.ground.curve",))
    version = provenance.code_version.__wrapped__
    first = version()
    assert (root / "__pycache__" / "code-version").is_file()
    assert version() == first
    curve = root / "ground" / "curve.py"
    spoken = (
        curve.read_text(encoding="utf-8").replace('"""', '"""Another word. ', 1) + "\n# really\n"
    )
    curve.write_text(spoken, encoding="utf-8")
    assert version() == first
    curve.write_text(f"{spoken}\nSCALE = 2.0\n", encoding="utf-8")
    assert version() != first


def test_a_second_runner_is_refused(design, data, tmp_path):
    store = Store(tmp_path / "results")
    with store.lock(), pytest.raises(StoreError, match="pid"):
        run(expand(design, data), tmp_path / "results")


def test_progress_ends_at_the_total_and_time_left_at_zero(design, one_mix, tmp_path):
    seen = []
    store = Store(tmp_path / "results")
    run_batch(expand(design, one_mix), store, fake(), seen.append)
    assert [p.done for p in seen] == list(range(1, 13))
    assert seen[-1].total == 12
    assert seen[-1].seconds_left == pytest.approx(0.0, abs=1e-6)


def test_the_time_left_follows_the_work_and_not_the_number_of_computations():
    """Long ones come first: after 3 of 4 hours, and 1 of 11 computations, an hour is left."""
    state = Progress(1, 11, 0, 3 * 3600.0, "the long one", share=0.75)
    assert state.seconds_left == pytest.approx(3600.0)
    assert Progress(1, 1000, 0, 60.0, "a quick one", share=0.001).seconds_left is None


def test_what_is_computed_after_the_cases_has_its_name(capsys):
    with progress_line() as line:
        first = Progress(1, 180, 0, 60.0, "plates bonded", 1, 108, share=0.01)
        in_phase(line, "finer meshes")(first)
    assert (
        capsys.readouterr().err == "finer meshes: 0/72 cases, 1/108 calibrations: plates bonded\n"
    )


def test_code_version_follows_what_the_tasks_import():
    """A list of names would miss the next file; reports must not send a study back to work."""
    root = Path(study.__file__).parent
    files = {str(path.relative_to(root)) for path, _ in provenance._numeric_files(root)}
    needed = {
        "ground/curve.py",
        "simulation/response.py",
        "simulation/fit_task.py",
        "mechanics/element/assembly.py",
        "mechanics/forward/closed_form.py",
        "mechanics/forward/finite_element.py",
        "mechanics/material/homogeneous.py",
    }
    assert needed <= files
    assert not any(name.startswith(("reporting", "statistics", "api", "cli")) for name in files)
