"""Comparison of simulation and measurement: E and u_val along the curve (ASME V&V 20)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from study.reporting.content.table import Table
from study.reporting.figure.axes import plain_ticks, wrap
from study.reporting.figure.style import BAND, MUTED, WIDTH_IN, canvas, color_of
from study.reporting.numbers import MISSING, significant
from study.reporting.text import clean, count

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

Row = Mapping[str, Any]
MOST_PANELS = 12
COLUMNS = 4


def label_of(row: Row) -> str:
    """Name of a cell: its levels.

    Parameters
    ----------
    row : mapping
        One case beside its measurement: ``levels`` by factor; ``all`` where it has none.
    """
    return " / ".join(str(v) for v in row["levels"].values()) or "all"


def first_block(rows: Sequence[Row]) -> list[Row]:
    """Rows of the first block, which stand for the others in the figure.

    Parameters
    ----------
    rows : sequence of mapping
        One a case.
    """
    return [row for row in rows if row["block"] == rows[0]["block"]]


def error_points(rows: Sequence[Row]) -> pd.DataFrame:
    """One row a place of a curve: E and each part of its uncertainty.

    Parameters
    ----------
    rows : sequence of mapping
        One a case, with arrays along its curve; at least one.

    Returns
    -------
    DataFrame
        ``displacement_mm``, ``simulated_N``, ``measured_N``, ``error_N`` (E, simulated less
        measured), ``u_num_N``, ``u_input_N``, ``u_data_N``, ``u_val_N``, ``cell``, ``block``.
    """
    import pandas as pd

    names = ("displacement_mm", "simulated_N", "measured_N", "error_N", "u_num_N", "u_input_N",
             "u_data_N", "u_val_N")  # fmt: skip
    frames = [
        pd.DataFrame({name: row[name] for name in names}).assign(
            cell=label_of(row), block=row["block"] or ""
        )
        for row in rows
    ]
    return pd.concat(frames, ignore_index=True)


def draw_errors(frame: pd.DataFrame) -> Canvas:
    """Draw E along the curve on the band of u_val, a panel a cell, on shared axes.

    Parameters
    ----------
    frame : DataFrame
        By :func:`error_points`, of one block; the first ``MOST_PANELS`` cells are drawn.
    """
    groups = list(frame.groupby("cell", sort=False))[:MOST_PANELS]
    columns = min(COLUMNS, len(groups))
    count = -(-len(groups) // columns)
    figure = canvas(WIDTH_IN, 0.5 + 1.9 * count)
    panels = figure.subplots(count, columns, squeeze=False, sharex=True, sharey=True)
    axes = np.atleast_1d(panels).ravel()
    for ax, (cell, part) in zip(axes, groups, strict=False):
        _panel(ax, part)
        ax.set_title(wrap(cell, 30), fontsize=7.5)
    for ax in axes[len(groups) :]:
        ax.set_visible(False)
    figure.supxlabel("displacement (mm)", fontsize=8.5)
    figure.supylabel("simulated minus measured force (N)", fontsize=8.5)
    return figure


def _panel(ax: Axes, part: pd.DataFrame) -> None:
    d, u = part["displacement_mm"], part["u_val_N"]
    ax.fill_between(d, -u, u, color=BAND, linewidth=0)
    ax.axhline(0.0, color=MUTED, linewidth=0.6)
    ax.plot(d, part["error_N"], color=color_of(0))
    plain_ticks(ax, "y")


def caption(rows: Sequence[Row]) -> str:
    """State in how many cells the model's error shows, and what is not known.

    Parameters
    ----------
    rows : sequence of mapping
        By :func:`first_block`; at least one.
    """
    judged = [row for row in rows if row["u_val_N"][-1] > 0]
    beyond = sum(abs(row["error_N"][-1]) > row["u_val_N"][-1] for row in judged)
    unknown = sorted({name for row in rows for name in row.get("unknown") or ()})
    lacking = f" Not known, and so left out: {', '.join(unknown)}." if unknown else ""
    block = f" (block {clean(rows[0]['block'], 30)})" if rows[0]["block"] else ""
    return (
        f"At the end of the curve E exceeds its uncertainty in {beyond} of {len(judged)} "
        f"cells{block}{_unjudged(len(rows) - len(judged))}. Band: u_val, from mesh, uncertain "
        f"inputs and scatter of the data.{lacking}"
    )


def _unjudged(cells: int) -> str:
    """Say of how many cells no uncertainty is known."""
    return f"; {count(cells, 'cell')} without a known one" if cells else ""


def table(rows: Sequence[Row], block: str) -> Table:
    """Compare every case at the end of its curve.

    Parameters
    ----------
    rows : sequence of mapping
        One a case, of all blocks.
    block : str
        What a block is called; empty without blocks.
    """
    shown = tuple(
        (
            clean(label_of(row)),
            clean(row["block"] or MISSING),
            *(significant(row[name][-1]) for name in _SHOWN),
            f"{100 * row['outside']:.0f} %",
            clean(row["verdict"], 200),
        )
        for row in rows
    )
    raw = tuple(
        {
            **dict(row["levels"]),
            "block": row["block"],
            **{name: row[name][-1] for name in _SHOWN},
            "outside": row["outside"],
            "verdict": row["verdict"],
        }
        for row in rows
    )
    columns = ("cell", block or "block", "E (N)", "u_num", "u_input", "u_data", "u_val",
               "curve outside", "verdict")  # fmt: skip
    return Table("validation", columns, shown, 2, 1, raw=raw)


_SHOWN = ("error_N", "u_num_N", "u_input_N", "u_data_N", "u_val_N")
