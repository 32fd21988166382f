"""What a run says of the time that it still needs."""

from __future__ import annotations

import datetime

import pytest

from study.api import planning

NOW = datetime.datetime(2026, 3, 1, 12, 0, tzinfo=datetime.UTC)
AGO = (NOW - datetime.timedelta(seconds=50)).isoformat()


class Stopped(datetime.datetime):
    @classmethod
    def now(cls, tz=None):
        return NOW


@pytest.mark.parametrize(
    ("noted", "left"),
    [
        ({"seconds_left": 60.0, "at": AGO}, 10.0),
        ({"seconds_left": 20.0, "at": AGO}, 0.0),
        *((note, None) for note in (None, {}, {"pid": 1}, {"at": "now", "seconds_left": 1})),
        ({"at": None}, None),
    ],
)
def test_time_passes_after_a_note_and_without_one_nothing_is_said(monkeypatch, noted, left):
    monkeypatch.setattr(datetime, "datetime", Stopped)
    assert planning.seconds_left(noted) == left
