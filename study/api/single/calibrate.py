"""Constants of a material from measured tests."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from study.api.folders import calibration_root
from study.api.single.fit_figure import panels_of
from study.design.load import load_calibration
from study.errors import Fault, InputError
from study.record.atomic_files import write_atomic
from study.record.folder import own_folder
from study.reporting.figure.curves.fit import draw_fit, fit_figure
from study.reporting.figure.style import shown
from study.reporting.notebook import Shown
from study.runner import provenance
from study.runner.calibration.calibrate import calibrate as run_calibration
from study.runner.calibration.comparison import compare
from study.runner.calibration.model_selection import choose
from study.runner.calibration.result import CalibrationResult
from study.runner.numerical.numerical_bound import numerical_bound

if TYPE_CHECKING:
    import pandas as pd

    from study.design.sections.calibration_design import CalibrationDesign
    from study.reporting.figure.style import Drawing
    from study.runner.calibration.comparison import Comparison
    from study.runner.calibration.model_selection import EnergyChoice
    from study.runner.fitting.staged_fit import Step


@dataclass(frozen=True, repr=False)
class Calibrated(Shown, CalibrationResult):
    """What :func:`study.calibrate` returns: a :class:`CalibrationResult` that can be shown."""

    digits: ClassVar[int] = 5

    @classmethod
    def of(cls, found: CalibrationResult) -> Calibrated:
        """Give a calibration the ways to be shown."""
        return cls(**{item.name: getattr(found, item.name) for item in fields(CalibrationResult)})

    def to_frame(self) -> pd.DataFrame:
        """Constants with one row each.

        Returns
        -------
        DataFrame
            ``constant``, ``value``, ``unit``, ``standard_error``, ``low`` and ``high`` (95 %).
        """
        import pandas as pd

        document = self.to_json()["parameters"]
        rows = [
            {"constant": name, "value": one["value"], "unit": one["unit"],
             "standard_error": one["standard_error"], "low": one["ci95"][0],
             "high": one["ci95"][1]}
            for name, one in (document.items() if isinstance(document, dict) else ())
        ]  # fmt: skip
        return pd.DataFrame(rows)

    def plot(self) -> Drawing:
        """Draw every measured curve with its fit or prediction, and the residuals below.

        Returns
        -------
        Figure
            Of matplotlib.
        """
        title = f"{self.name}: {self.model}, {self.status}"
        return shown(lambda: draw_fit(panels_of(self), title), "calibration", title)

    def tables(self) -> Sequence[pd.DataFrame]:
        """Constants with their intervals."""
        return (self.to_frame(),)


def calibrate(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    results: str | Path | None = None,
    progress: Callable[[Step], None] | None = None,
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
    config = load_calibration(source, overrides)
    if config.asked.method == "analytic":
        rule = "analytic gives one modulus a curve, not the constants of an energy"
        raise InputError(Fault("calibration.method", rule, "call study.indentation_modulus"))
    root = calibration_root(config, source, data)
    config = _located(config, source, root)
    folder = None if results is None else own_folder(Path(results), config.name)
    found = run_calibration(
        config,
        root,
        progress=progress,
        profiles=profiles,
        resamples=resamples,
        folder=folder,
    )
    if numerics and found.converged:
        bound = numerical_bound(config, root, found.fit, progress)
        found = replace(found, numerics=bound.as_dict())
    if folder is not None:
        save_calibration(found, folder)
    return Calibrated.of(found)


def choose_energy(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    progress: Callable[[Step], None] | None = None,
) -> EnergyChoice:
    """Fit every energy to the tests of a calibration and weigh them by AICc.

    Parameters
    ----------
    source : str or Path
        Calibration file: its compressibility is kept, the energy that it names does not matter.
    data : str or Path, optional
        Folder of the measurements.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    progress : callable, optional
        Gets every accepted iteration.

    Returns
    -------
    EnergyChoice
        A fit of every energy that converged, its Akaike weight, and why others have no answer.

    Raises
    ------
    InputError
        For a faulty file or faulty data.
    """
    config = load_calibration(source, overrides)
    root = calibration_root(config, source, data)
    return choose(_located(config, source, root), root, progress=progress)


def compare_tests(
    source: str | Path,
    *,
    data: str | Path | None = None,
    overrides: Sequence[str] = (),
    difference: float = 0.05,
    zero: float = 0.0,
    progress: Callable[[Step], None] | None = None,
) -> Comparison:
    """Fit every test of a calibration for itself; Wald test that all have the same constants.

    Parameters
    ----------
    source : str or Path
        Calibration file.
    data : str or Path, optional
        Folder of the measurements.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    difference : float
        Share by which the moduli of one test are off in what the power is stated for.
    zero : float
        Standard uncertainty of the zero of a test's force, over its largest force.
    progress : callable, optional
        Gets every accepted iteration.

    Returns
    -------
    Comparison
        Constants of every test, the test of equality and its power.

    Raises
    ------
    InputError
        For a faulty file or faulty data, or a difference that is no share.
    RefusedError
        If a test alone does not determine the constants.
    """
    if not 0 < difference < 1:
        rule = f"must lie between 0 and 1, got {difference:g}"
        raise InputError(Fault("difference", rule, 'write "5 %" on the command line, 0.05 here'))
    if not 0 <= zero < 1:
        rule = f"must be a share of the largest force, got {zero:g}"
        raise InputError(Fault("zero", rule, 'write "0.2 %" on the command line, 0.002 here'))
    config = load_calibration(source, overrides)
    root = calibration_root(config, source, data)
    return compare(
        _located(config, source, root),
        root,
        difference=difference,
        zero=zero,
        progress=progress,
    )


def _located(config: CalibrationDesign, source: str | Path, root: Path) -> CalibrationDesign:
    """Copy a calibration with the surface of every test found."""
    places = provenance.folders(source, root)
    found = (replace(t, tables=provenance.located(t.tables, places)) for t in config.tests)
    return replace(config, tests=tuple(found))


def save_calibration(found: CalibrationResult, folder: Path) -> tuple[Path, Path]:
    """Write the document and the figure of a calibration; returns both paths.

    Parameters
    ----------
    found : CalibrationResult
        With its curves.
    folder : Path
        Made where it is missing; gets ``calibration.json`` and ``calibration.svg``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    document, figure = folder / "calibration.json", folder / "calibration.svg"
    text = json.dumps(found.to_json(), indent=2, allow_nan=False)
    write_atomic(document, text.encode())
    write_atomic(figure, calibration_figure(found).encode())
    return document, figure


def calibration_figure(found: CalibrationResult) -> str:
    """Every measured curve with its fit, as SVG.

    Parameters
    ----------
    found : CalibrationResult
        With its curves; a curve without a prediction is drawn alone.

    Returns
    -------
    str
        Text of the SVG.
    """
    return fit_figure(panels_of(found), f"{found.name}: {found.model}, {found.status}")
