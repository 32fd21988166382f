"""Nuisance parameters as a fit sees them: names, expected values, and the curves they move."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.calibration.covariance import scaled_inverse
from study.mechanics.calibration.fit import Fit, fit
from study.mechanics.calibration.fit_influence import (
    judged_again,
    recorded_rows,
    with_serial_correlation,
)
from study.mechanics.calibration.levenberg_marquardt import Status
from study.mechanics.calibration.residual_function import (
    MeasuredCurve,
    NuisanceEstimate,
    NuisanceParameter,
    Prior,
    pseudo_jacobian,
)
from study.mechanics.calibration.serial_correlation import row_noise
from study.simulation.calibration.calibration_file import FRICTION, OFFSET, ZERO, CalibratedTest
from study.simulation.calibration.measured_tests import FitCurve, parts_of
from study.simulation.cell import CellProblem
from study.simulation.fit_task import TOLERANCES, FitPart, InverseFem, closed_form_model
from study.simulation.job import fitted_test


def parameters_of(
    tests: Sequence[CalibratedTest], curves: Sequence[FitCurve]
) -> tuple[NuisanceParameter, ...]:
    """Nuisance parameters of a fit."""
    units: dict[tuple[str, str], list[int]] = {}
    for index, curve in enumerate(curves):
        for key, declared in tests[curve.test].nuisance.items():
            unit = {"curve": curve.label, "test": f"tests[{curve.test}]", "all": ""}[declared.each]
            units.setdefault((key, unit), []).append(index)
    count = {key: sum(other == key for other, _ in units) for key, _ in units}
    return tuple(
        _parameter(tests, curves, key, key if count[key] == 1 else f"{key} [{unit}]", places)
        for (key, unit), places in units.items()
    )


def _parameter(
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    key: str,
    name: str,
    places: list[int],
) -> NuisanceParameter:
    owners = [tests[curves[index].test] for index in places]
    declared = owners[0].nuisance[key]
    expected = [_expected(test, key) for test in owners]
    if max(expected) - min(expected) > 1e-12 * max(map(abs, expected)):
        rule = "differs between the tests that share it"
        raise InputError(Fault(f"nuisance.{key}", rule, 'write each = "test"'))
    uncertainty = declared.uncertainty
    if declared.relative and uncertainty is not None:
        uncertainty = uncertainty * abs(expected[0])
    param = NuisanceParameter(
        name, key, expected[0], uncertainty, declared.treat == "fitted", tuple(places)
    )
    if key == "material.poisson_ratio" and expected[0] + param.step >= 0.5:
        rule = f"{expected[0]:g} with an uncertainty of {param.step:g} reaches 0.5"
        mend = "give a smaller one, or material.bulk_modulus with its uncertainty"
        raise InputError(Fault(f"nuisance.{key}", rule, mend))
    return param


def _expected(test: CalibratedTest, key: str) -> float:
    setup = test.problem.setup
    if key == FRICTION and (setup.has_no_elements or not setup.kind.compresses):
        rule = "is that of two plates, and this is no compression of a specimen between them"
        mend = "declare it in the [[tests]] that have plates: nuisance = { friction = ... }"
        raise InputError(Fault("nuisance.friction", rule, mend))
    value = test.nuisance[key].value
    return _input(test.problem, key) if value is None else value


def _input(test: CellProblem, key: str) -> float:
    """Return an input of a test, in internal units."""
    value = test.value_at(key)
    if value is None:
        mend = "declare it in the [[tests]] that have it: nuisance = { ... }"
        raise InputError(Fault(f"nuisance.{key}", "is no input of this test", mend))
    return value


# Predicted curves of tests with unknown offset d0, zero z and friction phi: F(d) = f(d + d0) + z,
# f = (1 - phi) f_frictionless + phi f_bonded; other inputs move a curve along a parabola.

#: standard uncertainties that an offset may reach
REACH = 4.0
#: share of the largest displacement that an offset of which nothing is known may reach
_FAR = 0.05
#: change of the offset over the largest displacement from which the slope of a curve is taken
_SMALL = 1e-4


#: forces at displacements, mm, for constants; negative displacements pull what others press
_Model = Callable[[Array, Array], Curve]


def _closed_form(problem: CellProblem, names: Sequence[str]) -> _Model:
    def at(values: Array, grid: Array) -> Curve:
        empty = [Curve(grid, np.zeros_like(grid))]
        return closed_form_model(problem, empty, names)(values)[0]

    return at


class _Simulated(InverseFem):
    """Simulation at any displacements up to a depth, solved once for each set of constants."""

    def __init__(self, problem: CellProblem, names: Sequence[str], depth_mm: float) -> None:
        end = np.array([depth_mm])
        super().__init__(problem, [Curve(end, np.zeros(1))], names)
        self._solutions: dict[bytes, Curve] = {}

    def at(self, values: Array, grid: Array) -> Curve:
        """Predict forces at displacements, mm; before contact the curve goes on as an odd one."""
        key = values.tobytes()
        if key not in self._solutions:
            self(values)
            self._solutions = {key: self._solved_last}
        mirrored = self._at(values, self._solutions[key], np.abs(grid))
        sign = np.where(grid < 0, -1.0, 1.0)
        slopes = {name: sign * slope for name, slope in mirrored.force_gradient.items()}
        return Curve(grid, sign * mirrored.force_N, force_gradient=slopes)

    def _solved(self, values: Array) -> Curve:
        self._solved_last = super()._solved(values)
        return self._solved_last


#: interface of both plates, input and side to which it is moved, of a curve that is computed
_Variant = tuple[str, str, int]


def reach_of(param: NuisanceParameter, depth_mm: float) -> float:
    """How far an offset may go from its expected value, mm."""
    return _FAR * depth_mm if param.uncertainty is None else REACH * param.uncertainty


class NuisancePredictions:
    """Curves of all parts of a fit for constants and nuisance parameters together."""

    def __init__(
        self,
        tests: Sequence[CalibratedTest],
        curves: Sequence[FitCurve],
        names: Sequence[str],
    ) -> None:
        self.parameters = parameters_of(tests, curves)
        self.parts, self._names = parts_of(tests, curves), tuple(names)
        self._tests = [tests[number] for number in sorted({c.test for c in curves})]
        self._made: dict[tuple[int, _Variant], _Model] = {}

    def __call__(self, values: Array, free: Sequence[NuisanceParameter]) -> list[Curve]:
        """Predict all curves, with their derivatives by the constants and what is asked."""
        # Shapes: values (p + k,), MPa.
        constants, others = np.split(values, [len(self._names)])
        given = {param.name: value for param, value in zip(free, others, strict=True)}
        out: list[Curve] = []
        for number, part in enumerate(self.parts):
            for m in part.measured:
                movers = [param for param in self.parameters if len(out) in param.curves]
                out.append(self._curve(number, m.curve.displacement_mm, movers, constants, given))
        return out

    def _curve(
        self,
        number: int,
        measured: Array,
        movers: Sequence[NuisanceParameter],
        constants: Array,
        given: Mapping[str, float],
    ) -> Curve:
        """Curve of one test by its parts: shares of the computed ones add up."""
        value = {**{param.name: param.expected for param in self.parameters}, **given}
        # the unloaded point takes part: an unknown zero is no zero there
        points = np.r_[0.0, measured] if measured[0] > 0 else measured
        n, part = points.size, self.parts[number]
        small = _SMALL * max(float(m.curve.displacement_mm[-1]) for m in part.measured)
        offset = sum(value[param.name] for param in movers if param.key == OFFSET)
        zero = sum(value[param.name] for param in movers if param.key == ZERO)
        grid = np.concatenate([points + offset, points + offset + small, points + offset - small])
        active = {p.key: p for p in movers if p.name in given or p.key == FRICTION}
        shares = _shares(list(active.values()), value)
        solved = {
            variant: self._model(number, variant, active.get(variant[1]))(constants, grid)
            for variant in shares
        }
        total = _weighed(shares, solved, self._names)
        gradient = {name: row[:n] for name, row in zip(self._names, total[1:], strict=True)}
        # those of other curves leave this one alone
        gradient |= {param.name: np.zeros(n) for param in self.parameters if param.name in given}
        for mover in active.values():
            if mover.key == OFFSET:
                gradient[mover.name] = (total[0][n : 2 * n] - total[0][2 * n :]) / (2 * small)
            elif mover.key == ZERO:
                gradient[mover.name] = np.ones(n)
            elif mover.name in given:
                change = _shares(list(active.values()), value, mover)
                gradient[mover.name] = _weighed(change, solved, ())[0][:n]
        return Curve(points, total[0][:n] + zero, force_gradient=gradient)

    def _model(self, number: int, variant: _Variant, moved: NuisanceParameter | None) -> _Model:
        plate, key, sign = variant
        if (number, variant) not in self._made:
            problem, depth = self._tests[number].problem, self._depth(self.parts[number])
            if moved is not None:
                problem = problem.with_value(key, _input(problem, key) + sign * moved.step)
            if plate:
                problem = problem.loaded(interface=plate, base=plate)
            fitted = fitted_test("auto", problem.loaded(displacement_mm=depth))
            self._made[number, variant] = (
                _closed_form(fitted.problem, self._names)
                if fitted.method == "closed-form"
                else _Simulated(fitted.problem, self._names, depth).at
            )
        return self._made[number, variant]

    def _depth(self, part: FitPart) -> float:
        """Depth that a simulation must reach, offsets included, mm."""
        depth = max(float(m.curve.displacement_mm.max()) for m in part.measured)
        offsets = [param for param in self.parameters if param.key == OFFSET]
        beyond = (max(param.expected, 0) + reach_of(param, depth) for param in offsets)
        return depth + max(beyond, default=0.0) + 2 * _SMALL * depth


def _shares(
    movers: Sequence[NuisanceParameter],
    value: Mapping[str, float],
    by: NuisanceParameter | None = None,
) -> dict[_Variant, float]:
    """Share of every computed curve in the one predicted, or its derivative by a parameter."""
    friction = next((param for param in movers if param.key == FRICTION), None)
    plates = {"": 1.0}
    if friction is not None:
        phi = value[friction.name]
        free, bonded = (-1.0, 1.0) if by is friction else (1 - phi, phi)
        plates = {"frictionless": free, "bonded": bonded}
    inner = {("", 0): 0.0 if by is not None and by is not friction else 1.0}
    for param in movers:
        is_input = param.key not in (OFFSET, ZERO, FRICTION)
        if not is_input or (by is not None and by is not friction and param is not by):
            continue
        t = (value[param.name] - param.expected) / param.step
        parabola = np.array([0.5 * t * (t - 1), -t * t, 0.5 * t * (t + 1)])
        if param is by:
            parabola = np.array([t - 0.5, -2 * t, t + 0.5]) / param.step
        for sign, share in zip((-1, 0, 1), parabola, strict=True):
            key = (param.key if sign else "", sign)
            inner[key] = inner.get(key, 0.0) + float(share)
    return {
        (plate, key, sign): a * b for plate, a in plates.items() for (key, sign), b in inner.items()
    }


def _weighed(
    shares: Mapping[_Variant, float], solved: Mapping[_Variant, Curve], names: Sequence[str]
) -> Array:
    """Sum of computed forces and gradients, shape (1 + p, n)."""
    rows = [
        share * np.array([solved[name].force_N, *(solved[name].force_gradient[n] for n in names)])
        for name, share in shares.items()
    ]
    return np.asarray(np.sum(rows, axis=0))


# Constants with nuisance parameters. A fitted one is one more unknown with a pseudo-observation;
# a propagated one of standard uncertainty u adds u^2 b b' to the covariance, b the derivative of
# the estimates by it (JCGM 100:2008, eq. 10).

#: change of the noise, relative, at which pseudo-observations have their weight
_SETTLED = 1e-3
#: the same where the correlation of rows, which stands on a grid, goes to and fro by a step
_A_STEP = 0.03
#: fits in which they find it
_ROUNDS = 16
#: standard uncertainties beside the expected offset at which a fit begins, too
_STARTS = (-1.5, 1.5, -3.0, 3.0)
#: noise over the largest force of data that have none
_NOISELESS = 1e-9


@dataclass(frozen=True)
class _NuisanceFit:
    """Fits of one calibration to its constants and its nuisance parameters."""

    predictions: NuisancePredictions
    measured: Sequence[MeasuredCurve]
    names: tuple[str, ...]
    bounds: Sequence[tuple[float, float]]
    simulated: bool
    #: Parameters that the tests may move, and those whose uncertainty is propagated.
    fitted: Sequence[NuisanceParameter]
    carried: Sequence[NuisanceParameter]

    @property
    def largest(self) -> float:
        """Largest weighted force."""
        return max(float(np.abs(m.weights * m.curve.force_N).max()) for m in self.measured)

    def solved(self, start: Array, noise: float) -> tuple[Fit, Fit]:
        """Fit all that is unknown; as least squares gives it, and from its rows."""
        free = (-np.inf, np.inf)
        depth = max(float(m.curve.displacement_mm.max()) for m in self.measured)
        bounds = [*self.bounds]
        for param in self.fitted:
            far = reach_of(param, depth)
            is_offset = param.key == OFFSET
            bounds.append((param.expected - far, param.expected + far) if is_offset else free)
        priors = [
            Prior(param.name, param.expected, param.uncertainty, noise)
            for param in self.fitted
            if param.uncertainty is not None
        ]
        solution = fit(
            lambda values: self.predictions(values, self.fitted),
            self.measured,
            (*self.names, *(param.name for param in self.fitted)),
            start,
            bounds=bounds,
            priors=priors,
            **TOLERANCES["inverse-fem" if self.simulated else "closed-form"],
        )
        return solution, with_serial_correlation(solution, self.measured)

    def settled(self, first_fit: Fit) -> tuple[Fit, Fit]:
        """Fit again until the weight of the pseudo-observations is that of the residuals left.

        The first weight is that of the noise of neighboring rows: the misfit at the expected
        values is what the nuisance parameters are there to explain.
        """
        noise = self._row_noise(first_fit)
        plain, joint = self._from_all(first_fit.values, noise)
        for number in range(_ROUNDS):
            now = self._noise(joint)
            near = _SETTLED if number < _ROUNDS // 2 else _A_STEP
            if not joint.converged or abs(now - noise) <= near * noise:
                break
            # more weight, less misfit, less weight: a round trip ends in its middle
            noise = now if number < _ROUNDS // 4 else float(np.sqrt(noise * now))
            plain, joint = self.solved(plain.values, noise)
        else:
            why = f"the weight of the pseudo-observations has not settled in {_ROUNDS} fits"
            plain, joint = (
                replace(each, status=Status.max_evaluations, failure=why) for each in (plain, joint)
            )
        return plain, joint

    def _from_all(self, constants: Array, noise: float) -> tuple[Fit, Fit]:
        """Fit from the expected values and from offsets beside them; the least penalty is kept."""
        expected = np.array([param.expected for param in self.fitted])
        starts = [expected]
        for param, unit in zip(self.fitted, np.eye(len(self.fitted)), strict=True):
            if param.key == OFFSET and param.uncertainty is not None:
                steps = _STARTS[:2] if self.simulated else _STARTS
                starts += [expected + step * param.uncertainty * unit for step in steps]
        candidates = [self.solved(np.r_[constants, start], noise) for start in starts]
        ended = [pair for pair in candidates if pair[1].converged]
        return min(ended or candidates[:1], key=lambda pair: pair[0].penalized_rss)

    def _row_noise(self, start: Fit) -> float:
        """Noise of independent points by differences of neighboring rows; else by the misfit."""
        squares: list[Array] = []
        for measured, curve in zip(self.measured, start.curves, strict=True):
            for weight, recorded, force, _ in recorded_rows(measured, curve, start.names):
                noise = row_noise(recorded.force_N, recorded.places, force, power=0.0)
                if noise is None:
                    return self._noise(start)
                squares.append(np.square(weight * noise.deviation))
        every = np.concatenate(squares)
        deviation = float(np.sqrt(np.mean(every) * start.n / min(every.size, start.n)))
        return max(deviation, _NOISELESS * self.largest)

    def _noise(self, result: Fit) -> float:
        """Give the standard deviation with which independent points would know as little."""
        deviation = np.sqrt(result.rss / max(result.degrees_of_freedom, 1))
        if result.serial is not None:
            deviation *= np.sqrt(result.n / min(result.serial.effective_rows, result.n))
        return max(float(deviation), _NOISELESS * self.largest)

    def moved(self, joint: Fit) -> Array:
        """Change of the estimates by one standard uncertainty of each propagated input, (p, k)."""
        if not self.carried:
            return np.zeros((joint.values.size, 0))
        values = np.r_[joint.values, [param.expected for param in self.carried]]
        curves = self.predictions(values, [*self.fitted, *self.carried])
        jacobian, slopes = (
            np.concatenate([m.slopes(c, names) for m, c in zip(self.measured, curves, strict=True)])
            for names in (joint.names, [param.name for param in self.carried])
        )
        full = np.concatenate([jacobian, pseudo_jacobian(joint.priors, joint.names)])
        inverse, _ = scaled_inverse(full)
        steps = np.array([param.step for param in self.carried])
        return np.asarray(-inverse @ jacobian.T @ slopes * steps)

    def estimate(
        self, param: NuisanceParameter, plain: Fit, joint: Fit, moved: Array
    ) -> NuisanceEstimate:
        """Say what became of one parameter, and which share of each variance is its own."""
        places = [i for i, name in enumerate(joint.names) if name in self.names]
        variance = np.diag(joint.covariance)[places]
        if param.is_fitted:
            i = joint.names.index(param.name)
            rest = tuple(name for name in joint.names if name != param.name)
            priors = tuple(prior for prior in plain.priors if prior.name in rest)
            reduced = replace(_part(plain, rest), priors=priors)
            others = np.delete(moved, i, axis=0)
            left = with_serial_correlation(reduced, self.measured, others @ others.T)
            gone = 1 - np.diag(left.covariance)[[rest.index(n) for n in self.names]] / variance
            value, error = float(joint.values[i]), float(joint.standard_error[i])
            interval = (float(joint.ci95[i, 0]), float(joint.ci95[i, 1]))
        else:
            gone = moved[places, list(self.carried).index(param)] ** 2 / variance
            value, error = param.expected, param.step
            interval = (value - 1.96 * error, value + 1.96 * error)
        shares = np.clip(np.nan_to_num(gone), 0.0, 1.0)
        shown = dict(zip(self.names, shares.tolist(), strict=True))
        return NuisanceEstimate(**vars(param), value=value, standard_error=error, ci95=interval,
                                shares=shown)  # fmt: skip


def with_nuisance(
    first_fit: Fit,
    tests: Sequence[CalibratedTest],
    curves: Sequence[FitCurve],
    bounds: Sequence[tuple[float, float]],
) -> Fit:
    """Fit of the constants with what is not known exactly."""
    predictions = NuisancePredictions(tests, curves, first_fit.names)
    parameters = predictions.parameters
    if not parameters or not first_fit.converged:
        return first_fit
    simulated = any(part.method == "inverse-fem" for part in predictions.parts)
    nuisance_fit = _NuisanceFit(
        predictions, curves, first_fit.names, bounds,
        simulated or any(param.key == FRICTION for param in parameters),
        [param for param in parameters if param.is_fitted],
        [param for param in parameters if not param.is_fitted],
    )  # fmt: skip
    plain, joint = nuisance_fit.settled(first_fit)
    if not joint.converged:
        return replace(_part(joint, first_fit.names), joint=joint)
    moved = nuisance_fit.moved(joint)
    joint = with_serial_correlation(plain, curves, moved @ moved.T)
    estimates = tuple(nuisance_fit.estimate(param, plain, joint, moved) for param in parameters)
    constants = _part(joint, first_fit.names)
    if np.isfinite(constants.covariance).all():
        constants = judged_again(constants, joint.degrees_of_freedom, curves)
    return replace(constants, joint=joint, nuisance=estimates)


def _part(joint: Fit, names: tuple[str, ...]) -> Fit:
    """Part of a fit that is about some of its parameters, the others still unknown."""
    places = [joint.names.index(name) for name in names]
    serial = joint.serial
    if serial is not None:
        mixture = None if serial.mixture is None else serial.mixture.of(np.array(places))
        serial = replace(serial, inflation=serial.inflation[places], mixture=mixture)
    values, covariance = joint.values[places], joint.covariance[np.ix_(places, places)]
    relative = np.where(values == 0, 1.0, values)
    spread = np.linalg.eigvalsh(np.nan_to_num(covariance / np.outer(relative, relative)))
    return replace(
        joint,
        names=names,
        values=values,
        condition=float(np.sqrt(spread[-1] / spread[0])) if spread[0] > 0 else np.inf,
        standard_error=joint.standard_error[places],
        ci95=joint.ci95[places],
        covariance=covariance,
        correlation=joint.correlation[np.ix_(places, places)],
        serial=serial,
        priors=(),
    )
