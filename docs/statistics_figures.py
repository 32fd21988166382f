"""Draw the pictures of docs/statistics.md: `python docs/statistics_figures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

HERE = Path(__file__).parent
INK = "#1b1f24"
BLUE = "#0072B2"
RED = "#D55E00"
GREEN = "#009E73"


def verdicts() -> Figure:
    """Draw four intervals against the band of what does not matter."""
    figure = Figure(figsize=(7, 2.6), layout="constrained")
    ax = figure.subplots()
    ax.axvspan(-2, 2, color="#e7ebef")
    rows = (
        ("no practical difference", -0.3, 1.4, GREEN),
        ("matters", 2.6, 4.2, RED),
        ("cannot tell", 0.8, 3.1, INK),
        ("cannot tell (and p = .001)", 1.2, 2.4, INK),
    )
    for place, (name, low, high, color) in enumerate(reversed(rows)):
        ax.plot([low, high], [place, place], color=color, linewidth=2)
        ax.plot([(low + high) / 2], [place], "o", color=color)
        ax.text(4.6, place, name, va="center", color=color)
    ax.set(xlim=(-3, 7.5), ylim=(-0.6, 3.6), yticks=[], xlabel="difference of two levels (pp)")
    ax.text(0, 3.68, "what does not matter to you", ha="center", fontsize=8)
    return figure


def replicates() -> Figure:
    """Draw three specimens measured five times: repeats agree, specimens differ."""
    rng = np.random.default_rng(2011)
    figure = Figure(figsize=(7, 2.6), layout="constrained")
    ax = figure.subplots()
    for place, mean in enumerate((9.2, 11.4, 10.1)):
        ax.plot(mean + 0.08 * rng.standard_normal(5), place + np.linspace(-0.2, 0.2, 5), ".k")
        ax.plot([mean, mean], [place - 0.3, place + 0.3], color=BLUE, linewidth=2)
    ax.set(yticks=[0, 1, 2], yticklabels=["specimen 1", "specimen 2", "specimen 3"])
    ax.set(xlabel="peak force (N): dots are repeats, lines are specimens", ylim=(-0.6, 2.6))
    return figure


def mesh() -> Figure:
    """Draw a value on three meshes, its limit, and the bound of the error that is left."""
    figure = Figure(figsize=(7, 2.6), layout="constrained")
    ax = figure.subplots()
    sizes = np.array([1.0, 2.0, 4.0])
    # a second-order method: error 0.03 h^2
    ax.plot(sizes, 10 + 0.03 * sizes**2, "o-", color=BLUE)
    fine = np.linspace(0, 1, 20)
    ax.plot(fine, 10 + 0.03 * fine**2, ":", color=BLUE)
    ax.errorbar([1.0], [10.03], yerr=[[0.06], [0.06]], color=RED, capsize=4)
    ax.annotate("U: bound of the mesh error", (1.0, 10.09), (1.15, 10.2), color=RED)
    ax.annotate("limit", (0, 10), (0.1, 9.95), color=BLUE)
    ax.set(xlabel="mesh size (mm)", ylabel="peak force (N)", xlim=(0, 4.2))
    return figure


def main() -> None:
    """Write every picture beside this file."""
    with mpl.rc_context({"svg.hashsalt": "study", "svg.fonttype": "none", "font.size": 9}):
        for draw in (verdicts, replicates, mesh):
            figure = draw()
            path = HERE / f"statistics-{draw.__name__}.svg"
            figure.savefig(path, metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    main()
