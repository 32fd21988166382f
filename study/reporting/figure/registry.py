"""The figures of a report: each drawn with its data, its caption and its failure.

A figure that cannot be drawn never stops the report: the page says which one is missing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from study.reporting.content import sentences
from study.reporting.content.recommendation import cost_front
from study.reporting.figure import (
    captions,
    constants,
    convergence,
    cost,
    depth,
    style,
    validation,
)
from study.reporting.figure.curves import marker_layers, plot, samples
from study.reporting.figure.effects import cells as cell_means
from study.reporting.figure.effects import interactions, level, sizes
from study.reporting.figure.residuals import contrast, diagnostics
from study.reporting.report import Facts, cells, practical_of
from study.reporting.text import clean, name_of
from study.study_result.report_data import ReportData

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure as Canvas


@dataclass(frozen=True)
class Figure:
    """A finished figure: ``svg`` is markup, all else plain text; ``missing`` says why not."""

    name: str
    title: str
    caption: str = ""
    svg: str = ""
    data: pd.DataFrame | None = None
    missing: str = ""


Drawn = tuple["pd.DataFrame", "Callable[[], Canvas]", str]


def make(name: str, title: str, compute: Callable[[], Drawn]) -> Figure:
    """Compute and draw one figure; any failure becomes its ``missing``.

    Parameters
    ----------
    name : str
        Prefix of the ids in the drawing, and part of the names of its files.
    title : str
        Heading, and accessible name of the drawing.
    compute : callable
        Returns the data, a function that draws them, and the caption.
    """
    frame: pd.DataFrame | None = None
    try:
        frame, draw, caption = compute()
        svg = style.render(draw, name, title)
    except Exception as error:  # the numbers must reach the reader whatever the drawing does
        why = f"{type(error).__name__}: {error}"
        return Figure(name, title, data=frame, missing=why[:300])
    return Figure(name, title, caption, svg, frame)


def of_response(data: ReportData, facts: Facts, without: Collection[str] = ()) -> dict[str, Figure]:
    """Figures of one response by kind, but those ``without``; none where it was not analyzed.

    Parameters
    ----------
    data : ReportData
        Its factors, rows and depths.
    facts : Facts
        The response; its title and unit are shortened in the figures.
    without : collection of str
        Kinds that are not drawn, for example ``"cells"``.

    Returns
    -------
    dict of str to Figure
        ``effects``, ``means``, ``interactions``, ``cells``, ``residuals``, ``spread``,
        ``contrasts``, ``depth``, ``front``: those that the response has data for.
    """
    if not facts.terms:
        return {}
    facts = replace(facts, title=clean(facts.title, 60), unit=clean(facts.unit, 16))
    stem = slug(facts.name)
    makers: dict[str, tuple[str, Callable[[], Drawn]]] = {
        "effects": ("Effects against what matters", lambda: _effects(data, facts)),
        "means": ("Main effects", lambda: _means(data, facts)),
        "interactions": ("Interactions", lambda: _interactions(data, facts)),
        "cells": ("Cells", lambda: _cells(data, facts)),
        "residuals": ("Residuals", lambda: _residuals(data, facts)),
        "spread": ("Spread of the cells", lambda: _spread(data, facts)),
    }
    if not any(effect.range is not None for effect in facts.terms):
        # the sentences say that nothing could be estimated
        del makers["effects"], makers["means"]
    if facts.residuals is None or "residual" not in facts.residuals:
        # nothing is left over by a saturated model
        del makers["residuals"], makers["spread"]
    if facts.lenth:
        title = "Contrasts without replicates"
        makers["contrasts"] = (title, lambda: _contrasts(data, facts))
    if len(data.factors) < 2:
        del makers["interactions"]
    if any(row.response == facts.name for row in data.depths):
        makers["depth"] = ("Effects against depth", lambda: _depth(data, facts))
    if facts.response.better and "seconds" in data.table:
        makers["front"] = ("Cost against accuracy", lambda: _front(data, facts))
    return {
        kind: make(f"{stem}-{kind}", f"{title}: {facts.title}", maker)
        for kind, (title, maker) in makers.items()
        if kind not in without
    }


def of_study(data: ReportData) -> dict[str, Figure]:
    """Figures that belong to no single response.

    Parameters
    ----------
    data : ReportData
        Its curves, fits, markers, series of meshes, comparisons and failures are drawn.

    Returns
    -------
    dict of str to Figure
        ``curves``, ``constants``, ``markers``, ``convergence``, ``validation``, ``failures``: those
        that the study has data for.
    """
    found: dict[str, Figure] = {}
    if data.curves:
        found["curves"] = make("curves", "Measured and predicted force", lambda: _curves(data))
    if any(fit.value is not None for fit in data.fits):
        found["constants"] = make("constants", "Fitted constants", lambda: _constants(data))
    if any(fit["error_by_layer_mm"] for one in data.markers for fit in one.fits):
        found["markers"] = make("markers", "Errors by layer", lambda: _markers(data))
    if data.convergence:
        found["convergence"] = make(
            "convergence", "Value against mesh size", lambda: _convergence(data)
        )
    if data.validation:
        found["validation"] = make(
            "validation", "Comparison error along the curve", lambda: _validation(data)
        )
    if data.failures:
        found["failures"] = make("failures", "Failure map", lambda: _failures(data))
    return found


def _convergence(data: ReportData) -> Drawn:
    frame = convergence.value_points(data.convergence)
    caption = convergence.value_caption(data.convergence)
    return frame, lambda: convergence.draw_values(frame), caption


def _markers(data: ReportData) -> Drawn:
    frame = marker_layers.layer_points(data)
    return frame, lambda: marker_layers.draw_layers(frame), marker_layers.caption(frame)


def _validation(data: ReportData) -> Drawn:
    rows = validation.first_block(data.validation)
    frame = validation.error_points(rows)
    return frame, lambda: validation.draw_errors(frame), validation.caption(rows)


def slug(text: str) -> str:
    """File and id name made of letters, digits and hyphens alone.

    Parameters
    ----------
    text : str
        Name as a user wrote it.

    Returns
    -------
    str
        Of 48 characters at most; ``response`` where none is left.
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower())[:48].strip("-") or "response"


def _effects(data: ReportData, facts: Facts) -> Drawn:
    frame = sizes.effect_sizes(facts, data.labels)
    if frame.empty:
        raise ValueError("no effect could be estimated")
    return frame, lambda: sizes.draw_effect_sizes(frame, facts), captions.effects(facts, data)


def _depth(data: ReportData, facts: Facts) -> Drawn:
    frame = depth.points(data.depths, facts.name, data)
    return frame, lambda: depth.draw(frame, facts), depth.caption(frame, facts)


def _contrasts(data: ReportData, facts: Facts) -> Drawn:
    frame = contrast.contrasts(facts, data)
    return (
        frame,
        lambda: contrast.draw_contrasts(frame, facts),
        captions.contrasts(frame, facts),
    )


def _constants(data: ReportData) -> Drawn:
    frame = constants.constant_points(data)
    return frame, lambda: constants.draw_constants(frame), captions.constants(frame, data)


def _means(data: ReportData, facts: Facts) -> Drawn:
    frame, center = level.level_means(facts), level.grand_mean(data, facts)
    limit = next((e.practical for e in facts.effects if e.practical is not None), None)
    return (
        frame,
        lambda: level.draw_level_means(frame, facts, center, limit, data),
        captions.means(facts, data),
    )


def _interactions(data: ReportData, facts: Facts) -> Drawn:
    frame = interactions.pair_means(data, facts)
    return (
        frame,
        lambda: interactions.draw_interactions(frame, facts, data.factors, data),
        captions.interactions(facts, data),
    )


def _cells(data: ReportData, facts: Facts) -> Drawn:
    frame = cell_means.cell_points(data, facts)
    limit = practical_of(facts, cells(data, facts.name))
    return (
        frame,
        lambda: cell_means.draw_cells(frame, facts, limit),
        captions.cells(facts, data, frame),
    )


def _residuals(data: ReportData, facts: Facts) -> Drawn:
    frame = diagnostics.residual_points(facts)
    return (
        frame,
        lambda: diagnostics.draw_residuals(frame, facts, data),
        captions.residuals(facts, data, len(frame)),
    )


def _spread(data: ReportData, facts: Facts) -> Drawn:
    frame = diagnostics.spread_of_cells(facts, data.alpha)
    return frame, lambda: diagnostics.draw_spread(frame, facts), captions.spread(frame)


def _front(data: ReportData, facts: Facts) -> Drawn:
    frame = cost_front(data, facts)
    if frame.empty:
        raise ValueError("no computing times are known")
    limit = practical_of(facts, frame)
    return (
        frame,
        lambda: cost.draw_front(frame, facts, data, limit),
        captions.front(frame, facts, limit),
    )


def _curves(data: ReportData) -> Drawn:
    found = samples.curve_panels(data)
    return found.frame, lambda: plot.draw_curves(found, data), captions.curves(found, data)


def _failures(data: ReportData) -> Drawn:
    factors = list(data.factors)
    frame = data.table[[*factors, "status"]].astype(str)
    block = data.table["block"].astype(str) if "block" in data.table else "all"
    frame = frame.assign(block=block, cell=frame[factors].agg(" \N{MIDDLE DOT} ".join, axis=1))
    orders = {**{name: list(levels) for name, levels in data.factors.items()}}
    orders["block"] = list(data.blocks)
    frame = frame.sort_values(
        [*factors, "block"], key=lambda column: column.map(_place_in(orders[str(column.name)]))
    )
    statuses = ["converged", *sorted(set(frame["status"]) - {"converged"})]
    named = ", ".join(name_of(name, data.labels) for name in factors)
    return (
        frame,
        lambda: cost.draw_failures(frame, statuses),
        f"{sentences.failures(data.failures, len(data.table)).split('. ')[0]}: large marks; rows "
        f"are cells ({named}), columns are blocks.",
    )


def _place_in(order: list[str]) -> Callable[[str], int]:
    """Index of a label in its order; a label that is not listed comes last."""
    return lambda label: order.index(label) if label in order else len(order)
