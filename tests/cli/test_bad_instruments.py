"""Wrong surfaces, scans, markers and recordings: what each verb says, and how to mend it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from study.cli.app import run
from study.laboratory.registration.iterative_closest_point import TriangleSurface
from tests.fem.surfaces import sphere, write
from tests.registration.bodies import egg, scan
from tests.shape_validation.test_shape import MOTION, cylinder, problem, write_csv, write_ply
from tests.tracker_accuracy import virtual
from tests.tracker_accuracy.test_tracking import (
    DISPLACEMENT,
    LASER,
    distance_study,
    reference_study,
)

SOLVE = """
schema = 1
[specimen]
shape = "surface"
file = "organ.stl"
unit = "{unit}"
clamp_below = "-2 mm"
[test]
kind = "indentation"
interface = "frictionless"
displacement = "0.4 mm"
steps = 1
indenter = {{ shape = "sphere", radius = "8 mm" }}
[material]
model = "neo-hookean"
C10 = "5 kPa"
poisson_ratio = 0.495
[model]
space = "3d"
element_order = "linear"
mesh = "coarse"
"""


def solving(folder: Path, *, factor: float = 1.0, left_out: int = 0, unit: str = "mm") -> list[str]:
    points, triangles = sphere(10, 3)
    write(folder / "organ.stl", (factor * points, triangles[left_out:]))
    (folder / "organ.toml").write_text(SOLVE.format(unit=unit))
    return ["solve", str(folder / "organ.toml")]


def shaping(
    folder: Path, change: Callable[[np.ndarray], np.ndarray], *, markers: int = 0, left_out: int = 0
) -> list[str]:
    whole = egg()
    body = TriangleSurface(whole.points, whole.triangles[left_out:])
    cloud = MOTION(change(scan(whole, 1500, np.random.default_rng(5))))
    command = ["shape", str(write_ply(folder / "body.ply", body))]
    command += ["--scan", str(write_csv(folder / "scan.csv", cloud))]
    if markers:
        command += ["--markers", str(write_csv(folder / "marks.csv", cloud[:markers]))]
    return [*command, "--reports", str(folder / "reports")]


def another_state(folder: Path) -> list[str]:
    cloud = write_csv(folder / "scan.csv", MOTION(cylinder(20.0, 30.0, 2000, 7)))
    return ["shape", str(problem(folder)), "--scan", str(cloud), "--reports", str(folder)]


def tracked(folder: Path, file: Path) -> list[str]:
    return ["tracking", str(file), "--data", str(folder), "--reports", str(folder / "reports")]


def clock_set_back(folder: Path) -> list[str]:
    file = distance_study(folder, 1)
    lines = (folder / "markers.csv").read_text().splitlines()
    lines[10], lines[11] = lines[11], lines[10]
    (folder / "markers.csv").write_text("\n".join(lines) + "\n")
    return tracked(folder, file)


def in_metres(folder: Path) -> list[str]:
    file = distance_study(folder, 1)
    file.write_text(file.read_text().replace('unit = "mm"', 'unit = "m"', 1))
    return tracked(folder, file)


def poses(
    folder: Path, kept: int = 12, *, mirrored: bool = False, shuffled: bool = False
) -> list[str]:
    file = reference_study(folder, 8, np.zeros(3), 5.0, 0.1)
    seen, known = virtual.pose_rows(8, np.zeros(3), 5.0, 0.1)
    if mirrored:
        seen = [[p, x, y, -z] for p, x, y, z in seen]
    if shuffled:
        known = [[row[0], *other[1:]] for row, other in zip(known, known[::-1], strict=True)]
    virtual.write(folder / "poses.csv", "pose,x,y,z", seen)
    virtual.write(folder / "laser.csv", LASER, known[:kept])
    return tracked(folder, file)


def two_stops(folder: Path) -> list[str]:
    rows = [row for row in virtual.rows_of(virtual.Errors(1)) if row[2] in (0.0, 50.0)]
    virtual.write(folder / "stage.csv", "time,stop,commanded,x,y,z", rows)
    (folder / "stage.toml").write_text(DISPLACEMENT)
    return tracked(folder, folder / "stage.toml")


def same(points: np.ndarray) -> np.ndarray:
    return points


CASES: dict[str, tuple[Callable[[Path], list[str]], int, str, str]] = {
    "solve, a hole": (
        lambda f: solving(f, left_out=3), 2, "is not closed", "fill the holes"),
    "solve, metres for millimetres": (
        lambda f: solving(f, factor=1e-3), 2, "0.02 mm large if its file is in mm", 'unit = "m"'),
    "solve, millimetres for metres": (
        lambda f: solving(f, unit="m"), 2, "2e+04 mm large if its file is in m", 'unit = "mm"'),
    "shape, a hole in the body": (
        lambda f: shaping(f, same, left_out=3), 2, "is not closed", "fill the holes"),
    "shape, metres for millimetres": (
        lambda f: shaping(f, lambda p: p / 1000), 2, "the simulated body", '--unit "m"'),
    "shape, a mirrored cloud": (
        lambda f: shaping(f, lambda p: p * [1, -1, 1]), 2, "is mirrored", "negate one coordinate"),
    "shape, too few markers": (
        lambda f: shaping(f, same, markers=2), 2, "has 2 markers, 3 or more", "mark more points"),
    "shape, no surface in the cloud": (
        lambda f: shaping(f, lambda p: p[:20]), 2, "has 20 points", "scan more of the body"),
    "shape, another state": (another_state, 3, "another state", "--any-state"),
    "tracking, the clock goes back": (
        clock_set_back, 2, "markers.csv:12: the time goes backwards", "sort the rows by time"),
    "tracking, metres for millimetres": (in_metres, 2, "mm apart", '"m" instead of "mm"'),
    "tracking, poses without a pair": (
        lambda f: poses(f, 9), 2, "poses do not pair", "the same labels in both files"),
    "tracking, poses in another order": (
        lambda f: poses(f, shuffled=True), 2, "the poses do not pair", "check the order"),
    "tracking, a mirrored frame": (
        lambda f: poses(f, mirrored=True), 2, "is mirrored", "exchange or negate one column"),
    "tracking, two stops": (two_stops, 2, "2 commanded positions", "stop at more positions"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_it_is_refused_with_a_way_to_mend_it(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make, code, rule, mend = CASES[case]
    command = make(tmp_path)
    assert run(command) == code
    told = " ".join(capsys.readouterr().err.split())
    assert rule in told
    assert mend in told
    assert not (tmp_path / "reports").exists()  # nothing is written


def test_outliers_are_counted_in_the_answer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    strewn = np.random.default_rng(3).uniform(-300, 300, (90, 3))
    assert run(shaping(tmp_path, lambda p: np.vstack([p, strewn]))) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "90 isolated points left out" in told
