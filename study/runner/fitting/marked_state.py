"""A specimen with markers inside: its prediction, and what the markers say of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from study.errors import Fault, InputError
from study.forward.exchange import NoAnswer
from study.forward.finite_element import load_compiled, solve
from study.measurement.marker_section import MarkerSpec
from study.record.document import MarkerDocument, Quantity
from study.runner.fitting.solution import Predicted
from study.setup.geometry import Block
from study.setup.section import table_of, with_table
from study.setup.setup import Tables, problem_of
from study.shape_validation.marker_states import read_markers
from study.shape_validation.plate_fit import plate_fits


def predicted_markers(
    tables: Tables, constants: Mapping[str, float] | None, label: str, depth_mm: float
) -> Predicted:
    """Predict a state of a marked specimen and compare all markers.

    Parameters
    ----------
    tables : mapping
        Resolved tables with ``markers``, whose file was found.
    constants : mapping of str to float, optional
        In MPa; None where the tables give them.
    label : str
        Of the state.
    depth_mm : float
        Motion of the plate that was said.

    Raises
    ------
    NoAnswer
        If the problem, or a motion that fits, has no equilibrium.
    InputError
        If the specimen is no block.
    """
    from study.fem.solver.prescribed_motion import NoEquilibrium

    began, spec = time.perf_counter(), MarkerSpec.from_dict(table_of(tables, "markers"))
    problem = problem_of(with_table(tables, "test", displacement_mm=depth_mm), constants)
    if not isinstance(problem.specimen, Block):
        raise InputError(Fault("specimen.shape", "markers lie in a block", 'write "block"'))
    markers = read_markers(spec, Path(str(table_of(tables, "markers")["path"])), problem.specimen)
    load_compiled(problem)
    solution = solve(problem, gradients=False)
    if solution.status != "converged":
        raise NoAnswer(solution.status, solution.message)
    try:
        fits = plate_fits(spec, markers, label, problem, solution)
    except NoEquilibrium as error:
        raise NoAnswer("not-converged", str(error)) from error
    document: MarkerDocument = {
        "state": label,
        "floor_mm": markers.localization_floor(label),
        "fits": [fit.to_json(markers.layers) for fit in fits],
    }
    found = Predicted.of(solution, time.perf_counter() - began)
    return replace(found, markers=document)


def marker_responses(tables: Tables, found: MarkerDocument) -> dict[str, Quantity]:
    """Errors of the markers, with the plate that the study asks for, mm.

    Parameters
    ----------
    tables : mapping
        Resolved tables, whose ``markers.plate`` says which motion of the plate counts.
    found : MarkerDocument
        Of :func:`predicted_markers`.

    Returns
    -------
    dict of str to Quantity
        Root mean square errors: ``marker_error`` of all markers, and ``predicted_marker_error`` of
        those outside the layers that alone told the motion, or that are left out where the plate
        moves as was said. The latter's value is None where no layers are named.
    """
    plate = MarkerSpec.from_dict(table_of(tables, "markers")).plate
    # of all markers first; then, where layers are named, of those outside them
    errors = [fit["error_mm"] for fit in found["fits"] if fit["plate"] == plate]
    return {
        "marker_error": {"value": errors[0], "unit": "mm"},
        "predicted_marker_error": {"value": errors[1] if len(errors) > 1 else None, "unit": "mm"},
    }
