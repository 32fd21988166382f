"""Coded runs of designs other than the full factorial, from kept-up libraries.

Two-level designs are coded -1 and 1, response-surface designs -1 to 1 with the outermost
runs at the ends of the ranges, space-filling designs 0 to 1. pyDOE3 is not used: its
fractional designs are wrong; those of pydoe are verified by :mod:`study.design.overview`.
"""

from __future__ import annotations

import itertools
import math
import string
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from study.arrays import Array
from study.design.factors import level_label
from study.design.reader import Section
from study.design.spec import Factor, Scheme
from study.design.toml_document import flatten
from study.errors import nearest
from study.setup.quantity import shown
from study.setup.section import Bad
from study.setup.text import name

#: letters that pydoe takes for factors
LETTERS = string.ascii_lowercase


def fractional(
    factors: Sequence[str], generators: Mapping[str, tuple[int, Sequence[str]]]
) -> Array:
    """Two-level fractional factorial with given generators.

    Parameters
    ----------
    factors : sequence of str
        Names, in order.
    generators : mapping of str to (sign, names)
        Each generated factor is the sign times the product of these basic factors.

    Returns
    -------
    ndarray, shape (runs, factors)
        -1 and 1.

    Examples
    --------
    >>> fractional(["A", "B", "C"], {"C": (-1, ["A", "B"])}).astype(int).tolist()
    [[-1, -1, -1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]]
    """
    from pydoe import fracfact

    basic = [name for name in factors if name not in generators]
    letter = dict(zip(basic, LETTERS, strict=False))
    words = []
    for factor in factors:
        sign, parts = generators.get(factor, (1, [factor]))
        words.append(("-" if sign < 0 else "") + "".join(sorted(letter[p] for p in parts)))
    return _ordered(np.asarray(fracfact(" ".join(words)), dtype=float))


def by_resolution(count: int, resolution: int) -> Array:
    """Smallest two-level fraction of a number of factors with at least a resolution.

    Raises
    ------
    ValueError
        If there is none.
    """
    from pydoe import fracfact_by_res

    return _ordered(np.asarray(fracfact_by_res(count, resolution), dtype=float))


def plackett_burman(count: int) -> Array:
    """Plackett-Burman screening design (Plackett and Burman 1946, Biometrika 33, 305)."""
    from pydoe import pbdesign

    return np.asarray(pbdesign(count), dtype=float)


def central_composite(count: int, star: str = "inscribed") -> Array:
    """Rotatable central composite design, or the face-centered one (Box and Wilson 1951).

    The center stands once: a simulation repeated is the same simulation. The runs are scaled
    so that none leaves -1 to 1, for the ends of a range are its true limits.

    Parameters
    ----------
    count : int
        Number of factors, at least 2.
    star : {"inscribed", "faced"}
        Whether the star points or the corners and stars lie at the ends of the ranges.
    """
    from pydoe import ccdesign

    runs = ccdesign(count, center=(0, 1), alpha="rotatable", face=star)
    return np.asarray(runs, dtype=float)


#: blocks of factors that vary together (Box and Behnken 1960, table 4); the paper's design of nine
#: factors has three of its blocks twice, and a simulation repeated is the same simulation
_BLOCKS: Mapping[int, Sequence[tuple[int, ...]]] = {
    6: ((1, 2, 4), (2, 3, 5), (3, 4, 6), (1, 4, 5), (2, 5, 6), (1, 3, 6)),
    7: ((4, 5, 6), (1, 6, 7), (2, 5, 7), (1, 2, 4), (3, 4, 7), (1, 3, 5), (2, 3, 6)),
    9: (
        *((1, 4, 7), (2, 5, 8), (3, 6, 9), (1, 2, 3), (4, 5, 6), (7, 8, 9)),
        *((1, 5, 9), (3, 4, 8), (2, 6, 7), (1, 6, 8), (2, 4, 9), (3, 5, 7)),
    ),
    10: (
        *((2, 6, 7, 10), (1, 2, 5, 10), (2, 3, 7, 8), (2, 4, 6, 9), (1, 8, 9, 10)),
        *((3, 4, 5, 10), (1, 4, 7, 8), (3, 5, 7, 9), (1, 3, 6, 9), (4, 5, 6, 8)),
    ),
}


def box_behnken(count: int) -> Array:
    """Box-Behnken design with one center run (Box and Behnken 1960, Technometrics 2, 455).

    Within a block of an incomplete block design its factors take all combinations of -1 and 1,
    and all others are 0. Up to five factors, and for eight, which the paper leaves out, the
    blocks are all pairs.

    Parameters
    ----------
    count : int
        Number of factors, at least 3.

    Returns
    -------
    ndarray, shape (runs, count)
        -1, 0 and 1.

    Examples
    --------
    >>> [len(box_behnken(count)) for count in range(3, 11)]
    [13, 25, 41, 49, 57, 113, 97, 161]
    """
    pairs = tuple(itertools.combinations(range(1, count + 1), 2))
    runs = [
        [signs[block.index(k)] if k in block else 0.0 for k in range(1, count + 1)]
        for block in _BLOCKS.get(count, pairs)
        for signs in itertools.product((-1.0, 1.0), repeat=len(block))
    ]
    return np.array([*runs, [0.0] * count])


def latin_hypercube(count: int, runs: int, seed: int) -> Array:
    """Latin hypercube sample in 0 to 1: every factor has one run in each of ``runs`` slices."""
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    return np.asarray(qmc.LatinHypercube(count, rng=rng).random(runs), dtype=float)


def sobol(count: int, runs: int, seed: int) -> Array:
    """Scrambled Sobol sequence in 0 to 1; ``runs`` is a power of two, which keeps its balance."""
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    sampler = qmc.Sobol(count, scramble=True, rng=rng)
    return np.asarray(sampler.random_base2(int(runs).bit_length() - 1), dtype=float)


def _ordered(runs: Array) -> Array:
    """Sort the runs as a table: the last basic factor varies fastest."""
    return runs[np.lexsort(runs.T[::-1])]


MAX_CELLS = 4096
Made = tuple[tuple[Factor, ...], Scheme]

#: parent of a nested factor, and the labels that exist within each of its levels
Nests = dict[str, tuple[str, dict[str, tuple[str, ...]]]]


def full(section: Section, factors: tuple[Factor, ...]) -> Made:
    """Full factorial, without the combinations that zipped or nested factors do not have."""
    zipped = section.take("zip", lambda raw: _zip(raw, factors), ())
    nests = _nests(section, factors)
    if zipped is None or nests is None:
        return factors, Scheme()
    followers = {n for group in zipped for n in group[1:]}
    count = math.prod(len(f.levels) for f in factors if f.name not in followers)
    if count > MAX_CELLS:
        rule = f"give {count} cells, the limit is {MAX_CELLS}"
        section.faults.add("factors", rule, "use fewer levels, or several studies")
        return (), Scheme()
    if not zipped and not nests:
        return factors, Scheme()
    rows = tuple(row for row in _product(factors, zipped) if _allowed(row, factors, nests))
    told = [
        f"{' and '.join(group)} change together: nothing tells their effects apart"
        for group in zipped
    ]
    told += [
        f"{child} is nested in {parent}: its levels are compared within one level of {parent}"
        for child, (parent, _) in nests.items()
    ]
    summary = f"{len(rows)} of {math.prod(len(f.levels) for f in factors)} combinations"
    return factors, Scheme("full", rows, summary, tuple(told))


def _product(factors: Sequence[Factor], zipped: Sequence[tuple[str, ...]]) -> list[tuple[int, ...]]:
    leader = {n: group[0] for group in zipped for n in group}
    free = [f for f in factors if leader.get(f.name, f.name) == f.name]
    rows = []
    for combination in itertools.product(*(range(len(f.levels)) for f in free)):
        index = dict(zip((f.name for f in free), combination, strict=True))
        rows.append(tuple(index[leader.get(f.name, f.name)] for f in factors))
    return rows


def _allowed(row: Sequence[int], factors: Sequence[Factor], nests: Nests) -> bool:
    labels = {f.name: f.labels[i] for f, i in zip(factors, row, strict=True)}
    return all(labels[child] in within[labels[parent]] for child, (parent, within) in nests.items())


def _zip(raw: Any, factors: Sequence[Factor]) -> tuple[tuple[str, ...], ...]:
    groups = raw if isinstance(raw, list) and raw and isinstance(raw[0], list) else [raw]
    by_name = {factor.name: factor for factor in factors}
    seen: set[str] = set()
    for group in groups:
        if not isinstance(group, list) or len(group) < 2:
            raise Bad(f"must list two or more factors, got {shown(group)}", 'zip = [["A", "B"]]')
        for key in group:
            if key not in by_name:
                raise Bad(f"no factor {shown(key)}", nearest(str(key)[:80], by_name))
            if key in seen:
                raise Bad(f"{key!r} stands twice", "a factor is zipped once")
            seen.add(key)
        counts = {key: len(by_name[key].levels) for key in group}
        if len(set(counts.values())) > 1:
            words = ", ".join(f"{key} has {count}" for key, count in counts.items())
            raise Bad(f"needs equal numbers of levels: {words}", "level k goes with level k")
    return tuple(tuple(group) for group in groups)


def _nests(section: Section, factors: Sequence[Factor]) -> Nests | None:
    """Read every ``[[design.nested]]``; None where one is faulty."""
    before = len(section.faults)
    rows = section.take("nested", lambda raw: raw, [])
    if not isinstance(rows, list):
        section.fault("nested", f"must be tables, got {shown(rows)}", "write [[design.nested]]")
        return None
    found: Nests = {}
    by_name = {factor.name: factor for factor in factors}

    def known(raw: Any) -> str:
        return _known(raw, by_name)

    for i, row in enumerate(rows):
        inner = Section(row, f"design.nested[{i}]", section.faults)
        child = inner.take("factor", known)
        parent = inner.take("within", known)
        levels = inner.take("levels", lambda raw: raw, mend="{ LEVEL = [..], LEVEL = [..] }")
        inner.finish()
        if child is None or parent is None or levels is None:
            continue
        if child == parent or child in found or parent in found:
            inner.fault("within", f"{child!r} in {parent!r} is no single nesting")
            continue
        try:
            found[child] = (parent, _within(levels, by_name[child], by_name[parent]))
        except Bad as bad:
            inner.fault("levels", bad.rule, bad.mend)
    return None if len(section.faults) > before else found


def _known(raw: Any, by_name: Mapping[str, Factor]) -> str:
    label = name(raw)
    if label not in by_name:
        raise Bad(f"no factor {shown(raw)}", nearest(label, by_name))
    return label


def _within(raw: Any, child: Factor, parent: Factor) -> dict[str, tuple[str, ...]]:
    """Labels of the child within each level of the parent: every one in exactly one."""
    if not isinstance(raw, Mapping):
        raise Bad(f"must be a table, got {shown(raw)}", "{ LEVEL = [..], LEVEL = [..] }")
    found: dict[str, tuple[str, ...]] = {}
    for label, items in raw.items():
        if label not in parent.labels:
            raise Bad(f"no level {label!r} of {parent.name!r}", nearest(label, parent.labels))
        listed = items if isinstance(items, list) else [items]
        found[label] = tuple(_level(item, child) for item in listed)
    flat = [label for labels in found.values() for label in labels]
    if sorted(flat) != sorted(child.labels) or set(found) != set(parent.labels):
        rule = f"each level of {child.name!r} must stand in one level of {parent.name!r}"
        raise Bad(rule, f"levels: {', '.join(child.labels)}")
    return found


def _level(raw: Any, factor: Factor) -> str:
    label = level_label(raw)
    if label not in factor.labels:
        raise Bad(f"no level {label!r} of {factor.name!r}", nearest(label, factor.labels))
    return label


def listed(section: Section, factors: tuple[Factor, ...]) -> Made:
    """Exactly the treatments of a list, in its order."""
    rows = section.take("treatments", lambda raw: _treatments(raw, factors),
                        mend="list the cells: treatments = [{ A = .., B = .. }]")  # fmt: skip
    if rows is None:
        return factors, Scheme()
    count = math.prod(len(factor.levels) for factor in factors)
    note = (
        "only the listed cells are run: terms that they do not separate are named by the analysis"
    )
    summary = f"{len(rows)} listed of {count} combinations"
    return factors, Scheme("listed", rows, summary, (note,))


def _treatments(raw: Any, factors: Sequence[Factor]) -> tuple[tuple[int, ...], ...]:
    if not isinstance(raw, list) or not 2 <= len(raw) <= MAX_CELLS:
        raise Bad(f"must list 2 to {MAX_CELLS} treatments, got {shown(raw)}")
    rows = []
    for i, item in enumerate(raw):
        given = flatten(item) if isinstance(item, Mapping) else {}
        wrong = [f.name for f in factors if f.name not in given]
        extra = [key for key in given if key not in {f.name for f in factors}]
        if wrong or extra:
            what = f"has no {wrong[0]!r}" if wrong else f"names no factor with {extra[0]!r}"
            raise Bad(f"treatment {i + 1} {what}", "each treatment gives one level of every factor")
        rows.append(tuple(f.labels.index(_level(given[f.name], f)) for f in factors))
    twice = next((row for i, row in enumerate(rows) if row in rows[:i]), None)
    if twice is not None:
        again = rows.index(twice) + 1
        raise Bad(f"treatment {again} stands twice", "the same simulation is no replicate")
    for f, column in zip(factors, zip(*rows, strict=True), strict=True):
        if len(set(column)) < len(f.levels):
            unused = next(lv for i, lv in enumerate(f.labels) if i not in column)
            raise Bad(f"no treatment has {f.name} = {unused!r}", "leave the level out")
    return tuple(rows)


def model_terms(scheme: Scheme, factors: Sequence[Factor]) -> tuple[str, ...] | None:
    """Terms of zipped and nested factors; None for a full factorial.

    Of zipped factors the first stands for all; a nested factor stands only beside its parent.
    """
    if scheme.rows is None:
        return None
    columns = {f.name: c for f, c in zip(factors, zip(*scheme.rows, strict=True), strict=True)}
    kept: list[str] = []
    for factor in factors:
        if not any(_same(columns[factor.name], columns[other]) for other in kept):
            kept.append(factor.name)
    parents = {
        child: parent
        for child in kept
        for parent in kept
        if child != parent and _determines(columns[child], columns[parent])
    }
    terms = [
        term
        for order in range(1, len(kept) + 1)
        for term in itertools.combinations(kept, order)
        if all(parents[n] in term for n in term if n in parents)
    ]
    return tuple(":".join(term) for term in terms)


def _determines(column: Sequence[int], other: Sequence[int]) -> bool:
    """Whether the level of one factor says the level of another."""
    pairs = set(zip(column, other, strict=True))
    return len(pairs) == len(set(column))


def _same(column: Sequence[int], other: Sequence[int]) -> bool:
    return _determines(column, other) and _determines(other, column)
