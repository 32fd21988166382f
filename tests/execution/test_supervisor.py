"""What a supervisor makes of answers that no worker of ours gives."""

import pytest

from study.execution.local import Answer, ReadyQueue, Supervisor, Task


class Liar:
    """A slot whose answers are what somebody else made of them."""

    def __init__(self, answers):
        self.answers, self.killed = answers, 0

    def start(self, payloads, done, ticket):
        done.put((ticket, Answer(self.answers.pop(0))))
        return

    def kill(self):
        self.killed += 1


GOOD = '[{"status": "converged"}]'


@pytest.mark.parametrize(
    "bad", ["[" * 100_000, "", "[]", "null", '"text"', "{", '[{"status": 1}]', f"[{GOOD}]"]
)
def test_an_answer_that_is_no_result_costs_its_own_case_alone(bad):
    tasks = [Task(name, lambda results: {}) for name in "ab"]
    slot = Liar([bad, bad, GOOD])
    outcomes = list(Supervisor(ReadyQueue(tasks, {}), [slot]).outcomes())
    assert sorted(one.result["status"] for one in outcomes) == ["converged", "crashed"]
    (crashed,) = [one.result for one in outcomes if one.result["status"] == "crashed"]
    assert "answer" in crashed["message"]
    assert slot.killed == 3
