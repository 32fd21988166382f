"""Names, ticks and words on the axes of a figure."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, TypeAlias

from study.reporting.text import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

    #: what a figure is to those who only hand it on
    Drawing: TypeAlias = Canvas


#: labels of a logarithmic axis beyond which some are left out
_MOST_TICKS = 9


def wrap(label: object, width: int = 14, longest: int = 60) -> str:
    """Label of user text over several lines, broken at spaces and hyphens.

    Parameters
    ----------
    label : object
        Control characters are replaced.
    width, longest : int
        Characters of a line, and of all lines; 0 for a ``longest`` without end.
    """
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

    Parameters
    ----------
    ax : Axes
        Its ticks of the vertical axis are replaced.
    places : iterable of float
        Heights in data coordinates, one for each name.
    names : sequence of str
        May hold line feeds.
    fontsize : float
        In points.
    """
    at = list(places)
    ax.set_yticks(at, [""] * len(at))
    ax.tick_params(axis="y", length=0)  # a tick would touch the name that ends at the axis
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
    """Few ticks, the same decimals on each, no offset and no exponent.

    Parameters
    ----------
    ax : Axes
        With a linear scale.
    axis : {"x", "y"}
        Which of its two axes.
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    target = ax.xaxis if axis == "x" else ax.yaxis
    formatter = ScalarFormatter(useOffset=False, useMathText=False)
    formatter.set_scientific(False)
    target.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    target.set_major_formatter(formatter)


def log_places(low: float, high: float) -> list[float]:
    """Places of the ticks of a logarithmic axis: at least two, as round as that allows.

    Parameters
    ----------
    low, high : float
        Limits of the axis, 0 < low < high.

    Returns
    -------
    list of float
        Powers of ten where two of them are seen; else also 2 and 5 times these, then every
        first digit, then equal steps.

    Examples
    --------
    >>> log_places(0.02, 300.0)
    [0.1, 1.0, 10.0, 100.0]
    >>> log_places(1.5, 6.0)
    [2.0, 5.0]
    >>> log_places(2.1, 2.4)
    [2.1, 2.2, 2.3, 2.4]
    """
    from matplotlib.ticker import MaxNLocator

    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in ((1,), (1, 2, 5), range(1, 10)):
        places = [float(f"{digit}e{exponent}") for exponent in exponents for digit in digits]
        inside = [place for place in places if low <= place <= high]
        if len(inside) >= 2:
            return inside[:: -(-len(inside) // _MOST_TICKS)]
    steps = MaxNLocator(4).tick_values(low, high)
    rounded = [float(f"{place:.6g}") for place in steps]
    return [place for place in rounded if low * (1 - 1e-9) <= place <= high * (1 + 1e-9)]


def log_ticks(ax: Axes, axis: str, label: Callable[[float], str] = "{:g}".format) -> None:
    """Label a logarithmic axis, whose limits are final, at two places at least.

    Parameters
    ----------
    ax : Axes
        With a logarithmic scale.
    axis : {"x", "y"}
        Which of its two axes.
    label : callable
        Text of a tick by its place.
    """
    from matplotlib.ticker import NullFormatter

    low, high = sorted(ax.get_xlim() if axis == "x" else ax.get_ylim())
    places = log_places(low, high)
    if axis == "x":
        ax.set_xticks(places, [label(place) for place in places])
    else:
        ax.set_yticks(places, [label(place) for place in places])
    (ax.xaxis if axis == "x" else ax.yaxis).set_minor_formatter(NullFormatter())


def at_right(ax: Axes, words: str, height: float, color: str | None = None) -> None:
    """Write outside the right edge of axes.

    Parameters
    ----------
    ax, words, height, color : Axes, str, float, str or None
        Where and what; the height is one of the vertical axis.
    """
    ax.annotate(
        words,
        (1.0, height),
        xytext=(4, 0),
        xycoords=ax.get_yaxis_transform(),
        textcoords="offset points",
        va="center",
        fontsize=7.5,
        annotation_clip=False,
        color=color,
    )


def clean_left(ax: Axes) -> None:
    """Take the line and the ticks from the left of some ``ax``, where names stand.

    Parameters
    ----------
    ax : Axes
        Its vertical axis has names instead of numbers.
    """
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", length=0)
