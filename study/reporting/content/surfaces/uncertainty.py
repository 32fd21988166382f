"""What uncertain inputs do to a response over ranges: sentences and the table of inputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.reporting.content.table import Table
from study.reporting.numbers import MISSING, percent, quantity
from study.reporting.text import clean, listing, name_of

if TYPE_CHECKING:
    from study.response_surface.propagation import InputShare
    from study.study_result.report_data import ReportData
    from study.study_result.response_surface import FittedSurface

#: a gain below this is no reason to measure an input better
WORTH = 0.01


def answer(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the answer: how sure the response is, and which input to measure better.

    Parameters
    ----------
    one : FittedSurface
        With the distribution of the response, in its unit; None of it gives no sentence.
    data : ReportData
        Better names of the inputs.
    """
    told = one.uncertain
    if told is None:
        return ()
    unit, ends = clean(one.unit), told.percentiles
    best = told.inputs[0]
    gain = told.gain(best)
    sure = (
        f"With these uncertain inputs it is {quantity(told.mean.value, unit)} with a standard "
        f"deviation of {quantity(told.sd.value, unit)}; 95 % of it lie between "
        f"{quantity(ends[2.5].value, unit)} and {quantity(ends[97.5].value, unit)}."
    )
    if gain < WORTH:
        return (sure, "Measuring one of them twice as well would change that by less than 1 %.")
    worth = (
        f"Knowing {name_of(best.name, data.labels)} twice as well would lower the standard "
        f"deviation by {percent(gain)}" + (", more than any other." if told.inputs[1:] else ".")
    )
    return (sure, worth)


def lines(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the section: the surface's own error, and what was held or cut off.

    Parameters
    ----------
    one : FittedSurface
        With the distribution of the response, in its unit; None of it gives no sentence.
    data : ReportData
        Better names of the inputs.
    """
    told = one.uncertain
    if told is None:
        return ()
    unit = clean(one.unit)
    ends = told.percentiles
    said = [
        "The surface itself may be off by "
        f"{quantity(told.mean.own, unit, 2)} in the mean, {quantity(told.sd.own, unit, 2)} in the "
        f"standard deviation and {quantity(max(t.own for t in ends.values()), unit, 2)} in the "
        "percentiles of the uncertain inputs' response; that is no part of these."
    ]
    if told.fixed:
        held = [
            f"{name_of(name, data.labels)} at {quantity(value, one.units.get(name, ''))}"
            for name, value in told.fixed.items()
        ]
        said.append(f"Held there for it: {listing(held)}.")
    cut = [f"{percent(p, 2)} of {name_of(n, data.labels)}" for n, p in told.cut.items() if p > 1e-4]
    if cut:
        said.append(f"Outside of the ranges that were run, and cut off: {listing(cut)}.")
    return tuple(said)


def table(one: FittedSurface, data: ReportData) -> Table | None:
    """List the inputs, the one that is worth measuring most first; None where none is uncertain.

    Parameters
    ----------
    one : FittedSurface
        Standard deviations are in the unit of its response, gains in percent.
    data : ReportData
        Better names of the inputs.
    """
    told = one.uncertain
    if told is None:
        return None
    rows = tuple(
        (
            clean(name_of(item.name, data.labels)),
            clean(one.inputs.get(item.name, "")),
            *_shares(item),
            quantity(item.halved, clean(one.unit)),
            percent(told.gain(item)),
        )
        for item in told.inputs
    )
    columns = ("input", "distribution", "share alone", "share in all", "sd if halved", "gain")
    note = (
        f"Standard deviation of the response now: {quantity(told.sd.value, clean(one.unit))}. "
        "Shares of its variance by the input alone and with all its interactions. Gain: part of "
        "the standard deviation that goes when the input is known twice as well."
    )
    name = " ".join(("uncertain", one.response, *one.labels.values()))
    return Table(name, columns, rows, 2, 0, note)


def _shares(item: InputShare) -> tuple[str, str]:
    if item.index is None:
        return MISSING, MISSING
    return percent(item.index.first), percent(item.index.total)
