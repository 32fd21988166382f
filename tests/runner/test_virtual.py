"""Virtual specimens: their scatter is as said; three tests of one give the same constants."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.ground.curve import Curve
from study.ground.errors import InputError
from study.harness.design import load
from study.harness.design.load import demo_design
from study.harness.runner.batch import expand
from study.mechanics.calibration.lack_of_fit import agreement
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.forward import finite_element
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material
from study.mechanics.measurement.measurement_section import MeasurementSpec, read_range
from study.mechanics.measurement.reading import read_measurements
from study.simulation import fit_task, virtual_specimens
from study.simulation.cell import CellProblem
from study.simulation.fit_task import FitPart as Part
from study.simulation.fit_task import StagedSearch, staged_fit
from study.simulation.problem_file import Virtual
from study.simulation.virtual_specimens import (
    TRUTHS,
    Generator,
    _csv,
    _files,
    generate,
    reference_curve,
    truth,
    write_virtual,
)

D = np.linspace(0.1, 6.2, 62)
REFERENCE = Curve(D, 4 * D, None, {"C20": D**3, "C30": D**5})
SPEC = MeasurementSpec(
    file="v.csv", columns={"displacement": "x", "force": "f"},
    units={"displacement": "mm", "force": "N"}, block="batch", average=("repeat",),
    fit={"specimen": "A"}, score={"specimen": "B"},
)  # fmt: skip


def drawn(**changes):
    return list(generate(REFERENCE, Generator(**changes), SPEC))


def test_groups_are_those_that_the_design_reads_and_the_seed_decides_everything():
    found = drawn(batches=2, repeats=3, seed=1)
    assert len(found) == 2 * 2 * 3
    assert found[0].groups == {"batch": "1", "specimen": "A", "repeat": "1"}
    assert found[-1].groups == {"batch": "2", "specimen": "B", "repeat": "3"}
    assert np.array_equal(found[0].force_N, drawn(batches=2, repeats=3, seed=1)[0].force_N)
    assert not np.array_equal(found[0].force_N, drawn(batches=2, repeats=3, seed=2)[0].force_N)


def test_stiffness_scatters_as_declared():
    found = drawn(batches=400, repeats=1, specimen_sd=0.0, shape_sd=0.0, noise_N=0.0)
    factors = np.log([t.force_N[-1] / (4 * t.displacement_mm[-1]) for t in found[::2]])
    # standard error of a standard deviation of 400 values: 3.5 %
    assert factors.std(ddof=1) == pytest.approx(0.06, rel=0.12)
    assert factors.mean() == pytest.approx(0.0, abs=0.01)


def test_shapes_scatter_between_the_specimens_of_a_batch_where_they_were_measured_to(monkeypatch):
    """Force 4 d and a change of d^3 for each unit of the shape: twice the declared .05."""
    kept = {"specimen_sd": 0.0, "noise_N": 0.0, "batch_sd": 0.0, "batches": 400, "repeats": 1}
    same = drawn(**kept)
    assert np.array_equal(same[0].force_N, same[1].force_N)
    monkeypatch.setitem(TRUTHS, "yeoh", replace(TRUTHS["yeoh"], specimen_sd=0.05))
    found = drawn(**kept)
    apart = [
        np.abs(b.force_N - a.force_N).max() for a, b in zip(found[::2], found[1::2], strict=True)
    ]
    assert min(apart) > 0
    between = [t.force_N[-1] for t in drawn(**kept, shape_sd=0.05)[::2]]
    # the shapes of two specimens differ by the square root of two standard deviations
    alone = [b.force_N[-1] - a.force_N[-1] for a, b in zip(found[::2], found[1::2], strict=True)]
    assert np.std(alone) == pytest.approx(np.std(between), rel=0.12)


def test_shape_scatter_follows_the_gradient():
    found = drawn(batches=1, repeats=1, batch_sd=0.0, specimen_sd=0.0, noise_N=0.0)
    d, extra = found[0].displacement_mm, found[0].force_N - 4 * found[0].displacement_mm
    columns = np.column_stack([d**3, d**5])
    rest = extra - columns @ np.linalg.lstsq(columns, extra, rcond=None)[0]
    assert np.abs(rest).max() < 1e-6 * np.abs(extra).max()  # spline through 62 points


def test_files_follow_a_pattern_and_units_and_sign():
    spec = MeasurementSpec(
        files="c-{batch}-{specimen}.csv", columns=SPEC.columns, block="batch", fit=SPEC.fit,
        score=SPEC.score, units={"displacement": "m", "force": "kN"}, sign="negative",
    )  # fmt: skip
    quiet = Generator(batches=2, batch_sd=0, specimen_sd=0, shape_sd=0, noise_N=0)
    written = _files(spec, list(generate(REFERENCE, quiet, spec)))
    assert set(written) == {f"c-{b}-{s}.csv" for b in "12" for s in "AB"}
    header, *rows = written["c-1-A.csv"].splitlines()
    assert header == "x,f"
    d, f = map(float, rows[-1].split(","))
    assert (d, f) == (pytest.approx(6.15e-3, abs=1e-5), pytest.approx(-4 * 6.15e-3, abs=1e-4))
    assert _csv(SPEC, drawn(batches=1), ["batch"]).startswith("batch,x,f\n1,0.00000,")


@pytest.mark.parametrize(
    ("force_N", "unit", "more"),
    [(24.0, "N", {}), (0.02, "kN", {}), (2e-4, "N", {}), (24.0, "N", {"header": False})],
)
def test_what_is_written_is_read_back(tmp_path, force_N, unit, more):  # noqa: N803
    """Five decimals made forces of 24 mN zeros in kN; a header that no one reads was a row."""
    names = ("2", "3") if more else ("x", "f")
    spec = MeasurementSpec(
        file="v.csv", columns=dict(zip(("displacement", "force"), names, strict=True)),
        units={"displacement": "mm", "force": unit}, block="1" if more else "batch",
        range=read_range(["1 mm", "6 mm"]), points=11, **more,
    )  # fmt: skip
    quiet = Generator(batches=2, batch_sd=0, specimen_sd=0, shape_sd=0, noise_N=0)
    rate = force_N / 6
    tests = list(generate(Curve(D, rate * D, None, {}), quiet, spec))
    (tmp_path / "v.csv").write_text(_files(spec, tests)["v.csv"])
    read = read_measurements(spec, tmp_path, 20.0, 6.0)
    for test in read.tests:
        np.testing.assert_allclose(test.force_N, rate * read.displacement_mm, rtol=1e-3)


def sagging(stiffer):
    """Solve a heavy cylinder under a flat tip, its moduli multiplied."""
    constants = {name: stiffer * value for name, value in truth("yeoh").constants.items()}
    heavy = {"density_kg_m3": 4000.0, "direction": "down"}
    tables = {
        "specimen": {"shape": "cylinder", "radius_mm": 20.0, "height_mm": 25.0},
        "test": {"kind": "indentation", "interface": "frictionless", "base": "bonded",
                 "displacement_mm": 1.0, "steps": 2, "gravity": heavy,
                 "indenter": {"shape": "flat", "radius_mm": 6.0, "edge_radius_mm": 2.0}},
        "material": {"model": "reduced-polynomial", "constants": constants,
                     "poisson_ratio": 0.4995},
        "model": {"space": "axisymmetric", "mesh": "coarse"},
    }  # fmt: skip
    return finite_element.solve(CellProblem.of(tables).at(), gradients=True).curve


def test_a_stiffer_specimen_sags_less():
    """The weight does not grow with the moduli: the reference says by how much, to first order."""
    # moduli 1.1 times as large, at load steps that were solved
    quiet = Generator(batches=1, repeats=1, batch_sd=0.068, specimen_sd=0, shape_sd=0, noise_N=0,
                      spacing_mm=0.25)  # fmt: skip
    one = sagging(1.0)
    naive, weighed = (next(generate(one, quiet, SPEC, weighs=heavy)) for heavy in (False, True))
    d = naive.displacement_mm[-1:]
    exact = sagging(float(naive.force_N[-1] / one.force_at(d)[0])).force_at(d)[0]
    apart = abs(naive.force_N[-1] - exact)
    assert apart > 1e-3 * exact  # what is left without it
    assert weighed.force_N[-1] == pytest.approx(exact, abs=0.1 * apart)


def slender(radius):
    shape = [f'specimen.radius="{radius}"', 'specimen.height="30 mm"']
    return demo_design(shape)


def test_a_specimen_that_is_a_thread_is_refused_before_it_is_solved(tmp_path):
    with pytest.raises(InputError, match="specimen.height: 30 mm is 3e.06 times half the width"):
        write_virtual(slender("0.00001 mm"), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_slender_specimen_has_the_force_of_a_bar():
    """The plates hold a radius of the length each: what is between them is uniaxial."""
    design = slender("0.005 mm")
    ((_, problem),) = virtual_specimens._sources(design)
    curve = reference_curve(
        problem, truth("yeoh"), 0.4995, as_designed=False, virtual=Virtual(steps=4)
    )
    solid = Material("reduced-polynomial", truth("yeoh").constants, poisson_ratio=0.4995)
    bar = LOADINGS["uniaxial"].nominal(solid, 1 - curve.displacement_mm / 30)
    np.testing.assert_allclose(curve.force_N, -np.pi * 0.005**2 * bar.stress, rtol=2e-3)


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
