"""Relaxation of stress: shares of the isochoric stress that fade, each with a time of its own.

The constants of an energy are those of a load that comes at once. What is left of its stress
after a time t is the relaxation function g(t) = 1 - sum share_i (1 - exp(-t / time_i)), a Prony
series of generalized Maxwell elements (Simo 1987, Comput. Methods Appl. Mech. Eng. 60, 153;
Simo and Hughes 1998, Computational Inelasticity, ch. 10). The shares are those of the
instantaneous modulus, as Abaqus' ``*Viscoelastic, time=PRONY`` takes them. A change of volume is
resisted at once and for ever by the same K.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence, Sized
from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault

_NAME = re.compile(r"(share|time)([1-9])")
#: terms that a series may have: names of its constants have one digit
MOST_TERMS = 9


@dataclass(frozen=True)
class RelaxationTerm:
    """One fading share of the stress."""

    #: Of the instantaneous isochoric stress, plain.
    share: float
    #: After which it has faded to 1/e, s.
    time_s: float


def relaxation_names(terms: Sized) -> tuple[str, ...]:
    """Names of the shares and times of all terms, counted from 1: share1, time1, share2, ..."""
    return tuple(f"{kind}{k}" for k in range(1, len(terms) + 1) for kind in ("share", "time"))


def is_of_relaxation(name: str) -> bool:
    """Whether a constant belongs to a term and not to the energy."""
    return _NAME.fullmatch(name) is not None


def shares(terms: Iterable[RelaxationTerm]) -> Array:
    """Shares of all terms, shape (terms,)."""
    return np.array([term.share for term in terms], float)


def times(terms: Iterable[RelaxationTerm]) -> Array:
    """Return the times of all terms in s, shape (terms,)."""
    return np.array([term.time_s for term in terms], float)


def long_term_share(terms: Iterable[RelaxationTerm]) -> float:
    """Share of the stress that never fades."""
    return 1.0 - math.fsum(term.share for term in terms)


def faults(terms: Sequence[RelaxationTerm], where: str = "material.relaxation") -> list[Fault]:
    """Say what is wrong with numbers, so that no stress could be computed with them."""
    faults_found = []
    if len(terms) > MOST_TERMS:
        mend = "leave the fastest and the slowest ones out"
        faults_found.append(
            Fault(where, f"has {len(terms)} terms, at most {MOST_TERMS} are taken", mend)
        )
    for number, term in enumerate(terms, 1):
        if not math.isfinite(term.share):
            faults_found.append(Fault(where, f"share {number} must be finite, got {term.share}"))
        if not (math.isfinite(term.time_s) and term.time_s > 0):
            rule = f"time {number} must be positive and finite, got {term.time_s} s"
            faults_found.append(Fault(where, rule))
    return faults_found


def unphysical(terms: Sequence[RelaxationTerm], where: str = "material.relaxation") -> list[Fault]:
    """Say which shares make a material that gives back more work than was put in."""
    growing = [
        Fault(where, f"share {number} is {term.share:g}: a stress cannot grow by itself")
        for number, term in enumerate(terms, 1)
        if term.share < 0
    ]
    left = long_term_share(terms)
    if terms and left <= 0:
        rule = f"the shares add up to {1 - left:g}: nothing of the stiffness would be left"
        growing.append(Fault(where, rule, "the sum of all shares must stay below 1"))
    return growing
