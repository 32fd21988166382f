"""Names, ticks and words on the axes of a figure."""

from __future__ import annotations

import io
import re
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias
from xml.etree import ElementTree

from study.reporting.content.blocks import Figure
from study.reporting.content.text import clean

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

    #: what a figure is to those who only hand it on
    Drawing: TypeAlias = Canvas


#: width of a figure, inches
WIDTH_IN = 9.6
#: width of a figure of the first page, where two stand beside each other or fill a phone
HALF_IN = 5.0


def labeled(words: str, unit: str | None) -> str:
    """Words of an axis with their unit."""
    return f"{words} ({unit})" if unit else words


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
    ax.tick_params(axis="y", length=0)  # a tick would touch the name that ends at the axis
    for y, name in zip(at, names, strict=True):
        lines = name.split("\n")
        for number, line in enumerate(lines):
            higher = 1.2 * fontsize * ((len(lines) - 1) / 2 - number)
            edge = {"xycoords": ax.get_yaxis_transform(), "annotation_clip": False}
            look = {"ha": "right", "va": "center_baseline", "fontsize": fontsize} | edge
            note(ax, line, (0, y), (-3.5, higher), **look)


def log_ticks(ax: Axes, axes: str = "xy", label: Callable[[float], str] = "{:g}".format) -> None:
    """Label logarithmic axes, whose limits are final, at two places at least."""
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    for name in axes:
        axis = ax.xaxis if name == "x" else ax.yaxis
        low, high = sorted(axis.get_view_interval())
        # within a decade powers of ten are too few
        steps = (1.0, 2.0, 5.0) if high < 1000 * low else (1.0,)
        locator = LogLocator(subs=steps, numticks=9) if high > 10 * low else MaxNLocator(4)
        places = [tick for tick in locator.tick_values(low, high) if low <= tick <= high]
        axis.set_ticks(places, labels=[label(tick) for tick in places])
        axis.set_minor_formatter(NullFormatter())


def note(
    ax: Axes, words: str, at: tuple[float, float], shift: tuple[float, float], **look: Any
) -> None:
    """Write small words beside a place, shifted by points."""
    look.setdefault("fontsize", 7.5)
    ax.annotate(words, at, xytext=shift, textcoords="offset points", **look)


def at_right(ax: Axes, words: str, height: float, color: str | None = None) -> None:
    """Write outside the right edge of axes."""
    edge = {"xycoords": ax.get_yaxis_transform(), "annotation_clip": False}
    note(ax, words, (1.0, height), (4, 0), va="center", color=color, **edge)


def above(ax: Axes, words: str, x: float, **look: Any) -> None:
    """Write small words on the upper edge of axes."""
    usual = {"ha": "center", "va": "bottom", "fontsize": 7.5, "color": MUTED}
    ax.text(x, 1.0, words, transform=ax.get_xaxis_transform(), **{**usual, **look})


def one_panel(height_in: float, width_in: float = WIDTH_IN) -> tuple[Canvas, Axes]:
    """Return an empty figure with its only axes."""
    figure = canvas(height_in, width_in)
    return figure, figure.subplots()


def panels(
    number: int, columns: int, height_in: float, pad_in: float = 0.5, **shared: Any
) -> tuple[Canvas, list[Axes]]:
    """Return a figure of panels in rows, all of one size; places that are left over stay empty."""
    columns = min(columns, number)
    rows = -(-number // columns)
    figure = canvas(pad_in + height_in * rows)
    axes = figure.subplots(rows, columns, squeeze=False, **shared).ravel()
    for ax in axes[number:]:
        ax.set_visible(False)
    return figure, list(axes[:number])


def clean_left(ax: Axes) -> None:
    """Take the line and the ticks from the left of some ``ax``, where names stand."""
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", length=0)


# How figures look: one palette, one set of type sizes, deterministic SVG.


INK = "#1b1f24"
MUTED = "#6a737d"
RULE = "#d5d9de"
BAND = "#eef1f4"

# Okabe & Ito 2008, without the yellow, which cannot be seen on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

# the same hues dark enough for words: a contrast of 4.5 on white and more (WCAG 2.1, AA)
WORDS = ("#005f96", "#a84300", "#00694d", "#8f3f6c", "#7a5200", "#1b6a96", "#000000")
# one more than there are colors, so that 56 series look different
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "p")
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
#: settings of matplotlib by their value; at an axis stands no offset and no exponent
_SETTINGS: dict[Any, str] = {
    False: "text.parse_math text.usetex axes.formatter.use_mathtext axes.formatter.useoffset "
    "axes.spines.top axes.spines.right legend.frameon",
    True: "axes.unicode_minus axes.axisbelow",
    "none": "svg.fonttype figure.facecolor axes.facecolor savefig.facecolor",
    8.5: "font.size axes.titlesize axes.labelsize figure.labelsize figure.titlesize",
    8: "xtick.labelsize ytick.labelsize legend.fontsize",
    3: "xtick.major.size ytick.major.size",
    1.4: "lines.linewidth",
    0.6: "axes.linewidth xtick.major.width ytick.major.width",
    0.4: "grid.linewidth",
    INK: "axes.labelcolor text.color xtick.labelcolor ytick.labelcolor",
    MUTED: "axes.edgecolor xtick.color ytick.color",
    RULE: "grid.color",
    "DejaVu Sans": "font.family",
    "bold": "axes.titleweight",
    "left": "axes.titlelocation",
    (-9, 9): "axes.formatter.limits",
}
_RC = {name: value for value, names in _SETTINGS.items() for name in names.split()}
_DECIMALS = re.compile(r"-?\d+\.\d+")
_FAMILY = re.compile("font-family: [^;]*; ")
_SVG = "http://www.w3.org/2000/svg"


def color_of(index: int) -> str:
    """Color of the level or series with this index."""
    return PALETTE[index % len(PALETTE)]


def word_color_of(index: int) -> str:
    """Color of a word that names the level or series with this index."""
    return WORDS[index % len(WORDS)]


def canvas(height_in: float, width_in: float = WIDTH_IN, *, arranged: bool = True) -> Canvas:
    """Return an empty figure that belongs to no global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained" if arranged else None)


def _look(more: Mapping[str, str]) -> Any:
    """Hand settings of a figure to a function whose type knows every key by name."""
    return {**_RC, **more}


def load_libraries() -> None:
    """Import what draws most figures, which takes a second."""
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401


def render(draw: Callable[[], Canvas], name: str, title: str) -> str:
    """Draw and return an inline ``<svg>`` element, the same bytes for the same data."""
    import matplotlib as mpl
    from matplotlib.artist import ArtistInspector
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    look = _look({"svg.hashsalt": name})
    nothing: Any = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with mpl.rc_context(look), warnings.catch_warnings():
        # the reader's browser draws the text and has the glyphs; only widths are estimated
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure = draw()
        buffer = io.StringIO()
        sheet: Any = FigureCanvasSVG(figure)
        sheet.print_svg(buffer, metadata=nothing)
    # matplotlib's cache of the setters of artists would hold 2 to 7 MB of drawings a report
    getattr(ArtistInspector.is_alias, "cache_clear", lambda: None)()
    return _inline(buffer.getvalue(), name, title)


def shown(draw: Callable[[], Canvas], name: str, title: str) -> Canvas:
    """Draw a figure that a notebook shows without any of its own settings for figures."""
    import matplotlib as mpl

    with mpl.rc_context(_look({})):
        figure = draw()
    # a notebook asks whatever it shows for this; a figure of no backend has none
    vars(figure)["_repr_svg_"] = lambda: render(lambda: figure, name, title)
    return figure


def _inline(text: str, name: str, title: str) -> str:
    """Strip the prologue, let the page choose the font, name the drawing.

    Its ids hold the hash of a name and of what they stand for: those of a page are different.
    """
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(text[text.index("<svg") :])
    for metadata in root.findall(f"{{{_SVG}}}metadata"):
        root.remove(metadata)
    for definitions in root.iter(f"{{{_SVG}}}defs"):
        # its `*` selector would style the whole page; style.css says the same for svg alone
        for rule in definitions.findall(f"{{{_SVG}}}style"):
            definitions.remove(rule)
    for element in root.iter():
        if element.tag.endswith("}g"):
            # ids that nothing refers to only make the page longer
            element.attrib.pop("id", None)
        turned = {"transform"} if element.get("transform", "").startswith("rotate(") else set()
        for key in element.attrib.keys() & ({"d", "x", "y", "width", "height"} | turned):
            # hundredths of a point are finer than any screen, and coarser than what the order of
            # the solver of layouts leaves from one process to the next
            element.attrib[key] = _DECIMALS.sub(
                lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."),
                element.attrib[key],
            )
        if element.tag.endswith("}text"):
            element.attrib["style"] = _FAMILY.sub("", element.attrib["style"])
            if element.attrib.get("transform", "").startswith("rotate(-0 "):
                del element.attrib["transform"]
    for dimension in ("width", "height"):
        root.attrib.pop(dimension, None)
    # a narrow drawing does not fill a wide page, a wide one keeps its letters on a phone
    points = float(root.attrib["viewBox"].split()[2])
    root.attrib["style"] = f"max-width: {1.75 * points:.0f}px; --least: {0.95 * points:.0f}px"
    # for a drawing opened by itself; in a page, its style sheet chooses
    root.attrib.update({"role": "img", "aria-label": title, "font-family": "Arial, sans-serif"})
    return ElementTree.tostring(root, encoding="unicode")


# A figure is its title, its points, its drawing and its caption, or why it is missing.


#: title, points, drawing and caption of a figure: the frame is computed, drawn and told of
Plot = tuple[str, Callable[..., "pd.DataFrame"], Callable[..., "Canvas"], Callable[..., str] | str]


def bound(plot: Plot, *subject: object) -> Plot:
    """Figure of a subject, such as a response and its report: its functions take that first."""
    title, points, draw, caption = plot
    words = caption if isinstance(caption, str) else partial(caption, *subject)
    return title, partial(points, *subject), partial(draw, *subject), words


_of_data_alone: ContextVar[bool] = ContextVar("figures of data alone", default=False)


@contextmanager
def data_alone() -> Iterator[None]:
    """Make figures without drawings, which take three quarters of the time of a small report."""
    token = _of_data_alone.set(True)
    try:
        yield
    finally:
        _of_data_alone.reset(token)


def make(name: str, plot: Plot) -> Figure:
    """Compute and draw one figure; any failure becomes its ``missing``."""
    title, points, draw, caption = plot
    frame: pd.DataFrame | None = None
    try:
        frame = points()
        words = caption if isinstance(caption, str) else caption(frame)
        svg = "" if _of_data_alone.get() else render(partial(draw, frame), name, title)
    except Exception as error:  # the numbers must reach the reader whatever the drawing does
        why = f"{type(error).__name__}: {error}"
        return Figure(name, title, data=frame, missing=why[:300])
    return Figure(name, title, words, svg, frame)


def figures_of(plots: Mapping[str, Plot], stem: str, of: str) -> dict[str, Figure]:
    """Make the figures of one response or surface: its name stands in their titles."""
    return {
        kind: make(f"{stem}-{kind}", (f"{title}: {of}", points, draw, caption))
        for kind, (title, points, draw, caption) in plots.items()
    }
