"""Constants of a material from measured tests."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.ground.declaration import Faults
from study.ground.errors import Fault, InputError
from study.ground.files import own_folder, write_atomic, write_new
from study.ground.tabular import csv_text
from study.harness.design.load import (
    calibration_root,
    demo_design,
    load,
    load_calibration,
    template,
)
from study.laboratory.tracker.tracker_recording import is_tracking, load_tracking, write_recording
from study.mechanics.indentation.indentation_modulus import (
    AnalyticCalibration,
    CurveModulus,
    IndentationTest,
)
from study.mechanics.indentation.indentation_modulus import indentation_modulus as modulus_of
from study.mechanics.measurement import inspection
from study.reporting.content.calibration_content import calibration_blocks
from study.reporting.figures.axes import render, shown
from study.reporting.output.page import Shown
from study.simulation.calibration.calibrate_tests import calibrate as run_calibration
from study.simulation.calibration.calibration_bound import numerical_bound, with_numerical
from study.simulation.calibration.calibration_result import CalibrationResult
from study.simulation.calibration.measured_tests import indentation_test
from study.simulation.calibration.model_comparison import (
    EnergyChoice,
    ModelComparison,
    choose,
    compare,
)
from study.simulation.job import folders, located
from study.simulation.virtual_specimens import usual_generator, write_tests, write_virtual

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.content.blocks import Block as ResultBlock
    from study.reporting.figures.axes import Drawing
    from study.reporting.figures.curve_figures import FitPanel
    from study.simulation.calibration.calibration_file import CalibrationDesign
    from study.simulation.fit_task import FitStep


# Curves of a calibration as the panels of its figure.


def panels_of(result: CalibrationResult) -> list[FitPanel]:
    """Every measured curve with its prediction."""
    from study.reporting.figures.curve_figures import FitPanel

    panels = []
    for curve in result.curves:
        test, measured, predicted = curve.measured, curve.curve, curve.predicted
        panels.append(FitPanel(
            curve.label,
            curve.role == "fit", measured.places, measured.force_N,
            None if predicted is None else predicted.force_at(measured.displacement_mm),
            test.scatter_N, measured.time_s is not None, test.directions > 1,
        ))  # fmt: skip
    return panels


def recording_points(result: CalibrationResult) -> pd.DataFrame:
    """Every recorded row of the tests of a calibration, its branch and why it is set aside."""
    import pandas as pd

    frames = []
    for number, curve in enumerate(result.curves, 1):
        for k, test in enumerate(curve.measured.tests, 1):
            rows = test.specimen
            branch = np.empty(rows.fate.size, dtype=object)
            for phase in rows.phases:
                branch[phase.rows] = phase.words
            title = f"{number}: {curve.label}"
            shown = {
                "test": title if len(curve.measured.tests) == 1 else f"{title}, {k}",
                "line": rows.recording.lines,
                "far": rows.recording.kinematic,
                "hard": rows.recording.kinetic,
                "branch": branch,
                "set_aside": np.array(rows.reasons, dtype=object)[rows.fate],
                "far_name": rows.recording.quantities[0],
                "hard_name": rows.recording.quantities[1],
            }
            frames.append(pd.DataFrame(shown))
    return pd.concat(frames, ignore_index=True)


@dataclass(frozen=True, repr=False)
class Calibrated(Shown, CalibrationResult):
    """What :func:`study.calibrate` returns: a :class:`CalibrationResult` that can be shown."""

    def to_frame(self) -> pd.DataFrame:
        """Constants with one row each."""
        import pandas as pd

        document: object = self.to_json()["parameters"]
        rows = [
            {"constant": name, "value": entry["value"], "unit": entry["unit"],
             "standard_error": entry["standard_error"], "low": entry["ci95"][0],
             "high": entry["ci95"][1]}
            for name, entry in (document.items() if isinstance(document, dict) else ())
        ]  # fmt: skip
        return pd.DataFrame(rows)

    def plot(self) -> Drawing:
        """Draw every measured curve with its fit or prediction, and the residuals below."""
        from study.reporting.figures.curve_figures import draw_fit

        title = _title(self)
        return shown(lambda: draw_fit(panels_of(self), title), "calibration", title)

    def blocks(self) -> Iterator[ResultBlock]:
        """Constants and what they rest on, as ``study calibrate`` prints them."""
        return calibration_blocks(self.to_json())


def calibrate(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    results: str | Path | None = None,
    progress: Callable[[FitStep], None] | None = None,
    profiles: bool = False,
    numerics: bool = False,
    resamples: int = 0,
) -> Calibrated:
    """Find material constants from one or several measured tests.

    Parameters
    ----------
    source : str or Path
        Calibration file.
    data : str or Path, optional
        Folder of the measurements.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    results : Path, optional
        Where accepted iterations are kept while it runs (an interrupted calibration goes on
        from there), and the document and the figure in the end; nothing is written without.
    progress : callable, optional
        Gets every accepted iteration.
    profiles : bool
        Whether profile-likelihood intervals are computed.
    numerics : bool
        Whether the error by meshes and load steps is bounded, by fits on others.
    resamples : int
        How many resampled fits give bootstrap intervals, 200 or more; 0 for none.

    Returns
    -------
    CalibrationResult
        Constants with intervals, stability, residuals and how the search ended; ``to_frame()``,
        ``plot()``, and a table in a notebook.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    config, root = _opened(source, overrides, data)
    if config.fitting.method == "analytic":
        rule = "analytic gives one modulus a curve, not the constants of an energy"
        raise InputError(Fault("calibration.method", rule, "call study.indentation_modulus"))
    folder = None if results is None else own_folder(Path(results), config.name)
    result = run_calibration(
        config, root, progress=progress, profiles=profiles, resamples=resamples, folder=folder
    )
    if numerics and result.converged:
        bound = numerical_bound(config, root, result.fit, progress)
        result = replace(result, numerics=bound.as_dict())
        if not bound.failure:  # in place of the estimate, which the intervals hold so far
            scattered = replace(result.fit, ci95=result.minima[0].ci95)
            result = replace(
                result, numerical=result.numerics, fit=with_numerical(scattered, bound)
            )
    if folder is not None:
        save_calibration(result, folder)
    return Calibrated.of(result)


def choose_energy(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    progress: Callable[[FitStep], None] | None = None,
) -> EnergyChoice:
    """Fit every energy to the tests of a calibration file and weigh them by AICc.

    The compressibility of the file is kept; the energy that it names does not matter.
    """
    return choose(*_opened(source, overrides, data), progress=progress)


def compare_tests(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    difference: float = 0.05,
    zero: float = 0.0,
    progress: Callable[[FitStep], None] | None = None,
) -> ModelComparison:
    """Fit every test of a calibration for itself; Wald test that all have the same constants.

    The power is for moduli of one test off by the share ``difference``; ``zero`` is the standard
    uncertainty of the zero of a test's force, over its largest force.
    """
    if not 0 < difference < 1:
        rule = f"must lie between 0 and 1, got {difference:g}"
        raise InputError(Fault("difference", rule, 'write "5 %" on the command line, 0.05 here'))
    if not 0 <= zero < 1:
        rule = f"must be a share of the largest force, got {zero:g}"
        raise InputError(Fault("zero", rule, 'write "0.2 %" on the command line, 0.002 here'))
    opened = _opened(source, overrides, data)
    return compare(*opened, difference=difference, zero=zero, progress=progress)


def _opened(
    source: str | Path, overrides: Sequence[str], data: str | Path | None
) -> tuple[CalibrationDesign, Path]:
    """Calibration of a file with the place of every surface, and the folder of its measurements."""
    config = load_calibration(source, overrides)
    root = calibration_root(config, source, data)
    places = folders(source, root)
    tests = (replace(t, problem=located(t.problem, places)) for t in config.tests)
    return replace(config, tests=tuple(tests)), root


def save_calibration(result: CalibrationResult, folder: Path) -> None:
    """Write the document of a calibration, its figure and that of the recordings."""
    from study.reporting.figures.curve_figures import draw_fit
    from study.reporting.figures.study_figures import of_recordings

    drawn = of_recordings(recording_points(result))
    if drawn.svg:
        write_atomic(folder / "recording.svg", drawn.svg.encode())
    text = json.dumps(result.to_json(), indent=2, allow_nan=False)
    write_atomic(folder / "calibration.json", text.encode())
    title = _title(result)
    figure = render(lambda: draw_fit(panels_of(result), title), "calibration", title)
    write_atomic(folder / "calibration.svg", figure.encode())


def _title(result: CalibrationResult) -> str:
    return f"{result.name}: {result.model}, {result.status}, {result.adequacy.verdict} the data"


# What a recorded file holds.


def inspect(source: str | Path, *, sheet: str = "") -> inspection.Inspection:
    """Look at a recorded file: how it is written, what its columns hold, how it is read.

    Parameters
    ----------
    source : str or Path
        Recorded file: text or workbook, plain or gzip.
    sheet : str
        Sheet of a workbook; the one with the most numbers if it is empty.

    Returns
    -------
    Inspection
        Encoding, marks, columns, phases, and the table ``[measurements]`` that reads the file:
        ``print(found.toml)``.

    Raises
    ------
    InputError
        For a file that cannot be read, or holds no rows of numbers.
    """
    return inspection.inspect(Path(source), sheet)


# How a calibration file wants its constants found.


def is_analytic(source: str | Path, overrides: Sequence[str] = ()) -> bool:
    """Whether a calibration file asks for the closed form of indentations."""
    return load_calibration(source, overrides).fitting.method == "analytic"


# Files to start from: virtual measurements, a commented design or calibration.


def virtual(
    out: str | Path,
    source: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    truth: str = "yeoh",
    blocks: int | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write virtual measurements for a design, the demo's by default; or a tracker's recording.

    ``truth`` is the material behind the specimens (yeoh, ogden or humphrey), of which there are
    ``blocks``, 6 by default; the files get the names that the design gives them below ``out``.
    ``progress`` is called with a sentence before each simulation.
    """
    if source is not None and is_tracking(source):
        if overrides or blocks is not None:
            mend = "leave -s and --specimens out; a tracker has neither"
            raise InputError(Fault(str(source), "is a file of `study tracking`, no design", mend))
        return write_recording(load_tracking(source), Path(out))
    design = demo_design(overrides) if source is None else load(source, overrides)
    generator = usual_generator(design, truth_name=truth, blocks=blocks)
    return write_virtual(design, Path(out), generator, progress)


def new_file(file: str | Path, *, calibration: bool = False) -> list[Path]:
    """Write a commented file to start from."""
    path = Path(file)
    write_new(path, template("calibration" if calibration else "template"))
    return [path, *(write_tests(path.parent / "tests-of-material") if calibration else ())]


# Young's modulus of measured indentations in closed form.

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
    faults = Faults()
    for number, test in enumerate(config.tests):
        with faults.gathered():
            tests.append(indentation_test(test, config.fitting, f"tests[{number}]"))
    faults.refuse(str(source))
    judged = [modulus_of(recording, root, number) for number, recording in enumerate(tests)]
    notes = tuple(dict.fromkeys(note for _, warnings in judged for note in warnings))
    moduli = tuple(recording for recording, _ in judged)
    result = AnalyticCalibration(config.name, moduli, notes, time.perf_counter() - began)
    if results is not None:
        save_moduli(result, own_folder(Path(results), result.name))
    return result


def save_moduli(result: AnalyticCalibration, folder: Path) -> None:
    """Write the document, and a table with one row a curve. Units: found MPa, kPa."""
    text = json.dumps(result.to_json(), indent=2, allow_nan=False)
    write_atomic(folder / "analytic.json", text.encode())
    moduli = ("E_kPa", "standard_error_kPa", "low_kPa", "high_kPa", "contact_mm")
    columns = ("test", "curve", "status", *moduli, "rows", "rows_outside")
    rows = ([test.test, *_row(curve)] for test in result.tests for curve in test.curves)
    write_atomic(folder / "moduli.csv", csv_text(columns, rows).encode())


def _row(curve: CurveModulus) -> list[object]:
    low, high = curve.interval_MPa or (None, None)
    moduli = [curve.modulus_MPa, curve.error_MPa, low, high]
    shown = ["" if v is None else f"{1e3 * v:.10g}" for v in moduli]
    contact = "" if curve.contact_mm is None else f"{curve.contact_mm:.10g}"
    return [curve.label, curve.status, *shown, contact, curve.rows, curve.rows_outside]
