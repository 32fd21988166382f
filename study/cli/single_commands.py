"""Verbs about one thing, material or instrument: solve, calibrate, converge, export, shape."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study import api
from study.cli import output
from study.cli.output import SWITCH, Text, argument, designs, option
from study.cli.study_commands import REPORTS, RESULTS, Data, Jobs, Json, Reports, Results, Set
from study.ground import units
from study.ground.errors import Fault, InputError
from study.reporting.content.blocks import Block, Sentence, Table, Verbatim
from study.reporting.content.calibration_content import (
    calibration_blocks,
    comparison_blocks,
    energy_blocks,
)
from study.reporting.content.text import between, general

if TYPE_CHECKING:
    from study.mechanics.indentation.indentation_modulus import (
        AnalyticCalibration,
        CurveModulus,
        IndentationModulus,
        MedianEstimate,
    )
    from study.mechanics.measurement.inspection import Inspection
    from study.simulation.fit_task import FitStep


Numerics = Annotated[bool, "Bound the error by meshes and load steps.", SWITCH]
Resamples = Annotated[int, option("Intervals from this many resampled fits.", "--bootstrap")]


def solve(
    file: Annotated[Path, argument("Problem file.", designs)],
    settings: Set = None,
    picture: Annotated[Path | None, "SVG file for a picture of the deformed mesh."] = None,
    vtu: Annotated[
        Path | None, "Fields for ParaView: .vtu of the last step, .pvd of all of them."
    ] = None,
    whole: Annotated[bool, "Mirror the fields at the planes of symmetry.", SWITCH] = False,
    follow: Annotated[bool, "Go on behind an instability, on the whole body.", SWITCH] = False,
    as_json: Json = False,
) -> None:
    """Simulate one test."""
    from study.api.solving import cautions, writable, write_picture, write_vtu

    writable(picture, vtu)
    output.warn(cautions(file, settings or ()))
    solution = api.solve(file, overrides=settings or (), follow=follow)
    if (picture or vtu) and not len(solution.curve.displacement_mm):
        print("no step converged: nothing is drawn or written", file=sys.stderr)
    else:
        for path, write in ((picture, write_picture), (vtu, partial(write_vtu, whole=whole))):
            if path is not None:
                write(solution, path)
    output.show(solution, as_json, solution.blocks())
    if solution.status != "converged":
        raise typer.Exit(1)


def doctor(as_json: Json = False) -> None:
    """Check the installation."""
    from study.simulation.tasks import examine

    findings = examine()
    heads = ("name", "outcome", "finding")
    rows = tuple(tuple(check[head] for head in heads) for check in findings["checks"])
    output.show(findings, as_json, [Table("", ("check", *heads[1:]), rows)])
    if not findings["ok"]:
        raise typer.Exit(1)


def calibrate(
    file: Annotated[Path, argument("Calibration file.", designs)],
    data: Data = None,
    settings: Set = None,
    convention: Annotated[
        str, "Also print the constants as: abaqus, febio, ogden-classical."
    ] = "study",
    profiles: Annotated[bool, option("Profile-likelihood intervals.", "--profile")] = False,
    numerics: Numerics = False,
    bootstrap: Resamples = 0,
    energies: Annotated[bool, "Fit every energy and weigh them by AICc.", SWITCH] = False,
    method: Annotated[str, "auto, or analytic: moduli of indentations in closed form."] = "",
    by: Annotated[Text, "Fit every 'test' for itself: are the constants equal (Wald test)?"] = None,
    difference: Annotated[
        str, "With --by: the power is that of seeing moduli this far off."
    ] = "5 %",
    zero: Annotated[str, "With --by: standard uncertainty of a test's zero, of its force."] = "0 %",
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Find material constants from one or several measured tests."""
    from study.api.calibrating import is_analytic

    overrides = [*(settings or ()), *([f'calibration.method="{method}"'] if method else ())]
    alone = not (profiles or numerics or bootstrap)
    if is_analytic(file, overrides):
        if not (alone and by is None and not energies and convention == "study"):
            rule = "takes no --energies, --profile, --numerics, --bootstrap, --by or --convention"
            raise InputError(Fault("method analytic", rule, "leave them out, or the method"))
        closed_form(file, data, overrides, results, as_json)
        return
    if by is not None:
        if by != "test" or not (alone and not energies):
            mend = "write --by test, without --energies, --profile, --numerics and --bootstrap"
            raise InputError(Fault("--by", f"cannot compare by {by!r} with these options", mend))
        with units.naming("--difference"):
            off = units.parse(difference, "ratio")
        with units.naming("--zero"):
            u_zero = units.parse(zero, "ratio")
        with _iterations() as progress:
            compared = api.compare_tests(
                file, data=data, overrides=overrides, progress=progress, difference=off, zero=u_zero
            )
        document = compared.to_json()
        warnings = [] if as_json else document["warnings"]
        output.show(document, as_json, comparison_blocks(document), warnings)
        return
    if energies:
        with _iterations() as progress:
            choice = api.choose_energy(file, data=data, overrides=overrides, progress=progress)
        document = choice.to_json()
        output.show(document, as_json, energy_blocks(document))
        return
    with _iterations() as progress:
        calibrated = api.calibrate(
            file, data=data, overrides=overrides, results=results, progress=progress,
            profiles=profiles, numerics=numerics, resamples=bootstrap,
        )  # fmt: skip
    document = calibrated.to_json()
    if convention != "study":
        document["converted"] = vars(calibrated.converted(convention))
    output.show(document, as_json, calibration_blocks(document))
    if not as_json:
        names = ("calibration.json", "calibration.svg", "recording.svg")
        output.warn(document["warnings"])
        folder = results / calibrated.name
        print(f"written: {', '.join(str(folder / name) for name in names)}")
    if not calibrated.usable:
        raise typer.Exit(1)


def inspect(
    file: Annotated[Path, argument("Recorded file: text or workbook, also .gz.")],
    sheet: Annotated[str, "Sheet of a workbook that has several."] = "",
    as_json: Json = False,
) -> None:
    r"""Show what a recorded file holds, and the table \[measurements] that reads it."""
    inspection = api.inspect(file, sheet=sheet)
    output.show(inspection, as_json, inspection_blocks(inspection))


def inspection_blocks(inspection: Inspection) -> Iterator[Block]:
    """How a file is written, its columns and phases, and the table that reads it."""
    names = "" if inspection.header_line is None else f", names in line {inspection.header_line}"
    names += "" if inspection.unit_line is None else f", units in line {inspection.unit_line}"
    yield Verbatim(
        f"{inspection.file}: {inspection.encoding}, delimiter {inspection.delimiter}, "
        f"decimal mark {inspection.decimal!r}{names}, {inspection.rows} rows in lines "
        f"{inspection.first_line} to {inspection.last_line}"
    )
    if inspection.sheets:
        yield Verbatim(f"sheets: {', '.join(inspection.sheets)}")
    yield from (Verbatim(f"  before the names: {line}") for line in inspection.preamble)
    yield Table.of(
        "columns",
        inspection.columns,
        {
            "column": lambda column: column.name,
            "unit": lambda column: column.unit or "-",
            "taken for": lambda column: (
                column.quantity
                or (f"labels {', '.join(column.labels[:3])}" if column.labels else "-")
            ),
            "from": lambda column: general(column.low, 6),
            "to": lambda column: general(column.high, 6),
        },
    )
    for phase in inspection.phases:
        ends = zip(phase["from"], phase["to"], strict=True)
        far, hard = (between(end, 6) for end in ends)
        lines, units = "{} to {}".format(*phase["lines"]), inspection.units
        yield Verbatim(f"{phase['phase']}: lines {lines}, {far} {units[0]}, {hard} {units[1]}")
    yield from (Verbatim(f"note: {note}") for note in inspection.notes)
    yield Verbatim(f"\n{inspection.toml}")


@contextmanager
def _iterations() -> Iterator[Callable[[FitStep], None]]:
    """One line on stderr: stage, iteration, cost and constants; redrawn where it can be."""
    from study.mechanics.material.material import is_dimensionless, unit_shown
    from study.simulation.fit_task import LAST

    width = 0

    def show(step: FitStep) -> None:
        nonlocal width
        it = step.iteration
        values = ", ".join(
            f"{n} {v:.5g} {unit_shown(n)}".rstrip()
            if is_dimensionless(n)
            else f"{n} {1e3 * v:.5g} kPa"
            for n, v in zip(step.names, it.x, strict=True)
        )
        stage = "" if step.stage == LAST else f"{step.stage}, "
        text = f"{stage}iteration {it.iteration}: cost {it.cost:.6g}, {values}"
        if not sys.stderr.isatty():
            print(text, file=sys.stderr)
            return
        print("\r" + text[:160].ljust(width), end="", file=sys.stderr, flush=True)
        width = min(len(text), 160)

    yield show
    if width:
        print(file=sys.stderr)


# The verb converge.


def converge(
    file: Annotated[
        Path | None, argument("Problem, design, or the results of a study.", output.studies)
    ] = None,
    values: Annotated[str, "Values of the quantity, with commas."] = "",
    sizes: Annotated[str, "Mesh sizes of these values, with commas."] = "",
    formal_order: Annotated[float | None, "Order that elements promise."] = None,
    tolerance: Annotated[float, "Algebraic error of a value."] = 0.0,
    data: Data = None,
    jobs: Annotated[int | None, "Workers for the cells of a design."] = None,
    memory: Annotated[float | None, "MB that one solution may take."] = None,
    settings: Set = None,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Judge mesh convergence: observed order, extrapolated value, GCI, verdict."""
    answer = api.converge(
        file,
        values=_numbers(values, "--values"),
        sizes=_numbers(sizes, "--sizes"),
        formal_order=formal_order,
        tolerance=tolerance,
        overrides=settings or (),
        data=data,
        jobs=jobs,
        memory_MB=memory,
        results=results,
        reports=reports,
        progress=_say,
    )
    document = answer if isinstance(answer, dict) else answer.to_json()
    cells = document.get("cells", [document])
    from study.reporting.output.convergence_page import series_blocks, series_warnings

    warnings = [] if as_json else series_warnings(cells)
    output.show(document, as_json, series_blocks(document), warnings)
    if any(mesh["status"] != "converged" for cell in cells for mesh in cell.get("meshes", ())):
        raise typer.Exit(1)


def _numbers(text: str, option: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        rule = f"must be numbers with commas, got {text!r}"
        raise InputError(Fault(option, rule)) from None


# What ``study calibrate --method analytic`` shows.

#: curves or units that are listed; moduli.csv has all
_LISTED = 12


def closed_form(
    file: Path, data: Path | None, settings: Sequence[str], results: Path, as_json: bool
) -> None:
    """Fit the moduli of a calibration file in closed form and show them."""
    calibration = api.indentation_modulus(file, data=data, overrides=settings, results=results)
    warnings = [text for test in calibration.tests for text in test.warnings]
    output.show(calibration, as_json, moduli_blocks(calibration), warnings)
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
    columns: dict[str, Callable[[CurveModulus], str]] = {
        "curve": lambda curve: curve.label,
        "E [kPa]": lambda curve: general(
            None if curve.modulus_MPa is None else 1e3 * curve.modulus_MPa, 5
        ),
        "95 % interval": lambda curve: _kilo(curve.interval_MPa),
    }
    if any(curve.contact_mm is not None for curve in test.curves):
        columns["contact [mm]"] = lambda curve: general(curve.contact_mm)
    columns |= {
        "residual [%]": lambda curve: general(
            None if curve.relative_rms is None else 100 * curve.relative_rms, 3
        ),
        "status": lambda curve: curve.status,
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
        argument("Problem file, calibration.json, or results of a study (--case).", output.studies),
    ],
    form: Annotated[
        str, option("What it becomes: force-law, emulator, abaqus or febio.", "--as")
    ] = "force-law",
    case: Annotated[str, "Case of a study: the beginning of its id."] = "",
    test: Annotated[int, option("Test of a calibration, from 1.", min=1)] = 1,
    tolerance: Annotated[float, "Wanted error bound over the largest force."] = 0.002,
    response: Annotated[Text, "With --as emulator: one response; all by default."] = None,
    settings: Set = None,
    reports: Reports = REPORTS,
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Turn a test or surfaces into functions, or a material into input of Abaqus or FEBio."""
    if form == "emulator":
        files = api.export_surface(source, response=response, out=reports, results=results)
    else:
        files = api.export(
            source, form=form, case=case, test=test, tolerance=tolerance,
            overrides=settings or (), out=reports, progress=_say,
        )  # fmt: skip
    blocks = _files(files.sentences, *files.paths)
    output.show(files.document, as_json, blocks, files.warnings)


def _files(lines: Iterable[str], *paths: Path | str | None) -> Iterator[Block]:
    """Sentences, then the files that hold the rest, whose names are not folded."""
    yield from map(Sentence, lines)
    yield from (Verbatim(f"written: {path}") for path in paths)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def require(
    file: Annotated[
        Path, argument("Problem with sensors and what is asked of them.", output.designs)
    ],
    settings: Set = None,
    jobs: Jobs = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Say how uncertain sensors make constants and force, and what they must be."""
    from study.reporting.output.laboratory_pages import errors

    answer = api.require(file, overrides=settings or (), jobs=jobs, out=reports, progress=_say)
    page = Verbatim(f"report: {answer.report}")
    blocks: list[Block] = [*map(Sentence, answer.sentences()), errors(answer), page]
    output.show(answer, as_json, blocks, answer.warnings)


# Verbs that compare with an instrument: tracking, shape.


def tracking(
    file: Annotated[Path, argument("TOML file of the tracker study.", output.designs)],
    data: Data = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Judge a tracker: fixed distances, commanded displacements, a better instrument."""
    from study.reporting.output.laboratory_pages import tracker_answers

    accuracy = api.tracking(file, data=data, reports=reports)
    blocks = _files(tracker_answers(accuracy), accuracy.report)
    output.show(accuracy, as_json, blocks, accuracy.notes)


def shape(
    simulation: Annotated[Path, argument("Problem file, VTU of study solve, or deformed surface.")],
    scan: Annotated[Path, "Scanned cloud or surface: PLY, STL, OBJ or CSV."],
    markers: Annotated[
        Path | None, "CSV of marked points: x, y, z, and x0, y0, z0 at rest."
    ] = None,
    unit: Annotated[str, "Unit of scan and markers."] = "mm",
    surface_unit: Annotated[str, "Unit of a simulated surface file."] = "mm",
    as_it_lies: Annotated[bool, "Compare without registration.", SWITCH] = False,
    any_state: Annotated[bool, "Also a scan that another state fits better.", SWITCH] = False,
    settings: Set = None,
    reports: Reports = REPORTS,
    as_json: Json = False,
) -> None:
    """Compare a simulated, deformed body with a scan of the real one."""
    from study.laboratory.shape.shape_deviation import ShapeOptions as Options
    from study.reporting.output.laboratory_pages import scan_answers

    deviation = api.shape(
        simulation, scan, markers=markers, unit=unit, surface_unit=surface_unit,
        options=Options(not as_it_lies, any_state), overrides=settings or (), reports=reports,
    )  # fmt: skip
    blocks = _files(scan_answers(deviation), deviation.report)
    output.show(deviation, as_json, blocks, deviation.notes)
