"""The figures of a report: each drawn with its data, its caption and its failure.

A figure that cannot be drawn never stops the report: the page says which one is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from study.reporting.content import sentences
from study.reporting.content.blocks import Figure
from study.reporting.content.effect_words import normality_phrase, size
from study.reporting.content.report_facts import Facts, block_name, practical_of
from study.reporting.content.report_facts import cells as report_cells
from study.reporting.content.sentences import cost_front
from study.reporting.content.tables import in_order
from study.reporting.content.text import (
    THIN,
    clean,
    count,
    duration,
    level,
    listing,
    name_of,
    p_phrase,
    plural_of,
    quantity,
    sentence,
    share,
    significant,
    slugs,
    term_name,
    trimmed,
)
from study.reporting.figures import (
    convergence_figures,
    curve_figures,
    effect_figures,
    residual_figures,
    study_figures,
)
from study.reporting.figures.axes import Plot, figures_of, make
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.simple_effects import MATTERS, NO_DIFFERENCE

if TYPE_CHECKING:
    from study.reporting.figures.curve_figures import CurvePanels


# Captions: each states what its figure shows, with numbers.


def means(facts: Facts, data: ReportData) -> str:
    """Say which share of the variation between cells each factor has."""
    shares = [
        (row.share, term_name(row.term, data.labels))
        for row in facts.rows
        if row.term in data.factors and row.share is not None and row.df
    ]
    text = listing([f"{name} {share(part)}" for part, name in sorted(shares, reverse=True)])
    has_ends = any(effect.mean_ci95 for effect in facts.effects)
    ends = f" with {level(facts.alpha)} intervals" if has_ends else ""
    parts = [f"level means{ends} on one shared axis"]
    if shares:
        parts.append(f"share of the total variation: {text}")
    if facts.has_size:
        parts.append("two means inside the shaded band differ by less than what matters")
    return sentence("; ".join(parts))


def interactions(facts: Facts, data: ReportData) -> str:
    """Say which interaction is the largest."""
    estimated = [e for e in facts.interactions if e.term.count(":") == 1 and e.range is not None]
    key = "lines that are parallel mean that the factors act independently"
    if not estimated:
        return sentence(key)
    first = max(estimated, key=lambda e: abs((e.range or 0) - (1 if e.is_ratio else 0)))
    row = facts.row(first.term)
    decided = None if row is None else row.p_deciding
    p = "" if decided is None else f", {p_phrase(decided)}"
    return sentence(
        f"the largest two-factor interaction is {term_name(first.term, data.labels)}, "
        f"{size(first, facts)}{p}; {key}"
    )


def cells(facts: Facts, data: ReportData, frame: pd.DataFrame) -> str:
    """Say what the points are, and how far the cells and the blocks differ."""
    shown = frame.drop_duplicates("rank")
    means_of = shown["cell_mean"]
    unit = clean(data.block) or "run"
    low, high = significant(float(means_of.min())), quantity(float(means_of.max()), facts.unit)
    kind = "geometric cell means" if facts.ratio else "cell means"
    text = f"{kind} (diamonds) run from {low} to {high}; each dot is one {unit}"
    if "block" in frame and frame["block"].notna().any():
        spread = frame.groupby("block")["value"].mean()
        text += (
            f", joined across cells by a thin line; {unit} means run from "
            f"{significant(float(spread.min()))} to {quantity(float(spread.max()), facts.unit)}"
        )
    return sentence(text)


def residuals(facts: Facts, data: ReportData, n: int) -> str:
    """Summarize the four panels and the test."""
    return sentence(
        f"{count(n, 'residual')} of block and cell, one cell for each distinct computation; "
        f"{normality_phrase(facts, data.alpha)}. Run order means nothing for deterministic runs, "
        "so residuals stand against the factors instead"
    )


def spread(frame: pd.DataFrame) -> str:
    """Say how far the largest and the smallest standard deviation are apart."""
    low, high = float(frame["sd"].min()), float(frame["sd"].max())
    apart = float(frame["low"].max()) > float(frame["high"].min())
    ratio = f"{significant(high / low)} times" if low > 0 else "far above"
    most = residual_figures.MOST_SPREAD
    drawn = f"; the {most} largest of {len(frame)} are drawn" if len(frame) > most else ""
    return sentence(
        f"the largest standard deviation is {ratio} the smallest, and the intervals "
        f"{'do not all overlap' if apart else 'all overlap'}{drawn}"
    )


def front(frame: pd.DataFrame, facts: Facts, limit: float) -> str:
    """Say how cheap a cell within the practical difference is."""
    near = frame[frame["within"]]
    dear = float(frame["seconds"].max())
    cheap = float(near["seconds"].min())
    lie = "lies" if len(near) == 1 else "lie"
    return sentence(
        f"{count(len(near), 'cell')} of {len(frame)} {lie} within {trimmed(limit)}{THIN}"
        f"{facts.difference_unit} of the best; the cheapest of them takes {duration(cheap)} a "
        f"case, the dearest cell of all {duration(dear)}"
    )


def curves(panels: CurvePanels, data: ReportData) -> str:
    """Say what is drawn, what is held fixed, and how large the residuals are."""
    gap = (panels.frame["predicted_N"] - panels.frame["measured_N"]).abs()
    worst = panels.frame.iloc[int(np.nanargmax(gap.to_numpy()))]
    held = listing([f"{name_of(k, data.labels)} = {clean(v)}" for k, v in panels.fixed.items()])
    text = (
        "force above, predicted minus measured below; the largest residual is "
        f"{quantity(float(gap.max()), 'N')} ({clean(worst['line'])}, "
        f"{block_name(str(worst['block']), data)})"
    )
    if panels.is_relative:
        text += (
            ". Each panel is in percent of its largest measured force, since forces differ too "
            "much for one axis in N"
        )
    if panels.frame["predicted_N"].isna().any():
        text += ". A line that ends early belongs to a simulation that stopped there"
    if held:
        text += f". Shown with {held}"
    if panels.left_out:
        unit = clean(data.block) or "block"
        text += f"; {count(panels.left_out, f'more {unit}')} not shown"
    return sentence(text)


def contrasts(frame: pd.DataFrame, facts: Facts) -> str:
    """Say which contrasts stand out, and what the limits are."""
    beyond = frame[frame["active"]]
    m = count(len(frame), "contrast")
    if beyond.empty:
        finding = f"none of the {m} exceeds the margin of error"
    else:
        named = [
            f"{name} ({p_phrase(p)})" for name, p in zip(beyond["name"], beyond["p"], strict=True)
        ]
        shown = named if len(named) <= 5 else [*named[:5], f"{len(named) - 5} more"]
        finding = f"beyond the margin of error, of {m}: {listing(shown)}"
    margin = quantity(float(frame["margin"].iloc[0]), facts.scale)
    every = quantity(float(frame["simultaneous"].iloc[0]), facts.scale)
    return sentence(
        f"{finding}. Dashed: limit of one contrast, {margin}; dotted: of all together, {every} "
        "(Lenth, simulated); contrasts that follow the shaded envelope look like no effect at all"
    )


def constants(frame: pd.DataFrame, data: ReportData) -> str:
    """Compare the scatter between fits with the uncertainty of one fit."""
    sure = frame[frame["identifiable"]]
    vague = len(frame) - len(sure)
    unit = clean(data.block) or "run"
    text = f"each mark is one fit with its 95{THIN}% interval"
    grouped = sure.groupby(["constant", "place"])["value"]
    apart = (grouped.std() / grouped.mean().abs()).median()
    relative_error = (sure["standard_error"] / sure["value"].abs()).median()
    if apart == apart and relative_error == relative_error:  # both are numbers
        text = (
            f"a constant differs between {plural_of(unit)} by {_by(float(apart))} (median "
            f"standard deviation), one fit alone is uncertain by {_by(float(relative_error))}; "
            f"{text}"
        )
    if vague:
        text += f"; hollow: {vague} of {len(frame)} that the data do not determine"
    return sentence(text)


def _by(fraction: float) -> str:
    return share(fraction).replace("< ", "less than ")


def of_response(data: ReportData, facts: Facts, without: Collection[str] = ()) -> dict[str, Figure]:
    """Figures of one response by kind, but those ``without``; none where it was not analyzed."""
    if (result := facts.result) is None or not facts.terms:
        return {}
    facts = replace(facts, title=clean(facts.title, 60), unit=clean(facts.unit, 16))
    plots: dict[str, Plot] = {
        "means": (
            "Main effects",
            lambda: effect_figures.level_means(facts),
            lambda frame: effect_figures.draw_level_means(frame, facts, data),
            lambda _: means(facts, data),
        ),
        "interactions": (
            "Interactions",
            lambda: effect_figures.pair_means(data, facts),
            lambda frame: effect_figures.draw_interactions(frame, facts, data),
            lambda _: interactions(facts, data),
        ),
        "cells": (
            "Cells",
            lambda: effect_figures.cell_points(data, facts),
            lambda frame: effect_figures.draw_cells(
                frame, facts, practical_of(facts, report_cells(data, facts.name))
            ),
            lambda frame: cells(facts, data, frame),
        ),
        "residuals": (
            "Residuals",
            lambda: residual_figures.diagnostic_residual_points(facts),
            lambda frame: residual_figures.draw_residuals(frame, facts, data),
            lambda frame: residuals(facts, data, len(frame)),
        ),
        "spread": (
            "Spread of the cells",
            lambda: residual_figures.spread_of_cells(facts, data.alpha),
            lambda frame: residual_figures.draw_spread(frame, facts),
            spread,
        ),
        "contrasts": (
            "Contrasts without replicates",
            lambda: residual_figures.contrasts(facts, data),
            lambda frame: residual_figures.draw_contrasts(frame, facts),
            lambda frame: contrasts(frame, facts),
        ),
        "depth": (
            "Effects against depth",
            lambda: study_figures.points(data.depths, facts.name, data),
            lambda frame: study_figures.draw(frame, facts),
            lambda frame: study_figures.caption(frame, facts),
        ),
        "front": (
            "Cost against accuracy",
            lambda: cost_front(data, facts),
            lambda frame: study_figures.draw_front(frame, facts, data, practical_of(facts, frame)),
            lambda frame: front(frame, facts, practical_of(facts, frame)),
        ),
    }
    # nothing is left over by a saturated model
    is_saturated = "residual" not in result.residuals
    timed = "seconds" in data.table and bool(data.table["seconds"].notna().any())
    has = {
        # the sentences say that nothing could be estimated
        "means": any(effect.range is not None for effect in facts.terms),
        "interactions": len(data.factors) > 1,
        "residuals": not is_saturated,
        "spread": not is_saturated,
        "contrasts": result.lenth is not None,
        "depth": any(row.response == facts.name for row in data.depths),
        "front": bool(facts.better) and timed,
    }
    chosen = {k: plot for k, plot in plots.items() if has.get(k, True) and k not in without}
    stem = slugs(response.name for response in data.analyses)[facts.name]
    return figures_of(chosen, stem, facts.title)


def overview(data: ReportData, all_facts: Sequence[Facts]) -> Figure | None:
    """Figure of the first page: every effect against what matters; None without an effect."""
    analyzed = [facts for facts in all_facts if facts.terms]
    limited = [facts for facts in analyzed if facts.has_size]
    # without a limit there is no common scale: the first response stands for itself
    shown = limited or analyzed[:1]
    if not any(effect.range is not None for facts in shown for effect in facts.terms):
        return None
    plot: Plot = (
        "Every effect against what matters" if limited else "Every effect",
        lambda: effect_figures.against_limits(shown, data.labels),
        lambda frame: effect_figures.draw_against_limits(frame, shown),
        lambda frame: _against_limits(frame, analyzed, shown),
    )
    return make("overview", plot)


def _against_limits(frame: pd.DataFrame, analyzed: Sequence[Facts], shown: Sequence[Facts]) -> str:
    """Count the effects on either side of what matters, and say what the marks are."""
    if frame["limited"].all():
        verdicts = frame.loc[frame["verdict"] != "", "verdict"].tolist()
        large, small = verdicts.count(MATTERS), verdicts.count(NO_DIFFERENCE)
        rest = len(verdicts) - large - small
        parts = [
            f"{number} of {count(len(verdicts), 'effect')} {words}"
            for number, words in (
                (large, f"matter{'s' * (large == 1)} (orange circle)"),
                (small, f"{'is' if small == 1 else 'are'} too small to matter (green square)"),
                (rest, "cannot be judged with these data (hollow)"),
            )
            if number
        ]
    else:
        parts = ["no smallest difference that matters was given, so no effect has a verdict"]
    if (frame["bound"] > 0).any():
        parts.append("thin ends: mesh error")
    left = [facts.title for facts in analyzed if facts not in shown]
    if left:
        parts.append(f"not drawn, on the second page: {listing(left)}")
    return sentence("; ".join(parts))


def of_study(data: ReportData) -> dict[str, Figure]:
    """Figures that belong to no single response."""
    plots: dict[str, Plot] = {}
    if data.curves:
        every = curve_figures.curve_panels(data)
        plots["curves"] = _curves("Measured and predicted force", every, data)
        if len(every.panels) > curve_figures.MOST_COLUMNS:
            few = curve_figures.curve_panels(data, curve_figures.MOST_COLUMNS)
            plots["few-curves"] = _curves("Measured and predicted force, a part", few, data)
    if any(fit.value is not None for fit in data.fits):
        plots["constants"] = (
            "Fitted constants",
            lambda: study_figures.constant_points(data),
            study_figures.draw_constants,
            lambda frame: constants(frame, data),
        )
    marked = (document for case in data.markers for document in case.markers)
    if any(fit["error_by_layer_mm"] for document in marked for fit in document["fits"]):
        plots["markers"] = (
            "Errors by layer",
            lambda: curve_figures.layer_points(data),
            curve_figures.draw_layers,
            curve_figures.caption,
        )
    if data.convergence:
        plots["convergence"] = (
            "Value against mesh size",
            lambda: convergence_figures.value_points(data.convergence),
            convergence_figures.draw_values,
            lambda _: convergence_figures.value_caption(data.convergence),
        )
    if data.validation:
        # the first block stands for the others
        rows = [row for row in data.validation if row["block"] == data.validation[0]["block"]]
        plots["validation"] = (
            "Comparison error along the curve",
            lambda: convergence_figures.validation_error_points(rows),
            convergence_figures.draw_validation_errors,
            lambda _: convergence_figures.caption(rows),
        )
    if data.failures:
        plots["failures"] = (
            "Failure map",
            lambda: _failed_cases(data),
            study_figures.draw_failures,
            lambda _: _failures(data),
        )
    return {name: make(name, plot) for name, plot in plots.items()}


def _curves(title: str, panels: CurvePanels, data: ReportData) -> Plot:
    return (
        title,
        lambda: panels.frame,
        lambda _: curve_figures.draw_curves(panels, data),
        lambda _: curves(panels, data),
    )


def of_recordings(frame: pd.DataFrame) -> Figure:
    """Figure of the rows of a calibration as they were recorded, with their branches."""
    aside = frame[frame["set_aside"] != ""]
    why = [f"{n} {reason}" for reason, n in aside.groupby("set_aside", sort=False).size().items()]
    caption = f"{len(frame)} recorded rows, {len(frame) - len(aside)} used"
    caption += f"; set aside: {listing(why)}" if why else ""
    plot: Plot = (
        "Recording and its branches",
        lambda: frame,
        curve_figures.draw_recordings,
        lambda _: sentence(caption),
    )
    return make("recording", plot)


def _failed_cases(data: ReportData) -> pd.DataFrame:
    """Cell, block and status of every case, in the order of the design."""
    factors, table = list(data.factors), in_order(data)
    frame = table[[*factors, "status"]].astype(str)
    block = table["block"].astype(str) if "block" in table else "all"
    return frame.assign(block=block, cell=frame[factors].agg(" \N{MIDDLE DOT} ".join, axis=1))


def _failures(data: ReportData) -> str:
    """Count the failed cases, and say what rows and columns of the map are."""
    failed = sentences.failures(data.failures, len(data.table)).split(". ")[0]
    named = ", ".join(name_of(name, data.labels) for name in data.factors)
    return f"{failed}: large marks; rows are cells ({named}), columns are blocks."
