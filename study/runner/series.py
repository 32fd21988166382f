"""Refinement series that are stored with a study, judged again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from study.runner.refine import Numerical


def stored_convergence(rows: Sequence[Numerical]) -> list[dict[str, Any]]:
    """Judge every stored series of a study.

    Returns
    -------
    list of dict
        The keys of a convergence document, with ``levels`` and ``note``; a series of two
        meshes has no order and says so.
    """
    from study.analysis import grid_convergence

    found = []
    for row in rows:
        cell: dict[str, Any] = {"levels": dict(row.levels), "note": row.note}
        if len(row.series) >= 3:
            judged = grid_convergence(
                row.mesh_size, row.series, formal_order=row.formal_order, qoi=row.response,
                unit=row.unit,
            )  # fmt: skip
            cell |= judged.to_json() | {"formal_reason": row.formal_reason}
        else:
            cell |= {
                "qoi": row.response, "unit": row.unit,
                "mesh_size": list(row.mesh_size)[::-1], "value": list(row.series)[::-1],
                "behaviour": "inconclusive", "observed_order": None, "formal_order": None,
                "extrapolated": None, "gci_fine": None, "factor_of_safety": None,
                "u_num": row.u_num, "asymptotic_ratio": None,
                "verdict": f"{len(row.series)} meshes have no order; u_num is that of the study",
            }  # fmt: skip
        found.append(cell)
    return found
