"""A scan: a cloud of points, or a scanned surface of which the vertices count."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.ground.tabular import read_csv
from study.ground.units import unit_factor
from study.laboratory.registration.rigid import isolated

#: Fewest points of a cloud that can be registered with something left over.
FEWEST_POINTS = 30
#: Fewest markers.
FEWEST_MARKERS = 3
#: Share of isolated points beyond which a cloud is no scan of a surface.
MOST_OUTLIERS = 0.4
#: Size of a cloud over that of the body outside which it is in another unit: a scan may show a
#: twentieth of a body, and is never five times as large.
SIZES = (0.05, 5.0)
#: Units that a scan may be in by mistake, in mm.
UNITS = {"m": 1000.0, "cm": 10.0, "in": 25.4, "um": 1e-3, "mm": 1.0}


@dataclass(frozen=True)
class Scan:
    """Cloud of scanned points without those that stand alone."""

    #: shape (n, 3); points, mm.
    points: Array
    #: Isolated points that were left out.
    outliers: int
    source: str


@dataclass(frozen=True)
class Markers:
    """Marked points of the body."""

    names: tuple[str, ...]
    #: shape (n, 3); places when the scan was taken, in its frame, mm.
    deformed: Array
    #: shape (n, 3); places before the deformation in the same frame; without them markers lie on
    #: the surface.
    rest: Array | None


def read_scan(path: Path, unit: str, body_size: float) -> Scan:
    """Read a scan and drop its isolated points. Units: body_size mm."""
    where = f"--scan: {path.name}"
    points = unit_factor(unit, "length") * _points(path, where)
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(axis=1).sum())
        raise InputError(Fault(where, f"{bad} points are no numbers", "export the scan again"))
    points = np.unique(points, axis=0)
    if len(points) < FEWEST_POINTS:
        rule = f"has {len(points)} points, a surface needs {FEWEST_POINTS}"
        raise InputError(Fault(where, rule, "scan more of the body"))
    alone = isolated(points)
    if alone.mean() > MOST_OUTLIERS:
        rule = f"{int(alone.sum())} of {len(points)} points stand alone: this is no surface"
        raise InputError(Fault(where, rule, "clean the cloud, or scan it more densely"))
    used = points[~alone]
    size = float(np.linalg.norm(np.ptp(used, axis=0)))
    if not SIZES[0] < size / body_size < SIZES[1]:
        factor = unit_factor(unit, "length")
        likely = min(UNITS, key=lambda name: abs(np.log(size / factor * UNITS[name] / body_size)))
        rule = f"is {size:.4g} mm large, the simulated body {body_size:.4g} mm"
        raise InputError(Fault(where, rule, f'is it in {likely}? Then say --unit "{likely}"'))
    return Scan(used, int(alone.sum()), path.name)


def _points(path: Path, where: str) -> Array:
    from study.mechanics.surface.closed_surface import read_mesh

    if path.suffix.lower() in (".csv", ".gz"):
        table = read_csv(path, required=("x", "y", "z"), source=path.name)
        return np.column_stack([table.numbers(axis) for axis in "xyz"])
    return read_mesh(path, where)[0]


def read_markers(path: Path, unit: str) -> Markers:
    """Read marked points: columns x, y, z, and x0, y0, z0 at rest where they are known."""
    table = read_csv(path, required=("x", "y", "z"), source=path.name)
    factor, n = unit_factor(unit, "length"), len(table.lines)
    if n < FEWEST_MARKERS:
        rule = f"has {n} markers, {FEWEST_MARKERS} or more are needed"
        raise InputError(Fault(f"--markers: {path.name}", rule, "mark more points"))
    at_rest = [f"{axis}0" for axis in "xyz"]
    given = [name for name in at_rest if name in table.columns]
    if given and len(given) < 3:
        rule = f"has the columns {', '.join(given)} but not all of {', '.join(at_rest)}"
        raise InputError(Fault(f"--markers: {path.name}", rule, "give all three, or none"))
    names = table.text("name") if "name" in table.columns else tuple(str(k + 1) for k in range(n))
    deformed = factor * np.column_stack([table.numbers(axis) for axis in "xyz"])
    rest = factor * np.column_stack([table.numbers(axis) for axis in at_rest]) if given else None
    return Markers(names, deformed, rest)
