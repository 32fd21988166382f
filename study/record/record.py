"""One finished case: the only thing that crosses the disk.

A record is stored as JSON with a sha256 over its canonical content, so that a truncated or
altered file is found, never used. JSON has no NaN: a number that is not finite is stored as
null, and ``extra["not_finite"]`` says where it stood and what it was.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from study.curve import Curve
from study.errors import StoreError, nearest

SCHEMA = 1
STATUSES = (
    "converged",
    "not-converged",
    "mesh-failed",
    "unstable",
    "out-of-memory",
    "timeout",
    "crashed",
    "failed",
)


@dataclass(frozen=True, eq=False)
class Record:
    """Result of one case, or the reason why there is none.

    Parameters
    ----------
    case_id : str
        Hash of the case.
    study : str
        Name of the study.
    levels : mapping of str to str
        Factor and level label.
    block : str or None
        Label of the block.
    status : str
        One of :data:`STATUSES`.
    message : str
        Sentence that explains the status.
    responses : mapping
        Name to ``{"value": float or None, "unit": str}``.
    parameters : mapping
        Name to ``{"value", "unit", "standard_error", "ci95"}``.
    fit : mapping or None
        What else is known of the fit, or the id of a shared one.
    curves : mapping of str to Curve
        For example ``"measured:B"`` and ``"predicted:B"``.
    timings : mapping of str to float
        Seconds of each part; ``"total"`` is shown in tables.
    mesh, solver, versions : mapping
        Provenance.
    input_hash : str
        Hash of everything that decides the answer: case, data, configuration, code version.
    extra : mapping
        Anything else that JSON can hold.

    Notes
    -----
    Two records are equal when their JSON is.
    """

    case_id: str
    study: str
    levels: Mapping[str, str] = field(default_factory=dict)
    block: str | None = None
    status: str = "converged"
    message: str = ""
    responses: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    fit: Mapping[str, Any] | None = None
    curves: Mapping[str, Curve] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    mesh: Mapping[str, Any] = field(default_factory=dict)
    solver: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)
    input_hash: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise ValueError(f"unknown status {self.status!r}; {nearest(self.status, STATUSES)}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Record) and self.to_json() == other.to_json()

    def __hash__(self) -> int:
        return hash((self.case_id, self.study))

    @property
    def converged(self) -> bool:
        """Whether the case has an answer."""
        return self.status == "converged"

    def response(self, name: str) -> float:
        """Value of a response; NaN where it is missing or the case has no answer."""
        value = self.responses.get(name, {}).get("value") if self.converged else None
        return math.nan if value is None else float(value)

    def to_json(self) -> str:
        """Text of the record with its checksum; never holds a bare NaN."""
        lost: dict[str, str] = {}
        content = {
            f.name: plain(getattr(self, f.name), f.name, lost)
            for f in fields(self)
            if f.name != "curves"
        }
        content["curves"] = {
            name: plain(curve.as_dict(), f"curves.{name}", lost)
            for name, curve in self.curves.items()
        }
        if lost:
            content["extra"] = {
                **content["extra"],
                "not_finite": {**content["extra"].get("not_finite", {}), **lost},
            }
        return seal(content)

    @classmethod
    def from_json(cls, text: str | bytes, source: str = "record") -> Record:
        """Read a record back.

        Raises
        ------
        StoreError
            If the text is no record, is damaged, or was written by a newer version.
        """
        content = unseal(text, source)
        names = {f.name for f in fields(cls)}
        if not isinstance(content, dict) or set(content) != names:
            raise StoreError(f"{source}: its fields are not those of a record")
        for name, kinds in _KINDS.items():
            if not isinstance(content[name], kinds):
                raise StoreError(f"{source}: field {name!r} has the wrong type")
        _check_parts(content, source)
        try:
            curves = {k: Curve.from_dict(v) for k, v in content.pop("curves").items()}
            return cls(**content, curves=curves)
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise StoreError(f"{source}: is not a valid record ({error})") from error


_KINDS: Mapping[str, tuple[type, ...]] = {
    **dict.fromkeys(("case_id", "study", "status", "message", "input_hash"), (str,)),
    **dict.fromkeys(
        (
            "levels",
            "responses",
            "parameters",
            "curves",
            "timings",
            "mesh",
            "solver",
            "versions",
            "extra",
        ),
        (dict,),
    ),
    "block": (str, type(None)),
    "fit": (dict, type(None)),
}


def _check_parts(content: Mapping[str, Any], source: str) -> None:
    """Check the types inside the mappings that tables and reports read."""
    number = (int, float, type(None))
    if not all(isinstance(v, str) for v in content["levels"].values()):
        raise StoreError(f"{source}: levels must be labels")
    if not all(isinstance(v, number) for v in content["timings"].values()):
        raise StoreError(f"{source}: timings must be numbers")
    for name, found in content["responses"].items():
        if not isinstance(found, dict) or not isinstance(found.get("value"), number):
            raise StoreError(f"{source}: response {name!r} has no number or null as its value")


def plain(value: Any, where: str, lost: dict[str, str]) -> Any:
    """Value as JSON can hold it; floats that are not finite become None and are listed.

    Parameters
    ----------
    value : Any
        Nested mappings, sequences, arrays and scalars.
    where : str
        Dotted place of the value, for the list.
    lost : dict
        Filled with place and text of every NaN or infinity.

    Raises
    ------
    TypeError
        For a type that has no place in a record.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (np.bool_, np.ndarray, np.generic)):
        return plain(value.tolist(), where, lost)
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return value
        lost[where] = str(value)
        return None
    if isinstance(value, Mapping):
        return {_key(k, where): plain(v, f"{where}.{k}", lost) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v, f"{where}.{k}", lost) for k, v in enumerate(value)]
    raise TypeError(f"{where}: {type(value).__name__} has no place in a record")


def _key(key: object, where: str) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{where}: keys must be text, got {key!r}")
    return key


def canonical(content: Any) -> str:
    """JSON text that is the same for equal content."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def seal(content: Any) -> str:
    """JSON text of ``content`` with schema and checksum."""
    text = canonical(content)
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"schema":{SCHEMA},"checksum":"{checksum}","content":{text}}}\n'


def unseal(text: str | bytes, source: str) -> Any:
    """Content of a sealed text.

    Raises
    ------
    StoreError
        If it is not JSON, its checksum does not fit, or its schema is unknown.
    """
    try:
        whole = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{source}: is not valid JSON ({error})") from error
    if not isinstance(whole, dict) or set(whole) != {"schema", "checksum", "content"}:
        raise StoreError(f"{source}: is not a sealed file of this program")
    if whole["schema"] != SCHEMA:
        raise StoreError(f"{source}: has schema {whole['schema']!r}, this version reads {SCHEMA}")
    try:
        found = hashlib.sha256(canonical(whole["content"]).encode()).hexdigest()
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{source}: holds what no record can hold ({error})") from error
    if found != whole["checksum"]:
        raise StoreError(f"{source}: is damaged, its checksum does not fit its content")
    return whole["content"]


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")
