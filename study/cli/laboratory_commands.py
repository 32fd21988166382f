"""What ``study calibrate --method analytic`` shows."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import output
from study.cli.study_commands import REPORTS, RESULTS, Data, Jobs, Json, Reports, Results, Set

if TYPE_CHECKING:
    from study.api.haptics import Required
    from study.mechanics.indentation.indentation_modulus import (
        AnalyticCalibration,
        IndentationModulus,
        MedianEstimate,
    )


#: curves or units that are listed; moduli.csv has all
_LISTED = 12


def closed_form(
    file: Path, data: Path | None, settings: Sequence[str], results: Path, as_json: bool
) -> None:
    """Fit the moduli of a calibration file in closed form and show them."""
    from study import api

    calibration = api.indentation_modulus(file, data=data, overrides=settings, results=results)
    warnings = [text for test in calibration.tests for text in test.warnings]
    output.show(calibration, as_json, _print, warnings)
    if not as_json:
        folder = results / calibration.name
        print(f"written: {folder / 'analytic.json'}, {folder / 'moduli.csv'}")
    if not calibration.is_complete:
        raise typer.Exit(1)


def _print(calibration: AnalyticCalibration) -> None:
    for test in calibration.tests:
        title = f"{test.file}: {test.indenter}, {test.theory}, nu = {test.poisson_ratio:g}"
        rows = [["median of", "n", "E [kPa]", "95 % interval", "quartiles", "G [kPa]"]]
        unit = test.block or "curve"
        if test.estimate is not None:
            rows.append([unit, *_estimate(test.estimate, test.poisson_ratio)])
        output.table(rows, title)
        _print_curves(test)
        print(f"{test.fitted} of {len(test.curves)} curves, {test.rows - test.rows_outside} of "
              f"{test.rows} rows, up to {test.limits[0].depth_mm:.4g} mm "
              f"({test.limits[0].what})")  # fmt: skip
        if test.estimate is not None:
            print(f"interval: {test.estimate.kind}")
    for note in calibration.notes:
        print(f"data: {note}")


def _estimate(estimate: MedianEstimate, poisson_ratio: float) -> list[str]:
    return [
        str(estimate.units),
        _kilo(estimate.value_MPa),
        _between(estimate.interval_MPa),
        _between(estimate.quartiles_MPa),
        _kilo(estimate.value_MPa / (2 * (1 + poisson_ratio))),
    ]


def _print_curves(test: IndentationModulus) -> None:
    fitted = any(curve.found.contact_mm is not None for curve in test.curves)
    rows = [["curve", "E [kPa]", "95 % interval", "residual [%]", "status"]]
    if fitted:
        rows[0].insert(3, "contact [mm]")
    for curve in test.curves[:_LISTED]:
        modulus = curve.found
        share = None if modulus.relative_rms is None else 100 * modulus.relative_rms
        row = [curve.label, _kilo(modulus.modulus_MPa), _between(modulus.interval_MPa),
               output.number(share, 3), modulus.status]  # fmt: skip
        if fitted:
            row.insert(3, output.number(modulus.contact_mm))
        rows.append(row)
    output.table(rows)
    if len(test.curves) > _LISTED:
        print(f"... and {len(test.curves) - _LISTED} more curves")


def _kilo(value_MPa: float | None) -> str:
    return output.number(None if value_MPa is None else 1e3 * value_MPa, 5)


def _between(pair: tuple[float, float] | None) -> str:
    return "-" if pair is None else " to ".join(f"{1e3 * v:.5g}" for v in pair)


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
        made.document, as_json, lambda _: _print_files(made.sentences, *made.paths), made.warnings
    )


def _print_files(lines: Iterable[str], *paths: Path | str | None) -> None:
    """Print sentences, then the files that hold the rest, whose names are not folded."""
    output.paragraphs(lines)
    for path in paths:
        print(f"written: {path}")


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
    output.show(answer, as_json, _print_requirement, answer.warnings)


def _print_requirement(answer: Required) -> None:
    from study.laboratory.sensors import requirement

    output.paragraphs(requirement.sentences(answer.requirement))
    rows = [["sensor", "error", "given", "allowed alone", "allowed beside the others"]]
    for k, source in enumerate(answer.requirement.propagation.sources):
        alone, jointly = (requirement.size(source, v) for v in answer.requirement.allowed(k))
        given = requirement.size(source, source.given)
        rows.append([source.sensor, source.name, given, alone, jointly])
    output.table(rows)
    print(f"report: {answer.page}")


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
    output.show(accuracy, as_json, lambda _: _print_files(answers(accuracy), accuracy.report))


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
    output.show(
        deviation, as_json, lambda _: _print_files(words, deviation.report), deviation.notes
    )
