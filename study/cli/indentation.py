"""What ``study calibrate --method analytic`` shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from study.cli import output

if TYPE_CHECKING:
    from study.contact_mechanics.median import MedianEstimate
    from study.contact_mechanics.result import AnalyticCalibration, IndentationModulus

#: curves or units that are listed; moduli.csv has all
_LISTED = 12


def closed_form(
    file: Path, data: Path | None, settings: Sequence[str], results: Path, as_json: bool
) -> None:
    """Fit the moduli of a calibration file in closed form and show them.

    Parameters
    ----------
    file : Path
        Calibration file.
    data : Path or None
        Folder of the measurements; None for the usual one.
    settings : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    results : Path
        Where the document and the table go, in a folder of the calibration's name.
    as_json : bool
        Whether one JSON document is printed instead of tables.

    Raises
    ------
    typer.Exit
        With code 1 if a test has no modulus.
    """
    from study import api

    found = api.indentation_modulus(file, data=data, overrides=settings, results=results)
    for test in found.tests:
        output.warn(test.warnings)
    if as_json:
        output.print_json(found.to_json())
    else:
        _print(found)
        folder = results / found.name
        print(f"written: {folder / 'analytic.json'}, {folder / 'moduli.csv'}")
    if not found.is_complete:
        raise typer.Exit(1)


def _print(found: AnalyticCalibration) -> None:
    for test in found.tests:
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
    for note in found.notes:
        print(f"data: {note}")


def _estimate(found: MedianEstimate, poisson_ratio: float) -> list[str]:
    return [
        str(found.units),
        _kilo(found.value_MPa),
        _between(found.interval_MPa),
        _between(found.quartiles_MPa),
        _kilo(found.value_MPa / (2 * (1 + poisson_ratio))),
    ]


def _print_curves(test: IndentationModulus) -> None:
    fitted = any(one.found.contact_mm is not None for one in test.curves)
    rows = [["curve", "E [kPa]", "95 % interval", "residual [%]", "status"]]
    if fitted:
        rows[0].insert(3, "contact [mm]")
    for one in test.curves[:_LISTED]:
        found = one.found
        share = None if found.relative_rms is None else 100 * found.relative_rms
        row = [one.label, _kilo(found.modulus_MPa), _between(found.interval_MPa),
               output.number(share, 3), found.status]  # fmt: skip
        if fitted:
            row.insert(3, output.number(found.contact_mm))
        rows.append(row)
    output.table(rows)
    if len(test.curves) > _LISTED:
        print(f"... and {len(test.curves) - _LISTED} more curves")


def _kilo(value_MPa: float | None) -> str:
    return output.number(None if value_MPa is None else 1e3 * value_MPa, 5)


def _between(pair: tuple[float, float] | None) -> str:
    return "-" if pair is None else " to ".join(f"{1e3 * v:.5g}" for v in pair)
