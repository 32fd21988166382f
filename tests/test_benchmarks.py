"""The benchmark's own parts: no peer is needed, and nothing is timed."""

import csv
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import launch, table
from benchmarks.__main__ import parsed, row
from benchmarks.cases import CASES, Case, oriented
from benchmarks.exchange import Task, midpoints
from benchmarks.peers import NAMES

TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def small(space):
    return Case("small", "", space, 10.0, 1.0, 2).task()


@pytest.mark.parametrize(("space", "volume"), [("3d", np.pi / 4), ("axisymmetric", np.pi)])
def test_the_volume_of_the_meshed_sector_is_that_of_the_half_cylinder(space, volume):
    assert small(space).volume_mm3 == pytest.approx(volume * 25.0**2 * 25.0, rel=1e-12)


def test_a_task_survives_its_file(tmp_path):
    task = small("axisymmetric")
    task.write(tmp_path / "task.npz")
    back = Task.read(tmp_path / "task.npz")
    np.testing.assert_array_equal(back.points, task.points)
    np.testing.assert_array_equal(back.cells, task.cells)
    assert (back.steps, back.c10, back.bulk) == (2, task.c10, task.bulk)
    assert back.plate_mm(1) == -0.125
    assert back.plate_mm(2) == -0.25


def test_the_exchanged_mesh_is_the_one_of_other_codes():
    cells = np.array([[0, 1, 2, 3], [0, 2, 1, 3]])
    np.testing.assert_array_equal(oriented(TETRAHEDRON, cells), [[0, 1, 2, 3], [0, 2, 3, 1]])
    points, cells = midpoints(TETRAHEDRON, np.array([[0, 1, 2, 3]]))
    expected = [[0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0], [0, 0, 0.5], [0.5, 0, 0.5], [0, 0.5, 0.5]]
    np.testing.assert_allclose(points[cells[0, 4:]], expected)
    task = small("3d")
    points, cells = midpoints(task.points, task.cells)  # neighbors share theirs
    assert len(np.unique(points.round(9), axis=0)) == len(points) == cells.max() + 1


def test_both_residuals_have_to_be_small():
    task = small("3d")
    assert task.unsolved(1e-9, 1.0, 0.0) == 1e-9
    assert task.unsolved(0.0, 1.0, task.volume_mm3) == pytest.approx(1.0)
    assert task.unsolved(0.0, 0.0, 0.0) == 1.0  # no reaction yet: nothing was solved


def test_an_absent_interpreter_gives_a_row_that_says_how_to_install(tmp_path):
    absent = {"felupe": str(tmp_path / "no-python")}
    found = launch.run("felupe", tmp_path, python=absent, repeats=1, limit_s=1.0, threads=1)
    made = row(CASES[0], "felupe", found, None)
    assert made["note"] == f"not installed: {NAMES['felupe'].install}"
    assert made["note"] in table.text(made)


def test_a_crash_and_a_hang_end_neither_the_bench_nor_its_other_rows():
    crash = [sys.executable, "-c", "raise SystemExit('out of luck')"]
    assert launch.waited(crash, dict(os.environ), 600.0) == "crashed (1): out of luck"
    hang = [sys.executable, "-c", "import time; time.sleep(600)"]
    assert launch.waited(hang, dict(os.environ), 0.2) == "stopped after 0 s"


def found(seconds, force=2.0):
    return {
        "unknowns": 10, "iterations": 3, "force_N": force, "peak_MB": 1024.0,
        "seconds": [seconds, 9.0, seconds], "cpu_s": [2.0], "solver": "LU", "parts_s": {},
    }  # fmt: skip


def test_the_fastest_peer_is_one_with_the_same_answer():
    parts = {"setup": 0.5, "assembly": 0.01, "total": 1.0}
    ours = row(CASES[3], "study", found(1.0) | {"parts_s": parts}, None)
    same = row(CASES[3], "felupe", found(1.5, 2.0 * (1 + 1e-9)), ours)
    other = row(CASES[3], "calculix", found(0.5, 2.02), ours)
    assert same["ratio"] == 1.5
    assert other["force_difference"] == pytest.approx(0.01)
    said = table.verdicts(CASES[3], [ours, same, other])
    assert said[0].startswith("1.50 times faster than the fastest peer")
    assert "(FElupe), asked 1.4: met" in said[0]
    assert said[1] == "peak memory 1.00 GB, asked at most 2.1: met"
    assert said[3] == "assembly's share of an iteration 2.00 %, asked at most 5: met"


@pytest.mark.parametrize("ending", ["json", "csv"])
def test_rows_are_written_for_other_programs(tmp_path, ending):
    path = Path(tmp_path / f"rows.{ending}")
    made = row(CASES[0], "study", found(1.0), None)
    table.write(path, [made, {"case": "a", "code": "felupe", "note": "diverged"}], {"cores": 2})
    if ending == "json":
        rows = json.loads(path.read_text("utf-8"))["rows"]
    else:
        rows = list(csv.DictReader(path.read_text("utf-8").splitlines()))
    assert float(rows[0]["seconds"]) == 1.0
    assert rows[1]["note"] == "diverged"


def test_options_name_known_codes(capsys):
    assert parsed(["--python", "felupe=/x/python"]).python == {"felupe": "/x/python"}
    with pytest.raises(SystemExit):
        parsed(["--python", "felup=/x/python"])
    assert "--python knows no code felup" in capsys.readouterr().err
