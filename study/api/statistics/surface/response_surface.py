"""Runs of a table, and the surface that suits them, with what it means."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np

from study.analysis.request import threshold
from study.arrays import Array, Flags
from study.errors import Fault, InputError, RefusedError, nearest
from study.reporting.text import count
from study.response_surface.emulator.blocked import (
    BlockedEmulator,
    fit_blocks,
    fit_blocks_together,
)
from study.response_surface.emulator.emulator import (
    FEWEST_SETTINGS,
    GRID_LEVELS,
    LARGEST,
    RUNS_A_FACTOR,
    Emulator,
    expected_seconds,
    fit_emulator,
    fit_together,
)
from study.response_surface.factors import NumericFactor, Runs
from study.response_surface.quadratic.surface import QuadraticSurface, fit_quadratic
from study.response_surface.result import (
    SurfaceAnalysis,
    analysis_of_emulator,
    analysis_of_quadratic,
)
from study.tabular import CsvTable
from study.tidy_csv import MISSING

Surface = Literal["auto", "quadratic", "emulator", "none"]

#: most factors of a quadratic surface that is chosen by itself
FEW = 5

#: how far a range may go beyond the runs, in coded units: a Latin hypercube of ten runs has its
#: outermost settings at most .2 inside of its range
BEYOND = 0.2 + 1e-9

#: seconds from which a fit is announced
LONG = 5.0

#: ``5 mm``: a number with a unit behind it
_WITH_UNIT = re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?\s*(?P<unit>[^\W\d_%][\w/^*]*|%)")

#: ``time``, ``time=80..90``, ``time=1..100 log``, ``time log``
_NUMERIC = re.compile(r"(?P<name>.+?)(=(?P<low>[^=]+?)\.\.(?P<high>[^=]+?))?(?P<log> +log)?")


def check_kind(surface: str) -> None:
    """Refuse what is no kind of a surface.

    Parameters
    ----------
    surface : str
        Kind that the user asks for; ``"none"`` is refused too.

    Raises
    ------
    InputError
        With the nearest one.
    """
    if surface not in get_args(Surface) or surface == "none":
        words = [word for word in get_args(Surface) if word != "none"]
        mend = nearest(surface, words) if surface != "none" else "leave --numeric out for a table"
        raise InputError(Fault("--surface", f"{surface!r} asks for no surface", mend))


def fit_runs(
    runs: Runs, surface: str = "auto", practical: float | None = None, u: float = 0.0
) -> SurfaceAnalysis:
    """Fit runs by the surface that is asked for, or by the one that suits them.

    Parameters
    ----------
    runs : Runs
        Coded settings and responses.
    surface : {"auto", "quadratic", "emulator"}
        By itself an emulator for more than five factors, or settings that fill the box.
    practical : float, optional
        Smallest difference that matters, in the response's unit; an emulator judges by it.
    u : float
        Bound of the numerical error of a difference, in the same unit.

    Returns
    -------
    SurfaceAnalysis
        The model, and what it says of every factor.

    Raises
    ------
    RefusedError
        If the runs cannot carry what is asked.
    """
    return told(fitted(runs, surface), practical, u)


def fitted(runs: Runs, surface: str = "auto") -> QuadraticSurface | Emulator | BlockedEmulator:
    """Fit runs; errors as for `fit_runs`.

    Parameters
    ----------
    runs : Runs
        Coded settings and responses; several blocks get one emulator each.
    surface : {"auto", "quadratic", "emulator"}
        As for `fit_runs`.
    """
    if kind_of(runs, surface) == "quadratic":
        return fit_quadratic(runs)
    return fit_blocks(runs) if len(set(runs.blocks)) > 1 else fit_emulator(runs)


def told(
    model: QuadraticSurface | Emulator | BlockedEmulator, practical: float | None, u: float
) -> SurfaceAnalysis:
    """Say what a model means.

    Parameters
    ----------
    model : QuadraticSurface, Emulator or BlockedEmulator
        Of :func:`fitted`.
    practical : float or None
        Smallest difference that matters, in the response's unit; used by an emulator alone.
    u : float
        Bound of the numerical error of a difference, in the same unit; used by an emulator alone.
    """
    if isinstance(model, QuadraticSurface):
        return analysis_of_quadratic(model)
    return analysis_of_emulator(model, practical, u)


def fitted_together(
    every: Sequence[Runs], sizes: Sequence[int], surface: str = "auto"
) -> tuple[Emulator | BlockedEmulator, ...] | None:
    """Fit one emulator to the runs at all combinations of levels, where that is the better one.

    Where runs are few at each combination, a common emulator is fitted beside one of each; the
    one is taken that predicts left-out runs better where it predicts them worst.

    Parameters
    ----------
    every : sequence of Runs
        Of each combination; the last factor without numbers changes fastest.
    sizes : sequence of int
        Number of levels of each of these factors.
    surface : {"auto", "quadratic", "emulator"}
        As for `fit_runs`.

    Returns
    -------
    tuple of Emulator or BlockedEmulator, or None
        One a combination; None where each shall have an emulator of its own, or a quadratic.
    """
    wanted = {kind_of(one, surface) for one in every}
    enough = RUNS_A_FACTOR * len(every[0].factors)
    few = min(len(one.distinct()[0]) for one in every) < enough
    if len(every) < 2 or wanted != {"emulator"} or not few:
        return None
    blocked = len(set(every[0].blocks)) > 1
    try:
        common = (fit_blocks_together if blocked else fit_together)(every, sizes)
    except RefusedError:
        return None
    try:
        apart = [(fit_blocks if blocked else fit_emulator)(one) for one in every]
    except RefusedError:
        return common
    worst = [min(one.q2 for one in models) for models in (common, apart)]
    return common if worst[0] >= worst[1] else tuple(apart)


def announce_cost(runs: Runs, announce: Callable[[str], None] | None) -> None:
    """Say beforehand what an emulator of many runs will take.

    Parameters
    ----------
    runs : Runs
        Of one fit; with blocks each has an emulator of its own.
    announce : callable or None
        Called with a sentence where more than 5 s are expected; None says nothing.
    """
    own = [runs.blocks.count(name) for name in set(runs.blocks)] or [runs.response.size]
    seconds = sum(expected_seconds(n) for n in own)
    if announce is not None and seconds > LONG and max(own) <= LARGEST:
        announce(f"an emulator of {runs.response.size} runs takes about {seconds:.0f} s")


def difference_of(practical: float | str | None, response: Array) -> float | None:
    """Read the smallest difference that matters, in the unit of a response.

    Parameters
    ----------
    practical : float, str or None
        A number in that unit, or a text such as ``"0.5 pp"`` or ``"5 % of mean"``; None for none.
    response : ndarray, shape (n,)
        Responses of all runs, for their mean.

    Returns
    -------
    float or None
        None where none is given.
    """
    asked = threshold(practical)
    return None if asked is None else asked.on_scale(float(response.mean()), "none")


def remarks(runs: Runs, surface: str, practical: float | None) -> list[str]:
    """Say what a quadratic does not judge, and why runs that fill the box got one all the same.

    Parameters
    ----------
    runs : Runs
        That were fitted.
    surface : {"auto", "quadratic", "emulator"}
        As it was asked for.
    practical : float or None
        Smallest difference that matters, in the response's unit.
    """
    said, few = [], _few(runs)
    if kind_of(runs, surface) == "quadratic" and practical is not None:
        said.append("a quadratic surface judges terms: --practical is asked of an emulator")
    if surface == "auto" and few and max(runs.levels()) > GRID_LEVELS:
        said.append(
            f"a quadratic surface: an emulator needs at least {FEWEST_SETTINGS} settings of every "
            f"factor, {', '.join(few)} has fewer"
        )
    return said


def kind_of(runs: Runs, surface: str) -> str:
    """Return the kind that is asked for; the design chooses where that is left to it.

    Composite designs have three or five settings a factor.

    Parameters
    ----------
    runs : Runs
        Their settings decide; their responses do not.
    surface : {"auto", "quadratic", "emulator"}
        ``"auto"`` gives an emulator where every factor has at least four settings and, besides,
        there are more than five factors or one of them has more than five settings.
    """
    if surface != "auto":
        return surface
    if _few(runs):
        return "quadratic"
    fills = max(runs.levels()) > GRID_LEVELS
    return "emulator" if len(runs.factors) > FEW or fills else "quadratic"


def _few(runs: Runs) -> list[str]:
    """Name the factors with too few settings for an emulator."""
    counts = zip(runs.names, runs.levels(), strict=True)
    return [name for name, count in counts if count < FEWEST_SETTINGS]


def runs_of(
    table: CsvTable, response: str, numeric: Sequence[str], block: str | None
) -> tuple[Runs, Flags, list[str]]:
    """Rows that have a response, which these are, and what is to be said of the others.

    Parameters
    ----------
    table : CsvTable
        One row a run.
    response, numeric, block
        As of :func:`study.fit_surface`.

    Raises
    ------
    InputError
        Naming file, row and column.
    """
    if not numeric:
        raise InputError(Fault("--numeric", "is missing", "name the columns of the factors"))
    values = table.numbers(response, missing=MISSING)
    kept = np.isfinite(values)
    notes = []
    if not kept.all():
        rows = ", ".join(str(table.lines[k]) for k in np.flatnonzero(~kept)[:10])
        notes.append(
            f"{count(int((~kept).sum()), 'run')} without a response left out: lines {rows}"
        )
    if kept.sum() < 2:
        raise InputError(Fault(table.source, "has fewer than two runs with a response"))
    asked = [_asked(item, table) for item in numeric]
    names = [name for name, _, _, _ in asked]
    _check_plain(table, names)
    if len({*names, response, block}) < len(names) + 2:
        rule = f"a column stands twice among {', '.join(names)}, the response and the block"
        raise InputError(Fault("--numeric", rule, "name every column once"))
    columns = {name: table.numbers(name)[kept] for name in names}
    factors = tuple(_factor(columns[name], name, low, high, log) for name, low, high, log in asked)
    coded = np.column_stack([factor.coded(columns[factor.name]) for factor in factors])
    labels = () if block is None else tuple(np.array(table.text(block))[kept].tolist())
    return Runs(response, factors, coded, values[kept], labels), kept, notes


def _check_plain(table: CsvTable, names: Sequence[str]) -> None:
    """Refuse cells with units, once a column: they may differ from row to row."""
    faults = []
    for name in names:
        told = [_WITH_UNIT.fullmatch(cell) for cell in table.text(name)]
        units = list(dict.fromkeys(one["unit"] for one in told if one is not None))
        if units:
            rule = f"has units in its cells: {', '.join(units[:5])}"
            mend = f"keep numbers in one unit alone, and name it in the header: {name}_{units[0]}"
            faults.append(Fault(f"{table.source}: column {name!r}", rule, mend))
    if faults:
        raise InputError(faults)


def _asked(item: str, table: CsvTable) -> tuple[str, float | None, float | None, bool]:
    """Column, ends of the range if given, and whether its logarithm is coded."""
    text = item.strip()
    if text in table.columns:
        return text, None, None, False
    parts = _NUMERIC.fullmatch(text)
    name = text if parts is None else parts["name"].strip()
    table.text(name)  # refuses what is no column, with the nearest one
    if parts is None or parts["low"] is None:
        return name, None, None, parts is not None and parts["log"] is not None
    try:
        low, high = float(parts["low"]), float(parts["high"])
    except ValueError as error:
        rule = f"cannot read the range of {text!r}"
        raise InputError(Fault("--numeric", rule, f"write {name}=80..90")) from error
    return name, low, high, parts["log"] is not None


def _factor(
    settings: Array, name: str, low: float | None, high: float | None, log: bool
) -> NumericFactor:
    """Make a factor whose ends are those asked for, or those that were run."""
    if log and settings.min() <= 0:
        rule = f"a logarithm needs positive settings, the lowest is {settings.min():g}"
        raise InputError(Fault(f"factor {name!r}", rule, "leave ' log' out"))
    first = float(settings.min()) if low is None else low
    last = float(settings.max()) if high is None else high
    factor = NumericFactor(name, first, last, log)
    run = factor.coded(np.array([settings.min(), settings.max()]))
    if run[0] > -1.0 + BEYOND or run[1] < 1.0 - BEYOND:
        rule = f"the range {first:g}..{last:g} goes beyond the settings that were run"
        mend = f"a surface is not extrapolated: {name}={settings.min():g}..{settings.max():g}"
        raise InputError(Fault(f"factor {name!r}", rule, mend))
    return factor
