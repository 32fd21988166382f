"""The verb tracking: accuracy of a tracker."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from study.api.folders import data_root
from study.design.load import default_name
from study.reporting.accuracy.page import tracker_page, write_accuracy
from study.reporting.figure.registry import slug
from study.tracker_accuracy.result import TrackerAccuracy, judge_tracker
from study.tracker_accuracy.section import load_tracking


def tracking(
    source: str | Path, *, data: str | Path | None = None, reports: str | Path | None = None
) -> TrackerAccuracy:
    """Judge a tracker: fixed distances, commanded displacements, a better instrument.

    Parameters
    ----------
    source : str or Path
        TOML file with ``[recording]`` and at least one of ``[distance]``, ``[displacement]``
        and ``[reference]``.
    data : str or Path, optional
        Folder that measured files are relative to; by default ``measurements`` beside the
        folder of the file, or that folder.
    reports : Path, optional
        Where the page is written; nothing is written without.

    Returns
    -------
    TrackerAccuracy
        What was found; ``to_json()`` gives plain values.

    Raises
    ------
    InputError
        For a faulty file or faulty data, with everything that is wrong.
    """
    declared = load_tracking(source)
    found = judge_tracker(declared, data_root(source, data), default_name(str(source)))
    if reports is None:
        return found
    page = write_accuracy(tracker_page(found), Path(reports) / slug(found.name))
    return replace(found, report=str(page))
