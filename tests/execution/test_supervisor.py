"""What a supervisor makes of answers that no worker of ours gives."""

from __future__ import annotations

import pytest

from study.harness.execution.supervisor import Answer, Done, ReadyQueue, Supervisor
from study.harness.execution.task import Task


class Liar:
    """A slot whose answers are what somebody else made of them."""

    def __init__(self, answers: list[str]) -> None:
        self.answers, self.killed = answers, 0

    def start(self, payloads: list[object], done: Done, ticket: object) -> bool | None:
        done.put((ticket, Answer(self.answers.pop(0))))
        return None

    def kill(self) -> None:
        self.killed += 1


GOOD = '[{"status": "converged"}]'


@pytest.mark.parametrize(
    "bad", ["[" * 100_000, "", "[]", "null", '"text"', "{", '[{"status": 1}]', f"[{GOOD}]"]
)
def test_an_answer_that_is_no_result_costs_its_own_case_alone(bad: str) -> None:
    tasks = [Task(name, lambda results: {}) for name in "ab"]
    slot = Liar([bad, bad, GOOD])
    outcomes = list(Supervisor(ReadyQueue(tasks, {}), [slot]).outcomes())
    assert sorted(one.result["status"] for one in outcomes) == ["converged", "crashed"]
    (crashed,) = [one.result for one in outcomes if one.result["status"] == "crashed"]
    assert "answer" in crashed["message"]
    assert slot.killed == 3
