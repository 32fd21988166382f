"""What is handed to every code and what comes back; NumPy alone, for any interpreter."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np


class NotInstalledError(Exception):
    """The code is not on this machine."""


class NoAnswerError(Exception):
    """The code ran and reached no equilibrium, or cannot do the problem."""


@dataclass(frozen=True)
class Task:
    """Bonded compression of the half of a specimen above its middle plane.

    Parameters
    ----------
    points : ndarray, shape (n_points, dim)
        Corners in mm; (r, z) in axisymmetric space, else the quarter with x, y >= 0.
    cells : ndarray, shape (n_cells, dim + 1)
        Triangles or tetrahedra.
    displacement_mm : float
        Of the plate; the modelled half takes half of it.
    steps : int
        Equal load steps.
    c10, bulk : float
        Neo-Hookean constant and bulk modulus, MPa.
    tolerance : float
        Of Newton: norm of the force residual over that of the reaction.
    """

    points: np.ndarray
    cells: np.ndarray
    displacement_mm: float
    steps: int
    c10: float
    bulk: float
    tolerance: float

    @property
    def axisymmetric(self) -> bool:
        """Whether the points are (r, z)."""
        return bool(self.points.shape[1] == 2)

    @property
    def scale(self) -> float:
        """Specimen's force over that of the meshed sector."""
        return 1.0 if self.axisymmetric else 4.0

    @property
    def middle_mm(self) -> float:
        """Height of the middle plane."""
        return float(self.points[:, -1].min())

    @property
    def top_mm(self) -> float:
        """Height of the plate."""
        return float(self.points[:, -1].max())

    @property
    def volume_mm3(self) -> float:
        """Volume of the meshed sector; around the whole axis in axisymmetric space."""
        corners = self.points[self.cells]
        det = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
        if self.axisymmetric:
            return float((np.pi * det * corners[:, :, 0].mean(axis=1)).sum())
        return float(det.sum() / 6)

    def unsolved(
        self, force: SupportsFloat, reaction: SupportsFloat, volume: SupportsFloat
    ) -> float:
        """Force residual over reaction, or volume residual over volume: the larger one.

        All codes stop by this figure (norms over unknowns); it is that of `study`.
        """
        relative = float(force) / float(reaction) if reaction else 1.0
        return max(relative, float(volume) / self.volume_mm3)

    def plate_mm(self, step: int) -> float:
        """Displacement of the plate (negative) at the end of a step counted from 1."""
        return -self.displacement_mm / 2 * step / self.steps

    def write(self, path: Path) -> None:
        """Write to an ``.npz`` file."""
        np.savez(path, **asdict(self))

    @classmethod
    def read(cls, path: Path) -> Task:
        """Read what :meth:`write` wrote."""
        with np.load(path) as data:
            values: dict[str, Any] = {k: v if v.ndim else v.item() for k, v in data.items()}
        return cls(**values)


@dataclass
class Answer:
    """What a code says: force of the whole specimen and how it got there."""

    force_N: float
    iterations: int
    unknowns: int
    solver: str
    parts_s: dict[str, float] = field(default_factory=dict)
    #: of processes that the code started itself
    peak_MB: float = 0.0
    #: time of the code itself where the call does more than that
    seconds: float | None = None
    cpu_s: float | None = None


Solve = Callable[[Task], Answer]


def midpoints(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic mesh: the corners, then the mid-points of the edges.

    Edges of a tetrahedron follow in the order 01, 12, 02, 03, 13, 23 (the first three alone
    for a triangle), as Abaqus, VTK and others have them.
    """
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)][: 3 if cells.shape[1] == 3 else 6]
    ends = np.sort(np.concatenate([cells[:, pair] for pair in pairs]), axis=1).astype(np.int64)
    key, where = np.unique(ends[:, 0] * len(points) + ends[:, 1], return_inverse=True)
    first, second = key // len(points), key % len(points)
    middle = (points[first] + points[second]) / 2
    number = len(points) + where.reshape(len(pairs), -1).T
    return np.vstack([points, middle]), np.hstack([cells, number])


def write_json(path: Path, what: Any) -> None:
    """Write where a reader sees all or nothing."""
    draft = path.with_suffix(".draft")
    draft.write_text(json.dumps(what), encoding="utf-8")
    draft.replace(path)
