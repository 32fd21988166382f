"""A scan: a cloud of points, or a scanned surface of which the vertices count."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.registration.robust import isolated
from study.tabular import read_csv
from study.units import unit_factor

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
    """Cloud of scanned points without those that stand alone.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points, mm.
    outliers : int
        Isolated points that were left out.
    source : str
        File.
    """

    points: Array
    outliers: int
    source: str


@dataclass(frozen=True)
class Markers:
    """Marked points of the body.

    Parameters
    ----------
    names : tuple of str
        Labels.
    deformed : ndarray, shape (n, 3)
        Places when the scan was taken, in its frame, mm.
    rest : ndarray, shape (n, 3), or None
        Places before the deformation in the same frame; without them markers lie on the surface.
    """

    names: tuple[str, ...]
    deformed: Array
    rest: Array | None


def read_scan(path: Path, unit: str, body_size: float) -> Scan:
    """Read a scan and drop its isolated points.

    Parameters
    ----------
    path : Path
        PLY, STL or OBJ; or CSV with columns x, y and z.
    unit : str
        Unit of the file.
    body_size : float
        Diagonal of the simulated body, mm: shows a wrong unit.

    Returns
    -------
    Scan

    Raises
    ------
    InputError
        For too few points, too many isolated ones, or another unit.
    """
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
    kept = points[~alone]
    _check_unit(kept, unit, body_size, where)
    return Scan(kept, int(alone.sum()), path.name)


def _points(path: Path, where: str) -> Array:
    from study.surface.surface import read_mesh

    if path.suffix.lower() in (".csv", ".gz"):
        table = read_csv(path, required=("x", "y", "z"), source=path.name)
        return np.column_stack([table.numbers(axis) for axis in "xyz"])
    return read_mesh(path, where)[0]


def _check_unit(points: Array, unit: str, body_size: float, where: str) -> None:
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if SIZES[0] < size / body_size < SIZES[1]:
        return
    factor = unit_factor(unit, "length")
    likely = min(UNITS, key=lambda name: abs(np.log(size / factor * UNITS[name] / body_size)))
    rule = f"is {size:.4g} mm large, the simulated body {body_size:.4g} mm"
    raise InputError(Fault(where, rule, f'is it in {likely}? Then say --unit "{likely}"'))


def read_markers(path: Path, unit: str) -> Markers:
    """Read marked points: columns x, y, z, and x0, y0, z0 at rest where they are known.

    Parameters
    ----------
    path : Path
        CSV; a column ``name`` gives labels.
    unit : str
        Unit of the file.

    Returns
    -------
    Markers

    Raises
    ------
    InputError
        For a faulty file or fewer than three markers.
    """
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
