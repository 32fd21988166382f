"""Runs of a table, and the surfaces that suit them: one at every combination of labels."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from study.ground.arrays import Array, Flags
from study.ground.errors import Fault, InputError, RefusedError, StudyError
from study.ground.tabular import MISSING, CsvTable
from study.ground.units import unit_of_column
from study.statistics.analysis.analysis_request import on_scale, threshold
from study.statistics.surfaces.emulator import (
    FEWEST_SETTINGS,
    GRID_LEVELS,
    RUNS_A_FACTOR,
    BlockedEmulator,
    Emulator,
    fit_blocks_together,
    fit_own,
    fit_together,
)
from study.statistics.surfaces.quadratic import fit_quadratic
from study.statistics.surfaces.surface_factors import NumericFactor, Runs
from study.statistics.surfaces.surface_optimum import Model
from study.statistics.surfaces.surface_result import (
    SCREENS,
    FittedSurface,
    LevelDifference,
    analysis_of,
    elementary_effects,
    level_difference,
)

if TYPE_CHECKING:
    from study.statistics.analysis.analysis_request import Practical


Surface = Literal["auto", "quadratic", "emulator", "none"]
#: what stands in the place of a table of levels
SEE_SURFACE = "its factors are numbers: see the surface"
#: most factors of a quadratic surface that is chosen by itself
FEW = 5
#: how far a range may go beyond the runs, in coded units: a Latin hypercube of ten runs has its
#: outermost settings at most .2 inside of its range
BEYOND = 0.2 + 1e-9
#: ``5 mm``: a number with a unit behind it
_WITH_UNIT = re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?\s*(?P<unit>[^\W\d_%][\w/^*]*|%)")
#: ``time``, ``time=80..90``, ``time=1..100 log``, ``time log``
_NUMERIC = re.compile(r"(?P<name>.+?)(=(?P<low>[^=]+?)\.\.(?P<high>[^=]+?))?(?P<log> +log)?")


def fitted_together(
    every: Sequence[Runs], sizes: Sequence[int], surface: str = "auto"
) -> tuple[Emulator | BlockedEmulator, ...] | None:
    """Fit one emulator to the runs at all combinations of levels, where that is the better one.

    Where runs are few at each combination, a common emulator is fitted beside one of each; the
    one is taken that predicts left-out runs better where it predicts them worst.
    """
    kinds = {kind_of(runs, surface) for runs in every}
    enough = RUNS_A_FACTOR * len(every[0].factors)
    few = min(len(runs.distinct()[0]) for runs in every) < enough
    if len(every) < 2 or kinds != {"emulator"} or not few:
        return None
    together = fit_blocks_together if len(set(every[0].blocks)) > 1 else fit_together
    try:
        common = together(every, sizes)
    except RefusedError:
        return None
    try:
        apart = [fit_own(runs) for runs in every]
    except RefusedError:
        return common
    worst = [min(model.q2 for model in models) for models in (common, apart)]
    return common if worst[0] >= worst[1] else tuple(apart)


def difference_of(practical: Practical, runs: Runs) -> float | None:
    """Read the smallest difference that matters, in the unit of the response of some runs."""
    return on_scale(threshold(practical, unit_of_column(runs.name)), float(runs.response.mean()))


def remarks(runs: Runs, surface: str) -> list[str]:
    """Say why runs that fill the box got a quadratic surface."""
    few = _few(runs)
    if surface != "auto" or not few or max(runs.levels()) <= GRID_LEVELS:
        return []
    return [
        f"a quadratic surface: an emulator needs at least {FEWEST_SETTINGS} settings of every "
        f"factor, {', '.join(few)} has fewer"
    ]


def kind_of(runs: Runs, surface: str) -> str:
    """Kind that is asked for, or that of the design: composites have three or five settings."""
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


def counted(runs: int) -> str:
    """Write a number of runs."""
    return f"{runs:,} run{'s' * (runs != 1)}"


def runs_of(
    table: CsvTable, response: str, numeric: Sequence[str], block: str | None
) -> tuple[Runs, Flags, list[str]]:
    """Find the runs with a response, the mask of their rows, and notes on the other rows."""
    if not numeric:
        raise InputError(Fault("--numeric", "is missing", "name the columns of the factors"))
    values = table.numbers(response, missing=MISSING)
    answered = np.isfinite(values)
    notes = []
    if not answered.all():
        rows = ", ".join(str(table.lines[k]) for k in np.flatnonzero(~answered)[:10])
        notes.append(f"{counted(int((~answered).sum()))} without a response left out: lines {rows}")
    if answered.sum() < 2:
        raise InputError(Fault(table.source, "has fewer than two runs with a response"))
    declared = [_asked(item, table) for item in numeric]
    names = [name for name, _, _, _ in declared]
    _check_plain(table, names)
    if len({*names, response, block}) < len(names) + 2:
        rule = f"a column stands twice among {', '.join(names)}, the response and the block"
        raise InputError(Fault("--numeric", rule, "name every column once"))
    columns = {name: table.numbers(name)[answered] for name in names}
    factors = tuple(
        _factor(columns[name], name, low, high, log) for name, low, high, log in declared
    )
    coded = np.column_stack([factor.coded(columns[factor.name]) for factor in factors])
    labels = () if block is None else tuple(np.array(table.text(block))[answered].tolist())
    return Runs(response, factors, coded, values[answered], labels), answered, notes


def settings_run(item: str, table: CsvTable) -> NumericFactor:
    """Numeric factor of ``--numeric`` over all settings of its column."""
    name, low, high, log = _asked(item, table)
    if (low, high) != (None, None):
        rule = f"takes no range for {name!r}: the runs of the table have theirs"
        raise InputError(Fault("--numeric", rule, f"write {name}"))
    _check_plain(table, [name])
    return _factor(table.numbers(name), name, None, None, log)


def _check_plain(table: CsvTable, names: Sequence[str]) -> None:
    """Refuse cells with units, once a column: they may differ from row to row."""
    faults = []
    for name in names:
        units_typed = [_WITH_UNIT.fullmatch(cell) for cell in table.text(name)]
        units = list(dict.fromkeys(match["unit"] for match in units_typed if match is not None))
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


#: combinations of labels of which each gets a surface
MOST_COMBINATIONS = 64
#: surfaces whose error holds everywhere in the ranges
_EMULATORS = (Emulator, BlockedEmulator)


def surfaces_at(
    blank: FittedSurface,
    places: Sequence[Mapping[str, str]],
    sizes: Sequence[int],
    surface: str,
    makers: Sequence[Callable[[], Runs]],
    practical: Practical,
) -> list[FittedSurface]:
    """Surface at every combination of labels, or why there is none; raised without labels."""
    each = []
    for labels, runs, model in zip(places, *models_at(sizes, surface, makers), strict=True):
        fitted_here = replace(blank, labels=labels)
        try:
            if not isinstance(runs, Runs):
                raise runs
            fitted_here = replace(fitted_here, practical=difference_of(practical, runs))
            if surface == "morris":
                screened = elementary_effects(runs)
                each.append(replace(fitted_here, refused=SCREENS, screened=screened))
                continue
            if isinstance(model, StudyError):
                raise model
            analysis = analysis_of(model, fitted_here.practical, blank.bound or 0.0)
            each.append(replace(fitted_here, surface=analysis))
        except StudyError as error:
            if not labels and not blank.units:
                raise
            each.append(replace(fitted_here, refused=str(error)))
    return each


def models_at(
    sizes: Sequence[int], surface: str, makers: Sequence[Callable[[], Runs]]
) -> tuple[list[Runs | StudyError], list[Model | StudyError]]:
    """Find runs and surface of every combination of labels, or why there are none."""
    every: list[Runs | StudyError] = []
    for made_of in makers:
        try:
            every.append(made_of())
        except StudyError as error:
            every.append(error)
    good, together = [table for table in every if isinstance(table, Runs)], None
    if len(good) == len(every) == math.prod(sizes):
        # what is wrong with a combination is said where it is fitted
        with contextlib.suppress(StudyError):
            together = fitted_together(good, sizes, surface)
    models: list[Model | StudyError] = []
    for k, runs in enumerate(every):
        try:
            if not isinstance(runs, Runs):
                raise runs
            if surface == "morris":
                raise RefusedError(SCREENS)
            fit = fit_quadratic if kind_of(runs, surface) == "quadratic" else fit_own
            models.append(fit(runs) if together is None else together[k])
        except StudyError as error:
            models.append(error)
    return every, models


def places_of(
    table: CsvTable, factors: Sequence[str], answered: Flags, taken: set[str | None]
) -> tuple[list[dict[str, str]], list[Flags]]:
    """List combinations of labels that have runs, and which of the runs with a response."""
    twice = [name for name in factors if name in taken or list(factors).count(name) > 1]
    if twice:
        rule = f"{twice[0]!r} stands twice among factors, numbers, response and block"
        raise InputError(Fault("--factors", rule, "name every column once"))
    columns = {name: np.array(table.text(name))[answered] for name in factors}
    levels = [list(dict.fromkeys(column.tolist())) for column in columns.values()]
    every = np.ones(answered.sum(), dtype=bool)
    named = (dict(zip(factors, levels_of, strict=True)) for levels_of in itertools.product(*levels))
    rows_of = [
        (labels, np.all([every, *(columns[name] == at for name, at in labels.items())], axis=0))
        for labels in named
    ]
    rows_of = [(labels, here) for labels, here in rows_of if here.any()]
    if len(rows_of) > MOST_COMBINATIONS:
        rule = f"make {len(rows_of)} combinations, and each gets a surface of its own"
        raise InputError(Fault("--factors", rule, f"at most {MOST_COMBINATIONS}: name fewer"))
    return [labels for labels, _ in rows_of], [here for _, here in rows_of]


def noted(
    each: Sequence[FittedSurface], of_table: Sequence[str], surface: str
) -> list[FittedSurface]:
    """Add its notes to every surface, and the notes on their table to the first."""
    noted, left = [], of_table
    for fitted in each:
        fit = fitted.surface
        if fit is not None:
            fit, left = fit.noted(*left, *remarks(fit.runs, surface)), ()
        noted.append(replace(fitted, surface=fit))
    return noted


def compared(each: Sequence[FittedSurface]) -> tuple[FittedSurface, ...]:
    """Surfaces with their differences from those at the first levels."""
    return tuple(replace(fitted, differences=_differences(fitted, each)) for fitted in each)


def _differences(
    fitted: FittedSurface, each: Sequence[FittedSurface]
) -> tuple[LevelDifference, ...]:
    """Compare a surface with those at the first levels of the other factors, one at a time."""
    differences = []
    for name, base in each[0].labels.items():
        labels_wanted = {**fitted.labels, name: base}
        # runs at some combinations of labels may be missing
        other = next((partner for partner in each if dict(partner.labels) == labels_wanted), fitted)
        mine, theirs = (None if s.surface is None else s.surface.model for s in (fitted, other))
        if fitted is other or not (isinstance(mine, _EMULATORS) and isinstance(theirs, _EMULATORS)):
            continue
        limits = [s.practical for s in (fitted, other) if s.practical is not None]
        limit = min(limits) if limits else None
        names = (name, fitted.labels[name], base)
        differences.append(level_difference(names, (mine, theirs), limit, fitted.bound or 0.0))
    return tuple(differences)
