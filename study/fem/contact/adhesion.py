"""Sticking to a rigid indenter: a point that has touched it goes with it from then on.

A bonded cone or sphere takes hold of more of the surface as it goes deeper, without slip and
without release (adhesive contact: Spence 1968, Proc. R. Soc. A 305, 55). New contact is
frictionless within its load step; when the step is done, its points are tied to the place of
the indenter that they touch. Ties are kept as contact is, by springs whose multipliers take up
the force. What slips before it is tied makes an error of first order in the load step, which is
why these steps are small: less than 0.1 % of the force of a cone is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.fem.contact.contact import ContactPoints, ContactState, Glue, Meeting


@dataclass(frozen=True)
class Tie:
    """Coordinate along one axis in a frame that moves with the indenter, as a surface to touch.

    Parameters
    ----------
    axis : int
    speed : float
        Axial motion of the indenter against the axis, per unit of displacement.
    """

    axis: int
    speed: float = 1.0

    def gap(self, x: Array, displacement_mm: float) -> tuple[Array, Array, Array]:
        """Coordinate, its direction and (zero) Hessian."""
        n, dim = x.shape
        normal = np.zeros((n, dim))
        normal[:, self.axis] = 1.0
        return in_its_frame(x, displacement_mm)[:, self.axis], normal, np.zeros((n, dim, dim))

    def reference_gap(self, x: Array, u: Array, displacement_mm: float) -> tuple[Array, Array]:
        """As :meth:`gap`: an axis looks the same from both states."""
        return self.gap(x + u, displacement_mm)[:2]


@dataclass(frozen=True)
class TiedPoints(ContactPoints):
    """Contact points along one axis of the indenter's frame, where they are held."""

    surface: Tie

    def evaluate(
        self,
        met: Meeting,
        multiplier: Array,
        closed: NDArray[np.bool_] | None = None,
        glue: Glue | None = None,
    ) -> ContactState:
        """Distance from the place where each point is held, and the force that holds it."""
        if glue is None:
            raise ValueError("ties need to know which points are held")
        free = super().evaluate(met, multiplier, glue.held)
        gap = np.where(glue.held, free.gap - glue.anchor[:, self.surface.axis], 0.0)
        pressure = np.where(glue.held, multiplier - self.eps * gap, 0.0)
        calm = np.zeros_like(gap)
        everywhere = np.ones(gap.shape, dtype=bool)
        return replace(
            free, gap=gap, pressure=pressure, wanted=glue.held, urge=calm, led=everywhere
        )

    def admissible(self, multiplier: Array) -> Array:
        """Whatever there is: ties pull as well as they push."""
        return multiplier


def in_its_frame(x: Array, displacement_mm: float) -> Array:
    """Positions as seen from the indenter, which moves against the last axis.

    Parameters
    ----------
    x : ndarray, shape (n, dim)
        Positions in mm; a copy is returned.
    displacement_mm : float
        How far the indenter has come down.
    """
    seen = x.copy()
    seen[:, -1] += displacement_mm
    return seen


#: area over the square of the contact radius that every tie is at least as stiff as
_TIED_AREA = 0.01


def gripping(
    points: ContactPoints, dim: int, *, is_bonded: bool, reach_mm: float
) -> tuple[ContactPoints, ...]:
    """Points that meet an indenter, with a set of ties for every axis where it is bonded.

    The Gauss points of quadratic edges all miss one mode of the surface, in which corners and
    mid-sides move against each other. Only symmetry forbids it, through the points next to the
    axis, which stand for next to no area: they get the stiffness of more of it. With their own,
    two fifths of a gap were left by every iteration.

    Parameters
    ----------
    points : ContactPoints
        Points of the surface that the indenter may meet.
    dim : {2, 3}
        Number of axes.
    is_bonded : bool
        Whether ties are made; ``points`` come back alone otherwise.
    reach_mm : float
        Radius of the contact.
    """
    if not is_bonded:
        return (points,)
    least = _TIED_AREA * reach_mm**2
    eps = points.eps * np.maximum(1.0, least / points.weights)
    ties = (
        TiedPoints(
            surface=Tie(axis), nodes=points.nodes, shape=points.shape, weights=points.weights,
            eps=eps, c=points.c, small_strain=points.small_strain,
        )
        for axis in range(dim)
    )  # fmt: skip
    return (points, *ties)


def nothing_held(points: ContactPoints, dim: int) -> Glue:
    """Return the glue of an indenter that has not touched yet.

    Parameters
    ----------
    points : ContactPoints
        Points of the surface that the indenter may meet.
    dim : {2, 3}
        Number of axes.
    """
    return Glue(np.zeros(points.size, dtype=bool), np.zeros((points.size, dim)))


def hold(
    glue: Glue,
    contact: tuple[ContactPoints, ...],
    touching: list[ContactState],
    nodes: Array,
    u: Array,
    displacement_mm: float,
    rates: Mapping[str, Array],
) -> tuple[Glue, tuple[Array, ...]]:
    """Take hold of every point that is closed, in the same equilibrium.

    Parameters
    ----------
    glue : Glue
        What has been held so far.
    contact : tuple of ContactPoints
        The contact, then its ties axis by axis.
    touching : list of ContactState
        Of each of them.
    nodes, u : ndarray, shape (n_nodes, dim)
        Nodes and their displacements, mm.
    displacement_mm : float
        How far the indenter has come down.
    rates : mapping of str to ndarray, shape (n_nodes, dim)
        Derivative of ``u`` by every constant.

    Returns
    -------
    glue : Glue
    multipliers : tuple of ndarray
        Of the contact and its ties.
    """
    points, pressure = contact[0], touching[0].pressure
    new = touching[0].active
    place = in_its_frame(points.interpolated(nodes + u), displacement_mm)
    anchor = np.where(new[:, None], place, glue.anchor)
    moved = {
        name: np.where(new[:, None], points.interpolated(rate), glue.rate(name))
        for name, rate in rates.items()
    }
    normal = touching[0].normal()
    pushed = [
        np.where(new, pressure * normal[:, axis], touch.pressure)
        for axis, touch in enumerate(touching[1:])
    ]
    return Glue(glue.held | new, anchor, moved), (np.where(new, 0.0, pressure), *pushed)
