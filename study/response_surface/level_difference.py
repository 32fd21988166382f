"""What another level of a factor without numbers changes, over the ranges of the numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.response_surface.emulator.blocked import BlockedEmulator
from study.response_surface.emulator.effect_ranges import ERRORS, SETTINGS, SHARE, Verdict
from study.response_surface.emulator.emulator import Emulator
from study.response_surface.extremes import box_points


@dataclass(frozen=True)
class LevelDifference:
    """Difference of a response at one level from that at another, with the same numbers.

    Parameters
    ----------
    factor, level, other : str
        The factor; the response at ``level`` less that at ``other``.
    mean, low, high : float
        Over the ranges: mean, and ends of what 95 % of the settings have, in the response's unit.
    bound : float
        Half width around them: twice the largest leave-one-out errors, and numerical uncertainty.
    verdict : {"matters", "no practical difference", "cannot tell"}
        Whether it matters at some settings; no difference means at none.
    """

    factor: str
    level: str
    other: str
    mean: float
    low: float
    high: float
    bound: float
    verdict: Verdict

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return dict(vars(self))


def level_difference(
    names: tuple[str, str, str],
    models: tuple[Emulator | BlockedEmulator, Emulator | BlockedEmulator],
    practical: float | None,
    u: float = 0.0,
) -> LevelDifference:
    """Compare the emulators of two levels.

    Parameters
    ----------
    names : tuple of str
        The factor, the level, and the one it is compared with.
    models : tuple of Emulator or BlockedEmulator
        Of these two levels, over the same factors.
    practical : float or None
        Smallest difference that matters, in the response's unit.
    u : float
        Bound of the numerical error of a difference, in the same unit.
    """
    points = box_points(len(models[0].runs.factors), SETTINGS)
    told = [one.predict(points) for one in models]
    change = told[0][0] - told[1][0]
    half = np.hypot(told[0][1], told[1][1])
    largest = [float(np.abs(one.loo_errors).max()) for one in models]
    bound = ERRORS * float(np.hypot(largest[0], largest[1])) + u
    verdict: Verdict = "cannot tell"
    if practical is not None and all(one.gate == "given" for one in models):
        if float(np.quantile(np.abs(change), SHARE)) - bound > practical:
            verdict = "matters"
        elif float((np.abs(change) + half).max()) + u < practical:
            verdict = "no practical difference"
    tail = 0.5 * (1.0 - SHARE)
    low, high = (float(q) for q in np.quantile(change, [tail, 1.0 - tail]))
    return LevelDifference(*names, float(change.mean()), low, high, bound, verdict)
