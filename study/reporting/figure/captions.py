"""Captions: each states what its figure shows, with numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.reporting.content.sizes import practical, size, size_interval
from study.reporting.numbers import THIN, duration, level, p_phrase, quantity, share, significant
from study.reporting.report import Facts
from study.reporting.text import clean, count, listing, name_of, plural_of, sentence, term_name
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figure.curves.samples import CurvePanels


def effects(facts: Facts, data: ReportData) -> str:
    """Name the largest effect, and what the band is.

    Parameters
    ----------
    facts : Facts
        Its effects; one without a size is passed over.
    data : ReportData
        For the shown names of factors.

    Returns
    -------
    str
        Empty where no effect has a size.
    """
    known = [effect for effect in facts.effects if effect.range is not None]
    if not known:
        return ""
    first = max(known, key=lambda e: abs((e.range or 0) - (1 if e.is_ratio else 0)))
    limit = practical(first, facts)
    text = f"{term_name(first.term, data.labels)} has the largest effect, {size(first, facts)}"
    if first.low is not None:
        text += f" ({level(facts.alpha)} interval {size_interval(first, facts)})"
    if first.practical is not None:
        text += f". Shaded: up to {limit}, which does not matter in practice"
    if first.practical is not None and first.low is not None:
        text += "; an interval wholly outside matters, one wholly inside does not"
    return sentence(text)


def means(facts: Facts, data: ReportData) -> str:
    """Say which share of the variation between cells each factor has.

    Parameters
    ----------
    facts : Facts
        Its rows of the ANOVA table, for their shares.
    data : ReportData
        For the factors and their shown names.
    """
    shares = [
        (row.share, term_name(row.term, data.labels))
        for row in facts.rows
        if row.term in data.factors and row.share is not None
    ]
    text = listing([f"{name} {share(part)}" for part, name in sorted(shares, reverse=True)])
    band = "two means inside the shaded band differ by less than what matters"
    shown = f"share of the total variation: {text}; " if shares else ""
    return sentence(f"level means on one shared axis; {shown}{band}")


def interactions(facts: Facts, data: ReportData) -> str:
    """Say which interaction is the largest.

    Parameters
    ----------
    facts : Facts
        Its interactions and their p; those of three or more factors are passed over.
    data : ReportData
        For the shown names of factors.
    """
    known = [e for e in facts.interactions if e.term.count(":") == 1 and e.range is not None]
    key = "lines that are parallel mean that the factors act independently"
    if not known:
        return sentence(key)
    first = max(known, key=lambda e: abs((e.range or 0) - (1 if e.is_ratio else 0)))
    row = facts.row(first.term)
    decided = None if row is None else row.p_deciding
    p = "" if decided is None else f", {p_phrase(decided)}"
    return sentence(
        f"the largest two-factor interaction is {term_name(first.term, data.labels)}, "
        f"{size(first, facts)}{p}; {key}"
    )


def cells(facts: Facts, data: ReportData, frame: pd.DataFrame) -> str:
    """Say what the points are, and how far the cells and the blocks differ.

    Parameters
    ----------
    facts : Facts
        For the unit, and whether means are geometric.
    data : ReportData
        For what a block is called.
    frame : DataFrame
        By :func:`study.reporting.figure.effects.cells.cell_points`.
    """
    shown = frame.drop_duplicates("rank")
    means_of = shown["cell_mean"]
    unit = clean(data.block) or "run"
    low, high = significant(float(means_of.min())), quantity(float(means_of.max()), facts.unit)
    kind = "geometric cell means" if facts.ratio else "cell means"
    text = f"{kind} (diamonds) run from {low} to {high}; each dot is one {unit}"
    if "block" in frame:
        spread = frame.groupby("block")["value"].mean()
        text += (
            f", joined across cells by a thin line; {unit} means run from "
            f"{significant(float(spread.min()))} to {quantity(float(spread.max()), facts.unit)}"
        )
    copies = int(shown["copies"].sum())
    if copies > len(shown):
        text += (
            f"; {count(len(shown), 'row')} for {copies} cells, since cells that agree in every "
            f"{unit} are one computation"
        )
    return sentence(text)


def residuals(facts: Facts, data: ReportData, n: int) -> str:
    """Summarize the four panels and the test.

    Parameters
    ----------
    facts : Facts
        Its test of normality.
    data : ReportData
        For the level of that test.
    n : int
        Residuals that are drawn.
    """
    found = facts.assumptions.normality
    verdict = "the test of normality does not apply"
    if found is not None and found.rj is not None:
        exact = found.p_exact
        rejected = exact is not None and exact < data.alpha
        verdict = f"normality is {'rejected' if rejected else 'not rejected'}"
        verdict += f" ({p_phrase(exact)}, simulated)" if exact is not None else ""
    return sentence(
        f"{count(n, 'residual')} of block and cell, one cell for each distinct computation; "
        f"{verdict}. Run order means nothing for deterministic runs, so residuals stand against "
        "the factors instead"
    )


def spread(frame: pd.DataFrame) -> str:
    """Say how far the largest and the smallest standard deviation are apart.

    Parameters
    ----------
    frame : DataFrame
        By :func:`study.reporting.figure.residuals.diagnostics.spread_of_cells`.
    """
    low, high = float(frame["sd"].min()), float(frame["sd"].max())
    apart = float(frame["low"].max()) > float(frame["high"].min())
    ratio = f"{significant(high / low)} times" if low > 0 else "far above"
    return sentence(
        f"the largest standard deviation is {ratio} the smallest, and the intervals "
        f"{'do not all overlap' if apart else 'all overlap'}"
    )


def front(frame: pd.DataFrame, facts: Facts, limit: float) -> str:
    """Say how cheap a cell within the practical difference is.

    Parameters
    ----------
    frame : DataFrame
        By :func:`study.reporting.content.recommendation.cost_front`; not empty.
    facts : Facts
        For the unit of a difference.
    limit : float
        Smallest difference that matters, in that unit.
    """
    near = frame[frame["within"]]
    dear = float(frame["seconds"].max())
    cheap = float(near["seconds"].min())
    lie = "lies" if len(near) == 1 else "lie"
    return sentence(
        f"{count(len(near), 'cell')} of {len(frame)} {lie} within {limit:.3g}{THIN}"
        f"{facts.difference_unit} of the best; the cheapest of them takes {duration(cheap)} a "
        f"case, the dearest cell of all {duration(dear)}"
    )


def curves(found: CurvePanels, data: ReportData) -> str:
    """Say what is drawn, what is held fixed, and how large the residuals are.

    Parameters
    ----------
    found : CurvePanels
        With one prediction at least.
    data : ReportData
        For the shown names of factors.
    """
    gap = (found.frame["predicted_N"] - found.frame["measured_N"]).abs()
    worst = found.frame.iloc[int(np.nanargmax(gap.to_numpy()))]
    held = listing([f"{name_of(k, data.labels)} = {clean(v)}" for k, v in found.fixed.items()])
    text = (
        f"force above, predicted minus measured below, over the whole of each measurement; the "
        f"largest residual is {quantity(float(gap.max()), 'N')} ({clean(worst['line'])}, "
        f"{clean(worst['block'])})"
    )
    if found.is_relative:
        text += (
            ". Forces differ too much for one axis in N: each panel is in percent of its largest "
            "measured force, so that residuals can be compared"
        )
    if found.frame["predicted_N"].isna().any():
        text += ". A line that ends early belongs to a simulation that stopped there"
    if held:
        text += f". Shown with {held}"
    if found.left_out:
        text += f"; {count(found.left_out, 'more block')} not shown"
    return sentence(text)


def contrasts(frame: pd.DataFrame, facts: Facts) -> str:
    """Say which contrasts stand out, and what the limits are.

    Parameters
    ----------
    frame : DataFrame
        By :func:`study.reporting.figure.residuals.contrast.contrasts`.
    facts : Facts
        For the unit; contrasts of a log response are log ratios.
    """
    beyond = frame[frame["active"]]
    m = count(len(frame), "contrast")
    if beyond.empty:
        said = f"none of the {m} exceeds the margin of error"
    else:
        named = [
            f"{name} ({p_phrase(p)})" for name, p in zip(beyond["name"], beyond["p"], strict=True)
        ]
        shown = named if len(named) <= 5 else [*named[:5], f"{len(named) - 5} more"]
        said = f"beyond the margin of error, of {m}: {listing(shown)}"
    unit = "log ratio" if facts.ratio else facts.difference_unit
    one = quantity(float(frame["margin"].iloc[0]), unit)
    every = quantity(float(frame["simultaneous"].iloc[0]), unit)
    return sentence(
        f"{said}. Dashed: limit of one contrast, {one}; dotted: of all together, {every} (Lenth, "
        "simulated); contrasts that follow the shaded envelope look like no effect at all"
    )


def constants(frame: pd.DataFrame, data: ReportData) -> str:
    """Compare the scatter between fits with the uncertainty of one fit.

    Parameters
    ----------
    frame : DataFrame
        By :func:`study.reporting.figure.constants.constant_points`.
    data : ReportData
        For what a block is called.
    """
    sure = frame[frame["identifiable"]]
    vague = len(frame) - len(sure)
    unit = clean(data.block) or "run"
    text = f"each mark is one fit with its 95{THIN}% interval"
    grouped = sure.groupby(["constant", "place"])["value"]
    apart = (grouped.std() / grouped.mean().abs()).median()
    own = (sure["standard_error"] / sure["value"].abs()).median()
    if apart == apart and own == own:  # both are numbers
        text = (
            f"a constant differs between {plural_of(unit)} by {_by(float(apart))} (median "
            f"standard deviation), one fit alone is uncertain by {_by(float(own))}; {text}"
        )
    if vague:
        text += f"; hollow: {vague} of {len(frame)} that the data do not determine"
    return sentence(text)


def _by(fraction: float) -> str:
    return share(fraction).replace("< ", "less than ")
