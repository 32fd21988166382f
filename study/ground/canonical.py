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
def plain(
    value: Mapping[str, object] | Dataclass | Keyed,
    where: str = "",
    lost: dict[str, str] | None = None,
) -> dict[str, Json]: ...


@overload
def plain(value: object, where: str = "", lost: dict[str, str] | None = None) -> Json: ...


def plain(value: object, where: str = "", lost: dict[str, str] | None = None) -> Json:
    """Value made of JSON types alone; a number that is not finite becomes None.

    What is to be read back names ``where`` it stands: ``lost`` then lists such numbers by their
    places, and keys must be text.
    """
    if type(value) is float and math.isfinite(value):  # nine values in ten
        return value
    if isinstance(value, Keyed):
        value = value.keyed()
    if is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        if lost is not None and not all(isinstance(key, str) for key in value):
            raise TypeError(f"{where}: keys must be text, got {', '.join(map(repr, value))}")
        return {str(key): plain(item, f"{where}.{key}", lost) for key, item in value.items()}
    if isinstance(value, list | tuple):
        if set(map(type, value)) == {float} and all(map(math.isfinite, value)):
            return list(value)  # a curve, as it stands
        return [plain(item, f"{where}.{k}", lost) for k, item in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        if lost is not None:
            lost[where] = str(value)
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{where}: {type(value).__name__} has no place in JSON")


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
    return hashlib.sha256(json_text(value).encode()).hexdigest()[:length]


def numbered(value: Sequence[object], count: int, length: int) -> list[str]:
    """Digests of a list with each number from 1 on behind it; the list is walked once."""
    begun = json_text(canonical(value)).removesuffix("]")
    texts = (f"{begun},{float(number)}]" for number in range(1, count + 1))
    return [hashlib.sha256(text.encode()).hexdigest()[:length] for text in texts]


def json_text(value: object) -> str:
    """JSON text that is the same for equal values."""
    return json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))
