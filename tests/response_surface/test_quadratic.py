"""Quadratic surfaces against a textbook, closed forms and simulated coverage."""

import numpy as np
import pytest

from study.ground.errors import InputError, RefusedError
from study.statistics.analysis.comparisons import all_contrasts
from study.statistics.surfaces.emulator import is_confirmed
from study.statistics.surfaces.quadratic import QuadraticPolynomial as Polynomial
from study.statistics.surfaces.quadratic import (
    against_blocks,
    factorize,
    fit_quadratic,
    leave_one_out,
    level_at,
    second_order,
)
from study.statistics.surfaces.surface_factors import (
    NumericFactor,
    Runs,
    box_points,
    never_run,
    some_runs,
)
from study.statistics.surfaces.surface_optimum import check_carries
from study.statistics.surfaces.surface_result import analysis_of


def unit_runs(coded, response, blocks=()):
    factors = tuple(NumericFactor(f"x{j + 1}", -1.0, 1.0) for j in range(coded.shape[1]))
    return Runs("y", factors, coded, response, blocks)


def face_centred(k):
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * k)).reshape(k, -1).T
    return np.vstack([corners, np.eye(k), -np.eye(k), np.zeros((1, k))])


@pytest.mark.parametrize(
    ("eigenvalues", "kind"),
    [
        ((-2.0, -1.0), "maximum"),
        ((1.0, 3.0), "minimum"),
        ((-1.0, 2.0), "saddle"),
        ((-4.0, 0.1), "ridge"),
    ],
)
def test_constructed_surface_is_found_again(eigenvalues, kind):
    angle, at = 0.4, np.array([0.3, -0.2])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = turn @ np.diag(eigenvalues) @ turn.T
    coded = face_centred(2)
    response = 5.0 + np.einsum("ni,ij,nj->n", coded - at, matrix, coded - at)
    found = fit_quadratic(unit_runs(coded, response))
    assert found.stationary is not None
    assert found.stationary.kind == kind
    assert found.stationary.inside
    assert found.stationary.at == pytest.approx(at, abs=1e-9)
    assert found.stationary.eigenvalues == pytest.approx(sorted(eigenvalues), abs=1e-9)
    assert found.loo is not None
    assert found.loo.q2 == pytest.approx(1.0, abs=1e-12)


def test_deterministic_surface_has_no_p_and_counts_copies_once():
    coded = face_centred(2)
    response = np.exp(coded[:, 0]) + coded[:, 1]
    once = fit_quadratic(unit_runs(coded, response))
    again = np.r_[0:9, 8, 8]
    copied = fit_quadratic(unit_runs(coded[again], response[again]))
    assert all(term.p is None and term.interval is None for term in copied.terms)
    assert copied.lack_of_fit is None
    assert (copied.terms, copied.loo) == (once.terms, once.loo)
    assert "2 copies of deterministic runs count once" in copied.notes


def test_copies_of_runs_and_of_blocks_count_once():
    random = np.random.default_rng(4)
    coded = np.vstack([face_centred(2), np.zeros((3, 2))])
    once = random.normal(10.0, 1.0, len(coded))
    single = fit_quadratic(unit_runs(coded, once))
    copied = fit_quadratic(unit_runs(np.tile(coded, (4, 1)), np.tile(once, 4)))
    assert (copied.terms, copied.loo) == (single.terms, single.loo)
    assert copied.lack_of_fit == single.lack_of_fit
    assert copied.notes[0] == "each run stands 4 times (12 distinct of 48): counts once"

    def of_blocks(*blocks):
        names = tuple(np.repeat(list("abcd")[: len(blocks)], len(coded)))
        return fit_quadratic(unit_runs(np.tile(coded, (len(blocks), 1)), np.hstack(blocks), names))

    # specimens of pure noise that differ by a shift alone: nothing is claimed
    shifted = of_blocks(once, once + 2.0, once)
    assert shifted.error == "none"
    assert all(term.p is None for term in shifted.terms)
    assert shifted.ranges(0.1) is None
    assert shifted.notes[0] == "blocks that are equal but for a shift count once: b is a, c is a"
    three = random.normal(10.0, 1.0, (3, len(coded)))
    assert of_blocks(*three, three[0]).terms == of_blocks(*three).terms


def test_leave_one_out_is_what_fitting_without_the_run_says():
    coded = face_centred(3)
    response = np.exp(coded @ [0.5, 0.3, -0.7])
    terms = second_order((3, 3, 3))
    found = leave_one_out(factorize(terms, coded), response)
    errors = np.zeros(len(coded))
    for i in range(len(coded)):
        rest = np.delete(np.arange(len(coded)), i)
        fit = factorize(terms, coded[rest]).coefficients(response[rest])
        errors[i] = response[i] - Polynomial(terms, fit, 3).value(coded[i : i + 1])[0]
    assert found is not None
    q2 = 1 - (errors**2).sum() / ((response - response.mean()) ** 2).sum()
    theirs = np.sqrt(np.mean(errors**2)), np.abs(errors).max(), q2
    assert (found.rms, found.largest, found.q2) == pytest.approx(theirs, rel=1e-9)


def test_terms_that_cannot_be_told_are_listed():
    coded = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1], [0, 0]], dtype=float)
    found = fit_quadratic(unit_runs(coded, np.arange(5.0) ** 2))
    assert found.aliases == ("x2^2 = x1^2",)
    assert found.stationary is None
    assert found.loo is None  # five coefficients of five runs
    assert any("add runs" in note for note in found.notes)
    x = np.linspace(-1, 1, 9)
    assert "x2 = -1 x1" in fit_quadratic(unit_runs(np.column_stack([x, -x]), x + x**2)).aliases


def test_curvature_of_two_factors_that_corners_and_centres_do_not_tell_apart():
    rng = np.random.default_rng(3)
    coded = np.vstack([np.tile([[-1, -1], [1, -1], [-1, 1], [1, 1]], (2, 1)), np.zeros((5, 2))])

    def true(x):  # all curvature is that of the second factor, which has no square of its own
        return 20 + 2 * x[:, 0] + x[:, 1] - 3 * x[:, 1] ** 2

    surface = fit_quadratic(unit_runs(coded, true(coded) + rng.normal(0, 0.3, len(coded))))
    points = rng.uniform(-1, 1, (500, 2))
    value, half = surface.predict(points)
    assert np.mean(np.abs(value - true(points)) <= half) > 0.95
    assert half[0] > surface.half_width == pytest.approx(surface.predict(coded[:1])[1][0])
    first, second = surface.ranges(0.5)
    assert abs(first.value - 4) <= first.bound
    assert abs(second.value - 4) <= second.bound  # -3 b^2 + b: from b = 1/6 to b = -1


def block_runs(rng, coded, true, blocks):
    """Every block with its own quadratic, and no misfit."""
    response, names = [], []
    for b in range(blocks):
        own = true.coefficients + rng.normal(0.0, 0.3, len(true.terms))
        response.append(Polynomial(true.terms, own, true.k).value(coded))
        names += [f"b{b}"] * len(coded)
    return unit_runs(np.tile(coded, (blocks, 1)), np.concatenate(response), tuple(names))


def test_incomplete_blocks_are_left_out_or_refused():
    coded = face_centred(2)
    true = Polynomial(second_order((3, 3)), np.arange(6.0), 2)
    runs = block_runs(np.random.default_rng(2), coded, true, 3)
    part = some_runs(runs, np.arange(27) < 26)
    assert "left out, with settings that lack a run: b2" in fit_quadratic(part).notes
    with pytest.raises(RefusedError, match="complete the blocks"):
        fit_quadratic(some_runs(runs, np.isin(np.arange(27), np.arange(1, 17))))


def test_best_point_on_the_boundary():
    coded = face_centred(2)
    response = 1.0 + 2.0 * coded[:, 0] - (coded[:, 1] - 0.5) ** 2
    found = analysis_of(fit_quadratic(unit_runs(coded, response)))
    assert found.largest.on_boundary
    assert found.largest.at == pytest.approx([1.0, 0.5], abs=1e-4)
    assert found.largest.value == pytest.approx(3.0, abs=1e-8)


def test_coding_and_bad_input():
    factor = NumericFactor("time", 1.0, 100.0, log=True)
    assert factor.coded(np.array([1.0, 10.0, 100.0])) == pytest.approx([-1.0, 0.0, 1.0])
    assert factor.setting(0.5) == pytest.approx(10**1.5)
    with pytest.raises(InputError, match="positive"):
        NumericFactor("time", 0.0, 1.0, log=True)
    with pytest.raises(InputError, match="empty"):
        NumericFactor("time", 3.0, 3.0)
    coded = face_centred(2)
    with pytest.raises(InputError, match="one setting in every run"):
        unit_runs(coded * [1.0, 0.0], coded[:, 0])
    runs = unit_runs(coded, coded[:, 0])
    assert runs.points({"x1": [0.5, 0.0], "x2": -1.0}) == pytest.approx(
        np.array([[0.5, -1.0], [0.0, -1.0]])
    )
    for at, said in [({"x1": 2.0, "x2": 0.0}, "outside"), ({"x1": 0.0}, "no setting"),
                     ({"x1": 0.0, "x2": 0.0, "x3": 0.0}, "no such factor"),
                     ({"x1": float("nan"), "x2": 0.0}, "outside")]:  # fmt: skip
        with pytest.raises(InputError, match=said):
            runs.points(at)


def share_in_interval(rng, designs):
    """Share of the box within 2 LOO rms of smooth surfaces that are no quadratics."""
    coded = face_centred(3)
    points = box_points(3, 512)
    shares = []
    for _ in range(designs):
        a, b = rng.normal(0, 0.8, 3), rng.normal(0, 0.8, 3)

        def truth(x, a=a, b=b):
            return np.asarray(np.exp(0.5 * x @ a) + np.sin(x @ b))

        values, half = fit_quadratic(unit_runs(coded, truth(coded))).predict(points)
        shares.append(float(np.mean(np.abs(values - truth(points)) <= half)))
    return float(np.mean(shares))


def region_coverage(rng, n):
    """Share of regions that hold the true stationary point, 6 blocks, 2 factors."""
    terms = second_order((3, 3))
    true = np.array([5.0, 0.3, -0.2, 0.1, -2.0, -1.5])
    surface = Polynomial(terms, true, 2)
    at = -0.5 * np.linalg.solve(surface.quadratic(), surface.linear())
    hits, limit = 0, all_contrasts(2, 5, 0.05, by_block=True)
    assert limit is not None
    for _ in range(n):
        each = true + rng.normal(0, 0.4, (6, 6))
        mean = Polynomial(terms, each.mean(axis=0), 2)
        hits += bool(level_at(mean, np.cov(each.T) / 6, limit, at[None, :])[0])
    return hits / n


def lack_of_fit_size(rng, n, blocks):
    """Share of false alarms of lack of fit where every block is a quadratic with noise."""
    columns = factorize(second_order((3, 3, 3)), face_centred(3))
    open_columns = columns.complement()
    found = 0
    for _ in range(n):
        test = against_blocks(open_columns, rng.normal(0, 1, (15, blocks)))
        found += test is not None and test.p < 0.05
    return found / n


@pytest.mark.parametrize(
    ("designs", "n", "blocks", "least", "apart", "most"),
    [
        (30, 400, (6,), 0.95, 0.03, 0.08),
        pytest.param(
            400, 4000, (5, 6, 9), 0.97, 0.015, 0.06, marks=[pytest.mark.slow, pytest.mark.verify]
        ),
    ],
)
def test_intervals_regions_and_lack_of_fit_hold_their_rates(designs, n, blocks, least, apart, most):
    rng = np.random.default_rng(10)
    share, coverage = share_in_interval(rng, designs), region_coverage(rng, n)
    sizes = {b: lack_of_fit_size(rng, n, b) for b in blocks}
    print(f"box within 2 LOO rms {share:.3f}; region covers {coverage:.3f}; lack of fit {sizes}")
    assert share >= least
    assert coverage == pytest.approx(0.95, abs=apart)
    assert max(sizes.values()) <= most


#: time, temperature and yield of a chemical reaction, run in two blocks: a cube and a star (Myers,
#: Montgomery and Anderson-Cook 2009, table 7.6; ChemReact of R's rsm, Lenth 2009, J. Stat. Softw.
#: 32, 7)
CUBE = [(80, 170, 80.5), (80, 180, 81.5), (90, 170, 82.0), (90, 180, 83.5),
        (85, 175, 83.9), (85, 175, 84.3), (85, 175, 84.0)]  # fmt: skip
STAR = [(85, 175, 79.7), (85, 175, 79.8), (85, 175, 79.5), (92.07, 175, 78.4),
        (77.93, 175, 75.6), (85, 182.07, 78.5), (85, 167.93, 77.0)]  # fmt: skip


def test_blocks_of_a_composite_design_shift_the_response():
    rows = np.array(CUBE + STAR)
    factors = (NumericFactor("time", 80, 90), NumericFactor("temp", 170, 180))
    coded = np.column_stack([f.coded(rows[:, j]) for j, f in enumerate(factors)])
    found = fit_quadratic(Runs("yield", factors, coded, rows[:, 2], ("cube",) * 7 + ("star",) * 7))
    # R 4.2.2: lm(Yield ~ Block + SO(x1, x2)) with sum contrasts of the blocks
    theirs = {
        "1": 81.866662323, "time": 0.932540814, "temp": 0.577712235, "time:temp": 0.125,
        "time^2": -1.308555445, "temp^2": -0.933442161,
    }  # fmt: skip
    for term in found.terms:
        assert term.coefficient == pytest.approx(theirs[term.term], abs=1e-8)
    assert {t.term: t.p for t in found.terms}["time:temp"] == pytest.approx(0.16938, abs=1e-5)
    assert found.stationary is not None
    assert found.stationary.at == pytest.approx([0.3722953975, 0.3343802034], abs=1e-9)
    assert found.stationary.established
    lack = found.lack_of_fit
    assert lack is not None
    assert (lack.f, lack.df, lack.df_error) == pytest.approx((0.53071, 3, 4), abs=1e-5)
    assert lack.p == pytest.approx(0.68509, abs=1e-5)
    told = analysis_of(found, practical=1.0)
    assert [item.range.verdict for item in told.sensitivity] == ["matters", "matters"]
    assert {i.range.verdict for i in analysis_of(found, 9.0).sensitivity} == {
        "no practical difference"
    }


@pytest.mark.parametrize("copies", [1, 2])
def test_noise_establishes_no_stationary_point(copies):
    random = np.random.default_rng(copies)
    coded = np.vstack([face_centred(2)] * copies)
    points = [
        fit_quadratic(unit_runs(coded, random.normal(10, 1, len(coded)))).stationary
        for _ in range(40)
    ]
    assert sum(point is not None and point.inside for point in points) > 10
    assert sum(point is not None and point.established for point in points) <= 2


def test_one_run_to_spare_carries_nothing():
    """Of 200 tables of noise at four settings 7.5 % had a Q2 of .8 and a factor that matters."""
    x = np.linspace(-1.0, 1.0, 4)[:, None]
    found = fit_quadratic(unit_runs(x, x[:, 0] + 1e-3 * x[:, 0] ** 3))
    assert found.q2 > 0.99
    assert found.ranges(0.1) is None
    assert any("one run more than coefficients" in note for note in found.notes)
    with pytest.raises(RefusedError, match="its Q2 may be chance"):
        check_carries(found)
    more = np.linspace(-1.0, 1.0, 5)[:, None]
    check_carries(fit_quadratic(unit_runs(more, more[:, 0] + 1e-3 * more[:, 0] ** 3)))


def test_quarters_of_the_box_without_a_run_are_named():
    coded = face_centred(2)
    factors = (NumericFactor("x1", 0, 10), NumericFactor("x2", 0, 4))
    assert not never_run(Runs("y", factors, coded, np.arange(9.0)))
    part = coded[~((coded > 0).all(axis=1))]
    (said,) = never_run(Runs("y", factors, part, np.arange(float(len(part)))))
    assert "x1 above 5 with x2 above 2" in said


def test_a_surface_that_judges_no_factor_ranks_them_by_what_they_change():
    """As many runs as terms leave no error; the second factor changes three times as much."""
    coded = np.array([[-1.0, -1], [1, -1], [-1, 1], [1, 1], [0, 0], [0, 1]])
    analysis = analysis_of(fit_quadratic(unit_runs(coded, coded @ [1.0, 3.0])), 0.5)
    assert any("no factor is judged" in note for note in analysis.notes)
    assert [(i.factor, i.rank, i.range) for i in analysis.sensitivity] == [
        ("x1", 2, None), ("x2", 1, None)
    ]  # fmt: skip


def test_repeated_runs_confirm_by_their_mean_in_any_order():
    coded = np.array([[-1.0, 0], [1, 0], [1, 0], [1, 0], [1, 1]])
    response = np.array([0.0, 0.2, 0.1, 3.0, 0.0])
    for last in range(1, 4):
        order = [0, *(i for i in range(1, 4) if i != last), last, 4]
        assert is_confirmed(unit_runs(coded, response[order]), 0, 1.0)
        assert not is_confirmed(unit_runs(coded, response[order]), 0, 1.2)


def test_a_constant_response_has_no_surface():
    coded = face_centred(2)
    with pytest.raises(RefusedError, match="the response 'y' is the same in every run"):
        fit_quadratic(unit_runs(coded, np.full(len(coded), 3.0)))
