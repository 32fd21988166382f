"""Time that a run still needs, learned from what it has done."""

from __future__ import annotations

from collections.abc import Mapping

from study.runner.costs import Costs

#: share of the work after which what was done is believed more than a prediction
_ENOUGH = 0.05


class Pace:
    """Predicted seconds of computations, corrected by those that are done.

    Computations of one kind cost alike: what one of them took tells more of the next than what
    others took. A kind of which none is done yet goes at the pace of all.

    Parameters
    ----------
    prices : mapping of str to float
        Predicted seconds of every computation.
    kinds : mapping of str to str
        Kind of every computation.
    workers : int
        Computations that run side by side.
    """

    def __init__(self, prices: Mapping[str, float], kinds: Mapping[str, str], workers: int) -> None:
        self._left, self._kinds, self._workers = dict(prices), kinds, workers
        self._enough = _ENOUGH * sum(prices.values())
        self._predicted: dict[str, float] = {}
        self._taken: dict[str, float] = {}

    def finished(self, key: str, seconds: float) -> None:
        """Count a computation that kept a worker busy for so many seconds."""
        kind, price = self._kinds[key], self._left.pop(key)
        self._predicted[kind] = self._predicted.get(kind, 0.0) + price
        self._taken[kind] = self._taken.get(kind, 0.0) + seconds

    def seconds_left(self) -> float:
        """Wall time of the rest."""
        predicted = sum(self._predicted.values())
        if predicted < self._enough or not predicted:
            return Costs.side_by_side(list(self._left.values()), self._workers)
        usual = sum(self._taken.values()) / predicted
        own = {kind: self._taken[kind] / price for kind, price in self._predicted.items() if price}
        rest = [price * own.get(self._kinds[key], usual) for key, price in self._left.items()]
        return Costs.side_by_side(rest, self._workers)
