"""A specimen given as a closed surface: read from a file, checked, and stood on its base.

The file holds triangles in a unit of its own. Inside, the specimen stands on z = 0, its
loading axis is x = y = 0 and lengths are mm.
"""

from __future__ import annotations

import functools
import os
import re
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array, Ints
from study.bounded_file import UnreadableError, open_regular
from study.errors import Fault, InputError, UnitError
from study.setup.geometry import Brain, Enclosed, Specimen, Surface
from study.surface.brain import brain_surface
from study.surface.integrity import area, inspect, volume
from study.units import parse

SUFFIXES = (".stl", ".ply", ".obj")
MAX_BYTES = 200 * 1024**2

#: bytes of a binary STL before its triangles, and of each of them
_STL_HEADER = 84
_STL_TRIANGLE = 50

#: bytes of a PLY header, comments included
_PLY_HEADER = 64 * 1024

#: more triangles than any mesh for a laptop can follow
MAX_TRIANGLES = 500_000

#: faces within this fraction of the height of the lowest or highest point touch the plates
PLATE_TOLERANCE = 1e-4

#: cosine of the angle that such a face may have to the plate (10 deg)
_LEVEL = 0.985

#: lengths of a specimen, in mm, outside which a unit is suspect
PLAUSIBLE_MM = (2.0, 1000.0)

#: file coordinates (columns, signs) that become x, y and z where this axis points up
_TURNS: dict[str, tuple[tuple[int, int, int], tuple[int, int, int]]] = {
    "z": ((0, 1, 2), (1, 1, 1)),
    "-z": ((0, 1, 2), (1, -1, -1)),
    "x": ((1, 2, 0), (1, 1, 1)),
    "-x": ((1, 2, 0), (1, -1, -1)),
    "y": ((2, 0, 1), (1, 1, 1)),
    "-y": ((2, 0, 1), (1, -1, -1)),
}
AXES = tuple(_TURNS)


def _turn(u: Array, v: Array) -> Array:
    """Twice the area between two rows of points and the axis, seen from above."""
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


@dataclass(frozen=True, eq=False)
class Body:
    """A checked surface that stands on z = 0 below its plate.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Vertices in mm.
    triangles : ndarray of int, shape (m, 3)
        Counterclockwise seen from outside.
    top, base : ndarray of bool, shape (m,)
        Triangles that lie in the upper and in the lower plate.
    lowest_mm : float
        Position of z = 0 along the axis of the file.
    notes : tuple of str
        What was mended, and what looks strange.
    """

    points: Array
    triangles: Ints
    top: NDArray[np.bool_]
    base: NDArray[np.bool_]
    lowest_mm: float
    notes: tuple[str, ...] = ()

    @property
    def height_mm(self) -> float:
        """Height of the highest point."""
        return float(self.points[:, 2].max())

    @functools.cached_property
    def volume_mm3(self) -> float:
        """Volume enclosed."""
        return volume(self.points, self.triangles)

    @functools.cached_property
    def area_mm2(self) -> float:
        """Area of all triangles."""
        return area(self.points, self.triangles)

    @property
    def half_width_mm(self) -> float:
        """Distance from the loading axis to the nearest side of the bounding box."""
        low, high = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        return float(max(min(high.min(), -low.max()), 0.0))

    @functools.cached_property
    def axis_height_mm(self) -> float:
        """Height of the highest point on the loading axis; 0 where it misses the body."""
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        shares = np.column_stack([_turn(b, c), _turn(c, a), _turn(a, b)])
        twice = shares.sum(axis=1)
        hit = (twice > 0) & (shares >= 0).all(axis=1)  # those that face up
        if not hit.any():
            return 0.0
        z = np.column_stack([a[hit, 2], b[hit, 2], c[hit, 2]])
        return float(((shares[hit] * z).sum(axis=1) / twice[hit]).max())

    def rounding_mm(self, sharp: float) -> float:
        """Integral of the mean curvature over the round part of the surface, mm.

        Half the sum of length times angle over all edges (Steiner 1840) that are bent by less
        than ``sharp`` (rad): 4 pi R of a ball, 0 of a box.
        """
        corners = self.points[self.triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        a, b, c = self.triangles.T
        sides = np.sort(np.concatenate([[a, b], [b, c], [c, a]], axis=1), axis=0)
        first, second = np.lexsort(sides).reshape(-1, 2).T  # closed: every edge has two triangles
        ends = self.points[sides[:, first]]
        faces = len(self.triangles)
        between = (normal[first % faces] * normal[second % faces]).sum(axis=1)
        angle = np.arccos(np.clip(between, -1, 1))
        bent = np.linalg.norm(ends[0] - ends[1], axis=1) * angle
        return float(bent[angle < sharp].sum() / 2)

    def plate_area_mm2(self, which: str) -> float:
        """Area that lies in the plate above (``"top"``) or below (``"base"``)."""
        chosen = self.triangles[self.top if which == "top" else self.base]
        a, b, c = (self.points[chosen[:, k], :2] for k in range(3))
        u, v = b - a, c - a
        return float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2)

    def touches(self, which: str) -> bool:
        """Whether a face lies in a plate: more than a thousandth of the cross-section."""
        return self.plate_area_mm2(which) > 1e-3 * self.volume_mm3 / self.height_mm


def height_of(specimen: Specimen) -> float:
    """Height of a specimen in mm; that of a surface is read from its file.

    Parameters
    ----------
    specimen : Specimen
        Of any shape; a faulty file raises as :func:`body` does.
    """
    return body(specimen).height_mm if isinstance(specimen, Enclosed) else specimen.height_mm


def body(surface: Enclosed) -> Body:
    """Read or make, check and stand up the surface of a specimen.

    Parameters
    ----------
    surface : Surface or Brain
        Everything that is wrong with its file is told by one InputError.
    """
    if isinstance(surface, Brain):
        return _made(surface)
    if not isinstance(surface, Surface):
        raise TypeError(f"no surface is known of {type(surface).__name__}")
    path = Path(surface.file)
    try:
        state = path.stat()
    except (OSError, ValueError) as error:
        rule = f"{surface.file!r} cannot be read ({getattr(error, 'strerror', None) or error})"
        raise InputError(Fault("specimen.file", rule, "check the path")) from error
    return _body(surface, state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=8)
def _body(surface: Surface, changed: int, size: int) -> Body:
    """Body of a file as it is now; ``changed`` and ``size`` tell versions of it apart."""
    points, triangles = read_triangles(Path(surface.file))
    found = inspect(points, triangles, Path(surface.file).name, surface.unit)
    scale = unit_mm(surface.unit)
    turned = turned_up(found.points * scale, surface.axis)
    notes = (*found.notes, *_implausible(np.ptp(turned, axis=0), surface.unit))
    return _stood(turned, found.triangles, surface, notes)


@functools.lru_cache(maxsize=8)
def _made(brain: Brain) -> Body:
    """Body of a formula, checked as a file would be."""
    found = inspect(*brain_surface(brain), "brain", "mm")
    return _stood(found.points, found.triangles, brain, found.notes)


def _stood(turned: Array, triangles: Ints, surface: Enclosed, notes: tuple[str, ...]) -> Body:
    """Stand a surface on z = 0, its loading axis at x = y = 0."""
    low, high = turned.min(axis=0), turned.max(axis=0)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    beside = []
    for k, given in enumerate((surface.press_x_mm, surface.press_y_mm)):
        origin[k] = origin[k] if given is None else given
        if not low[k] <= origin[k] <= high[k]:
            rule = f"{given:g} mm is beside the specimen, which reaches from {low[k]:.8g} to "
            mend = "choose press_x and press_y inside its outline"
            beside.append(Fault(f"specimen.press_{'xy'[k]}", f"{rule}{high[k]:.8g} mm", mend))
    if beside:
        raise InputError(beside)
    height = float(high[2] - low[2])
    tolerance = surface.plate_tolerance_mm
    within = PLATE_TOLERANCE * height if tolerance is None else tolerance
    standing, top, base = _flattened(turned - origin, triangles, height, within)
    return Body(standing, triangles, top, base, float(low[2]), notes)


def unit_mm(unit: str) -> float:
    """Length of a unit in mm.

    Parameters
    ----------
    unit : str
        Its symbol; one that is no unit of length raises InputError.
    """
    try:
        return parse(f"1 {unit}", "length")
    except UnitError as error:
        mend = 'for example unit = "mm"; an STL file does not say in which unit it is'
        rule = f"{unit!r} is no unit of length"
        raise InputError(Fault("specimen.unit", rule, mend)) from error


def turned_up(points: Array, axis: str) -> Array:
    """Turn points, never mirrored, so that an axis of theirs points up.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Coordinates.
    axis : str
        One of :data:`AXES`.

    Raises
    ------
    InputError
        For another word.
    """
    if axis not in _TURNS:
        rule = f"must be one of {', '.join(AXES)}, got {axis!r}"
        raise InputError(Fault("specimen.axis", rule, "it is the axis of the file that points up"))
    columns, signs = _TURNS[axis]
    return np.asarray(points[:, columns] * np.array(signs, dtype=float))


def _flattened(
    points: Array, triangles: Ints, height: float, tolerance: float
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Put the corners of all faces that touch a plate exactly into it."""
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = normal[:, 2] / np.linalg.norm(normal, axis=1)
    z = corners[:, :, 2]
    top = (z > height - tolerance).all(axis=1) & (level > _LEVEL)
    base = (z < tolerance).all(axis=1) & (level < -_LEVEL)
    out = points.copy()
    out[np.unique(triangles[top]), 2] = height
    out[np.unique(triangles[base]), 2] = 0.0
    return out, top, base


def _implausible(extent: Array, unit: str) -> tuple[str, ...]:
    low, high = PLAUSIBLE_MM
    largest = float(extent.max())
    if low <= largest <= high:
        return ()
    size = " x ".join(f"{v:.4g}" for v in extent)
    return (
        f"specimen.unit: the specimen is {size} mm, outside {low:g} to {high:g} mm: is it really "
        f"in {unit}?",
    )


def read_triangles(path: Path) -> tuple[Array, Ints]:
    """Vertices and triangles of an STL (ASCII or binary), PLY or OBJ file, as written.

    Parameters
    ----------
    path : Path
        InputError if it is too large, empty, malformed or holds other faces than triangles.
    """
    where = f"specimen.file: {path.name}"
    points, triangles = read_mesh(path, where)
    if not len(triangles):
        raise InputError(Fault(where, "holds no triangles", "save the surface, not its points"))
    if len(triangles) > MAX_TRIANGLES:
        rule = f"has {len(triangles)} triangles, the limit is {MAX_TRIANGLES}"
        raise InputError(Fault(where, rule, "decimate the surface: a mesh cannot follow it"))
    return points, triangles


def read_mesh(path: Path, where: str) -> tuple[Array, Ints]:
    """Read the points and triangles of an STL, PLY or OBJ file; there may be points alone.

    Parameters
    ----------
    path, where : Path and str
        The file, and its name in messages.

    Returns
    -------
    points : ndarray, shape (n, 3)
    triangles : ndarray of int, shape (m, 3)

    Raises
    ------
    InputError
        If the file is missing, too large, empty, malformed or holds other faces.
    """
    try:
        stream = open_regular(path, sys.maxsize)
    except UnreadableError as error:
        raise InputError(Fault(where, error.rule, "check the path")) from error
    if stream is None:
        rule = "cannot be read (there is no such file)"
        raise InputError(Fault(where, rule, "check the path"))
    with stream:
        raw_size, head = os.fstat(stream.fileno()).st_size, stream.read(_PLY_HEADER)
    if path.suffix.lower() not in SUFFIXES:
        rule = f"must end in {', '.join(SUFFIXES)}, got {path.suffix!r}"
        raise InputError(Fault(where, rule, "save the surface as STL"))
    if not raw_size:
        raise InputError(Fault(where, "is empty", "save the surface again"))
    if raw_size > MAX_BYTES:
        rule = f"has {raw_size / 1024**2:.0f} MB, the limit is {MAX_BYTES // 1024**2} MB"
        raise InputError(Fault(where, rule, "decimate the surface: a mesh cannot follow it"))
    if path.suffix.lower() == ".ply":
        _check_ply_header(head, raw_size, where)
    if path.suffix.lower() == ".stl":
        _check_stl_size(head[:1024], raw_size, where)
    return _parsed(path, where)


def _parsed(path: Path, where: str) -> tuple[Array, Ints]:
    from meshio import obj, ply, stl

    read = {".stl": stl.read, ".ply": ply.read, ".obj": obj.read}[path.suffix.lower()]
    mend = "save the surface again, as binary STL"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a text that ends early is no more than a warning
            # meshio counts the triangles of a text as if it were binary
            warnings.filterwarnings("ignore", message="overflow encountered")
            mesh = read(str(path))
            points = np.array(mesh.points, dtype=float).reshape(-1, 3)
            blocks = [(block.type, np.asarray(block.data, dtype=np.int64)) for block in mesh.cells]
    except Exception as error:  # meshio's parsers raise whatever they stumble over
        reason = str(error).split("\n")[0][:120] or "it breaks the rules of its format"
        raise InputError(Fault(where, f"is malformed: {reason}", mend)) from error
    other = sorted({kind for kind, _ in blocks if kind not in ("triangle", "line", "vertex")})
    if other:
        rule = f"holds faces that are no triangles ({', '.join(other)})"
        raise InputError(Fault(where, rule, "triangulate the surface"))
    faces = [data.reshape(-1, 3) for kind, data in blocks if kind == "triangle"]
    triangles = np.concatenate(faces) if faces else np.zeros((0, 3), dtype=np.int64)
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
        rule = "is malformed: a triangle names a point that is not there"
        raise InputError(Fault(where, rule, mend))
    return points, triangles


def _check_stl_size(head: bytes, size: int, where: str) -> None:
    """Refuse a binary STL that is shorter or longer than its own count of triangles says."""
    if head.lstrip().startswith(b"solid") and b"facet" in head:
        return
    count = int.from_bytes(head[80:84], "little")
    if size < _STL_HEADER or size != _STL_HEADER + _STL_TRIANGLE * count:
        room = max(size - _STL_HEADER, 0) / _STL_TRIANGLE
        rule = f"is malformed: its header promises {count} triangles, it has room for {room:.4g}"
        raise InputError(Fault(where, rule, "save the surface again: it may have been cut short"))


def _check_ply_header(head: bytes, size: int, where: str) -> None:
    """Refuse a header without end, which meshio would read for ever, or with too large counts."""
    end = re.search(rb"^end_header[ \t]*\r?$", head, re.MULTILINE)
    if end is None:
        rule = "is malformed: its header has no end"
        raise InputError(Fault(where, rule, "save the surface again, as binary STL"))
    head = head[: end.start()]
    for count in re.findall(rb"element\s+\w+\s+(\d+)", head):
        if len(count) > 12 or int(count) > size:
            rule = "is malformed: its header promises more than the file holds"
            raise InputError(Fault(where, rule, "save the surface again, as binary STL"))
