"""Tables of fitted constants: one row for each kind of fit, and every fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from study.reporting.data import FittedConstant, ReportData
from study.reporting.tables import Table
from study.reporting.text import MINUS, MISSING, clean, interval, name_of, quantity, share


def fits(data: ReportData) -> Table:
    """Fitted constants over the blocks: median, range, uncertainty, identifiability."""
    import numpy as np

    groups: dict[tuple[str, ...], list[Any]] = {}
    names = list(dict.fromkeys(name for fit in data.fits for name in fit.levels))
    for fit in data.fits:
        key = (*(clean(fit.levels.get(name, MISSING)) for name in names), clean(fit.constant))
        groups.setdefault(key, []).append(fit)
    rows = []
    for key, items in sorted(groups.items(), key=lambda group: _place(group[0], names, data)):
        values = np.array([i.value for i in items if i.value is not None], dtype=float)
        relative = [
            abs(i.standard_error / i.value)
            for i in items
            if i.standard_error is not None and i.value
        ]
        known = sum(item.identifiable for item in items)
        residual = [i.residual_N for i in items if i.residual_N is not None]
        rows.append(
            (
                *key,
                quantity(float(np.median(values)), items[0].unit) if values.size else MISSING,
                interval(float(values.min()), float(values.max()), items[0].unit)
                if values.size
                else MISSING,
                share(float(np.median(relative))) if relative else MISSING,
                _strongest(items),
                quantity(float(np.median(residual)), "N", 2) if residual else MISSING,
                f"{known} of {len(items)}",
            )
        )
    raw = tuple(
        {
            **{name: fit.levels.get(name) for name in names},
            "block": fit.block,
            "specimen": fit.specimen,
            "constant": fit.constant,
            "value": fit.value,
            "unit": fit.unit,
            "standard_error": fit.standard_error,
            "low": fit.low,
            "high": fit.high,
            "identifiable": fit.identifiable,
            "reason": fit.reason,
            "residual_N": fit.residual_N,
            "r_squared": fit.r_squared,
            **{f"correlation with {k}": v for k, v in fit.correlated.items()},
        }
        for fit in data.fits
    )
    columns = (
        *(name_of(name, data.labels) for name in names),
        "constant",
        "median",
        "range over fits",
        "standard error",
        "correlation",
        "residual (RMS)",
        "identifiable",
    )
    return Table("fits", columns, tuple(rows), len(names) + 1, 0, raw=raw)


def _strongest(items: Sequence[FittedConstant]) -> str:
    """Median correlation with the constant that a fit is most entangled with."""
    import numpy as np

    others = dict.fromkeys(other for item in items for other in item.correlated)
    medians = {
        other: float(np.median([i.correlated[other] for i in items if other in i.correlated]))
        for other in others
    }
    if not medians:
        return MISSING
    other = max(medians, key=lambda name: abs(medians[name]))
    return f"{medians[other]:.3f} with {clean(other, 16)}".replace("-", MINUS)


def _place(
    key: Sequence[str], names: Sequence[str], data: ReportData
) -> tuple[tuple[int, ...], str]:
    """Sort key of a fit: its levels in the order of the design, then its constant."""
    order = []
    for name, shown in zip(names, key, strict=False):
        levels = [clean(level) for level in data.factors.get(name, ())]
        order.append(levels.index(shown) if shown in levels else -1)
    return tuple(order), key[-1]


def every_fit(data: ReportData) -> Table:
    """Every fitted constant with its 95 % interval."""
    names = list(dict.fromkeys(name for fit in data.fits for name in fit.levels))
    rows = tuple(
        (
            *(clean(fit.levels.get(name, MISSING)) for name in names),
            clean(fit.block),
            clean(fit.specimen),
            clean(fit.constant),
            quantity(fit.value, fit.unit),
            interval(fit.low, fit.high, fit.unit),
            quantity(fit.residual_N, "N", 2),
            ("yes" if fit.identifiable else "no")
            + (f": {clean(fit.reason, 160)}" * bool(fit.reason)),
        )
        for fit in data.fits
    )
    columns = (
        *(name_of(name, data.labels) for name in names),
        data.block or "block",
        "specimen",
        "constant",
        "value",
        "95 % interval",
        "residual (RMS)",
        "identifiable",
    )
    return Table("every-fit", columns, rows, len(names) + 3, 1)
