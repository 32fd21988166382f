"""Virtual recordings of a tracker whose errors are known: they are put in here."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.laboratory.registration.rigid import turned_about

#: What is put into the distance of stage "turn", mm.
TURN_BIAS = 0.30
#: Standard deviation of a visit's own error and of a sample's within it, mm.
VISIT_SD = 0.02
SAMPLE_SD = 0.05
STAGES = ("rest", "advance", "turn")


def write(path: Path, header: str, rows: Array | list[list[object]]) -> Path:
    """Write a CSV file."""
    lines = [",".join(str(v) for v in row) for row in rows]
    path.write_text(header + "\n" + "\n".join(lines) + "\n")
    return path


def distance_rows(
    seed: int, passes: int = 6, drift_mm_per_h: float = 0.0, samples: int = 40
) -> list[list[object]]:
    """Rows ``time, stage, ax, ay, az, bx, by, bz`` of two markers 50 mm apart.

    Samples of a visit have a common error and a serial correlation of 0.8.
    """
    rng = np.random.default_rng(seed)
    rows: list[list[object]] = []
    time = 0.0
    for _ in range(passes):
        for stage in STAGES:
            own = VISIT_SD * rng.standard_normal() + (TURN_BIAS if stage == "turn" else 0.0)
            noise = 0.0
            place = rng.uniform(-100, 100, 3)
            direction = rng.standard_normal(3)
            direction /= np.linalg.norm(direction)
            for _ in range(samples):
                noise = 0.8 * noise + 0.6 * SAMPLE_SD * rng.standard_normal()
                length = 50 + own + noise + drift_mm_per_h * time / 3600
                other = place + length * direction
                rows.append([round(time, 3), stage, *place.tolist(), *other.tolist()])
                time += 0.05
    return rows


def stage_rows(
    seed: int, scale: float, offset: float, sd: float, bow_mm: float = 0.0
) -> list[list[object]]:
    """Rows ``stage, commanded, x, y, z``: a stage that goes to ten stops and home, three times.

    Home is the stop at 0. ``offset`` is added to every other stop, ``bow_mm`` sideways in the
    middle.
    """
    rng = np.random.default_rng(seed)
    axis = np.array([2.0, -1.0, 2.0]) / 3
    side = np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    rows: list[list[object]] = []
    for number in range(3):
        for k, told in enumerate(np.linspace(0, 50, 11)):
            true = scale * told + (offset if told else 0.0) + sd * rng.standard_normal()
            sideways = bow_mm * 4 * told / 50 * (1 - told / 50)
            place = np.array([300.0, -20, 900]) + true * axis + sideways * side
            rows += [[f"{number}-{k}", told, *place.tolist()] for _ in range(3)]
    return rows


def pose_rows(
    seed: int, arm: Array, turn_deg: float, noise_mm: float, poses: int = 12
) -> tuple[list[list[object]], list[list[object]]]:
    """Recording ``pose, x, y, z`` and reference ``pose, x, y, z, ax, .., by, ..`` of poses.

    ``arm`` leads from the reference's point to the marker in the frame of the body, which is
    turned by about ``turn_deg`` from pose to pose.
    """
    rng = np.random.default_rng(seed)
    frame = turned_about(np.zeros(3), rng.standard_normal(3), np.array([1500.0, -200, 700]))
    seen: list[list[object]] = []
    known: list[list[object]] = []
    for k in range(poses):
        body = turned_about(
            np.zeros(3),
            np.radians(turn_deg) * rng.standard_normal(3),
            rng.uniform(-400, 400, 3),
        )
        origin, x, y, marker = body(np.array([[0, 0, 0], [100.0, 0, 0], [0, 100.0, 0], arm]))
        place = frame.inverse(marker[None])[0] + noise_mm * rng.standard_normal(3)
        seen += [[f"p{k}", *(place + 0.01 * rng.standard_normal(3)).tolist()] for _ in range(5)]
        known.append([f"p{k}", *origin.tolist(), *x.tolist(), *y.tolist()])
    return seen, known
