"""Time that is left, foretold from what is done."""

from __future__ import annotations

import pytest

from study.harness.runner.cost import Pace

PRICES = {"plane 1": 1.0, "plane 2": 1.0, "solid 1": 20.0, "solid 2": 20.0, "other": 4.0}
KINDS = {key: key.split()[0] for key in PRICES}


def test_the_prediction_counts_until_enough_is_done() -> None:
    pace = Pace(PRICES, KINDS, workers=2)
    assert pace.seconds_left() == pytest.approx(46 / 2)
    pace.finished("plane 1", 30.0)
    assert pace.seconds_left() == pytest.approx(45 / 2)


def test_every_kind_goes_at_its_own_pace_and_a_new_one_at_that_of_all() -> None:
    pace = Pace(PRICES, KINDS, workers=2)
    pace.finished("solid 1", 40.0)
    pace.finished("plane 1", 0.5)
    usual = 40.5 / 21
    assert pace.seconds_left() == pytest.approx(max((0.5 + 40 + 4 * usual) / 2, 40))
    pace.finished("solid 2", 40.0)
    usual = 80.5 / 41
    assert pace.seconds_left() == pytest.approx(max((0.5 + 4 * usual) / 2, 4 * usual))
    pace.finished("plane 2", 0.5)
    pace.finished("other", 1.0)
    assert pace.seconds_left() == 0.0


def test_free_computations_tell_nothing() -> None:
    pace = Pace({"a": 0.0, "b": 0.0}, {"a": "x", "b": "x"}, workers=1)
    pace.finished("a", 3.0)
    assert pace.seconds_left() == 0.0
