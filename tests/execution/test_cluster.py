"""Tasks on a Dask cluster: as on this machine, and what is lost with workers and scheduler."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from study.execution.cluster import Cluster, Crew, Processes, differences
from study.ground.errors import InputError, RefusedError, SchedulerLostError
from tests.execution.loopback import children, loopback
from tests.execution.misbehaving import line_of, perform, study_left, task
from tests.waiting import CAP_S, until

distributed = pytest.importorskip("distributed", reason="Dask is not installed (extra 'dask')")
dask = pytest.importorskip("dask", reason="Dask is not installed (extra 'dask')")


@pytest.fixture(autouse=True)
def _looks_are_frequent_and_farewells_short(monkeypatch):
    """A worker that comes or goes is noticed sooner, and one that hangs is not waited for."""
    monkeypatch.setattr("study.execution.cluster.LOOK_S", 0.1)
    monkeypatch.setattr("study.execution.cluster.FAREWELL_S", 1.0)


def run(where, tasks, **options):
    return {o.key: o for o in Cluster(perform, where.file, **options).run(tasks)}


def worker_processes(cluster):
    """Command lines of the processes beside the workers."""
    lines = [line for worker in cluster.workers for line in children(worker.pid).values()]
    return [line for line in lines if "popen_loky" in line]


@pytest.mark.slow
def test_a_worker_that_its_nanny_starts_again_goes_on(tmp_path):
    """As `dask worker` starts them: children of a nanny, which may have no children of theirs."""
    with loopback(tmp_path, workers=0) as made:
        nanny = made.start_worker(nanny=True)
        seen = set()
        for outcome in Cluster(perform, made.file).run(
            [task(str(k), "process") for k in range(40)]
        ):
            assert outcome.status == "converged"
            seen.add(outcome.key)
            if len(seen) == 10:
                for child, line in children(nanny.pid).items():
                    if "spawn_main" in line:
                        os.kill(child, signal.SIGKILL)
        assert len(seen) == 40
        nanny.terminate()
        nanny.join(timeout=CAP_S)


def test_what_is_lost_with_workers_and_with_the_scheduler(tmp_path):
    """A worker costs what it was doing; a task that loses two is a failed case and says so.

    It may be what brings the machines down; others are done by the worker that comes. One that
    hangs holds nobody, and what is finished before the scheduler goes is kept.
    """
    with loopback(tmp_path) as made:
        tasks = [task(str(k), "process") for k in range(20)]
        seen = {}
        for outcome in Cluster(perform, made.file).run(tasks):
            seen[outcome.key] = outcome
            if len(seen) == 6:
                made.workers[0].kill()
        assert set(seen) == {task.key for task in tasks}
        assert {outcome.status for outcome in seen.values()} == {"converged"}
        mark = tmp_path / "mark"
        slow = task("slow", "hang", mark=str(mark))
        outcomes = Cluster(perform, made.file, jobs=1).run([slow, task("a")])
        killer = threading.Thread(target=_lose_twice, args=(made, mark))
        killer.start()
        found = {outcome.key: outcome for outcome in outcomes}
        killer.join()
        assert found["slow"].status == "crashed"
        assert "lost with its worker tcp://127.0.0.1" in found["slow"].message
        assert found["slow"].message.endswith(", twice")
        assert found["a"].status == "converged"

        outcomes = Cluster(perform, made.file).run([task("a"), task("b"), task("c")])
        assert sorted(next(outcomes).key for _ in range(3)) == ["a", "b", "c"]
        os.kill(made.workers[-1].pid, signal.SIGSTOP)
        assert list(outcomes) == []
        os.kill(made.workers[-1].pid, signal.SIGCONT)
        outcomes = Cluster(perform, made.file).run([task("a"), task("b"), task("slow", "hang")])
        assert sorted(next(outcomes).key for _ in range(2)) == ["a", "b"]
        made.scheduler.kill()
        with pytest.raises(SchedulerLostError, match="what is finished is kept") as lost:
            next(outcomes)
    assert "it resumes" in str(lost.value)
    assert lost.value.exit_code == 130


def begun(mark):
    """How often a task that hangs has begun."""
    return mark.read_text().count("begun") if mark.exists() else 0


def _lose_twice(made, mark):
    """Kill the worker while it hangs, and the next one, and start a third."""
    for k in range(2):
        until(lambda k=k: begun(mark) > k)
        made.workers[-1].kill()
        made.start_worker()


def test_a_worker_without_the_package_is_refused(tmp_path):
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "__init__.py").write_text("raise ImportError('no study here')\n")
    with loopback(tmp_path, workers=0) as made:
        made.start_worker(shadow=str(tmp_path))
        with pytest.raises(RefusedError, match="study cannot be imported there: .*no study here"):
            run(made, [task("a")])


def test_what_differs_is_named():
    here = {"a": "1", "b": "2"}
    assert differences(here, {"a": "1", "c": "3"}) == "b absent (here 2), c 3 (here absent)"
    assert differences(here, here) == ""
    assert differences(here, OSError("connection refused")) == "connection refused"


def test_a_study_waits_for_the_first_worker_and_a_later_one_gets_its_share(
    tmp_path, capsys, monkeypatch
):
    call = Crew._call_for_workers
    with loopback(tmp_path, workers=0) as made:

        def answered(crew):
            call(crew)
            if not made.workers:
                made.start_worker()

        monkeypatch.setattr(Crew, "_call_for_workers", answered)
        assert run(made, [task("a")])["a"].status == "converged"
        assert "waiting for a worker" in capsys.readouterr().err
        seen = set()
        tasks = [task(str(k), "process") for k in range(20)]
        for outcome in Cluster(perform, made.file).run(tasks):
            seen.add(outcome.result["process"])
            if len(made.workers) == 1:
                made.start_worker()
                until(lambda: "Registered to" in made.log(2))
        assert len(seen) == 2


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("scheduler.jsn", r"'scheduler.jsn' is no address and no file"),
        ("tcp://127.0.0.1:9", r"tcp://127.0.0.1:9 cannot be reached"),
    ],
)
def test_a_scheduler_that_is_none_is_refused(place, said, monkeypatch):
    monkeypatch.setattr("study.execution.cluster.PATIENCE_S", 0.5)
    with pytest.raises(InputError, match=said):
        list(Cluster(perform, place).run([]))


def certificate(folder, name):
    """Options of Dask with a certificate that is its own authority."""
    key, cert = folder / f"{name}.key", folder / f"{name}.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
         "-subj", f"/CN={name}", "-keyout", str(key), "-out", str(cert)],
        check=True, capture_output=True,
    )  # fmt: skip
    return ["--tls-ca-file", str(cert), "--tls-cert", str(cert), "--tls-key", str(key)]


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
def test_an_encrypted_cluster_lets_in_those_with_its_certificate(tmp_path, monkeypatch):
    own, foreign = certificate(tmp_path, "own"), certificate(tmp_path, "foreign")
    with loopback(tmp_path, workers=1, tls=own) as made:
        with dask.config.set(_tls(own)):
            assert run(made, [task("a")])["a"].status == "converged"
        monkeypatch.setattr("study.execution.cluster.PATIENCE_S", 3.0)
        with dask.config.set(_tls(foreign)), pytest.raises(InputError, match="certificate"):
            run(made, [task("a")])
        with pytest.raises(InputError, match="cannot be reached"):
            run(made, [task("a")])


def _tls(options):
    """What a file of Dask's configuration says of certificates."""
    ca, cert, key = options[1::2]
    place = "distributed.comm.tls"
    return {
        f"{place}.ca-file": ca, f"{place}.client.cert": cert, f"{place}.client.key": key,
    }  # fmt: skip


def test_processes_that_nobody_uses_end():
    """A study that was killed cannot say that it is over."""
    here = Processes()
    answer = here.perform(("gone", 0), perform, [{"kind": "process"}], None, lambda: False)
    process = int(answer.text.split('"process": ')[1].rstrip("}]"))
    here.end_idle(idle_s=60.0)
    assert Path(f"/proc/{process}").exists()
    here.end_idle(idle_s=0.0)
    assert not Path(f"/proc/{process}").exists()


# What one cluster is enough for stands last: it runs no longer than these tests.


def test_leaving_early_stops_the_tasks_of_this_run_alone(cluster, tmp_path):
    """Two studies on one cluster: the end of one is not that of the other."""
    slow = task("slow", "hang", mark=str(tmp_path / "mark"))
    mine = Cluster(perform, cluster.file, jobs=2).run([task("a"), slow])
    other = Cluster(perform, cluster.file, jobs=2).run([task(str(k), "process") for k in range(12)])
    found = [next(other)]
    assert next(mine).key == "a"
    until(lambda: begun(tmp_path / "mark"))
    mine.close()
    found += list(other)
    assert len(found) == 12
    assert {outcome.status for outcome in found} == {"converged"}
    # a worker that has nothing to do has no process left, ours nor theirs
    until(lambda: not worker_processes(cluster))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_task_outlives_its_study(cluster, how):
    """However it ends, the workers notice and stop what nobody waits for."""
    with study_left(str(cluster.file)) as owner:
        assert int(line_of(owner))
        until(lambda: all(children(worker.pid) for worker in cluster.workers))
        owner.send_signal(how)
        owner.wait(timeout=CAP_S)
    busy = "" if how == signal.SIGINT else "idle processes end a minute later"
    until(lambda: busy or not worker_processes(cluster))
    # whatever was left, the threads of the workers are free for the next study
    assert run(cluster, [task("a"), task("b")])["a"].status == "converged"


def test_a_worker_with_other_versions_is_refused_with_the_differences(cluster):
    with pytest.raises(RefusedError, match="would not give the numbers") as refused:
        run(cluster, [task("a")], identity=_of_process)
    assert "numpy 1.0 (here 2.0)" in str(refused.value)
    assert "2 workers" in str(refused.value)


def _of_process():
    """Versions that differ between the study and the processes of the cluster."""
    is_worker = any("dask_worker" in word for word in sys.argv)
    return {"numpy": "1.0" if is_worker else "2.0"}


def test_files_that_tasks_read_travel_with_the_study(cluster, tmp_path):
    """A worker on another machine sees no file of ours; its copy goes when the run ends."""
    path = tmp_path / "a surface.stl"
    path.write_text("solid")
    tasks = [task(k, "read", path=str(path)) for k in "abc"]
    found = run(cluster, tasks, files=[path])
    assert {outcome.result["text"] for outcome in found.values()} == {"solid"}
    places = {str(outcome.result["path"]) for outcome in found.values()}
    assert str(path) not in places
    assert {Path(place).suffix for place in places} == {".stl"}
    assert not any(Path(place).exists() for place in places)


def test_a_client_that_was_given_stays_open(cluster):
    with distributed.Client(scheduler_file=str(cluster.file), set_as_default=False) as client:
        for _ in range(2):
            found = list(Cluster(perform, client).run([task("a"), task("b")]))
            assert [outcome.status for outcome in found] == ["converged"] * 2
        assert client.status == "running"
