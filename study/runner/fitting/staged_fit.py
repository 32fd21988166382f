"""One fit in stages: a cheaper problem gives the start, the wanted one the answer.

The first steps of a fit are far from its end, so that the error of a coarse mesh, or of the
equivalent cylinder in axisymmetric space, does not matter to them; on the wanted mesh one or
two simulations are left. A stage that has no answer at its start begins again at a gentler one
(:mod:`study.runner.fitting.starts`). Start values remain a function of the case alone.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, cast

import numpy as np

from study.arrays import Array
from study.bounded_file import read_json
from study.calibration.fit import fit
from study.calibration.function import EvaluationFailed
from study.calibration.iteration import Iteration, Status
from study.curve import Curve
from study.errors import StoreError
from study.record.atomic_files import write_atomic
from study.runner.fitting.starts import Start, gentler
from study.runner.tables import on_mesh
from study.setup.setup import MESH_LEVELS, Setup, Tables

if TYPE_CHECKING:
    from study.calibration.fit import Fit
    from study.calibration.iteration import Iteration
    from study.calibration.measured_curve import MeasuredCurve

Predict = Callable[[Array], list[Curve]]


class Tolerances(TypedDict, total=False):
    """When a search ends; see :func:`study.calibration.levenberg_marquardt.levenberg_marquardt`."""

    ftol: float
    xtol: float
    gtol: float
    edge: float


#: each evaluation of an inverse fit is a simulation: digits far below the error of the mesh
#: are not worth one; a start needs fewer still
TOLERANCES: Mapping[str, Tolerances] = {
    "closed-form": {},
    "inverse-fem": {"ftol": 1e-9, "xtol": 1e-7, "gtol": 1e-5, "edge": 1e-3},
    # gradients by differences are good to three digits
    "external": {"ftol": 1e-9, "xtol": 1e-6, "gtol": 1e-4, "edge": 1e-3},
    "start": {"ftol": 1e-6, "xtol": 1e-2, "gtol": 1e-3, "edge": 1e-2},
}

#: name of the stage that gives the start
FIRST = "cheaper model"

#: name of the stage that gives the answer
LAST = "wanted mesh"

#: coarse over fine of the named meshes
_COARSER = 2.25

#: elements over the height below which a mesh is coarse already
_FEW = 4.0


@dataclass(frozen=True)
class Part:
    """One test of a fit: how it is predicted, and the curves measured in it.

    Parameters
    ----------
    method : str
        ``"closed-form"``, ``"inverse-fem"`` or ``"external"``.
    tables : mapping
        Those that enter.
    measured : tuple of MeasuredCurve
        Curves of this test, of one or several specimens of equal size.
    """

    method: str
    tables: Tables
    measured: tuple[MeasuredCurve, ...]


@dataclass(frozen=True)
class Step:
    """An accepted iteration of a stage; what a progress line shows."""

    stage: str
    names: tuple[str, ...]
    iteration: Iteration


Progress = Callable[[Step], None]

#: method, tables, measured curves and names -> model
MakeModel = Callable[[str, Tables, Sequence[Curve], Sequence[str]], Predict]


@dataclass(frozen=True)
class Staged:
    """A fit, the models that made it, one for each part, and the coarse fit before it.

    ``fruitless`` counts the calls of the model in starts that were given up, and ``notes`` say
    what was begun with instead.
    """

    fit: Fit
    models: tuple[Predict, ...]
    rough: Fit | None = None
    fruitless: int = 0
    notes: tuple[str, ...] = ()

    @property
    def evaluations(self) -> int:
        """Calls of the model in all stages, starts without an answer included."""
        return self.fit.evaluations + self.fruitless + (self.rough.evaluations if self.rough else 0)

    @property
    def message(self) -> str:
        """How the fit ended, and what it was begun with where that was not its own start."""
        return "; ".join([self.fit.message, *self.notes])


def staged_fit(
    parts: Sequence[Part],
    names: tuple[str, ...],
    start: Array,
    make: MakeModel,
    *,
    bounds: Sequence[tuple[float, float]] | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
) -> Staged:
    """Fit common constants to all parts at once.

    Parameters
    ----------
    parts : sequence of Part
        The tests.
    names : tuple of str
        Constants.
    start : ndarray, shape (p,)
        Start values in MPa.
    make : callable
        Makes the model of a part.
    bounds : sequence of (low, high), optional
        One pair for every constant.
    progress : callable, optional
        Gets every accepted iteration.
    checkpoint : Checkpoint, optional
        Keeps accepted iterations, so that an interrupted fit goes on where it was.
    """
    kept = checkpoint or Checkpoint()
    cheap = [cheaper(part) for part in parts]
    starts = gentler(names, start, bounds)
    rough: Staged | None = None
    if len(names) > 1 and any(one is not None for one in cheap):
        first = [own if own is not None else part for own, part in zip(cheap, parts, strict=True)]
        rough = begun_stage(FIRST, first, names, starts, make, bounds, progress, kept)
        if rough.fit.status.usable and not np.array_equal(rough.fit.values, start):
            # what the cheaper problem could solve may be beyond the wanted one
            starts = [Start(rough.fit.values, f"the constants of the {FIRST}"), *starts]
    done = begun_stage(LAST, parts, names, starts, make, bounds, progress, kept)
    if rough is None:
        return done
    return replace(
        done,
        rough=rough.fit,
        fruitless=rough.fruitless + done.fruitless,
        notes=(*rough.notes, *done.notes),
    )


def begun_stage(
    stage: str,
    parts: Sequence[Part],
    names: tuple[str, ...],
    starts: Sequence[Start],
    make: MakeModel,
    bounds: Sequence[tuple[float, float]] | None,
    progress: Progress | None,
    checkpoint: Checkpoint,
) -> Staged:
    """Fit from the first start that leads anywhere; from the last one if none does.

    Parameters
    ----------
    stage : str
        Name in progress and checkpoint; a later start adds a comma and its words.
    parts, names, make, bounds, progress
        As for :func:`staged_fit`.
    starts : sequence of Start
        One at least, the wanted one first.
    checkpoint : Checkpoint
        Says which start an interrupted fit was at, and keeps accepted iterations.

    Returns
    -------
    Staged
        ``fruitless`` and ``notes`` tell of the starts that were given up.
    """
    labels = [stage, *(f"{stage}, {one.words}" for one in starts[1:])]
    # an interrupted fit goes on from the start that it was at; those before it failed at once
    number = max((k for k, one in enumerate(labels) if checkpoint.last(one)), default=0)
    fruitless = number
    while True:
        done = single_stage(
            labels[number], parts, names, starts[number].values, make, bounds, progress, checkpoint
        )
        if number + 1 == len(starts) or not _nowhere(done.fit):
            break
        fruitless, number = fruitless + done.fit.evaluations, number + 1
    notes = () if number == 0 else (_told(stage, starts[: number + 1], _nowhere(done.fit)),)
    return replace(done, fruitless=fruitless, notes=notes)


def _nowhere(found: Fit) -> bool:
    """Whether the model had no answer at the start of a fit, or nowhere around it."""
    stuck = found.status is Status.too_many_failures and len(found.history) <= 1
    return found.status is Status.start_failed or stuck


def _told(stage: str, tried: Sequence[Start], in_vain: bool) -> str:
    """Say which starts were given up, and what was begun with."""
    failed = tried if in_vain else tried[:-1]
    rule = f"the {stage} led nowhere from {', nor from '.join(one.words for one in failed)}"
    return rule if in_vain else f"{rule}: it was begun with {tried[-1].words}"


def single_stage(
    stage: str,
    parts: Sequence[Part],
    names: tuple[str, ...],
    start: Array,
    make: MakeModel,
    bounds: Sequence[tuple[float, float]] | None,
    progress: Progress | None,
    checkpoint: Checkpoint,
) -> Staged:
    """Fit on the given meshes from one start.

    Parameters
    ----------
    stage : str
        Name of its progress and checkpoint; a simulated stage whose name begins with ``FIRST`` is
        only as exact as a start needs to be.
    parts, names, start, make, bounds, progress
        As for :func:`staged_fit`.
    checkpoint : Checkpoint
        Its last iteration of this stage, if any, is gone on from; accepted ones are kept.
    """
    models = [make(p.method, p.tables, [m.curve for m in p.measured], names) for p in parts]

    def predict(values: Array) -> list[Curve]:
        return [curve for model in models for curve in model(values)]

    def accepted(iteration: Iteration) -> None:
        checkpoint.keep(stage, iteration)
        if progress is not None:
            progress(Step(stage, names, iteration))

    resume = checkpoint.last(stage)
    if resume is not None:
        # models interpolate relative to what they solved first: make that the start again
        with contextlib.suppress(EvaluationFailed):
            predict(np.asarray(start, float))
    simulated = any(part.method == "inverse-fem" for part in parts)
    tolerances = "start" if stage.startswith(FIRST) else "inverse-fem"
    if any(part.method == "external" for part in parts):
        simulated, tolerances = True, "external"
    found = fit(
        predict,
        [m for part in parts for m in part.measured],
        names,
        start,
        bounds=bounds,
        callback=accepted,
        resume=resume,
        **TOLERANCES[tolerances if simulated else "closed-form"],
    )
    return Staged(found, tuple(models))


def cheaper(part: Part) -> Part | None:
    """Make the same part axisymmetric, or on a coarse mesh; None where nothing is cheaper.

    Parameters
    ----------
    part : Part
        Nothing is cheaper where no elements of ours predict it.
    """
    if part.method != "inverse-fem":
        return None
    setup = Setup.of(part.tables)
    if setup.model.space == "3d" and not setup.is_whole:
        return replace(part, tables=on_mesh(part.tables, space="axisymmetric"))
    coarse = _coarse(setup)
    return None if coarse is None else replace(part, tables=on_mesh(part.tables, **coarse))


def _coarse(setup: Setup) -> dict[str, object] | None:
    """Return the keys of a coarse mesh; None where it is one already, or too few are left."""
    size = setup.model.mesh_size_mm
    if size is None:
        return {"mesh": "coarse"} if setup.model.level < len(MESH_LEVELS) - 1 else None
    coarser, height = _COARSER * size, setup.height_mm
    few = height is None or height / coarser < _FEW
    return None if few else {"mesh_size_mm": coarser}


class StageDocument(TypedDict):
    """An accepted iteration as it is kept; see :class:`study.calibration.iteration.Iteration`."""

    iteration: int
    evaluations: int
    x: list[float]
    cost: float
    radius: float
    damping: float
    offset: float
    scale: list[float]


class CheckpointDocument(TypedDict):
    """Accepted iterations by the name of their stage, and the fit that they are of."""

    key: str
    stages: dict[str, StageDocument]


class Checkpoint:
    """Last accepted iteration of every stage of one fit.

    Parameters
    ----------
    path : Path, optional
        Its file; nothing is kept without one.
    key : str
        Name of the fit, made of its content: a file of another fit is not read.
    """

    def __init__(self, path: Path | None = None, key: str = "") -> None:
        self.path, self.key = path, key
        self.stages: dict[str, StageDocument] = {} if path is None else _read(path, key)

    def last(self, stage: str) -> Iteration | None:
        """Last accepted iteration of a stage; None where it has not begun."""
        kept = self.stages.get(stage)
        if kept is None:
            return None
        return Iteration(
            kept["iteration"], kept["evaluations"], np.array(kept["x"], float), kept["cost"],
            kept["radius"], kept["damping"], kept["offset"], np.array(kept["scale"], float),
        )  # fmt: skip

    def keep(self, stage: str, iteration: Iteration) -> None:
        """Keep an accepted iteration."""
        if self.path is None:
            return
        arrays = {"x": iteration.x.tolist(), "scale": iteration.scale.tolist()}
        self.stages[stage] = cast(StageDocument, {**vars(iteration), **arrays})
        text = json.dumps({"key": self.key, "stages": self.stages}, indent=1, allow_nan=False)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path, text.encode())

    def clear(self) -> None:
        """Forget everything: the fit is finished."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
        self.stages = {}


def _read(path: Path, key: str) -> dict[str, StageDocument]:
    """Stages of a file; none where it is of another fit, or damaged: the fit then starts anew."""
    try:
        content = cast(CheckpointDocument, read_json(path))
        stages: dict[str, StageDocument] = content["stages"] if content["key"] == key else {}
        wanted = set(StageDocument.__annotations__)
        return {name: kept for name, kept in stages.items() if set(kept) == wanted}
    except (StoreError, KeyError, TypeError, AttributeError):
        return {}
