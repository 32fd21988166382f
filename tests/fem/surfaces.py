"""Closed surfaces for tests, and the files they are written to."""

import numpy as np


def box(width, depth, height):
    """Twelve triangles of a box that stands on z = 0 about the z axis."""
    w, d = width / 2, depth / 2
    points = np.array([[x, y, z] for z in (0.0, height) for y in (-d, d) for x in (-w, w)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return points, np.array(triangles)


def cylinder(radius, height, segments):
    """Prism with a regular polygon as its base; the radius is that of its corners."""
    n, t = segments, np.arange(segments) * 2 * np.pi / segments
    ring = radius * np.column_stack([np.cos(t), np.sin(t)])
    ends = [np.column_stack([ring, np.full(n, z)]) for z in (0.0, height)]
    points = np.vstack([*ends, [[0, 0, 0.0]], [[0, 0, height]]])
    triangles = []
    for i in range(n):
        j = (i + 1) % n
        triangles += [(i, j, n + j), (i, n + j, n + i), (2 * n, j, i), (2 * n + 1, n + i, n + j)]
    return points, np.array(triangles)


def sphere(radius, divisions):
    """Octahedron divided so often, its points pushed out onto a sphere about the origin."""
    points = [np.array(v, float) for v in np.vstack([np.eye(3), -np.eye(3)])]
    cells = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    for _ in range(divisions):
        middles = {}
        finer = []
        for a, b, c in cells:
            x, y, z = (_middle(points, middles, *pair) for pair in ((a, b), (b, c), (c, a)))
            finer += [(a, x, z), (x, b, y), (z, y, c), (x, y, z)]
        cells = finer
    return radius * np.array(points), np.array(cells)


def _middle(points, middles, a, b):
    key = (min(a, b), max(a, b))
    if key not in middles:
        between = points[a] + points[b]
        points.append(between / np.linalg.norm(between))
        middles[key] = len(points) - 1
    return middles[key]


def joined(*shapes):
    """Several surfaces in one file."""
    shift, points, triangles = 0, [], []
    for own, cells in shapes:
        points.append(own)
        triangles.append(cells + shift)
        shift += len(own)
    return np.vstack(points), np.vstack(triangles)


def write(path, shape, *, text=False):
    """Write STL (binary unless ``text``), OBJ or PLY; the name, as a specimen takes it."""
    points, triangles = shape
    writer = {".stl": _ascii_stl if text else _binary_stl, ".obj": _obj, ".ply": _ply}[path.suffix]
    path.write_bytes(writer(points, triangles))
    return str(path)


def _binary_stl(points, triangles):
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows = np.zeros(len(triangles), dtype=facet)
    rows["corners"] = points[triangles]
    return b"solid, but binary".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()


def _ascii_stl(points, triangles):
    lines = ["solid specimen"]
    for corners in points[triangles]:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(repr(float(v)) for v in corner) for corner in corners]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid specimen", ""]).encode()


def _obj(points, triangles):
    lines = ["v " + " ".join(repr(float(v)) for v in point) for point in points]
    lines += ["f " + " ".join(str(int(v) + 1) for v in cell) for cell in triangles]
    return ("\n".join(lines) + "\n").encode()


def _ply(points, triangles):
    head = [
        *("ply", "format ascii 1.0", f"element vertex {len(points)}"),
        *(f"property double {axis}" for axis in "xyz"),
        *(f"element face {len(triangles)}", "property list uchar int vertex_indices"),
        "end_header",
    ]
    lines = [" ".join(repr(float(v)) for v in point) for point in points]
    lines += ["3 " + " ".join(str(int(v)) for v in cell) for cell in triangles]
    return "\n".join([*head, *lines, ""]).encode()
