"""Surfaces of a table, and what those of a study predict at settings that were not run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from study.api import opened_study
from study.ground import tabular, units
from study.ground.errors import Fault, InputError, RefusedError, nearest
from study.harness.design.load import RESULTS, design_root, results_folder
from study.harness.design.spec import Design
from study.harness.runner.adaptive_cells import confirm
from study.harness.runner.batch import Progress
from study.record.record import are_imported
from study.simulation.job import NOTHING, Allowed
from study.simulation.problem_file import ANY, dimension_of
from study.statistics.surfaces import surface_fitting
from study.statistics.surfaces.emulator import LARGEST, expected_seconds
from study.statistics.surfaces.surface_factors import some_runs
from study.statistics.surfaces.surface_result import (
    FittedSurface,
    SurfaceAnalysis,
    SurfacePrediction,
)

if TYPE_CHECKING:
    from study.api.assemble import Study
    from study.ground.arrays import Array
    from study.record.record import Record


#: setting of a factor: with its unit, a number or numbers in the unit of the design, or a label
Setting = str | ArrayLike


def predict(
    path: str | Path | Study,
    at: Mapping[str, Setting],
    *,
    response: str | None = None,
    results: str | Path = RESULTS,
) -> tuple[SurfacePrediction, ...]:
    """Predict the responses of a study with numeric factors.

    Parameters
    ----------
    path : str, Path or Study
        Results folder, design file, name of the study, or the study itself.
    at : mapping
        Setting of every factor: ``"3 mm"``, numbers of shape (m,) in the unit of the design's
        range, or the label of a level where the factor is no number.
    response : str, optional
        One response alone.
    results : Path
        Folder of the results, where ``path`` is a name.

    Returns
    -------
    tuple of SurfacePrediction
        One for every response.

    Raises
    ------
    InputError
        If a factor is missing or unknown, a setting has another dimension, a point would have to
        be extrapolated, or the study has no surface.
    """
    study = opened(path, results)
    surfaces = surfaces_of(study, response)
    numbers, labels = given(study.design, at, {
        factor.name: Fault(factor.name, "has no setting", "give every factor one")
        for factor in study.design.factors
    })  # fmt: skip
    here = [fitted for fitted in surfaces if dict(fitted.labels) == labels]
    faults = [
        Fault("predict", f"{model.response} has no surface: {model.refused}",
              "add runs, or ask another --response")
        for model in here if model.surface is None
    ]  # fmt: skip
    if faults:
        raise InputError(faults)
    return tuple(
        replace(model.surface.predict(numbers), response=model.response, unit=model.unit)
        for model in here
        if model.surface is not None
    )


def opened(path: str | Path | Study, results: str | Path, *, fits_surfaces: bool = True) -> Study:
    """Study that a verb is asked about, whether by its place or by itself."""
    if not isinstance(path, str | Path):
        return path
    return opened_study.opened(results_folder(path, results), fits_surfaces=fits_surfaces)


def given(
    design: Design, at: Mapping[str, Setting], needed: Mapping[str, Fault] | None = None
) -> tuple[dict[str, Array], dict[str, str]]:
    """Read settings of ranges in their units, and labels of the others; all faults at once.

    ``speed`` names ``parameters.speed`` where no factor is called so. The settings that are needed
    come with what is wrong where they are missing.
    """
    names, lists = [factor.name for factor in design.factors], design.lists
    full = {n: f"parameters.{n}" for n in at if n not in names}
    at = {full[n] if full.get(n) in names else n: setting for n, setting in at.items()}
    labels = {n: str(at[n]) for n in lists if n in at}
    faults = unknown_factors(at, names)
    faults += [fault for n, fault in (needed or {}).items() if n not in at]
    faults += [
        Fault(n, f"has no level {label!r}", nearest(label, lists[n]))
        for n, label in labels.items()
        if label not in lists[n]
    ]
    if faults:
        raise InputError(faults)
    spans = design.ranges.items()
    return {n: number_in_unit(n, span.unit, at[n]) for n, span in spans if n in at}, labels


def surfaces_of(study: Study, response: str | None = None) -> tuple[FittedSurface, ...]:
    """Surfaces of a study, of one response alone where it is named; refused where there is none."""
    if not study.surfaces:
        rule = "has no surface: no factor is a range"
        mend = 'write { low = "1 mm", high = "3 mm" } and [design] kind = "latin-hypercube"'
        if are_imported(study.manifest["notes"]):
            mend = "import the table again with --numeric and the columns that are numbers"
        raise InputError(Fault(study.design.name, rule, mend))
    names = list(dict.fromkeys(fitted.response for fitted in study.surfaces))
    if response is not None and response not in names:
        raise InputError(Fault("--response", f"there is no {response!r}", nearest(response, names)))
    return tuple(fitted for fitted in study.surfaces if response in (None, fitted.response))


def unknown_factors(at: Iterable[str], factors: Sequence[str]) -> list[Fault]:
    """Faults of settings of what is no factor."""
    return [Fault(n, "no such factor", nearest(n, factors)) for n in at if n not in factors]


def number_in_unit(name: str, unit: str, setting: Setting) -> Array:
    """Read settings (m,) in the unit of a factor's range."""
    kind = dimension_of(name)
    if not isinstance(setting, str):
        return np.atleast_1d(np.asarray(setting, dtype=np.float64))
    with units.naming(name):
        if kind == ANY and unit:
            return np.array([units.converted(*units.split(setting), unit)])
        if kind is None or not unit:
            return np.array([units.parse_number(setting)])
        return np.array([units.parse(setting, kind) / units.parse(f"1 {unit}", kind)])


@dataclass(frozen=True)
class Permission:
    """What a run of the true model may use."""

    data: str | Path | None = None
    #: Programs and functions that it may run.
    allowed: Allowed = NOTHING
    progress: Callable[[Progress], None] | None = None

    def confirm(self, study: Study, settings: Mapping[str, float | str]) -> tuple[Record, ...]:
        """Run the true model at a setting, and let the run join the study's surfaces."""
        root, progress = design_root(study.design, self.data), self.progress or (lambda _: None)
        return confirm(
            study.design, study.folder, study.manifest, settings, root, self.allowed, progress
        )


# Surfaces over the numeric factors of a table.

#: seconds from which a fit is announced
LONG = 5.0


class SurfaceOptions(TypedDict, total=False):
    """Keywords of :func:`fit_surfaces`, where they are described."""

    surface: surface_fitting.Surface
    block: str | None
    practical: float | str | None
    decimal: str
    announce: Callable[[str], None] | None


def fit_surface(
    source: str | Path, response: str, numeric: Sequence[str], **options: Unpack[SurfaceOptions]
) -> SurfaceAnalysis:
    """Fit a response over numeric factors, and say what they do.

    Parameters
    ----------
    source : str or Path
        CSV with one row a run.
    response : str
        Column of the response; rows without one are left out, and that is said.
    numeric : sequence of str
        Columns of the factors: ``"time"``, ``"time=80..90"`` for the settings that are coded -1
        and 1 (those of the runs if left out), ``"time log"`` to code the logarithm.
    **options : optional
        As for :func:`fit_surfaces`: ``surface``, ``block``, ``practical``, ``decimal``,
        ``announce``.

    Returns
    -------
    SurfaceAnalysis
        The model, what it says of every factor, and ``predict``.

    Raises
    ------
    InputError
        Naming file, row and column, all faults at once.
    RefusedError
        If the runs cannot carry what is asked.
    """
    alone = fit_surfaces(source, response, numeric, (), **options)
    # without labels there is one, and what keeps it from being fitted is raised
    return next(fitted.surface for fitted in alone if fitted.surface is not None)


def fit_surfaces(  # noqa: PLR0913  # the public face: one keyword for each thing that may be asked
    source: str | Path,
    response: str,
    numeric: Sequence[str],
    factors: Sequence[str],
    *,
    surface: surface_fitting.Surface = "auto",
    block: str | None = None,
    practical: float | str | None = None,
    decimal: str = ".",
    announce: Callable[[str], None] | None = None,
) -> tuple[FittedSurface, ...]:
    """Fit a response over numeric factors at every combination of labels, and compare these.

    Where runs are few at each combination one emulator is fitted to all of them, if it predicts
    left-out runs better.

    Parameters
    ----------
    source : str or Path
        CSV with one row a run.
    response : str
        Column of the response; rows without one are left out, and that is said.
    numeric : sequence of str
        Columns of the factors that are numbers, as of :func:`fit_surface`; the ranges are those of
        all runs.
    factors : sequence of str
        Columns of the factors that are labels.
    surface : {"auto", "quadratic", "emulator", "none"}
        By itself an emulator for more than five factors, or settings that fill the box.
    block : str, optional
        Column of the blocks; a quadratic needs a run of each at every setting, an emulator three
        blocks.
    practical : float or str, optional
        Smallest difference that matters: a number, or "5 % of mean" of all runs.
    decimal : {".", ","}
        Decimal mark of the file.
    announce : callable, optional
        Told beforehand what a long fit will cost.

    Returns
    -------
    tuple of FittedSurface
        One a combination that has runs, the last factor changing fastest.

    Raises
    ------
    InputError
        Naming file, row and column.
    RefusedError
        If no combination can carry a surface.
    """
    kinds = [word for word in get_args(surface_fitting.Surface) if word != "none"]
    if surface not in kinds:
        mend = nearest(surface, kinds) if surface != "none" else "leave --numeric out for a table"
        raise InputError(Fault("--surface", f"{surface!r} asks for no surface", mend))
    table = tabular.read_csv(
        Path(source), numbers=[response], decimal=decimal, declared_by=tabular.TYPED_COMMA
    ).without_units([response])
    runs, answered, notes = surface_fitting.runs_of(table, response, numeric, block)
    places, rows = surface_fitting.places_of(
        table, factors, answered, {*runs.names, response, block}
    )
    if announce is not None and surface_fitting.kind_of(runs, surface) == "emulator":
        counts = [runs.blocks.count(name) for name in set(runs.blocks)] or [runs.response.size]
        seconds = sum(expected_seconds(n) for n in counts)
        if seconds > LONG and max(counts) <= LARGEST:
            announce(f"an emulator of {runs.response.size} runs takes about {seconds:.0f} s")
    difference = surface_fitting.difference_of(practical, runs)
    sizes = [len({labels[name] for labels in places}) for name in factors]
    each = surface_fitting.surfaces_at(
        FittedSurface(runs.name, "", None, practical=difference), places, sizes, surface,
        [partial(some_runs, runs, here) for here in rows], difference,
    )  # fmt: skip
    if all(fitted.surface is None for fitted in each):
        raise RefusedError(f"no combination carries a surface: {each[0].refused}")
    return surface_fitting.compared(surface_fitting.noted(each, (*table.notes, *notes), surface))
