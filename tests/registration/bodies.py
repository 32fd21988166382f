"""Bodies and scans of them whose truth is known: they are made here."""

import numpy as np
from scipy.spatial import ConvexHull

from study.laboratory.registration.iterative_closest_point import TriangleSurface
from tests.fem import surfaces


def directions(n):
    """Unit vectors spread evenly (a Fibonacci spiral), shape (n, 3)."""
    k = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k
    return np.column_stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)]
    )


def egg(n=500):
    """Closed surface of about 80 x 60 x 44 mm without any symmetry, nor that of a mirror."""
    d = directions(n)
    triangles = outward(d, ConvexHull(d).simplices)
    x, y, z = (d[:, [k]] for k in range(3))
    bulge = 1 + 0.15 * x + 0.12 * y * z + 0.08 * z + 0.5 * x * y * z
    return TriangleSurface(d * np.array([40.0, 30.0, 22.0]) * bulge, triangles)


def ball(radius, n=2000):
    """Sphere about the origin, its vertices on it."""
    d = directions(n)
    return TriangleSurface(radius * d, outward(d, ConvexHull(d).simplices))


def outward(points, triangles):
    """Triangles of a body that holds the origin and is seen from there, turned outward."""
    faces = TriangleSurface(points, triangles)
    inward = (faces.crossed * faces.corners.mean(axis=1)).sum(axis=1) < 0
    turned = triangles.astype(np.int64)
    turned[inward] = turned[inward, ::-1]
    return turned


def box(width, depth, height):
    """Box with a corner at the origin: twelve triangles."""
    points, triangles = surfaces.box(width, depth, height)
    return TriangleSurface(points + [width / 2, depth / 2, 0], triangles)


def scan(surface, n, rng, noise=0.0):
    """Points spread evenly over a surface, with normal noise in every direction, mm."""
    chosen = rng.choice(len(surface.triangles), n, p=surface.areas / surface.areas.sum())
    places = np.einsum("nk,nkj->nj", rng.dirichlet([1, 1, 1], n), surface.corners[chosen])
    return np.asarray(places + noise * rng.standard_normal((n, 3)))


def cap(center, radius, share, n, noise, rng):
    """Scan of a cap that covers a share of a sphere, noise along the normal, mm."""
    z = 1 - 2 * share * rng.random(n)
    turn, s = 2 * np.pi * rng.random(n), np.sqrt(1 - z**2)
    d = np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
    return np.asarray(center + d * (radius + noise * rng.standard_normal(n))[:, None])
