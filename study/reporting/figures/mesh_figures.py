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
#: elevation and azimuth of a view in degrees
_VIEW = (22.0, -55.0)
_SIDES = {"along y": (0.0, -90.0), "along x": (0.0, 0.0), "from above": (90.0, -90.0)}


def boundary_faces(cells: Ints) -> Ints:
    """Faces that belong to one cell alone.

    Shapes: cells (n_cells, 4 or 8); returns (n_faces, 3 or 4).
    """
    faces = np.concatenate([cells[:, list(face)] for face in _FACES[cells.shape[1]]])
    _, first, times = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(faces[np.sort(first[times == 1])])


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
    before = points * np.array([-1.0, 1.0])
    both = np.concatenate((before, after))
    size = np.ptp(both, axis=0)
    figure, ax = one_panel(float(np.clip(WIDTH_IN * size[1] / size[0], 2.2, 6.5)) + 0.6)
    colors, scale = _colors(displacement, faces)
    thin = 0.35 if len(faces) < 3000 else 0.15
    for shape, color, edge in ((before, _PLAIN, INK), (after, colors, "white")):
        drawn = PolyCollection(list(shape[faces]), facecolors=color, edgecolors=edge)
        drawn.set_linewidth(thin)
        ax.add_collection(drawn)
    ax.axvline(0, color=MUTED, linewidth=0.7, linestyle=(0, (6, 2, 1, 2)))
    ax.autoscale_view()
    ax.set(xlabel="radius (mm)", ylabel="height (mm)", aspect="equal")
    _bar(figure, [ax], scale)
    return figure


def _is_whole(points: Array) -> bool:
    """Whether a solid lies on both sides of its axis: a modelled quarter lies on one."""
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    return bool((low < -0.1 * (high - low)).all())


def _solid(points: Array, faces: Ints, displacement: Array) -> Canvas:
    from mpl_toolkits.mplot3d import Axes3D
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    after, is_whole = points + displacement, _is_whole(points)
    colors, scale = _colors(displacement, faces)
    plain = np.tile(mpl.colors.to_rgba(_PLAIN), (len(faces), 1))
    views = [("before", points, plain, _VIEW), ("after", after, colors, _VIEW)]
    views += [(words, after, colors, view) for words, view in _SIDES.items() if is_whole]
    figure = canvas(7.6 if is_whole else 4.2)
    both = np.concatenate((points, after))
    grid = figure.add_gridspec(2 if is_whole else 1, 6)
    places = (grid[0, :3], grid[0, 3:], *(grid[-1, k : k + 2] for k in (0, 2, 4)))
    panels: list[Axes] = []
    for position, (words, shape, color, view) in zip(places, views, strict=False):
        ax: Axes3D = figure.add_subplot(position, projection="3d", proj_type="ortho")
        thin = 0.35 if len(faces) < 3000 else 0.15
        drawn = Poly3DCollection(
            shape[faces],
            facecolors=color,
            edgecolors=INK,
            linewidths=thin,
            shade=color is plain,
        )
        ax.add_collection3d(drawn)
        ax.auto_scale_xyz(*both.T)
        ax.set_box_aspect(np.ptp(both, axis=0), zoom=1.1)
        ax.view_init(*view)
        ax.set_title(words)
        ax.set_axis_off()
        panels.append(ax)
    _bar(figure, panels, scale)
    return figure


_PLAIN = "#edf0f2"


def _colors(displacement: Array, faces: Ints) -> tuple[Array, ScalarMappable]:
    """Color of every face by how far its corners moved on average, and the scale of colors."""
    values = np.linalg.norm(displacement, axis=1)[faces].mean(axis=1)
    scale = mpl.colormaps[_COLORS]
    norm = Normalize(0.0, float(values.max()) or 1.0)
    # few levels, or the bar would become an image, which a report may not hold
    return np.asarray(scale(norm(values))), ScalarMappable(norm, scale.resampled(32))


def _bar(figure: Canvas, panels: list[Axes], scale: ScalarMappable) -> None:
    bar = figure.colorbar(scale, ax=panels, shrink=0.7, aspect=18, pad=0.02)
    bar.set_label("displacement (mm)")
    bar.outline.set_visible(False)
