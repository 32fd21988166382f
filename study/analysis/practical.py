"""The smallest difference that matters, in the scale that the analysis works on."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from study.errors import Fault, InputError

_TEXT = re.compile(r"^\s*(?P<value>\d+(\.\d*)?([eE][+-]?\d+)?|\.\d+)\s*(?P<unit>[^\d\s].*?)?\s*$")


@dataclass(frozen=True)
class Threshold:
    """A practical difference: absolute in the response's unit, or a fraction of the mean."""

    value: float
    relative: bool = False

    def on_scale(self, mean: float, transform: str) -> float:
        """Half-width of the practical band on the working scale.

        Parameters
        ----------
        mean : float
            Mean of the response (geometric for a log response).
        transform : {"none", "log"}
            On the log scale '10 % of mean' is the ratio 1.10, so ln 1.10.

        Examples
        --------
        >>> round(math.exp(Threshold(0.10, relative=True).on_scale(25.0, "log")), 10)
        1.1
        """
        if transform == "log":
            return math.log1p(self.value if self.relative else self.value / abs(mean))
        return self.value * abs(mean) if self.relative else self.value


def threshold(practical: Any) -> Threshold | None:
    """Read a practical difference: None, a number, text, or an object with value and relative.

    Raises
    ------
    InputError
        If it is not a positive difference.

    Examples
    --------
    >>> threshold("10 % of mean")
    Threshold(value=0.1, relative=True)
    >>> threshold("0.5 pp")
    Threshold(value=0.5, relative=False)
    """
    if practical is None or isinstance(practical, Threshold):
        return practical
    if isinstance(practical, str):
        found = _parse(practical)
    elif isinstance(practical, int | float):
        found = Threshold(float(practical))
    else:
        relative = bool(getattr(practical, "relative", False))
        value = float(practical.value)
        percent = relative and "%" in str(getattr(practical, "unit", "") or "")
        found = Threshold(value / 100 if percent else value, relative)
    if not (math.isfinite(found.value) and found.value > 0):
        raise InputError(Fault("practical", f"must be a positive difference, got {practical!r}"))
    return found


def _parse(text: str) -> Threshold:
    match = _TEXT.match(text)
    if match is None:
        raise InputError(
            Fault("practical", f"cannot read {text!r}", "write '0.5 pp', '0.05 N' or '5 % of mean'")
        )
    value, unit = float(match["value"]), " ".join((match["unit"] or "").split())
    if unit.replace(" ", "") == "%ofmean":
        return Threshold(value / 100, relative=True)
    if unit == "%":
        raise InputError(
            Fault("practical", f"{text!r} can mean two things", "write 'pp' or '% of mean'")
        )
    return Threshold(value)
