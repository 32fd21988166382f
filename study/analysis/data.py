"""What may be asked of an analysis, checked once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis.effects.numerical_bound import NumericalBound, bound_of
from study.analysis.linear_model.design_matrix import Layout
from study.arrays import Array, Ints
from study.errors import Fault, InputError, nearest
from study.tidy_csv import _NUMBER, _check_names, names_of

if TYPE_CHECKING:
    import pandas as pd

_CHOICES = {
    "type": ("auto", "I", "II", "III"),
    "transform": ("none", "log"),
    "error": ("auto", "pooled", "own"),
    "replicates": ("auto", "runs", "mesh-seeds", "noise"),
}


@dataclass(frozen=True)
class Options:
    """Options of one analysis; see :func:`study.analysis.analyze`."""

    block: tuple[str, ...] = ()
    unit: str | None = None
    whole_plot: tuple[str, ...] = ()
    replicates: str = "auto"
    type: str = "auto"
    model: Any = "full"
    error: str = "auto"
    records: bool = False
    tolerance: float | None = None
    practical: Any = None
    transform: str = "none"
    u_num: float | Mapping[str, float] | NumericalBound | None = None
    specimens: int | None = None
    alpha: float = 0.05
    seed: int = 2011
    exact: bool = True

    def check(self) -> None:
        """Raise for every option outside its range.

        Raises
        ------
        InputError
            Naming all of them at once.
        """
        faults = []
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                listed = f"{', '.join(choices[:-1])} or {choices[-1]}"
                faults.append(Fault(name, f"must be {listed}, got {value!r}"))
        if not 0 < self.alpha < 1:
            faults.append(Fault("alpha", f"must be between 0 and 1, got {self.alpha!r}"))
        if self.error == "own" and not self.block:
            mend = "name the replicated unit with --block"
            rule = "'own' tests against interactions with the blocks, but no block is named"
            faults.append(Fault("error", rule, mend))
        if self.error == "own" and len(self.block) > 1:
            faults.append(Fault("error", "'own' needs one block; several that cross are pooled"))
        if self.whole_plot and len(self.block) != 1:
            faults.append(Fault("whole plot", "needs the block in which the plots lie, one column"))
        if isinstance(self.u_num, Mapping):
            faults += [f for name, u in self.u_num.items() for f in _unusable(f"u_num {name}", u)]
        elif isinstance(self.u_num, int | float):
            faults += _unusable("u_num", self.u_num)
        if faults:
            raise InputError(faults)

    def bound(self, terms: Iterable[str], unit: float) -> NumericalBound | None:
        """Numerical uncertainty of every difference, on the working scale.

        Raises
        ------
        InputError
            If one is given for what is no term.
        """
        if not isinstance(self.u_num, Mapping):
            return bound_of(self.u_num, unit)
        known = list(terms)
        strange = [name for name in self.u_num if name not in known]
        if strange:
            raise InputError(
                [Fault("u_num", f"{n!r} is no term", nearest(n, known)) for n in strange]
            )
        return bound_of({n: float(u) for n, u in self.u_num.items() if u is not None}, unit)


def _unusable(where: str, u: float | None) -> list[Fault]:
    if u is None or (math.isfinite(u) and u >= 0):
        return []
    mend = "leave it out where it is not known; 0 means that there is none"
    return [Fault(where, f"must be zero or a positive number, got {u!r}", mend)]


@dataclass(frozen=True)
class Data:
    """One checked response: rows without a response are counted, never lost silently."""

    y: Array
    layout: Layout
    factors: tuple[str, ...]
    block: str | None
    rows: Ints
    missing: int
    warnings: tuple[str, ...]
    also: tuple[str, ...] = ()

    @property
    def blocks(self) -> tuple[str, ...]:
        """Columns of all blocks: the first, and those that cross it (a Latin square)."""
        return (*((self.block,) if self.block else ()), *self.also)

    @property
    def cell(self) -> Ints:
        """Index of the cell of each row in the full grid of the factors."""
        return self.layout.cell(self.factors)

    def cell_names(self) -> list[str]:
        """Names of all cells of the full grid, in the order of their index."""
        from itertools import product

        return [" ".join(c) for c in product(*(self.layout.levels[f] for f in self.factors))]


def prepare(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    block: str | Sequence[str] | None = None,
) -> Data:
    """Check a table and code its factors.

    Raises
    ------
    InputError
        For unknown columns, a factor with one level, text responses, labels that clash.
    """
    factors, blocks = [str(name) for name in factors], names_of(block)
    _check_names("table", [str(c) for c in table.columns], response, factors, blocks)
    raw = _response(table, response)
    labels = {n: _labels(table[n], n) for n in [*factors, *blocks]}
    keep = np.isfinite(raw)
    warnings = _missing_warning(keep, response)
    if keep.sum() < 2:
        raise InputError(Fault(f"response {response!r}", f"has {int(keep.sum())} values"))
    faults, levels, codes = [], {}, {}
    for name, text in labels.items():
        order = _level_order(table[name], text)
        present = set(text[keep])
        lost = [level for level in order if level not in present]
        if lost:
            warnings.append(f"{name}: no response at level {', '.join(lost)}")
        order = [level for level in order if level in present]
        if len(order) < 2:
            kind = "block" if name in blocks else "factor"
            faults.append(Fault(f"{kind} {name!r}", f"needs at least two levels, got {order}"))
        index = {level: i for i, level in enumerate(order)}
        levels[name] = tuple(order)
        codes[name] = np.array([index[t] for t in text[keep]], dtype=np.int64)
    if faults:
        raise InputError(faults)
    return Data(
        raw[keep],
        Layout(levels, codes),
        tuple(factors),
        blocks[0] if blocks else None,
        np.flatnonzero(keep),
        int((~keep).sum()),
        tuple(warnings),
        blocks[1:],
    )


def _response(table: pd.DataFrame, response: str) -> Array:
    import pandas as pd

    column = table[response]
    if not (pd.api.types.is_numeric_dtype(column) or column.isna().all()):
        bad = pd.to_numeric(column, errors="coerce").isna() & column.notna()
        if bad.any():
            row = column.index[bad.to_numpy()][0]
            raise InputError(
                Fault(f"row {row}, column {response!r}", f"{column[row]!r} is not a number")
            )
        column = pd.to_numeric(column)
    return np.asarray(column.to_numpy(dtype=float, na_value=math.nan), dtype=float)


def _missing_warning(keep: Any, response: str) -> list[str]:
    lost = np.flatnonzero(~keep)
    if not lost.size:
        return []
    listed = ", ".join(str(i + 1) for i in lost[:10]) + (", ..." if lost.size > 10 else "")
    return [f"{response} is missing in {lost.size} of {keep.size} rows (rows {listed})"]


def _labels(column: pd.Series, name: str) -> Any:
    if column.isna().any():
        row = int(np.flatnonzero(column.isna().to_numpy())[0]) + 1
        raise InputError(Fault(f"row {row}, column {name!r}", "the level is empty"))
    # 1, 1.0 and True are equal keys, so the type goes along
    keys = [(type(value), value) for value in column.tolist()]
    label = {key: _label(key[1]) for key in dict.fromkeys(keys)}
    seen: dict[str, Any] = {}
    for (_, value), text in label.items():
        first = seen.setdefault(text.strip(), value)
        if isinstance(first, str) != isinstance(value, str) or _label(first) != text:
            raise InputError(
                Fault(
                    f"column {name!r}",
                    f"the levels {first!r} and {value!r} look the same",
                    "write both the same way",
                )
            )
    return np.array([label[key] for key in keys], dtype=object)


def _label(value: Any) -> str:
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return str(value)


def _level_order(column: pd.Series, labels: Any) -> list[str]:
    """Order of the levels: of the categories, numeric where all are numbers, else as met."""
    if hasattr(column, "cat"):
        found = set(labels)
        return [_label(c) for c in column.cat.categories if _label(c) in found]
    unique = list(dict.fromkeys(labels))
    if all(_NUMBER.fullmatch(label) for label in unique):
        return sorted(unique, key=float)
    return unique


_TEXT = re.compile(r"^\s*(?P<value>\d+(\.\d*)?([eE][+-]?\d+)?|\.\d+)\s*(?P<unit>[^\d\s].*?)?\s*$")


@dataclass(frozen=True)
class Threshold:
    """A practical difference: absolute in the response's unit, or a fraction of the mean."""

    value: float
    relative: bool = False

    def on_scale(self, mean: float, transform: str) -> float:
        """Half-width of the practical band on the working scale.

        Parameters
        ----------
        mean : float
            Mean of the response (geometric for a log response).
        transform : {"none", "log"}
            On the log scale '10 % of mean' is the ratio 1.10, so ln 1.10.

        Examples
        --------
        >>> round(math.exp(Threshold(0.10, relative=True).on_scale(25.0, "log")), 10)
        1.1
        """
        if transform == "log":
            return math.log1p(self.value if self.relative else self.value / abs(mean))
        return self.value * abs(mean) if self.relative else self.value


def threshold(practical: Any) -> Threshold | None:
    """Read a practical difference: None, a number, text, or an object with value and relative.

    Raises
    ------
    InputError
        If it is not a positive difference.

    Examples
    --------
    >>> threshold("10 % of mean")
    Threshold(value=0.1, relative=True)
    >>> threshold("0.5 pp")
    Threshold(value=0.5, relative=False)
    """
    if practical is None or isinstance(practical, Threshold):
        return practical
    if isinstance(practical, str):
        found = _parse(practical)
    elif isinstance(practical, int | float):
        found = Threshold(float(practical))
    else:
        relative = bool(getattr(practical, "relative", False))
        value = float(practical.value)
        percent = relative and "%" in str(getattr(practical, "unit", "") or "")
        found = Threshold(value / 100 if percent else value, relative)
    if not (math.isfinite(found.value) and found.value > 0):
        raise InputError(Fault("practical", f"must be a positive difference, got {practical!r}"))
    return found


def _parse(text: str) -> Threshold:
    match = _TEXT.match(text)
    if match is None:
        raise InputError(
            Fault("practical", f"cannot read {text!r}", "write '0.5 pp', '0.05 N' or '5 % of mean'")
        )
    value, unit = float(match["value"]), " ".join((match["unit"] or "").split())
    if unit.replace(" ", "") == "%ofmean":
        return Threshold(value / 100, relative=True)
    if unit == "%":
        raise InputError(
            Fault("practical", f"{text!r} can mean two things", "write 'pp' or '% of mean'")
        )
    return Threshold(value)
