"""F01, F06, F07, F13: tasks that die, hang or are stopped cost themselves alone."""

import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from threading import Timer

import pytest

from study.execution import local
from study.execution.cluster import Cluster
from study.execution.local import Answer, Inline, Loky, ReadyQueue, Supervisor, Task, Worker
from study.ground.errors import InputError
from tests.execution.loopback import ROOT, children
from tests.execution.misbehaving import line_of, never_up, perform, study_left, task
from tests.waiting import CAP_S, is_alive, state_of, until

#: limit of a task in seconds: a healthy one takes 0.07 s of a processor
LIMIT_S = 2.0


HERE = partial(Loky, perform)


@pytest.fixture(params=["here", "cluster"])
def make(request):
    """Make an executor on processes of this machine, or on the workers of a cluster."""
    if request.param == "here":
        return HERE
    return partial(Cluster, perform, request.getfixturevalue("cluster").file)


def run(tasks, jobs=2, limit_s=None, *, make=HERE, **more):
    return {o.key: o for o in make(jobs=jobs, limit_s=limit_s).run(tasks, **more)}


def limit_here(make=HERE):
    """Limit in seconds that a sound task keeps on this machine, however busy that is now."""
    began = time.perf_counter()
    run([task("a")], 1, make=make)
    return max(LIMIT_S, math.ceil(2 * (time.perf_counter() - began)))


def workers():
    """Worker processes that this process has, perhaps of an earlier test."""
    return {pid for pid, line in children(os.getpid()).items() if "popen_loky" in line}


def test_tasks_that_misbehave_cost_themselves_alone(make, tmp_path):
    ends = {
        "die": ("crashed", "signal 9"),
        "exit": ("crashed", "exit code 3"),
        "memory": ("out-of-memory", "out of memory"),
        "raise": ("failed", "ZeroDivisionError: a bug"),
        "nan": ("failed", "not JSON compliant"),
        "not plain": ("failed", "not JSON serializable"),
    }
    seen = {}

    def told(results):
        seen.update(results["die"])
        return {"kind": "work"}

    again = task("again", "die once", mark=str(tmp_path / "mark"))
    tasks = [*(task(kind, kind) for kind in ends), again, Task("next", told, ("die",)), task("a")]
    found = run(tasks, make=make)
    for kind, (status, said) in ends.items():
        assert found[kind].result["status"] == status
        assert said in found[kind].result["message"]
    assert found["a"].result["value"] == 1
    # one whose worker died is tried once more
    assert found["again"].result == {"status": "converged", "value": 1}
    # what waits for a crash is told of it, and not left waiting
    assert seen["status"] == "crashed"
    assert found["next"].result["status"] == "converged"


def test_a_need_that_nobody_makes_is_a_bug_and_raises():
    with pytest.raises(RuntimeError, match="nobody makes"):
        run([task("a", needs=("ghost",))])


def test_leaving_early_kills_the_workers():
    before = workers()
    outcomes = Loky(perform, 2).run([task("a"), task("slow", "hang")])
    assert next(outcomes).key == "a"
    outcomes.close()
    assert workers() <= before


def test_the_limit_holds_whatever_a_worker_does(make):
    limit_s = limit_here(make)
    kinds = ("hang", "hold the interpreter", "stopped")
    found = run([*(task(kind, kind) for kind in kinds), task("a")], 4, limit_s, make=make)
    for kind in kinds:
        assert found[kind].result["status"] == "timeout"
        assert f"{limit_s:g} s" in found[kind].result["message"]
    assert found["a"].result["status"] == "converged"


def test_a_worker_that_never_comes_up_is_given_up(monkeypatch):
    """No limit was asked for: only the start of a process has one of its own."""
    monkeypatch.setattr("study.execution.local.serve_quietly", never_up)
    monkeypatch.setattr("study.execution.local.START_LIMIT_S", 0.5)
    before = workers()
    found = run([task("a"), task("b")])
    assert {o.status for o in found.values()} == {"crashed"}
    assert "no worker was up within 0.5 s, twice" in found["a"].message
    assert workers() <= before


def test_a_pipe_that_nobody_reads_does_not_hold_the_owner():
    """A worker stops after its answer, and the next task is larger than any pipe."""
    outcomes = Loky(perform, 1, limit_here()).run(
        [task("a", "stop soon"), task("large", needs=("a",), text="x" * 30_000_000),
         task("next", needs=("large",))]
    )  # fmt: skip
    first = next(outcomes)
    assert first.status == "converged"
    until(lambda: state_of(first.result["process"]) == "T")
    assert [o.status for o in outcomes] == ["timeout", "converged"]


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_that_is_none_is_refused(make, limit):
    with pytest.raises(InputError, match="must be a positive number"):
        run([task("a")], limit_s=limit, make=make)


def test_outcomes_do_not_depend_on_the_executor(make):
    def value_of(key):
        return lambda results: {"kind": "work", "value": results[key]["value"]}

    tasks = [Task("b", value_of("a"), ("a",)), task("a", value=3), task("bad", "raise")]
    # what is finished already is not done again
    tasks.append(Task("next", value_of("stored"), ("stored",)))
    stored = {"stored": {"value": 5}}
    inline = {o.key: o.result for o in Inline(perform).run(tasks, stored)}
    apart = {key: o.result for key, o in run(tasks, make=make, finished=stored).items()}
    for found in (inline, apart):
        found["bad"].pop("traceback")
    assert inline == apart
    assert set(inline) == {"a", "b", "bad", "next"}
    assert inline["next"]["value"] == 6


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_no_worker_outlives_its_study(how):
    with study_left() as owner:
        pids = {int(line_of(owner)) for _ in range(2)}
        owner.send_signal(how)
        owner.wait(timeout=CAP_S)
    until(lambda: not any(is_alive(pid) for pid in pids))


def test_a_worker_whose_parent_died_before_it_was_up_ends():
    """Who asks for its parent's number that late gets another one, which never changes."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    code = "import sys, time; from study.execution.local import serve_quietly as serve\n"
    code += "serve(int(sys.argv[1])); time.sleep(600)"
    orphan = subprocess.run([sys.executable, "-c", code, str(gone.pid)], cwd=ROOT, check=False)
    assert orphan.returncode == -signal.SIGKILL


def test_workers_that_are_starting_end_with_a_killed_parent():
    with study_left() as owner:
        until(lambda: len(children(owner.pid)) >= 2)
        pids = set(children(owner.pid))
    until(lambda: not any(is_alive(pid) for pid in pids))


def test_tasks_of_a_group_stay_with_one_process_of_one_thread(make, monkeypatch):
    """Whatever this process has; and nothing of a worker is shown."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    grouped = [
        Task(f"{g}{k}", lambda _: {"kind": "process"}, group=g) for k in range(3) for g in "ab"
    ]
    found = run([*grouped, task("threads", "threads"), task("loud", "print")], make=make)
    assert found["threads"].result["threads"] == "1"
    assert found["loud"].result["value"] == 1
    processes = {g: {found[f"{g}{k}"].result["process"] for k in range(3)} for g in "ab"}
    assert all(len(own) == 1 for own in processes.values())
    assert processes["a"] != processes["b"]


def test_the_queue_grows_no_slower_than_its_tasks():
    """Looking at every task for every task took 10,000 of them 8 seconds: operations counted."""
    count = 2000
    tasks = [Task(str(k), lambda _: {}, group=str(k % 7)) for k in range(count)]
    ready = ReadyQueue(tasks, {})
    taken = [ready.take("") for _ in range(count)]
    assert [t.key for t in taken if t] == [t.key for t in tasks]
    assert ready.take("") is None
    assert ready._fronts == []


def test_the_longest_comes_first_and_what_others_wait_for_before_them():
    """Graham 1969: two workers end after 6, 5 and 6 + 5 where the long ones came last."""

    def nothing(results):
        return {}

    tasks = [
        Task("short", nothing, seconds=1),
        Task("case", nothing, ("fit",), seconds=2),
        Task("fit", nothing, seconds=3),
        Task("long", nothing, seconds=4),
        Task("g1", nothing, group="g", seconds=2.5),
        Task("g2", nothing, group="g", seconds=2),
    ]
    assert [t.key for t in local.longest_first(tasks)] == [
        "fit",
        "g1",
        "long",
        "case",
        "g2",
        "short",
    ]
    ready = ReadyQueue(tasks, {})
    assert [t.key for _ in range(4) if (t := ready.take(""))] == ["fit", "g1", "long", "g2"]


def test_no_more_run_at_once_than_there_is_room_for():
    """Predicted memory: two of 3 beside each other in 7, and one of 20 alone."""
    sizes = {"giant": 20.0, **{f"t{k}": 3.0 for k in range(6)}}
    running = []
    most = []

    class Counted:
        """Slot that does its task at once, and is told when it ends."""

        def start(self, payloads, done, ticket):
            running.append(sizes[payloads[0]])
            most.append(sum(running))
            Timer(0.02, self._end, (payloads[0], done, ticket)).start()

        def _end(self, key, done, ticket):
            running.remove(sizes[key])
            done.put((ticket, Answer('[{"status": "converged"}]')))

        def kill(self):
            """Nothing runs elsewhere."""

    tasks = [
        Task(key, lambda _, key=key: key, seconds=1.0, memory_MB=size)
        for key, size in sizes.items()
    ]
    found = list(
        Supervisor(ReadyQueue(tasks, {}), [Counted() for _ in range(4)], None, 7.0).outcomes()
    )
    assert len(found) == len(sizes)
    assert sorted(set(most)) == [3.0, 6.0, 20.0]


def short(key, kind="work", **values):
    return replace(task(key, kind, **values), seconds=0.02)


def test_short_tasks_go_to_a_worker_together_and_come_back_one_by_one():
    found = list(Loky(perform, 2).run([short(f"{k}", value=k) for k in range(40)]))
    assert {one.key: one.result["value"] for one in found} == {f"{k}": k + 1 for k in range(40)}
    # the last of those that came together has nothing behind it
    assert any(one.followed for one in found)
    assert not found[-1].followed


@pytest.mark.parametrize(("kind", "status"), [("die", "crashed"), ("hang", "timeout")])
def test_a_short_task_that_misbehaves_costs_those_beside_it_nothing(kind, status):
    tasks = [short("bad", kind), *(short(f"{k}") for k in range(30))]
    found = {one.key: one for one in Loky(perform, 2, limit_here()).run(tasks)}
    assert found.pop("bad").status == status
    assert {one.status for one in found.values()} == {"converged"}
    assert len(found) == 30


def test_results_are_kept_while_somebody_needs_them():
    ready = ReadyQueue([task("a"), task("b", needs=("a",)), task("c", needs=("a",))], {"x": {}})
    assert ready.results == {}
    for key, kept in (("a", {"a"}), ("b", {"a"}), ("c", set())):
        taken = ready.take("")
        assert taken is not None
        ready.finish(taken.key, {"status": key})
        assert set(ready.results) == kept


# A process beside this one: it works, and whatever becomes of it the call is made.


def where(text):
    return text, os.getpid()


def killed_elsewhere(home):
    if os.getpid() != home:
        os.kill(os.getpid(), signal.SIGKILL)
    return home


def test_a_call_is_made_in_another_process_that_ends_with_the_context():
    with Worker(dict) as worker:
        found, process = worker.begin(where, "there")()
    assert found == "there"
    assert process != os.getpid()
    until(lambda: not is_alive(process))


def test_a_death_or_what_cannot_be_sent_is_made_up_for_here():
    with Worker(dict) as worker:
        assert worker.begin(killed_elsewhere, os.getpid())() == os.getpid()
        assert worker.begin(where, "here")() == ("here", os.getpid())
    unsent = (number for number in range(3))
    with Worker(dict) as worker:
        assert worker.begin(sum, unsent)() == 3


def test_a_fault_of_the_call_is_raised_here():
    with Worker(dict) as worker:
        later = worker.begin(int, "none")
        with pytest.raises(ValueError, match="none"):
            later()
