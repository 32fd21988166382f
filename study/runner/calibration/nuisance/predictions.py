"""Predicted curves of tests whose offset, zero, friction and inputs are not known exactly.

An offset d0 adds to every recorded displacement and a zero z to every force:
F(d) = f(d + d0) + z. Friction between plates lies between the two conditions that can be computed,
f = (1 - phi) f_frictionless + phi f_bonded. Other inputs move a curve along the parabola
through its values at the expected input and one step on either side, so that the force is a
smooth function of them although a mesh is not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from study.arrays import Array
from study.curve import Curve
from study.design.sections.calibration_design import CalibratedTest
from study.runner.calibration.measured_tests import problem_of
from study.runner.calibration.nuisance.parameters import (
    FRICTION,
    OFFSET,
    ZERO,
    NuisanceParameter,
    moved,
)
from study.runner.fitting import fit_task
from study.runner.fitting.staged_fit import Part
from study.setup.section import with_table
from study.setup.setup import Tables

#: standard uncertainties that an offset may reach
REACH = 4.0

#: share of the largest displacement that an offset of which nothing is known may reach
_FAR = 0.05

#: change of the offset over the largest displacement from which the slope of a curve is taken
_SMALL = 1e-4


class _Homogeneous:
    """Closed form at any displacements."""

    def __init__(self, tables: Tables, names: Sequence[str]) -> None:
        self._tables, self._names = tables, names

    def at(self, values: Array, grids: Sequence[Array]) -> list[Curve]:
        """Predict forces at displacements, mm; negative ones pull what others press."""
        asked = [Curve(grid, np.zeros_like(grid)) for grid in grids]
        return fit_task.closed_form_model(self._tables, asked, self._names)(values)


class _Simulated(fit_task.InverseFem):
    """Simulation at any displacements up to a depth, solved once for each set of constants."""

    def __init__(self, tables: Tables, names: Sequence[str], depth_mm: float) -> None:
        end = np.array([depth_mm])
        super().__init__(tables, [Curve(end, np.zeros(1))], names)
        self._solutions: dict[bytes, Curve] = {}

    def at(self, values: Array, grids: Sequence[Array]) -> list[Curve]:
        """Predict forces at displacements, mm; before contact the curve goes on as an odd one."""
        key = values.tobytes()
        if key not in self._solutions:
            self(values)
            self._solutions = {key: self._solved_last}
        return [self._odd(self._solutions[key], grid) for grid in grids]

    def _solved(self, values: Array) -> Curve:
        self._solved_last = super()._solved(values)
        return self._solved_last

    def _odd(self, curve: Curve, grid: Array) -> Curve:
        found, sign = self._at(curve, np.abs(grid)), np.where(grid < 0, -1.0, 1.0)
        slopes = {name: sign * slope for name, slope in found.force_gradient.items()}
        return Curve(grid, sign * found.force_N, force_gradient=slopes)


def reach_of(one: NuisanceParameter, depth_mm: float) -> float:
    """How far an offset may go from its expected value, mm.

    Parameters
    ----------
    one : NuisanceParameter
        A displacement offset; it may go four standard uncertainties.
    depth_mm : float
        Largest measured displacement; an offset of unknown uncertainty may go 5 % of it.
    """
    return _FAR * depth_mm if one.uncertainty is None else REACH * one.uncertainty


class Predictions:
    """Curves of all parts of a fit for constants and nuisance parameters together.

    Parameters
    ----------
    parts : sequence of Part
        Tests with their curves.
    tests : sequence of CalibratedTest
        Test of every part.
    names : sequence of str
        Constants.
    parameters : sequence of NuisanceParameter
        All of the calibration; a call asks for some of them.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        tests: Sequence[CalibratedTest],
        names: Sequence[str],
        parameters: Sequence[NuisanceParameter],
    ) -> None:
        self._parts, self._tests = parts, tests
        self._names, self._parameters = tuple(names), tuple(parameters)
        self._made: dict[tuple[int, str, str, int], _Homogeneous | _Simulated] = {}

    def __call__(self, values: Array, asked: Sequence[NuisanceParameter]) -> list[Curve]:
        """Predict all curves, with their derivatives by the constants and what is asked.

        Parameters
        ----------
        values : ndarray, shape (p + k,)
            Constants in MPa, exponents plain, then the parameters that are asked.
        asked : sequence of NuisanceParameter, length k
            Others have their expected values.
        """
        constants = values[: len(self._names)]
        given = {one.name: v for one, v in zip(asked, values[len(self._names) :], strict=True)}
        out: list[Curve] = []
        for number, part in enumerate(self._parts):
            first = len(out)
            places = range(first, first + len(part.measured))
            out += self._of_part(number, part, constants, places, given)
        return out

    def _of_part(
        self, number: int, part: Part, constants: Array, places: range, given: Mapping[str, float]
    ) -> list[Curve]:
        own = [[one for one in self._parameters if place in one.curves] for place in places]
        value = {one.name: given.get(one.name, one.expected) for one in self._parameters}
        points = [_from_origin(m.curve.displacement_mm) for m in part.measured]
        depth = max(float(grid[-1]) for grid in points)
        small = _SMALL * depth
        offset = [sum(value[o.name] for o in ones if o.key == OFFSET) for ones in own]
        zeros = [sum(value[o.name] for o in ones if o.key == ZERO) for ones in own]
        grids = [
            np.concatenate([grid + d, grid + d + small, grid + d - small])
            for grid, d in zip(points, offset, strict=True)
        ]
        active = [[one for one in ones if one.name in given or one.key == FRICTION] for ones in own]
        keys = {one.key: one for ones in active for one in ones if one.is_input}
        plates = {one.key for ones in active for one in ones} & {FRICTION}
        found: dict[tuple[str, str, int], list[Curve]] = {}
        for plate in ("frictionless", "bonded") if plates else ("",):
            found[plate, "", 0] = self._model(number, part, plate, None, 0).at(constants, grids)
            for key, one in keys.items():
                for sign in (-1, 1):
                    model = self._model(number, part, plate, one, sign)
                    found[plate, key, sign] = model.at(constants, grids)
        return [
            self._combined(k, points[k], small, zeros[k], active[k], value, given, found)
            for k in range(len(points))
        ]

    def _model(
        self, number: int, part: Part, plate: str, one: NuisanceParameter | None, sign: int
    ) -> _Homogeneous | _Simulated:
        name = (number, plate, "" if one is None else one.key, sign)
        if name not in self._made:
            tables = self._tests[number].tables
            if one is not None:
                tables = moved(tables, one.key, sign * one.step)
            if plate:
                tables = with_table(tables, "test", interface=plate, base=plate)
            reached = with_table(tables, "test", displacement_mm=self._depth(part))
            problem = problem_of(reached)
            if problem.method == "closed-form":
                self._made[name] = _Homogeneous(problem.tables, self._names)
            else:
                self._made[name] = _Simulated(problem.tables, self._names, self._depth(part))
        return self._made[name]

    def _depth(self, part: Part) -> float:
        """Depth that a simulation must reach, offsets included, mm."""
        depth = max(float(m.curve.displacement_mm.max()) for m in part.measured)
        offsets = [one for one in self._parameters if one.key == OFFSET]
        beyond = (max(one.expected, 0) + reach_of(one, depth) for one in offsets)
        return depth + max(beyond, default=0.0) + 2 * _SMALL * depth

    def _combined(
        self,
        k: int,
        points: Array,
        small: float,
        zero: float,
        own: Sequence[NuisanceParameter],
        value: Mapping[str, float],
        given: Mapping[str, float],
        found: Mapping[tuple[str, str, int], Sequence[Curve]],
    ) -> Curve:
        """Curve of one test by its parts: shares of the computed ones add up."""
        shares = _shares(own, value)
        names = self._names
        total = _weighed(shares, found, k, names)
        n = points.size
        slope = (total[0][n : 2 * n] - total[0][2 * n :]) / (2 * small)
        gradient = {name: row[:n] for name, row in zip(names, total[1:], strict=True)}
        for one in self._parameters:  # those of other curves leave this one alone
            if one.name in given:
                gradient[one.name] = np.zeros(n)
        force = total[0][:n]
        for one in own:
            if one.key == OFFSET:
                gradient[one.name] = slope
            elif one.key == ZERO:
                gradient[one.name] = np.ones(n)
            elif one.name in given:
                change = _shares(own, value, one)
                gradient[one.name] = _weighed(change, found, k, ())[0][:n]
        return Curve(points, force + zero, force_gradient=gradient)


def _from_origin(grid: Array) -> Array:
    """Points of a curve with the unloaded one, at which an unknown zero is no zero."""
    return np.r_[0.0, grid] if grid[0] > 0 else grid


def _shares(
    own: Sequence[NuisanceParameter],
    value: Mapping[str, float],
    by: NuisanceParameter | None = None,
) -> dict[tuple[str, str, int], float]:
    """Share of every computed curve in the one predicted, or its derivative by a parameter."""
    friction = next((one for one in own if one.key == FRICTION), None)
    plates = {"": 1.0}
    if friction is not None:
        phi = value[friction.name]
        plates = {"frictionless": 1 - phi, "bonded": phi}
        if by is friction:
            plates = {"frictionless": -1.0, "bonded": 1.0}
    inner = {("", 0): 0.0 if by is not None and by is not friction else 1.0}
    for one in own:
        if not one.is_input or (by is not None and by is not friction and one is not by):
            continue
        t = (value[one.name] - one.expected) / one.step
        parabola = np.array([0.5 * t * (t - 1), -t * t, 0.5 * t * (t + 1)])
        if one is by:
            parabola = np.array([t - 0.5, -2 * t, t + 0.5]) / one.step
        for sign, share in zip((-1, 0, 1), parabola, strict=True):
            key = (one.key if sign else "", sign)
            inner[key] = inner.get(key, 0.0) + float(share)
    return {
        (plate, key, sign): a * b for plate, a in plates.items() for (key, sign), b in inner.items()
    }


def _weighed(
    shares: Mapping[tuple[str, str, int], float],
    found: Mapping[tuple[str, str, int], Sequence[Curve]],
    k: int,
    names: Sequence[str],
) -> Array:
    """Sum of computed forces and gradients, shape (1 + p, n)."""
    rows = [
        share
        * np.array([found[name][k].force_N, *(found[name][k].force_gradient[n] for n in names)])
        for name, share in shares.items()
    ]
    return np.asarray(np.sum(rows, axis=0))
