"""Whether what was read from the disk is such a document as its class says.

A right checksum says that a file is as it was written, not that a study wrote it. The keys and
types of a document are compiled once, and its numbers must be finite: it is checked in a few
microseconds.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping, Sequence
from functools import cache
from typing import (
    Annotated,
    NotRequired,
    Required,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np
from pydantic_core import SchemaValidator, ValidationError, core_schema
from pydantic_core.core_schema import CoreSchema

from study.arrays import Array
from study.curve import Curve
from study.record.document import (
    CurveKey,
    FitDocument,
    NumericalRow,
    ScoreDocument,
    ValidationRow,
)

#: what a record must know of each of its fits
_NEEDED = ("key", "values", "identifiable")

#: whole numbers of a document; a larger one overflows where it meets a float
_LARGEST = 2**63


def fault_of(content: object, kind: type) -> str:
    """Say where a content is not such a document.

    Parameters
    ----------
    content : object
        Plain data, as JSON gives it.
    kind : type
        Class of :mod:`study.record.document`, or a ``list`` of one.

    Returns
    -------
    str
        The first fault, as the end of a sentence; empty if there is none.

    Examples
    --------
    >>> from study.record.document import Quantity
    >>> fault_of({"value": 1.5, "unit": "N"}, Quantity)
    ''
    >>> fault_of({"value": "1.5"}, Quantity)
    'its value should be a valid number'
    """
    try:
        _validator(kind).validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            return f"it has no {place}"
        _, _, wanted = first["msg"].partition("Input should ")
        whose = f"its {place}" if place else "its content"
        return f"{whose} should {wanted}" if wanted else f"{whose} has another length"
    return ""


def fault_of_fits(fits: Mapping[str, FitDocument], needed: Sequence[str] = _NEEDED) -> str:
    """Say which fit cannot be shown; empty if each can.

    Parameters
    ----------
    fits : mapping of str to FitDocument
        By the name under which the record keeps them.
    needed : sequence of str
        Keys that each must have.
    """
    for name, fit in fits.items():
        lost = [key for key in needed if key not in fit]
        if lost:
            return f"its fit {name!r} has no {lost[0]}"
        if _is_uneven(fit):
            return f"its fit {name!r} has correlations of other constants than its own"
    return ""


def _is_uneven(fit: FitDocument) -> bool:
    """Whether correlations are others than one for each two constants."""
    size, rows = len(fit.get("names", ())), fit.get("correlation") or []
    return bool(rows) and [len(row) for row in rows] != [size] * size


def fault_of_curves(
    curves: Mapping[CurveKey, Curve], directions: Sequence[ScoreDocument] = ()
) -> str:
    """Say which curve of a record cannot be read off, or is not there; empty if each can.

    Parameters
    ----------
    curves : mapping of CurveKey to Curve
        Measured and predicted ones; a prediction must reach the end of its measured curve.
    directions : sequence of ScoreDocument
        What was scored, and needs a prediction.
    """
    for key, curve in curves.items():
        if not _is_readable(curve):
            return f"its curve {key} has columns of unequal length, or gaps"
    for key, curve in curves.items():
        measured = curves.get(CurveKey("measured", key.label))
        if key.role == "predicted" and measured is not None and not _reaches(curve, measured):
            return f"its curve {key} ends before the measured one"
    lost = [one for one in directions if CurveKey("predicted", one["score"]) not in curves]
    return f"it has no curve predicted:{lost[0]['score']}" if lost else ""


def fault_of_series(rows: list[NumericalRow]) -> str:
    """Say which refined cell has not one value a mesh; empty if each has.

    Parameters
    ----------
    rows : list of NumericalRow
        Of the right keys and types; one without meshes is whole.
    """
    for number, row in enumerate(rows):
        if len(row.get("series", ())) != len(row.get("mesh_size", ())):
            return f"its {number}.series has another length than its mesh_size"
    return ""


def fault_of_comparisons(rows: list[ValidationRow]) -> str:
    """Say which comparison has columns of unequal length; empty if none has.

    Parameters
    ----------
    rows : list of ValidationRow
        Of the right keys and types.
    """
    for number, row in enumerate(rows):
        columns: Mapping[str, object] = row
        if len({len(cast("list[float]", columns[name])) for name in _ALONG}) > 1:
            return f"its {number} has columns of unequal length"
    return ""


#: columns of a comparison along a curve
_ALONG = frozenset(name for name in ValidationRow.__annotations__ if name.endswith(("_N", "_mm")))


def _is_readable(curve: Curve) -> bool:
    """Whether each row has every number of it; forces may be unknown, places not."""
    columns = (curve.force_N, curve.stiffness_N_per_mm, curve.work_Nmm, curve.time_s)
    shape = curve.displacement_mm.shape
    alike = len(shape) == 1 and all(one is None or one.shape == shape for one in columns)
    if not alike or not shape[0] or not _is_finite(curve.displacement_mm):
        return False
    if curve.time_s is not None and not _is_finite(curve.time_s):
        return False
    return _is_finite(curve.force_N) or not bool(np.isinf(curve.force_N).any())


def _is_finite(values: Array) -> bool:
    """Whether every number is finite, which the ends tell sooner than every number does."""
    return math.isfinite(values.max()) and math.isfinite(values.min())


def _reaches(predicted: Curve, measured: Curve) -> bool:
    """Whether a prediction is known at every measured place; see :meth:`Curve.force_at`."""
    asked, known = measured.displacement_mm, predicted.displacement_mm
    if predicted.time_s is not None:
        span = float(np.abs(known).max())
        return asked.shape == known.shape and np.allclose(asked, known, rtol=0, atol=1e-6 * span)
    return bool(asked.min() >= -1e-12 and asked.max() <= known[-1] * (1 + 1e-9) + 1e-12)


@cache
def _validator(kind: type) -> SchemaValidator:
    return SchemaValidator(_schema(kind))


_PLAIN: Mapping[object, CoreSchema] = {
    str: core_schema.str_schema(strict=True),
    bool: core_schema.bool_schema(strict=True),
    int: core_schema.int_schema(strict=True, ge=-_LARGEST, le=_LARGEST),
    float: core_schema.float_schema(strict=True, allow_inf_nan=False),
    object: core_schema.any_schema(),
}


def _schema(hint: object) -> CoreSchema:
    """Compile a type as the documents use them."""
    if is_typeddict(hint):
        return _table(cast(type, hint))
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return cast(CoreSchema, {**_schema(inner[0]), **dict(inner[1:])})
    if origin in (Union, types.UnionType):
        (one,) = (kind for kind in inner if kind is not types.NoneType)
        return core_schema.nullable_schema(_schema(one))
    if origin is dict:
        return core_schema.dict_schema(_PLAIN[str], _schema(inner[1]), strict=True)
    if origin is list:
        return core_schema.list_schema(_schema(inner[0]), strict=True)
    return _PLAIN[hint]


def _table(kind: type) -> CoreSchema:
    """Compile a dictionary with known keys; what else it holds is nobody's business."""
    fields = {}
    by_class: frozenset[str] = kind.__dict__["__required_keys__"]
    for name, hint in get_type_hints(kind, include_extras=True).items():
        # in annotations that are kept as text the class itself does not see these two
        said = get_origin(hint) if get_origin(hint) in (Required, NotRequired) else None
        required = said is Required if said else name in by_class
        inner = get_args(hint)[0] if said else hint
        fields[name] = core_schema.typed_dict_field(_schema(inner), required=required)
    return core_schema.typed_dict_schema(fields, strict=True, extra_behavior="ignore")
