"""A table in, surfaces over its numeric factors out: one at every combination of labels."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, TypeVar, Unpack, get_args

import numpy as np

from study.api.analyzing import AnalysisSource, data_of_table
from study.ground import tabular
from study.ground.arrays import Array, Flags
from study.ground.errors import Fault, InputError, RefusedError, StudyError, nearest
from study.ground.tabular import MISSING, CsvTable
from study.ground.units import parse_number
from study.harness.design import overlay
from study.harness.design.questions import usual_value
from study.harness.record.record import is_repeat
from study.reporting.content.text import count
from study.reporting.results.study_result import ReportData, ResponseAnalysis
from study.statistics.analysis.analysis_request import threshold
from study.statistics.surfaces.emulator import (
    FEWEST_SETTINGS,
    GRID_LEVELS,
    LARGEST,
    RUNS_A_FACTOR,
    BlockedEmulator,
    Emulator,
    expected_seconds,
    fit_blocks_together,
    fit_own,
    fit_together,
)
from study.statistics.surfaces.quadratic import QuadraticSurface, fit_quadratic
from study.statistics.surfaces.surface_factors import NumericFactor, Runs
from study.statistics.surfaces.surface_profile import (
    SCREENS,
    FittedSurface,
    LevelDifference,
    elementary_effects,
    level_difference,
)
from study.statistics.surfaces.surface_propagation import propagate
from study.statistics.surfaces.surface_result import (
    SurfaceAnalysis,
    analysis_of,
)

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.design.spec import Design, Treatment
    from study.harness.record.record import Record
    from study.statistics.analysis.analysis_request import Practical
    from study.statistics.convergence.grid_convergence import NumericalUncertainty


# Runs of a table, and the surface that suits them, with what it means.

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


def fitted(runs: Runs, surface: str = "auto") -> QuadraticSurface | Emulator | BlockedEmulator:
    """Fit runs by the surface that is asked for, or by the one that suits them."""
    return fit_quadratic(runs) if kind_of(runs, surface) == "quadratic" else fit_own(runs)


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


def difference_of(practical: Practical, response: Array) -> float | None:
    """Read the smallest difference that matters, in the unit of a response (n,)."""
    limit = threshold(practical)
    return None if limit is None else limit.on_scale(float(response.mean()), "none")


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


def runs_of(
    table: CsvTable, response: str, numeric: Sequence[str], block: str | None
) -> tuple[Runs, Flags, list[str]]:
    """Rows that have a response, which these are, and what is to be said of the others."""
    if not numeric:
        raise InputError(Fault("--numeric", "is missing", "name the columns of the factors"))
    values = table.numbers(response, missing=MISSING)
    answered = np.isfinite(values)
    notes = []
    if not answered.all():
        rows = ", ".join(str(table.lines[k]) for k in np.flatnonzero(~answered)[:10])
        notes.append(
            f"{count(int((~answered).sum()), 'run')} without a response left out: lines {rows}"
        )
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


class SurfaceOptions(TypedDict, total=False):
    """Keywords of :func:`fit_surfaces`, where they are described."""

    surface: Surface
    block: str | None
    practical: float | str | None
    decimal: str
    announce: Callable[[str], None] | None


def fit_surface(
    source: str | Path, response: str, numeric: Sequence[str], **options: Unpack[SurfaceOptions]
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
    **options : optional
        As for :func:`fit_surfaces`: ``surface``, ``block``, ``practical``, ``decimal``,
        ``announce``.

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
    alone = fit_surfaces(source, response, numeric, (), **options)
    # without labels there is one, and what keeps it from being fitted is raised
    return next(fitted.found for fitted in alone if fitted.found is not None)


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
        By itself an emulator for more than five factors, or settings that fill the box.
    block : str, optional
        Column of the blocks; a quadratic needs a run of each at every setting, an emulator three
        blocks.
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
    kinds = [word for word in get_args(Surface) if word != "none"]
    if surface not in kinds:
        mend = nearest(surface, kinds) if surface != "none" else "leave --numeric out for a table"
        raise InputError(Fault("--surface", f"{surface!r} asks for no surface", mend))
    table = tabular.read_csv(
        Path(source), numbers=[response], decimal=decimal, declared_by=tabular.TYPED_COMMA
    ).without_units([response])
    runs, answered, notes = runs_of(table, response, numeric, block)
    places, rows = _places(table, factors, answered, {*runs.names, response, block})
    if announce is not None and kind_of(runs, surface) == "emulator":
        counts = [runs.blocks.count(name) for name in set(runs.blocks)] or [runs.response.size]
        seconds = sum(expected_seconds(n) for n in counts)
        if seconds > LONG and max(counts) <= LARGEST:
            announce(f"an emulator of {runs.response.size} runs takes about {seconds:.0f} s")
    difference = difference_of(practical, runs.response)
    sizes = [len({place[name] for place in places}) for name in factors]
    each = _surfaces_at(
        FittedSurface(runs.name, "", None, practical=difference), places, sizes, surface,
        [partial(_some, runs, here) for here in rows], difference,
    )  # fmt: skip
    if all(fitted.found is None for fitted in each):
        raise RefusedError(f"no combination carries a surface: {each[0].refused}")
    return _compared(_noted(each, (*table.notes, *notes), surface))


def _surfaces_at(
    blank: FittedSurface,
    places: Sequence[Mapping[str, str]],
    sizes: Sequence[int],
    surface: str,
    makers: Sequence[Callable[[], Runs]],
    practical: Practical,
) -> list[FittedSurface]:
    """Surface at every combination of labels, or why there is none; raised without labels."""
    every: list[Runs | StudyError] = []
    for made_of in makers:
        try:
            every.append(made_of())
        except StudyError as error:
            every.append(error)
    good, together = [one for one in every if isinstance(one, Runs)], None
    if len(good) == len(places) == math.prod(sizes):
        # what is wrong with a combination is said where it is fitted
        with contextlib.suppress(StudyError):
            together = fitted_together(good, sizes, surface)
    each = []
    for k, (labels, runs) in enumerate(zip(places, every, strict=True)):
        fitted_here = replace(blank, labels=labels)
        try:
            if not isinstance(runs, Runs):
                raise runs
            fitted_here = replace(fitted_here, practical=difference_of(practical, runs.response))
            if surface == "morris":
                screened = elementary_effects(runs)
                each.append(replace(fitted_here, refused=SCREENS, screened=screened))
                continue
            model = fitted(runs, surface) if together is None else together[k]
            made = analysis_of(model, fitted_here.practical, blank.bound or 0.0)
            each.append(replace(fitted_here, found=made))
        except StudyError as error:
            if not labels and not blank.units:
                raise
            each.append(replace(fitted_here, refused=str(error)))
    return each


def _places(
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
        (place, np.all([every, *(columns[name] == at for name, at in place.items())], axis=0))
        for place in named
    ]
    rows_of = [(place, here) for place, here in rows_of if here.any()]
    if len(rows_of) > MOST_COMBINATIONS:
        rule = f"make {len(rows_of)} combinations, and each gets a surface of its own"
        raise InputError(Fault("--factors", rule, f"at most {MOST_COMBINATIONS}: name fewer"))
    return [place for place, _ in rows_of], [here for _, here in rows_of]


def _some(runs: Runs, here: Flags) -> Runs:
    """Keep some of the runs, in the ranges of all; refuses a factor that never changes in them."""
    blocks = tuple(name for name, chosen in zip(runs.blocks, here, strict=False) if chosen)
    return replace(runs, coded=runs.coded[here], response=runs.response[here], blocks=blocks)


def _noted(
    each: Sequence[FittedSurface], of_table: Sequence[str], surface: str
) -> list[FittedSurface]:
    """Add what is to be said of every surface, and of their table once, with the first."""
    noted, left = [], of_table
    for fitted in each:
        found = fitted.found
        if found is not None:
            found, left = found.noted(*left, *remarks(found.runs, surface)), ()
        noted.append(replace(fitted, found=found))
    return noted


def _compared(each: Sequence[FittedSurface]) -> tuple[FittedSurface, ...]:
    """Surfaces with their differences from those at the first levels."""
    return tuple(replace(fitted, differences=_differences(fitted, each)) for fitted in each)


def _differences(
    fitted: FittedSurface, each: Sequence[FittedSurface]
) -> tuple[LevelDifference, ...]:
    """Compare a surface with those at the first levels of the other factors, one at a time."""
    made = []
    for name, base in each[0].labels.items():
        labels_wanted = {**fitted.labels, name: base}
        # runs at some combinations of labels may be missing
        other = next((partner for partner in each if dict(partner.labels) == labels_wanted), fitted)
        mine, theirs = (None if s.found is None else s.found.model for s in (fitted, other))
        if fitted is other or not (isinstance(mine, _EMULATORS) and isinstance(theirs, _EMULATORS)):
            continue
        limits = [s.practical for s in (fitted, other) if s.practical is not None]
        limit = min(limits) if limits else None
        names = (name, fitted.labels[name], base)
        made.append(level_difference(names, (mine, theirs), limit, fitted.bound or 0.0))
    return tuple(made)


# Surfaces over the numeric factors of a study's own runs.

#: kinds of a design whose settings are chosen for a surface
_FOR_SURFACES = (
    "central-composite", "box-behnken", "latin-hypercube", "sobol", "morris", "adaptive", "listed"
)  # fmt: skip

#: what stands in the place of a table of levels
SEE_SURFACE = "its factors are numbers: see the surface"


def is_numeric(design: Design) -> bool:
    """Whether a surface over the ranges of a design answers its question."""
    ranged = any(factor.span is not None for factor in design.factors)
    kind = design.analysis.surface
    if not ranged or kind == "none":
        return False
    return kind != "auto" or design.scheme.kind in _FOR_SURFACES


def surfaces(
    design: Design, records: Sequence[Record], numerical: Sequence[NumericalUncertainty]
) -> tuple[FittedSurface, ...]:
    """Fit all responses over the ranges at every combination of levels, without unanswered runs."""
    if not is_numeric(design):
        return ()
    originals = [record for record in records if not is_repeat(record.extra)]
    places, sizes = labels_of(design), [len(f.labels) for f in design.factors if f.span is None]
    kind = design.analysis.surface
    if kind == "auto" and design.scheme.kind == "morris":
        kind = "morris"
        place = {tuple(t.levels.values()): n for n, t in enumerate(design.treatments)}
        originals.sort(key=lambda record: place[tuple(record.levels.values())])
    units_of = {f.name: f.span.unit for f in design.factors if f.span is not None}
    surfaces_fitted: list[FittedSurface] = []
    for response in design.responses:
        half_width = _half_width(response.name, records, numerical)
        factors, ends = _answered(design, response.name, originals)
        here = [at_levels(originals, labels) for labels in places]
        good = [[r for r in some if r.value(response.name) is not None] for some in here]
        # each of two settings may be off by its own bound
        bound = None if half_width is None else 2.0 * half_width
        each = _surfaces_at(
            FittedSurface(response.name, response.unit, None, bound=bound, units=units_of),
            places, sizes, kind,
            [partial(_runs_of_records, response.name, some, half_width, factors)
             for some in good],
            response.practical,
        )  # fmt: skip
        lost = [len(some) - len(answered) for some, answered in zip(here, good, strict=True)]
        surfaces_fitted += _compared(
            [_finished(design, one, n, ends) for one, n in zip(each, lost, strict=True)]
        )
    return tuple(surfaces_fitted)


def labels_of(design: Design) -> list[dict[str, str]]:
    """Every combination of labels of the factors that are no numbers."""
    others = {factor.name: factor.labels for factor in design.factors if factor.span is None}
    combinations = itertools.product(*others.values())
    return [dict(zip(others, labels, strict=True)) for labels in combinations]


T = TypeVar("T", "Record", "Treatment")


def at_levels(records: Sequence[T], labels: Mapping[str, str]) -> list[T]:
    """Choose the records, or the cells, at a combination of labels."""
    return [r for r in records if all(r.levels[name] == label for name, label in labels.items())]


def runs_at(
    design: Design, response: str, labels: Mapping[str, str], records: Sequence[Record]
) -> Runs:
    """Return the runs of a response that have an answer, at one combination of other levels."""
    good = [r for r in at_levels(records, labels)
            if not is_repeat(r.extra) and r.value(response) is not None]  # fmt: skip
    return _runs_of_records(response, good, None, ranges_of(design))


def _half_width(
    response: str, records: Sequence[Record], numerical: Sequence[NumericalUncertainty]
) -> float | None:
    """Largest half-width of a run: of its mesh where one was refined, and of its load steps."""
    meshes = [row.u_num for row in numerical if row.response == response and row.u_num is not None]
    if not meshes:
        return None
    steps = [record.responses[response].get("u_steps") or 0.0 for record in records
             if response in record.responses]  # fmt: skip
    return max(meshes) + max(steps, default=0.0)


def _finished(
    design: Design, fitted: FittedSurface, lost: int, ends: Sequence[str]
) -> FittedSurface:
    """Add what is to be said of the runs, and what uncertain inputs do."""
    if fitted.found is None:
        return fitted
    left_out = f"{count(lost, 'run')} without an answer left out; nothing is put in the place"
    notes = [*([left_out] if lost else []), *ends]
    uncertain = None
    if design.inputs:
        fixed = {
            f.name: usual_value(
                f.name, overlay.dimension(f.name) or "number", f.span, design.config
            )
            for f in design.factors
            if f.span is not None and f.name not in design.inputs
        }
        try:
            uncertain = propagate(fitted.found, design.inputs, fixed, design.seed)
        except StudyError as error:
            notes.insert(0, str(error))
    return replace(
        fitted, found=fitted.found.noted(*notes), uncertain=uncertain,
        inputs={name: span.words(fitted.units[name]) for name, span in design.inputs.items()},
    )  # fmt: skip


def ranges_of(design: Design) -> tuple[NumericFactor, ...]:
    """Ranges of a design."""
    ranged = [(factor, factor.span) for factor in design.factors if factor.span is not None]
    return tuple(NumericFactor(f.name, span.low, span.high, span.log) for f, span in ranged)


def coded_settings(factors: Sequence[NumericFactor], levels: Sequence[Mapping[str, str]]) -> Array:
    """Coded settings of some runs by their levels, such as ``"3 mm"`` or ``"3"``, shape (n, k)."""
    return np.column_stack([
        factor.coded(np.array([parse_number(at[factor.name].partition(" ")[0]) for at in levels]))
        for factor in factors
    ])  # fmt: skip


def _answered(
    design: Design, response: str, records: Sequence[Record]
) -> tuple[tuple[NumericFactor, ...], tuple[str, ...]]:
    """Ranges of a design without the ends where no run has an answer, and sentences about these.

    A surface beyond its last run is a guess, and where runs fail there may be nothing to guess.
    """
    factors = ranges_of(design)
    coded = coded_settings(factors, [record.levels for record in records])
    good = np.array([record.value(response) is not None for record in records], dtype=bool)
    if good.all() or not good.any():
        return factors, ()
    complete, ends = [], []
    for factor, every, its_values in zip(factors, coded.T, coded[good].T, strict=True):
        low, high = factor.low, factor.high
        # what is one share of the sample from an end is as near as runs are to each other
        near = 2.0 / len(records)
        if every.min() < its_values.min() and its_values.min() > near - 1.0:
            low = factor.setting(float(its_values.min()))
            ends.append(_end(factor.name, "below", low))
        if every.max() > its_values.max() and its_values.max() < 1.0 - near:
            high = factor.setting(float(its_values.max()))
            ends.append(_end(factor.name, "above", high))
        complete.append(replace(factor, low=low, high=high) if low < high else factor)
    return tuple(complete), tuple(ends)


def _end(name: str, side: str, value: float) -> str:
    return f"no run with {name} {side} {value:.4g} has an answer: nothing is said there"


def _runs_of_records(
    response: str,
    records: Sequence[Record],
    half_width: float | None,
    factors: tuple[NumericFactor, ...],
) -> Runs:
    """Coded settings and responses; a numerical half-width is two standard uncertainties."""
    values = np.array([record.value(response) for record in records], dtype=np.float64)
    blocks = tuple(str(record.block) for record in records if record.block is not None)
    u = None if half_width is None else np.full(values.size, half_width / 2.0)
    coded = coded_settings(factors, [record.levels for record in records])
    return Runs(response, factors, coded, values, blocks, u)


# What the page of a surface that was fitted to a table shows.


def table_data(fits: Sequence[FittedSurface], source: AnalysisSource) -> ReportData:
    """Gather what a report shows of the surfaces of one response of a table."""
    import pandas as pd

    good = [(fitted.found.runs, fitted.labels) for fitted in fits if fitted.found is not None]
    table = pd.concat([_rows(runs, labels) for runs, labels in good], ignore_index=True)
    table.insert(0, "case_id", [str(n + 1) for n in range(len(table))])
    runs, names = good[0][0], [*fits[0].labels, *good[0][0].names]
    data = data_of_table(
        source,
        ResponseAnalysis(
            runs.name, "", None, practical=fits[0].practical, title=runs.name, refused=SEE_SURFACE
        ),
        f"How does {runs.name} depend on {', '.join(names)}?",
        {name: tuple(table[name].unique()) for name in names},
        table,
        sum(len(one.distinct()[0]) for one, _ in good),
    )
    return replace(
        data,
        block="block" if runs.blocks else "",
        blocks=tuple(table["block"].unique()) if runs.blocks else (),
        surfaces=tuple(fits),
        ranges={f.name: f"{f.low:g} to {f.high:g}" for f in runs.factors},
    )


def _rows(runs: Runs, labels: Mapping[str, str]) -> pd.DataFrame:
    import pandas as pd

    settings = {
        factor.name: [f"{factor.setting(float(x)):.6g}" for x in column]
        for factor, column in zip(runs.factors, runs.coded.T, strict=True)
    }
    frame = pd.DataFrame({**{n: [at] * runs.response.size for n, at in labels.items()}, **settings})
    if runs.blocks:
        frame["block"] = list(runs.blocks)
    return frame.assign(status="converged", **{runs.name: runs.response})
