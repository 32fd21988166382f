"""What the records of a results folder hold, in plain values: constants, curves, responses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.ground.declaration import table_of
from study.ground.errors import InputError
from study.record.record import CurveKey
from study.simulation.response import simulated_at

Config = Mapping[str, Any]

RESPONSES = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")
#: responses of the simulation alone that are read from forces
SIMULATED = ("peak_force", "force_at", "work")
_CLOSED_FORM = "closed form"


@dataclass(frozen=True)
class Direction:
    """One scored curve of a record: constants in MPa (None: those of the design), and curves.

    ``measured`` is None where the responses are those of the simulation alone.
    """

    label: str
    responses: dict[str, float]
    constants: dict[str, float] | None
    measured: tuple[list[float], list[float]] | None
    predicted: tuple[list[float], list[float]]


@dataclass(frozen=True)
class Job:
    """One record, in plain values."""

    study: str
    case_id: str
    levels: str
    config: dict[str, Any]
    responses: dict[str, float]
    directions: tuple[Direction, ...]
    closed_form: bool
    sticks: bool
    mesh_hash: str


def jobs_of(folder: Path, data: Path | None, left_out: Counter[str]) -> list[Job]:
    """List the records of a results folder that can be computed again.

    Raises
    ------
    InputError
        If the folder holds no study, or ``data`` not its measurements.
    """
    from study.harness.design.load import loads, results_folder
    from study.record.store import Store

    home = results_folder(folder)
    store = Store(home)
    manifest = store.read_manifest()
    if manifest is None:
        raise InputError(f"{home}: its manifest is damaged; run the design again")
    records = store.records(manifest["cases"])
    left_out["not computed yet"] += len(manifest["cases"]) - len(records)
    design = loads(manifest["design"], manifest["source"])
    configs = _configs(design, manifest["blocks"], data)
    found = [_job(record, configs, data, left_out) for record in records]
    return sorted((job for job in found if job is not None), key=lambda job: job.case_id)


def _configs(design: Any, blocks: Sequence[str], data: Path | None) -> dict[Any, Config]:
    """Resolve every case, by its levels, its block and the number of its mesh."""
    from study.harness.design.spec import cases
    from study.harness.runner.batch import seeded
    from study.simulation.job import located_cell

    places = () if data is None else (data.resolve(),)
    configs: dict[Any, Config] = {}
    for case, origin in seeded(cases(design, blocks), design):
        cell = located_cell(case.cell, places)
        config = cell.document() | {"measurements": getattr(cell.problem, "measurements", None)}
        configs[_name(case.levels, case.block, origin.mesh_seed)] = config
    return configs


def _name(levels: Mapping[str, str], block: str | None, mesh_seed: int | None) -> Any:
    return tuple(sorted(levels.items())), block, mesh_seed


def _job(
    record: Any, configs: Mapping[Any, Config], data: Path | None, left_out: Counter[str]
) -> Job | None:
    """Job of a record; None where there is nothing to compute, which is counted."""
    why = _unfit(record)
    if why:
        left_out[why] += 1
        return None
    config = configs.get(_name(record.levels, record.block, record.extra.get("mesh_seed")))
    if config is not None and table_of(config, "forward").get("model") in ("command", "python"):
        left_out["of another program"] += 1
        return None
    if config is None:
        raise InputError(f"case {record.case_id}: the stored design has no such cell")
    return Job(
        record.study,
        record.case_id,
        " / ".join([*record.levels.values(), *([record.block] if record.block else [])]),
        _plain(config),
        {name: record.response(name) for name in record.responses if _is_of_a_curve(name)},
        tuple(_directions(record, config, data)),
        record.solver.get("name") == _CLOSED_FORM,
        _sticks(config),
        str(record.mesh.get("hash", "")),
    )


def _is_of_a_curve(name: str) -> bool:
    """Whether a response is read from a force-displacement curve.

    A stiffness is not computed again: the slope of a spline at the end of a curve is no better
    than 0.1 %, and a mesh that is made for another depth has another slope. `tests/fem` holds
    slopes to differences of forces on one mesh.
    """
    return name in RESPONSES or simulated_at(name)[0] in SIMULATED


def _sticks(config: Config) -> bool:
    """Whether an indenter holds what it touches where it meets it: load steps matter then."""
    from study.mechanics.setup.test_kind import TEST_KINDS, IndenterContact
    from study.simulation.cell import CellProblem

    made = CellProblem.of(config).setup.test.to_depth(1.0)
    contacts = TEST_KINDS[made.kind].contacts(made)
    return any(isinstance(one, IndenterContact) and one.is_bonded for one in contacts)


def _unfit(record: Any) -> str:
    """Why a record cannot be computed again; empty where it can."""
    if not record.converged:
        return f"without an answer ({record.status})"
    if record.extra.get("noise_seed"):
        return "fits to resampled noise, which hold no curve"
    facts = record.extra.get("directions") or ()
    if not facts or not all(
        CurveKey("predicted", fact["score"]) in record.curves for fact in facts
    ):
        return "without a predicted curve"
    fits = [fact["fit"] or "all" for fact in facts]
    if record.fit is not None and len(set(fits)) < len(fits):
        return "two fits under one name, of which the record holds one"
    return ""


def _plain(config: Config) -> dict[str, Any]:
    from study.ground.canonical import plain

    made: dict[str, Any] = plain(config)
    return made


def _directions(record: Any, config: Config, data: Path | None) -> Iterator[Direction]:
    for number, fact in enumerate(record.extra["directions"]):
        label = fact["score"]
        fit = None if record.fit is None else record.fit[fact["fit"] or "all"]
        measured = record.curves.get(CurveKey("measured", label))
        if data is not None and measured is not None:
            measured = _read(config, record.block, data, number)
        yield Direction(
            label,
            {
                name: float(found["value"])
                for name, found in fact["responses"].items()
                if _is_of_a_curve(name)
            },
            None if fit is None else dict(fit["values"]),
            None if measured is None else _lists(measured),
            _lists(record.curves[CurveKey("predicted", label)]),
        )


def _lists(curve: Any) -> tuple[list[float], list[float]]:
    return curve.displacement_mm.tolist(), curve.force_N.tolist()


def _read(config: Config, block: str | None, data: Path, number: int) -> Any:
    """Read the measured curve that a direction is scored on; the second is the first's reverse."""
    from study.mechanics.measurement.reading import read_measurements

    spec, height = config["measurements"], config["specimen"].get("height_mm")
    found = read_measurements(spec, data, height, config["test"].get("displacement_mm"))
    sides = [found.spec.score or found.spec.fit, found.spec.fit]
    where = dict(sides[number] or {})
    return found.curve(block if found.spec.block is not None else None, **where).curve
