"""Names made of content: the hash of plain values with one spelling."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from typing import cast, overload

import numpy as np

from study.canonical import Json
from study.errors import Fault, InputError
from study.measurement.section import MeasurementSpec

ID_LENGTH = 16


def case_id(content: object) -> str:
    """Name made of content: 16 hex digits of the sha256 of canonical JSON.

    Numbers are coerced first (``1`` and ``1.0`` are one), keys sorted. Labels, names and
    citations are no content.

    Parameters
    ----------
    content
        As :func:`plain` takes it; a ``path`` within it is ignored.

    Examples
    --------
    >>> case_id({"a": 1, "b": 2.5}) == case_id({"b": 2.5, "a": 1.0})
    True
    """
    return _name(canonical_json(content))


def block_ids(content: Mapping[str, object], blocks: Sequence[str | None]) -> list[str]:
    """Names of some content in every block; the content is walked once.

    Parameters
    ----------
    content : mapping
        Document of a cell, without its block.
    blocks : sequence of str or None
        Label of every block; None for a study without blocks.

    Returns
    -------
    list of str
        One :func:`case_id` a block, in the same order.

    Examples
    --------
    >>> block_ids({"a": 1}, ["x"]) == [case_id({"a": 1, "block": "x"})]
    True
    """
    walked = without_places(plain(content))
    shared = walked if isinstance(walked, dict) else {}
    return [_name(_text({**shared, "block": block})) for block in blocks]


def _name(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]


def canonical_json(content: object) -> str:
    """One spelling of JSON for equal content.

    Parameters
    ----------
    content
        As :func:`plain` takes it; a ``path`` within it is ignored.

    Raises
    ------
    InputError
        For what has no such spelling: nan, infinity, an unknown type.

    Examples
    --------
    >>> canonical_json({"b": (1.0, 2), "a": None})
    '{"a":null,"b":[1,2]}'
    """
    return _text(without_places(plain(content)))


def _text(named: Json) -> str:
    return json.dumps(named, sort_keys=True, allow_nan=False, separators=(",", ":"))


def without_places(value: Json) -> Json:
    """Content without ``path``: where a file lies on this machine names nothing.

    Parameters
    ----------
    value
        Plain JSON values; mappings and lists are walked at every depth.
    """
    if isinstance(value, dict):
        return {k: without_places(v) for k, v in value.items() if k != "path"}
    return [without_places(v) for v in value] if isinstance(value, list) else value


@overload
def plain(value: Mapping[str, object]) -> dict[str, Json]: ...


@overload
def plain(value: object) -> Json: ...


def plain(value: object) -> Json:
    """Plain JSON values of a configuration, numbers coerced.

    Parameters
    ----------
    value
        Mappings, lists, tuples, arrays, dataclasses and atoms, nested at will. The citation of a
        MeasurementSpec is left out.

    Returns
    -------
    dict, list or atom
        A whole float of a size below 2**53 is an int.

    Raises
    ------
    InputError
        For nan, infinity or an unknown type.
    """
    return _plain(value)


#: types that are plain as they are, asked for first: nine values in ten
_ATOMS = frozenset({str, int, bool, type(None)})


def _plain(value: object) -> Json:
    kind = type(value)
    if kind in _ATOMS:
        return cast("Json", value)
    if kind is dict:
        return {str(k): _plain(v) for k, v in cast("dict[object, object]", value).items()}
    if isinstance(value, MeasurementSpec):
        return _plain({k: v for k, v in value.as_dict().items() if k != "citation"})
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(vars(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value.is_integer() and abs(value) < 2**53 else value
    raise InputError(Fault("case", f"cannot name the content {value!r}"))
