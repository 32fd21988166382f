"""What ``study calibrate --method analytic`` shows."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import output
from study.cli.study_commands import REPORTS, RESULTS, Data, Jobs, Json, Reports, Results, Set
from study.reporting.content.blocks import Sentence, Table, Verbatim
from study.reporting.content.text import between, general

if TYPE_CHECKING:
    from study.laboratory.sensors.requirement import SensorRequirement
    from study.mechanics.indentation.indentation_modulus import (
        AnalyticCalibration,
        FittedCurve,
        IndentationModulus,
        MedianEstimate,
    )
    from study.reporting.content.blocks import Block


#: curves or units that are listed; moduli.csv has all
_LISTED = 12


def closed_form(
    file: Path, data: Path | None, settings: Sequence[str], results: Path, as_json: bool
) -> None:
    """Fit the moduli of a calibration file in closed form and show them."""
    from study import api

    calibration = api.indentation_modulus(file, data=data, overrides=settings, results=results)
    warnings = [text for test in calibration.tests for text in test.warnings]
    output.show(calibration, as_json, moduli_blocks, warnings)
    if not as_json:
        folder = results / calibration.name
        print(f"written: {folder / 'analytic.json'}, {folder / 'moduli.csv'}")
    if not calibration.is_complete:
        raise typer.Exit(1)


def moduli_blocks(calibration: AnalyticCalibration) -> Iterator[Block]:
    """Median modulus of every test, and of its first curves."""
    for test in calibration.tests:
        yield from _moduli(test)
    yield from (Verbatim(f"data: {note}") for note in calibration.notes)


def _moduli(test: IndentationModulus) -> Iterator[Block]:
    title = f"{test.file}: {test.indenter}, {test.theory}, nu = {test.poisson_ratio:g}"
    of_median: dict[str, Callable[[MedianEstimate], str]] = {
        "median of": lambda _: test.block or "curve",
        "n": lambda median: str(median.units),
        "E [kPa]": lambda median: general(1e3 * median.value_MPa, 5),
        "95 % interval": lambda median: _kilo(median.interval_MPa),
        "quartiles": lambda median: _kilo(median.quartiles_MPa),
        "G [kPa]": lambda median: general(
            1e3 * median.value_MPa / (2 * (1 + test.poisson_ratio)), 5
        ),
    }
    yield Table.of(title, [] if test.estimate is None else [test.estimate], of_median)
    columns: dict[str, Callable[[FittedCurve], str]] = {
        "curve": lambda curve: curve.label,
        "E [kPa]": lambda curve: general(
            None if curve.found.modulus_MPa is None else 1e3 * curve.found.modulus_MPa, 5
        ),
        "95 % interval": lambda curve: _kilo(curve.found.interval_MPa),
    }
    if any(curve.found.contact_mm is not None for curve in test.curves):
        columns["contact [mm]"] = lambda curve: general(curve.found.contact_mm)
    columns |= {
        "residual [%]": lambda curve: general(
            None if curve.found.relative_rms is None else 100 * curve.found.relative_rms, 3
        ),
        "status": lambda curve: curve.found.status,
    }
    yield Table.of("", test.curves[:_LISTED], columns)
    if len(test.curves) > _LISTED:
        yield Verbatim(f"... and {len(test.curves) - _LISTED} more curves")
    yield Verbatim(
        f"{test.fitted} of {len(test.curves)} curves, {test.rows - test.rows_outside} of "
        f"{test.rows} rows, up to {test.limits[0].depth_mm:.4g} mm ({test.limits[0].what})"
    )
    if test.estimate is not None:
        yield Verbatim(f"interval: {test.estimate.kind}")


def _kilo(pair: tuple[float, float] | None) -> str:
    return between(None if pair is None else [1e3 * end for end in pair])


# The verbs for a device that renders forces: its force law, and what its sensors must be.


def export(
    source: Annotated[
        Path,
        typer.Argument(
            help="Problem file, calibration.json, or results of a study (--case).",
            autocompletion=output.studies,
        ),
    ],
    form: Annotated[
        str, typer.Option("--as", help="What it becomes: force-law, emulator, abaqus or febio.")
    ] = "force-law",
    case: Annotated[str, typer.Option(help="Case of a study: the beginning of its id.")] = "",
    test: Annotated[int, typer.Option(min=1, help="Test of a calibration, from 1.")] = 1,
    tolerance: Annotated[
        float, typer.Option(help="Wanted error bound over the largest force.")
    ] = 0.002,
    response: Annotated[
        str | None, typer.Option(help="With --as emulator: one response; all by default.")
    ] = None,
    settings: Set = None,
    reports: Reports = REPORTS,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Turn a test or surfaces into functions, or a material into input of Abaqus or FEBio."""
    from study import api

    if form == "emulator":
        made = api.export_surface(source, response=response, out=reports, results=results)
    else:
        made = api.export(
            source, form=form, case=case, test=test, tolerance=tolerance,
            overrides=settings or (), out=reports, progress=_say,
        )  # fmt: skip
    output.show(
        made.document, as_json, lambda _: _files(made.sentences, *made.paths), made.warnings
    )


def _files(lines: Iterable[str], *paths: Path | str | None) -> Iterator[Block]:
    """Sentences, then the files that hold the rest, whose names are not folded."""
    yield from map(Sentence, lines)
    yield from (Verbatim(f"written: {path}") for path in paths)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def require(
    file: Annotated[
        Path,
        typer.Argument(
            help="Problem with sensors and what is asked of them.",
            autocompletion=output.designs,
        ),
    ],
    settings: Set = None,
    jobs: Jobs = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Say how uncertain sensors make constants and force, and what they must be."""
    from study import api

    answer = api.require(file, overrides=settings or (), jobs=jobs, out=reports, progress=_say)
    output.show(answer, as_json, _requirement, answer.warnings)


def _requirement(answer: SensorRequirement) -> Iterator[Block]:
    from study.reporting.output import haptic_pages

    yield from map(Sentence, answer.sentences())
    yield haptic_pages.errors(answer)
    yield Verbatim(f"report: {answer.report}")


# Verbs that compare with an instrument: tracking, shape.


def tracking(
    file: Annotated[
        Path,
        typer.Argument(help="TOML file of the tracker study.", autocompletion=output.designs),
    ],
    data: Data = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Judge a tracker: fixed distances, commanded displacements, a better instrument."""
    from study import api
    from study.reporting.output.accuracy_page import tracker_answers as answers

    accuracy = api.tracking(file, data=data, reports=reports)
    output.show(accuracy, as_json, lambda _: _files(answers(accuracy), accuracy.report))


def shape(
    simulation: Annotated[
        Path, typer.Argument(help="Problem file, VTU of study solve, or deformed surface.")
    ],
    scan: Annotated[Path, typer.Option(help="Scanned cloud or surface: PLY, STL, OBJ or CSV.")],
    markers: Annotated[
        Path | None, typer.Option(help="CSV of marked points: x, y, z, and x0, y0, z0 at rest.")
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of scan and markers.")] = "mm",
    surface_unit: Annotated[str, typer.Option(help="Unit of a simulated surface file.")] = "mm",
    as_it_lies: Annotated[
        bool, typer.Option("--as-it-lies", help="Compare without registration.")
    ] = False,
    any_state: Annotated[
        bool, typer.Option("--any-state", help="Also a scan that another state fits better.")
    ] = False,
    settings: Set = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Compare a simulated, deformed body with a scan of the real one."""
    from study import api
    from study.laboratory.shape.shape_deviation import ShapeOptions as Options
    from study.reporting.output.accuracy_page import scan_answers as answers

    deviation = api.shape(
        simulation, scan, markers=markers, unit=unit, surface_unit=surface_unit,
        options=Options(not as_it_lies, any_state), overrides=settings or (), reports=reports,
    )  # fmt: skip
    words = answers(deviation)
    output.show(deviation, as_json, lambda _: _files(words, deviation.report), deviation.notes)
