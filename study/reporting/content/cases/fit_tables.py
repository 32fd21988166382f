"""Tables of fitted constants: one row for each kind of fit, and every fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from study.reporting.content.table import Table
from study.reporting.numbers import MINUS, MISSING, interval, quantity, share
from study.reporting.text import clean, name_of
from study.study_result.report_data import ANY, FittedConstant, ReportData


def fit_name(fit: FittedConstant, data: ReportData) -> str:
    """Name a fit by its levels; a factor that one fit serves is any.

    Parameters
    ----------
    fit : FittedConstant
        Its levels, ``ANY`` where one fit serves all levels of a factor.
    data : ReportData
        Better names of the factors.
    """
    parts = (
        f"any {name_of(name, data.labels)}" if level == ANY else clean(level)
        for name, level in fit.levels.items()
    )
    return " \N{MIDDLE DOT} ".join(parts)


def fit_rank(levels: Mapping[str, str], data: ReportData) -> tuple[int, ...]:
    """Sort key of a fit: its levels in the order of the design.

    Parameters
    ----------
    levels : mapping of str to str
        Level by factor; not of a fit alone: cells and marked cases are sorted by it too.
    data : ReportData
        Order of the levels of each factor.

    Returns
    -------
    tuple of int
        Place of each level; -1 for one that is not in the design, such as ``ANY``.
    """
    known = ((data.factors.get(name, ()), level) for name, level in levels.items())
    return tuple(order.index(level) if level in order else -1 for order, level in known)


def fits(data: ReportData) -> Table:
    """Fitted constants over the blocks: median, range, uncertainty, identifiability.

    Parameters
    ----------
    data : ReportData
        Its fits, values in the unit of each constant and residuals in N.

    Returns
    -------
    Table
        One row for the same levels and constant; ``raw`` has one for every fitted constant.
    """
    names = list(dict.fromkeys(name for fit in data.fits for name in fit.levels))
    groups: dict[tuple[str, str], list[FittedConstant]] = {}
    for fit in sorted(data.fits, key=lambda fit: (fit_rank(fit.levels, data), fit.constant)):
        groups.setdefault((fit_name(fit, data), clean(fit.constant)), []).append(fit)
    rows = [(*key, *_summary(items)) for key, items in groups.items()]
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
        "fit",
        "constant",
        "median",
        "range over fits",
        "standard error",
        "correlation",
        "residual (RMS)",
        "identifiable",
    )
    return Table("fits", columns, tuple(rows), 2, 0, raw=raw, grouped=True)


def _summary(items: Sequence[FittedConstant]) -> tuple[str, ...]:
    """Median, range, relative standard error, correlation, residual, share that is determined."""
    import numpy as np

    values = np.array([i.value for i in items if i.value is not None], dtype=float)
    unit = items[0].unit
    relative = [
        abs(i.standard_error / i.value) for i in items if i.standard_error is not None and i.value
    ]
    residual = [i.residual_N for i in items if i.residual_N is not None]
    return (
        quantity(float(np.median(values)), unit) if values.size else MISSING,
        interval(float(values.min()), float(values.max()), unit) if values.size else MISSING,
        share(float(np.median(relative))) if relative else MISSING,
        _strongest(items),
        quantity(float(np.median(residual)), "N", 2) if residual else MISSING,
        f"{sum(item.identifiable for item in items)} of {len(items)}",
    )


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


def every_fit(data: ReportData) -> Table:
    """Every fitted constant with its 95 % interval.

    Parameters
    ----------
    data : ReportData
        One row for each of its fits, values in the unit of the constant and residuals in N.
    """
    rows = tuple(
        (
            fit_name(fit, data),
            clean(fit.constant),
            clean(fit.block),
            clean(fit.specimen) or MISSING,
            quantity(fit.value, fit.unit),
            interval(fit.low, fit.high, fit.unit),
            quantity(fit.residual_N, "N", 2),
            ("yes" if fit.identifiable else "no")
            + (f": {clean(fit.reason, 160)}" if fit.reason else ""),
        )
        for fit in sorted(data.fits, key=lambda fit: fit_rank(fit.levels, data))
    )
    columns = (
        "fit",
        "constant",
        data.block or "block",
        "specimen",
        "value",
        "95 % interval",
        "residual (RMS)",
        "identifiable",
    )
    return Table("every-fit", columns, rows, 4, 1, grouped=True)
