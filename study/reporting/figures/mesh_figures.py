"""Pictures of a deformed mesh: before and after, colored by how far each point moved.

Takes plain arrays, so that whoever holds a solution can draw it: an axisymmetric section is
mirrored at its axis (left before, right after), a solid is seen from a fixed direction, and a
whole one also from three sides.
"""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.figure import SubFigure

from study.ground.arrays import Array, Ints
from study.reporting.content.text import count, quantity, sentence
from study.reporting.figures.axes import INK, MUTED, WIDTH_IN, canvas, one_panel, render

#: more polygons than these make a drawing that no browser likes
MOST_FACES = 20_000
_COLORS = "cividis"  # reads the same with any color vision
_FACES = {
    4: ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    # vertices of a hexahedron in the order of scikit-fem
    8: ((0, 1, 4, 2), (0, 2, 6, 3), (0, 3, 5, 1), (2, 4, 7, 6), (1, 5, 7, 4), (3, 6, 7, 5)),
}
_VIEW = np.radians((-55.0, 22.0))
#: a whole body from three sides: axes to the right, up and towards the viewer with their signs
_SIDES = (("xzy", (1, 1, -1)), ("yzx", (1, 1, 1)), ("xyz", (1, 1, 1)))
_LIGHT = np.array([-0.35, 0.72, 0.6])


def boundary_faces(cells: Ints) -> Ints:
    """Faces that belong to one cell alone.

    Shapes: cells (n_cells, 4 or 8); returns (n_faces, 3 or 4).
    """
    faces = np.concatenate([cells[:, list(face)] for face in _FACES[cells.shape[1]]])
    _, first, times = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(faces[np.sort(first[times == 1])])


def _turned(points: Array) -> Array:
    """Turn points to the viewer: columns are right, up and depth (towards the viewer)."""
    across, up = _VIEW
    x, y, z = points.T
    right = x * np.cos(across) + y * np.sin(across)
    back = -x * np.sin(across) + y * np.cos(across)
    return np.column_stack(
        (right, z * np.cos(up) + back * np.sin(up), z * np.sin(up) - back * np.cos(up))
    )


def picture(
    points: Array, cells: Ints, displacement: Array, *, name: str = "mesh", title: str = ""
) -> tuple[str, str]:
    """Draw a mesh before and after its deformation.

    Shapes: points, displacement (n_points, 2 or 3), mm; cells (n_cells, k).
    """
    faces = cells if points.shape[1] == 2 else boundary_faces(cells)
    if len(faces) > MOST_FACES:
        raise ValueError(f"{len(faces):,} faces are too many to draw (at most {MOST_FACES:,})")
    draw = _section if points.shape[1] == 2 else _solid
    svg = render(lambda: draw(points, faces, displacement), name, title or "deformed mesh")
    moved = np.linalg.norm(displacement, axis=1)
    left = "left half before, right half after"
    sides = left if points.shape[1] == 2 else "before on the left, after on the right"
    if points.shape[1] == 3 and _is_whole(points):
        sides += ", below it from three sides"
    return svg, sentence(
        f"{count(len(cells), 'cell')}, {sides}; the largest displacement is "
        f"{quantity(float(moved.max()), 'mm')}"
    )


def _section(points: Array, faces: Ints, displacement: Array) -> Canvas:
    after = points + displacement
    mirror = np.array([-1.0, 1.0])
    both = np.concatenate((points * mirror, after))
    size = np.ptp(both, axis=0)
    figure, ax = one_panel(float(np.clip(WIDTH_IN * size[1] / size[0], 2.2, 6.5)) + 0.6)
    color = _mean(np.linalg.norm(displacement, axis=1), faces)
    _polygons(ax, (points * mirror)[faces], None)
    made = _polygons(ax, after[faces], color)
    ax.axvline(0, color=MUTED, linewidth=0.7, linestyle=(0, (6, 2, 1, 2)))
    _frame(ax, both)
    ax.set_xlabel("radius (mm)")
    ax.set_ylabel("height (mm)")
    _bar(figure, ax, made)
    return figure


def _is_whole(points: Array) -> bool:
    """Whether a solid lies on both sides of its axis: a modelled quarter lies on one."""
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    return bool((low < -0.1 * (high - low)).all())


def _solid(points: Array, faces: Ints, displacement: Array) -> Canvas:
    turned = [_turned(points), _turned(points + displacement)]
    size = np.ptp(np.concatenate(turned), axis=0)
    whole = _is_whole(points)
    high = float(np.clip(0.47 * WIDTH_IN * size[1] / size[0], 2.2, 6.0)) + 0.3
    x, y, z = np.ptp(points + displacement, axis=0)
    # beside the drawings of three sides there is room for their axes
    low = float((WIDTH_IN - 2.4) * max(z, y) / (2 * x + y) + 0.8) if whole else 0.0
    figure = canvas(high + low)
    upper: Canvas | SubFigure = figure
    lower: SubFigure | None = None
    if whole:
        grid = figure.add_gridspec(2, 1, height_ratios=(high, low))
        upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    axes = upper.subplots(1, 2, sharex=True, sharey=True)
    color = _mean(np.linalg.norm(displacement, axis=1), faces)
    for ax, seen, values in zip(axes, turned, (None, color), strict=True):
        made = _seen(ax, seen, faces, values)
        _frame(ax, np.concatenate(turned)[:, :2])
        ax.set_axis_off()
    _bar(upper, axes[1], made)
    if lower is not None:
        _from_sides(lower, points + displacement, faces, color)
    return figure


def _seen(ax: Axes, seen: Array, faces: Ints, values: Array | None) -> ScalarMappable:
    """Draw a solid whose columns are right, up and depth."""
    far_first = np.argsort(seen[faces][:, :, 2].mean(axis=1), kind="stable")
    ordered = faces[far_first]
    part = None if values is None else values[far_first]
    corners = seen[ordered]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # the side that is seen faces the viewer
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    return _polygons(
        ax, seen[ordered][:, :, :2], part, np.asarray(0.62 + 0.38 * np.clip(normal @ _LIGHT, 0, 1))
    )


def _from_sides(figure: SubFigure, after: Array, faces: Ints, color: Array) -> None:
    """Draw the deformed body along y, along x and from above, in one scale."""
    wide = [float(np.ptp(after[:, "xyz".index(axes[0])])) for axes, _ in _SIDES]
    panels = figure.subplots(1, 3, width_ratios=wide)
    for ax, (axes, signs) in zip(panels, _SIDES, strict=True):
        seen = after[:, ["xyz".index(axis) for axis in axes]] * np.array(signs, dtype=float)
        _seen(ax, seen, faces, color)
        _frame(ax, seen[:, :2])
        ax.set_xlabel(f"{axes[0]} (mm)")
        ax.set_ylabel(f"{axes[1]} (mm)")


def _mean(values: Array, faces: Ints) -> Array:
    return np.asarray(values[faces].mean(axis=1))


def _polygons(
    ax: Axes, corners: Array, values: Array | None, shade: Array | None = None
) -> ScalarMappable:
    """Draw faces; without values they are plain."""
    norm = Normalize(0.0, 1.0 if values is None else float(values.max()) or 1.0)
    scale = mpl.colormaps[_COLORS]
    color = np.tile((0.93, 0.94, 0.95, 1.0), (len(corners), 1))
    if values is not None:
        color = np.asarray(scale(norm(values)))
    if shade is not None:
        color[:, :3] *= shade[:, None]
    thin = 0.35 if len(corners) < 3000 else 0.15
    made = PolyCollection(
        list(corners), facecolors=color, edgecolors=INK if values is None else "white"
    )
    made.set_linewidth(thin)
    ax.add_collection(made)
    # few levels, or the bar would become an image, which a report may not hold
    return mpl.cm.ScalarMappable(norm, scale.resampled(32))


def _frame(ax: Axes, points: Array) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    pad = 0.02 * float((high - low).max())
    ax.set_xlim(low[0] - pad, high[0] + pad)
    ax.set_ylim(low[1] - pad, high[1] + pad)
    ax.set_aspect("equal")


def _bar(figure: Canvas | SubFigure, ax: Axes, made: ScalarMappable) -> None:
    bar = figure.colorbar(made, ax=ax, shrink=0.7, aspect=18, pad=0.02)
    bar.set_label("displacement (mm)")
    bar.outline.set_visible(False)
