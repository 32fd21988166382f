"""Deviation of a simulated surface from a scan: registration, signed distances, markers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError, RefusedError
from study.ground.tabular import read_csv
from study.ground.units import times, unit_factor
from study.laboratory.registration.iterative_closest_point import (
    Registration,
    TriangleSurface,
    coarse_registration,
    register,
)
from study.laboratory.registration.rigid import RigidMotion, biweight, identity, isolated
from study.laboratory.shape.boundary import SimulatedBody
from study.mechanics.surface.closed_surface import read_mesh

#: Percentiles of the signed distances that are reported.
PERCENTILES = (5, 25, 50, 75, 95)
#: A scan is called mirrored, or of another state, if that fits it with less than this share of
#: the residual.
CLEARLY_BETTER = 0.5
#: Residuals below this share of the size are the resolution of any scanner: nothing is judged.
RESOLUTION_SHARE = 1e-3
#: Logarithm of the ratio of both sizes up to which a scan is not scaled by mistake; and the
#: distance over the size up to which a scaled one is the body.
SAME_SIZE = 0.3
SAME_SHAPE = 0.02
#: Shares of the displacement at which a scan could have been taken by mistake.
OTHER_STATES = (0.0, 0.5, 1.5)
#: Part of the surface that is nearer to a scanned point than this many spacings of them.
SEEN_SPACINGS = 3.0


@dataclass(frozen=True)
class Statistics:
    """Signed distances, positive where the scan lies outside the simulated surface, mm.

    Of the points that count: those without weight in the registration are set aside, unless they
    are the most, as of a body that is larger all around.
    """

    points: int
    #: Mean with its sign, of the sizes, root mean square, standard deviation.
    mean: float
    mean_absolute: float
    rms: float
    sd: float
    largest: float
    percentiles: dict[str, float]
    #: 95 % of the sizes are below.
    absolute_p95: float
    #: Points without weight, and the largest distance among them.
    set_aside: int = 0
    largest_set_aside: float | None = None


@dataclass(frozen=True)
class MarkerDeviation(Keyed):
    """Marked points against the simulation."""

    KEYS = "paired markers=names.__len__ outside mean_mm=mean rms_mm=rms largest_mm=sizes.max"

    names: tuple[str, ...]
    #: shape (n, 3); measured less simulated place, mm; nan for a marker outside the simulated body.
    #: For markers without a place at rest: their way to the deformed surface.
    errors: Array
    #: shape (n,); measured displacement, mm.
    moved: Array | None
    #: Whether material points were compared, rather than distances to the surface.
    paired: bool
    #: Markers outside the simulated body at rest, without an error.
    outside: int

    @property
    def sizes(self) -> Array:
        """Size of the errors of markers inside, mm."""
        sizes = np.linalg.norm(self.errors, axis=1)
        return np.asarray(sizes[np.isfinite(sizes)])

    @property
    def mean(self) -> float:
        """Mean size, mm."""
        return float(self.sizes.mean())

    @property
    def rms(self) -> float:
        """Root mean square of the sizes, mm."""
        return float(np.sqrt((self.sizes**2).mean()))


@dataclass(frozen=True)
class ShapeDeviation(Keyed):
    """Deviation of a simulated body from a scan; lengths in mm."""

    KEYS = (
        "name scan outliers registration registration_uncertainty_mm=registration_uncertainty "
        "deviation_mm=statistics seen markers symmetry notes report"
    )

    name: str
    scan: str
    #: Isolated points of the scan that were left out.
    outliers: int
    #: None where the frames were taken as they are.
    registration: Registration | None
    #: shape (n, 3); registered points and their signed distances, mm.
    points: Array
    distances: Array
    #: shape (n, 3); unit normals of the simulated surface there.
    normals: Array
    statistics: Statistics
    #: Share of the simulated surface that the scan shows.
    seen: float
    #: RMS over the points of the uncertainty that the registration adds, mm.
    registration_uncertainty: float | None
    markers: MarkerDeviation | None
    #: How the simulated part became the whole body.
    symmetry: str
    #: What was mended, and what the figures do not say.
    notes: tuple[str, ...] = ()
    report: str | None = None


@dataclass(frozen=True)
class ShapeOptions:
    """How a scan is compared."""

    #: Whether the scan is moved onto the surface; else the frames agree already.
    register: bool = True
    #: Whether a scan that another state fits better is compared nevertheless.
    any_state: bool = False


def judge_shape(
    name: str, body: SimulatedBody, scan: Scan, markers: Markers | None, options: ShapeOptions
) -> ShapeDeviation:
    """Compare a simulated body with a scan of the real one."""
    surface, registration, motion = body.deformed, None, identity()
    if options.register:
        distance, start = coarse_registration(surface, scan.points)
        _check_handedness(surface, scan, distance)
        _check_size(surface, scan, distance)
        if not options.any_state:
            _check_state(body, scan, distance, start)
        registration = register(surface, scan.points, [start])
        motion = registration.motion
    placed = motion(scan.points)
    closest = surface.closest(placed)
    added = None
    if registration is not None:
        added = float(np.sqrt((registration.uncertainty_at(placed) ** 2).mean()))
    from scipy.spatial import cKDTree

    tree = cKDTree(placed)
    spacing = float(np.median(tree.query(placed, k=2)[0][:, 1]))
    centers = surface.corners.mean(axis=1)
    off = float(np.median(np.abs(closest.distance)))
    near = tree.query(centers, k=1)[0] < SEEN_SPACINGS * (spacing + off)
    return ShapeDeviation(
        name=name,
        scan=scan.source,
        outliers=scan.outliers,
        registration=registration,
        points=placed,
        distances=closest.distance,
        normals=closest.normal,
        statistics=statistics_of(closest.distance, registration),
        seen=float(surface.areas[near].sum() / surface.areas.sum()),
        registration_uncertainty=added,
        markers=None if markers is None else _marked(body, markers, motion),
        symmetry=str(body.symmetry),
        notes=(*body.notes, *_notes(registration)),
    )


def statistics_of(every: Array, registration: Registration | None = None) -> Statistics:
    """Describe signed distances. Shapes: every (n,), mm."""
    aside = np.zeros(every.shape, dtype=bool)
    if registration is not None and registration.scale_mm > 0:
        aside = biweight(every / registration.scale_mm) == 0
        aside &= aside.mean() < 0.5
    distances = every[~aside]
    sizes = np.abs(distances)
    return Statistics(
        points=len(distances),
        mean=float(distances.mean()),
        mean_absolute=float(sizes.mean()),
        rms=float(np.sqrt((distances**2).mean())),
        sd=float(distances.std(ddof=1)),
        largest=float(sizes.max()),
        percentiles={
            f"p{q}": float(value)
            for q, value in zip(PERCENTILES, np.percentile(distances, PERCENTILES), strict=True)
        },
        absolute_p95=float(np.percentile(sizes, 95)),
        set_aside=int(aside.sum()),
        largest_set_aside=float(np.abs(every[aside]).max()) if aside.any() else None,
    )


def _check_handedness(surface: TriangleSurface, scan: Scan, distance: float) -> None:
    """Refuse a cloud whose mirror image fits far better."""
    if distance < RESOLUTION_SHARE * surface.size:
        return
    other, _ = coarse_registration(surface, scan.points * np.array([-1.0, 1.0, 1.0]))
    if other < CLEARLY_BETTER * distance:
        rule = (
            f"is mirrored: its mirror image lies {other:.3g} mm from the surface, it {distance:.3g}"
        )
        mend = "negate one coordinate: the scanner's frame is left-handed"
        raise InputError(Fault(f"--scan: {scan.source}", rule, mend))


def _reach(points: Array) -> float:
    """Largest distance of points, shape (n, 3), from their mean."""
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def _check_size(surface: TriangleSurface, scan: Scan, distance: float) -> None:
    """Refuse a cloud that is the body in another size, which fits far better when it is scaled."""
    # no box around the points: it depends on how they are turned
    ratio = _reach(scan.points) / _reach(surface.points[np.unique(surface.triangles)])
    if abs(math.log(ratio)) < SAME_SIZE or distance < RESOLUTION_SHARE * surface.size:
        return
    scaled, _ = coarse_registration(surface, scan.points / ratio)
    if scaled < CLEARLY_BETTER * distance / ratio and scaled < SAME_SHAPE * surface.size:
        rule = (
            f"is the body {times(ratio)} as large: scaled it lies {scaled:.3g} mm from the "
            f"surface, as it is {distance:.3g}"
        )
        raise InputError(Fault(f"--scan: {scan.source}", rule, "check --unit, and the specimen"))


def _check_state(body: SimulatedBody, scan: Scan, distance: float, start: RigidMotion) -> None:
    """Refuse a scan that the body at rest, or at another displacement, fits far better."""
    size = body.deformed.size
    moved = float(np.linalg.norm(body.body.displacement, axis=1).max())
    if min(moved, distance) < RESOLUTION_SHARE * size:
        return
    others = {s: coarse_registration(body.at(s), scan.points, [start])[0] for s in OTHER_STATES}
    share, least = min(others.items(), key=lambda pair: pair[1])
    if least < CLEARLY_BETTER * distance:
        state = "the body at rest" if share == 0 else f"{100 * share:g} % of the displacement"
        raise RefusedError(
            f"{scan.source}: is a scan of another state: {state} fits it to {least:.3g} mm, the "
            f"simulated one to {distance:.3g} mm. Give the scan of this displacement, or say "
            "--any-state if the simulation itself is in doubt"
        )


def _marked(body: SimulatedBody, markers: Markers, motion: RigidMotion) -> MarkerDeviation:
    """Errors of markers, as material points where their places at rest are known."""
    measured = motion(markers.deformed)
    if markers.rest is None:
        closest = body.deformed.closest(measured)
        return MarkerDeviation(markers.names, measured - closest.points, None, False, 0)
    rest = motion(markers.rest)
    errors = measured - rest - body.displacement_at(rest)
    outside = int((~np.isfinite(errors).all(axis=1)).sum())
    if outside == len(errors):
        mend = "markers must be in the frame and unit of the scan (--unit)"
        raise InputError(Fault("--markers", "all lie outside the simulated body", mend))
    moved = np.linalg.norm(measured - rest, axis=1)
    return MarkerDeviation(markers.names, errors, moved, True, outside)


def _notes(registration: Registration | None) -> tuple[str, ...]:
    if registration is None:
        return ("the scan was compared as it lies, without registration",)
    notes = ["a registered deviation holds no rigid motion: what the fit takes up is not seen"]
    if registration.sliding:
        listed = "; ".join(str(motion) for motion in registration.sliding)
        notes.append(f"the shape does not fix: {listed}; the scan was not moved along it")
    if not registration.converged:
        notes.append("the registration did not settle: see its residual")
    return tuple(notes)


# A scan: a cloud of points, or a scanned surface of which the vertices count.


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

    @property
    def size(self) -> float:
        """Diagonal of the box around the points, mm."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


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
    if path.suffix.lower() in (".csv", ".gz"):
        table = read_csv(path, required=("x", "y", "z"), source=path.name)
        points = np.column_stack([table.numbers(axis) for axis in "xyz"])
    else:
        points = read_mesh(path, where)[0]
    points = unit_factor(unit, "length") * points
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
    scan = Scan(points[~alone], int(alone.sum()), path.name)
    if not SIZES[0] < scan.size / body_size < SIZES[1]:
        written = scan.size / unit_factor(unit, "length")
        likely = min(UNITS, key=lambda name: abs(np.log(written * UNITS[name] / body_size)))
        rule = f"is {scan.size:.4g} mm large, the simulated body {body_size:.4g} mm"
        raise InputError(Fault(where, rule, f'is it in {likely}? Then say --unit "{likely}"'))
    return scan


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
