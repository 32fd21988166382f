"""What a report says of a scanned surface: its answers in sentences, and its tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from study.registration.iterative_closest_point import Registration
from study.reporting.content.table import Table
from study.reporting.numbers import quantity, share, significant
from study.reporting.text import clean, count
from study.shape_validation.deviation import MarkerDeviation, ShapeDeviation


def answers(found: ShapeDeviation) -> list[str]:
    """Say in a few sentences what was found.

    Parameters
    ----------
    found : ShapeDeviation
        Lengths in mm. Sentences on registration and markers only where these are not None.

    Returns
    -------
    list of str
        Plain text: deviation, coverage, registration, markers.
    """
    s = found.statistics
    lines = [
        f"The scan lies {quantity(s.mean_absolute, 'mm')} from the simulated surface on average "
        f"(RMS {quantity(s.rms, 'mm')}, 95 % within {quantity(s.absolute_p95, 'mm')}, at worst "
        f"{quantity(s.largest, 'mm')}), with its sign {quantity(s.mean, 'mm')}: positive where "
        "the real body is the larger one.",
        f"{count(s.points, 'point')} of {found.scan} show {share(found.seen)} of the surface; "
        f"{count(found.outliers, 'isolated point')} left out.",
    ]
    if found.registration is not None:
        lines += _registration(found.registration, found.registration_uncertainty or 0.0)
    if found.markers is not None:
        lines += _markers(found.markers)
    return [clean(line) for line in lines]


def _registration(found: Registration, added: float) -> Iterator[str]:
    shift = float(np.linalg.norm(found.motion(found.motion.inverse(found.center[None]))[0]
                                 - found.motion.inverse(found.center[None])[0]))  # fmt: skip
    yield (
        f"Registered by closest points: moved by {quantity(shift, 'mm')} and turned by "
        f"{significant(found.motion.angle_deg)} deg; residual {quantity(found.rms_mm, 'mm')} RMS, "
        f"{found.rejected:,} of {found.used:,} points without weight. The registration is known "
        f"to {quantity(added, 'mm', 2)} (one standard uncertainty, RMS over the points)."
    )
    if found.sliding:
        listed = "; ".join(str(one) for one in found.sliding)
        yield f"The shape does not fix: {listed}. The scan was not moved along it."
    else:
        yield "The shape fixes all six motions."


def _markers(found: MarkerDeviation) -> Iterator[str]:
    what = "their simulated places" if found.paired else "the simulated surface"
    sizes = found.sizes
    text = (
        f"{count(len(sizes), 'marker')} are {quantity(found.mean, 'mm')} from {what} on average, "
        f"{quantity(found.rms, 'mm')} RMS, {quantity(float(sizes.max()), 'mm')} at worst"
    )
    if found.moved is not None:
        inside = np.isfinite(found.errors).all(axis=1)
        moved = float(np.sqrt((found.moved[inside] ** 2).mean()))
        text += f"; they moved by {quantity(moved, 'mm')} RMS"
    yield f"{text}."
    if found.outside:
        yield f"{count(found.outside, 'marker')} outside the simulated body had no place in it."


def tables(found: ShapeDeviation) -> list[Table]:
    """Statistics of the deviation, and markers.

    Parameters
    ----------
    found : ShapeDeviation
        Lengths in mm. Without markers there is one table, with markers there are two.

    Returns
    -------
    list of Table
        Shown with three significant digits; ``raw`` is unrounded.
    """
    s = found.statistics
    values = {
        "mean": s.mean, "mean of sizes": s.mean_absolute, "RMS": s.rms, "SD": s.sd,
        "largest": s.largest, "95 % of sizes": s.absolute_p95,
        **{f"percentile {name[1:]}": value for name, value in s.percentiles.items()},
    }  # fmt: skip
    rows = tuple((name, significant(value)) for name, value in values.items())
    raw = tuple({"statistic": name, "mm": value} for name, value in values.items())
    made = [Table("Deviation of the scan", ("statistic", "mm"), rows, raw=raw)]
    if found.markers is not None:
        made.append(_marker_table(found.markers))
    return made


def _marker_table(found: MarkerDeviation) -> Table:
    rows, raw = [], []
    for name, error in zip(found.names, found.errors.tolist(), strict=True):
        size = float(np.linalg.norm(error))
        rows.append((clean(name), *(significant(value) for value in (*error, size))))
        raw.append({"marker": name, "x_mm": error[0], "y_mm": error[1], "z_mm": error[2],
                    "size_mm": size})  # fmt: skip
    columns = ("marker", "x (mm)", "y (mm)", "z (mm)", "size (mm)")
    return Table("Measured less simulated place of markers", columns, tuple(rows), raw=tuple(raw))
