"""Logarithmic axes have two labelled ticks and more inside their limits, however narrow these."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from study.reporting.figures.axes import canvas, log_places, log_ticks
from study.reporting.figures.convergence_figures import draw_errors, draw_front


def seen(ax, axis: str) -> list[str]:
    low, high = sorted(ax.get_xlim() if axis == "x" else ax.get_ylim())
    target = ax.xaxis if axis == "x" else ax.yaxis
    ax.figure.canvas.draw()
    labels = zip(target.get_majorticklocs(), target.get_majorticklabels(), strict=True)
    return [label.get_text() for place, label in labels if low <= place <= high]


@pytest.mark.parametrize("low", [1e-9, 0.0031, 0.97, 1.0, 9.9, 12345.0])
@pytest.mark.parametrize("ratio", [1.001, 1.05, 1.4, 2.0, 3.3, 9.0, 11.0, 1e3, 1e12])
def test_two_places_at_least(low: float, ratio: float) -> None:
    places = log_places(low, low * ratio)
    inside = [place for place in places if low * (1 - 1e-6) <= place <= low * ratio * (1 + 1e-6)]
    assert 2 <= len(inside) == len(places) <= 10
    assert places == sorted(set(places))


@pytest.mark.parametrize("ratio", [1.02, 1.7, 4.0, 40.0, 1e5])
def test_an_axis_shows_two_different_labels(ratio: float) -> None:
    ax = canvas(3, 6).subplots()
    ax.plot([3.0, 3.0 * ratio], [0.07, 0.07 * ratio])
    ax.set_xscale("log")
    ax.set_yscale("log")
    log_ticks(ax)
    for axis in "xy":
        labels = seen(ax, axis)
        assert len(set(labels)) == len(labels) >= 2
        assert all(labels)


@pytest.mark.parametrize("spread", [1.001, 1.3, 50.0])
def test_figures_of_convergence_label_both_axes(spread: float) -> None:
    error = 0.03 * np.geomspace(1, spread, 3)
    frame = pd.DataFrame(
        {"cell": "a", "mesh_size": [1.0, 1.5, 2.25], "error": error, "formal_order": np.nan}
    )
    (ax,) = draw_errors(frame).axes
    assert len(seen(ax, "y")) >= 2
    front = pd.DataFrame({"cell": "a", "seconds": 2.0 * np.geomspace(1, spread, 3), "error": error})
    (ax,) = draw_front(front, 0.029).axes
    assert len(seen(ax, "x")) >= 2
    assert len(seen(ax, "y")) >= 2
