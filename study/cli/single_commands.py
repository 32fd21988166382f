"""Verbs about one thing: solve, calibrate, doctor (converge: its own file)."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from study.cli import output
from study.cli.laboratory_commands import closed_form
from study.cli.output import Document, designs
from study.cli.study_commands import RESULTS, Data, Json, Results, Set
from study.ground import units
from study.ground.errors import Fault, InputError

if TYPE_CHECKING:
    from study.harness.runner.staged_fit import FitStep
    from study.mechanics.measurement.inspection import Inspection


Numerics = Annotated[
    bool, typer.Option("--numerics", help="Bound the error by meshes and load steps.")
]
Resamples = Annotated[
    int, typer.Option("--bootstrap", help="Intervals from this many resampled fits.")
]


def solve(
    file: Annotated[Path, typer.Argument(help="Problem file.", autocompletion=designs)],
    settings: Set = None,
    picture: Annotated[
        Path | None, typer.Option(help="SVG file for a picture of the deformed mesh.")
    ] = None,
    vtu: Annotated[
        Path | None,
        typer.Option(help="Fields for ParaView: .vtu of the last step, .pvd of all of them."),
    ] = None,
    whole: Annotated[
        bool, typer.Option("--whole", help="Mirror the fields at the planes of symmetry.")
    ] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on behind an instability, on the whole body.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Simulate one test."""
    from study import api
    from study.api.solving import cautions, solution_json, writable, write_picture, write_vtu

    writable(picture, vtu)
    output.warn(cautions(file, settings or ()))
    solution = api.solve(file, overrides=settings or (), follow=follow)
    curve = solution.curve
    if (picture or vtu) and not len(curve.displacement_mm):
        print("no step converged: nothing is drawn or written", file=sys.stderr)
    elif picture or vtu:
        for path, write in ((picture, write_picture), (vtu, partial(write_vtu, whole=whole))):
            if path is not None:
                write(solution, path)
    if as_json:
        output.print_json(solution_json(solution))
    else:
        output.table(output.curve_rows(curve))
        print(f"{solution.status}: {solution.message}")
        if figures := solution.equilibria.contact:
            last, above = figures[-1], solution.equilibria.plate[-1]
            print(
                f"at the last step: contact {last.area_mm2:.4g} mm^2, peak pressure "
                f"{1e3 * last.peak_pressure_MPa:.4g} kPa, nodes up to {last.penetration_mm:.2g} mm "
                f"inside and {last.gap_mm:.2g} mm off the surface; side force "
                f"{math.hypot(*above.side):.4g} N"
            )
        total = solution.seconds["total"]
        print(f"{solution.dofs} unknowns, {total:.2f} s, {solution.solver}")
    if solution.status != "converged":
        raise typer.Exit(1)


def doctor(as_json: Json = False) -> None:
    """Check the installation."""
    from study.api.solving import examine

    findings = examine()
    rows = [["check", "outcome", "finding"]]
    rows += [[c["name"], c["outcome"], c["finding"]] for c in findings["checks"]]
    output.show(findings, as_json, lambda _: output.table(rows))
    if not findings["ok"]:
        raise typer.Exit(1)


def calibrate(
    file: Annotated[Path, typer.Argument(help="Calibration file.", autocompletion=designs)],
    data: Data = None,
    settings: Set = None,
    convention: Annotated[
        str,
        typer.Option(help="Also print the constants as: abaqus, febio, ogden-classical."),
    ] = "study",
    profiles: Annotated[bool, typer.Option("--profile", help="Profile-likelihood intervals.")] = (
        False
    ),
    numerics: Numerics = False,
    bootstrap: Resamples = 0,
    energies: Annotated[
        bool, typer.Option("--energies", help="Fit every energy and weigh them by AICc.")
    ] = False,
    method: Annotated[
        str, typer.Option(help="auto, or analytic: moduli of indentations in closed form.")
    ] = "",
    by: Annotated[
        str | None,
        typer.Option(help="Fit every 'test' for itself: are the constants equal (Wald test)?"),
    ] = None,
    difference: Annotated[
        str, typer.Option(help="With --by: the power is that of seeing moduli this far off.")
    ] = "5 %",
    zero: Annotated[
        str, typer.Option(help="With --by: standard uncertainty of a test's zero, of its force.")
    ] = "0 %",
    results: Results = RESULTS,
    as_json: Json = False,
) -> None:
    """Find material constants from one or several measured tests."""
    from study import api
    from study.api.calibrating import is_analytic

    asked = [*(settings or ()), *([f'calibration.method="{method}"'] if method else ())]
    alone = not (profiles or numerics or bootstrap)
    if is_analytic(file, asked):
        if not (alone and by is None and not energies and convention == "study"):
            rule = "takes no --energies, --profile, --numerics, --bootstrap, --by or --convention"
            raise InputError(Fault("method analytic", rule, "leave them out, or the method"))
        closed_form(file, data, asked, results, as_json)
        return
    if by is not None:
        if by != "test" or not (alone and not energies):
            mend = "write --by test, without --energies, --profile, --numerics and --bootstrap"
            raise InputError(Fault("--by", f"cannot compare by {by!r} with these options", mend))
        with units.naming("--difference"):
            off = units.parse(difference, "ratio")
        with units.naming("--zero"):
            uncertain = units.parse(zero, "ratio")
        with _iterations() as progress:
            compared = api.compare_tests(
                file, data=data, overrides=asked, progress=progress, difference=off, zero=uncertain
            )
        output.show(compared.to_json(), as_json, _print_comparison)
        return
    if energies:
        with _iterations() as progress:
            choice = api.choose_energy(file, data=data, overrides=asked, progress=progress)
        output.show(choice.to_json(), as_json, _print_energies)
        return
    with _iterations() as progress:
        calibrated = api.calibrate(
            file, data=data, overrides=asked, results=results, progress=progress,
            profiles=profiles, numerics=numerics, resamples=bootstrap,
        )  # fmt: skip
    document = calibrated.to_json()
    if convention != "study":
        document["converted"] = vars(calibrated.converted(convention))
    output.show(document, as_json, _print_calibration)
    if not as_json:
        names = ("calibration.json", "calibration.svg", "recording.svg")
        folder = results / calibrated.name
        print(f"written: {', '.join(str(folder / name) for name in names)}")
    if not calibrated.usable:
        raise typer.Exit(1)


def inspect(
    file: Annotated[Path, typer.Argument(help="Recorded file: text or workbook, also .gz.")],
    sheet: Annotated[str, typer.Option(help="Sheet of a workbook that has several.")] = "",
    as_json: Json = False,
) -> None:
    """Show what a recorded file holds, and the table [measurements] that reads it."""
    from study import api

    output.show(api.inspect(file, sheet=sheet), as_json, _print_inspection)


def _print_inspection(found: Inspection) -> None:
    names = "" if found.header_line is None else f", names in line {found.header_line}"
    names += "" if found.unit_line is None else f", units in line {found.unit_line}"
    print(f"{found.file}: {found.encoding}, delimiter {found.delimiter}, decimal mark "
          f"{found.decimal!r}{names}, {found.rows} rows in lines {found.lines[0]} to "
          f"{found.lines[1]}")  # fmt: skip
    if found.sheets:
        print(f"sheets: {', '.join(found.sheets)}")
    for line in found.preamble:
        print(f"  before the names: {line}")
    rows = [["column", "unit", "taken for", "from", "to"]]
    for one in found.columns:
        ends = [output.number(one.low, 6), output.number(one.high, 6)]
        held = one.quantity or (f"labels {', '.join(one.labels[:3])}" if one.labels else "-")
        rows.append([one.name, one.unit or "-", held, *ends])
    output.table(rows, "columns")
    for phase in found.phases:
        far, hard = (f"{a:.6g} to {b:.6g}" for a, b in zip(phase.start, phase.end, strict=True))
        print(f"{phase.phase}: lines {phase.lines[0]} to {phase.lines[1]}, "
              f"{far} {found.units[0]}, {hard} {found.units[1]}")  # fmt: skip
    for note in found.notes:
        print(f"note: {note}")
    print(f"\n{found.toml}")


@contextmanager
def _iterations() -> Iterator[Callable[[FitStep], None]]:
    """One line on stderr: stage, iteration, cost and constants; redrawn where it can be."""
    from study.harness.runner.staged_fit import LAST
    from study.mechanics.material.material import is_dimensionless, unit_shown

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


def _print_calibration(found: Document) -> None:
    bound = found.get("numerics") or found.get("numerical")
    _print_constants(found, bound)
    output.print_nuisance(found["nuisance"])
    if "shear_moduli" in found:
        both = found["shear_moduli"]
        print(f"shear modulus at small strain: {both['instantaneous']:.5g} kPa at once, "
              f"{both['long_term']:.5g} kPa after all relaxation")  # fmt: skip
    if "converted" in found:
        _print_converted(found["converted"])
    _print_further_bounds(found, bound)
    if found["serial_correlation"]:
        print(_rows_sentence(found["serial_correlation"]))
    _print_curves("", found["curves"])
    for kind, title in (("specimens", "alone"), ("cross_validation", "left out")):
        for one in found[kind]:
            values = ", ".join(f"{n} {output.number(e['value'], 5)} {e['unit']}".rstrip()
                               for n, e in one["parameters"].items())  # fmt: skip
            print(f"{one['label']} {title}: {values} ({one['status']})")
            _print_curves("  ", one["curves"])
    if found["population"]:
        _print_population(found["population"])
    if found["same_constants_p"] is not None:
        print(f"all specimens share their constants: p = {found['same_constants_p']:.3g}")
    if found["lack_of_fit"]:
        lack = found["lack_of_fit"]
        print(
            f"{lack['verdict']}: F = {lack['statistic']:.4g}, p = {lack['p_independent']:.3g} "
            f"if every point is independent, {lack['p_dependent']:.3g} if every curve is"
        )
    print(f"{found['status']}: {found['message']} ({found['evaluations']} evaluations)")
    print(f"{found['fit']['verdict']}: {found['fit']['sentence']}")
    verdict = "identifiable" if found["identifiable"] else "not identifiable"
    scaled = found["identifiability"]["sentence"] if found["identifiability"] else ""
    whys = "; ".join(why for why in (found["reason"], scaled) if why)
    print(f"{verdict}{': ' + whys if whys else ''}")
    if found["next_test"] and found["next_test"]["sentence"]:
        print(found["next_test"]["sentence"])
    print(found["stability"])
    for note in found["notes"]:
        print(f"data: {note}")
    output.warn(found["warnings"])


def _print_constants(found: Document, bound: Document | None) -> None:
    rows = [["constant", "value", "unit", "standard error", "95 % interval", "numerics",
             "profile interval"]]  # fmt: skip
    for name, entry in found["parameters"].items():
        u = "-" if bound is None else f"+-{output.number(bound['u'][name], 2)}"
        profile = found["profiles"].get(name, {}).get("interval")
        rows.append(
            [name, output.number(entry["value"], 6), entry["unit"],
             output.number(entry["standard_error"]), _between(entry["ci95"]), u, _between(profile)]
        )  # fmt: skip
    if not found["profiles"]:
        rows = [row[:-1] for row in rows]
    if bound is None:
        rows = [[*row[:5], *row[6:]] for row in rows]
    output.table(rows, found["model"])


def _print_further_bounds(found: Document, bound: Document | None) -> None:
    """Say how the numerical bound was had, and what the bootstrap gives."""
    if bound is not None:
        print(bound["sentence"])
    if "bootstrap" in found:
        drawn = found["bootstrap"]
        said = "; ".join(
            f"{n} {_between(pair)} {found['parameters'][n]['unit']}".rstrip()
            for n, pair in drawn["interval"].items()
        )
        print(f"{drawn['sentence']}: {said}")


def _print_population(found: Document) -> None:
    rows = [["constant", "specimens", "mean", "unit", "scatter", "95 % of the mean",
             "95 % of the next specimen"]]  # fmt: skip
    for name, one in found.items():
        rows.append(
            [name, str(one["specimens"]), output.number(one["mean"], 5), one["unit"],
             output.number(one["standard_deviation"]), _between(one["mean_ci95"]),
             _between(one["next_ci95"])]
        )  # fmt: skip
    output.table(rows, "population of specimens")
    for name, one in found.items():
        listed = ", ".join(f"{k} {output.number(v, 5)}" for k, v in one["shrunk"].items())
        print(f"{name} of each specimen, shrunk to the mean by its own error: {listed}")


def _rows_sentence(serial: Document) -> str:
    if serial["correlation"] is None:
        return f"intervals from {serial['rows']} rows, taken as independent: too few to tell"
    return (
        f"intervals from {serial['rows']} rows, neighbors correlated by "
        f"{serial['correlation']:.2f}: worth {serial['effective_rows']:.3g} independent rows"
    )


def _between(pair: Sequence[float | None] | None) -> str:
    if pair is None:
        return "-"
    return " to ".join("-" if v is None else f"{v:.5g}" for v in pair)


def _print_converted(found: Document) -> None:
    values = ", ".join(f"{name} = {value:.6g}" for name, value in found["constants"].items())
    note = f" ({found['note']})" if found["note"] else ""
    print(f"{found['convention']}: {found['keyword']}: {values} in MPa{note}")


def _print_curves(indent: str, curves: Sequence[Document]) -> None:
    for curve in curves:
        name = f"{curve['file']}, {curve['specimen']}" if curve["specimen"] else curve["file"]
        if curve["rms_force_error"] is None:
            print(f"{indent}{curve['role']}: {name}: no prediction: {curve['message']}")
            continue
        print(f"{indent}{curve['role']}: {name}: RMS error {curve['relative_rms_force_error']:.3g} "
              f"% of the RMS force ({curve['rms_force_error']:.3g} N), "
              f"R2 {output.number(curve['r_squared'], 4)}")  # fmt: skip


def _print_comparison(found: Document) -> None:
    names = list(found["common"])
    heads = [f"{n} [{one['unit']}]".replace(" []", "") for n, one in found["common"].items()]
    rows = [["test", "n", *heads, "mu0 [kPa]",
             f"power, {100 * found['difference']:.3g} % off", "seen with power 0.8"]]  # fmt: skip
    for one in found["groups"]:
        seen = "-" if one["detectable"] is None else f"{100 * one['detectable']:.3g} %"
        rows.append(
            [one["label"], str(one["n"]), *(_with_error(one["parameters"][n]) for n in names),
             output.number(one["mu0"], 5), output.number(one["power"], 3), seen]
        )  # fmt: skip
    common = [_with_error(found["common"][n]) for n in names]
    rows.append(["common", "", *common, "", "", ""])
    output.table(rows, found["model"])
    print(f"{found['verdict']}: {found['sentence']}")
    output.warn(found["warnings"])


def _with_error(entry: Document) -> str:
    return f"{output.number(entry['value'], 5)} +- {output.number(entry['standard_error'], 2)}"


def _print_energies(found: Document) -> None:
    rows = [
        ["energy", "constants", "AICc - best", "weight", "mu0 [kPa]", "the data", "may be chosen"]
    ]
    for one in found["energies"]:
        why = one["not_chosen_because"]
        alike = one["energy"] in found["cannot_be_told_apart"]
        may = "best" if one["energy"] == found["best"] else "not told apart" if alike else "yes"
        rows.append(
            [one["energy"], str(one["constants"]), output.number(one["delta_aicc"]),
             output.number(one["weight"]), output.number(one["mu0"], 5), one["verdict"],
             f"no: {why}" if why else may]
        )  # fmt: skip
    output.table(rows)
    for name, why in found["failures"].items():
        print(f"{name}: {why}")
    print(found["sentence"])
