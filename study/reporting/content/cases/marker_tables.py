"""Tables of markers inside a specimen: errors beside the motion of the plate that leaves them."""

from __future__ import annotations

from study.record.document import PlateFitDocument
from study.reporting.content.cases.fit_tables import fit_rank
from study.reporting.content.table import Table
from study.reporting.numbers import MINUS, MISSING, quantity
from study.reporting.text import clean
from study.study_result.report_data import MarkedCase, ReportData

#: what a plate is taken to do, in words
_PLATES = {"nominal": "as said", "rigid": "any rigid motion", "slipping": "rigid, face slips"}


def marker_errors(data: ReportData) -> Table:
    """RMS error of the markers of every case and plate, with the motion of the plate.

    Parameters
    ----------
    data : ReportData
        Its marked cases, with errors in mm; a motion has mm, deg (tilts, twist) and percent
        (spread).

    Returns
    -------
    Table
        One row a case and plate. Fitted components stand with their standard errors.
    """
    shown = sorted(data.markers, key=lambda one: fit_rank(one.levels, data))
    rows = tuple(_row(one, fit) for one in shown for fit in one.fits)
    raw = tuple(
        {
            **one.levels,
            "state": one.state,
            "plate": fit["plate"],
            "fitted": fit["fitted"],
            "markers": fit["markers"],
            "error_mm": fit["error_mm"],
            "floor_mm": one.floor_mm,
            **{f"{name}_{end}": v for name, pair in fit["motion"].items()
               for end, v in zip(("value", "standard_error"), pair, strict=True)},
            **{f"layer_{name}_mm": v for name, v in fit["error_by_layer_mm"].items()},
        }
        for one in shown
        for fit in one.fits
    )  # fmt: skip
    columns = (
        "cell", "state", "plate", "told by", "markers", "RMS error", "floor",
        "down, x, y (mm)", "tilts, twist (deg)", "spread (%)",
    )  # fmt: skip
    return Table("marker-errors", columns, rows, 4, 3, raw=raw, grouped=True)


def _row(one: MarkedCase, fit: PlateFitDocument) -> tuple[str, ...]:
    motion = fit["motion"]
    return (
        " \N{MIDDLE DOT} ".join(clean(level) for level in one.levels.values()),
        clean(one.state),
        _PLATES.get(fit["plate"], clean(fit["plate"])),
        f"{clean(fit['fitted'])}",
        f"{fit['markers']}",
        quantity(fit["error_mm"], "mm"),
        quantity(one.floor_mm, "mm"),
        _values(motion, ("down", "x", "y")),
        _values(motion, ("tilt_x", "tilt_y", "twist")),
        _values(motion, ("spread",)),
    )


def _values(motion: dict[str, list[float | None]], names: tuple[str, ...]) -> str:
    """Components with their standard errors where they were fitted."""
    said = []
    for name in names:
        value, error = motion.get(name, (None, None))
        if value is None:
            said.append(MISSING)
            continue
        said.append(f"{value:.2f} \N{PLUS-MINUS SIGN} {error:.2f}" if error else f"{value:.4g}")
    return ", ".join(said).replace("-", MINUS) or MISSING
