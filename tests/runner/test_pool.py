"""F01, F06, F07, F13: workers that die, hang or are stopped cost their own task alone."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from study.runner.pool import Outcome, Task, run_tasks

COMMAND = (sys.executable, str(Path(__file__).with_name("pool_worker.py")))


def task(key: str, kind: str = "work", needs: tuple[str, ...] = (), **values: Any) -> Task:
    return Task(key, lambda results: {"kind": kind, **values}, needs)


def run(tasks: list[Task], jobs: int = 2, **options: Any) -> dict[str, Outcome]:
    return {o.key: o for o in run_tasks(tasks, jobs=jobs, command=COMMAND, **options)}


def test_a_killed_worker_costs_its_own_task_alone() -> None:
    found = run([task("a"), task("bad", "die"), task("b"), task("c")])
    assert set(found) == {"a", "bad", "b", "c"}
    assert found["bad"].result["status"] == "crashed"
    assert "signal 9" in found["bad"].result["message"]
    assert all(found[k].result["value"] == 1 for k in "abc")


def test_a_task_whose_worker_died_is_tried_once_more(tmp_path: Path) -> None:
    found = run([task("a", "die once", mark=str(tmp_path / "mark"))], jobs=1)
    assert found["a"].result == {"status": "converged", "value": 1}


def test_a_task_that_never_ends_is_killed_and_says_so() -> None:
    began = time.monotonic()
    found = run([task("slow", "hang"), task("a")], timeout_s=1.5)
    assert found["slow"].result["status"] == "timeout"
    assert "1.5 s" in found["slow"].result["message"]
    assert found["a"].result["status"] == "converged"
    assert time.monotonic() - began < 20  # not the 60 s that the task wanted


def test_tasks_wait_for_what_they_need() -> None:
    def payload(results: Any) -> dict[str, Any]:
        return {"kind": "work", "value": results["first"]["value"]}

    found = run([Task("second", payload, ("first",)), task("first", value=10)])
    assert found["second"].result["value"] == 12


def test_what_is_finished_already_is_not_done_again() -> None:
    def payload(results: Any) -> dict[str, Any]:
        return {"kind": "work", "value": results["stored"]["value"]}

    found = run([Task("next", payload, ("stored",))], finished={"stored": {"value": 5}})
    assert list(found) == ["next"]
    assert found["next"].result["value"] == 6


def test_dependents_of_a_crash_are_told_and_not_left_waiting() -> None:
    seen: dict[str, Any] = {}

    def payload(results: Any) -> dict[str, Any]:
        seen.update(results["bad"])
        return {"kind": "work"}

    found = run([Task("next", payload, ("bad",)), task("bad", "die")], jobs=1)
    assert seen["status"] == "crashed"
    assert found["next"].result["status"] == "converged"


def test_a_need_that_nobody_makes_is_a_bug_and_raises() -> None:
    with pytest.raises(RuntimeError, match="nobody makes"):
        run([task("a", needs=("ghost",))])


def test_libraries_that_print_do_not_disturb_the_answers() -> None:
    assert run([task("a", "print")], jobs=1)["a"].result["value"] == 1


def test_every_worker_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    assert run([task("a", "threads")], jobs=1)["a"].result["threads"] == "1"


def test_leaving_early_kills_the_workers() -> None:
    outcomes = run_tasks([task("a"), task("slow", "hang")], jobs=2, command=COMMAND)
    assert next(outcomes).key == "a"
    outcomes.close()
    children = _children()
    assert not children, f"workers still alive: {children}"


def _children() -> list[str]:
    listed = Path(f"/proc/self/task/{os.getpid()}/children")
    return listed.read_text().split() if listed.exists() else []


def test_tasks_of_a_group_stay_with_one_worker() -> None:
    grouped = [
        Task(f"{g}{k}", lambda _: {"kind": "process"}, group=g) for k in range(3) for g in "ab"
    ]
    found = run(grouped)
    processes = {g: {found[f"{g}{k}"].result["process"] for k in range(3)} for g in "ab"}
    assert all(len(own) == 1 for own in processes.values())
    assert processes["a"] != processes["b"]
