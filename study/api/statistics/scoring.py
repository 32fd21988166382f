"""What a response was scored on: the curve that was fitted, or one that the fit never saw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.design.study_file import SCORED
from study.runner.calibration.cross_validation import held_out
from study.study_result.report_data import FITTED_CURVE, OTHER_SPECIMEN, OTHER_TEST

if TYPE_CHECKING:
    from study.design.spec import Design

#: words in the name of a column that tell specimens apart
_SPECIMENS = ("specimen", "sample", "phantom", "subject", "animal", "donor", "batch")


def scored_on(design: Design, response: str, blocks: int) -> str:
    """Say what a response was scored on.

    Parameters
    ----------
    design : Design
        Says which curves are fitted, scored and left out.
    response : str
        Name of a response.
    blocks : int
        Number of specimens (or batches) of the study.

    Returns
    -------
    str
        ``"the curve fitted"``, ``"same specimen, other test"`` or ``"other specimen"``; empty
        for a response that is no score, or without a calibration.
    """
    fitted, measured = design.calibration, design.measurements
    if response not in SCORED or measured is None or fitted.method == "none":
        return ""
    kind = _held_out(design, blocks)
    if kind is not None:
        return OTHER_SPECIMEN if kind == "specimen" else OTHER_TEST
    if fitted.problem is not None:
        return OTHER_TEST
    fit, score = dict(measured.fit or {}), dict(measured.score or measured.fit or {})
    if fit == score:
        return FITTED_CURVE
    changed = [name for name in {**fit, **score} if fit.get(name) != score.get(name)]
    apart = any(word in name.lower() for name in changed for word in _SPECIMENS)
    return OTHER_SPECIMEN if apart else OTHER_TEST


def cross_validated(design: Design, response: str, blocks: int) -> bool:
    """Whether each specimen is predicted by constants that were fitted to all others.

    Parameters
    ----------
    design, response, blocks : Design, str, int
        As for :func:`scored_on`.
    """
    scored = scored_on(design, response, blocks)
    return bool(scored) and _held_out(design, blocks) == "specimen"


def _held_out(design: Design, blocks: int) -> str | None:
    fitted, measured = design.calibration, design.measurements
    if measured is None:
        return None
    other = fitted.problem is not None
    return held_out(fitted.leave_out, measured.fit, measured.score, blocks, other_test=other)
