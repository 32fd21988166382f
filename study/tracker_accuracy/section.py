"""The file of a tracker study: its tables are classes, and a class's fields are the keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from study.design import toml_document
from study.design.diagnostics import Faults, read_table
from study.errors import Fault, InputError, nearest
from study.measurement.section import csv_path
from study.setup.quantity import Length, LengthOrZero, number, shown, unit_of_length
from study.setup.section import Bad, Reads, section
from study.setup.text import choice, text
from study.setup.text import name as label

SCHEMA = 1

#: Coordinates of a point: names of three columns.
Triple = tuple[str, str, str]


def triple(value: object) -> Triple:
    """Read the names of three columns.

    Parameters
    ----------
    value
        Raw value: a list of three different labels.

    Raises
    ------
    Bad
        If it is anything else.
    """
    if not isinstance(value, list) or len(value) != 3:
        raise Bad(f"must be three columns, got {shown(value)}", 'for example ["x", "y", "z"]')
    x, y, z = (label(one) for one in value)
    if len({x, y, z}) < 3:
        raise Bad(f"names a column twice, got {shown(value)}")
    return x, y, z


def two_triples(value: object) -> tuple[Triple, Triple]:
    """Read the columns of two points.

    Parameters
    ----------
    value
        Raw value: a list of two lists, each as :func:`triple` reads it.

    Raises
    ------
    Bad
        If it is anything else.
    """
    if not isinstance(value, list) or len(value) != 2:
        raise Bad(f"must be the columns of two points, got {shown(value)}")
    return triple(value[0]), triple(value[1])


def triples(value: object) -> dict[str, Triple]:
    """Read markers: a name and three columns each.

    Parameters
    ----------
    value
        Raw value: a table of lists, each as :func:`triple` reads it.

    Raises
    ------
    Bad
        If it is anything else, or empty.
    """
    if not isinstance(value, Mapping) or not value:
        raise Bad(f"must be a table, got {shown(value)}", 'for example { tip = ["x", "y", "z"] }')
    return {label(key): triple(columns) for key, columns in value.items()}


def pair(value: object) -> tuple[str, str]:
    """Read the names of two markers.

    Parameters
    ----------
    value
        Raw value: a list of two different labels.

    Raises
    ------
    Bad
        If it is anything else.
    """
    if not isinstance(value, list) or len(value) != 2 or value[0] == value[1]:
        raise Bad(f"must be two markers, got {shown(value)}", 'for example ["tip", "tail"]')
    return label(value[0]), label(value[1])


def two_files(value: object) -> tuple[str, str]:
    """Read the files of two scanned spheres.

    Parameters
    ----------
    value
        Raw value: a list of two paths, each as :func:`study.measurement.section.csv_path` reads it.

    Raises
    ------
    Bad
        If it is anything else.
    """
    if not isinstance(value, list) or len(value) != 2:
        raise Bad(f"must be two files, got {shown(value)}", 'for example ["a.csv", "b.csv"]')
    return csv_path(value[0]), csv_path(value[1])


@section
class RecordingTable:
    """``[recording]``: what the tracker wrote, one row a sample.

    Parameters
    ----------
    file : str
        CSV below the data root.
    markers : mapping of str to three str
        Columns of the coordinates of every marker.
    unit : str
        Unit of the coordinates.
    time : str, optional
        Column of the time stamps, in s.
    stage : str, optional
        Column that says in which stage of the motion, or at which pose, a sample was taken.
    decimal : str
        Decimal mark.
    """

    file: Annotated[str, Reads(csv_path, mend='for example file = "samples.csv"')]
    markers: Annotated[
        dict[str, Triple], Reads(triples, mend='for example markers = { tip = ["x", "y", "z"] }')
    ]
    unit: Annotated[str, Reads(unit_of_length, mend='for example unit = "mm"')]
    time: Annotated[str | None, Reads(label)] = None
    stage: Annotated[str | None, Reads(label)] = None
    decimal: Annotated[str, Reads(choice(".", ","))] = "."


@section
class DistanceTable:
    """``[distance]``: two markers on one rigid body, and how far apart they are known to be.

    Parameters
    ----------
    markers : tuple of two str
        The markers.
    reference : float, optional
        Known distance, mm.
    uncertainty : float
        Standard uncertainty of the known distance, mm.
    spheres : tuple of two str, optional
        Instead: CSV files of points scanned on the spheres of both markers.
    columns : tuple of three str
        Columns of these points.
    unit : str
        Unit of these points.
    practical : float, optional
        Smallest difference of distances that matters, mm.
    """

    markers: Annotated[tuple[str, str], Reads(pair, mend='for example ["tip", "tail"]')]
    reference: Length | None = None
    uncertainty: LengthOrZero = 0.0
    spheres: Annotated[tuple[str, str] | None, Reads(two_files)] = None
    columns: Annotated[Triple, Reads(triple)] = ("x", "y", "z")
    unit: Annotated[str, Reads(unit_of_length)] = "mm"
    practical: Length | None = None


@section
class DisplacementTable:
    """``[displacement]``: a marker on a stage that was told where to go.

    Parameters
    ----------
    marker : str
        The marker.
    commanded : str
        Column of the commanded position along the axis.
    unit : str
        Its unit.
    uncertainty : float
        Standard uncertainty of a commanded position, mm; 0 for an exact stage.
    """

    marker: Annotated[str, Reads(label, mend="name a marker of [recording]")]
    commanded: Annotated[str, Reads(label, mend="name the column of the commanded position")]
    unit: Annotated[str, Reads(unit_of_length)] = "mm"
    uncertainty: LengthOrZero = 0.0


@section
class ReferenceTable:
    """``[reference]``: a better instrument that measured the same poses in its own frame.

    Parameters
    ----------
    file : str
        CSV with one row a pose.
    marker : str
        The marker that was measured.
    stage : str
        Column of the pose; its labels pair with those of the recording.
    position : tuple of three str
        Columns of the reference's point on the body.
    axes : tuple of two triples, optional
        Columns of two more points on the body, beside the first one: they show how it is
        turned, so that the lever arm between marker and reference point can be estimated.
    unit : str
        Unit of these columns.
    """

    file: Annotated[str, Reads(csv_path, mend='for example file = "laser.csv"')]
    marker: Annotated[str, Reads(label, mend="name a marker of [recording]")]
    stage: Annotated[str, Reads(label, mend="name the column of the pose")]
    position: Annotated[Triple, Reads(triple, mend='for example position = ["x", "y", "z"]')]
    axes: Annotated[tuple[Triple, Triple] | None, Reads(two_triples)] = None
    unit: Annotated[str, Reads(unit_of_length)] = "mm"


@section
class TrackingTable:
    """``[tracking]``: what the study is called.

    Parameters
    ----------
    name : str
        Of the report; that of the file where it is left out.
    question : str
        Printed above the answer.
    alpha : float
        Size of tests; intervals have the level 1 - alpha.
    """

    name: Annotated[str, Reads(label)] = ""
    question: Annotated[str, Reads(text)] = ""
    alpha: Annotated[float, Reads(number(0, 0.5))] = Field(default=0.05)


@dataclass(frozen=True)
class TrackingFile:
    """A file of ``study tracking``, read.

    Parameters
    ----------
    tracking, recording : TrackingTable, RecordingTable
        Always there.
    distance, displacement, reference : table or None
        What the tracker is compared with; at least one is there.
    """

    tracking: TrackingTable
    recording: RecordingTable
    distance: DistanceTable | None
    displacement: DisplacementTable | None
    reference: ReferenceTable | None


TABLES = ("schema", "tracking", "recording", "distance", "displacement", "reference")


def load_tracking(path: str | Path) -> TrackingFile:
    """Read a file of ``study tracking``.

    Parameters
    ----------
    path : str or Path
        TOML file.

    Returns
    -------
    TrackingFile

    Raises
    ------
    InputError
        With every fault of the file.
    """
    source = str(path)
    tables = toml_document.parse_toml(toml_document.read_text(path), source)
    faults = Faults()
    if tables.get("schema") != SCHEMA:
        faults.add("schema", f"must be {SCHEMA}", f"write schema = {SCHEMA} on the first line")
    for key in tables:
        if key not in TABLES:
            faults.add(key, "unknown key", nearest(key, TABLES))
    tracking = read_table(TrackingTable, tables.get("tracking", {}), "tracking", faults)
    recording = read_table(RecordingTable, tables.get("recording"), "recording", faults)
    distance = displacement = reference = None
    if "distance" in tables:
        distance = read_table(DistanceTable, tables["distance"], "distance", faults)
    if "displacement" in tables:
        displacement = read_table(DisplacementTable, tables["displacement"], "displacement", faults)
    if "reference" in tables:
        reference = read_table(ReferenceTable, tables["reference"], "reference", faults)
    found = TrackingFile(tracking, recording, distance, displacement, reference)
    if not faults:
        faults.extend(_across(found))
    if faults:
        raise InputError([Fault(f"{source}: {f.where}", f.rule, f.mend) for f in faults])
    return found


def is_tracking(path: str | Path) -> bool:
    """Whether a file is one of ``study tracking``: it has a table ``[recording]``.

    Parameters
    ----------
    path : str or Path
        TOML file.

    Raises
    ------
    InputError
        If it is no TOML.
    """
    return "recording" in toml_document.parse_toml(toml_document.read_text(path), str(path))


def _across(found: TrackingFile) -> Sequence[Fault]:
    """Faults between tables."""
    faults = Faults()
    known = found.recording.markers
    asked = {
        "distance.markers": found.distance.markers if found.distance else (),
        "displacement.marker": (found.displacement.marker,) if found.displacement else (),
        "reference.marker": (found.reference.marker,) if found.reference else (),
    }
    for where, markers in asked.items():
        for marker in markers:
            if marker not in known:
                faults.add(where, f"no marker {marker!r} in [recording]", nearest(marker, known))
    if not (found.distance or found.displacement or found.reference):
        mend = "write [distance], [displacement] or [reference]"
        faults.add("tracking", "nothing says what to compare the tracker with", mend)
    if found.reference and found.recording.stage is None:
        mend = 'write stage = "COLUMN" in [recording]'
        faults.add("recording.stage", "is missing: poses pair by it", mend)
    if found.distance and found.distance.reference and found.distance.spheres:
        faults.add("distance", "has a reference and spheres", "keep the one that is the standard")
    return faults
