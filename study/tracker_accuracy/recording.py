"""What a tracker wrote: positions of its markers over time, in visits to stages of a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.arrays import Array, Ints
from study.errors import Fault, InputError
from study.registration.rigid import check_places
from study.tabular import CsvTable, read_csv
from study.tracker_accuracy.section import RecordingTable, Triple
from study.units import unit_factor

#: Name of the only stage of a recording without a column of stages.
WHOLE = "all"

#: Samples that a visit needs for its scatter and correlation.
FEWEST_SAMPLES = 4


@dataclass(frozen=True)
class Visit:
    """Samples in a row at one stage: they go together, and only their mean is independent.

    Parameters
    ----------
    stage : str
        Its stage or pose.
    begin, end : int
        First sample, and the one after the last.
    """

    stage: str
    begin: int
    end: int

    @property
    def rows(self) -> slice:
        """Samples of the visit."""
        return slice(self.begin, self.end)


@dataclass(frozen=True)
class Recording:
    """Positions of markers, sample by sample.

    Parameters
    ----------
    positions : dict of str to ndarray, shape (n, 3)
        Of every marker, mm.
    time_s : ndarray, shape (n,), or None
        Time stamps.
    visits : tuple of Visit
        In the order of the recording.
    table : CsvTable
        The file, for further columns.
    """

    positions: dict[str, Array]
    time_s: Array | None
    visits: tuple[Visit, ...]
    table: CsvTable

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages in the order of their first visit."""
        return tuple(dict.fromkeys(visit.stage for visit in self.visits))

    def visits_of(self, stage: str) -> tuple[Visit, ...]:
        """Return the visits to a stage."""
        return tuple(visit for visit in self.visits if visit.stage == stage)


def read_recording(declared: RecordingTable, root: Path) -> Recording:
    """Read what a tracker wrote.

    Parameters
    ----------
    declared : RecordingTable
        Where it is and which columns it has.
    root : Path
        Data root.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        For a file that cannot be read, or time stamps that go backwards.
    """
    columns = [c for triple in declared.markers.values() for c in triple]
    columns += [c for c in (declared.time, declared.stage) if c]
    table = read_csv(
        root / declared.file, required=columns, decimal=declared.decimal, source=declared.file
    )
    factor = unit_factor(declared.unit, "length")
    positions = {
        marker: factor * coordinates(table, triple) for marker, triple in declared.markers.items()
    }
    for marker, points in positions.items():
        check_places(points, f"{declared.file}: marker {marker}")
    time = None if declared.time is None else table.numbers(declared.time)
    if time is not None:
        _check_time(time, table)
    labels = table.text(declared.stage) if declared.stage else (WHOLE,) * len(table.lines)
    return Recording(positions, time, visits_to(labels), table)


def coordinates(table: CsvTable, columns: Triple) -> Array:
    """Coordinates in three columns of a table.

    Parameters
    ----------
    table : CsvTable
        One row a sample.
    columns : tuple of str
        Names of the columns of x, y and z.

    Returns
    -------
    ndarray, shape (n, 3)
        In the unit of the table.
    """
    return np.column_stack([table.numbers(column) for column in columns])


def _check_time(time: Array, table: CsvTable) -> None:
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        first = int(back[0]) + 1
        word = "goes backwards" if time[first] < time[first - 1] else "stands still"
        more = f" (and at {back.size - 1} more rows)" if back.size > 1 else ""
        rule = f"the time {word}: {time[first]:g} s after {time[first - 1]:g} s{more}"
        mend = "sort the rows by time; was the clock set, or were two recordings joined?"
        raise InputError(Fault(f"{table.source}:{table.lines[first]}", rule, mend))


def visits_to(labels: Sequence[str]) -> tuple[Visit, ...]:
    """Find runs of equal labels.

    Parameters
    ----------
    labels : sequence of str
        Stage of every sample, in the order of the recording.

    Examples
    --------
    >>> [(v.stage, v.begin, v.end) for v in visits_to(["a", "a", "b", "a"])]
    [('a', 0, 2), ('b', 2, 3), ('a', 3, 4)]
    """
    marks = np.array(labels, dtype=object)
    ends = [*(np.flatnonzero(marks[1:] != marks[:-1]) + 1).tolist(), len(labels)]
    begins = [0, *ends[:-1]]
    return tuple(Visit(labels[a], a, b) for a, b in zip(begins, ends, strict=True))


def passes(visits: Sequence[Visit]) -> Ints | None:
    """Pass of the motion that every visit belongs to.

    A pass visits every stage once. Comparing stages within passes takes a drift out.

    Parameters
    ----------
    visits : sequence of Visit
        In the order of the recording.

    Returns
    -------
    ndarray of int, shape (visits,), or None
        Number of the pass, from 0; None where a pass is not complete, or there are fewer than two
        passes or stages.
    """
    stages = list(dict.fromkeys(visit.stage for visit in visits))
    count, left = divmod(len(visits), len(stages))
    if left or count < 2 or len(stages) < 2:
        return None
    for k in range(count):
        part = visits[k * len(stages) : (k + 1) * len(stages)]
        if {visit.stage for visit in part} != set(stages):
            return None
    return np.arange(len(visits)) // len(stages)


def correlation_time(series: Array) -> float:
    """Count the samples that go for one independent one: the autocorrelation time, at least 1.

    Sokal 1997: the sum 1 + 2 sum rho_k is cut at the first lag beyond five times itself, so
    that the noise of far lags does not add up. The mean of n samples then has the variance of
    n over this many independent ones.

    Parameters
    ----------
    series : ndarray, shape (n,)
        Samples at even times; 1 is returned where they are fewer than :data:`FEWEST_SAMPLES`, or
        all alike.
    """
    n = len(series)
    away = series - series.mean()
    variance = float(away @ away) / n
    if variance == 0 or n < FEWEST_SAMPLES:
        return 1.0
    spectrum = np.abs(np.fft.rfft(away, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n] / n / variance
    total = 1 + 2 * np.cumsum(rho[1:])
    beyond = np.arange(1, n) >= 5 * total
    where = int(beyond.argmax()) if beyond.any() else n - 2
    return float(min(max(total[where], 1.0), n))
