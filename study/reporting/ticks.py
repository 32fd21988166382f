"""Names and numbers along an axis: wrapped, flush, with few decimals."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from study.reporting.text import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def wrap(label: object, width: int = 14, longest: int = 60) -> str:
    """Label of user text over several lines, broken at spaces and hyphens."""
    text = clean(label, longest)
    # a word a little too long is better read whole than cut
    widest = max(map(len, text.replace("-", "- ").split()), default=0)
    lines = textwrap.wrap(text, width, break_long_words=widest > 1.7 * width)
    return "\n".join(lines) or text


def name_rows(
    ax: Axes, places: Iterable[float], names: Sequence[str], fontsize: float = 7.5
) -> None:
    """Write names left of the axis, every line of them flush right.

    Matplotlib places the lines of one text by its own measure of their widths, and the font of
    a browser has another: each line is therefore a text of its own that ends at the axis.
    """
    at = list(places)
    ax.set_yticks(at, [""] * len(at))
    for place, name in zip(at, names, strict=True):
        lines = name.split("\n")
        for number, line in enumerate(lines):
            higher = 1.2 * fontsize * ((len(lines) - 1) / 2 - number)
            ax.annotate(
                line,
                (0, place),
                xycoords=ax.get_yaxis_transform(),
                xytext=(-3.5, higher),
                textcoords="offset points",
                ha="right",
                va="center_baseline",
                fontsize=fontsize,
                annotation_clip=False,
            )


def plain_ticks(ax: Axes, axis: str) -> None:
    """Few ticks, the same decimals on each, no offset and no exponent."""
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    target = ax.xaxis if axis == "x" else ax.yaxis
    formatter = ScalarFormatter(useOffset=False, useMathText=False)
    formatter.set_scientific(False)
    target.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    target.set_major_formatter(formatter)
