"""Resolved tables of a case: what they say of its calibration, and copies on another mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from study.forward.closed_form import height_and_area
from study.measurement.quantities import Gauge
from study.setup.setup import Setup

#: tables of a case by name, in mm, N, MPa and deg, as :func:`study.design.resolve.resolve` made
#: and checked them; what stands in one is read by the section of that name
Tables = Mapping[str, Any]

#: tables that make a problem; ``forward`` stands there where another program predicts
PROBLEM = ("specimen", "test", "material", "model", "forward")


@dataclass(frozen=True)
class CalibrationTable:
    """How the constants of a case are found.

    Parameters
    ----------
    method : str
        ``"auto"``, ``"analytic"``, ``"inverse-fem"`` or ``"none"``.
    problem : mapping or None
        Tables of the test whose curve gives the constants, where that is another one.
    """

    method: str
    problem: Tables | None

    @classmethod
    def of(cls, tables: Tables) -> CalibrationTable:
        """Read the table ``calibration``; without one everything is left to the program."""
        table = tables.get("calibration") or {}
        return cls(table.get("method") or "auto", table.get("problem"))


def on_mesh(tables: Tables, **changes: object) -> dict[str, object]:
    """Copy tables with other keys of ``model``, in the problem of the calibration too.

    Examples
    --------
    >>> on_mesh({"model": {"space": "3d"}, "test": {}}, mesh_seed=1)
    {'model': {'space': '3d', 'mesh_seed': 1}, 'test': {}}
    """
    made = {**tables, "model": {**tables["model"], **changes}}
    own = CalibrationTable.of(tables).problem
    if own:
        problem = {**own, "model": {**own["model"], **changes}}
        made["calibration"] = {**tables["calibration"], "problem": problem}
    return made


def gauge_of(specimen: Tables, test: Tables) -> Gauge | None:
    """Return what turns recorded strain and stress into displacement and force.

    None for a surface whose file nobody looked for.
    """
    setup = Setup.of({"specimen": specimen, "test": test})
    if setup.height_mm is None:
        return None
    height, area = height_and_area(setup.specimen)
    return Gauge(area, height, setup.kind.mode, setup.kind.sense, setup.is_homogeneous)
