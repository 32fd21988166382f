"""Which curves are drawn in which panel, sampled, each beside its own measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.study_result.report_data import CurvePair, ReportData

if TYPE_CHECKING:
    import pandas as pd

#: Displacements at which every curve is sampled, from the first measured one to the last.
POINTS = 31
#: Panels that fit on one page.
MOST_PANELS = 24
#: Levels of a factor that fit beside each other.
MOST_COLUMNS = 4
#: Forces in N are drawn on one axis if the largest ones of all panels differ by less than this
#: factor. Otherwise each panel shows shares of its own largest measured force: on an axis that
#: reaches 10 times higher, residuals of some percent could not be seen.
COMPARABLE = 3.0
#: Displacements are drawn on one axis if the panels end within this factor of each other.
SAME_LENGTH = 1.5
#: Two measurements are one if their forces differ by less than this share of the largest force.
#: Both are interpolated from the same points, so that only round-off is left between them.
SAME_FORCE = 1e-6

COLUMNS = (
    "block",
    "panel",
    "line",
    "displacement_mm",
    "measured_N",
    "predicted_N",
    "scatter_N",
)


@dataclass(frozen=True)
class CurvePanels:
    """Which curves go where.

    Parameters
    ----------
    line : str
        Factor drawn as lines.
    panel : str
        Factor that splits each block into panels; empty for none.
    fixed : mapping of str to str
        Level at which every other factor is held.
    panels : tuple of (str, str)
        Block and level of ``panel``, in reading order.
    left_out : int
        Blocks that are not drawn.
    frame : DataFrame
        One row a sampled point: ``COLUMNS``. ``predicted_N`` is missing beyond the end of a
        prediction that stopped early, ``scatter_N`` where there are no repeats.
    """

    line: str
    panel: str
    fixed: Mapping[str, str]
    panels: tuple[tuple[str, str], ...]
    left_out: int
    frame: pd.DataFrame

    def rows(self, panel: tuple[str, str]) -> pd.DataFrame:
        """Return the points of one panel."""
        block, level = panel
        return self.frame[(self.frame["block"] == block) & (self.frame["panel"] == level)]

    @property
    def is_relative(self) -> bool:
        """Whether forces are shown as shares of the largest measured one of their panel."""
        top = self.frame.groupby(["block", "panel"])["measured_N"].max()
        return bool(top.max() > COMPARABLE * top.min())

    @property
    def has_one_length(self) -> bool:
        """Whether the curves of all panels end at about the same displacement."""
        end = self.frame.groupby(["block", "panel"])["displacement_mm"].max()
        return bool(end.max() < SAME_LENGTH * end.min())


def curve_panels(data: ReportData) -> CurvePanels:
    """Choose the panels and sample every curve over the range of its own measurement.

    A factor that changes the measurement itself (its range) is drawn in panels, so that every
    panel shows one measurement. Of the others, lines are the factor whose levels differ most
    among the predictions, panels the next; the first scored curve of a block stands for it.

    Parameters
    ----------
    data : ReportData
        Of a study that kept curves.

    Returns
    -------
    CurvePanels

    Raises
    ------
    ValueError
        If no curves were kept.
    """
    import pandas as pd

    pairs = _first_of_each_block(data)
    line, panel = _roles(data, pairs)
    fixed = {name: data.factors[name][0] for name in data.factors if name not in (line, panel)}
    chosen = [p for p in pairs if all(p.levels.get(k) == v for k, v in fixed.items())]
    levels = data.factors[panel] if panel else ("",)
    present = dict.fromkeys(pair.block for pair in pairs)
    blocks = [block for block in data.blocks if block in present] or list(present)
    room = max(MOST_PANELS // len(levels), 1)
    kept = [blocks[i] for i in np.unique(np.linspace(0, len(blocks) - 1, room).astype(int))]
    panels = tuple((block, level) for block in kept for level in levels)
    rows = [row for pair in chosen if pair.block in kept for row in _samples(pair, line, panel)]
    frame = pd.DataFrame(rows, columns=list(COLUMNS))
    return CurvePanels(line, panel, fixed, panels, len(blocks) - len(kept), frame)


def _first_of_each_block(data: ReportData) -> list[CurvePair]:
    pairs = [pair for pair in data.curves if pair.role == "score"] or list(data.curves)
    if not pairs:
        raise ValueError("no curves were kept")
    first: dict[str, str] = {}
    for pair in pairs:
        first.setdefault(pair.block, pair.label)
    return [pair for pair in pairs if pair.label == first[pair.block]]


def _roles(data: ReportData, pairs: Sequence[CurvePair]) -> tuple[str, str]:
    """Return the factor drawn as lines and the one drawn in panels."""
    order = sorted(data.factors, key=lambda name: -_spread(pairs, name))
    measuring = [name for name in order if _changes_measurement(pairs, name)]
    others = [name for name in order if name not in measuring]
    few = [name for name in measuring if len(data.factors[name]) <= MOST_COLUMNS]
    if few and others:
        return others[0], few[0]
    panel = order[1] if len(order) > 1 and len(data.factors[order[1]]) <= MOST_COLUMNS else ""
    return order[0], panel


def _changes_measurement(pairs: Sequence[CurvePair], factor: str) -> bool:
    """Whether levels of a factor, all others held, meet measurements that end elsewhere."""
    ends: dict[tuple[str, ...], set[float]] = {}
    for pair in pairs:
        others = (level for name, level in pair.levels.items() if name != factor)
        end = round(float(pair.measured.displacement_mm[-1]), 9)
        ends.setdefault((pair.block, *others), set()).add(end)
    return any(len(found) > 1 for found in ends.values())


def _spread(pairs: Sequence[CurvePair], factor: str) -> float:
    """Variance between levels of the residual averaged at each tenth of the range."""
    groups: dict[str, list[Array]] = {}
    for pair in pairs:
        end = min(pair.measured.displacement_mm[-1], pair.predicted.displacement_mm[-1])
        d = np.linspace(0.1, 1, 10) * float(end)
        gap = pair.predicted.force_at(d) - pair.measured.force_at(d)
        groups.setdefault(pair.levels.get(factor, ""), []).append(gap / pair.measured.force_N.max())
    means = [np.mean(group, axis=0) for group in groups.values()]
    return float(np.var(means, axis=0).sum())


def _samples(pair: CurvePair, line: str, panel: str) -> list[tuple[str | float, ...]]:
    """Points of one pair over its whole measurement."""
    measured_mm = pair.measured.displacement_mm
    d = np.linspace(max(float(measured_mm[0]), 0.0), float(measured_mm[-1]), POINTS)
    end = float(pair.predicted.displacement_mm[-1])
    # a curve that was asked for to the last measured point may end an ulp before it
    reached = d <= end * (1 + 1e-9)
    predicted = np.full(d.size, np.nan)
    predicted[reached] = pair.predicted.force_at(np.minimum(d[reached], end))
    scatter = np.full(d.size, np.nan)
    if pair.scatter_N is not None:
        scatter = np.interp(d, measured_mm, pair.scatter_N)
    key = (pair.block, pair.levels.get(panel, ""), pair.levels.get(line, ""))
    columns = zip(d, pair.measured.force_at(d), predicted, scatter, strict=True)
    return [(*key, *map(float, values)) for values in columns]


def measurements(rows: pd.DataFrame) -> tuple[pd.DataFrame, ...]:
    """Return the distinct measurements of one panel, longest first.

    Lines share a measurement as a rule. One that only repeats the beginning of a longer one is
    not returned: its points would cover those of the longer one.

    Parameters
    ----------
    rows : DataFrame
        Points of one panel.

    Returns
    -------
    tuple of DataFrame
        The rows of the first line that has each measurement.
    """
    lines = [one for _, one in rows.groupby("line", sort=False)]
    lines.sort(key=lambda one: -float(one["displacement_mm"].max()))
    found: list[pd.DataFrame] = []
    for one in lines:
        if not any(_repeats(one, longer) for longer in found):
            found.append(one)
    return tuple(found)


def _repeats(one: pd.DataFrame, longer: pd.DataFrame) -> bool:
    """Whether a measurement agrees with the beginning of a longer one, up to its sampling."""
    d, force = longer["displacement_mm"].to_numpy(), longer["measured_N"].to_numpy()
    if np.array_equal(one["displacement_mm"].to_numpy(), d):
        return bool(np.allclose(one["measured_N"], force, rtol=0, atol=SAME_FORCE * force.max()))
    between = np.interp(one["displacement_mm"], d, force)
    # a longer curve is sampled more coarsely: a chord leaves a curve by its second difference / 8
    bend = float(np.abs(np.diff(force, 2)).max(initial=0.0))
    scatter = max(bend, SAME_FORCE * float(force.max()))
    return bool(np.all(np.abs(one["measured_N"] - between) <= scatter))
