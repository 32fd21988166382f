"""Contrasts that the analyst names: one set of cells against another.

``"material=ogden-1, range=60 % - material=neo-hookean, range=60 %"`` is the mean over all cells
of the first kind less that of the second; a factor that a side leaves out is averaged over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import TypeVar

import numpy as np

from study.ground.contrast import Setting, sides_of
from study.ground.errors import Fault, InputError
from study.statistics.analysis.anova_table import Effect
from study.statistics.analysis.comparisons import holm, two_sided
from study.statistics.analysis.data import Data
from study.statistics.analysis.effects import Gate, Scale
from study.statistics.analysis.linear_model import CellLayout, ModelMatrix, model_matrix
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    CLAIMS,
    NOT_RESOLVED,
    ONE_SPECIMEN,
    UNBOUNDED,
    Differences,
    Estimates,
    verdict_of,
)


@dataclass(frozen=True)
class Contrast:
    """A named difference with its intervals and its verdict."""

    name: str
    #: In the unit of the response, or a ratio where its log was analyzed; as the intervals.
    difference: float
    #: Of this contrast alone, and of all that were asked for together; None without scatter.
    ci: tuple[float, float] | None
    ci_simultaneous: tuple[float, float] | None
    df: float | None
    #: Of no difference: alone, and adjusted for all that were asked for (Holm 1979).
    p: float | None
    #: Bound of the numerical error; None where it is not known.
    u: float | None
    #: Against the smallest difference that matters.
    verdict: str
    why: str = ""
    p_holm: float | None = None


HolmTest = TypeVar("HolmTest", Effect, Contrast)


def with_holm(tests: Sequence[HolmTest]) -> tuple[HolmTest, ...]:
    """Adjust the p of all that have one together (Holm 1979, Scand. J. Statist. 6, 65)."""
    adjusted = iter(holm([test.p for test in tests if test.p is not None]).tolist())
    return tuple(test if test.p is None else replace(test, p_holm=next(adjusted)) for test in tests)


def cells_with_rows(gate: Gate, data: Data) -> CellLayout:
    """Levels of the cells that hold rows, without levels that the analysis left out."""
    first = np.unique(data.cell, return_index=True)[1]
    levels = {name: gate.layout.levels[name] for name in data.factors}
    codes = {}
    for name, its_levels in levels.items():
        index = [its_levels.index(a) if a in its_levels else -1 for a in data.layout.levels[name]]
        codes[name] = np.array(index)[data.layout.codes[name][first]]
    cells = CellLayout(levels, codes)
    return cells.take(np.flatnonzero(np.all([code >= 0 for code in codes.values()], axis=0)))


def contrasts(gate: Gate, data: Data, texts: Sequence[str]) -> tuple[Contrast, ...]:
    """Estimate differences of sets of cells."""
    estimated, faults = possible_contrasts(gate, data, texts)
    if faults:
        raise InputError(faults)
    return estimated


def possible_contrasts(
    gate: Gate, data: Data, texts: Sequence[str]
) -> tuple[tuple[Contrast, ...], list[Fault]]:
    """Estimate those differences of sets of cells that can be, and say what keeps the others."""
    possible: list[_Sides] = []
    cells = cells_with_rows(gate, data)
    faults: list[Fault] = []
    for text in texts:
        try:
            possible.append(_sides(text, cells))
        except InputError as error:
            faults += error.faults
    if not possible:
        return (), faults
    estimates = gate.sample(_differences(gate.matrix, gate.layout, possible))
    lost = np.isnan(estimates.value)
    if lost.any():
        rule = "needs cells without rows"
        faults += [Fault(f"contrast {s.text!r}", rule) for s in compress(possible, lost)]
        if lost.all():
            return (), faults
        possible = list(compress(possible, ~lost))
        estimates = gate.sample(_differences(gate.matrix, gate.layout, possible))
    judged = _withdrawn(gate, possible, _judged(gate, possible, estimates))
    return with_holm(judged), faults


@dataclass(frozen=True)
class _Sides:
    """The cells of both sides of a contrast."""

    text: str
    settings: tuple[Setting, Setting]
    cells: tuple[CellLayout, CellLayout]
    #: Over which settings a factor is averaged where cells are empty.
    averaged: str
    #: Whether both sides name every factor.
    is_of_cells: bool


def _sides(text: str, cells: CellLayout) -> _Sides:
    """Find the cells of a contrast, each side averaged over settings that both of them have."""
    settings = sides_of(text, cells.levels)
    holds = [
        np.all([cells.codes[n] == cells.levels[n].index(a) for n, a in setting.items()], axis=0)
        for setting in settings
    ]
    for setting, side in zip(settings, holds, strict=True):
        if not side.any():
            named = ", ".join(f"{name}={level}" for name, level in setting.items())
            raise InputError(Fault(f"contrast {text!r}", f"no row has {named}"))
    others = [name for name in cells.levels if name not in settings[0]]
    averaged = ""
    if set(settings[0]) == set(settings[1]) and others:
        at = cells.cell(others)
        both = np.intersect1d(at[holds[0]], at[holds[1]])
        every = np.union1d(at[holds[0]], at[holds[1]]).size
        if not both.size:
            rule = f"its sides have no setting of {', '.join(others)} in common"
            raise InputError(Fault(f"contrast {text!r}", rule))
        if both.size < every:
            averaged = f"over the {both.size} of {every} settings of {', '.join(others)} with both"
            holds = [side & np.isin(at, both) for side in holds]
    first, second = (cells.take(np.flatnonzero(side)) for side in holds)
    is_of_cells = all(len(setting) == len(cells.levels) for setting in settings)
    return _Sides(text, settings, (first, second), averaged, is_of_cells)


def _differences(
    matrix: ModelMatrix, layout: CellLayout, contrasted: Sequence[_Sides]
) -> Differences:
    """Combine the coefficients of a model to the two means of each contrast."""
    settings = np.zeros((2 * len(contrasted), matrix.columns.shape[1]))
    for i, cells in enumerate(side for sides in contrasted for side in sides.cells):
        first = np.zeros(cells.n, dtype=np.int64)
        codes = {name: cells.codes.get(name, first) for name in layout.levels}
        rows = model_matrix(CellLayout(layout.levels, codes), matrix.terms[1:])
        for term in matrix.terms:
            if set(term) <= cells.levels.keys():
                settings[i, matrix.of(term)] = rows.columns[:, rows.of(term)].mean(axis=0)
    first = np.arange(0, len(settings), 2)
    return Differences(settings, first, first + 1)


def _judged(gate: Gate, contrasted: Sequence[_Sides], estimates: Estimates) -> list[Contrast]:
    """Judge contrasts by the printed analysis alone."""
    scale, listed = gate.scale, []
    for i, (sides, value) in enumerate(zip(contrasted, estimates.value.tolist(), strict=True)):
        u = 0.0 if scale.bound is None else scale.bound.of(*map(dict, sides.settings))
        shown = None if u is None or scale.bound is None else u / scale.unit
        why = "nothing scatters, so there is no interval"
        contrast = Contrast(
            sides.text, scale.back(value), None, None, None, None, shown, CANNOT_TELL, why
        )
        ends = _ends(estimates, i)
        if estimates.error is not None and ends is not None:
            verdict, why = _verdict(*ends, u, scale)
            error, df = float(estimates.error[i]), None
            if estimates.df is not None:
                df = float(np.broadcast_to(estimates.df, estimates.value.shape)[i])
            contrast = replace(
                contrast,
                ci=scale.ends(ends[0]),
                ci_simultaneous=scale.ends(ends[1]),
                df=df,
                p=two_sided(value / error, df) if error and df is not None else None,
                verdict=verdict,
                why="; ".join(filter(None, (why, sides.averaged))),
            )
        listed.append(contrast)
    return listed


def _ends(estimates: Estimates, i: int) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the interval of a contrast alone, and that of all together."""
    if estimates.error is None:
        return None
    value, error = float(estimates.value[i]), float(estimates.error[i])
    halves = [
        float(np.broadcast_to(multiplier, estimates.value.shape)[i]) * error
        for multiplier in (estimates.single, estimates.simultaneous)
    ]
    alone, every = ((value - half, value + half) for half in halves)
    return alone, every


def _withdrawn(gate: Gate, contrasted: Sequence[_Sides], printed: list[Contrast]) -> list[Contrast]:
    """Withdraw claims that an analysis as defensible as the printed one does not make."""
    contrasts = [
        replace(c, verdict=CANNOT_TELL, why=gate.undecided)
        if gate.undecided and c.verdict in CLAIMS and not sides.is_of_cells
        else c
        for c, sides in zip(printed, contrasted, strict=True)
    ]
    for rival in gate.rivals:
        if not {c.verdict for c in contrasts} & set(CLAIMS) & set(rival.claims):
            continue
        scale = replace(gate.scale, practical=rival.practical or gate.scale.practical)
        estimates = rival.sample(_differences(rival.matrix or gate.matrix, gate.layout, contrasted))
        for i, (contrast, sides) in enumerate(zip(contrasts, contrasted, strict=True)):
            u = 0.0 if scale.bound is None else scale.bound.of(*map(dict, sides.settings))
            ends = _ends(estimates, i)
            verdict = CANNOT_TELL if ends is None else _verdict(*ends, u, scale)[0]
            if contrast.verdict in rival.claims and contrast.verdict != verdict:
                contrasts[i] = replace(contrast, verdict=CANNOT_TELL, why=rival.why)
    return contrasts


def _verdict(
    ci: tuple[float, float], wide: tuple[float, float], u: float | None, scale: Scale
) -> tuple[str, str]:
    """Verdict, and why it is none where the interval alone does not show that."""
    if scale.practical is None:
        return CANNOT_TELL, "no practical threshold was given"
    if scale.specimens == 1:
        return CANNOT_TELL, ONE_SPECIMEN
    verdict = verdict_of(ci, wide, u, scale.practical)
    if verdict == NOT_RESOLVED and u is None:
        return verdict, UNBOUNDED
    return verdict, "2 specimens" if scale.specimens == 2 and verdict in CLAIMS else ""
