"""Checks of a whole design: every cell, every response, every replicate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from study.contrast import sides_of
from study.design.diagnostics import Faults, quoted_path
from study.design.factors import Presets
from study.design.sections.cell import Cell
from study.design.sections.simulated import is_simulated, simulated_at
from study.design.spec import Design, Level
from study.design.study_file import MARKED, RESPONSES, SCORED
from study.errors import Fault, InputError, nearest

MAX_FAULTS = 100


def check_cells(design: Design, presets: Presets, faults: Faults) -> None:
    """Check every cell that is not left out; a fault of a level is told where it is written.

    Parameters
    ----------
    design : Design
        As read, its cells not yet checked.
    presets : mapping of str to mapping
        Dotted keys of every level, by set and label.
    faults : Faults
        Where faults go.
    """
    count, cells = 0, []
    found: dict[Fault, list[str]] = {}
    for one, levels in design.combinations():
        if design.why_excluded(one.levels) is not None or len(found) > MAX_FAULTS:
            continue
        count += 1
        own = Faults()
        cells.append(design.resolved(levels, own))
        places = _places(design, levels, presets)
        for fault in own:
            found.setdefault(_moved(fault, places), []).append(one.label)
    for fault, labelled in found.items():
        told = len(labelled) == count or fault.where.startswith(("presets.", "factors."))
        where = "" if told else f" (in {_listed(labelled)})"
        faults.add(fault.where, fault.rule + where, fault.mend)
    _check_left(design, faults)
    if not faults:  # a level that cannot be read would be missed here once more
        _check_contrasts(design, faults)
    if not found and cells:
        _check_courses(cells, faults)
        _check_responses(design, cells, faults)
        check_replicates(design, cells, faults)


def _check_contrasts(design: Design, faults: Faults) -> None:
    """Find differences that are asked for of levels that do not exist, or of cells left out."""
    where = "analysis.contrasts"
    levels = {factor.name: factor.labels for factor in design.factors if factor.span is None}
    kept = [one.levels for one, _ in design.combinations() if not design.why_excluded(one.levels)]
    for text in design.analysis.contrasts:
        try:
            sides = sides_of(text, levels)
        except InputError as error:
            for fault in error.faults:
                faults.add(where, f"{fault.where}: {fault.rule}", fault.mend)
            continue
        for side in sides:
            if not any(side.items() <= cell.items() for cell in kept):
                named = ", ".join(f"{name}={level}" for name, level in side.items())
                faults.add(where, f"contrast {text!r}: no cell that is run has {named}", "")


def _listed(labels: Sequence[str]) -> str:
    return labels[0] + (f" and {len(labels) - 1} more cells" if len(labels) > 1 else "")


def _places(design: Design, levels: Sequence[Level], presets: Presets) -> dict[str, str]:
    """Dotted key of the merged file -> where the level that sets it is written."""
    places: dict[str, str] = {}
    for factor, level in zip(design.factors, levels, strict=True):
        for key in level.settings:
            places[key] = f"factors.{quoted_path(factor.name)}"
            if factor.name in presets:
                inner = key.removeprefix(f"{factor.name}.")
                places[key] = f"presets.{factor.name}.{quoted_path(level.label)}.{inner}"
    return places


def _moved(fault: Fault, places: Mapping[str, str]) -> Fault:
    for key, place in places.items():
        if fault.where == key or fault.where.startswith((f"{key}.", f"{key}[")):
            return Fault(place + fault.where.removeprefix(key), fault.rule, fault.mend)
    return fault


def _check_left(design: Design, faults: Faults) -> None:
    """Check that the exclusions leave every factor two levels."""
    every = [one.levels for one, _ in design.combinations()]
    left = [levels for levels in every if design.why_excluded(levels) is None]
    for factor in design.factors:
        count = len({levels[factor.name] for levels in left})
        if count < 2 <= len(factor.levels):
            rule = f"leaves {count} of the {len(factor.levels)} levels of {factor.name!r}"
            faults.add("exclude", rule, "a factor needs two levels; remove it, or exclude less")


def _check_courses(cells: Sequence[Cell], faults: Faults) -> None:
    """Keep courses that stand still or go back out of designs, whose curves are over distance."""
    for cell in cells:
        for problem in (cell.problem, cell.fitted):
            test, spec = problem.test, problem.measurements
            mend = "responses compare curves over displacement: `study solve` follows a course"
            for key, value in (("hold", test.hold_s), ("cycles", test.cycles)):
                if value is not None:
                    faults.add(f"test.{key}", "has no place in a design", mend)
            if spec is not None and spec.columns.time is not None:
                mend = "give test.speed, or fit the course by `study calibrate`"
                faults.add("measurements.columns.time", "has no place in a design", mend)


def _check_responses(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    for i, response in enumerate(design.responses):
        where = f"response[{i}].name"
        if response.name in SCORED and any(c.problem.measurements is None for c in cells):
            rule = f"{response.name} compares with measured curves, and there are none"
            faults.add(where, rule, "add [measurements]")
        elif response.name in MARKED:
            _check_marked(response.name, where, cells, faults)
        elif is_simulated(response.name):
            _check_place(response.name, f"response[{i}].displacement", cells, faults)
        elif response.name and response.name not in RESPONSES:
            names = {n for c in cells for n in c.problem.material.calibrated_names}
            if response.name not in names:
                rule = f"no material of this design has a constant {response.name}"
                faults.add(where, rule, nearest(response.name, sorted(names)))


def _check_marked(name: str, where: str, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that there are markers, and some that are left to be predicted."""
    specs = [cell.problem.markers for cell in cells]
    if any(spec is None for spec in specs):
        rule = f"{name} compares with markers inside the specimen, and there are none"
        faults.add(where, rule, "add [markers]")
    elif name == "predicted_marker_error" and not all(spec and spec.fit for spec in specs):
        rule = f"{name} is of markers that did not tell how the plate moved, and all did"
        faults.add(where, rule, "add markers.layer and markers.fit")


def _check_place(name: str, where: str, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that every cell is pressed as far as a response looks."""
    place = simulated_at(name)[1]
    depths = [c.problem.test.displacement_mm for c in cells]
    least = min((depth for depth in depths if depth is not None), default=None)
    if place is not None and least is not None and place > least * (1 + 1e-9):
        rule = f"is {place:g} mm, and a cell is pressed {least:g} mm only"
        faults.add(where, rule, "take it inside the test of every cell, or press deeper")


#: responses that a fit alone does not give
_NO_CONSTANT = (*SCORED, *MARKED, "seconds")


def check_replicates(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that every cell has what its replicates vary.

    Parameters
    ----------
    design : Design
        With its ``[replicates]`` and ``analysis.error``.
    cells : sequence of Cell
        All that are not left out, each resolved without a fault.
    faults : Faults
        Where faults go.
    """
    asked = design.replicates.noise or design.replicates.mesh_seeds
    if design.analysis.error == "replicates" and not asked:
        rule = "is the scatter of replicates, and the design asks for none"
        faults.add("analysis.error", rule, "add [replicates] mesh_seeds = 5 or noise = 200")
    if design.replicates.noise:
        _check_noise(design, cells, faults)
    if design.replicates.mesh_seeds and not any(_meshed(cell) for cell in cells):
        rule = (
            "every cell is compression between frictionless plates, which is the same on every "
            "mesh: there is no scatter of meshes to learn"
        )
        faults.add("replicates.mesh_seeds", rule, "leave it out, or vary something with a mesh")


def _check_noise(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    where = "replicates.noise"
    given = sum(not cell.is_calibrated for cell in cells)
    if given:
        rule = (
            "fits again to the measured curve with resampled residuals, but in "
            f"{given} of {len(cells)} cells the constants are given and nothing is fitted"
        )
        faults.add(where, rule, 'write calibration.method = "auto", or use mesh_seeds')
    if not any(is_constant(response.name) for response in design.responses):
        rule = "says how much calibrated constants scatter, and no response is one"
        faults.add(where, rule, 'add [[response]] name = "mu0" (or C10, ...), or use mesh_seeds')


def is_constant(response: str) -> bool:
    """Whether a response is a constant or mu0, which a fit gives without a prediction.

    Parameters
    ----------
    response : str
        Name of a response that exists.

    Examples
    --------
    >>> is_constant("mu0"), is_constant("C10"), is_constant("work_error"), is_constant("work")
    (True, True, False, False)
    """
    return response not in _NO_CONSTANT and not is_simulated(response)


def _meshed(cell: Cell) -> bool:
    """Whether a mesh can change an answer of a cell: its scored test or its calibration."""
    return not (cell.problem.is_homogeneous and cell.fitted.is_homogeneous)
