"""Values of the unknowns, and what is assembled and looked at there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from study.arrays import Array, Flags
from study.fem.contact.contact import ContactState, Glue, Meeting


@dataclass(frozen=True)
class State:
    """Unknowns at one displacement.

    Parameters
    ----------
    displacement_mm : float
        Displacement of the test.
    x : ndarray, shape (n,)
        Displacements node by node, then pressures.
    multipliers : tuple of ndarray
        Contact pressures, one array for each set of contact points.
    closed : tuple of ndarray of bool
        Imposed active sets; empty where every contact point decides for itself.
    glue : Glue, optional
        What a bonded indenter has taken hold of.
    """

    displacement_mm: float
    x: Array
    multipliers: tuple[Array, ...] = ()
    closed: tuple[Flags, ...] = ()
    glue: Glue | None = None


@dataclass(frozen=True)
class Drag:
    """Resistance to leaving a place: ``weights`` (n,) times the motion from ``place`` (n,)."""

    weights: Array
    place: Array


@dataclass
class Assembly:
    """Residual, tangent entries and contact at one state (arrays are the system's own)."""

    min_j: float
    internal: Array
    residual: Array
    contact: list[ContactState]


@dataclass
class Latest:
    """What was found at the last state, so that it is found once.

    Parameters
    ----------
    meetings : tuple, optional
        Unknowns and displacement, and where each set of contact points is there.
    ratios : tuple of ndarray, optional
        Unknowns and J there.
    touching : ndarray of bool
        Closed contact points of the last assembly, one set after the other.
    """

    meetings: tuple[Array, float, list[Meeting]] | None = None
    ratios: tuple[Array, Array] | None = None
    touching: Flags = field(default_factory=lambda: np.zeros(0, bool))
