"""`study run --scheduler`: a study on a Dask cluster gives the numbers of this machine."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from study import api
from tests.cli.small import refusal, study
from tests.execution.loopback import ROOT, loopback
from tests.fem.surfaces import box, write
from tests.forward.test_command import DESIGN as PROGRAMS
from tests.forward.test_command import force
from tests.runner.conftest import DESIGN, make_data
from tests.runner.test_surfaces import DESIGN as SURFACE
from tests.waiting import CAP_S, until

pytest.importorskip("distributed", reason="Dask is not installed (extra 'dask')")

#: finite elements, calibration and a refinement in seconds
FEM = (
    DESIGN.replace('mesh = "coarse"', 'mesh_size = "6 mm"')
    .replace("steps = 10", "steps = 3")
    .replace("swap = true", "")
    .replace('material = ["neo-hookean", "mooney-rivlin"]\n', "")
    .replace('[presets.material.neo-hookean]\nmodel = "neo-hookean"\n', "")
    .replace('[presets.material.mooney-rivlin]\nmodel = "mooney-rivlin"\n', "")
    .replace("[material]\n", '[material]\nmodel = "neo-hookean"\n')
) + '[report]\nformat = ["csv"]\n'


#: a closed form, and a program that gives its answer only when a file is there
HELD = PROGRAMS.replace(', "differences", "gradients"]', ', "gradients"]').replace(
    'name = "programs"', 'name = "small"'
)


@pytest.fixture
def held(tmp_path):
    """A study that cannot end before the file `go` is there, on a machine of any speed."""
    (tmp_path / "small.toml").write_text(HELD)
    (tmp_path / "solvers").mkdir()
    solver = (ROOT / "designs/solvers/closed_form.py").read_text()
    wait = f"""import pathlib, time
pathlib.Path({str(tmp_path / "begun")!r}).touch()
while not pathlib.Path({str(tmp_path / "go")!r}).exists():
    time.sleep(0.1)
"""
    (tmp_path / "solvers/closed_form.py").write_text(
        solver.replace("import csv\n", f"{wait}import csv\n", 1)
    )
    (tmp_path / "data").mkdir()
    rows = [f"{d!r},{force(d)!r}" for d in (5.2 * k / 40 for k in range(41))]
    (tmp_path / "data/m.csv").write_text("d,f\n" + "\n".join(rows) + "\n")
    return tmp_path


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "small.toml").write_text(FEM)
    make_data(tmp_path, ("M1", "M2"))
    return tmp_path


def started(folder, cluster, *options):
    """`study run` on a cluster, in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "study", "run", "small.toml", "--data", "data",
         "--scheduler", str(cluster.file), "--json", *options],
        cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])},
        # a shell in the background hands on that Ctrl-C is ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def kept_of(folder):
    """Fits and records that are on disk; fits come first, and take nearly all of the time."""
    home = folder / "results" / "small"
    return [*(home / "fits").glob("*.json"), *(home / "cases").rglob("*.json")]


def numbers(record):
    """Everything of a record but the times that it took."""
    return without_times(json.loads(record.to_json())["content"])


def without_times(document):
    if isinstance(document, dict):
        kept = {k: v for k, v in document.items() if k not in ("seconds", "timings")}
        return {k: without_times(v) for k, v in kept.items()}
    return [without_times(v) for v in document] if isinstance(document, list) else document


def assert_equal(found, expected):
    """The same tables, records and numerical uncertainty, bit for bit."""
    there, here = (one.table.drop(columns="seconds") for one in (found, expected))
    assert there.equals(here)
    for one, other in zip(found.records, expected.records, strict=True):
        assert numbers(one) == numbers(other)
    assert {"responses", "curves", "fit"} <= set(numbers(found.records[0]))
    assert found.numerical == expected.numerical
    assert len(found.numerical) > 0


@pytest.mark.slow
@pytest.mark.usefixtures("processes")  # a solver that other tests used may round otherwise
def test_a_study_that_loses_a_worker_gives_the_table_of_a_local_run(folder, tmp_path):
    cluster_folder = tmp_path / "cluster"
    cluster_folder.mkdir()
    with loopback(cluster_folder) as cluster:
        run = started(folder, cluster)
        until(lambda: len(kept_of(folder)) >= 2 or run.poll() is not None)
        cluster.workers[0].kill()
        out, err = run.communicate(timeout=CAP_S)
    assert run.returncode == 0, err
    assert json.loads(out)["cases"] == {"total": 4, "done": 4, "failed": 0, "missing": 0}
    local = api.run(
        folder / "small.toml", data=folder / "data", jobs=2, results=tmp_path / "local",
        reports=None,
    )  # fmt: skip
    assert_equal(api.load(folder / "results" / "small"), local)


LONG = (pytest.mark.slow, pytest.mark.verify)


@pytest.mark.parametrize("lost", ["scheduler", pytest.param("terminal", marks=LONG)])
def test_a_study_that_is_stopped_keeps_what_is_finished_and_resumes(held, tmp_path, lost):
    """Where its scheduler is gone it goes on here; after Ctrl-C the cluster is there as before."""
    plan = study("plan", held / "small.toml", "--data", held / "data", "--json").json
    options = ("--allow-digest", plan["commands_digest"])
    cluster_folder = tmp_path / "cluster"
    cluster_folder.mkdir()
    again = ["run", held / "small.toml", "--data", held / "data", "--results", held / "results"]
    with loopback(cluster_folder, workers=2 if lost == "scheduler" else 1) as cluster:
        run = started(held, cluster, *options)
        if lost == "scheduler":
            until(lambda: kept_of(held) or run.poll() is not None)
            cluster.scheduler.kill()
        else:
            until(lambda: (held / "begun").exists() or run.poll() is not None)
            run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=CAP_S)
        assert run.returncode == 130, err
        assert ("the scheduler of the cluster is gone" in err) is (lost == "scheduler")
        assert "what is finished is kept" in err
        assert "Traceback" not in err, err
        kept = {path: path.read_bytes() for path in kept_of(held)}
        assert kept or lost != "scheduler"
        (held / "go").touch()
        where = ("--jobs", 1) if lost == "scheduler" else ("--scheduler", cluster.file)
        resumed = study(*again, *where, "--json", *options)
    assert resumed.json["cases"] == {"total": 2, "done": 2, "failed": 0, "missing": 0}
    assert {path: path.read_bytes() for path in kept} == kept


def test_a_scheduler_that_is_not_there_is_refused_and_nothing_is_written(folder, monkeypatch):
    monkeypatch.chdir(folder)
    answer = refusal("run", "small.toml", "--data", "data", "--scheduler", "nowhere.json")
    assert "'nowhere.json' is no address and no file" in answer.err
    assert "tls://HOST:PORT" in answer.err
    assert not (folder / "results").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("processes")
def test_a_surface_goes_to_workers_that_do_not_see_its_file(tmp_path):
    """The file is gone as soon as something is computed: workers read the copies that they got."""
    designs, data, place = (tmp_path / name for name in ("designs", "data", "cluster"))
    for folder in (designs, data, place):
        folder.mkdir()
    write(designs / "box.stl", box(10, 8, 6))
    (designs / "design.toml").write_text(SURFACE)
    rows = [f"{s},{d:.3f},{0.45 * d:.5f}" for s in "ab" for d in np.linspace(0, 0.7, 15)]
    (data / "tests.csv").write_text("\n".join(["specimen,d,f", *rows, ""]))
    found = {}
    with loopback(place) as cluster:
        for name, engine in (("here", None), ("there", cluster.file)):

            def hide(state, name=name):
                if name == "there":
                    (designs / "box.stl").unlink(missing_ok=True)

            found[name] = api.run(
                designs / "design.toml", data=data, results=tmp_path / name, reports=None,
                jobs=2 if engine is None else None, engine=engine, progress=hide, refine=False,
            )  # fmt: skip
    assert not (designs / "box.stl").exists()
    assert found["there"].cases == {"total": 4, "done": 4, "failed": 0, "missing": 0}
    here, there = (found[name].table.drop(columns="seconds") for name in ("here", "there"))
    assert there.equals(here)
