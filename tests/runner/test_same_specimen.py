"""The thesis's central claim: three tests of one specimen give the same constants."""

from pathlib import Path

import numpy as np
import pytest

from study.harness.design import load
from study.harness.runner.batch import expand
from study.mechanics.calibration.lack_of_fit import agreement
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.simulation import fit_task
from study.simulation.fit_task import FitPart as Part
from study.simulation.fit_task import StagedSearch, staged_fit
from study.simulation.virtual_specimens import TRUTHS, Generator, write_virtual

DESIGN = Path(__file__).parents[2] / "designs" / "same-specimen.toml"
WAYS = ["lubricated-compression", "bonded-compression", "flat-indentation"]


def test_the_design_plans_three_tests_of_every_specimen(tmp_path, monkeypatch):
    """One file a test, the same factors of every specimen in each, and no shared fit."""
    from study.ground.curve import Curve
    from study.simulation import virtual_specimens

    def line(setup, *truth, as_designed, **_):
        assert as_designed
        d = np.linspace(0.3, 6.3, 21)
        stiff = 2.0 if setup.test.kind == "compression" else 0.5
        return Curve(d, stiff * d, force_gradient={"C20": 0 * d, "C30": 0 * d})

    monkeypatch.setattr(virtual_specimens, "reference_curve", line)
    loaded = load.load(DESIGN)
    write_virtual(loaded, tmp_path, Generator(noise_N=0.0, batches=3))
    work = expand(loaded, tmp_path)
    assert len(work.jobs) == 9
    assert [job.case.levels["way"] for job in work.jobs if job.case.block == "1"] == WAYS
    assert len({job.directions[0].fit_key for job in work.jobs}) == 9
    slopes = {
        (job.case.block, job.case.levels["way"]): job.directions[0].measured.force_N[-1]
        / job.directions[0].measured.displacement_mm[-1]
        for job in work.jobs
    }
    for block in "123":
        ratio = slopes[block, WAYS[0]] / slopes[block, WAYS[2]]
        assert ratio == pytest.approx(4.0, rel=1e-4)  # the same stiffness factor in both files
    assert slopes["1", WAYS[0]] != pytest.approx(slopes["2", WAYS[0]], rel=1e-3)


def test_the_calibration_reads_the_same_files():
    found = load.load_calibration(DESIGN.with_name("one-material.toml"))
    assert found.fitting.leave_out == "test"
    files = [test.file for test in found.tests]
    assert files == [f"same-specimen/{way}.csv" for way in WAYS]


def _fit(work, way, block):
    job = next(j for j in work.jobs if j.case.block == block and j.case.levels["way"] == way)
    return _done(work, work.fits[job.directions[0].fit_key or ""])


def _done(work, job):
    start = None if job.start is None else _done(work, job.start).constants()
    (way,) = job.problem.tests
    names, first = fit_task.start_values(way.problem, job.measured, start)
    data = tuple(MeasuredCurve("virtual", curve) for curve in job.measured)
    search = StagedSearch(names)
    found = staged_fit([Part(way.method, way.problem, data)], first, search).fit
    assert found.converged, found.message
    return found


@pytest.mark.slow
def test_three_tests_agree_within_their_joint_intervals(tmp_path):
    """Data of a mesh finer than the fit's; what the mesh moves counts as uncertainty."""
    loaded = load.load(DESIGN)
    write_virtual(loaded, tmp_path, Generator(seed=loaded.seed, batches=1))
    fine = expand(loaded, tmp_path)
    medium = expand(load.load(DESIGN, ["model.mesh=medium"]), tmp_path)
    found = [_fit(fine, way, "1") for way in WAYS]
    moved = [
        (one.values - _fit(medium, way, "1").values) / (1.5 - 1)
        for one, way in zip(found, WAYS, strict=True)
    ]
    # first order at the corners: what is left of the error is the last change over r - 1
    plain, joint = agreement(found), agreement(found, [np.outer(m, m) for m in moved])
    for way, one, shift in zip(WAYS, found, moved, strict=True):
        pairs = zip(one.names, one.values, one.standard_error, shift, strict=True)
        words = ", ".join(f"{n} {1e3 * v:.4f} +- {1e3 * s:.4f} (mesh {1e3 * m:+.4f})"
                          for n, v, s, m in pairs)  # fmt: skip
        print(f"\n{way}: {words} kPa", end="")
    print(f"\nsame constants: p = {plain.p:.3g}; with the mesh's error {joint.p:.3g}")
    assert joint.p > 0.05
    # mu0 = 2 C10 agrees to a percent in all tests, whatever the intervals
    c10 = np.array([one.values[0] for one in found])
    assert np.ptp(c10) / c10.mean() < 0.01
    assert c10.mean() == pytest.approx(
        TRUTHS["yeoh"].constants["C10"], rel=0.15
    )  # of its factor's scatter
