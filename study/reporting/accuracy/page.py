"""Pages of accuracy: a tracker against its references, a surface against a scan."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from study.reporting.accuracy import scan as scan_content
from study.reporting.accuracy import scan_figure, tracker_figure
from study.reporting.accuracy import tracker as tracker_content
from study.reporting.content.table import Table
from study.reporting.figure.registry import Drawn, Figure, make, slug
from study.reporting.output import write
from study.reporting.output.files import data_folder, replace_file
from study.reporting.output.page import _environment
from study.reporting.text import clean
from study.shape_validation.deviation import ShapeDeviation
from study.tracker_accuracy.displacement import DisplacementResult
from study.tracker_accuracy.distance import DistanceResult
from study.tracker_accuracy.reference import ReferenceResult
from study.tracker_accuracy.result import TrackerAccuracy

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class AccuracyPage:
    """A page before it is drawn.

    Parameters
    ----------
    kicker, name, question : str
        Kind of the page, its title, what was asked.
    answer : sequence of str
        Sentences.
    figures : sequence of Figure
    tables : sequence of Table
    warnings : sequence of str
    document : mapping
        What ``--json`` prints; written beside the page.
    """

    kicker: str
    name: str
    question: str
    answer: Sequence[str]
    figures: Sequence[Figure]
    tables: Sequence[Table]
    warnings: Sequence[str]
    document: Mapping[str, object]


def write_accuracy(page: AccuracyPage, out_dir: str | Path) -> Path:
    """Write a page, with the data of its figures and tables beside it.

    Parameters
    ----------
    page : AccuracyPage
        What it says.
    out_dir : str or Path
        Folder; made where missing.

    Returns
    -------
    Path
        The HTML file.
    """
    folder, stem = Path(out_dir), f"{slug(page.name)}-{slug(page.kicker)}"
    beside = data_folder(folder, stem)
    for figure in page.figures:
        if figure.data is not None:
            replace_file(beside / f"figure-{figure.name}.csv", write.of_frame(figure.data))
    for table in page.tables:
        replace_file(beside / f"table-{slug(table.name)}.csv", write.of_records(table.raw))
    numbers = json.dumps(page.document, indent=1, allow_nan=False)
    replace_file(beside / "numbers.json", numbers + "\n")
    text = _environment().get_template("accuracy.html.j2").render(
        kicker=page.kicker, name=clean(page.name), question=clean(page.question),
        answer=page.answer, figures=page.figures, tables=page.tables,
        warnings=[clean(line) for line in page.warnings],
    )  # fmt: skip
    replace_file(folder / f"{stem}.html", clean(text))
    return folder / f"{stem}.html"


def tracker_page(found: TrackerAccuracy) -> AccuracyPage:
    """Page of a tracker.

    Parameters
    ----------
    found : TrackerAccuracy
        Lengths in mm. Of distance, displacement and reference, each that is not None has a figure.

    Returns
    -------
    AccuracyPage
        With drawn figures; a figure that cannot be drawn says why.
    """
    figures = []
    if (distance := found.distance) is not None:
        figures.append(make("tracker-distance", "Distance by stage", lambda: _distance(distance)))
    if (displacement := found.displacement) is not None:
        figures.append(
            make(
                "tracker-displacement",
                "Measured and commanded displacement",
                lambda: _displacement(displacement),
            )
        )
    if (reference := found.reference) is not None:
        figures.append(
            make("tracker-reference", "Errors against the reference", lambda: _poses(reference))
        )
    return AccuracyPage(
        kicker="Tracker accuracy",
        name=found.name,
        question=found.question,
        answer=tracker_content.answers(found),
        figures=figures,
        tables=tracker_content.tables(found),
        warnings=found.notes,
        document=found.to_json(),
    )


def _distance(found: DistanceResult) -> Drawn:
    frame = tracker_figure.distance_points(found)
    dashed = " Dashed: the standard." if found.standard else ""
    caption = f"Histograms of all samples, a panel a stage. Line: mean over visits.{dashed}"
    return frame, lambda: tracker_figure.draw_distances(frame, found), caption


def _displacement(found: DisplacementResult) -> Drawn:
    frame = tracker_figure.displacement_points(found)
    caption = (
        "Left: every stop and the line with errors in both. Right: differences against means, "
        "bias and limits of agreement (dashed) with their intervals."
    )
    return frame, lambda: tracker_figure.draw_displacement(frame, found), caption


def _poses(found: ReferenceResult) -> Drawn:
    frame = tracker_figure.reference_points(found)
    caption = (
        "Left: residuals of the registration over the workspace. Right: what is left at every "
        "pose, and the error of a pose predicted from all others."
    )
    return frame, lambda: tracker_figure.draw_reference(frame, found), caption


def shape_page(found: ShapeDeviation) -> AccuracyPage:
    """Page of a scanned surface.

    Parameters
    ----------
    found : ShapeDeviation
        Lengths in mm; distances are positive where the scan lies outside the simulated surface.

    Returns
    -------
    AccuracyPage
        With drawn figures; a figure that cannot be drawn says why.
    """
    frame = scan_figure.deviation_points(found)
    return AccuracyPage(
        kicker="Shape deviation",
        name=found.name,
        question=f"How far is the simulated surface from {found.scan}?",
        answer=scan_content.answers(found),
        figures=[
            make("shape-histogram", "Deviations", lambda: _histogram(frame)),
            make("shape-views", "Deviation over the body", lambda: _views(frame)),
        ],
        tables=scan_content.tables(found),
        warnings=(f"simulated part: {found.symmetry}", *found.notes),
        document=found.to_json(),
    )


def _histogram(frame: pd.DataFrame) -> Drawn:
    caption = "Signed distances of scanned points. Line: mean; dashed: 5 % and 95 %."
    return frame, lambda: scan_figure.draw_histogram(frame), caption


def _views(frame: pd.DataFrame) -> Drawn:
    caption = "Mean deviation of the points in every hexagon that face the viewer."
    return frame, lambda: scan_figure.draw_views(frame), caption
