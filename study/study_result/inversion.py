"""All inputs of a study that agree with a measured curve, as they are told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class InputSet:
    """What a measured curve says of one input.

    Parameters
    ----------
    name, unit : str
        The input.
    best, low, high : float
        Setting of the best curve, and the ends of those that agree, in that unit.
    open_low, open_high : bool
        Whether the settings that agree go on to the end of what was run, and maybe beyond.
    """

    name: str
    unit: str
    best: float
    low: float
    high: float
    open_low: bool
    open_high: bool

    @property
    def verdict(self) -> str:
        """What is known of the input by itself."""
        if self.open_low and self.open_high:
            return "not determined"
        if self.open_low:
            return "has an upper end only"
        return "has a lower end only" if self.open_high else "determined"


@dataclass(frozen=True)
class Determined:
    """A product of powers that the curve determines, where inputs by themselves are not.

    Parameters
    ----------
    exponents : mapping of str to float
        Powers of the inputs.
    value : float
        Of the product, in the inputs' units.
    ratio : float
        Factor by which it may be larger or smaller.
    """

    exponents: Mapping[str, float]
    value: float
    ratio: float

    @property
    def words(self) -> str:
        """The product as it is written; powers that are next to nothing are left out."""
        parts = [name if abs(e - 1.0) < 0.005 else f"{name}^{e:.3g}"
                 for name, e in self.exponents.items() if abs(e) >= 0.01]  # fmt: skip
        return " * ".join(parts)


@dataclass(frozen=True)
class Checked:
    """A run of the true model at a setting of the set.

    Parameters
    ----------
    settings : mapping of str to str
        Labels of the run.
    rms : float
        What its curve misses of the measured one, root mean square in N; NaN without an answer.
    agrees : bool
        Whether it is no more than the limit.
    """

    settings: Mapping[str, str]
    rms: float
    agrees: bool


@dataclass(frozen=True)
class Inverted:
    """All inputs whose curve agrees with a measured one.

    Parameters
    ----------
    inputs : tuple of InputSet
        One for every input that is asked for.
    combinations : tuple of Determined
        What is determined where inputs by themselves are not.
    held : mapping of str to float or str
        Known inputs, in the units of ``units``.
    units : mapping of str to str
        Units of the inputs that are numbers.
    rms, limit : float
        What the best curve misses and what an agreeing one may miss, root mean square in N.
    relative : float
        ``rms`` over the root mean square of the measured force.
    rows : int
        Rows of the measured curve that were used.
    q2 : float
        Of the emulator of the curves.
    members : tuple of mapping
        Settings that agree, in their units.
    best_run : Checked or None
        The true model at the best setting; None where it was not asked.
    end_runs : tuple of Checked
        The true model where the least determined input is smallest and largest.
    notes : tuple of str
        What a reader must know.
    """

    inputs: tuple[InputSet, ...]
    combinations: tuple[Determined, ...]
    held: Mapping[str, float | str]
    units: Mapping[str, str]
    rms: float
    limit: float
    relative: float
    rows: int
    q2: float
    members: tuple[Mapping[str, float], ...]
    best_run: Checked | None
    end_runs: tuple[Checked, ...]
    notes: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What the curve determines, in a sentence."""
        loose = [one.name for one in self.inputs if one.open_low or one.open_high]
        if not loose:
            return "the curve determines every input that was asked for"
        if self.combinations:
            told = " and ".join(one.words for one in self.combinations)
            return f"the curve does not determine {', '.join(loose)} alone; it determines {told}"
        return f"the curve does not determine {', '.join(loose)} inside of what was run"

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "inputs": [vars(one) | {"verdict": one.verdict} for one in self.inputs],
            "combinations": [vars(one) | {"words": one.words} for one in self.combinations],
            "sentence": self.sentence,
            "held": dict(self.held),
            "units": dict(self.units),
            "rms_N": self.rms,
            "limit_N": self.limit,
            "relative_rms": self.relative,
            "rows": self.rows,
            "q2": self.q2,
            "members": [dict(one) for one in self.members],
            "best_run": None if self.best_run is None else _run_json(self.best_run),
            "end_runs": [_run_json(one) for one in self.end_runs],
            "notes": list(self.notes),
        }


def _run_json(run: Checked) -> dict[str, object]:
    rms = run.rms if np.isfinite(run.rms) else None
    return {"settings": dict(run.settings), "rms_N": rms, "agrees": run.agrees}
