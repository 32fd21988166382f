"""The verdict on a difference: its interval, widened by the numerics, against what matters.

A numerical error is a bias, so its bound widens the interval on both sides and is never added
in quadrature. A verdict is a claim (*matters*, *no practical difference*) or a refusal: the data
*cannot tell*, or they could and the mesh does not allow it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError

MATTERS = "matters"
NO_DIFFERENCE = "no practical difference"
NOT_RESOLVED = "not resolved by the mesh"
CANNOT_TELL = "cannot tell"
CLAIMS = (MATTERS, NO_DIFFERENCE)
REFUSALS = (NOT_RESOLVED, CANNOT_TELL)
#: Why the values of one specimen claim nothing, however far they are from the threshold.
ONE_SPECIMEN = "one specimen: another may differ"
#: Why a difference has no U although meshes were refined.
UNBOUNDED = "with finer meshes a cell moves ever farther, so nothing bounds its error"
#: of an interaction, whose pure components nobody chooses between
SEE_SIMPLE = "see simple effects"


@dataclass(frozen=True)
class Judgement:
    """Verdict on one difference, or on several.

    Parameters
    ----------
    verdict : {"matters", "no practical difference", "not resolved by the mesh", "cannot tell"}
        Two claims and two refusals.
    why : str
        What decided.
    u_needed : float or None
        Numerical uncertainty at which the mesh would allow the claim that the interval makes.
    """

    verdict: str
    why: str
    u_needed: float | None = None


def claim(low: float, high: float, practical: float) -> str:
    """Claim that an interval allows; empty where it allows none.

    Parameters
    ----------
    low, high : float
        Ends of the interval of a difference.
    practical : float
        Smallest difference that matters.

    Examples
    --------
    >>> claim(1.2, 1.6, 1.0), claim(-0.3, 0.4, 1.0), claim(0.5, 1.5, 1.0)
    ('matters', 'no practical difference', '')
    """
    if low > practical or high < -practical:
        return MATTERS
    return NO_DIFFERENCE if -practical < low and high < practical else ""


def judge(low: float, high: float, practical: float, u: float = 0.0) -> Judgement:
    """Judge one difference.

    Parameters
    ----------
    low, high : float
        Ends of its interval; equal for a difference that is known without scatter.
    practical : float
        Smallest difference that matters, positive.
    u : float
        Bound of its numerical error, finite and not negative.

    Returns
    -------
    Judgement

    Raises
    ------
    InputError
        If ``u`` is negative, infinite or no number.

    Examples
    --------
    >>> judge(0.2, 0.4, 1.0, u=100.0).verdict
    'not resolved by the mesh'
    >>> judge(1.15, 1.25, 1.0, u=0.5).u_needed
    0.15
    """
    if not (math.isfinite(u) and u >= 0):
        mend = "leave it out where it is not known; 0 means that there is none"
        raise InputError(Fault("u_num", f"must be zero or a positive number, got {u!r}", mend))
    found = claim(low - u, high + u, practical)
    if found == MATTERS:
        return Judgement(MATTERS, "the interval lies beyond the practical band")
    if found == NO_DIFFERENCE:
        return Judgement(NO_DIFFERENCE, "the interval lies inside the practical band")
    without = claim(low, high, practical)
    if not without:
        return Judgement(CANNOT_TELL, "the interval crosses the practical threshold")
    needed = max(low, -high) - practical if without == MATTERS else practical - max(-low, high)
    return Judgement(NOT_RESOLVED, resolution(needed), float(f"{needed:.6g}"))


def judge_all(low: Array, high: Array, practical: float, u: Array) -> Judgement:
    """Judge several differences together.

    Parameters
    ----------
    low, high : ndarray, shape (m,)
        Ends of their simultaneous intervals.
    practical : float
        Smallest difference that matters.
    u : ndarray, shape (m,)
        Bounds of their numerical errors.

    Returns
    -------
    Judgement
        *matters* where one of them does, *no practical difference* where none can.
    """
    beyond = np.maximum(low, -high)
    if (beyond - u > practical).any():
        return Judgement(MATTERS, "the interval lies beyond the practical band")
    inside = practical - np.maximum(-low, high)
    if (inside > u).all():
        return Judgement(NO_DIFFERENCE, "every interval lies inside the practical band")
    if beyond.max() > practical:
        needed = float(f"{beyond.max() - practical:.6g}")
        return Judgement(NOT_RESOLVED, resolution(needed), needed)
    if inside.min() > 0:
        needed = float(f"{inside.min():.6g}")
        return Judgement(NOT_RESOLVED, resolution(needed), needed)
    return Judgement(CANNOT_TELL, "the interval crosses the practical threshold")


def resolution(needed: float) -> str:
    """Say which numerical uncertainty a claim needs.

    Parameters
    ----------
    needed : float
        Uncertainty below which the claim is allowed; two digits of it are told.

    Examples
    --------
    >>> resolution(0.0512)
    'the numerical uncertainty would have to be below 0.051'
    """
    return f"the numerical uncertainty would have to be below {needed:.2g}"


def size_needed(mesh_size: float, u: float, u_needed: float, order: float) -> float:
    """Mesh size that a claim needs.

    Parameters
    ----------
    mesh_size : float
        Finest size that was solved, mm.
    u, u_needed : float
        Bound on that mesh, and the one needed.
    order : float
        Order by which the bound falls.

    Returns
    -------
    float
        In mm; 0 where no mesh is fine enough.

    Examples
    --------
    >>> size_needed(1.0, 0.4, 0.1, 2.0)
    0.5
    """
    if u_needed <= 0 or not math.isfinite(u):
        return 0.0
    return mesh_size * (u_needed / u) ** (1 / order) if u > u_needed else mesh_size
