"""One finished case: the only thing that crosses the disk.

A record is stored as JSON with a sha256 over its canonical content, so that a truncated or
altered file is found, never used. JSON has no NaN: a number that is not finite is stored as
null, and ``extra["not_finite"]`` says where it stood and what it was.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from study.ground.canonical import json_text, plain
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError, NewerSchemaError, StoreError, nearest
from study.ground.files import parse_json, write_atomic
from study.ground.tabular import is_formula
from study.record.document import (
    CurveKey,
    FitDocument,
    MarkerDocument,
    MeshDocument,
    ParameterDocument,
    RecordDocument,
    ResponseDocument,
    RetryDocument,
    ScoreDocument,
    SolverDocument,
    fault_of,
    fault_of_curves,
    fault_of_fits,
)

if TYPE_CHECKING:
    from pandas import DataFrame, Series


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
    "lost-contact",
    "out-of-memory",
    "timeout",
    "crashed",
    "failed",
)


@dataclass(frozen=True, eq=False)
class Record:
    """Result of one case, or the reason why there is none; equal when its JSON is."""

    case_id: str
    study: str
    levels: Mapping[str, str] = field(default_factory=dict)
    block: str | None = None
    status: str = "converged"
    message: str = ""
    responses: Mapping[str, ResponseDocument] = field(default_factory=dict)
    #: Constants averaged over the fits, by name.
    parameters: Mapping[str, ParameterDocument] = field(default_factory=dict)
    #: Every fit by the label of what was fitted; None where constants were given.
    fit: Mapping[str, FitDocument] | None = None
    curves: Mapping[CurveKey, Curve] = field(default_factory=dict)
    #: Seconds of each part; ``"total"`` is shown in tables.
    timings: Mapping[str, float] = field(default_factory=dict)
    mesh: MeshDocument = field(default_factory=MeshDocument)
    solver: SolverDocument = field(default_factory=SolverDocument)
    #: Versions of everything that may move a digit.
    versions: Mapping[str, str] = field(default_factory=dict)
    #: Hash of everything that decides the answer: case, data, configuration, code version.
    input_hash: str = ""
    #: Anything else that JSON can hold.
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
        response = self.responses.get(name)
        value = None if response is None else response["value"]
        return None if value is None else float(value)

    @property
    def fits(self) -> tuple[FitDocument, ...]:
        """Every fit of the case."""
        return tuple((self.fit or {}).values())

    @property
    def scores(self) -> tuple[ScoreDocument, ...]:
        """Every scored curve of the case; empty without an answer, or for a refit."""
        written = self.extra.get("directions", ()) if self.converged else ()
        return tuple(cast("Sequence[ScoreDocument]", written))

    @property
    def markers(self) -> tuple[MarkerDocument, ...]:
        """What markers inside the specimen say; empty where it has none."""
        written = self.extra.get("markers", ()) if self.converged else ()
        return tuple(cast("Sequence[MarkerDocument]", written))

    @property
    def retries(self) -> tuple[RetryDocument, ...]:
        """Every attempt before this one; empty where the design's own setting gave it."""
        return tuple(cast("Sequence[RetryDocument]", self.extra.get("retries", ())))

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
        predicted = (curve for key, curve in self.curves.items() if key.role == "predicted")
        return next(predicted, None)

    def to_json(self) -> str:
        """Text of the record with its checksum; never holds a bare NaN."""
        # Of a record that was read it is the text itself, where this version wrote it.
        text = self.__dict__.get(_READ)
        if text is not None:
            return str(text)
        lost: dict[str, str] = {}
        content: dict[str, object] = {
            f.name: plain(getattr(self, f.name), f.name, lost)
            for f in fields(self)
            if f.name not in ("curves", "extra")
        }
        content["curves"] = {
            str(key): plain(curve.as_dict(), f"curves.{key}", lost)
            for key, curve in self.curves.items()
        }
        extra = plain(self.extra, "extra", lost)
        if lost:
            before = cast("Mapping[str, str]", extra.get("not_finite", {}))
            extra["not_finite"] = plain({**before, **lost})
        return seal(content | {"extra": extra})

    @classmethod
    def from_json(cls, text: str | bytes, source: str = "record") -> Record:
        """Read a record back."""
        content = unseal(text, source)
        fault = fault_of(content, RecordDocument)
        fields_read = cast("dict[str, Any]", content)
        if not fault and set(fields_read) != set(RecordDocument.__annotations__):
            fault = "its fields are others"
        if fault:
            raise StoreError(f"{source}: is no record of a case, {fault}")
        try:
            written = fields_read.pop("curves")
            curves = {CurveKey.of(key): Curve.from_dict(curve) for key, curve in written.items()}
            record = cls(**fields_read, curves=curves)
        except (TypeError, ValueError, LookupError, ArithmeticError, StoreError) as error:
            raise StoreError(f"{source}: is not a valid record ({error})") from error
        fault = fault_of_fits(record.fit or {}) or fault_of_curves(curves, record.scores)
        if fault:
            raise StoreError(f"{source}: is no record of a case, {fault}")
        if isinstance(text, str) and _SEALED.fullmatch(text.encode()):
            record.__dict__[_READ] = text  # a worker's, on its way to the disk
        return record


#: a file as :func:`seal` writes it
_SEALED = re.compile(
    rb'\{"schema":%d,"checksum":"(?P<checksum>[0-9a-f]{64})","content":(?P<content>.*)\}\s*'
    % SCHEMA,
    re.DOTALL,
)


def seal(content: object) -> str:
    """JSON text of a content with schema and checksum."""
    text = json_text(content)
    checksum = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"schema":{SCHEMA},"checksum":"{checksum}","content":{text}}}\n'


def unseal(text: str | bytes, source: str) -> object:
    """Content of a sealed text, as JSON gives it."""
    data = text.encode() if isinstance(text, str) else text
    as_written = _SEALED.fullmatch(data)
    if as_written is not None:
        content = as_written["content"]
        if hashlib.sha256(content).hexdigest() == as_written["checksum"].decode():
            return parse_json(content, source)  # byte for byte what was sealed
    whole = parse_json(data, source)
    schema = whole.get("schema") if isinstance(whole, dict) else None
    if isinstance(schema, int) and schema > SCHEMA:
        raise NewerSchemaError(
            f"{source}: was written by a newer study (schema {schema}, this version reads "
            f"{SCHEMA}); it is left as it is. Update this one with pip install --upgrade, or "
            "name another folder with --results"
        )
    if not isinstance(whole, dict) or set(whole) != {"schema", "checksum", "content"}:
        raise StoreError(f"{source}: is not a sealed file of this program")
    if whole["schema"] != SCHEMA:
        raise StoreError(f"{source}: has schema {whole['schema']!r}, this version reads {SCHEMA}")
    try:
        checksum = hashlib.sha256(json_text(whole["content"]).encode()).hexdigest()
    except (ValueError, RecursionError) as error:
        raise StoreError(f"{source}: holds what no record can hold ({error})") from error
    if checksum != whole["checksum"]:
        raise StoreError(f"{source}: is damaged, its checksum does not fit its content")
    return whole["content"]


# The tidy table of a study: one row per case, failed cases included.

FIXED = ("case_id", "block", "status", "seconds", "dofs")
#: columns that number the replicates of a cell, and the number of the case that they repeat
REPLICATES = {"mesh_seed": 1, "noise_seed": 0, "replicate": 1}


def is_repeat(extra: Mapping[str, object]) -> bool:
    """Whether a case repeats another one for an error term."""
    return any(replicate(extra, name) != first for name, first in REPLICATES.items())


def is_same_run(extra: Mapping[str, object]) -> bool:
    """Whether a case is a run that counts already, on another mesh or with drawn noise."""
    # a replicate of a stochastic simulation is a run of its own, as the first one is
    return is_repeat({name: number for name, number in extra.items() if name != "replicate"})


def replicate(extra: Mapping[str, object], name: str) -> int:
    """Read the number that a case has among its repeats."""
    number = extra.get(name)
    return number if isinstance(number, int) and number else REPLICATES[name]


def table(records: Sequence[Record]) -> DataFrame:
    """Tidy table of records, in the order given."""
    import pandas as pd

    factors = list(records[0].levels) if records else []
    seen: set[str] = set()
    for record in records:
        if set(record.levels) != set(factors):
            raise StoreError(
                f"case {record.case_id}: its factors are {sorted(record.levels)}, those of the "
                f"first record {sorted(factors)}; records of different studies are not mixed"
            )
        if record.case_id in seen:
            raise StoreError(f"case {record.case_id} stands twice among the records")
        seen.add(record.case_id)
    units = _units(records)
    numbered = [n for n in REPLICATES if any(n in r.extra for r in records)]
    clash = [n for n in factors if n in FIXED or n in units or n in numbered]
    if clash:
        raise StoreError(f"factor {clash[0]!r} has the name of another column; rename it")
    columns: dict[str, list[object]] = {
        "case_id": [r.case_id for r in records],
        "block": [r.block for r in records],
        **{name: [r.levels[name] for r in records] for name in factors},
        **{n: [replicate(r.extra, n) for r in records] for n in numbered},
        "status": [r.status for r in records],
    }
    numbers = {name: [r.response(name) for r in records] for name in units}
    numbers.setdefault("seconds", [_number(r.timings.get("total")) for r in records])
    numbers.setdefault("dofs", [_number(r.mesh.get("dofs")) for r in records])
    frame = pd.DataFrame(
        {name: pd.Series(values, dtype=object) for name, values in columns.items()}
        | {name: pd.Series(values, dtype=float) for name, values in numbers.items()}
    )
    frame.attrs["units"] = units
    return frame


def cell_names(frame: DataFrame, factors: Sequence[str]) -> Series[str]:
    """Name the cell of every row: its levels joined by ``:``."""
    import pandas as pd

    columns = [frame[name].astype(str) for name in factors]
    joined = [":".join(levels) for levels in zip(*columns, strict=True)]
    return pd.Series(joined, index=frame.index, dtype=str)


def answered_often(
    table_known: DataFrame, factors: Sequence[str], block: str, blocks: int
) -> Series[bool]:
    """Tell which rows belong to a cell with an answer in more than half of so many blocks."""
    cell = cell_names(table_known, factors)
    return 2 * table_known[block].groupby(cell).transform("nunique") > blocks


def write_csv(frame: DataFrame, path: Path) -> None:
    """Write a table as CSV, whole or not at all."""
    texts = [("header", str(name)) for name in frame.columns]
    for name in frame.columns:
        values = dict.fromkeys(v for v in frame[name].tolist() if isinstance(v, str))
        texts += [(f"column {name}", value) for value in values]
    faults = [
        Fault(
            f"{path.name}: {where}",
            f"a spreadsheet would run {text[:40]!r} as a formula",
            "rename it so that it does not begin with = + - @ or a control character",
        )
        for where, text in texts
        if is_formula(text)
    ]
    if faults:
        raise InputError(list(dict.fromkeys(faults))[:20])
    text = frame.to_csv(index=False, lineterminator="\n")
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        raise InputError(Fault(path.name, f"a name is not valid text ({error.reason})")) from error
    write_atomic(path, data)


def _units(records: Sequence[Record]) -> dict[str, str]:
    units: dict[str, str] = {}
    for record in records:
        for name, response in record.responses.items():
            unit = str(response.get("unit", ""))
            if units.setdefault(name, unit) != unit:
                raise StoreError(
                    f"case {record.case_id}: {name} is in {unit!r}, elsewhere in {units[name]!r}"
                )
    return units


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else float("nan")
