"""Measured against commanded displacement of a marker on a linear stage.

A stop is one observation: the mean of its samples. The commanded position has an uncertainty
of its own, so the line is fitted with errors in both quantities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.registration.agreement import Agreement, limits_of_agreement
from study.registration.deming import Line, deming_line
from study.tracker_accuracy.recording import Recording, Visit, visits_to
from study.tracker_accuracy.section import DisplacementTable
from study.units import unit_factor

#: A scale this far from 1 is another unit, not an error of a tracker.
UNIT_RATIO = 5.0


@dataclass(frozen=True)
class DisplacementResult:
    """How a tracker follows a stage.

    Parameters
    ----------
    marker : str
        The marker.
    commanded_mm, measured_mm : ndarray, shape (n_stops,)
        Displacements from home along the axis, home left out.
    line : Line
        Regression of measured on commanded displacement: scale and offset (mm).
    straightness_rms_mm, straightness_max_mm : float
        Distances of the stops from the straight line through them.
    agreement : Agreement
        Measured less commanded displacement, mm.
    repeatability_mm : float or None
        Standard deviation of stops at the same position; None where none repeats.
    home_uncertainty_mm : float
        Standard uncertainty of the home position, which every displacement shares: it is in
        the interval of the offset.
    axis : ndarray, shape (3,)
        Direction of the motion in the tracker's frame.
    stops : int
        Stops in all, home included.
    """

    marker: str
    commanded_mm: Array
    measured_mm: Array
    line: Line
    straightness_rms_mm: float
    straightness_max_mm: float
    agreement: Agreement
    repeatability_mm: float | None
    home_uncertainty_mm: float
    axis: Array
    stops: int


def analyze_displacement(
    declared: DisplacementTable, recording: Recording, alpha: float
) -> DisplacementResult:
    """Judge how a tracker follows a commanded displacement.

    Parameters
    ----------
    declared : DisplacementTable
        The marker, and where it was told to be.
    recording : Recording
        What the tracker wrote.
    alpha : float
        Size of intervals' complement.

    Returns
    -------
    DisplacementResult

    Raises
    ------
    InputError
        For too few stops, or a scale that shows another unit.
    """
    commanded = unit_factor(declared.unit, "length") * recording.table.numbers(declared.commanded)
    stops = _stops(recording, declared.commanded)
    places = np.array([recording.positions[declared.marker][s.rows].mean(axis=0) for s in stops])
    told = np.array([commanded[stop.begin] for stop in stops])
    axis, along, off = _straight(places, told)
    repeat = _repeatability(told, along)
    at_home = told == told[0]
    measured = (along - along[at_home].mean())[~at_home]
    wanted = (told - told[0])[~at_home]
    line = deming_line(wanted, measured, _ratio(declared, repeat, wanted, measured), alpha,
                       "displacement")  # fmt: skip
    if not 1 / UNIT_RATIO < line.scale < UNIT_RATIO:
        rule = f"measured is {line.scale:.4g} times commanded displacement: another unit"
        mend = "compare [recording] unit and [displacement] unit"
        raise InputError(Fault("displacement.unit", rule, mend))
    spread = line.residual_sd if repeat is None else repeat
    home = float(spread / np.sqrt(at_home.sum()))
    return DisplacementResult(
        marker=declared.marker,
        commanded_mm=wanted,
        measured_mm=measured,
        line=_with_home(line, home),
        straightness_rms_mm=float(np.sqrt((off**2).mean())),
        straightness_max_mm=float(off.max()),
        agreement=limits_of_agreement(measured, wanted, alpha, "displacement"),
        repeatability_mm=repeat,
        home_uncertainty_mm=home,
        axis=axis,
        stops=len(stops),
    )


def _stops(recording: Recording, column: str) -> list[Visit]:
    """Find samples in a row at one commanded position, within one visit to a stage."""
    labels = recording.table.text(column)
    return [
        Visit(own.stage, visit.begin + own.begin, visit.begin + own.end)
        for visit in recording.visits
        for own in visits_to(labels[visit.rows])
    ]


def _straight(places: Array, told: Array) -> tuple[Array, Array, Array]:
    """Axis of the straight line through stops, places along it, and distances from it, mm."""
    if np.unique(told).size < 3:
        rule = f"there are {np.unique(told).size} commanded positions, a line needs 3 or more"
        raise InputError(Fault("displacement.commanded", rule, "stop at more positions"))
    away = places - places.mean(axis=0)
    axis = np.linalg.svd(away, full_matrices=False)[2][0]
    along = away @ axis
    if along @ (told - told.mean()) < 0:
        axis, along = -axis, -along
    return axis, along, np.linalg.norm(away - np.outer(along, axis), axis=1)


def _repeatability(told: Array, along: Array) -> float | None:
    """Pooled standard deviation of stops at the same position."""
    groups = [along[told == value] for value in np.unique(told)]
    freedom = sum(len(group) - 1 for group in groups)
    if not freedom:
        return None
    return float(np.sqrt(sum(((g - g.mean()) ** 2).sum() for g in groups) / freedom))


def _ratio(
    declared: DisplacementTable, repeat: float | None, wanted: Array, measured: Array
) -> float:
    """Variance of a measured over that of a commanded position; infinite for an exact stage."""
    if declared.uncertainty == 0:
        return float("inf")
    if repeat is None:
        # the scatter about a first line holds both errors, each a part of it
        total = deming_line(wanted, measured, float("inf"), where="displacement").residual_sd ** 2
        own = max(total - declared.uncertainty**2, 0.1 * total)
        return float(own / declared.uncertainty**2)
    return max(repeat**2, 1e-12 * declared.uncertainty**2) / declared.uncertainty**2


def _with_home(line: Line, home: float) -> Line:
    """Line whose offset has the uncertainty of home besides its own."""
    own = line.offset_uncertainty
    total = float(np.hypot(own, home))
    half = (line.offset_interval[1] - line.offset) * (total / own if own > 0 else 1.0)
    interval = (line.offset - half, line.offset + half)
    return replace(line, offset_uncertainty=total, offset_interval=interval)
