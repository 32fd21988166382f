"""What a run says of the time that it still needs."""

from __future__ import annotations

import datetime

import pytest

from study.api import planning
from study.harness.record.store import Store
from study.harness.runner.batch import Progress

NOW = datetime.datetime(2026, 3, 1, 12, 0, tzinfo=datetime.UTC)


@pytest.fixture(autouse=True)
def _stopped_clock(monkeypatch):
    class Stopped(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return NOW

    monkeypatch.setattr(datetime, "datetime", Stopped)


def test_progress_is_noted_for_other_shells(tmp_path):
    shown: list[Progress] = []
    store = Store(tmp_path)
    with store.lock():
        planning.noted_progress(store, shown.append)(Progress(3, 10, 0, 5.0, 20.0, "a case"))
        running = store.running()
        assert running is not None
        assert (running["done"], running["total"], running["seconds_left"]) == (3, 10, 20.0)
        assert planning.seconds_left(running) == 20.0
    assert [state.seconds_left for state in shown] == [20.0]


def test_time_passes_after_a_note():
    ago = NOW - datetime.timedelta(seconds=50)
    noted = {"seconds_left": 60.0, "at": ago.isoformat()}
    assert planning.seconds_left(noted) == 10.0
    assert planning.seconds_left(noted | {"seconds_left": 20.0}) == 0.0


@pytest.mark.parametrize(
    "runner", [None, {}, {"pid": 1}, {"at": "now", "seconds_left": 1}, {"at": None}]
)
def test_a_runner_that_noted_nothing_has_no_time(runner):
    assert planning.seconds_left(runner) is None
