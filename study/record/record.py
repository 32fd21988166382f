"""One finished case: the only thing that crosses the disk.

A record is stored as JSON with a sha256 over its canonical content, so that a truncated or
altered file is found, never used. JSON has no NaN: a number that is not finite is stored as
null, and ``extra["not_finite"]`` says where it stood and what it was.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, cast

import numpy as np

from study.bounded_file import parse_json
from study.curve import Curve
from study.errors import NewerSchemaError, StoreError, nearest
from study.record.document import (
    CurveKey,
    FitDocument,
    MarkerDocument,
    MeshDocument,
    ParameterDocument,
    RecordDocument,
    ResponseDocument,
    ScoreDocument,
    SolverDocument,
)
from study.record.document_checks import fault_of, fault_of_curves, fault_of_fits

SCHEMA = 1
#: where a record keeps the text that it was read from
_READ = "_read"
#: status of a case that has an answer
CONVERGED = "converged"
STATUSES = (
    CONVERGED,
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
    responses : mapping of str to ResponseDocument
        Value and unit by name.
    parameters : mapping of str to ParameterDocument
        Constants averaged over the fits, by name.
    fit : mapping of str to FitDocument, or None
        Every fit by the label of what was fitted; None where constants were given.
    curves : mapping of CurveKey to Curve
        For example ``measured:B`` and ``predicted:B``.
    timings : mapping of str to float
        Seconds of each part; ``"total"`` is shown in tables.
    mesh, solver : MeshDocument, SolverDocument
        Of the last prediction.
    versions : mapping of str to str
        Versions of everything that may move a digit.
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
    responses: Mapping[str, ResponseDocument] = field(default_factory=dict)
    parameters: Mapping[str, ParameterDocument] = field(default_factory=dict)
    fit: Mapping[str, FitDocument] | None = None
    curves: Mapping[CurveKey, Curve] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)
    mesh: MeshDocument = field(default_factory=MeshDocument)
    solver: SolverDocument = field(default_factory=SolverDocument)
    versions: Mapping[str, str] = field(default_factory=dict)
    input_hash: str = ""
    extra: Mapping[str, object] = field(default_factory=dict)

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
        return self.status == CONVERGED

    def response(self, name: str) -> float:
        """Value of a response; NaN where it is missing or the case has no answer."""
        value = self.value(name) if self.converged else None
        return math.nan if value is None else value

    def value(self, name: str) -> float | None:
        """Look up the value of a response, whatever the status; None where there is none."""
        found = self.responses.get(name)
        value = None if found is None else found["value"]
        return None if value is None else float(value)

    @property
    def fits(self) -> tuple[FitDocument, ...]:
        """Every fit of the case."""
        return tuple((self.fit or {}).values())

    @property
    def scores(self) -> tuple[ScoreDocument, ...]:
        """Every scored curve of the case; empty without an answer, or for a refit."""
        found = self.extra.get("directions", ()) if self.converged else ()
        return tuple(cast("Sequence[ScoreDocument]", found))

    @property
    def markers(self) -> tuple[MarkerDocument, ...]:
        """What markers inside the specimen say; empty where it has none."""
        found = self.extra.get("markers", ()) if self.converged else ()
        return tuple(cast("Sequence[MarkerDocument]", found))

    def pair(self, label: str) -> tuple[Curve, Curve] | None:
        """Measured and predicted curve of a label; None unless both are kept."""
        measured = self.curves.get(CurveKey("measured", label))
        predicted = self.curves.get(CurveKey("predicted", label))
        return None if measured is None or predicted is None else (measured, predicted)

    def first_pair(self) -> tuple[Curve, Curve] | None:
        """Measured and predicted curve of the first direction; None without a prediction."""
        labels = (key.label for key in self.curves if key.role == "predicted")
        return next((pair for label in labels if (pair := self.pair(label)) is not None), None)

    def first_prediction(self) -> Curve | None:
        """Predicted curve of the first direction; None without a prediction."""
        found = (curve for key, curve in self.curves.items() if key.role == "predicted")
        return next(found, None)

    def to_json(self) -> str:
        """Text of the record with its checksum; never holds a bare NaN.

        Of a record that was read it is the text itself, where this version wrote it.
        """
        known = self.__dict__.get(_READ)
        if known is not None:
            return str(known)
        lost: dict[str, str] = {}
        content = {
            f.name: plain(getattr(self, f.name), f.name, lost)
            for f in fields(self)
            if f.name not in ("curves", "extra")
        }
        content["curves"] = {
            str(key): plain(curve.as_dict(), f"curves.{key}", lost)
            for key, curve in self.curves.items()
        }
        extra = cast("dict[str, object]", plain(self.extra, "extra", lost))
        if lost:
            before = cast("Mapping[str, str]", extra.get("not_finite", {}))
            extra["not_finite"] = {**before, **lost}
        return seal(content | {"extra": extra})

    @classmethod
    def from_json(cls, text: str | bytes, source: str = "record") -> Record:
        """Read a record back.

        Raises
        ------
        StoreError
            If the text is no record, is damaged, or was written by a newer version.
        """
        content = unseal(text, source)
        fault = fault_of(content, RecordDocument)
        kept = cast("dict[str, Any]", content)
        if not fault and set(kept) != set(RecordDocument.__annotations__):
            fault = "its fields are others"
        if fault:
            raise StoreError(f"{source}: is no record of a case, {fault}")
        try:
            written = kept.pop("curves")
            curves = {CurveKey.of(key): Curve.from_dict(curve) for key, curve in written.items()}
            record = cls(**kept, curves=curves)
        except (TypeError, ValueError, LookupError, ArithmeticError, StoreError) as error:
            raise StoreError(f"{source}: is not a valid record ({error})") from error
        fault = fault_of_fits(record.fit or {}) or fault_of_curves(curves, record.scores)
        if fault:
            raise StoreError(f"{source}: is no record of a case, {fault}")
        if isinstance(text, str) and _SEALED.fullmatch(text.encode()):
            record.__dict__[_READ] = text  # a worker's, on its way to the disk
        return record


def plain(value: object, where: str, lost: dict[str, str]) -> object:
    """Value as JSON can hold it; floats that are not finite become None and are listed.

    Parameters
    ----------
    value : object
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
    if type(value) is float and math.isfinite(value):  # nine values in ten
        return value
    if type(value) is list and set(map(type, value)) == {float} and all(map(math.isfinite, value)):
        return value  # a curve, as it stands
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


def canonical(content: object) -> str:
    """JSON text that is the same for equal content.

    Parameters
    ----------
    content
        Values that JSON has; nan and infinity raise ValueError.
    """
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


#: a file as :func:`seal` writes it
_SEALED = re.compile(
    rb'\{"schema":%d,"checksum":"(?P<checksum>[0-9a-f]{64})","content":(?P<content>.*)\}\s*'
    % SCHEMA,
    re.DOTALL,
)


def seal(content: object) -> str:
    """JSON text of a content with schema and checksum.

    Parameters
    ----------
    content
        As :func:`canonical` takes it.
    """
    text = canonical(content)
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"schema":{SCHEMA},"checksum":"{checksum}","content":{text}}}\n'


def unseal(text: str | bytes, source: str) -> object:
    """Content of a sealed text, as JSON gives it.

    Parameters
    ----------
    text : str or bytes
        As :func:`seal` writes it, or the same JSON laid out in another way.
    source : str
        Name of the file, for messages.

    Raises
    ------
    NewerSchemaError
        If a newer version wrote it.
    StoreError
        If it is not JSON, its checksum does not fit, or its schema is unknown.
    """
    data = text.encode() if isinstance(text, str) else text
    as_written = _SEALED.fullmatch(data)
    if as_written is not None:
        content = as_written["content"]
        if hashlib.sha256(content).hexdigest() == as_written["checksum"].decode():
            return parse_json(content, source)  # byte for byte what was sealed
    whole = parse_json(data, source)
    _check_schema(whole, source)
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


def _check_schema(whole: object, source: str) -> None:
    """Tell what a newer version wrote from what is damaged."""
    schema = whole.get("schema") if isinstance(whole, dict) else None
    if isinstance(schema, int) and schema > SCHEMA:
        raise NewerSchemaError(
            f"{source}: was written by a newer study (schema {schema}, this version reads "
            f"{SCHEMA}); it is left as it is. Update this one with pip install --upgrade, or "
            "name another folder with --results"
        )
