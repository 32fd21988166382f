"""What a factor is to the question: a choice, a condition of it, or a fact nobody measured."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from study.setup.quantity import shown
from study.setup.section import Bad
from study.setup.text import choice

#: the analyst decides it, and recommendations are made among its levels
CHOICE = "choice"
#: belongs to the question, which is answered at each of its levels
CONDITION = "condition"
#: a fact that nobody measured: what it would change is said, and no level is recommended
UNKNOWN = "unknown"


#: factor and its role
Roles = tuple[tuple[str, str], ...]


def read_roles(value: object) -> Roles:
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


def default_role(keys: Collection[str], assumed: Collection[str]) -> str:
    """Role of a factor of which nothing is said.

    Parameters
    ----------
    keys : collection of str
        Dotted keys that its levels set.
    assumed : collection of str
        Inputs that nobody measured, as ``[study] assumed`` lists them.

    Returns
    -------
    str
        ``"unknown"`` where all keys are assumed, else ``"choice"``.

    Examples
    --------
    >>> default_role(["test.interface"], ["test"]), default_role(["model.space"], ["test"])
    ('unknown', 'choice')
    """
    covered = all(any(key == a or key.startswith(f"{a}.") for a in assumed) for key in keys)
    return UNKNOWN if keys and covered else CHOICE
