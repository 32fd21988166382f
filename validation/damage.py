"""Documents with one thing wrong, as somebody's editor or another program leaves them.

Every key of a tree is deleted once, and replaced by what hardly any reader expects; of a list the
first two places stand for the others. The files are sealed as the program seals its own, but also
with numbers that JSON has not.
"""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

#: what a place is given; each copied where it is used
WRONG: tuple[Any, ...] = (
    None, 1, "x", [], {}, [1], {"a": 1}, math.nan, math.inf, 10**400, -1, 0, True, [None], "",
)  # fmt: skip

#: places of a list that stand for all
FIRST = 2


@dataclass(frozen=True)
class Damage:
    """One thing that is wrong: the keys that lead there, what stands there now, and the tree."""

    place: tuple[str | int, ...]
    what: str
    content: Any

    def __str__(self) -> str:
        return f"{'.'.join(map(str, self.place)) or 'all'} {self.what}"


def damages(content: Any) -> Iterator[Damage]:
    """Every tree that differs from one in a single place."""
    for value in WRONG:
        yield Damage((), f"is {value!r:.20}", copy.deepcopy(value))
    for place in places(content):
        yield without(content, place)
        yield from (instead(content, place, value) for value in WRONG)


def without(content: Any, place: tuple[str | int, ...]) -> Damage:
    """Delete what stands at a place."""
    changed = copy.deepcopy(content)
    del _above(changed, place)[place[-1]]
    return Damage(place, "is deleted", changed)


def instead(content: Any, place: tuple[str | int, ...], value: Any) -> Damage:
    """Put a value where another one stands."""
    changed = copy.deepcopy(content)
    _above(changed, place)[place[-1]] = copy.deepcopy(value)
    return Damage(place, f"is {value!r:.20}", changed)


def places(content: Any, above: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Keys that lead to every part of a tree."""
    parts: list[tuple[str | int, Any]] = []
    if isinstance(content, dict):
        parts = list(content.items())
    elif isinstance(content, list):
        parts = list(enumerate(content[:FIRST]))
    for key, part in parts:
        yield (*above, key)
        yield from places(part, (*above, key))


def _above(content: Any, place: tuple[str | int, ...]) -> Any:
    for key in place[:-1]:
        content = content[key]
    return content


def sealed(content: Any) -> str:
    """Text of a stored file with the right checksum, whatever it holds."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    text = text.replace("Infinity", "1e400")  # a reader of JSON takes it for infinite
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"schema":1,"checksum":"{checksum}","content":{text}}}\n'
