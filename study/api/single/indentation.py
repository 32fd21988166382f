"""Young's modulus of measured indentations in closed form."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.folders import calibration_root
from study.contact_mechanics.closed_form import IndentationTest
from study.contact_mechanics.closed_form import indentation_modulus as modulus_of
from study.contact_mechanics.layer import Layer
from study.contact_mechanics.result import AnalyticCalibration
from study.design.load import load_calibration
from study.errors import Fault, InputError
from study.record.atomic_files import write_atomic
from study.record.folder import own_folder
from study.setup.geometry import Block, Cylinder, Sphere
from study.setup.material_section import Compressibility, MaterialSection

if TYPE_CHECKING:
    from study.contact_mechanics.result import FittedCurve
    from study.design.sections.calibration import Fitting
    from study.design.sections.calibration_design import CalibratedTest

#: override that asks a calibration file for the closed form
ASKED = 'calibration.method="analytic"'


def indentation_modulus(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    results: str | Path | None = None,
) -> AnalyticCalibration:
    """Fit Young's modulus to measured indentations in closed form, curve by curve.

    Parameters
    ----------
    source : str or Path
        Calibration file whose tests are indentations of a cylinder or block.
    data : str or Path, optional
        Folder of the measurements.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    results : Path, optional
        Where the document and the table of curves are written; nothing is written without.

    Returns
    -------
    AnalyticCalibration
        Modulus of every curve, median over units with its interval, and the share of rows that
        lie beyond the range in which the closed form holds.

    Raises
    ------
    InputError
        For a faulty file, faulty data, or a test that has no closed form.
    """
    began = time.perf_counter()
    config = load_calibration(source, (*overrides, ASKED))
    root = calibration_root(config, source, data)
    tests: list[IndentationTest] = []
    faults: list[Fault] = []
    for number, test in enumerate(config.tests):
        try:
            tests.append(_test_of(test, config.asked, f"tests[{number}]"))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError([Fault(f"{source}: {f.where}", f.rule, f.mend) for f in faults])
    found = [modulus_of(one, root, number) for number, one in enumerate(tests)]
    notes = tuple(dict.fromkeys(note for _, own in found for note in own))
    moduli = tuple(one for one, _ in found)
    result = AnalyticCalibration(config.name, moduli, notes, time.perf_counter() - began)
    if results is not None:
        save_moduli(result, own_folder(Path(results), result.name))
    return result


def _test_of(test: CalibratedTest, asked: Fitting, where: str) -> IndentationTest:
    """Gather what the closed form needs of one test.

    Raises
    ------
    InputError
        If the test has no closed form.
    """
    setup = test.setup
    specimen, pressed = setup.specimen, setup.test.indenter
    if not setup.kind.takes_indenter or pressed is None:
        rule = f"analytic is for indentation, got {setup.test.kind}"
        mend = 'leave calibration.method out: "auto" knows the closed form of the other tests'
        raise InputError(Fault(f"{where}.test.kind", rule, mend))
    if not isinstance(specimen, (Cylinder, Block)):
        rule = f"analytic needs a cylinder or block, got {specimen.shape}"
        raise InputError(Fault(f"{where}.specimen", rule, "its height is that of the layer"))
    if setup.test.interface == "bonded":
        rule = "analytic takes the indenter for frictionless, got bonded"
        mend = 'write interface = "frictionless", or leave calibration.method out'
        raise InputError(Fault(f"{where}.test.interface", rule, mend))
    if asked.theory == "dimitriadis" and not isinstance(pressed, Sphere):
        rule = f"dimitriadis is a series for spheres, got {pressed.shape}"
        mend = 'write theory = "integral-equation"'
        raise InputError(Fault("calibration.theory", rule, mend))
    nu = _poisson_ratio(MaterialSection.of(test.tables).compressibility)
    return IndentationTest(
        indenter=pressed,
        layer=Layer(specimen.height_mm, nu, setup.test.base == "bonded"),
        area_mm2=specimen.area_mm2,
        spec=test.measurements,
        displacement_mm=setup.test.displacement_mm,
        theory=asked.theory,
        paraboloid=asked.profile == "paraboloid",
        find_contact=asked.contact == "fitted",
    )


def _poisson_ratio(volume: Compressibility) -> float:
    if volume.incompressible:
        return 0.5
    if volume.poisson_ratio is None:
        rule = "the closed form needs Poisson's ratio, got bulk_modulus"
        mend = "write poisson_ratio = ..., or incompressible = true"
        raise InputError(Fault("material.bulk_modulus", rule, mend))
    return volume.poisson_ratio


def save_moduli(found: AnalyticCalibration, folder: Path) -> tuple[Path, Path]:
    """Write the document, and a table with one row a curve; returns both paths.

    Parameters
    ----------
    found : AnalyticCalibration
        Moduli in MPa; the table has them in kPa.
    folder : Path
        Made where it is missing; gets ``analytic.json`` and ``moduli.csv``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    document, table = folder / "analytic.json", folder / "moduli.csv"
    text = json.dumps(found.to_json(), indent=2, allow_nan=False)
    write_atomic(document, text.encode())
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    columns = ("E_kPa", "standard_error_kPa", "low_kPa", "high_kPa", "contact_mm")
    writer.writerow(["test", "curve", "status", *columns, "rows", "rows_outside"])
    for test in found.tests:
        writer.writerows([test.test, *_row(one)] for one in test.curves)
    write_atomic(table, out.getvalue().encode())
    return document, table


def _row(curve: FittedCurve) -> list[object]:
    one = curve.found
    low, high = one.interval_MPa or (None, None)
    moduli = [one.modulus_MPa, one.error_MPa, low, high]
    shown = ["" if v is None else f"{1e3 * v:.10g}" for v in moduli]
    contact = "" if one.contact_mm is None else f"{one.contact_mm:.10g}"
    return [curve.label, one.status, *shown, contact, one.rows, one.rows_outside]
