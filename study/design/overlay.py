"""Dotted keys of a file: which exist, what dimension they have, how one is laid over a file."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from study.design import study_file
from study.design.study_file import FACTOR_KEYS
from study.errors import nearest
from study.material.registry import ENERGIES, is_constant_key, is_dimensionless
from study.setup.geometry import INDENTERS, SPECIMENS
from study.setup.material_section import Compressibility
from study.setup.section import keys_of, written_keys
from study.setup.setup import Model
from study.setup.test_section import TestSection
from study.setup.text import MAX_NAME

#: tables that a preset set may be named after
TABLES = ("specimen", "test", "material", "model", "measurements", "calibration")
_SPECIMEN = sorted({key for shape in SPECIMENS.values() for key in written_keys(shape)} - {"shape"})
_INDENTER = sorted({key for shape in INDENTERS.values() for key in written_keys(shape)} - {"shape"})
_EXAMPLES = ("C10", "C01", "C20", "youngs_modulus", "mu", "alpha")

#: keys that may differ between the cells of a design
VARYING: tuple[str, ...] = (
    "specimen.shape",
    *(f"specimen.{key}" for key in _SPECIMEN),
    *(f"test.{key}" for key in written_keys(TestSection)),
    "test.indenter.shape",
    *(f"test.indenter.{key}" for key in _INDENTER),
    *(f"material.{key}" for key in (*study_file.MATERIAL_KEYS, *_EXAMPLES)),
    *(f"model.{key}" for key in written_keys(Model)),
    *(f"measurements.{key}" for key in FACTOR_KEYS),
    "calibration.method",
)
_REPLACED = r"calibration\.problem\."
_VALUED: tuple[type, ...] = (
    *SPECIMENS.values(),
    *INDENTERS.values(),
    TestSection,
    Model,
    Compressibility,
)

#: what the value of a key measures, as its declaration says
_DIMENSIONS = {
    key.written: key.reads.dimension
    for table in _VALUED
    for key in keys_of(table)
    if key.reads is not None and key.reads.dimension
}

#: keys that decide which others a table may have
_RULING = {"specimen": "shape", "test.indenter": "shape", "material": "model"}


def may_vary(key: str) -> bool:
    """Whether a dotted key may be a factor or stand in a preset.

    Examples
    --------
    >>> may_vary("model.space"), may_vary("material.C30"), may_vary("model.spce")
    (True, True, False)
    """
    plain = re.sub(f"^{_REPLACED}", "", key)
    table, _, name = plain.partition(".")
    return plain in VARYING or (table == "material" and is_constant_key(name))


def suggestion(key: str) -> str:
    """Nearest dotted keys to a wrong one."""
    table = key.partition(".")[0]
    same = [k for k in VARYING if k.startswith(f"{table}.")]
    return nearest(key[:MAX_NAME], same or VARYING)


def dimension(key: str) -> str | None:
    """Dimension of a dotted key, ``"number"`` for a plain one, None where it has no value.

    Examples
    --------
    >>> dimension("specimen.height"), dimension("material.C20")
    ('length', 'pressure')
    """
    last = key.rpartition(".")[2]
    if key in ("measurements.displacement", "measurements.force"):
        return "length" if last == "displacement" else "force"
    if not may_vary(key):
        return None
    if is_constant_key(last):
        return "number" if is_dimensionless(last) else "pressure"
    return _DIMENSIONS.get(last)


def lay(tables: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Lay dotted keys over the tables of a file.

    A key takes away what cannot stand beside it: ``mesh`` a ``mesh_size`` (and the other
    ways round), a shape the sizes of another shape, an energy the constants of another.

    Parameters
    ----------
    tables : mapping
        Not changed.
    settings : mapping
        Dotted keys and raw values.

    Examples
    --------
    >>> lay({"model": {"mesh": "fine", "space": "3d"}}, {"model.mesh_size": "2 mm"})
    {'model': {'space': '3d', 'mesh_size': '2 mm'}}
    """
    merged: dict[str, Any] = copy.deepcopy(dict(tables))
    for key in settings:
        _make_room(merged, key, settings)
    for key, value in settings.items():
        *path, last = key.split(".")
        node = merged
        for part in path:
            if not isinstance(node.get(part), dict):
                node[part] = {}
            node = node[part]
        node[last] = copy.deepcopy(value)
    return merged


def _make_room(merged: dict[str, Any], key: str, settings: Mapping[str, Any]) -> None:
    table, _, last = key.rpartition(".")
    plain = re.sub(f"^{_REPLACED}", "", table)
    node: Any = merged
    for part in table.split("."):
        node = node.get(part) if isinstance(node, dict) else None
    if not isinstance(node, dict):
        return
    alternatives = study_file.ALTERNATIVES.get(plain, ())
    if last in alternatives:
        for other in alternatives:
            node.pop(other, None)
    if last == _RULING.get(plain):
        for other in [k for k in node if not _belongs(plain, settings[key], k)]:
            del node[other]


def _belongs(table: str, ruling: Any, key: str) -> bool:
    """Whether a key may stay in a table whose shape or energy becomes ``ruling``."""
    if table != "material":
        kinds = SPECIMENS if table == "specimen" else INDENTERS
        others = {key for shape in kinds.values() for key in written_keys(shape)}
        return key not in others or ruling not in kinds or key in written_keys(kinds[ruling])
    if key in study_file.MATERIAL_KEYS or ruling not in ENERGIES:
        return True
    if not is_constant_key(key):
        return True  # an unknown key stays, to be reported
    return ENERGIES[ruling].has_key(key)
