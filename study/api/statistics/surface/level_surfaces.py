"""A table in, surfaces over its numeric factors out: one at every combination of labels."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from study import tabular
from study.api.statistics.surface.response_surface import (
    Surface,
    announce_cost,
    check_kind,
    difference_of,
    fitted,
    fitted_together,
    kind_of,
    remarks,
    runs_of,
    told,
)
from study.arrays import Flags
from study.errors import Fault, InputError, RefusedError, StudyError
from study.response_surface.emulator.blocked import BlockedEmulator
from study.response_surface.emulator.emulator import Emulator
from study.response_surface.factors import Runs
from study.response_surface.level_difference import LevelDifference, level_difference
from study.response_surface.result import SurfaceAnalysis
from study.study_result.response_surface import FittedSurface
from study.tabular import CsvTable

#: combinations of labels of which each gets a surface
MOST_COMBINATIONS = 64

#: surfaces whose error holds everywhere in the ranges
_EMULATORS = (Emulator, BlockedEmulator)


def fit_surface(
    source: str | Path,
    response: str,
    numeric: Sequence[str],
    *,
    surface: Surface = "auto",
    block: str | None = None,
    practical: float | str | None = None,
    decimal: str = ".",
    announce: Callable[[str], None] | None = None,
) -> SurfaceAnalysis:
    """Fit a response over numeric factors, and say what they do.

    Parameters
    ----------
    source : str or Path
        CSV with one row a run.
    response : str
        Column of the response; rows without one are left out, and that is said.
    numeric : sequence of str
        Columns of the factors: ``"time"``, ``"time=80..90"`` for the settings that are coded -1
        and 1 (those of the runs if left out), ``"time log"`` to code the logarithm.
    surface : {"auto", "quadratic", "emulator", "none"}
        By itself an emulator for more than five factors, or settings that fill the box.
    block : str, optional
        Column of the blocks; a quadratic needs a run of each at every setting, an
        emulator three blocks.
    practical : float or str, optional
        Smallest difference that matters: a number, or "5 % of mean".
    decimal : {".", ","}
        Decimal mark of the file.
    announce : callable, optional
        Told beforehand what a long fit will cost.

    Returns
    -------
    SurfaceAnalysis
        The model, what it says of every factor, and ``predict``.

    Raises
    ------
    InputError
        Naming file, row and column, all faults at once.
    RefusedError
        If the runs cannot carry what is asked.
    """
    alone = fit_surfaces(
        source, response, numeric, (), surface=surface, block=block, practical=practical,
        decimal=decimal, announce=announce,
    )  # fmt: skip
    # without labels there is one, and what keeps it from being fitted is raised
    return next(one.found for one in alone if one.found is not None)


def fit_surfaces(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    source: str | Path,
    response: str,
    numeric: Sequence[str],
    factors: Sequence[str],
    *,
    surface: Surface = "auto",
    block: str | None = None,
    practical: float | str | None = None,
    decimal: str = ".",
    announce: Callable[[str], None] | None = None,
) -> tuple[FittedSurface, ...]:
    """Fit a response over numeric factors at every combination of labels, and compare these.

    Where runs are few at each combination one emulator is fitted to all of them, if it predicts
    left-out runs better.

    Parameters
    ----------
    source : str or Path
        CSV with one row a run.
    response : str
        Column of the response; rows without one are left out, and that is said.
    numeric : sequence of str
        Columns of the factors that are numbers, as of :func:`fit_surface`; the ranges are those of
        all runs.
    factors : sequence of str
        Columns of the factors that are labels.
    surface : {"auto", "quadratic", "emulator", "none"}
        As of :func:`fit_surface`, at every combination.
    block : str, optional
        Column of the blocks.
    practical : float or str, optional
        Smallest difference that matters: a number, or "5 % of mean" of all runs.
    decimal : {".", ","}
        Decimal mark of the file.
    announce : callable, optional
        Told beforehand what a long fit will cost.

    Returns
    -------
    tuple of FittedSurface
        One a combination that has runs, the last factor changing fastest.

    Raises
    ------
    InputError
        Naming file, row and column.
    RefusedError
        If no combination can carry a surface.
    """
    check_kind(surface)
    table = tabular.read_csv(Path(source), numbers=[response], decimal=decimal)
    runs, kept, notes = runs_of(table, response, numeric, block)
    places, rows = _places(table, factors, kept, {*runs.names, response, block})
    if kind_of(runs, surface) == "emulator":
        announce_cost(runs, announce)
    difference = difference_of(practical, runs.response)
    sizes = [len({place[name] for place in places}) for name in factors]
    common = _together(runs, rows, sizes, surface) if len(rows) == np.prod(sizes) else None
    each = [
        _fitted(runs, here, place, surface, difference, None if common is None else common[k])
        for k, (place, here) in enumerate(zip(places, rows, strict=True))
    ]
    if all(one.found is None for one in each):
        raise RefusedError(f"no combination carries a surface: {each[0].refused}")
    each = _noted(each, (*table.notes, *notes), surface)
    return tuple(replace(one, differences=differences(one, each, places[0])) for one in each)


def _places(
    table: CsvTable, factors: Sequence[str], kept: Flags, taken: set[str | None]
) -> tuple[list[dict[str, str]], list[Flags]]:
    """List combinations of labels that have runs, and which of the runs with a response."""
    twice = [name for name in factors if name in taken or list(factors).count(name) > 1]
    if twice:
        rule = f"{twice[0]!r} stands twice among factors, numbers, response and block"
        raise InputError(Fault("--factors", rule, "name every column once"))
    columns = {name: np.array(table.text(name))[kept] for name in factors}
    levels = [list(dict.fromkeys(column.tolist())) for column in columns.values()]
    every = np.ones(kept.sum(), dtype=bool)
    named = (dict(zip(factors, one, strict=True)) for one in itertools.product(*levels))
    found = [
        (place, np.all([every, *(columns[name] == at for name, at in place.items())], axis=0))
        for place in named
    ]
    found = [(place, here) for place, here in found if here.any()]
    if len(found) > MOST_COMBINATIONS:
        rule = f"make {len(found)} combinations, and each gets a surface of its own"
        raise InputError(Fault("--factors", rule, f"at most {MOST_COMBINATIONS}: name fewer"))
    return [place for place, _ in found], [here for _, here in found]


def _some(runs: Runs, here: Flags) -> Runs:
    """Keep some of the runs, in the ranges of all; refuses a factor that never changes in them."""
    blocks = tuple(name for name, chosen in zip(runs.blocks, here, strict=False) if chosen)
    return replace(runs, coded=runs.coded[here], response=runs.response[here], blocks=blocks)


def _together(
    runs: Runs, rows: Sequence[Flags], sizes: Sequence[int], surface: str
) -> tuple[Emulator | BlockedEmulator, ...] | None:
    """Models of all combinations by one emulator, where that is the better one."""
    try:
        return fitted_together([_some(runs, here) for here in rows], sizes, surface)
    except StudyError:
        return None  # what is wrong with a combination is said where it is fitted


def _fitted(
    runs: Runs,
    here: Flags,
    place: Mapping[str, str],
    surface: str,
    practical: float | None,
    model: Emulator | BlockedEmulator | None,
) -> FittedSurface:
    """Surface at one combination, or why there is none: raised where there are no labels."""
    try:
        one = fitted(_some(runs, here), surface) if model is None else model
        found = told(one, practical, 0.0)
    except StudyError as error:
        if not place:
            raise
        return FittedSurface(runs.name, "", None, str(error), place, practical)
    return FittedSurface(runs.name, "", found, "", place, practical)


def _noted(
    each: Sequence[FittedSurface], of_table: Sequence[str], surface: str
) -> list[FittedSurface]:
    """Add what is to be said of every surface, and of their table once, with the first."""
    noted, left = [], of_table
    for one in each:
        if one.found is None:
            noted.append(one)
            continue
        said = (*left, *remarks(one.found.runs, surface, one.practical))
        noted.append(replace(one, found=one.found.noted(*said)))
        left = ()
    return noted


def differences(
    one: FittedSurface, each: Sequence[FittedSurface], first: Mapping[str, str]
) -> tuple[LevelDifference, ...]:
    """Compare a surface with those at the first levels of the other factors, one at a time.

    Parameters
    ----------
    one : FittedSurface
        The surface.
    each : sequence of FittedSurface
        Those at all combinations of levels.
    first : mapping of str to str
        First level of each of these factors.

    Returns
    -------
    tuple of LevelDifference
        None of a quadratic, whose error is not known everywhere in the ranges.
    """
    made = []
    for name, base in first.items():
        wanted = {**one.labels, name: base}
        # runs at some combinations of labels may be missing
        other = next((found for found in each if dict(found.labels) == wanted), one)
        mine, theirs = (None if s.found is None else s.found.model for s in (one, other))
        if one is other or not (isinstance(mine, _EMULATORS) and isinstance(theirs, _EMULATORS)):
            continue
        limits = [s.practical for s in (one, other) if s.practical is not None]
        limit = min(limits) if limits else None
        names = (name, one.labels[name], base)
        made.append(level_difference(names, (mine, theirs), limit, one.bound or 0.0))
    return tuple(made)
