"""Whether a fit describes its data: rows that it must accept, and rows that it must not."""

import re

import numpy as np
import pytest

import study
from study.api.assemble import _checks
from study.ground.curve import Curve
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.lack_of_fit import adequacy, apart
from study.mechanics.calibration.residual_function import LOSS_LIMIT, MeasuredCurve
from study.mechanics.calibration.serial_correlation import row_noise
from tests.calibration.cylinder import predictor
from tests.cli import small
from tests.fem.problems import LONG, long_verification

TRUTH = {"C10": 15e-3, "C20": 3e-3}
KINDS = ("white", "drift", "proportional")
#: largest share of good fits that may be called anything but good
FALSE = 0.02


def errors(kind, force, size, rng):
    """Errors of rows with a standard deviation of ``size`` over the (largest) force."""
    white = rng.normal(size=force.size)
    if kind == "proportional":
        return size * force * white
    rho = 0.9 if kind == "drift" else 0.0
    out = white.copy()
    for k in range(1, out.size):
        out[k] = rho * out[k - 1] + np.sqrt(1 - rho**2) * white[k]
    return size * force.max() * out


def judged(curves, names=("C10", "C20"), model="reduced-polynomial", tests=(), bounds=None):
    """Fit tension to stretch 2, and judge."""
    predict, d = predictor(model, names, 30.0, sign=1.0, points=curves[0].size)
    measured = [MeasuredCurve(f"test {k}", Curve(d, one)) for k, one in enumerate(curves)]
    found = fit(
        lambda values: predict(values) * len(measured), measured, names,
        [0.9 * TRUTH[n] for n in names], bounds=bounds,
    )  # fmt: skip
    found = with_serial_correlation(found, measured)
    return adequacy(found, measured, tests=tests)


def true_force(points):
    predict, _ = predictor("reduced-polynomial", tuple(TRUTH), 30.0, sign=1.0, points=points)
    return predict(np.array(list(TRUTH.values())))[0].force_N


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("points", "draws", "seed", "most"),
    [
        # of 20 draws at a rate of 1 %, more than 2 come in 0.1 %
        *((points, 20, 7, 0.1) for points in (10, 60)),
        *(
            pytest.param(n, 400, 11, FALSE + 2 * np.sqrt(FALSE / 400), marks=LONG)
            for n in (10, 30, 100, 500)
        ),
    ],
)  # fmt: skip
def test_few_good_fits_are_called_bad(kind, points, draws, seed, most):
    rng, force = np.random.default_rng(seed), true_force(points)
    sizes = np.where(np.arange(draws) % 2, 0.01, 0.05)
    bad = [judged([force + errors(kind, force, s, rng)]).verdict != "describes" for s in sizes]
    assert np.mean(bad) <= most


@long_verification
def test_noise_that_grows_with_the_force_makes_no_row_of_few_suspect():
    """In 1,000 sets 1 is called anything but good; 21 were where growth had to be significant."""
    rng, force = np.random.default_rng(11), true_force(20)
    tests = [force + errors("proportional", force, 0.05, rng) for _ in range(100)]
    assert np.mean([judged([test]).verdict != "describes" for test in tests]) <= FALSE


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("points", [20, 100])
def test_an_energy_that_is_wrong_is_told(kind, points):
    """A neo-Hookean fit to data that stiffen: 14 % of the force stay."""
    rng, force = np.random.default_rng(3), true_force(points)
    for _ in range(10):
        found = judged([force + errors(kind, force, 0.01, rng)], ("C10",), "neo-hookean")
        assert found.verdict != "describes"
        assert "take another energy" in found.sentence or "then the energy" in found.sentence


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_load_cell_that_drifts_by_a_twentieth_is_doubtful(sign):
    """Constants take up most of it: C10 is 5 % off, and the interval says .2 %."""
    predict, d = predictor("neo-hookean", ("C10",), 12.0, sign=sign, points=100)
    force, rng = predict(np.array([15e-3]))[0].force_N, np.random.default_rng(2)
    for drift, verdict in ((0.05, "doubtful"), (0.0, "describes")):
        for _ in range(10):
            read = force + drift * force.max() * np.linspace(0, 1, 100)
            measured = [MeasuredCurve("a", Curve(d, read + errors("white", force, 0.002, rng)))]
            found = with_serial_correlation(fit(predict, measured, ("C10",), [1e-2]), measured)
            told = adequacy(found, measured)
            assert told.verdict == verdict
            assert ("drifts by" in told.sentence) == (drift > 0)


@pytest.mark.parametrize(("zero", "least", "most"), [(0.03, 12, 30), (0.0, 0, 0)])
def test_a_load_cell_that_is_not_zeroed_is_told_beside_noise(zero, least, most):
    """By 3 % of the force, beside noise of 3 %, in half of draws; general trends told 7 of 30."""
    predict, d = predictor("neo-hookean", ("C10",), 12.0, sign=1.0, points=60)
    force, rng, doubted = predict(np.array([15e-3]))[0].force_N, np.random.default_rng(4), 0
    for _ in range(30):
        read = force + zero * force.max() + errors("white", force, 0.03, rng)
        measured = [MeasuredCurve("a", Curve(d, read))]
        fitted = with_serial_correlation(fit(predict, measured, ("C10",), [1e-2]), measured)
        doubted += adequacy(fitted, measured).verdict == "doubtful"
    assert least <= doubted <= most


def test_a_row_five_times_too_large_is_named():
    rng, force = np.random.default_rng(5), true_force(50)
    for place in (20, 33, 47):
        read = force + errors("white", force, 0.002, rng)
        read[place] *= 5
        found = judged([read])
        assert found.verdict == "does not describe"
        assert [row.row for row in found.rows] == [place + 1]
        assert "soft-l1" in found.sentence
        assert "e+" not in found.sentence


def test_a_constant_at_its_bound_is_doubtful():
    rng, force = np.random.default_rng(5), true_force(50)
    read = force + errors("white", force, 0.01, rng)
    found = judged([read], bounds=[(0.0, 1.0), (0.0, 2.9e-3)])
    assert found.verdict == "doubtful"
    assert "C20 ended at its bound (0.0029 MPa)" in found.sentence


def test_specimens_that_differ_are_noise_and_what_they_share_is_not():
    rng, force = np.random.default_rng(8), true_force(40)
    scales = 1 + 0.2 * rng.normal(size=6)
    specimens = [s * force + errors("white", force, 0.005, rng) for s in scales]
    assert judged(specimens, tests=[0] * 6).verdict == "describes"
    wrong = judged(specimens[:1] * 6, ("C10",), "neo-hookean", tests=[0] * 6)
    assert wrong.verdict == "does not describe"


RAMP = np.linspace(0.0, 9.0, 46)
PULLED = 200 * 0.02 * (1 + RAMP / 30 - (1 + RAMP / 30) ** -2)  # N, of C10 = 20 kPa


def calibrated(folder, rows, column="", more=""):
    """Adequacy that ``study calibrate`` gives of rows of tension: number, mm, N."""
    lines = ["no,d,f", *(f"{number},{d:.6f},{f:.6f}" for number, d, f in rows)]
    (folder / "a.csv").write_text("\n".join(lines) + "\n")
    (folder / "c.toml").write_text(
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "100 mm^2"\nlength = "30 mm"\n'
        '[material]\nmodel = "neo-hookean"\nincompressible = true\n[[tests]]\n'
        'test = { kind = "tension" }\n[tests.measurements]\nfile = "a.csv"\n'
        'columns = { displacement = "d", force = "f" }\n'
        f'units = {{ displacement = "mm", force = "N" }}\n{column}\n{more}\n'
    )
    return study.calibrate(folder / "c.toml", data=folder).adequacy


@pytest.mark.parametrize(
    ("last", "column", "verdict"),
    [
        ((1.03, 1.0), 'average = ["no"]', "describes"),
        ((2.0, 1.0), 'average = ["no"]', "doubtful"),
        ((1.0, 1e3), 'average = ["no"]', "doubtful"),  # micrometers among millimeters
        ((1.4, 1.0), 'block = "no"', "describes"),  # specimens differ
        ((10.0, 1.0), 'block = "no"', "doubtful"),
    ],
)
def test_a_recording_that_is_none_of_the_others_is_named(tmp_path, last, column, verdict):
    """C10 of 20 kPa was 26.7, 13.4 and 65 kPa where the third of three was in another unit."""
    rng, rows = np.random.default_rng(4), []
    for number, (stiff, far) in enumerate([(1.0, 1.0), (1.02, 1.0), last], 1):
        read = stiff * PULLED + rng.normal(0, 0.003, RAMP.size)
        rows += [(number, d, f) for d, f in zip(far * RAMP, read, strict=True)]
    told = calibrated(tmp_path, rows, column)
    assert told.verdict == verdict
    named = "a.csv, repeat 3" if "average" in column else "a.csv, 3"
    assert (f"{named}: its forces are" in told.sentence) == (verdict == "doubtful")


@pytest.mark.parametrize("specimens", [2, 3, 5])
@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_a_specimen_off_by_ten_is_named_beside_ones_that_scatter(specimens, factor):
    """Of 500 draws with the scatter of a fifth that specimens have, 4 in 10 of three were not."""
    rng = np.random.default_rng(8)
    named, sound = 0, 0
    for _ in range(500):
        sizes = dict(enumerate(np.exp(0.2 * rng.normal(size=specimens))))
        most = 4.0 if specimens > 2 else 6.0
        sound += bool(apart(sizes, most))
        named += bool(apart({**sizes, 1: factor * sizes[1]}, most))
    assert named / 500 > 0.92
    assert sound / 500 < 0.01


@pytest.mark.parametrize("second", [1.0, 1.1, 0.8])
def test_tests_that_ask_for_different_constants_are_told(tmp_path, second):
    """Equibiaxial forces 10 % too large gave a C01 of 13.6 [11.5, 15.7] kPa of 10, and described.

    Each test alone follows the energy; both together do with the right forces alone.
    """
    rng, far = np.random.default_rng(9), np.linspace(0, 8, 41)
    stretch = 1 + far / 20
    forces = {
        "tension": 160 * (0.02 + 0.01 / stretch) * (stretch - stretch**-2),
        "equibiaxial": second * 160 * (0.02 + 0.01 * stretch**2) * (stretch - stretch**-5),
    }
    text = (
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "80 mm^2"\nlength = "20 mm"\n'
        '[material]\nmodel = "mooney-rivlin"\nincompressible = true\n'
    )
    for kind, force in forces.items():
        rows = zip(far, force + 0.02 * rng.normal(size=41), strict=True)
        (tmp_path / f"{kind}.csv").write_text(
            "d,f\n" + "".join(f"{d:.6f},{f:.6f}\n" for d, f in rows)
        )
        text += (
            f'[[tests]]\ntest = {{ kind = "{kind}" }}\nmeasurements = {{ file = "{kind}.csv", '
            'columns = { displacement = "d", force = "f" }, '
            'units = { displacement = "mm", force = "N" } }\n'
        )
    (tmp_path / "c.toml").write_text(text)
    judged = study.calibrate(tmp_path / "c.toml", data=tmp_path).adequacy
    assert judged.verdict == ("describes" if second == 1 else "doubtful")
    assert ("the tests ask for different constants" in judged.sentence) == (second != 1)


@pytest.mark.parametrize("specimens", [(4, 4), (5, 5), (5, 1)])
@pytest.mark.parametrize("second", [1.0, 0.8])
def test_tests_of_several_specimens_that_ask_for_different_constants(tmp_path, specimens, second):
    """Specimens agree within 1 %, the tests differ by a fifth: Mooney-Rivlin "described" both.

    C10 of 30 kPa and C01 of none were 34 [31, 37] and -6.6 [-8.7, -4.6] kPa.
    """
    rng, far = np.random.default_rng(9), np.linspace(0.2, 8, 40)
    text = (
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "80 mm^2"\nlength = "20 mm"\n'
        '[material]\nmodel = "mooney-rivlin"\nincompressible = true\n'
    )
    kinds = zip(("tension", "compression"), (1.0, -1.0), (1.0, second), specimens, strict=True)
    for kind, sign, size, count in kinds:
        stretch, lines = 1 + sign * far / 20, ["s,d,f"]
        for number, stiff in enumerate(1 + 0.01 * rng.normal(size=count)):
            force = sign * 160 * 0.03 * stiff * size * (stretch - stretch**-2)
            read = force + 0.01 * rng.normal(size=40)
            lines += [f"S{number},{d:.6f},{f:.6f}" for d, f in zip(far, read, strict=True)]
        (tmp_path / f"{kind}.csv").write_text("\n".join(lines) + "\n")
        text += (
            f'[[tests]]\ntest = {{ kind = "{kind}" }}\nmeasurements = {{ file = "{kind}.csv", '
            'block = "s", columns = { displacement = "d", force = "f" }, '
            'units = { displacement = "mm", force = "N" } }\n'
        )
    (tmp_path / "c.toml").write_text(text)
    judged = study.calibrate(tmp_path / "c.toml", data=tmp_path).adequacy
    assert (judged.verdict == "describes") == (second == 1)
    assert ("the tests ask for different constants" in judged.sentence) == (second != 1)


@pytest.mark.parametrize("clamp", [1.0, 0.9, 1.1])
def test_a_clamp_that_stretches_less_than_it_says_is_told(tmp_path, clamp):
    """By the file both stretches are equal: C10 of 30 kPa was 29.1 [28.3, 29.9], and described."""
    far, rng = np.linspace(0.02, 0.5, 25), np.random.default_rng(1)
    a, b = 1 + far, 1 + clamp * far
    third = 1 / (a * b)
    first, second = 60 * (a - third**2 / a), 60 * (b - third**2 / b)  # kPa, of C10 = 30 kPa
    noise = 0.01 * first.max() * rng.normal(size=(2, 25))
    rows = zip(a, a, first + noise[0], second + noise[1], strict=True)
    (tmp_path / "a.csv").write_text(
        "a,b,s,t\n" + "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in rows)
    )
    (tmp_path / "c.toml").write_text(
        'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "80 mm^2"\nlength = "20 mm"\n'
        '[material]\nmodel = "neo-hookean"\nincompressible = true\n[[tests]]\n'
        'test = { kind = "biaxial" }\n[tests.measurements]\nfile = "a.csv"\n'
        'columns = { stretch_1 = "a", stretch_2 = "b", stress_1 = "s", stress_2 = "t" }\n'
        'units = { stretch_1 = "1", stress_1 = "kPa" }\n'
    )
    judged = study.calibrate(tmp_path / "c.toml", data=tmp_path).adequacy
    assert judged.verdict == ("describes" if clamp == 1 else "doubtful")
    assert ("the directions ask for different constants" in judged.sentence) == (clamp != 1)


def test_specimens_that_differ_more_than_their_repeats_are_no_lack_of_fit(tmp_path):
    """Three specimens of 18, 20 and 22 kPa, two repeats of each: every one is neo-Hookean."""
    rng, rows = np.random.default_rng(4), []
    for number, stiff in enumerate((0.9, 0.9, 1.0, 1.0, 1.1, 1.1)):
        read = stiff * PULLED + rng.normal(0, 0.003, RAMP.size)
        rows += [(number, d, f) for d, f in zip(RAMP, read, strict=True)]
    label = 'block = "specimen"\naverage = ["repeat"]'
    lines = ["specimen,repeat,no,d,f"]
    lines += [f"S{no // 2},{no % 2},{no},{d:.6f},{f:.6f}" for no, d, f in rows]
    calibrated(tmp_path, rows[: RAMP.size])
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    table = (tmp_path / "c.toml").read_text() + label + "\n"
    (tmp_path / "c.toml").write_text(table)
    told = study.calibrate(tmp_path / "c.toml", data=tmp_path).adequacy
    assert (told.verdict, told.reasons) == ("describes", ())


@pytest.mark.parametrize("more", ["", '[calibration]\nloss = "soft-l1"'])
def test_a_specimen_that_slips_several_times_is_none_of_misread_rows(tmp_path, more):
    """At 5 and 7 mm it slips in its grips by .6 mm: no robust loss mends that."""
    held = RAMP - 0.6 * (RAMP > 5.05) - 0.6 * (RAMP > 7.05)
    read = 200 * 0.02 * (1 + held / 30 - (1 + held / 30) ** -2)
    read = read + np.random.default_rng(4).normal(0, 0.003, RAMP.size)
    rows = [(1, d, f) for d, f in zip(RAMP, read, strict=True)]
    told = calibrated(tmp_path, rows, more=more)
    assert told.verdict == "doubtful"
    assert "between rows 26 and 27, 5 and 5.2 mm; rows 36 and 37, 7 and 7.2 mm" in told.sentence
    assert "write the range before the first" in told.sentence
    assert "misread" not in told.sentence


HELD = {
    "nothing": RAMP,
    "slips": RAMP - 0.3 * (RAMP > 4.9),
    "slips over 2 mm": RAMP - 0.3 * np.clip((RAMP - 4) / 2, 0, 1),
}


@pytest.mark.parametrize("noise", [0.002, 0.006])
@pytest.mark.parametrize("fault", [*HELD, "set to zero"])
def test_a_force_that_goes_to_another_level_is_told(tmp_path, fault, noise):
    """Less than 3 % of the largest force at half travel: C10 was 3 % off, and "described"."""
    held = HELD.get(fault, RAMP)
    read = 200 * 0.02 * (1 + held / 30 - (1 + held / 30) ** -2)
    read = read + 0.08 * (fault == "set to zero") * (RAMP > 4.9)
    for seed in range(3):
        errors_N = np.random.default_rng(seed).normal(0, noise, RAMP.size)  # noqa: N806
        rows = [(1, d, f) for d, f in zip(RAMP, read + errors_N, strict=True)]
        told = calibrated(tmp_path, rows)
        assert told.verdict == ("describes" if fault == "nothing" else "doubtful")
        assert ("write the range before it" in told.sentence) == (fault != "nothing")


@pytest.mark.parametrize("loss", ["linear", "soft-l1"])
@pytest.mark.parametrize("fault", ["falls to .62", "falls by .57 N", "drifts"])
def test_a_robust_loss_hides_no_line_that_many_rows_follow(tmp_path, fault, loss):
    """A step was called single misread rows; with the loss that was advised 12.5 kPa "described".

    Forces of 20 kPa whose last 16 rows are .62 of what they were, or .57 N less, or that drift.
    """
    torn = np.arange(RAMP.size) >= 30
    read = {
        "falls to .62": np.where(torn, 0.62, 1.0) * PULLED,
        "falls by .57 N": PULLED - 0.57 * torn,
        "drifts": PULLED + 0.05 * PULLED.max() * np.linspace(0, 1, RAMP.size),
    }[fault] + np.random.default_rng(7).normal(0, 0.0055, RAMP.size)
    rows = [(1, d, f) for d, f in zip(RAMP, read, strict=True)]
    told = calibrated(tmp_path, rows, more=f'[calibration]\nloss = "{loss}"')
    assert told.verdict != "describes"
    seen = "drifts by" if fault == "drifts" else "between rows 30 and 31, 5.8 and 6 mm"
    assert seen in told.sentence


def test_data_that_a_mean_describes_better():
    force = true_force(40)
    found = judged([force.max() * np.linspace(1.0, 1.2, 40)])
    assert found.verdict == "does not describe"
    assert "displacement_zero" in found.sentence


@pytest.mark.parametrize("loss", ["soft-l1", "huber"])
def test_a_robust_loss_leaves_a_misread_row_aside(loss):
    """The minimum is that of scipy's least_squares, and the row is listed, not held against it."""
    from scipy.optimize import least_squares

    rng, force = np.random.default_rng(5), true_force(50)
    read = force + errors("white", force, 0.002, rng)
    read[30] *= 5
    predict, d = predictor("reduced-polynomial", ("C10", "C20"), 30.0, sign=1.0, points=50)
    noise = row_noise(read, d, read)
    limit = LOSS_LIMIT * float(np.median(noise.deviation))
    measured = [MeasuredCurve("one", Curve(d, read), loss=loss, limit_N=limit)]
    found = with_serial_correlation(fit(predict, measured, ("C10", "C20"), [1e-2, 1e-3]), measured)
    other = least_squares(
        lambda v: predict(v)[0].force_N - read, [1e-2, 1e-3], loss=loss.replace("-", "_"),
        f_scale=limit, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    assert found.values == pytest.approx(other.x, rel=1e-5)
    # within four standard errors of the truth, which are those of the other rows
    assert np.all(np.abs(found.values - list(TRUTH.values())) < 4 * found.standard_error)
    assert found.standard_error[0] < 0.01 * TRUTH["C10"]
    told = adequacy(found, measured)
    assert told.verdict == "describes"
    assert [row.row for row in told.rows] == [31]


@pytest.mark.parametrize("power", [0.0, 1.0])
def test_noise_of_rows_and_its_power_of_the_force(power):
    rng, force = np.random.default_rng(4), true_force(200)
    true = 0.01 * force.max() * (force / force.max()) ** power
    powers, ratios = [], []
    for _ in range(40):
        noise = row_noise(force + true * rng.normal(size=200), np.arange(200.0), force)
        powers.append(noise.power)
        ratios.append(np.median(noise.deviation / true))
    assert np.mean(powers) == pytest.approx(power, abs=0.1)
    # a mean of 40 medians of 200 rows scatters by 1 to 2 %
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.06)


def test_a_study_says_which_of_its_fits_do_not_describe(tmp_path):
    """One row five times too large: the fits to its specimen name it."""
    small.write_files(tmp_path)
    data = tmp_path / "data" / "tests.csv"
    rows = data.read_text().splitlines()
    places = [k for k, row in enumerate(rows) if row.startswith(("M1,A,1,2.0000", "M1,A,2,2.0000"))]
    for k in places:
        label, force = rows[k].rsplit(",", 1)
        rows[k] = f"{label},{5 * float(force):.10f}"
    data.write_text("\n".join(rows) + "\n")
    ran = study.run(
        tmp_path / "small.toml", data=data.parent, results=tmp_path / "r", reports=None, jobs=1
    )
    fits = {fit["key"]: fit for one in ran.records for fit in (one.fit or {}).values()}
    bad = [fit for fit in fits.values() if fit.get("verdict") == "does not describe"]
    assert len(bad) == 4  # two energies over two ranges
    assert all("is off by up to" in fit["misfit"] for fit in bad)
    (check,) = [one for one in _checks(ran) if one.name == "fits describe their data"]
    assert "4 do not" in check.finding
    # the card names the fit: energy, range, block and specimen
    assert re.search(r"of [a-z-]+, (large|small), mix M1, specimen A, ", check.finding)
    assert check.consequence.startswith("use no constant of 4 fits that missed the data, such as ")
    # what a reader sees first speaks of it too
    assert any("4 do not" in line and "is off by up to" in line for line in ran.answers)


def test_a_study_names_the_specimen_in_another_unit(tmp_path):
    """One of four specimens in mN where the file says N: the answer names it, not a number."""
    d = np.linspace(0, 4, 41)
    stretch = 1 - d / 20
    force = 0.8 * (stretch**-2 - stretch)  # N: neo-Hookean of 40 kPa on 20 mm^2
    rows = ["specimen,displacement_mm,force_N"]
    for name, size in (("S1", 1.0), ("S2", 1.05), ("S3", 1e3), ("S4", 0.95)):
        rows += [f"{name},{x:.3f},{size * f:.9g}" for x, f in zip(d, force, strict=True)]
    (tmp_path / "tests.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "unit.toml").write_text(
        """schema = 1
[study]
name = "unit"
[specimen]
shape = "homogeneous"
area = "20 mm^2"
length = "20 mm"
[test]
kind = "compression"
[material]
poisson_ratio = 0.4995
[presets.energy.first]
material.model = "neo-hookean"
[presets.energy.second]
material.model = "reduced-polynomial"
material.order = 2
[measurements]
file = "tests.csv"
columns = { displacement = "displacement_mm", force = "force_N" }
units = { displacement = "mm", force = "N" }
block = "specimen"
points = 20
range = ["1 %", "20 %"]
[factors]
energy = ["first", "second"]
[[response]]
name = "relative_rms_force_error"
practical = "0.5 pp"
"""
    )
    ran = study.run(
        tmp_path / "unit.toml", data=tmp_path, results=tmp_path / "r", reports=None, jobs=1
    )
    (line,) = [one for one in ran.answers if "calibrations describe their rows" in one]
    assert "specimen S3: its forces are" in line
    assert "curve " not in line
    assert re.search(r"6 are doubtful, for example that of \w+, all but specimen S[124]: ", line)
    assert any("in 1 of 4 tests, of specimen S3)" in one for one in ran.answers)
