"""A process beside this one: it works, and whatever becomes of it the call is made."""

from __future__ import annotations

import os
import signal

import pytest

from study.harness.execution.local import Worker
from tests.waiting import is_alive, until


def where(text: str) -> tuple[str, int]:
    return text, os.getpid()


def killed_elsewhere(home: int) -> int:
    if os.getpid() != home:
        os.kill(os.getpid(), signal.SIGKILL)
    return home


def test_a_call_is_made_in_another_process_that_ends_with_the_context() -> None:
    with Worker(dict) as worker:
        found, process = worker.begin(where, "there")()
    assert found == "there"
    assert process != os.getpid()
    until(lambda: not is_alive(process))


def test_a_death_or_what_cannot_be_sent_is_made_up_for_here() -> None:
    with Worker(dict) as worker:
        assert worker.begin(killed_elsewhere, os.getpid())() == os.getpid()
        assert worker.begin(where, "here")() == ("here", os.getpid())
    unsent = (number for number in range(3))
    with Worker(dict) as worker:
        assert worker.begin(sum, unsent)() == 3


def test_a_fault_of_the_call_is_raised_here() -> None:
    with Worker(dict) as worker:
        later = worker.begin(int, "none")
        with pytest.raises(ValueError, match="none"):
            later()
