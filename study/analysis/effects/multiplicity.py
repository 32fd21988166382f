"""Several tests at once: Holm's p beside the raw one, within a response or over a study.

Holm controls the chance of any false rejection whatever the dependence (Holm 1979, Scand. J.
Statist. 6, 65-70) and is never less powerful than Bonferroni. The false discovery rate is no
alternative here: a study has 7 to 30 dependent tests and each is read alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from study.analysis.effects.comparisons import holm
from study.errors import Fault, InputError, nearest

#: more primary terms than this are no choice before the run
MOST_PRIMARY = 3


@dataclass(frozen=True)
class FamilyTest:
    """One test of a family.

    Parameters
    ----------
    response, term : str
        What was tested.
    p : float or None
        Raw p; None where there is no test.
    p_holm : float or None
        Adjusted p; None outside the family.
    family : int
        Number of tests in the family.
    """

    response: str
    term: str
    p: float | None
    p_holm: float | None
    family: int


def response_family(
    response: str, p: Mapping[str, float | None], primary: Sequence[str] = ()
) -> tuple[FamilyTest, ...]:
    """Adjust the p of all terms in the table of one response.

    Parameters
    ----------
    response : str
        The response.
    p : mapping of str to (float or None)
        Raw p of each term; None where a term has no test.
    primary : sequence of str
        Up to three terms declared before the run, which then form the family.

    Returns
    -------
    tuple of FamilyTest
        One for each term, in order.

    Raises
    ------
    InputError
        For a p outside [0, 1], or primary terms that are too many or unknown.

    Examples
    --------
    >>> [t.p_holm for t in response_family("f", {"A": 0.01, "B": 0.04, "A:B": None})]
    [0.02, 0.04, None]
    """
    return _adjusted([(response, term, value) for term, value in p.items()], primary)


def study_family(
    p: Mapping[str, Mapping[str, float | None]], primary: Sequence[str] = ()
) -> tuple[FamilyTest, ...]:
    """Adjust the p of all terms of all responses together.

    Parameters
    ----------
    p : mapping of str to mapping of str to (float or None)
        Raw p of each term of each response.
    primary : sequence of str
        As in :func:`response_family`, for every response.

    Returns
    -------
    tuple of FamilyTest
        One for each response and term.
    """
    return _adjusted(
        [(name, term, value) for name, terms in p.items() for term, value in terms.items()],
        primary,
    )


def _adjusted(
    tests: Sequence[tuple[str, str, float | None]], primary: Sequence[str]
) -> tuple[FamilyTest, ...]:
    _check(tests, primary)
    inside = [
        i
        for i, (_, term, value) in enumerate(tests)
        if value is not None and (not primary or term in primary)
    ]
    raw = [value for i in inside if (value := tests[i][2]) is not None]
    adjusted = dict(zip(inside, holm(raw).tolist() if raw else [], strict=True))
    return tuple(
        FamilyTest(name, term, value, adjusted.get(i), len(inside))
        for i, (name, term, value) in enumerate(tests)
    )


def _check(tests: Sequence[tuple[str, str, float | None]], primary: Sequence[str]) -> None:
    faults = []
    for name, term, p in tests:
        if p is not None and not (math.isfinite(p) and 0 <= p <= 1):
            faults.append(Fault(f"{name}: {term}", f"p must lie in [0, 1], got {p!r}"))
    terms = [term for _, term, _ in tests]
    if len(primary) > MOST_PRIMARY:
        rule = f"at most {MOST_PRIMARY} may be declared, got {len(primary)}"
        faults.append(Fault("primary terms", rule, "name only those decided before the run"))
    for term in primary:
        if term not in terms:
            rule = f"{term!r} is no term of the model"
            faults.append(Fault("primary terms", rule, nearest(term, terms)))
    if faults:
        raise InputError(faults)
