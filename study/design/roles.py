"""What a factor is to the question: a choice, a condition of it, or a fact nobody measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from study.setup.quantity import shown
from study.setup.section import Bad
from study.setup.text import choice

if TYPE_CHECKING:
    from study.design.spec import Design, Factor

#: the analyst decides it, and recommendations are made among its levels
CHOICE = "choice"
#: belongs to the question, which is answered at each of its levels
CONDITION = "condition"
#: a fact that nobody measured: what it would change is said, and no level is recommended
UNKNOWN = "unknown"


def read_roles(value: object) -> tuple[tuple[str, str], ...]:
    """Read ``[analysis] roles``: factor to role."""
    if not isinstance(value, Mapping):
        mend = 'for example { plates = "unknown", range = "condition" }'
        raise Bad(f"must be a table of factors, got {shown(value)}", mend)
    found: list[tuple[str, str]] = []
    for name, role in value.items():
        if isinstance(role, Mapping):  # a dotted key that was not quoted
            found += [(f"{name}.{rest}", one) for rest, one in read_roles(role)]
        else:
            found.append((str(name), choice(CHOICE, CONDITION, UNKNOWN)(role)))
    return tuple(found)


def roles_of(design: Design) -> dict[str, str]:
    """Role of every factor.

    Parameters
    ----------
    design : Design
        Its ``[analysis] roles`` decide; a factor whose keys all stand in ``[study] assumed``
        is unknown, any other one a choice.

    Returns
    -------
    dict of str to str
        In the order of the factors.
    """
    declared = dict(design.analysis.roles)
    return {f.name: declared.get(f.name, _default(f, design.assumed)) for f in design.factors}


def _default(factor: Factor, assumed: tuple[str, ...]) -> str:
    keys = {key for level in factor.levels for key in level.settings}
    covered = all(any(key == a or key.startswith(f"{a}.") for a in assumed) for key in keys)
    return UNKNOWN if keys and covered else CHOICE
