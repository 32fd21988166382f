"""One canonical form of plain values, and the content hashes made of it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, fields, is_dataclass
from typing import ClassVar, Protocol, TypeAlias, overload

import numpy as np

#: what JSON can hold
Json: TypeAlias = "None | bool | int | float | str | list[Json] | dict[str, Json]"


class Dataclass(Protocol):
    """An instance of any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]


class Keyed:
    """A result whose JSON document has declared keys, in place of all of its fields."""

    #: the keys in their order: each a field or property, or ``key=path`` to one of a part, which
    #: is null where the part is None; what the path ends at is called where it is a method
    KEYS: ClassVar[str]

    def to_json(self) -> dict[str, Json]:
        """Document of plain values; a number that is not finite is null."""
        return plain(self)

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key."""
        pairs = (key.partition("=") for key in self.KEYS.split())
        return {key: _at(self, path or key) for key, _, path in pairs}


def _at(value: object, path: str) -> object:
    for name in path.split("."):
        value = None if value is None else getattr(value, name)
    if callable(value) and not is_dataclass(value):
        return value()
    return value


@overload
def plain(value: Mapping[str, object] | Dataclass | Keyed) -> dict[str, Json]: ...


@overload
def plain(value: object) -> Json: ...


def plain(value: object) -> Json:
    """Value made of JSON types alone; a number that is not finite becomes None."""
    if isinstance(value, Keyed):
        value = value.keyed()
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"JSON cannot hold a {type(value).__name__}: {value!r}")


def canonical(value: object, number: Callable[[float], Json] = float) -> Json:
    """Plain JSON values with one spelling per number: ``1`` and ``1.0`` are the same."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, Mapping):
        # where a file lies on this machine is no content; its sha256 stands beside it
        return {str(k): canonical(v, number) for k, v in value.items() if k != "path"}
    if isinstance(value, (list, tuple)):
        # a curve is a list of floats, which are canonical as they stand
        as_they_are = number is float and set(map(type, value)) == {float}
        return list(value) if as_they_are else [canonical(v, number) for v in value]
    if isinstance(value, (int, float)):
        return number(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return canonical(value.tolist(), number)
    if is_dataclass(value) and not isinstance(value, type):
        fields: dict[str, object] = vars(value)
        return canonical(fields, number)
    raise TypeError(f"cannot hash a {type(value).__name__}: {value!r}")


def digest(value: object, length: int = 64) -> str:
    """Hex sha256 of the canonical JSON of a value."""
    return hashed(canonical(value), length)


def hashed(value: Json, length: int) -> str:
    """Hex sha256 of a value that is canonical."""
    return hashlib.sha256(_text(value).encode()).hexdigest()[:length]


def numbered(value: Sequence[object], count: int, length: int) -> list[str]:
    """Digests of a list with each number from 1 on behind it; the list is walked once."""
    begun = _text(canonical(value)).removesuffix("]")
    texts = (f"{begun},{float(number)}]" for number in range(1, count + 1))
    return [hashlib.sha256(text.encode()).hexdigest()[:length] for text in texts]


def _text(value: Json) -> str:
    return json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))
