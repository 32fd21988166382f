"""Cells that a run has added to its design, kept in the design that it stores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from study.design.load import dump, loads
from study.design.spec import Design
from study.errors import InputError
from study.runner.provenance import code_version

if TYPE_CHECKING:
    from study.record.store import Store


def continued(design: Design, store: Store) -> Design:
    """Design with the cells that an earlier run of it has added.

    Parameters
    ----------
    design : Design
        As it is written; one that is not adaptive is handed back.
    store : Store
        Of its results.
    """
    if design.scheme.sequential is None:
        return design
    manifest = store.read_unfinished() or store.read_manifest()
    if manifest is None or manifest.get("versions", {}).get("study") != code_version():
        return design
    try:
        known = loads(manifest["design"], manifest["source"])
    except InputError:
        return design
    same = dump(with_added(known, ())) == dump(with_added(design, ()))
    return with_added(design, added(known)) if same else design


def _table(design: Design) -> Mapping[str, object]:
    written = design.config["design"]
    return written if isinstance(written, Mapping) else {}


def added(design: Design) -> list[list[float]]:
    """Cells that were added, as they stand in the design.

    Parameters
    ----------
    design : Design
        One that is not adaptive has none.

    Returns
    -------
    list of list of float
        For each cell the share of every factor's range, 0 to 1, in the order of the factors.
    """
    cells = _table(design).get("added", ())
    return [list(cell) for cell in cells] if isinstance(cells, list | tuple) else []


def with_added(design: Design, cells: Sequence[Sequence[float]]) -> Design:
    """Copy of a design with other cells added to its Latin hypercube.

    Parameters
    ----------
    design : Design
        An adaptive one; cells that it has added already are dropped.
    cells : sequence of sequence of float
        As of :func:`added`; empty for the design as it is written.
    """
    table = {key: value for key, value in _table(design).items() if key != "added"}
    if cells:
        table["added"] = [list(cell) for cell in cells]
    text = dump(replace(design, config={**design.config, "design": table}))
    return replace(loads(text, design.source), text=design.text)
