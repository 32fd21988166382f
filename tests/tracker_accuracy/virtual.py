"""Virtual recordings of a tracker whose errors are known: they are put in here."""

import numpy as np

from study.laboratory.registration.rigid import turned_about
from study.laboratory.tracker.tracker_recording import recorded


def write(path, header, rows):
    """Write a CSV file."""
    lines = [",".join(str(v) for v in row) for row in rows]
    path.write_text(header + "\n" + "\n".join(lines) + "\n")
    return path


def rows_of(errors, apart_mm=None, **changes):
    """Rows of the shipped generator, ``time, stage, ..``, of two markers so far apart, or of one.

    A single marker has its commanded position besides. Changes are a drift of the second marker,
    ``drift_mm_per_h``, and how far the middle of the way lies sideways, ``bow_mm``.
    """
    axis, side = np.array([2.0, -1.0, 2.0]) / 3, np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    rows = []
    for sample in recorded(errors, 1 if apart_mm is None else 2, apart_mm or 0.0):
        share = sample.commanded_mm / 50
        places = sample.places_mm + 4 * changes.get("bow_mm", 0.0) * share * (1 - share) * side
        places[1:] += changes.get("drift_mm_per_h", 0.0) * sample.time_s / 3600 * axis
        told = [sample.commanded_mm] if apart_mm is None else []
        rows.append([round(sample.time_s, 3), sample.stage, *told, *places.ravel().tolist()])
    return rows


def pose_rows(seed, arm, turn_deg, noise_mm, poses=12):
    """Recording ``pose, x, y, z`` and reference ``pose, x, y, z, ax, .., by, ..`` of poses.

    ``arm`` leads from the reference's point to the marker in the frame of the body, which is
    turned by about ``turn_deg`` from pose to pose.
    """
    rng = np.random.default_rng(seed)
    frame = turned_about(np.zeros(3), rng.standard_normal(3), np.array([1500.0, -200, 700]))
    seen = []
    known = []
    for k in range(poses):
        body = turned_about(
            np.zeros(3), np.radians(turn_deg) * rng.standard_normal(3), rng.uniform(-400, 400, 3)
        )
        origin, x, y, marker = body(np.array([[0, 0, 0], [100.0, 0, 0], [0, 100.0, 0], arm]))
        place = frame.inverse(marker[None])[0] + noise_mm * rng.standard_normal(3)
        seen += [[f"p{k}", *(place + 0.01 * rng.standard_normal(3)).tolist()] for _ in range(5)]
        known.append([f"p{k}", *origin.tolist(), *x.tolist(), *y.tolist()])
    return seen, known
