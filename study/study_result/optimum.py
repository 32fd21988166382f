"""The best setting among the choices of a study, as it is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from study.response_surface.optimum import Goal, Spread


@dataclass(frozen=True)
class Bound:
    """A limit of another response, as it was asked for.

    Parameters
    ----------
    response, unit : str
        The response and its unit.
    sign : {1, -1}
        1 for at least, -1 for at most.
    value : float
        The limit, in that unit.
    """

    response: str
    unit: str
    sign: int
    value: float

    @property
    def words(self) -> str:
        """The limit as it is written."""
        sign = ">=" if self.sign > 0 else "<="
        return f"{self.response} {sign} {self.value:.4g} {self.unit}".strip()


@dataclass(frozen=True)
class Confirmed:
    """What the true model says at a recommended setting.

    Parameters
    ----------
    settings : mapping of str to str
        Labels of the run.
    values : mapping of str to float
        Responses in their units, means over the blocks; NaN where the run has no answer.
    predicted : bool
        Whether the response lies in the interval that was predicted.
    kept : bool
        Whether the limits hold for the run.
    """

    settings: Mapping[str, str]
    values: Mapping[str, float]
    predicted: bool
    kept: bool


@dataclass(frozen=True)
class Recommendation:
    """The best setting among choices.

    Parameters
    ----------
    goal : {"minimize", "maximize"}
        What is best.
    response, unit : str
        The response and its unit.
    settings : mapping of str to float or str
        Recommended settings of the choices: in the units of ``units``, or a label.
    held : mapping of str to float or str
        Settings that nobody recommends: of conditions, of unknowns, and those that were given.
    units : mapping of str to str
        Units of the factors that are numbers.
    value, low, high : float
        Prediction and its 95 % interval, in the response's unit.
    bounds : tuple of Bound
        Limits of other responses.
    limited : tuple of tuple of float
        Prediction, and ends of its interval, of each of them.
    assurance : {"", "surely", "predicted"}
        Whether the limits hold with the unfavourable ends of the intervals, or for the prediction
        alone.
    at_end : tuple of str
        Choices that stand at an end of what was run: a better setting may lie beyond.
    spread : Spread or None
        What the factors that nobody chooses do there, over what was run of them.
    rivals : tuple of tuple of (mapping, float)
        Other levels of the choices that are no numbers, and their best values, the best first.
    confirmed : Confirmed or None
        The true model's run there; None where none was made.
    notes : tuple of str
        What a reader must know.
    """

    goal: Goal
    response: str
    unit: str
    settings: Mapping[str, float | str]
    held: Mapping[str, float | str]
    units: Mapping[str, str]
    value: float
    low: float
    high: float
    bounds: tuple[Bound, ...] = ()
    limited: tuple[tuple[float, float, float], ...] = ()
    assurance: str = ""
    at_end: tuple[str, ...] = ()
    spread: Spread | None = None
    rivals: tuple[tuple[Mapping[str, str], float], ...] = ()
    confirmed: Confirmed | None = None
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        limits = [
            {"limit": one.words, "response": one.response, "unit": one.unit, "value": value,
             "low": low, "high": high}
            for one, (value, low, high) in zip(self.bounds, self.limited, strict=True)
        ]  # fmt: skip
        run = self.confirmed
        told: dict[str, object] | None = None
        if run is not None:
            values = {n: v if np.isfinite(v) else None for n, v in run.values.items()}
            told = {"settings": dict(run.settings), "values": values,
                    "inside_interval": run.predicted, "keeps_limits": run.kept}  # fmt: skip
        return {
            "goal": self.goal,
            "response": self.response,
            "unit": self.unit,
            "settings": dict(self.settings),
            "held": dict(self.held),
            "units": dict(self.units),
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "limits": limits,
            "limits_hold": self.assurance or None,
            "at_end_of_range": list(self.at_end),
            "over_what_is_not_chosen": None if self.spread is None else vars(self.spread),
            "rivals": [{"settings": dict(at), "value": value} for at, value in self.rivals],
            "confirmed": told,
            "notes": list(self.notes),
        }
