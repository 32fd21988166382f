"""Rows of a table as one analysis takes them: response, coded levels, blocks, what is missing."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations, compress, permutations, product
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Ints, gathered
from study.ground.errors import Fault, InputError, RefusedError, UnitError
from study.ground.tabular import NUMBER, _check_names, names_of
from study.ground.units import converted, split
from study.statistics.analysis.linear_model import CellLayout, Term
from study.statistics.analysis.sums_of_squares import two_way

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Data:
    """One checked response: rows without a response are counted, never lost silently."""

    y: Array
    layout: CellLayout
    factors: tuple[str, ...]
    #: Columns of all blocks: the first, and those that cross it (a Latin square).
    blocks: tuple[str, ...]
    rows: Ints
    missing: int
    warnings: tuple[str, ...]

    @property
    def block(self) -> str | None:
        """Column of the first blocks."""
        return self.blocks[0] if self.blocks else None

    @property
    def cell(self) -> Ints:
        """Index of the cell of each row in the full grid of the factors."""
        return self.layout.cell(self.factors)

    def cell_names(self) -> list[str]:
        """Names of all cells of the full grid, in the order of their index."""
        return [" ".join(c) for c in product(*(self.layout.levels[f] for f in self.factors))]


def prepare(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    block: str | Sequence[str] | None = None,
) -> Data:
    """Check a table and code its factors."""
    factors, blocks = [str(name) for name in factors], names_of(block)
    _check_names("table", [str(c) for c in table.columns], response, factors, blocks)
    raw = _response(table, response)
    coded = {n: _labels(table[n], n) for n in [*factors, *blocks]}
    keep = np.isfinite(raw)
    missing, warnings = np.flatnonzero(~keep), []
    if missing.size:
        listed = ", ".join(str(i + 1) for i in missing[:10]) + ", ..." * (missing.size > 10)
        where = f"{missing.size} of {keep.size} rows (rows {listed})"
        warnings.append(f"{response} is missing in {where}")
    if keep.sum() < 2:
        rule = f"has {int(keep.sum())} values"
        mend = "an analysis needs two rows with a response, and better more"
        raise InputError(Fault(f"response {response!r}", rule, mend))
    faults, levels, codes = [], {}, {}
    for name, (code, every) in coded.items():
        present = {every[i] for i in np.unique(code[keep])}
        warnings += _alike(every, name)
        order = [level for level in every if level in present]
        if lost := [level for level in every if level not in present]:
            warnings.append(f"{name}: no response at level {', '.join(lost)}")
        if len(order) < 2:
            kind = "block" if name in blocks else "factor"
            others = [other for other in factors if other != name]
            option = f" (--factors {','.join(others)})" if kind == "factor" and others else ""
            mend = f"leave the {kind} out{option}, or add rows with another level"
            if lost:
                mend = f"level {', '.join(lost)} has no response: {mend}"
            rule = f"needs at least two levels, got {order}"
            faults.append(Fault(f"{kind} {name!r}", rule, mend))
        index = {level: i for i, level in enumerate(order)}
        levels[name] = tuple(order)
        codes[name] = np.array([index.get(label, -1) for label in every])[code[keep]]
    if faults:
        raise InputError(faults)
    layout, rows = CellLayout(levels, codes), np.flatnonzero(keep)
    return Data(raw[keep], layout, tuple(factors), blocks, rows, missing.size, tuple(warnings))


def _response(table: pd.DataFrame, response: str) -> Array:
    import pandas as pd

    column = table[response]
    if not (pd.api.types.is_numeric_dtype(column) or column.isna().all()):
        bad = pd.to_numeric(column, errors="coerce").isna() & column.notna()
        if bad.any():
            row, rule = bad.idxmax(), f"{column[bad].iloc[0]!r} is not a number"
            raise InputError(Fault(f"row {row}, column {response!r}", rule))
        column = pd.to_numeric(column)
    values = np.asarray(column.to_numpy(dtype=float, na_value=math.nan), dtype=float)
    _check_range(values, response)
    return values


#: Largest size and smallest spread of a response. Sphericity takes fourth powers of differences,
#: which leave the range of doubles (1e-308 to 1e308) beyond 1e77 and below 1e-77.
LARGEST = 1e60
SMALLEST = 1e-60


def _check_range(values: Array, response: str) -> None:
    """Refuse numbers whose powers overflow or vanish."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return
    size = float(np.abs(finite).max())
    if size > LARGEST:
        row = int(np.flatnonzero(np.abs(values) == size)[0]) + 1
        rule = f"{size:.3g} is too large: the squares of such numbers overflow"
        mend = f"write {response!r} in a larger unit, or correct the value"
        raise InputError(Fault(f"row {row}, column {response!r}", rule, mend))
    spread = float(np.ptp(finite))
    if 0 < spread < SMALLEST:
        rule = f"the values differ by {spread:.3g} at most, and the squares of that vanish"
        mend = f"write {response!r} in a smaller unit"
        raise InputError(Fault(f"column {response!r}", rule, mend))


def _alike(levels: Sequence[str], name: str) -> list[str]:
    """Say which levels may be one level, written twice: by letters, or as a number with a unit."""
    by_letters = gathered(("".join(level.split()).casefold(), level) for level in levels)
    alike = [(same, "differ in capitals or spaces alone") for same in by_letters.values()]
    quantities = {}
    for level in levels:
        with suppress(UnitError):
            plain = NUMBER.fullmatch(level)
            quantities[level] = (float(level), "") if plain else split(level)
    units = list(dict.fromkeys(unit for _, unit in quantities.values()))
    sizes = dict(quantities)
    for other, level in product(reversed(units), quantities):
        # in the first of the units that is of its kind, with the digits that conversion keeps
        with suppress(UnitError):
            size = converted(*quantities[level], other)
            sizes[level] = float(f"{size:.12g}"), other
    by_size = gathered((size, level) for level, size in sizes.items())
    spelt = by_letters.values()
    alike += [(same, "are one quantity") for same in by_size.values() if same not in spelt]
    alike += [(same, "are one date") for same in _dates(levels) if same not in spelt]
    return [
        f"{name}: the levels {' and '.join(map(repr, same))} {how} and are taken for different "
        "ones: write them the same way if they are one"
        for same, how in alike
        if len(same) > 1
    ]


#: separators of the parts of a date
_BETWEEN = re.compile(r"[-./ ]+")
#: behind a date
_MIDNIGHT = re.compile(r"[T ]0?0:00.*")
#: spellings of a date
_DATES = ("%Y-%m-%d", "%d-%m-%Y", "%d-%b-%Y", "%d-%B-%Y")


def _dates(levels: Sequence[str]) -> list[list[str]]:
    """List levels of one date, in several spellings; with slashes the month may stand first."""
    groups, with_year = [], [level for level in levels if re.search(r"\d{4}", level)]
    for formats in (_DATES, ("%Y-%m-%d", "%m-%d-%Y")):
        dated = []
        for level, kind in product(with_year, formats):
            is_swapped = kind == "%m-%d-%Y" and "/" not in level
            with suppress(ValueError):
                text = _BETWEEN.sub("-", _MIDNIGHT.sub("", level.strip()))
                dated.append((datetime.strptime(text, _DATES[1] if is_swapped else kind), level))
        alike = [same for same in gathered(dated).values() if len(same) > 1]
        groups += [same for same in alike if same not in groups]
    return groups


def _labels(column: pd.Series, name: str) -> tuple[Ints, list[str]]:
    """Index of the label of every row, and all labels in order.

    That is the order of the categories, numeric where all are numbers, else as met.
    """
    import pandas as pd

    if column.isna().any():
        row = int(np.flatnonzero(column.isna().to_numpy())[0]) + 1
        raise InputError(Fault(f"row {row}, column {name!r}", "the level is empty"))
    # 1, 1.0 and True are equal keys, so the type goes along
    typed = [(type(value), value) for value in column] if column.dtype == object else column
    code, keys = pd.factorize(pd.Series(typed))
    values = [key[1] for key in keys] if column.dtype == object else list(keys)
    texts = list(map(_label, values))
    seen: dict[str, object] = {}
    for value, text in zip(values, texts, strict=True):
        first = seen.setdefault(text.strip(), value)
        if isinstance(first, str) != isinstance(value, str) or _label(first) != text:
            rule = f"the levels {first!r} and {value!r} look the same"
            raise InputError(Fault(f"column {name!r}", rule, "write both the same way"))
    labels = list(dict.fromkeys(texts))
    if hasattr(column, "cat"):
        labels = [label for label in map(_label, column.cat.categories) if label in labels]
    elif all(map(NUMBER.fullmatch, labels)):
        labels.sort(key=float)
    index = {label: i for i, label in enumerate(labels)}
    return np.array([index[text] for text in texts])[code], labels


def _label(value: object) -> str:
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return str(value)


@dataclass(frozen=True)
class Crossed:
    """A complete table of cells against blocks."""

    #: shape (cells, blocks); response, repeats of one cell in one block averaged.
    y: Array
    layout: CellLayout
    blocks: tuple[str, ...]
    warnings: tuple[str, ...]


def crossed(data: Data, y: Array) -> Crossed:
    """Cells against blocks of y (n,); incomplete cells and blocks are left out, and said."""
    block = data.block or ""
    names = data.layout.levels[block]
    cells, start, index = np.unique(data.cell, return_index=True, return_inverse=True)
    table = np.full((cells.size, len(names)), np.nan)
    table[index, data.layout.codes[block]] = y
    filled = np.isfinite(table)
    keep_cells = filled.mean(axis=1) > 0.5
    keep_blocks = filled[keep_cells].all(axis=0)
    labels, warnings = data.cell_names(), []
    if lost := [labels[c] for c in cells[~keep_cells]]:
        warnings.append(f"cells missing in half of the blocks are left out: {', '.join(lost)}")
    if gone := list(compress(names, ~keep_blocks)):
        warnings.append(f"incomplete blocks are left out: {', '.join(gone)}")
    first = start[keep_cells]
    layout = data.layout.take(first) if first.size else data.layout
    # a level without a cell left would make its siblings impossible to compare
    present = {f: np.unique(layout.codes[f], return_inverse=True) for f in data.factors}
    only = CellLayout(
        {f: tuple(layout.levels[f][i] for i in at) for f, (at, _) in present.items()},
        {f: code.astype(np.int64) for f, (_, code) in present.items()},
    )
    blocks, complete = tuple(compress(names, keep_blocks)), np.ix_(keep_cells, keep_blocks)
    return Crossed(table[complete], only, blocks, tuple(warnings))


# -------------------------------------------------------------------------------------------------
# What a table is, before anything is fitted: copies, resolution, nesting, empty cells.

#: decimals beyond which a response is a computed number, not a reading
_MOST_DECIMALS = 9
#: chance of the ties that are seen below which rows are taken for copies
_CHANCE = 1e-4
#: share of repeated rows from which they are taken for copies
_LEAST_SHARE = 0.2
#: distinct rows from which equal numbers of copies of each are no chance
DISTINCT_ROWS = 8
#: part of a cell's scatter within which neighbours tell how densely its rows lie
_NEARBY = 0.1
#: pairs of blocks that are compared value by value
_MOST_BLOCKS = 200
#: parts of the scatter to which copies agree whose last digits were changed
_NEAR = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
#: rows of a table in which such copies are looked for
_MOST_ROWS = 5000
#: part of the interactions' scatter that a copied block may lie apart
_FARTHEST = 1e-3


@dataclass(frozen=True)
class Structure:
    """What a table is, before a model is fitted."""

    #: Step of the readings in the unit of the response, their root mean square where levels were
    #: read with different steps; 0 where none shows.
    resolution: float = 0.0
    #: Factors whose levels each lie in one level of another factor: (inner, outer).
    nested: tuple[tuple[str, str], ...] = ()
    #: Combinations of levels without a row.
    empty_cells: int = 0
    #: Factors with one level in every block.
    constant_in_blocks: tuple[str, ...] = ()
    #: Why factors are not judged whose terms the runs cannot tell from others; empty if none.
    undecided: str = ""
    #: Terms of the model with those; empty where none was left out.
    asked: tuple[Term, ...] = ()


def structure_of(data: Data) -> Structure:
    """Look at checked rows."""
    size = math.prod(len(data.layout.levels[f]) for f in data.factors)
    empty = size - np.unique(data.cell).size
    levels = {name: len(data.layout.levels[name]) for name in data.factors}
    nested = [
        (inner, outer)
        for inner, outer in permutations(data.factors if empty else (), 2)
        if np.unique(data.layout.cell([inner, outer])).size == levels[inner] > levels[outer]
    ]
    return Structure(_step_of_readings(data), tuple(nested), empty, constant_in_blocks(data))


def constant_in_blocks(data: Data) -> tuple[str, ...]:
    """Factors with one level in every block."""
    if data.block is None:
        return ()
    blocks = np.unique(data.layout.codes[data.block]).size
    pairs = {f: np.unique(data.layout.cell([data.block, f])).size for f in data.factors}
    return tuple(f for f in data.factors if pairs[f] == blocks)


def blocks_that_lack_cells(data: Data, factors: Sequence[str]) -> tuple[int, int]:
    """Count the blocks that lack some cell of these factors, and all blocks."""
    cell = np.unique(data.layout.cell(factors), return_inverse=True)[1]
    pairs = np.unique(np.column_stack([data.layout.codes[str(data.block)], cell]), axis=0)
    cells = np.bincount(pairs[:, 0])
    return int((cells < cell.max() + 1).sum()), cells.size


def _decimals(y: Array) -> Array:
    """Decimals of values (n,); infinite for computed ones, with ten after the first or more."""
    decimals = np.full(y.size, np.inf)
    scale = float(np.abs(y).max(initial=0.0))
    # of small numbers those after their first digit count, whatever the unit
    first = max(0, -math.floor(math.log10(scale))) if scale else 0
    for digits in range(first, first + _MOST_DECIMALS + 1):
        if scale * 10.0**digits > 1e15:
            break
        units = y * 10.0**digits
        is_whole = np.abs(units - np.round(units)) <= 1e-6 + 4e-16 * scale * 10.0**digits
        decimals[is_whole & np.isinf(decimals)] = digits
        if np.isfinite(decimals).all():
            break
    return decimals


def resolution(y: Array, decimals: Array | None = None) -> float:
    """Largest step of which all values are multiples; 0 for values with ten decimals or more."""
    most = float(np.max(_decimals(y) if decimals is None else decimals, initial=0.0))
    if math.isinf(most):
        return 0.0
    step = int(np.gcd.reduce(np.round(y * 10.0**most).astype(np.int64)))
    return step * math.pow(10.0, -most)


def _step_of_readings(data: Data) -> float:
    """Step of the readings: the root mean square where levels were read with different steps."""
    decimals = _decimals(data.y)
    steps = np.full(data.y.size, resolution(data.y, decimals))
    written = decimals[np.isfinite(decimals)]
    finest = float(written.max(initial=0.0)) + (written.size < decimals.size)
    for name, code in data.layout.codes.items():
        count, most = np.bincount(code), np.zeros(len(data.layout.levels[name]))
        np.maximum.at(most, code, decimals)
        # so many values without the last decimals are no chance
        for level in np.flatnonzero(count * (finest - most) > -math.log10(_CHANCE / count.size)):
            here = code == level
            unit = 10.0 ** -float(most[level])
            # an instrument reads in steps of 1, 2 or 5; a wider step is the measured quantity's
            of_unit = resolution(data.y[here], decimals[here]) / unit
            if np.ptp(data.y[here]):
                steps[here] = np.maximum(steps[here], unit * math.gcd(round(of_unit), 10))
    return float(steps[0]) if not np.ptp(steps) else float(np.sqrt(np.mean(steps**2)))


def refuse_copied_rows(data: Data) -> None:
    """Refuse rows that repeat others, more often or more closely than chance explains."""
    copies = ""
    if data.block is None:
        near = _NEAR if data.y.size <= _MOST_ROWS else ()
        texts = (_copied_within(data, part) for part in (0.0, *near))
        copies = next(filter(None, texts), "")
    elif len(data.blocks) == 1 and (twins := _copied_blocks(data, data.layout.codes[data.block])):
        names = data.layout.levels[data.block]
        listed = ", ".join(f"{names[j]} repeats {names[i]}" for i, j, _ in twins[:5])
        apart = max(apart for *_, apart in twins)
        copies = f"to within {apart:.2g}" if apart else "in every digit"
        copies = f"{copies} {data.block} {listed}"
    if copies:
        limit = rows_at_limit(data)
        raise RefusedError(
            f"{limit}; "
            * bool(limit)
            + f"copied rows: {copies}. Copies tell nothing new: leave them out; where every one "
            "of them was measured, say --copies independent"
        )


def rows_at_limit(data: Data) -> str:
    """Describe rows that share the smallest or the largest value, more often than by chance.

    Readings end at a limit of detection, or where an instrument ends; rows of cells without any
    spread do not count.
    """
    _, cell = np.unique(data.cell, return_inverse=True)
    centred = data.y - data.y[0]
    residual = centred - (np.bincount(cell, centred) / np.bincount(cell))[cell]
    varies = (np.bincount(cell, np.abs(residual)) > 0)[cell]
    n, cells = int(varies.sum()), np.unique(cell[varies]).size
    if n <= cells:
        return ""
    sd = math.sqrt(float(np.sum(residual[varies] ** 2)) / (n - cells))
    chance = min(1.0, 3 * chance_of_tie(_least_step(data.y), sd))
    for value, which in ((data.y.min(), "smallest"), (data.y.max(), "largest")):
        rows = int((data.y[varies] == value).sum())
        if rows > 1 and n * chance ** (rows - 1) < _CHANCE:
            return (
                f"{rows} of {n} rows are {value:g}, the {which} value: readings that end at a "
                "limit (of detection, of an instrument) are to be left empty, for they move means"
            )
    return ""


def _copied_within(data: Data, part: float) -> str:
    """Describe rows of a cell that lie no farther apart than this part of its scatter."""
    from scipy.special import pdtrc

    cell = np.unique(data.cell, return_inverse=True)[1]
    order = np.lexsort((data.y, cell))
    cell, y = cell[order], data.y[order]
    gap = np.where(np.diff(cell) > 0, np.inf, np.diff(y))
    distinct = np.flatnonzero(np.append(True, gap > 0))
    apart = part * _spreads(cell[distinct], y[distinct])
    begins = np.append(True, gap > apart[cell[1:]])
    ends = np.flatnonzero(np.append(begins[1:], True))
    # a chain of rows that is longer than copies can lie apart is where rows are dense
    dense = y[ends] - y[begins] > 2 * apart[cell[ends]]
    first = np.flatnonzero(begins | dense[np.cumsum(begins) - 1])
    counts = np.diff(np.append(first, y.size))
    spread = _spreads(cell[first], y[first])
    varies = spread > 0  # a cell without spread is told as such
    clusters = first[varies[cell[first]]]
    counts, index = counts[varies[cell[first]]], cell[clusters]
    n = int(counts.sum())
    repeats = n - counts.size
    if not repeats:
        return ""
    times = int(np.gcd.reduce(counts))
    how = f" to within {apart[varies].max():.2g}" if part else ""
    every = f"each row stands {times} times{how} ({counts.size} distinct rows of {n})"
    if times > 1 and counts.size >= DISTINCT_ROWS and not part:
        return every
    size = spread.size
    rows = np.bincount(index, counts, minlength=size)
    ties = np.bincount(index, counts * (counts - 1) / 2, minlength=size)
    pairs = rows * (rows - 1) / 2
    # readings that were coarse before they were computed with tie between cells as well
    in_order = np.sort(y[varies[cell]])
    breaks = np.flatnonzero(np.append(True, np.diff(in_order) > float(np.median(apart[varies]))))
    total = np.diff(np.append(breaks, n)).astype(float)
    elsewhere = float(np.sum(total * (total - 1)) / 2 - ties.sum())
    between = n * (n - 1) / 2 - float(pairs.sum())
    step = _least_step(data.y)
    wide = np.maximum(_NEARBY, 1.5 * step / np.where(varies, spread, np.inf))
    density = _density(y[clusters], index, counts, wide, spread) / np.maximum(pairs, 1)
    chance = (step + 2 * apart) / np.where(varies, spread, np.inf)
    chance *= np.maximum(1 / (2 * math.sqrt(math.pi)), density / (2 * wide))
    chance = np.clip(chance, max(2 * elsewhere / between, 0.0) if between else 0.0, 1.0)
    # whether so many ties are chance, where readings cluster threefold; several in one cell are
    # looked at by themselves
    expected = 3 * pairs * chance
    several = np.bincount(index, counts > 1, minlength=size) > 1
    copied = several & (ties > 0) & (size * pdtrc(np.maximum(ties - 1, 0), expected) < _CHANCE)
    copied &= rows - np.bincount(index, minlength=size) >= _LEAST_SHARE * rows
    if repeats >= _LEAST_SHARE * n and pdtrc(ties.sum() - 1, expected.sum()) < _CHANCE:
        return every if times > 1 else f"{repeats} of {n} rows repeat another of their cell{how}"
    if not copied.any():
        return ""
    here = copied[index]
    repeats, n = int(np.sum(counts[here] - 1)), int(rows[copied].sum())
    label = data.cell_names()[int(np.unique(data.cell)[np.flatnonzero(copied)[0]])]
    return f"{repeats} of {n} rows repeat another of their cell{how}, as in {label}"


def _density(y: Array, cell: Ints, counts: Ints, wide: Array, spread: Array) -> Array:
    """Pairs of rows of each cell that lie apart, but no farther than ``wide`` of its scatter.

    Clusters of rows are sorted by cell and value.
    """
    start = np.searchsorted(cell, np.arange(spread.size))
    above = (y - y[np.minimum(start, y.size - 1)][cell]) / spread[cell]
    position = 3e6 * cell + np.minimum(above, 1e6)
    rows = np.append(0, np.cumsum(counts))
    to = np.searchsorted(position, position + wide[cell], side="right")
    within = counts * (rows[to] - rows[1:])
    return np.bincount(cell, within, minlength=spread.size).astype(float)


def _spreads(cell: Ints, y: Array) -> Array:
    """Median absolute deviation in each cell, of rows that are sorted by cell and value."""
    count = np.bincount(cell)
    start = np.cumsum(count) - count

    def medians(values: Array) -> Array:
        middle = values[start + (count - 1) // 2] + values[start + count // 2]
        return np.asarray(middle / 2)

    away = np.abs(y - medians(y)[cell])
    # of normal readings this is the standard deviation
    return 1.4826 * medians(away[np.lexsort((away, cell))])


def _least_step(y: Array) -> float:
    """Step of the readings, that of doubles where none shows."""
    return resolution(y) or 16 * float(np.spacing(np.abs(y).max()))


def chance_of_tie(step: float, sd: float) -> float:
    """Chance that two normal readings agree: step times the integral of the squared density."""
    return min(1.0, step / (2 * math.sqrt(math.pi) * sd)) if sd > 0 else 1.0


def _copied_blocks(data: Data, block: Ints) -> list[tuple[int, int, float]]:
    """Pairs of blocks whose values agree in every cell that both have, and how far apart they are.

    Blocks that are alike agree in their mean as well; a copy agrees in its interaction with the
    cells too, far below how that scatters.
    """
    cells, index = np.unique(data.cell, return_inverse=True)
    blocks = int(block.max()) + 1
    if not 2 <= blocks <= _MOST_BLOCKS or cells.size < 2:
        return []
    table = np.full((blocks, cells.size), np.nan)
    table[block, index] = data.y
    with np.errstate(invalid="ignore"):
        centred = table - np.nanmean(table, axis=0)
    sd = float(np.sqrt(np.nanmean(centred**2)))
    at_block, at_cell = np.nonzero(np.isfinite(table))
    residual = two_way(at_block, at_cell, table[at_block, at_cell]).residual
    interaction = float(np.sqrt(np.mean(residual**2)))
    pairs, step, twins = blocks * (blocks - 1) / 2, _least_step(data.y), []
    for i, j in combinations(range(blocks), 2):
        apart = table[i] - table[j]
        both = int(np.isfinite(apart).sum())
        farthest = float(np.nanmax(np.abs(apart))) if both > 1 else math.inf
        if both > 1 and farthest > _FARTHEST * interaction:
            # one that was copied and moved, as by another zero, keeps its interaction
            farthest = float(np.nanmax(np.abs(apart - np.nanmedian(apart))))
            farthest = max(farthest, float(np.spacing(np.abs(data.y).max())))
        if farthest == 0:
            chance = (3 * chance_of_tie(step, sd)) ** both
        else:
            chance = (3 * chance_of_tie(step + 2 * farthest, interaction)) ** (both - 1)
        if farthest <= _FARTHEST * interaction and pairs * chance < _CHANCE:
            twins.append((i, j, farthest))
    return twins
