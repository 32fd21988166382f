"""Generated designs against their definitions: balance, orthogonality, published words."""

import itertools

import numpy as np
import pytest

from study.harness.design import generators

NAMES = list("ABCDEFGHJKLM")


def gram(runs):
    return np.asarray(runs.T @ runs)


# generators and resolutions of Box, Hunter and Hunter 1978, table 12.15
@pytest.mark.parametrize(
    ("count", "given", "runs", "resolution"),
    [
        (3, {"C": "AB"}, 4, 3),
        (4, {"D": "ABC"}, 8, 4),
        (5, {"E": "ABCD"}, 16, 5),
        (5, {"D": "AB", "E": "AC"}, 8, 3),
        (6, {"E": "ABC", "F": "BCD"}, 16, 4),
        (7, {"D": "AB", "E": "AC", "F": "BC", "G": "ABC"}, 8, 3),
        (8, {"E": "BCD", "F": "ACD", "G": "ABC", "H": "ABD"}, 16, 4),
        (6, {"F": "ABCDE"}, 32, 6),
        (8, {"G": "ABCD", "H": "ABEF"}, 64, 5),
    ],
)
def test_published_fractions(count, given, runs, resolution):
    names = NAMES[:count]
    found = generators.fractional(names, {k: (1, list(v)) for k, v in given.items()})
    assert found.shape == (runs, count)
    assert set(np.unique(found)) == {-1.0, 1.0}
    assert gram(found).tolist() == (runs * np.eye(count)).tolist()
    assert len({tuple(run) for run in found}) == runs
    for name, parts in given.items():
        product = np.prod([found[:, names.index(p)] for p in parts], axis=0)
        assert found[:, names.index(name)].tolist() == product.tolist()
    assert generators.resolution(found) == resolution


def test_a_negative_generator_is_the_other_fraction():
    plus = generators.fractional(["A", "B", "C"], {"C": (1, ["A", "B"])})
    minus = generators.fractional(["A", "B", "C"], {"C": (-1, ["A", "B"])})
    assert len({tuple(run) for run in np.vstack([plus, minus])}) == 8
    assert generators.defining_relation(minus, ["A", "B", "C"]) == "I = -A:B:C"


def test_words_of_a_quarter_fraction():
    # 2^(5-2), D = AB, E = AC: I = ABD = ACE = BCDE (Box, Hunter and Hunter 1978, chapter 12)
    runs = generators.fractional(NAMES[:5], {"D": (1, ["A", "B"]), "E": (1, ["A", "C"])})
    words = {generators.term_name(w, NAMES) for w in generators.defining_words(runs)}
    assert words == {"A:B:D", "A:C:E", "B:C:D:E"}
    told = generators.sentences(runs, NAMES[:5])
    assert (
        "the effect of A cannot be told from the interaction of B and D or "
        "the interaction of C and E" in told
    )
    assert "the interaction of B and C cannot be told from the interaction of D and E" in told


def test_a_full_factorial_aliases_nothing():
    runs = np.array(list(itertools.product([-1.0, 1.0], repeat=4)))
    assert generators.resolution(runs) is None
    assert generators.sentences(runs, NAMES[:4]) == []
    assert generators.defining_relation(runs, NAMES[:4]) == ""


def test_a_wrong_fraction_is_found_out():
    # column C repeats column A: whatever a generator promised, that is resolution 2
    runs = np.array([[-1, -1, -1], [-1, 1, -1], [1, -1, 1], [1, 1, 1]], dtype=float)
    assert generators.resolution(runs) == 2
    assert "the effect of A cannot be told from the effect of C" in generators.sentences(
        runs, "ABC"
    )


@pytest.mark.parametrize("resolution", [3, 4, 5])
@pytest.mark.parametrize("count", [4, 5, 6, 7, 8])
def test_fractions_by_resolution_keep_their_word(count, resolution):
    try:
        runs = generators.by_resolution(count, resolution)
    except ValueError:
        pytest.skip("the library has no such fraction")
    found = generators.resolution(runs)
    assert found is None or found >= resolution
    assert gram(runs).tolist() == (len(runs) * np.eye(count)).tolist()


@pytest.mark.parametrize("count", range(2, 16))
def test_plackett_burman_is_orthogonal(count):
    runs = generators.plackett_burman(count)
    assert len(runs) % 4 == 0
    assert count < len(runs) <= count + 4
    assert gram(runs).tolist() == (len(runs) * np.eye(count)).tolist()
    assert runs.sum(axis=0).tolist() == [0.0] * count


def test_plackett_burman_of_twelve_mixes_by_thirds():
    # each main effect has correlation 1/3 with every interaction of two others (Lin and
    # Draper 1992, Technometrics 34, 423)
    runs = generators.plackett_burman(11)
    assert len(runs) == 12
    told = generators.sentences(runs, NAMES[:11])
    mixed = "is mixed with a part (up to 0.333) of 45 interactions of two other factors"
    assert told == [f"the effect of {name} {mixed}" for name in NAMES[:11]]


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_central_composite(count):
    runs = generators.central_composite(count)
    assert len(runs) == 2**count + 2 * count + 1
    assert np.abs(runs).max() == pytest.approx(1)
    assert (np.abs(runs).sum(axis=1) == 0).sum() == 1
    corner = np.abs(runs[(np.abs(runs) > 1e-12).all(axis=1)])
    # rotatable: stars at 2^(k/4) times the corners (Box and Hunter 1957, Ann. Math. Stat. 28)
    assert np.unique(np.round(1 / corner, 10)).tolist() == [round(2 ** (count / 4), 10)]
    # the fourth moments of a rotatable design: sum x^4 = 3 sum x^2 y^2
    assert (runs[:, 0] ** 4).sum() == pytest.approx(3 * (runs[:, 0] ** 2 * runs[:, 1] ** 2).sum())
    faced = generators.central_composite(count, "faced")
    assert set(np.unique(faced)) == {-1.0, 0.0, 1.0}


# runs without the center: Box and Behnken 1960, where nine factors have 24 runs of the 120 twice
@pytest.mark.parametrize(
    ("count", "block", "runs"),
    [(3, 2, 12), (4, 2, 24), (5, 2, 40), (6, 3, 48), (7, 3, 56), (9, 3, 96), (10, 4, 160)],
)
def test_box_behnken(count, block, runs):
    found = generators.box_behnken(count)
    assert len(found) == len({tuple(run) for run in found}) == runs + 1
    assert sorted(set(np.abs(found).sum(axis=1))) == [0.0, block]
    assert (np.abs(found).sum(axis=1) == 0).sum() == 1
    apart = ~np.eye(count, dtype=bool)
    assert np.count_nonzero(gram(found)[apart]) == 0
    # rotatable are exactly those of four and seven factors: sum x^4 = 3 sum x^2 y^2
    moments = gram(found**2)
    is_rotatable = set(moments[apart]) == {moments[0, 0] / 3} and len(set(np.diag(moments))) == 1
    assert is_rotatable == (count in (4, 7))


@pytest.mark.parametrize("count", range(3, 11))
def test_box_behnken_estimates_every_quadratic_term(count):
    # a column is estimable where a part of it lies outside the span of all others, which is one
    # over its variance inflation; the center alone tells the constant from the sum of the squares
    columns = quadratic_columns(generators.box_behnken(count))
    assert np.linalg.matrix_rank(columns) == 1 + 2 * count + count * (count - 1) // 2
    inflation = np.diag(np.linalg.inv(gram(columns))) * (columns**2).sum(axis=0)
    assert inflation[0] == pytest.approx(len(columns))
    linear, squares, products = np.split(inflation[1:], [count, 2 * count])
    assert linear == pytest.approx(np.ones(count))
    assert 1 < squares.max() < 9
    assert products == pytest.approx(np.ones(len(products)))


def quadratic_columns(runs):
    """Constant, linear, square and product columns of coded runs."""
    pairs = itertools.combinations(range(runs.shape[1]), 2)
    products = [runs[:, i] * runs[:, j] for i, j in pairs]
    return np.column_stack([np.ones(len(runs)), runs, runs**2, *products])


def test_latin_hypercube_has_one_run_in_each_slice():
    runs = generators.latin_hypercube(4, 20, seed=3)
    for column in runs.T:
        assert sorted((column * 20).astype(int)) == list(range(20))
    assert runs.tolist() == generators.latin_hypercube(4, 20, seed=3).tolist()
    assert runs.tolist() != generators.latin_hypercube(4, 20, seed=4).tolist()


def test_sobol_is_a_net():
    # 32 points of a (t, m, 2)-net with t = 0: every elementary box of volume 1/32 has one
    runs = generators.sobol(2, 32, seed=3)
    for power in range(6):
        boxes = {(int(x * 2**power), int(y * 2 ** (5 - power))) for x, y in runs}
        assert len(boxes) == 32
    assert runs.tolist() == generators.sobol(2, 32, seed=3).tolist()


# D-optimal designs against known bounds of the determinant.


def main_effects(factors):
    return [(k,) for k in range(factors)]


@pytest.mark.parametrize(
    ("sizes", "runs"),
    [((2,) * 4, 8), ((2,) * 7, 8), ((2,) * 11, 12), ((3,) * 4, 9), ((2, 2, 2, 3), 12)],
)
def test_orthogonal_arrays_are_found(sizes, runs):
    # half fraction, Hadamard 8, Plackett and Burman 12, Taguchi's L9, L12 of mixed levels
    words = main_effects(len(sizes))
    found = generators.d_optimal(sizes, words, runs, seed=1)
    assert len(set(found)) == runs
    assert generators.efficiency(found, sizes, words) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("factors", "runs"), [(3, 6), (5, 10)])
def test_the_bound_of_ehlich_is_met(factors, runs):
    """Ehlich 1964, Math. Z. 83, 123: det <= [(n - 2 + p) (n - 2)^(p/2 - 1)]^2 for n = 2 mod 4."""
    p = factors + 1
    bound = ((runs - 2 + p) * (runs - 2) ** (p // 2 - 1)) ** 2
    found = generators.d_optimal((2,) * factors, main_effects(factors), runs, seed=1)
    x = generators.model_columns(np.array(found), (2,) * factors, main_effects(factors))
    assert np.linalg.det(x.T @ x) == pytest.approx(bound, rel=1e-9)


def test_given_cells_are_kept_and_not_chosen_again():
    sizes, words = (2, 2, 2), [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2)]
    given = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 1)]
    found = generators.d_optimal(sizes, words, 4, seed=3, given=given)
    assert sorted([*given, *found]) == sorted(itertools.product(range(2), repeat=3))


def test_the_best_of_all_subsets_is_found_where_they_can_be_counted():
    """C(12, 6) = 924 designs of 6 of the 12 cells of 2 x 2 x 3."""
    sizes, words = (2, 2, 3), main_effects(3)
    every = list(itertools.product(range(2), range(2), range(3)))
    best = max(
        generators.efficiency(rows, sizes, words) for rows in itertools.combinations(every, 6)
    )
    found = generators.d_optimal(sizes, words, 6, seed=5)
    assert generators.efficiency(found, sizes, words) == pytest.approx(best, rel=1e-9)
