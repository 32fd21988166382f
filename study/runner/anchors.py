"""Predictions of one cell for several specimens: a cold solution serves them all.

The specimens of a cell differ in their constants alone. The first specimen's problem is
solved cold, with gradients; every other one starts from its load steps, moved along their
sensitivities, and needs a few iterations where a cold start needs dozens. The anchor is a
function of the cell and not of what was computed before, so that a resumed study gives
the same digits.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from study.runner import build, fits
from study.runner.compiled import load_compiled

Config = Mapping[str, Any]


@dataclass(frozen=True)
class Prediction:
    """A forward solution and what it would have cost alone, in seconds."""

    solution: Any
    cold_seconds: float


class Anchors:
    """The anchor of the cell that this worker is busy with; one at a time is kept."""

    def __init__(self) -> None:
        self._group = ""
        self._solution: Any = None
        self._seconds = 0.0

    def predict(
        self,
        config: Config,
        constants: Mapping[str, float] | None,
        depth_mm: float,
        anchor: Mapping[str, Any] | None,
    ) -> Prediction:
        """Solve for one specimen, from the anchor of its cell where there is one.

        Parameters
        ----------
        constants : mapping or None
            MPa; None where the configuration gives them.
        anchor : mapping or None
            ``group``, the name of the cell, and ``constants`` of its first specimen.
        """
        if anchor is None:
            return _cold(config, constants, depth_mm, gradients=False)
        self._prepare(config, depth_mm, anchor)
        if self._solution is None:
            return _cold(config, constants, depth_mm, gradients=False)
        if constants == anchor["constants"]:
            return Prediction(self._solution, self._seconds)
        problem = build.problem(config, constants, depth_mm)
        found = fits.solve(problem, gradients=False, warm=self._solution)
        if found.status != "converged":
            return _cold(config, constants, depth_mm, gradients=False)
        return Prediction(found, self._seconds)

    def _prepare(self, config: Config, depth_mm: float, anchor: Mapping[str, Any]) -> None:
        if anchor["group"] == self._group:
            return
        self._solution = None  # its memory goes before the next one comes
        made = _cold(config, anchor["constants"], depth_mm, gradients=True)
        self._group, self._seconds = anchor["group"], made.cold_seconds
        self._solution = made.solution if made.solution.status == "converged" else None


def _cold(
    config: Config, constants: Mapping[str, float] | None, depth_mm: float, *, gradients: bool
) -> Prediction:
    problem = build.problem(config, constants, depth_mm)
    load_compiled(problem)
    began = time.perf_counter()
    solution = fits.solve(problem, gradients=gradients)
    return Prediction(solution, time.perf_counter() - began)
