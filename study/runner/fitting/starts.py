"""Starts of a fit, the wanted one first, then gentler ones for where the model has no answer.

Higher constants that were fitted on another mesh, or with one constant less, can soften so much
that the wanted model loses its equilibrium before the end of the test. Less of them is nearer
to a neo-Hookean solid of the same initial shear modulus, which has an answer wherever the test
has one. The order is fixed, so that a start remains a function of the case alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.material.relaxation import is_of_relaxation

#: what is kept of the higher constants, and how a message calls it
_SHARES = (
    (0.5, "the higher constants halved"),
    (0.25, "the higher constants halved twice"),
    (0.0, "the neo-Hookean constant alone"),
)


@dataclass(frozen=True)
class Start:
    """Start values of a fit.

    Parameters
    ----------
    values : ndarray, shape (p,)
        In MPa, exponents plain.
    words : str
        How a message calls them.
    """

    values: Array
    words: str = "the start values"


def gentler(
    names: Sequence[str],
    start: Array,
    bounds: Sequence[tuple[float, float]] | None = None,
) -> list[Start]:
    """List a start and what may be tried after it, each one once.

    Parameters
    ----------
    names : sequence of str
        Names of the constants.
    start : ndarray, shape (p,)
        Wanted start values in MPa.
    bounds : sequence of (low, high), optional
        One pair for every constant; a gentler start stays inside.

    Examples
    --------
    >>> for one in gentler(("C10", "C20"), np.array([3.0, -0.4])):
    ...     print(one.values, one.words)
    [ 3.  -0.4] the start values
    [ 3.  -0.2] the higher constants halved
    [ 3.  -0.1] the higher constants halved twice
    [3. 0.] the neo-Hookean constant alone
    """
    found = [Start(np.array(start, float))]
    for share, words in _SHARES:
        values = _softened(names, found[0].values, share)
        if bounds is not None:
            values = np.clip(values, *np.array(bounds, float).T)
        if not any(np.array_equal(values, one.values) for one in found):
            found.append(Start(values, words))
    return found


def _softened(names: Sequence[str], start: Array, share: float) -> Array:
    """Keep a share of the higher constants, and the initial shear modulus."""
    every = dict(zip(names, start.tolist(), strict=True))
    old = {n: v for n, v in every.items() if not is_of_relaxation(n)}
    if "mu1" in old:
        new = _softened_ogden(old, share)
    elif "C10" in old:
        new = {n: v if n == "C10" else share * v for n, v in old.items()}
        # mu0 = 2 (C10 + C01)
        new["C10"] = old["C10"] + (1 - share) * old.get("C01", 0.0)
    else:
        new = old
    return np.array([{**every, **new}[n] for n in names]) + 0.0  # no minus zero


def _softened_ogden(old: dict[str, float], share: float) -> dict[str, float]:
    """Move moduli to the first term, whose exponent nears the 2 of a neo-Hookean solid."""
    new = {n: share * v if re.fullmatch(r"mu\d+", n) else v for n, v in old.items()}
    total = sum(v for n, v in old.items() if re.fullmatch(r"mu\d+", n))
    new["mu1"] += (1 - share) * total
    if "alpha1" in old:
        new["alpha1"] = 2 + share * (old["alpha1"] - 2)
    return new
