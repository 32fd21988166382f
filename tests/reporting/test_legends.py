"""Legends of many levels leave the axes their room."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from study.reporting.figures.axes import render
from study.reporting.figures.study_figures import draw_front


@pytest.mark.parametrize("levels", [2, 14, 40])
def test_cost_against_accuracy_of_many_levels(levels: int) -> None:
    ranges = [f"{k} %" for k in range(levels)]
    factors = {"material": ["neo-hookean", "reduced-polynomial-3"], "range": ranges}
    frame = pd.DataFrame(
        [(m, r) for m in factors["material"] for r in ranges], columns=["material", "range"]
    )
    frame["cell"] = frame["material"] + frame["range"]
    frame["seconds"] = np.geomspace(0.05, 0.2, len(frame))
    frame["mean"] = np.linspace(6.0, 3.0, len(frame))
    frame["front"] = True
    facts: Any = SimpleNamespace(better="lower", title="relative RMS force error", unit="%")
    data: Any = SimpleNamespace(factors=factors, labels={})
    found = []

    def draw() -> Any:
        found.append(draw_front(frame, facts, data, 0.5))
        return found[0]

    with warnings.catch_warnings():
        warnings.simplefilter("error")  # matplotlib gives up a layout with a warning
        render(draw, "front", "Cost against accuracy")
    (ax,) = found[0].axes
    legend = ax.get_legend().get_window_extent()
    assert legend.x1 <= found[0].bbox.x1
    assert ax.get_position().height * found[0].get_figheight() > 1.5
