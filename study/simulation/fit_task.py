"""Calibration of one material on one block, in stages, as a worker does it.

A cheaper problem gives the start, the wanted one the answer. The first steps of a fit are far from
its end, so that the error of a coarse mesh, or of the equivalent cylinder in axisymmetric space,
does not matter to them; on the wanted mesh one or two simulations are left.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np

from study.external.answers import PredictedCurve
from study.ground.arrays import Array
from study.ground.canonical import digest
from study.ground.curve import Curve, spline_from_origin
from study.ground.errors import InputError, StoreError
from study.ground.files import read_json, write_atomic
from study.mechanics.calibration.fit import Fit, ResidualFunction, fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.lack_of_fit import adequacy
from study.mechanics.calibration.levenberg_marquardt import Iteration, Status
from study.mechanics.calibration.residual_function import EvaluationFailed, MeasuredCurve
from study.mechanics.forward import closed_form, finite_element
from study.mechanics.material.material import ENERGIES, constant_names, is_dimensionless
from study.mechanics.material.relaxation import is_of_relaxation
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import MESH_LEVELS
from study.record.record import FitDocument
from study.simulation.cell import CellProblem
from study.simulation.job import (
    FitJob,
    FitResult,
    InverseExternal,
    described,
    prediction_of,
    status_of,
)
from study.simulation.job import FitPart as FitPart

if TYPE_CHECKING:
    from study.mechanics.material.energy import Energy
    from study.mechanics.solver.solution import Solution


# Starts of a fit, the wanted one first, then gentler ones for where the model has no answer.
#
# Higher constants that were fitted on another mesh, or with one constant less, can soften so much
# that the wanted model loses its equilibrium before the end of the test. Less of them is nearer
# to a neo-Hookean solid of the same initial shear modulus, which has an answer wherever the test
# has one. The order is fixed, so that a start remains a function of the case alone.

#: what is kept of the higher constants, and how a message calls it
_SHARES = (
    (0.5, "the higher constants halved"),
    (0.25, "the higher constants halved twice"),
    (0.0, "the neo-Hookean constant alone"),
)


@dataclass(frozen=True)
class Start:
    """Start values of a fit."""

    #: shape (p,); in MPa, exponents plain.
    values: Array
    words: str = "the start values"


def gentler(
    names: Sequence[str], start: Array, bounds: Sequence[tuple[float, float]] | None = None
) -> list[Start]:
    """List a start (p,), MPa, and what may be tried after it, each one once."""
    starts = [Start(np.array(start, float))]
    for share, words in _SHARES:
        values = within(_softened(names, starts[0].values, share), bounds)
        if not any(np.array_equal(values, earlier.values) for earlier in starts):
            starts.append(Start(values, words))
    return starts


def _softened(names: Sequence[str], start: Array, share: float) -> Array:
    """Keep a share of the higher constants, and the initial shear modulus."""
    every = dict(zip(names, start.tolist(), strict=True))
    old = {n: v for n, v in every.items() if not is_of_relaxation(n)}
    if "mu1" in old:  # moduli move to the first term, whose exponent nears the neo-Hookean 2
        moduli = [n for n in old if re.fullmatch(r"mu\d+", n)]
        new = {n: share * v if n in moduli else v for n, v in old.items()}
        new["mu1"] += (1 - share) * sum(old[n] for n in moduli)
        if "alpha1" in old:
            new["alpha1"] = 2 + share * (old["alpha1"] - 2)
    elif "C10" in old:
        new = {n: v if n == "C10" else share * v for n, v in old.items()}
        # mu0 = 2 (C10 + C01)
        new["C10"] = old["C10"] + (1 - share) * old.get("C01", 0.0)
    else:
        new = old
    return np.array([{**every, **new}[n] for n in names]) + 0.0  # no minus zero


Predict = Callable[[Array], list[Curve]]


class Tolerances(TypedDict, total=False):
    """When a search ends; see ``levenberg_marquardt``."""

    ftol: float
    xtol: float
    gtol: float
    edge: float


#: each evaluation of an inverse fit is a simulation: digits far below the error of the mesh
#: are not worth one, nor the last 3e-4 of the radius of a 95 % region (``gtol``); a start needs
#: fewer still
TOLERANCES: Mapping[str, Tolerances] = {
    "closed-form": {},
    "inverse-fem": {"ftol": 1e-9, "xtol": 1e-7, "gtol": 3e-4, "edge": 1e-3},
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
class FitStep:
    """An accepted iteration of a stage; what a progress line shows."""

    stage: str
    names: tuple[str, ...]
    iteration: Iteration


Progress = Callable[[FitStep], None]

#: method, problem, measured curves and names -> model
MakeModel = Callable[[str, CellProblem, Sequence[Curve], Sequence[str]], Predict]


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


@dataclass(frozen=True)
class Limits:
    """What a search may use up."""

    #: Calls of the model in each search.
    evaluations: int = 200
    #: Of ``time.monotonic``, s; none by default.
    deadline_s: float = math.inf

    @property
    def is_late(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() > self.deadline_s


NO_LIMITS = Limits()


def staged_fit(parts: Sequence[FitPart], start: Array, search: StagedSearch) -> Staged:
    """Fit common constants to all parts at once; start (p,), MPa."""
    cheap = [cheaper(part) for part in parts]
    starts = gentler(search.names, start, search.bounds)
    rough: Staged | None = None
    if len(search.names) > 1 and any(part is not None for part in cheap):
        first = [other or part for other, part in zip(cheap, parts, strict=True)]
        rough = begun_stage(FIRST, first, starts, search)
        if rough.fit.status.usable and not np.array_equal(rough.fit.values, start):
            # what the cheaper problem could solve may be beyond the wanted one
            begun = at_common_ratios(parts, search.names, rough.fit.values)
            starts = [Start(begun, f"the constants of the {FIRST}"), *starts]
    done = begun_stage(LAST, parts, starts, search)
    if rough is None:
        return done
    return replace(
        done,
        rough=rough.fit,
        fruitless=rough.fruitless + done.fruitless,
        notes=(*rough.notes, *done.notes),
    )


#: digits of the ratios of moduli to the initial shear modulus at which a search on the wanted mesh
#: begins: specimens of one material, or both directions of a pair, then begin with one solution
_RATIO_DIGITS = 2


def at_common_ratios(parts: Sequence[FitPart], names: Sequence[str], values: Array) -> Array:
    """Round moduli to few digits of the initial shear modulus, which stays; values (p,), MPa.

    Exponents are no ratios: beside them nothing is rounded.
    """
    if not all(scales_with_moduli(part.problem, names) for part in parts):
        return values
    constants = dict(zip(names, values.tolist(), strict=True))
    material = parts[0].problem.material.material(constants)
    mu0, slopes = material.mu0, material.mu0_gradient()
    if mu0 <= 0 or any(is_dimensionless(name) for name in names):
        return values
    rounded = {n: mu0 * float(f"{c / mu0:.{_RATIO_DIGITS}g}") for n, c in constants.items()}
    rest = max(names, key=lambda name: slopes[name] * constants[name])
    rounded[rest] += (mu0 - sum(slopes[n] * c for n, c in rounded.items())) / slopes[rest]
    return np.array(list(rounded.values()))


def begun_stage(
    stage: str, parts: Sequence[FitPart], starts: Sequence[Start], search: StagedSearch
) -> Staged:
    """Fit from the first start that leads anywhere; from the last one if none does."""
    labels = [stage, *(f"{stage}, {begun.words}" for begun in starts[1:])]
    # an interrupted fit goes on from the start that it was at; those before it failed at once
    number = max(
        (k for k, label in enumerate(labels) if label in search.checkpoint.stages), default=0
    )
    fruitless = number
    while True:
        done = single_stage(labels[number], parts, starts[number].values, search)
        if number + 1 == len(starts) or not _nowhere(done.fit):
            break
        fruitless, number = fruitless + done.fit.evaluations, number + 1
    if not number:
        return replace(done, fruitless=fruitless)
    in_vain = _nowhere(done.fit)
    failed = starts[: number + 1] if in_vain else starts[:number]
    note = f"the {stage} led nowhere from {', nor from '.join(start.words for start in failed)}"
    note += "" if in_vain else f": it was begun with {starts[number].words}"
    return replace(done, fruitless=fruitless, notes=(note,))


def _nowhere(fit_result: Fit) -> bool:
    """Whether the model had no answer at the start of a fit, or nowhere around it."""
    stuck = fit_result.status is Status.too_many_failures and len(fit_result.history) <= 1
    return fit_result.status is Status.start_failed or stuck


def single_stage(
    stage: str, parts: Sequence[FitPart], start: Array, search: StagedSearch
) -> Staged:
    """Fit on the given meshes from one start."""
    names, checkpoint = search.names, search.checkpoint
    models = [model_of(part, names, search.make) for part in parts]

    def predict(values: Array) -> list[Curve]:
        return [curve for model in models for curve in model(values)]

    def accepted(iteration: Iteration) -> bool:
        checkpoint.keep(stage, iteration)
        if search.progress is not None:
            search.progress(FitStep(stage, names, iteration))
        return checkpoint.limits.is_late

    resume = checkpoint.stages.get(stage)
    if resume is not None:
        # models interpolate relative to what they solved first: make that the start again
        with contextlib.suppress(EvaluationFailed):
            predict(np.asarray(start, float))
    simulated = any(part.method == "inverse-fem" for part in parts)
    tolerances = "start" if stage.startswith(FIRST) else "inverse-fem"
    if any(part.method == "external" for part in parts):
        simulated, tolerances = True, "external"
    fitted = fit(
        predict,
        [each for part in parts for each in part.measured],
        names,
        start,
        bounds=search.bounds,
        callback=accepted,
        resume=resume,
        max_evaluations=checkpoint.limits.evaluations,
        **TOLERANCES[tolerances if simulated else "closed-form"],
    )
    if fitted.status is Status.stopped:
        fitted = replace(fitted, failure="the time of calibration.max_time is over")
    return Staged(fitted, tuple(models))


def cheaper(part: FitPart) -> FitPart | None:
    """Make the same part axisymmetric, or on a coarse mesh; None where nothing is cheaper."""
    if part.method != "inverse-fem":
        return None
    setup = part.problem.setup
    size, height = setup.model.mesh_size_mm, setup.height_mm
    changes: dict[str, object]
    if setup.model.space == "3d" and not setup.is_whole:
        changes = {"space": "axisymmetric"}
    elif size is None:
        if setup.model.level == len(MESH_LEVELS) - 1:  # it is coarse already
            return None
        changes = {"mesh": "coarse"}
    else:
        if height is None or height / (_COARSER * size) < _FEW:
            return None
        changes = {"mesh_size_mm": _COARSER * size}
    return replace(part, problem=part.problem.on_mesh(**changes), exact=part.problem)


def model_of(part: FitPart, names: Sequence[str], make: MakeModel) -> Predict:
    """Model of a part; forces of a cheaper problem are multiplied to those of the wanted one.

    The factor at each displacement is that of a neo-Hookean solid, whose force on either mesh is
    known once for all constants.
    """
    curves = part.curves
    model = make(part.method, part.problem, curves, names)
    if part.exact is None:
        return model
    try:
        cheap = _neo_hookean(part.problem, curves, make)
        exact = _neo_hookean(part.exact, curves, make)
    except EvaluationFailed:
        return model
    factors = [
        np.where(coarse > 0, other / np.where(coarse > 0, coarse, 1.0), 1.0)
        for coarse, other in zip(cheap, exact, strict=True)
    ]

    def predict(values: Array) -> list[Curve]:
        return [
            replace(
                curve,
                force_N=factor * curve.force_N,
                force_gradient={n: factor * g for n, g in curve.force_gradient.items()},
            )
            for curve, factor in zip(model(values), factors, strict=True)
        ]

    return predict


def _neo_hookean(problem: CellProblem, curves: Sequence[Curve], make: MakeModel) -> list[Array]:
    """Predict the forces of a neo-Hookean solid of C10 = 1 MPa at the measured points, N."""
    solid = MaterialSection("neo-hookean", None, {}, problem.material.compressibility)
    alone = replace(problem, material=solid)
    if not scales_with_moduli(alone, ("C10",)):
        raise EvaluationFailed("its force is not proportional to its constant")
    return [curve.force_N for curve in make("inverse-fem", alone, curves, ("C10",))(np.ones(1))]


def scales_with_moduli(problem: CellProblem, names: Sequence[str]) -> bool:
    """Whether all stresses, hence the force, are in proportion to the moduli that are fitted."""
    section, test = problem.material, problem.setup.test
    fixed = section.compressibility.bulk_modulus_MPa is not None or section.relaxation
    complete = tuple(names) == constant_names(section.model, section.order)
    return complete and not fixed and not test.weight_N_mm3


class Checkpoint:
    """Last accepted iteration of every stage of one fit."""

    def __init__(self, path: Path | None = None, key: str = "", limits: Limits = NO_LIMITS) -> None:
        self.path, self.key, self.limits = path, key, limits
        self.stages: dict[str, Iteration] = {} if path is None else _read(path, key)

    def keep(self, stage: str, iteration: Iteration) -> None:
        """Keep an accepted iteration."""
        if self.path is None:
            return
        self.stages[stage] = iteration
        document = {"key": self.key, "stages": {name: vars(at) for name, at in self.stages.items()}}
        text = json.dumps(document, indent=1, allow_nan=False, default=np.ndarray.tolist)
        write_atomic(self.path, text.encode())

    def clear(self) -> None:
        """Forget everything: the fit is finished."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
        self.stages = {}


def _read(path: Path, key: str) -> dict[str, Iteration]:
    """Stages of a file; none where it is of another fit, or damaged: the fit then starts anew."""
    try:
        content = cast("Mapping[str, Any]", read_json(path))
        stages = content["stages"] if content["key"] == key else {}
        return {
            name: Iteration(**{**at, **{k: np.array(at[k], float) for k in ("x", "scale")}})
            for name, at in stages.items()
        }
    except (StoreError, KeyError, TypeError, ValueError, AttributeError):
        return {}


@dataclass(frozen=True)
class StagedSearch:
    """What all stages of a fit share."""

    names: tuple[str, ...]
    bounds: Sequence[tuple[float, float]] | None = None
    progress: Progress | None = None
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    #: Makes the model of a part.
    make: MakeModel = field(default_factory=lambda: fitted_model)


# Energies with exponents have minima on both sides of zero: a fit begins on each, unasked.

#: looks that are fitted at most of one exponent
_LOOKED = 6
#: the same of several, each with other signs
_LOOKED_OF_SEVERAL = 3
#: looks that are simulated at most, where no test has a closed form
_SIMULATED = 10
#: a start ends on the cheaper mesh where its sum of squares is so many times that of the fit
_HOPELESS_START = 2.0
#: minima within this factor of the least sum of squares: interpolation may hide which is least
_NEAR_LEAST = 2.0
#: relative difference of constants from which two minima are two
_APART = 0.02
#: the same where each is judged by another interpolation, which moves it along its valley
_IN_ANOTHER_VALLEY = 0.1
#: difference of AICc up to which two minima cannot be told apart (Burnham and Anderson 2002, 2.6)
OPEN = 6.0


def least_minimum(
    tried: Sequence[Staged],
    parts: Sequence[FitPart],
    start: Array,
    search: StagedSearch,
    fit_from: Callable[[Array], Staged],
) -> tuple[Staged, tuple[Staged, ...]]:
    """Fit from cheap looks too; the least sum of squares, and minima that cannot be told from it.

    ``tried`` are the fits so far, that from ``start`` (p,), MPa, first; ``fit_from`` fits from
    another start.
    """
    candidates = list(tried)
    for look in _looked_for(parts, start, search):
        if not search.checkpoint.limits.is_late:
            candidates.append(_from_look(parts, look, search, tried[0], fit_from))
    evaluations = sum(candidate.evaluations for candidate in candidates)
    minima = sorted((c for c in candidates if _is_minimum(c.fit)), key=lambda c: c.fit.rss)
    if any(part.method == "inverse-fem" for part in parts) and not search.checkpoint.limits.is_late:
        minima, more = _judged_at_their_ends(minima, fit_from)
        evaluations += more
    chosen = minima[0] if minima else candidates[0]
    rivals: list[Staged] = []
    for minimum in minima[1:]:
        apart = all(_differ(minimum.fit.values, other.fit.values) for other in (chosen, *rivals))
        if apart and minimum.fit.aicc - chosen.fit.aicc < OPEN:
            rivals.append(minimum)
    fruitless = evaluations - (chosen.evaluations - chosen.fruitless)
    return replace(chosen, fruitless=fruitless), tuple(rivals)


def _is_minimum(fitted: Fit) -> bool:
    """Whether a search ended at a minimum; one at a kink may be the least as well."""
    return fitted.converged or fitted.status is Status.at_kink


def _judged_at_their_ends(
    minima: Sequence[Staged], fit_from: Callable[[Array], Staged]
) -> tuple[list[Staged], int]:
    """Fit again from the end of each minimum that may be the least, where there are several.

    A simulated curve is interpolated between its load steps relative to the first one of its
    search. Searches that began at other constants judge by other models, and their sums of squares
    at equal constants differ by up to a fifth; a search from its own end has the tangents of its
    answer. One that had a cheaper stage began near its end already. Minima come and go in
    ascending order of their sums of squares; the calls of the model are counted.
    """
    close: list[Staged] = []
    far: list[Staged] = []
    for minimum in minima:
        if minimum.fit.rss > _NEAR_LEAST * minima[0].fit.rss:
            far.append(minimum)
        elif all(_differ(minimum.fit.values, c.fit.values, _IN_ANOTHER_VALLEY) for c in close):
            close.append(minimum)
    if len(close) < 2:
        return list(minima), 0
    judged, evaluations = far, 0
    for minimum in close:
        judged.append(minimum)
        if minimum.rough is None and _differ(minimum.fit.history[0].x, minimum.fit.values):
            again = fit_from(minimum.fit.values)
            evaluations += again.evaluations
            if _is_minimum(again.fit):
                judged[-1] = replace(minimum, fit=again.fit, models=again.models)
    return sorted(judged, key=lambda staged: staged.fit.rss), evaluations


def named_open(fitted: Fit, rivals: Sequence[Staged]) -> Fit:
    """Fit that names its rivals: constants that describe the rows as well are not told apart."""
    if not rivals:
        return fitted
    rivals_text = "; ".join(
        ", ".join(
            f"{name} {value:.4g}" if is_dimensionless(name) else f"{name} {1e3 * value:.4g} kPa"
            for name, value in rival.fit.constants().items()
        )
        for rival in rivals
    )
    why = f"another minimum describes the rows as well: {rivals_text}"
    reason = f"{why}; {fitted.reason}" if fitted.reason else why
    return replace(fitted, identifiable=False, reason=reason)


def _differ(first: Array, other: Array, share: float = _APART) -> bool:
    return bool(np.any(np.abs(first - other) > share * np.maximum(np.abs(first), np.abs(other))))


def _from_look(
    parts: Sequence[FitPart],
    start: Array,
    search: StagedSearch,
    first: Staged,
    fit_from: Callable[[Array], Staged],
) -> Staged:
    """Fit from one look; on the cheaper mesh alone where that tells how it ends."""
    if first.rough is not None and first.rough.status.usable:
        cheap = [cheaper(part) or part for part in parts]
        starts = gentler(search.names, start, search.bounds)
        aside = replace(
            search, progress=None, checkpoint=Checkpoint(limits=search.checkpoint.limits)
        )
        rough = begun_stage("look", cheap, starts, aside)
        is_hopeless = rough.fit.rss > _HOPELESS_START * first.rough.rss
        is_same = first.fit.converged and not _differ(rough.fit.values, first.rough.values)
        if not _is_minimum(rough.fit) or is_hopeless or is_same:
            return replace(rough, fit=replace(rough.fit, status=Status.stopped))
        start = rough.fit.values
    return fit_from(start)


def _looked_for(parts: Sequence[FitPart], start: Array, search: StagedSearch) -> list[Array]:
    """List starts on every side of zero of the exponents, the best of each, by cheap looks.

    A look is a linear fit of the moduli beside given exponents, in closed form; a specimen that
    sticks to its plates is taken at equal strain, which leaves exponents near enough to begin
    with. Where no test has a closed form, fewer looks are simulated on a coarse mesh.
    """
    names, first = search.names, dict(zip(search.names, start.tolist(), strict=True))
    energy = energy_of(parts)
    plain = {n for n in names if energy.is_dimensionless(n) and not is_of_relaxation(n)}
    looks = [look for look in energy.looks(names) if set(look) == plain] if plain else []
    if not looks:
        return []
    free = [equal_strain for part in parts if (equal_strain := _at_equal_strain(part)) is not None]
    if not free:
        free = [cheaper(part) or part for part in parts if part.method == "inverse-fem"]
        step = math.ceil(len(looks) / _SIMULATED)
        looks = looks[step // 2 :: step]
    if not free:
        return []
    seen: list[tuple[float, Array]] = []
    for look in looks:
        values = within(np.array([{**first, **look}[n] for n in names]), search.bounds)
        values, squares = with_moduli(search, values, free)
        seen.append((squares, within(values, search.bounds)))
    if len(plain) == 1:  # every dip of the sum of squares along the exponent
        sums = [np.inf, *(squares for squares, _ in seen), np.inf]
        seen = [look for k, look in enumerate(seen) if look[0] <= min(sums[k], sums[k + 2])]
        return [values for _, values in sorted(seen, key=lambda pair: pair[0])[:_LOOKED]]
    places = [k for k, name in enumerate(names) if name in plain]
    best_of: dict[tuple[bool, ...], Array] = {}
    for _, values in sorted(seen, key=lambda pair: pair[0]):
        best_of.setdefault(tuple(sorted(values[places] > 0)), values)
    return list(best_of.values())[:_LOOKED_OF_SEVERAL]


def _at_equal_strain(part: FitPart) -> FitPart | None:
    """Part in closed form, as if its faces did not stick; None where it has no closed form."""
    if part.method == "closed-form":
        return part
    setup = part.problem.setup
    if part.method != "inverse-fem" or setup.height_mm is None or not setup.kind.compresses:
        return None
    problem = part.problem.loaded(interface="frictionless", base="frictionless")
    if not problem.is_homogeneous:
        return None
    return replace(part, method="closed-form", problem=problem)


def energy_of(parts: Sequence[FitPart]) -> Energy:
    """Energy that all parts of a fit share."""
    return ENERGIES[parts[0].problem.material.model]


def within(values: Array, bounds: Sequence[tuple[float, float]] | None) -> Array:
    """Values moved into their bounds."""
    if bounds is None:
        return values
    return np.asarray(np.clip(values, *np.array(bounds, float).T))


def with_moduli(
    search: StagedSearch, values: Array, parts: Sequence[FitPart]
) -> tuple[Array, float]:
    """Moduli that fit best beside these plain numbers, and their sum of squares.

    Every energy is linear in its moduli where K scales with them. Where the model has no answer,
    or resists nothing, they are unchanged and the sum is infinite.
    """
    energy, names = energy_of(parts), search.names
    moduli = [k for k, n in enumerate(names)
              if not (energy.is_dimensionless(n) or is_of_relaxation(n))]  # fmt: skip
    models = [search.make(part.method, part.problem, part.curves, names) for part in parts]
    measured = [m for part in parts for m in part.measured]
    residual = ResidualFunction(
        lambda x: [curve for model in models for curve in model(x)], measured, names
    )
    try:
        r, jacobian = residual(values)
    except EvaluationFailed:
        return values, np.inf
    step, *_ = np.linalg.lstsq(jacobian[:, moduli], -r, rcond=None)
    left = r + jacobian[:, moduli] @ step
    moved = values.copy()
    moved[moduli] += step
    # a modulus of a single term must stay positive, or nothing resists
    if len(moduli) > 1 or (moved[moduli] > 0).all():
        return moved, float(left @ left)
    return values, np.inf


#: smallest load step over the largest: constants that need less are next to having no answer,
#: and an optimizer that asks there should hear so soon
_CUTBACKS = 0.12

#: share of the force that a curve which is moved along its gradients may be off: a tenth of the
#: tolerance of the solver
_NEAR = 1e-9
#: what the estimate of it is multiplied by, for constants that move in another direction
_SAFETY = 10.0


def perform(job: FitJob) -> dict[str, object]:
    """Fit the constants of one material, to resampled curves where it has a seed: for a worker."""
    return (fitted if job.noise is None else refitted)(job).to_json()


def fitted(job: FitJob) -> FitResult:
    """Fit the constants of one material to measured curves."""
    began = time.perf_counter()
    start = job.begun
    if start is not None and not start.converged:  # it cannot be fitted alone
        why = f"the fit that starts it did not converge: {start.message}"
        return FitResult(start.status, {"message": why})
    parts = parts_of(job)
    names, first = start_values(
        parts[0].problem, job.measured, None if start is None else start.constants
    )
    search = StagedSearch(names)

    def fit_from(values: Array) -> Staged:
        return staged_fit(parts, values, search)

    done, rivals = least_minimum([fit_from(first)], parts, first, search, fit_from)
    fitted_curves = [curve for part in parts for curve in part.measured]
    fit = named_open(with_serial_correlation(done.fit, fitted_curves), rivals)
    several = len(parts) > 1
    facts = described(fit, parts[0].problem, job.measured[:1] if several else job.measured)
    if fit.status.usable:
        # curves of one test are specimens or repeats: what they differ by is noise
        judged = adequacy(fit, fitted_curves, tests=() if several else [0] * len(fitted_curves))
        if judged.reasons:
            facts.update({"verdict": judged.verdict, "misfit": judged.sentence})
    method = job.problem.method
    facts.update({"message": done.message, "evaluations": done.evaluations, "method": method})
    predict, predicted = done.models[0], None
    if isinstance(predict, InverseFem) and method == "inverse-fem":
        predicted = predict.predicted(done.fit.values)
        facts.update({"newton_iterations": predict.newton_iterations, "solves": predict.solves})
        facts["first_solution"] = predict.first_solution
    if isinstance(predict, InverseExternal):
        predicted = predict.predicted(done.fit.values) if done.fit.status.usable else None
        facts["solves"] = predict.solves
    facts["seconds"] = time.perf_counter() - began
    return FitResult(status_of(done.fit), facts, predicted, 0.0 if start is None else start.seconds)


def parts_of(job: FitJob) -> list[FitPart]:
    """Parts of a fit, each with the measured curves that belong to it."""
    data = tuple(MeasuredCurve(f"curve {k}", c) for k, c in enumerate(job.measured, 1))
    tests = job.problem.tests
    groups = [data] if len(tests) == 1 else [(curve,) for curve in data]
    return [replace(test, measured=group) for test, group in zip(tests, groups, strict=True)]


def start_values(
    problem: CellProblem, measured: Sequence[Curve], neo_hookean: Mapping[str, float] | None
) -> tuple[tuple[str, ...], Array]:
    """Names of the constants and where the fit starts.

    Higher constants start at zero: those of the closed form soften so much that a bonded
    specimen cannot be solved with them.

    Shapes: neo_hookean MPa; returns (p,), MPa, s.
    """
    section = problem.material
    names, fading = section.calibrated_names, section.starts_of_relaxation()
    if section.constants:
        return names, np.array([float({**section.constants, **fading}[n]) for n in names])
    if neo_hookean is None:
        first = measured[0]
        neo_hookean = closed_form.neo_hookean_start(
            problem.setup, section.compressibility, first.displacement_mm, first.force_N
        )
    energy, shear_modulus = ENERGIES[section.model], 2 * float(neo_hookean["C10"])
    elastic = [name for name in names if name not in fading]
    values = {**neo_hookean, **energy.starting_values(elastic, shear_modulus), **fading}
    return names, np.array([values.get(n, 0.0) for n in names])


def fitted_model(
    method: str, problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
) -> Predict:
    """Model of one test, for the optimizer."""
    if method == "external":
        return InverseExternal(problem, measured, names)
    if method == "closed-form":
        return closed_form_model(problem, measured, names)
    return InverseFem(problem, measured, names)


def models_of(parts: Sequence[FitPart], names: Sequence[str]) -> list[Predict]:
    """Models of the parts of a fit."""
    return [fitted_model(part.method, part.problem, part.curves, names) for part in parts]


def closed_form_model(
    problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
) -> Predict:
    """Model of a homogeneous test, for the optimizer."""
    setup, section = problem.setup, problem.material

    def predict(values: Array) -> list[Curve]:
        constants = dict(zip(names, values.tolist(), strict=True))
        try:
            material = section.material(constants)
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        curves = [closed_form.at_rows(setup, material, curve) for curve in measured]
        if not all(np.all(np.isfinite(curve.force_N)) for curve in curves):
            raise EvaluationFailed("the material has no equilibrium state at these constants")
        return curves

    return predict


#: initial shear modulus, MPa, at which constants are solved that all stresses scale with: that of a
#: soft solid, whose tangents keep their pivots in single precision where those of 1 MPa do not
_SOLVED_MPa = 0.01

#: digits of the constants of a solution that searches share: those that a division leaves
_DIGITS = 12

#: solutions that a process holds, and unknowns of those from which others can be solved
_MOST_SOLUTIONS = 256
_MOST_UNKNOWNS = 50_000

#: solutions that searches began with, by the name of their problem
_first_solutions: dict[str, Solution] = {}


def _make_room() -> None:
    """Forget what takes most memory before the next solution comes: the load steps of the oldest.

    What they began with can be solved once more, to the same digit.
    """
    whole = [key for key, solution in _first_solutions.items() if solution.warm is not None]
    unknowns = sum(_first_solutions[key].dofs for key in whole)
    for key in whole:
        if unknowns <= _MOST_UNKNOWNS:
            break
        unknowns -= _first_solutions[key].dofs
        _first_solutions[key] = replace(_first_solutions[key], warm=None)
    while len(_first_solutions) >= _MOST_SOLUTIONS:
        del _first_solutions[next(iter(_first_solutions))]


class InverseFem:
    """Forward solutions with gradients; each starts from the one before it in the same fit.

    Where all stresses scale with the moduli, constants are solved at one shear modulus, and the
    curve is multiplied: specimens that differ in their stiffness alone share their solutions, and
    those of one constant are solved once. Equal solutions that searches begin with are found once
    in a process, whatever curves of whichever specimens are fitted.

    Constants so near those of the last solution that its gradients tell the forces within the
    tolerance of the solver are not solved again: what gradients missed on the way to that solution
    grows with the square of the way.

    Between the solved steps the first curve is interpolated with its tangent (Hermite), multiplied
    to the shear modulus asked for, and what later curves add to it by a spline that is linear in
    the solved forces. The gradient of the forces at the measured points is then the exact gradient
    of what is compared; otherwise the optimizer would chase the difference of two interpolations.
    """

    def __init__(
        self, problem: CellProblem, measured: Sequence[Curve], names: Sequence[str]
    ) -> None:
        self._problem, self._names = problem, names
        self._scales = scales_with_moduli(problem, names)
        self._moduli = np.array([not is_dimensionless(name) for name in names])
        self._grids = [curve.displacement_mm for curve in measured]
        self._depth = max(float(grid.max()) for grid in self._grids)
        self._base = Curve(np.zeros(0), np.zeros(0))
        self._last: Solution | None = None
        #: constants of the last solution (p,), and what gradients missed on the way to it over
        #: the square of the way: both as shares of the force
        self._solved_at = np.zeros(len(names))
        self._bend = math.inf
        #: simulations so far, and iterations of Newton's method in them
        self.solves = 0
        self.newton_iterations = 0
        #: name of the solution that the search began with, which other fits may share
        self.first_solution = ""
        #: solved curve at every set of constants
        self.curves: dict[bytes, Curve] = {}

    def __call__(self, values: Array) -> list[Curve]:
        """Predict the forces at the measured displacements for constants in MPa."""
        curve = self._solved(values)
        self.curves[values.tobytes()] = curve.without_gradients()
        return [self._at(values, curve, grid) for grid in self._grids]

    def _factor(self, values: Array) -> tuple[float, dict[str, float]]:
        """Shear modulus over that of the solutions, and its derivatives by the constants, 1/MPa."""
        if not self._scales:
            return 1.0, dict.fromkeys(self._names, 0.0)
        try:
            material = self._problem.material.material(self._constants(values))
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        if not material.mu0 > 0:
            rule = f"the initial shear modulus must be above 0, got {material.mu0:.6g} MPa"
            raise EvaluationFailed(rule)
        gradient = material.mu0_gradient()
        return material.mu0 / _SOLVED_MPa, {n: gradient[n] / _SOLVED_MPa for n in self._names}

    def _constants(self, values: Array) -> dict[str, float]:
        return dict(zip(self._names, values.tolist(), strict=True))

    def _solved(self, values: Array) -> Curve:
        """Curve at constants in MPa, with its gradients."""
        factor, _ = self._factor(values)
        solved = self._solved_at_one_modulus(np.where(self._moduli, values / factor, values))
        if not self._base.displacement_mm.size:
            self._base = solved
        gradient = {
            name: solved.force_gradient[name] * (1.0 if is_modulus else factor)
            for name, is_modulus in zip(self._names, self._moduli, strict=True)
        }
        return replace(solved.times(factor, without=["contact_area"]), force_gradient=gradient)

    def _solved_at_one_modulus(self, values: Array) -> Curve:
        if self._last is None:
            self._last, self._solved_at = self._first(values), values.copy()
        near, way = self._moved(self._last, values)
        missed = way * min(1.0, self._bend * way) if way else 0.0
        if _SAFETY * missed <= _NEAR:
            return near
        solution = self._simulated(values, self._last)
        if solution.status == "not-converged":
            # the way from the solution before was too long: that says nothing of the constants
            solution = self._simulated(values, None)
        self._bend, curve = math.inf, _converged(solution).curve
        if np.array_equal(near.displacement_mm, curve.displacement_mm):
            missed_N = np.linalg.norm(near.force_N - curve.force_N)
            self._bend = float(missed_N / np.linalg.norm(curve.force_N)) / way**2
        self._last, self._solved_at = solution, values.copy()
        return curve

    def _moved(self, solution: Solution, values: Array) -> tuple[Curve, float]:
        """Curve of a solution moved along its gradients to other constants, and how far that is.

        The way is the change of the force by each constant, as a share of the force.
        """
        curve, change = solution.curve, values - self._solved_at
        by_constant = np.array([curve.force_gradient[n] for n in self._names]) * change[:, None]
        way = float(np.linalg.norm(by_constant) / np.linalg.norm(curve.force_N))
        here, force = curve.displacement_mm, by_constant.sum(axis=0)
        tangent, work = curve.stiffness_N_per_mm, curve.work_Nmm
        from scipy.interpolate import CubicSpline

        spline = CubicSpline(np.r_[0.0, here], np.r_[0.0, force])
        moved = replace(
            curve,
            force_N=curve.force_N + force,
            stiffness_N_per_mm=None if tangent is None else tangent + spline.derivative()(here),
            work_Nmm=None if work is None else work + spline.antiderivative()(here),
        )
        return moved, way

    def _first(self, values: Array) -> Solution:
        """Solution that a search begins with: equal ones are found once, one after the other.

        All fits to resampled residuals of a curve begin at its constants, and all fits of a cell
        whose higher constants begin at zero begin at one ratio.
        """
        rounded = np.array([float(f"{value:.{_DIGITS}g}") for value in values])
        material = replace(self._problem.material, constants=self._constants(rounded))
        document = replace(self._problem.alone(), material=material).document()
        key = self.first_solution = digest([document, self._depth], 32)
        is_last = self._scales and len(self._names) == 1  # of one modulus all others are known
        solution = _first_solutions.get(key)
        if solution is None or (solution.warm is None and not is_last):
            _make_room()
            solution = self._simulated(rounded, None, gradients=not is_last)
            if is_last and solution.status == "converged":
                slope = {self._names[0]: solution.curve.force_N / rounded[0]}
                curve = replace(solution.curve, force_gradient=slope)
                solution = replace(solution, curve=curve, warm=None)
            _first_solutions[key] = solution
        else:
            self._count(solution)
        return _converged(solution)

    def _simulated(
        self, values: Array, warm: Solution | None, *, gradients: bool = True
    ) -> Solution:
        try:
            problem = self._problem.at(self._constants(values), self._depth)
            solution = finite_element.solve(
                problem, gradients=gradients, warm=warm, cutbacks=_CUTBACKS
            )
        except InputError as error:
            raise EvaluationFailed(str(error)) from error
        self._count(solution)
        return solution

    def _count(self, solution: Solution) -> None:
        self.solves += 1
        self.newton_iterations += int(sum(solution.newton_iterations))

    def _at(self, values: Array, curve: Curve, grid: Array) -> Curve:
        """Interpolate force and gradient at measured points, each consistent with the other."""
        (factor, rates), here = self._factor(values), curve.displacement_mm
        base_here, base = self._base.force_at(here), self._base.force_at(grid)
        added = spline_from_origin(here, curve.force_N - factor * base_here, grid)
        gradient = {
            n: rates[n] * base
            + spline_from_origin(here, curve.force_gradient[n] - rates[n] * base_here, grid)
            for n in self._names
        }
        return Curve(grid, factor * base + added, force_gradient=gradient)

    @property
    def mesh_size_mm(self) -> float | None:
        """Element size of the last solution; None where there is none."""
        return None if self._last is None else float(self._last.mesh_size_mm)

    def predicted(self, values: Array) -> PredictedCurve | None:
        """Curve at the final constants, with mesh and solver of the last solution."""
        if self._last is None:
            return None
        return replace(prediction_of(self._last), curve=self.curves[np.asarray(values).tobytes()])


def _converged(solution: Solution) -> Solution:
    """Solution that has an answer."""
    if solution.status != "converged":
        raise EvaluationFailed(f"{solution.status}: {solution.message}")
    return solution


# -------------------------------------------------------------------------------------------------
# What the noise of a measured curve does to its constants: fits to resampled residuals.
#
# The residuals of a fit are laid around its curve again, in blocks where neighbors are
# correlated, and the constants are fitted to that curve, starting from the fit (Efron and
# Tibshirani 1993, chapter 9; blocks on a circle: Politis and Romano 1992). Draws depend on the
# study's seed and the measured curve alone: cells that are fitted to one curve, with blocks of
# one length, see its noise at the same places, so that effects are compared under one noise.

#: points below which residuals say nothing of their correlation
_FEWEST = 8

#: correlation of neighbors beyond this many standard errors is believed
_BELIEVED = 2.0


@dataclass(frozen=True)
class Residuals:
    """What a fit left of a measured curve, ready to be drawn from."""

    #: shape (n,); force of the fit, and its residuals, centered and scaled for the constants
    #: fitted.
    predicted_N: Array  # noqa: N815
    noise_N: Array  # noqa: N815
    lag1: float
    block: int


def residuals_of(measured: Curve, predicted_N: Array, share: float) -> Residuals:  # noqa: N803
    """Residuals of a fit with their block length; predicted_N (n,)."""
    left = measured.force_N - predicted_N
    left = left - left.mean()
    power = float(left @ left)
    lag1 = float(left[1:] @ left[:-1]) / power if power > 0 else 0.0
    return Residuals(predicted_N, math.sqrt(share) * left, lag1, block_length(lag1, left.size))


def block_length(lag1: float, n: int) -> int:
    """Length of the blocks that serves the variance of a mean best; 1 without correlation.

    Politis and White (2004, Econometric Reviews 23, 53), eq. 6 for circular blocks, with the
    autocovariances of a first-order autoregression, and their upper bound.

    Examples
    --------
    >>> block_length(0.0, 200), block_length(0.5, 200), block_length(0.9, 200)
    (1, 8, 30)
    """
    if n < _FEWEST or lag1 <= _BELIEVED / math.sqrt(n):
        return 1
    rho = min(lag1, 0.999)
    best = math.cbrt(6 * rho**2 / (1 - rho**2) ** 2 * n)
    return max(1, min(round(best), math.ceil(min(3 * math.sqrt(n), n / 3))))


def resampled(residuals: Residuals, random: np.random.Generator) -> Array:
    """Force of the fit with its residuals drawn anew, N, shape (n,)."""
    n, block = residuals.noise_N.size, residuals.block
    starts = random.integers(0, n, math.ceil(n / block))
    drawn = ((starts[:, None] + np.arange(block)) % n).ravel()[:n]
    return np.asarray(residuals.predicted_N + residuals.noise_N[drawn])


def refitted(job: FitJob) -> FitResult:
    """Fit the constants again to resampled curves."""
    began = time.perf_counter()
    if job.begun is None or job.noise is None:
        raise ValueError("a refit needs a fit, a seed and a number")
    base, measured = job.begun, job.measured
    if not base.converged:
        why = f"the fit to the measured curve did not converge: {base.message}"
        return FitResult(base.status, {"message": why})
    names = tuple(base.fit["names"])
    start = np.array([base.constants[name] for name in names])
    models = models_of(parts_of(job), names)
    predicted = [curve for model in models for curve in model(start)]
    points = sum(len(curve) for curve in measured)
    share = points / max(1, points - len(names))
    residuals = [
        residuals_of(curve, model_curve.force_at(curve.displacement_mm), share)
        for curve, model_curve in zip(measured, predicted, strict=True)
    ]
    drawn = (_drawn(*each, *job.noise) for each in zip(measured, residuals, strict=True))
    again = parts_of(replace(job, measured=tuple(drawn)))
    queue = iter(models)
    done = single_stage("resampled", again, start, StagedSearch(names, make=lambda *_: next(queue)))
    document = _described(done.fit, again[0].problem.material, residuals)
    document.update({"method": job.problem.method, "seconds": time.perf_counter() - began})
    return FitResult(status_of(done.fit), document)


def _described(fit: Fit, section: MaterialSection, residuals: Sequence[Residuals]) -> FitDocument:
    """Describe a refit; unstable constants stay, for they are part of the scatter."""
    constants = fit.constants()
    return {
        "message": fit.message,
        "names": list(fit.names),
        "values": constants,
        "mu0": float(section.material(constants).mu0),
        "identifiable": fit.converged,
        "reason": "" if fit.converged else fit.status.sentence,
        "evaluations": int(fit.evaluations),
        "resampling": [{"block": residual.block, "lag1": residual.lag1} for residual in residuals],
    }


def _drawn(measured: Curve, residuals: Residuals, seed: int, number: int) -> Curve:
    """One resample of one measured curve: numbers are the same for every cell fitted to it."""
    d = measured.displacement_mm
    name = digest([d.tolist(), measured.force_N.tolist()], 16)
    random = np.random.default_rng([seed, int(name, 16), number])
    return Curve(d, resampled(residuals, random), recorded=measured.recorded)
