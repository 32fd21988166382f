"""What ``study tracking`` found, and its document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from study.canonical import plain
from study.tracker_accuracy.displacement import DisplacementResult, analyze_displacement
from study.tracker_accuracy.distance import DistanceResult, analyze_distance
from study.tracker_accuracy.recording import read_recording
from study.tracker_accuracy.reference import ReferenceResult, analyze_reference
from study.tracker_accuracy.section import TrackingFile

#: JSON of one part of a result.
Document = Mapping[str, object]


@dataclass(frozen=True)
class TrackerAccuracy:
    """Accuracy of a tracker.

    Parameters
    ----------
    name, question : str
        Of the study.
    samples, markers : int
        Size of the recording.
    alpha : float
        Size of tests; intervals have the level 1 - alpha.
    distance, displacement, reference : result or None
        What was asked for.
    notes : tuple of str
        What was mended in reading.
    report : str or None
        Page that was written.
    """

    name: str
    question: str
    samples: int
    markers: int
    alpha: float
    distance: DistanceResult | None
    displacement: DisplacementResult | None
    reference: ReferenceResult | None
    notes: tuple[str, ...] = ()
    report: str | None = None

    def to_json(self) -> Document:
        """Document of ``study tracking --json``; lengths in mm."""
        found: Document = plain(
            {
                "name": self.name,
                "samples": self.samples,
                "markers": self.markers,
                "alpha": self.alpha,
                "distance": None if self.distance is None else _distance(self.distance),
                "displacement": (None if self.displacement is None else asdict(self.displacement)),
                "reference": None if self.reference is None else _reference(self.reference),
                "notes": list(self.notes),
                "report": self.report,
            }
        )
        return found


def judge_tracker(declared: TrackingFile, root: Path, name: str) -> TrackerAccuracy:
    """Compare a tracker with everything its file names.

    Parameters
    ----------
    declared : TrackingFile
        The file.
    root : Path
        Data root.
    name : str
        Of the study where the file gives none.

    Returns
    -------
    TrackerAccuracy

    Raises
    ------
    InputError
        For faulty data.
    """
    alpha = declared.tracking.alpha
    recording = read_recording(declared.recording, root)
    distance = displacement = reference = None
    if declared.distance is not None:
        distance = analyze_distance(declared.distance, recording, root, alpha)
    if declared.displacement is not None:
        displacement = analyze_displacement(declared.displacement, recording, alpha)
    if declared.reference is not None:
        reference = analyze_reference(declared.reference, recording, root)
    return TrackerAccuracy(
        name=declared.tracking.name or name,
        question=declared.tracking.question,
        samples=len(recording.table.lines),
        markers=len(recording.positions),
        alpha=alpha,
        distance=distance,
        displacement=displacement,
        reference=reference,
        notes=recording.table.notes,
    )


def _distance(found: DistanceResult) -> Document:
    standard, comparison = found.standard, found.comparison
    return {
        "markers": found.markers,
        "stages": found.stages,
        "comparison": None if comparison is None else comparison.to_json(),
        "comparison_note": found.comparison_note,
        "drift": found.drift,
        "standard": standard
        and {
            "distance_mm": standard.distance_mm,
            "uncertainty_mm": standard.uncertainty_mm,
            "spheres": [sphere.to_json() for sphere in standard.spheres],
        },
        "bias_mm": found.bias_mm,
        "bias_interval_mm": found.bias_interval_mm,
    }


def _reference(found: ReferenceResult) -> Document:
    kept = {f.name: getattr(found, f.name) for f in fields(found) if f.name != "fit"}
    return {
        **kept,
        "registration": found.fit.motion.to_json(),
        "residuals_mm": found.fit.residuals,
        "fiducial_registration_error_mm": found.fit.rms,
        "localization_error_mm": found.fit.localization_error,
        "scale": found.fit.scale,
        "left_out_rms_mm": found.left_out_rms_mm,
    }
