"""Virtual recordings of a tracker whose errors are known, for trying a file of ``study tracking``.

The generator, in full. Two markers on a needle, as far apart as their standard says (80 mm where
spheres tell it), ride on a stage that goes from home by stops of 10 mm to 50 mm, holds, goes back
by the same stops, and is home again: four stages of the motion, six times over. Each stop errs
along the axis, each visit to a stage errs in the distance, each sample has noise that goes together
with that of the sample before; the stage is followed with a scale, and the distance is wrong by a
bias while the needle retracts. All errors are normal, and ``.virtual.json`` beside the recording
tells their sizes.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.ground.units import unit_factor
from study.harness.record.atomic_files import write_atomic
from study.laboratory.tracker.tracker_recording import RecordingTable, TrackingFile

#: stages of the motion with the stops of each, mm
STAGES = (
    ("home", (0.0,)),
    ("advance", (10.0, 20.0, 30.0, 40.0)),
    ("hold", (50.0,)),
    ("retract", (40.0, 30.0, 20.0, 10.0)),
)
#: stage in which the distance is wrong
BIASED = "retract"
#: distance of the markers where no number says it, mm
_APART_MM = 80.0
#: radius of scanned spheres, mm
_RADIUS_MM = 6.0
_SCANNED = 400
#: their noise, mm
_SCAN_SD_MM = 0.02
#: part of a sphere's height that the scanner sees
_SEEN = 0.4
#: direction of the needle and place of its tip at home, mm
_AXIS = np.array([2.0, -1.0, 2.0]) / 3
_HOME_MM = np.array([300.0, -20.0, 900.0])


@dataclass(frozen=True)
class Errors:
    """Errors that are put in."""

    seed: int = 2011
    #: How often the motion is made, and samples at each stop.
    passes: int = 6
    samples: int = 40
    interval_s: float = 0.05
    scale: float = 1.003
    #: Standard deviations: of a stop along the axis, of the distance in a visit to a stage, and of
    #: a coordinate in a sample.
    stop_sd_mm: float = 0.03
    visit_sd_mm: float = 0.02
    sample_sd_mm: float = 0.05
    #: Of the noise of a sample with that of the sample before.
    correlation: float = 0.8
    #: Of the distance while the needle retracts.
    bias_mm: float = 0.15


@dataclass(frozen=True)
class TrackerSample:
    """One row of a recording: time, stage, commanded position and places of markers, mm."""

    time_s: float
    stage: str
    commanded_mm: float
    places_mm: Array


def write_recording(declared: TrackingFile, out: Path, errors: Errors | None = None) -> list[Path]:
    """Write the recording, and the scans of spheres, that a tracking file reads."""
    if declared.reference is not None:
        mend = "leave [reference] out, and give [distance] or [displacement]"
        raise InputError(Fault("reference", "virtual recordings have no reference", mend))
    errors = errors or Errors()
    distance, recording = declared.distance, declared.recording
    apart = (distance.reference if distance else None) or _APART_MM
    samples = list(recorded(errors, len(recording.markers), apart))
    texts = {recording.file: _recording(declared, recording, samples)}
    texts[f"{recording.file}.virtual.json"] = json.dumps(
        {"errors": asdict(errors), "distance_mm": apart, "biased_stage": BIASED}, indent=2
    )
    if distance is not None and distance.spheres is not None:
        random = np.random.default_rng([errors.seed, 1])
        factor = unit_factor(distance.unit, "length")
        for file, along in zip(distance.spheres, (0.0, apart), strict=True):
            center = _HOME_MM + along * _AXIS
            z = 1 - 2 * _SEEN * random.random(_SCANNED)
            turn = 2 * np.pi * random.random(_SCANNED)
            flat = np.sqrt(1 - z**2)
            normals = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
            radii = _RADIUS_MM + _SCAN_SD_MM * random.standard_normal((_SCANNED, 1))
            cloud = np.asarray(center + radii * normals) / factor
            texts[file] = _csv(distance.columns, [[f"{v:.6g}" for v in row] for row in cloud])
    for name, text in texts.items():
        write_atomic(out / name, text.encode())
    return [out / name for name in texts]


def recorded(errors: Errors, markers: int, apart_mm: float) -> Iterator[TrackerSample]:
    """Give samples in their order.

    Shapes: returns (markers, 3).

    Examples
    --------
    >>> rows = list(recorded(Errors(passes=2, samples=3), 2, 80.0))
    >>> len(rows), rows[0].stage, rows[-1].commanded_mm
    (60, 'home', 10.0)
    """
    random = np.random.default_rng(errors.seed)
    noise, time = np.zeros((markers, 3)), 0.0
    fresh = errors.sample_sd_mm * np.sqrt(1 - errors.correlation**2)
    for _ in range(errors.passes):
        for stage, stops in STAGES:
            wrong = errors.visit_sd_mm * random.standard_normal()
            wrong += errors.bias_mm if stage == BIASED else 0.0
            for commanded in stops:
                along = errors.scale * commanded + errors.stop_sd_mm * random.standard_normal()
                spots = along + np.arange(markers) * (apart_mm + wrong)
                for _ in range(errors.samples):
                    noise = errors.correlation * noise + fresh * random.standard_normal(noise.shape)
                    yield TrackerSample(
                        time, stage, commanded, _HOME_MM + spots[:, None] * _AXIS + noise
                    )
                    time += errors.interval_s


def _recording(
    declared: TrackingFile, recording: RecordingTable, samples: Sequence[TrackerSample]
) -> str:
    """CSV of the recording, with the columns that the file names."""
    moved, mark = declared.displacement, recording.decimal
    columns = [name for name in (recording.time, recording.stage) if name]
    columns += [moved.commanded] if moved else []
    columns += [column for triple in recording.markers.values() for column in triple]
    factor = unit_factor(recording.unit, "length")
    per_mm = unit_factor(moved.unit, "length") if moved else 1.0
    rows = []
    for sample in samples:
        row = [f"{sample.time_s:.3f}"] if recording.time else []
        row += [sample.stage] if recording.stage else []
        row += [f"{sample.commanded_mm / per_mm:g}"] if moved else []
        row += [f"{v / factor:.7g}" for v in sample.places_mm.ravel()]
        rows.append([v.replace(".", mark) for v in row])
    return _csv(columns, rows, ";" if mark == "," else ",")


def _csv(columns: Sequence[str], rows: Sequence[Sequence[str]], delimiter: str = ",") -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n", delimiter=delimiter)
    writer.writerow(columns)
    writer.writerows(rows)
    return stream.getvalue()
