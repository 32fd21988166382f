"""One pass over the requested load steps: sub-steps, limit points, points where a curve bends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.fem.solver.energy_balance import LoadedState
from study.fem.solver.limit_point import gives_way, lost_ellipticity, solve_through
from study.fem.solver.newton import NewtonResult, NewtonSettings, solve_step
from study.fem.solver.options import Options
from study.fem.solver.own_weight import FALLS, sagged_state
from study.fem.solver.sensitivity import StepGradients, step_gradients
from study.fem.solver.solution import Logbook, Solution
from study.fem.solver.state import State
from study.fem.solver.system import System
from study.setup.setup import Problem

#: steps past a limit point over the largest step: long enough to leave it behind, or just past it
_LEAPS = (0.5, 0.1)

#: places at which the new equilibrium is looked for, as shares of the way back from there
_BACK = (0.02, 0.5)

#: the same of the last one before, where right at the limit point nothing converges any more:
#: shares of the way back to the last load step
_BEFORE = (0.0, 0.02, 0.1)

#: longest extrapolation over the last step: a step may grow and still be extrapolated
_FARTHEST = 1.7

#: shares of its last value to which J may fall: in a step (below it, what was found is a folded
#: surface and not the next state), in an extrapolation, and in a start from an earlier solve
_LEAPT = 0.25
_EXTRAPOLATED = 0.3
_MOVED = 0.5

#: smallest step of an energy that has lost its ellipticity over that of any other
_BEYOND = 8.0

#: Times that a step is halved where energy is missing: a jump is found to an eighth of it.
_HALVINGS = 3

#: Times that steps are added to a curve whose interpolation is not as near as asked.
_ROUNDS = 3


@dataclass(frozen=True)
class _Place:
    """What a load step starts from, so that it can be taken once more in halves."""

    state: State
    previous: State | None
    J: Array
    step_mm: float
    min_j: float


class LoadPath:
    """One pass over the requested steps."""

    def __init__(
        self,
        system: System,
        problem: Problem,
        options: Options,
        gradients: bool,
        progress: Callable[[float], None] | None,
        warm: Solution | None,
    ) -> None:
        self.system, self.problem, self.options = system, problem, options
        self.wanted = problem.material.names if gradients else ()
        self.warm = warm.warm if warm is not None else None
        steps = () if self.warm is None else self.warm.steps
        self._warm_steps = {step.state.displacement_mm: step for step in steps}
        self.progress = progress or (lambda _: None)
        self.rest: State | None = system.start()  # None where the weight has no equilibrium
        if system.weight is not None:
            self.rest = sagged_state(system, options.newton)
            system = self.system = system if self.rest is None else system.sagged(self.rest)
        self.state, self.previous = self.rest or system.start(), None  # type: State, State | None
        self.J = system.volume_ratios(self.state.x)
        self.rule = problem.setup.step_rule(options.steps, system.height_mm)
        self.step_mm = self.rule.first_mm
        every = options.curve_error is not None
        self.logbook = Logbook(system, problem, self.wanted, every_step=every)
        self.min_j, self.reason = 1.0, ""
        self._reach_of: tuple[State, str] | None = None
        self._latest: tuple[NewtonResult, StepGradients] | None = None

    def to_the_end(self) -> LoadPath:
        """Go through the requested steps for as long as they converge."""
        if self.rest is None:
            self.reason = FALLS
            return self
        for target, asked in self._targets():
            if not self._advance(target, _HALVINGS):
                break
            self.logbook.requested += asked
            self.progress(target / self.problem.test.depth_mm)
        if self.options.curve_error and self.warm is None and not self.system.sticks:
            self._fill_in(self.options.curve_error)
        return self

    def _targets(self) -> list[tuple[float, bool]]:
        """Displacements, and whether they are requested; an earlier solve's are gone through too.

        Curves of one problem then have the same points, and their difference is one of forces.
        """
        test = self.problem.test
        asked = [test.depth_mm * k / test.steps for k in range(1, test.steps + 1)]
        added = [d for d in self._warm_steps if d < asked[-1] and self.logbook.every_step]
        near = 1e-9 * self.system.height_mm
        others = [d for d in added if min(abs(d - own) for own in asked) > near]
        return sorted([(d, True) for d in asked] + [(d, False) for d in others])

    def _advance(self, target: float, halvings: int) -> bool:
        """Reach a displacement and write it down, in halves where energy does not add up."""
        place, snaps = self._place(), len(self.logbook.snaps)
        result, spent = self._reach(target)
        if result is None:
            return False
        # kept, for other steps may be assembled before it is written down
        row = self._row(result)
        loaded = self.logbook.loaded(self.state, row)
        known = len(self.logbook.snaps) > snaps
        jumped = not known and self.logbook.jumped_to(loaded)
        if jumped and halvings and not self.system.sticks:
            there, middle = self._place(), 0.5 * (place.state.displacement_mm + target)
            self._return_to(place)
            if self._advance(middle, halvings - 1) and self._advance(target, halvings - 1):
                return True
            self._return_to(there)  # smaller steps found nothing
        if jumped:
            self.logbook.snaps.append(self.logbook.reached[-1])
        self.logbook.add(self.state, result.equilibrium(), row, loaded, spent)
        return True

    def _place(self) -> _Place:
        return _Place(self.state, self.previous, self.J, self.step_mm, self.min_j)

    def _return_to(self, place: _Place) -> None:
        """Go back; what was found in between is no start for the steps to come."""
        self.state, self.J, self.min_j = place.state, place.J, place.min_j
        self.previous, self.step_mm = place.previous, place.step_mm
        self.reason = ""
        self.logbook.forget_jumps()

    def _fill_in(self, error: float) -> None:
        """Add steps in the middle of intervals in which the curve bends."""
        for _ in range(_ROUNDS):
            places = self.logbook.coarse_intervals(error)
            for displacement in places:
                self._insert(displacement)
            if not places:
                return

    def _insert(self, displacement: float) -> None:
        """Write down an equilibrium between two steps, where it lies on the way between them."""
        before, after = self.logbook.around(displacement)
        left = (self.rest or self.system.start()) if before is None else before
        end = self._place()
        result = self._halfway(left, after, displacement) or self._onwards(left, displacement)
        if result is not None:
            row = self._row(result)
            loaded = self.logbook.loaded(result.state, row)
            if self.logbook.lies_between(loaded):
                spent = result.iterations
                self.logbook.add(result.state, result.equilibrium(), row, loaded, spent)
        self._return_to(end)

    def _halfway(self, left: State, right: State, displacement: float) -> NewtonResult | None:
        """Equilibrium near the mean of two states; None where there is none nearby."""
        each = zip(self.system.contact, left.multipliers, right.multipliers, strict=True)
        pressed = tuple(points.admissible(0.5 * (m + n)) for points, m, n in each)
        J = self.system.volume_ratios(left.x)
        mean = State(displacement, 0.5 * (left.x + right.x), pressed)
        guess = self._sound(mean, J, _MOVED)
        if guess is None:
            return None
        result = solve_step(self.system, guess, self.options.newton)
        return result if result.converged and _near(result, J) else None

    def _onwards(self, left: State, displacement: float) -> NewtonResult | None:
        """Equilibrium reached from a state by load steps like any others."""
        self.state, self.previous, self.J = left, None, self.system.volume_ratios(left.x)
        self.step_mm = min(self.rule.first_mm, displacement - left.displacement_mm)
        return self._reach(displacement)[0]

    def may_do_better(self) -> bool:
        """Whether a run that stopped short is to be tried from the unloaded state.

        Where a surface is about to snap, the way that led there decides whether it is passed.
        """
        return not self.logbook.complete and not self._lost()

    def _reach(self, target: float) -> tuple[NewtonResult | None, int]:
        """Equilibrium at a displacement, in sub-steps where needed, and the iterations spent."""
        spent, result = 0, self._from_warm(target)
        if result is not None:
            spent += result.iterations
            self._accept(result)
        while result is None or not self._at(target):
            remaining = target - self.state.displacement_mm
            pieces = max(1, int(np.ceil(remaining / self.step_mm - 1e-9)))
            step, newton = remaining / pieces, self.options.newton
            if pieces > 1 and not self.system.sticks:  # what sticks remembers every state
                newton = newton.passing()
            result = self._attempt(self.state.displacement_mm + step, newton)
            spent += result.iterations
            if result.converged and (_near(result, self.J) or self._too_short(step / 2)):
                self._adapt(result.iterations, step)
                self._accept(result)
                continue
            self.step_mm = step / 2
            if self._too_short(self.step_mm):
                through = self._through(target) if self._may_snap() else None
                if through is None:
                    self.reason = result.reason
                    return None, spent
                result, spent = through, spent + through.iterations
                self._accept(result)
        return result, spent

    def _at(self, target: float) -> bool:
        return abs(self.state.displacement_mm - target) < 1e-9 * self.system.height_mm

    def _attempt(self, displacement: float, newton: NewtonSettings) -> NewtonResult:
        guess = self._extrapolated(displacement)
        if guess is not None:
            result = solve_step(self.system, guess, newton)
            if result.converged and _near(result, self.J):
                return result
            self.previous = None  # no extrapolation right after a failure
        start = replace(self.state, displacement_mm=displacement)
        return solve_step(self.system, start, newton, lifted_from=self._lift())

    def _lift(self) -> State | None:
        """State that a driven specimen is lifted from; an indenter drives no unknown."""
        return self.state if self.system.constraints.rate.any() else None

    def _too_short(self, step_mm: float) -> bool:
        """Whether a step is not worth trying: sooner where the energy's reach has ended."""
        smallest = self.rule.smallest_mm()
        return step_mm < smallest or (step_mm < _BEYOND * smallest and bool(self._lost()))

    def _may_snap(self) -> bool:
        """Whether to look beyond a limit point: not for an energy that has lost its ellipticity."""
        return self.options.snaps and not self._lost()

    def _lost(self) -> str:
        """Where the energy has lost its ellipticity at the last state, looked at once for each."""
        if self._reach_of is None or self._reach_of[0] is not self.state:
            self._reach_of = self.state, lost_ellipticity(self.system, self.state)
        return self._reach_of[1]

    def _through(self, target: float) -> NewtonResult | None:
        """Go past a limit point, in a step long enough to leave it behind; None if none does."""
        here, spent = self.state.displacement_mm, 0
        for share in _LEAPS:
            step = min(target - here, share * self.rule.largest_mm(here))
            start = replace(self.state, displacement_mm=here + step)
            newton, lift = self.options.newton, self._lift()
            result = solve_through(self.system, start, newton, lifted_from=lift)
            spent += result.iterations
            if result.converged:
                self._write_down_both_sides(result)
                self.step_mm, self.previous = 0.5 * step, None
                self.logbook.snaps.append(here)
                # assembled once more: slopes are those of the state that was assembled last
                again = solve_step(self.system, result.state, newton)
                return replace(again, iterations=spent + again.iterations)
        return None

    def _write_down_both_sides(self, landing: NewtonResult) -> None:
        """Write down the last state before a limit point, and the first one past it.

        Else nobody could tell where between two load steps the force has jumped. Of the way back
        only what leads to the landing without a loss of energy is on its branch.
        """
        if self.system.sticks:
            return
        landed, here_mm = landing.state, self.state.displacement_mm
        arrived = self.logbook.loaded(landed, self._row(landing))
        way_mm = here_mm - (self.logbook.reached[-1] if self.logbook.reached else 0.0)
        if way_mm > self.rule.smallest_mm():
            self._write_down_near(self.state, [here_mm - share * way_mm for share in _BEFORE])
        places = [here_mm + share * (landed.displacement_mm - here_mm) for share in _BACK]
        self._write_down_near(landed, places, landed if self._lift() else None, arrived)

    def _write_down_near(
        self,
        state: State,
        places_mm: Sequence[float],
        lift: State | None = None,
        arrived: LoadedState | None = None,
    ) -> None:
        """Write down an equilibrium near a state, at the first of some places that has one."""
        for place_mm in places_mm:
            start = replace(state, displacement_mm=place_mm)
            found = solve_step(self.system, start, self.options.newton, lifted_from=lift)
            if self._write_down(found, state, arrived):
                return

    def _write_down(
        self, found: NewtonResult, neighbor: State, arrived: LoadedState | None = None
    ) -> bool:
        """Write down an equilibrium if it converged near its neighbor, and say whether it did.

        Not one that would have to jump to where the specimen ``arrived``.
        """
        J = self.system.volume_ratios(neighbor.x)
        if not (found.converged and _near(found, J)):
            return False
        row = self._row(found)
        loaded = self.logbook.loaded(found.state, row)
        if arrived is not None and self.logbook.lies_apart(loaded, arrived):
            return False
        self.logbook.add(found.state, found.equilibrium(), row, loaded, found.iterations)
        return True

    def _extrapolated(self, displacement: float) -> State | None:
        """Linear extrapolation of the last two states, where it keeps every J."""
        if self.previous is None:
            return None
        last, before = self.state, self.previous
        ratio = (displacement - last.displacement_mm) / (
            last.displacement_mm - before.displacement_mm
        )
        if ratio > _FARTHEST:
            return None
        x = last.x + ratio * (last.x - before.x)
        return self._sound(replace(last, displacement_mm=displacement, x=x), self.J, _EXTRAPOLATED)

    def _from_warm(self, target: float) -> NewtonResult | None:
        """Start from the same step of an earlier solve, moved along its sensitivities."""
        near = [d for d in self._warm_steps if abs(d - target) < 1e-9 * self.system.height_mm]
        if self.warm is None or self.system.sticks or not near:
            return None
        step = self._warm_steps[near[0]]
        x, multipliers = step.state.x.copy(), list(step.state.multipliers)
        for name, rate in step.constants.items():
            change = self.problem.material.constants[name] - self.warm.values[name]
            x += change * rate.x
            multipliers = [
                m + change * r for m, r in zip(multipliers, rate.multipliers, strict=True)
            ]
        touching = zip(self.system.contact, multipliers, strict=True)
        pressed = tuple(points.admissible(m) for points, m in touching)
        J = self.system.volume_ratios(step.state.x)
        guess = self._sound(State(target, x, pressed), J, _MOVED)
        if guess is None:
            return None
        quick = replace(self.options.newton, max_iterations=8, max_switching=8)
        result = solve_step(self.system, guess, quick)
        return result if result.converged and _near(result, J) else None

    def _sound(self, guess: State, J: Array, share: float) -> State | None:
        guess.x[self.system.constraints.dofs] = self.system.prescribed(guess.displacement_mm)
        return guess if (share * J < self.system.volume_ratios(guess.x)).all() else None

    def _adapt(self, iterations: int, step: float) -> None:
        depth = self.state.displacement_mm
        self.step_mm = self.rule.next_mm(self.step_mm, step, iterations, depth)

    def _accept(self, result: NewtonResult) -> None:
        assembly = result.equilibrium()
        self.previous, self.state, self.J = self.state, result.state, result.J
        self.min_j = assembly.min_j
        if self.system.sticks:
            rates = self._row(result).constants if self.wanted else {}
            along = {name: rate.x for name, rate in rates.items()}
            self.state = self.system.held(result.state, assembly, along)

    def _row(self, result: NewtonResult) -> StepGradients:
        """Force and derivatives of a converged state, computed once."""
        if self._latest is None or self._latest[0] is not result:
            assembly = result.equilibrium()
            row = step_gradients(self.system, result.state, assembly, wanted=self.wanted)
            self._latest = result, row
        return self._latest[1]

    def solution(self, seconds: float) -> Solution:
        """Return what was written down; ``seconds`` is the time that it took."""
        return self.logbook.solution(self.state, self.min_j, self._lost(), self._why(), seconds)

    def _why(self) -> str:
        """Why the run went no further: a limit point is no failure of the iteration."""
        steps = self.logbook.warm_steps
        if self.logbook.complete or self._lost() or not steps:
            return self.reason
        return gives_way(self.system, steps[0].state, self.state) or self.reason


def _near(result: NewtonResult, J: Array) -> bool:
    """Whether a state has still much of the ``J`` of the one that it was reached from."""
    return bool((_LEAPT * J < result.J).all())
