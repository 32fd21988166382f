"""Specimen, test and discretization of a cell, with the defaults that other tables decide.

Checks of one table against another are in :mod:`study.design.plausibility`.
"""

from __future__ import annotations

from collections.abc import Mapping

from study.design.diagnostics import Faults, Table, read_table, read_variant, with_values
from study.setup.forward_model import ForwardModel
from study.setup.geometry import INDENTERS, SPECIMENS, Specimen
from study.setup.setup import Model
from study.setup.test_section import TEST_KINDS, TestSection


def specimen_from(table: object, faults: Faults, path: str = "specimen") -> Specimen:
    """Read a specimen: its shape says which keys it has.

    Parameters
    ----------
    table : mapping
        The table as written.
    faults : Faults
        Where faults go.
    path : str
        Of the table.
    """
    return read_variant(SPECIMENS, "shape", table, path, faults)


def loading_from(table: object, faults: Faults, path: str = "test") -> TestSection:
    """Read how the specimen is loaded; the measured range may give the displacement later.

    Parameters
    ----------
    table : mapping
        The table as written.
    faults : Faults
        Where faults go.
    path : str
        Of the table.

    Returns
    -------
    TestSection
        With its base filled in, and an indenter only where its kind takes one.
    """
    found = read_table(TestSection, table, path, faults)
    written: Table = table if isinstance(table, Mapping) else {}
    base = found.base if "base" in written else found.held_below
    kind, where = TEST_KINDS.get(found.kind), f"{path}.indenter"
    indenter = None
    if kind is not None and kind.takes_indenter:
        if "indenter" in written:
            indenter = read_variant(INDENTERS, "shape", written["indenter"], where, faults)
        else:
            faults.add(where, "is missing", f"{{ shape = ... }} with {'|'.join(INDENTERS)}")
    return with_values(found, base=base, indenter=indenter)


def model_from(
    table: object, faults: Faults, shape: str, ratio: float, path: str = "model"
) -> Model:
    """Read the discretization.

    Parameters
    ----------
    table : mapping
        The table as written.
    faults : Faults
        Where faults go.
    shape : str
        Shape of the specimen: a cylinder is axisymmetric unless the file says 3d.
    ratio : float
        Refinement ratio between coarse, medium and fine.
    path : str
        Of the table.
    """
    found = read_table(Model, table, path, faults)
    written: Table = table if isinstance(table, Mapping) else {}
    if "mesh" in written and "mesh_size" in written:
        faults.add(f"{path}.mesh_size", "stands beside mesh", "give one of the two")
    usual = "axisymmetric" if shape == "cylinder" else "3d"
    space = found.space if "space" in written else usual
    return with_values(found, space=space, mesh_ratio=ratio)


def forward_from(table: object, faults: Faults, path: str = "forward") -> ForwardModel | None:
    """Read what predicts the curves; None for the built-in finite elements.

    Parameters
    ----------
    table : mapping or None
        The table as written; it may hold the commands of another level.
    faults : Faults
        Where faults go.
    path : str
        Of the table.
    """
    if table is None:
        return None
    found = read_table(ForwardModel, table, path, faults)
    if found.model is None or found.model == "fem":
        return None
    missing = None if found.argv is None else found.fault(path)
    if missing is not None:
        faults.add(missing.where, missing.rule, missing.mend)
    return found
