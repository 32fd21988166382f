"""Repeats of every cell: their names, their sharing, their noise, and that they resume."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from study.ground.curve import Curve
from study.ground.errors import InputError
from study.harness.design.load import loads
from study.harness.runner.batch import expand, run_batch
from study.harness.runner.study_refinement import refinement_work
from study.mechanics.forward import closed_form
from study.mechanics.material.material import Material
from study.record.record import table
from study.record.store import Store
from study.simulation import fit_task
from study.simulation.cell import Cell, CellProblem
from study.simulation.job import FitJob, FitResult, fit_problem
from study.simulation.tasks import Costs

from .conftest import DESIGN, SPECIMEN, compressed, fake, make_data

MESHES, NOISE = "\n[replicates]\nmesh_seeds = 5\n", "\n[replicates]\nnoise = 20\n"
DEPTHS = np.linspace(0.3, 6.0, 100)
TRUTH = Material("neo-hookean", {"C10": 8e-3}, poisson_ratio=0.4995)
EXACT = closed_form.homogeneous(SPECIMEN, TRUTH, DEPTHS).force_N


def run(work, folder):
    store = Store(folder)
    run_batch(work, store, fake())
    return store.records(work.input_hashes)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    home = tmp_path_factory.mktemp("noise")
    data = make_data(home, ("M1",))
    work = expand(loads(DESIGN + NOISE), data)
    return home, work, run(work, home / "results")


def test_noise_adds_refits_to_the_study_and_changes_no_name_of_it(noisy):
    home, work, records = noisy
    alone = expand(loads(DESIGN), home / "data")
    # 4 cells in one block, each with 20 more; 8 fits (two specimens), each with 20 more
    assert len(work.jobs) == 4 * 21
    assert len(work.fits) == 8 * 21
    assert work.plain().input_hashes == alone.input_hashes
    assert len(work.input_hashes) == len(work.jobs)
    frame = table(records)
    assert frame["noise_seed"].value_counts().to_dict() == dict.fromkeys(range(21), 4)
    assert set(frame["status"]) == {"converged"}
    again = frame[frame["noise_seed"] > 0]
    assert again["mu0"].notna().all()
    assert again["relative_rms_force_error"].isna().all()  # nothing is predicted
    assert frame.loc[frame["noise_seed"] == 0, "relative_rms_force_error"].notna().all()
    one = next(r for r in records if r.extra.get("noise_seed") == 3)
    assert not one.curves
    assert one.fit["A"]["resampling"][0]["block"] >= 1


def test_exact_data_have_next_to_no_noise_and_misfit_counts_as_noise(noisy):
    frame = table(noisy[2])
    again = frame[(frame["noise_seed"] > 0) & (frame["plates"] == "frictionless")]
    spread = again.groupby("material")["mu0"].agg(lambda v: v.std() / v.mean())
    # Mooney-Rivlin data: its own fit leaves the ten decimals of the file, the other a misfit
    assert spread["mooney-rivlin"] < 1e-6
    assert 1e-4 < spread["neo-hookean"] < 0.1


def test_replicates_resume(noisy):
    home, work, records = noisy
    shutil.copytree(home / "results", home / "resumed")
    store = Store(home / "resumed")
    gone = [r.case_id for r in records if r.extra.get("noise_seed") in (4, 5)]
    for name in gone:
        shutil.rmtree(home / "resumed" / "cases" / name)
    lost = sorted((home / "resumed" / "fits").iterdir())[::40]
    for path in lost:
        path.unlink()
    assert run_batch(work, store, fake()) == 8
    again = {r.case_id: r.responses for r in store.records(work.input_hashes)}
    assert again == {r.case_id: r.responses for r in records}


def test_another_seed_of_the_study_is_another_noise(noisy):
    home, work, _ = noisy
    text = DESIGN.replace('name = "small"', 'name = "small"\nseed = 1') + NOISE
    other = expand(loads(text), home / "data")
    same = set(other.input_hashes.values()) & set(work.input_hashes.values())
    assert same == set(work.plain().input_hashes.values())


def test_mesh_seeds_make_cases_whose_meshes_differ(one_mix):
    work = expand(loads(DESIGN + MESHES), one_mix)
    assert len(work.jobs) == len(work.input_hashes) == 4 * 5
    assert [job.origin.mesh_seed for job in work.jobs] == 4 * [1, 2, 3, 4, 5]
    seeds = {job.case.tested.model.mesh_seed for job in work.jobs}
    assert len(seeds) == 20  # meshes of two cells have nothing to do with each other
    # a fit on a mesh is one of its own, one without a mesh is shared by all
    plates = {f: len({tuple(fit.key for fit in j.fits) for j in work.jobs
                      if j.case.levels["plates"] == f})
              for f in ("bonded", "frictionless")}  # fmt: skip
    assert plates == {"bonded": 10, "frictionless": 2}
    assert [job.origin.mesh_seed for job in work.plain().jobs] == 4 * [1]
    again = expand(loads(DESIGN + MESHES), one_mix)
    assert again.input_hashes == work.input_hashes


def test_the_refined_mesh_keeps_its_seed_and_one_cell_of_a_kind_is_refined(one_mix):
    work = expand(loads(DESIGN + MESHES), one_mix)
    finer = refinement_work(work.plain())
    bases = {job.origin.of for job in finer.jobs}
    assert len(bases) == len({job.origin.of for job in refinement_work(
        expand(loads(DESIGN), one_mix)).jobs})  # fmt: skip
    known = {job.case.case_id: job for job in work.jobs}
    for job in finer.jobs:
        base = known[job.origin.of].case.tested.model
        assert job.case.tested.model.mesh_seed == base.mesh_seed


def test_too_many_replicates_are_refused(one_mix, monkeypatch):
    monkeypatch.setattr("study.harness.runner.batch.MAX_CASES", 50)
    with pytest.raises(InputError, match="84 cases with their replicates are more than 50"):
        expand(loads(DESIGN + NOISE), one_mix)


def test_a_refit_is_cheap_in_a_plan(one_mix):
    work, costs = expand(loads(DESIGN + NOISE), one_mix), Costs()
    again = [costs.case_seconds(job) for job in work.jobs if job.origin.noise_seed]
    assert max(again) < 0.1


def fitted(model, order, seed, poisson_ratio=0.4995):
    config = compressed(model, "frictionless", order, poisson_ratio=poisson_ratio)
    noise_N = 0.02 * np.random.default_rng(seed).standard_normal(DEPTHS.size)  # noqa: N806
    problem = fit_problem(Cell(CellProblem.of(config), "auto"))
    measured = Curve(DEPTHS, EXACT + noise_N)
    return problem, measured, fit_task.fitted(FitJob(problem, (measured,)))


def refit(task):
    found = fit_task.refitted(task)
    assert found.converged
    return found.fit


def standard_error(found, name):
    error = found.fit["standard_error"][name]
    assert error is not None
    return error


@pytest.mark.parametrize(("model", "order"), [("neo-hookean", None), ("reduced-polynomial", 2)])
def test_the_scatter_of_refits_is_the_standard_error_of_the_fit(model, order):
    problem, measured, base = fitted(model, order, seed=1)
    found = [refit(FitJob(problem, (measured,), base, (2011, k))) for k in range(1, 121)]
    assert all(f["resampling"][0]["block"] == 1 for f in found)  # independent noise is seen so
    for name in base.fit["names"]:
        values = np.array([f["values"][name] for f in found])
        ratio = values.std(ddof=1) / standard_error(base, name)
        # sd of 120: 1/sqrt(240) = 6.5 %; three of them. Both rest on one residual variance
        assert ratio == pytest.approx(1, abs=0.2)
        # and their mean is the fit: sd/sqrt(120) = 0.09 of a standard error
        assert abs(values.mean() - base.constants[name]) < 0.27 * standard_error(base, name)


def test_cells_fitted_to_one_curve_see_the_same_noise():
    tasks = []
    for poisson_ratio in (0.4995, 0.49):
        problem, measured, base = fitted("neo-hookean", None, 1, poisson_ratio)
        tasks.append((FitJob(problem, (measured,), base), base))
    both = np.array(
        [
            [refit(replace(task, noise=(2011, k)))["mu0"] / base.fit["mu0"] for k in range(1, 31)]
            for task, base in tasks
        ]
    )
    # nearly the same model fitted to the same noise: independent draws give r = 0 +- 0.18
    assert np.corrcoef(both)[0, 1] > 0.9


def test_correlated_noise_is_drawn_in_blocks_and_scatters_more():
    problem, measured, _ = fitted("neo-hookean", None, seed=1)
    random = np.random.default_rng(5)
    drift = np.zeros(DEPTHS.size)
    for i in range(1, DEPTHS.size):
        drift[i] = 0.8 * drift[i - 1] + random.standard_normal()
    measured = Curve(DEPTHS, EXACT + 0.02 * drift)
    base = fit_task.fitted(FitJob(problem, (measured,)))
    found = [refit(FitJob(problem, (measured,), base, (2011, k))) for k in range(1, 101)]
    block = found[0]["resampling"][0]["block"]
    assert 5 < block <= 30
    # independent points: the force is of first degree in C10
    slope = EXACT / 8e-3
    independent = np.sqrt(base.fit["rss"] / (DEPTHS.size - 1) / (slope @ slope))
    scatter = np.std([f["values"]["C10"] for f in found], ddof=1)
    # for an AR(1) of 0.8 the mean of many scatters by sqrt(1.8 / 0.2) = 3 more, of which blocks
    # of a tenth of the curve see a part
    assert 1.5 < scatter / independent < 3.5
    # the fit itself allows for a correlation that it does not know
    assert standard_error(base, "C10") > scatter


def test_a_fit_that_failed_is_not_resampled():
    problem, measured, _ = fitted("neo-hookean", None, seed=1)
    failed = FitResult("not-converged", {"message": "too stiff"})
    task = FitJob(problem, (measured,), failed, (2011, 1))
    found = fit_task.refitted(task)
    assert found.status == "not-converged"
    assert "too stiff" in found.message


def test_block_length_follows_the_correlation():
    assert fit_task.block_length(-0.5, 100) == fit_task.block_length(0.19, 100) == 1
    lengths = [fit_task.block_length(rho, 200) for rho in (0.3, 0.5, 0.7, 0.9, 0.999)]
    # by hand at 0.5: cbrt(6 * 0.25 / 0.5625 * 200) = 8.11
    assert lengths[1] == 8
    assert lengths == sorted(lengths)
    assert lengths[-1] == 43  # ceil(3 sqrt(200)), their upper bound
