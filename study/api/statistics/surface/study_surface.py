"""Surfaces over the numeric factors of a study's own runs."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.request import threshold
from study.api.statistics.surface.level_surfaces import differences
from study.api.statistics.surface.response_surface import fitted, fitted_together, told
from study.arrays import Array
from study.design import overlay
from study.design.factors import settings_of
from study.design.statistics.uncertainty import usual_value
from study.errors import StudyError
from study.record.table import is_repeat
from study.reporting.text import count
from study.response_surface.factors import NumericFactor, Runs
from study.response_surface.propagation import propagate
from study.study_result.response_surface import FittedSurface

if TYPE_CHECKING:
    from study.analysis.convergence.grid_convergence import NumericalUncertainty
    from study.design.spec import Design, Response
    from study.record.record import Record
    from study.response_surface.emulator.blocked import BlockedEmulator
    from study.response_surface.emulator.emulator import Emulator
    from study.response_surface.propagation import Propagated
    from study.response_surface.result import SurfaceAnalysis

#: kinds of a design whose settings are chosen for a surface
_FOR_SURFACES = ("central-composite", "box-behnken", "latin-hypercube", "sobol", "adaptive")

#: what stands in the place of a table of levels
SEE_SURFACE = "its factors are numbers: see the surface"


def is_numeric(design: Design) -> bool:
    """Whether a surface over the ranges of a design answers its question.

    Parameters
    ----------
    design : Design
        With ``[analysis] surface = "auto"`` it must be of a kind that is made for surfaces.
    """
    ranged = any(factor.span is not None for factor in design.factors)
    asked = design.analysis.surface
    if not ranged or asked == "none":
        return False
    return asked != "auto" or design.scheme.kind in _FOR_SURFACES


def surfaces(
    design: Design, records: Sequence[Record], numerical: Sequence[NumericalUncertainty]
) -> tuple[FittedSurface, ...]:
    """Fit every response of a design over its ranges, at every combination of the other levels.

    A run without an answer is left out and said; it is never imputed.

    Parameters
    ----------
    design : Design
        Whose factors are ranges; one without a surface to answer its question gives none.
    records : sequence of Record
        Those that are computed; replicates are passed over.
    numerical : sequence of NumericalUncertainty
        What refinement found.
    """
    if not is_numeric(design):
        return ()
    others = [factor for factor in design.factors if factor.span is None]
    own = [record for record in records if not is_repeat(record.extra)]
    combinations = itertools.product(*(factor.labels for factor in others))
    places = [dict(zip([f.name for f in others], labels, strict=True)) for labels in combinations]
    found: list[FittedSurface] = []
    for response in design.responses:
        half_width = _half_width(response.name, records, numerical)
        asked = _Asked(design, response, half_width, *_answered(design, response.name, own))
        together = _together(asked, places, own)
        each = [_fitted(asked, labels, own, together.get(place))
                for place, labels in enumerate(places)]  # fmt: skip
        first = {factor.name: factor.labels[0] for factor in others}
        found += [replace(one, differences=differences(one, each, first)) for one in each]
    return tuple(found)


@dataclass(frozen=True)
class _Asked:
    """A response of a design, and the largest numerical half-width of its runs.

    Its factors have the ranges over which runs have answers, and ``ends`` says which are cut.
    """

    design: Design
    response: Response
    half_width: float | None
    factors: tuple[NumericFactor, ...]
    ends: tuple[str, ...]

    def good(
        self, labels: Mapping[str, str], records: Sequence[Record]
    ) -> tuple[list[Record], int]:
        """Collect the runs with an answer at some levels, and count those without."""
        here = [r for r in records if all(r.levels[n] == label for n, label in labels.items())]
        answered = [one for one in here if one.value(self.response.name) is not None]
        return answered, len(here) - len(answered)

    def runs(self, records: Sequence[Record]) -> Runs:
        """Code the settings of runs."""
        return _runs(self.design, self.response.name, records, self.half_width, self.factors)


def _together(
    asked: _Asked, places: Sequence[Mapping[str, str]], records: Sequence[Record]
) -> Mapping[int, Emulator | BlockedEmulator]:
    """Fit the runs at all combinations of levels together, where that tells left-out runs better.

    Parameters
    ----------
    places : sequence of mapping
        Combinations of the levels of factors that are no ranges.
    records : sequence of Record
        Runs of the design.

    Returns
    -------
    mapping of int to Emulator or BlockedEmulator
        By the number of the combination; empty where each has a surface of its own.
    """
    design = asked.design
    sizes = [len(f.labels) for f in design.factors if f.span is None]
    try:
        every = [asked.runs(asked.good(labels, records)[0]) for labels in places]
        found = fitted_together(every, sizes, design.analysis.surface)
    except StudyError:
        return {}
    return {} if found is None else dict(enumerate(found))


def runs_at(
    design: Design, response: str, labels: Mapping[str, str], records: Sequence[Record]
) -> Runs:
    """Collect the runs of a response that have an answer, at one combination of the other levels.

    Parameters
    ----------
    design : Design
        Its ranges code the settings.
    response : str
        Name of a response of the design.
    labels : mapping of str to str
        Levels of the factors that are no ranges.
    records : sequence of Record
        Those that are computed; replicates are passed over.
    """
    here = [r for r in records if all(r.levels[name] == label for name, label in labels.items())]
    good = [r for r in here if not is_repeat(r.extra) and r.value(response) is not None]
    return _runs(design, response, good, None, _factors(design))


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


def _fitted(
    asked: _Asked,
    labels: Mapping[str, str],
    records: Sequence[Record],
    model: Emulator | BlockedEmulator | None,
) -> FittedSurface:
    design, response = asked.design, asked.response
    good, lost = asked.good(labels, records)
    # each of two settings may be off by its own bound
    bound = None if asked.half_width is None else 2.0 * asked.half_width
    practical = None
    units_of = {f.name: f.span.unit for f in design.factors if f.span is not None}
    try:
        runs = asked.runs(good)
        limit = threshold(response.practical)
        if limit is not None:
            practical = limit.on_scale(float(runs.response.mean()), "none")
        one = fitted(runs, design.analysis.surface) if model is None else model
        found = told(one, practical, bound or 0.0).noted(*_left_out(lost), *asked.ends)
        uncertain, refused = _propagated(design, found)
        found = found.noted(refused) if refused else found
    except StudyError as error:
        return FittedSurface(
            response.name, response.unit, None, str(error), labels, practical, bound, units_of
        )
    words = {name: one.words(units_of[name]) for name, one in design.inputs.items()}
    return FittedSurface(
        response.name, response.unit, found, "", labels, practical, bound, units_of, uncertain,
        words,
    )  # fmt: skip


def _propagated(design: Design, found: SurfaceAnalysis) -> tuple[Propagated | None, str]:
    """Carry uncertain inputs through a surface; a refusal is a sentence."""
    if not design.inputs:
        return None, ""
    fixed = {
        f.name: usual_value(f.name, overlay.dimension(f.name) or "number", f.span, design.config)
        for f in design.factors
        if f.span is not None and f.name not in design.inputs
    }
    try:
        return propagate(found, design.inputs, fixed, design.seed), ""
    except StudyError as error:
        return None, str(error)


def _left_out(failed: int) -> tuple[str, ...]:
    if not failed:
        return ()
    return (f"{count(failed, 'run')} without an answer left out; nothing is put in the place",)


def _factors(design: Design) -> tuple[NumericFactor, ...]:
    """Ranges of a design."""
    ranged = [(factor, factor.span) for factor in design.factors if factor.span is not None]
    return tuple(NumericFactor(f.name, span.low, span.high, span.log) for f, span in ranged)


def _coded(design: Design, factors: Sequence[NumericFactor], records: Sequence[Record]) -> Array:
    """Coded settings of some runs, shape (n, k)."""
    columns = []
    ranged = [factor for factor in design.factors if factor.span is not None]
    for factor, numeric in zip(ranged, factors, strict=True):
        known = settings_of(factor)
        settings = [known[record.levels[factor.name]] for record in records]
        columns.append(numeric.coded(np.array(settings, dtype=np.float64)))
    return np.column_stack(columns)


def _answered(
    design: Design, response: str, records: Sequence[Record]
) -> tuple[tuple[NumericFactor, ...], tuple[str, ...]]:
    """Ranges of a design without the ends where no run has an answer, and sentences about these.

    A surface beyond its last run is a guess, and where runs fail there may be nothing to guess.
    """
    factors, coded = _factors(design), _coded(design, _factors(design), records)
    good = np.array([record.value(response) is not None for record in records], dtype=bool)
    if good.all() or not good.any():
        return factors, ()
    found, ends = [], []
    for one, every, own in zip(factors, coded.T, coded[good].T, strict=True):
        low, high = one.low, one.high
        # what is one share of the sample from an end is as near as runs are to each other
        near = 2.0 / len(records)
        if every.min() < own.min() and own.min() > near - 1.0:
            low = one.setting(float(own.min()))
            ends.append(_end(one.name, "below", low))
        if every.max() > own.max() and own.max() < 1.0 - near:
            high = one.setting(float(own.max()))
            ends.append(_end(one.name, "above", high))
        found.append(replace(one, low=low, high=high) if low < high else one)
    return tuple(found), tuple(ends)


def _end(name: str, side: str, value: float) -> str:
    return f"no run with {name} {side} {value:.4g} has an answer: nothing is said there"


def _runs(
    design: Design,
    response: str,
    records: Sequence[Record],
    half_width: float | None,
    factors: tuple[NumericFactor, ...],
) -> Runs:
    """Coded settings and responses; a numerical half-width is two standard uncertainties."""
    values = np.array([record.value(response) for record in records], dtype=np.float64)
    blocks = tuple(str(record.block) for record in records if record.block is not None)
    u = None if half_width is None else np.full(values.size, half_width / 2.0)
    return Runs(response, factors, _coded(design, factors, records), values, blocks, u)
