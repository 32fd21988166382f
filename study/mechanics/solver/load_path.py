"""One pass over the requested load steps: sub-steps, limit points, points where a curve bends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array
from study.mechanics.contact.contact import BESIDES, face_motions
from study.mechanics.element.function_space import at_level, deformation_gradient
from study.mechanics.material.stability import always_elliptic, ellipticity
from study.mechanics.setup.setup import Problem
from study.mechanics.solver.equilibrium import (
    Instability,
    is_unstable,
    least_stiffness,
    surplus,
    swaying,
)
from study.mechanics.solver.linear_solver import SingularMatrixError
from study.mechanics.solver.newton import (
    FALLS,
    NewtonResult,
    NewtonSettings,
    Options,
    sagged_state,
    solve_step,
)
from study.mechanics.solver.sensitivity import Loads, StepGradients, linear_rates, step_gradients
from study.mechanics.solver.solution import Logbook, Solution, Step
from study.mechanics.solver.system import Assembly, Drag, State, System

# -------------------------------------------------------------------------------------------------
# Past a limit point: the specimen creeps to the next equilibrium through something viscous.
#
# A surface that a sharp indenter stretches can lose its equilibrium at a load and find the next
# one some way off: it snaps. Full Newton steps then jump to and fro for ever. Here the motion is
# resisted by a drag in proportion to it, so that a state nearby balances (a backward Euler step of
# the gradient flow, or pseudo-transient continuation: Kelley and Keyes 1998, SIAM J. Numer. Anal.
# 35, 508). Step by step the drag falls, and the last step is one of plain Newton without it: the
# equilibrium that is found is one of the specimen alone.

#: steps in all, and plain solves that may fail before it is given up
_STEPS = 60
_TRIALS = 6

#: drag over the diagonal of the tangent: at first, where it hardly counts, and where it is hopeless
_FIRST = 0.05
_LITTLE = 1e-4
_MOST = 1e3

#: it falls after an easy step, grows after a hard one and more so after one that failed
_EASY = 6
_HARD = 10
_LESS = 0.25
_MORE = 1.5
_MUCH_MORE = 5.0

#: iterations of a step that leads to the next, also while contact changes
_ITERATIONS = 15
_SWITCHING = 25

#: motion over the size of an element below which a place is nearly one of equilibrium
_STILL = 1e-3

#: largest diagonal that counts, over the median: springs of the contact are no part of it
_OUTSTANDING = 3.0


def solve_through(
    system: System, guess: State, settings: NewtonSettings, *, lifted_from: State | None = None
) -> NewtonResult:
    """Equilibrium at ``guess.displacement_mm``, however far from the last one."""
    weights = _weights(system, lifted_from or guess)
    rough = replace(settings.passing(), max_iterations=_ITERATIONS, max_switching=_SWITCHING)
    (place, lift), spent = _lifted(system, guess, rough, lifted_from)
    drag, trials = _FIRST, 0
    for _ in range(_STEPS):
        dragged = replace(system, drag=Drag(drag * weights, place.x), latest=replace(system.latest))
        result = solve_step(dragged, place, rough, lifted_from=lift)
        spent += result.iterations
        if not result.converged:
            drag *= _MUCH_MORE
            if drag > _MOST:
                break
            continue
        moved = float(np.abs(result.state.x - place.x)[: system.space.n_displacement].max())
        place, lift = replace(result.state, closed=()), None
        still = drag <= _FIRST and moved < _STILL * system.mesh.contact_size_mm
        if drag < _LITTLE or still:
            result = solve_step(system, place, settings)
            spent, trials = spent + result.iterations, trials + 1
            if result.converged or trials == _TRIALS:
                return replace(result, iterations=spent)
            rough = replace(rough, tolerance=max(0.1 * rough.tolerance, settings.tolerance))
            drag = max(drag, _LITTLE)
        drag *= _LESS if result.iterations <= _EASY else _MORE if result.iterations > _HARD else 1.0
    return replace(result, converged=False, iterations=spent)


def _lifted(
    system: System, guess: State, settings: NewtonSettings, before: State | None
) -> tuple[tuple[State, State | None], int]:
    """Place to begin at, the state to lift it from where it has yet to be lifted, and iterations.

    A plate's motion spreads through the specimen as it is: drag would keep it near the plate.
    """
    if before is None:
        return (guess, None), 0
    once = replace(settings, max_iterations=1, max_switching=1)
    tried = solve_step(system, guess, once, lifted_from=before)
    there = tried.state.displacement_mm == guess.displacement_mm
    return (tried.state, None) if there else (guess, before), tried.iterations


def _weights(system: System, state: State) -> Array:
    """Diagonal of the tangent at the displacements, zero where nothing moves freely."""
    system.assemble(state)
    free = system.pattern.free
    moving = free < system.space.n_displacement
    diagonal = np.abs(system.data[system.pattern.indptr[:-1]])[moving]
    weights = np.zeros(system.space.n)
    weights[free[moving]] = np.minimum(diagonal, _OUTSTANDING * np.median(diagonal))
    return weights


#: share of the first stiffness below which a specimen gives way
_VANISHED_SHARE = 0.2


def gives_way(system: System, first: State, last: State) -> str:
    """Say that the smallest stiffness has nearly vanished at a state; empty where it has not."""
    before, after = _stiffness_at(system, first), _stiffness_at(system, last)
    if not after < _VANISHED_SHARE * before:
        return ""
    return (
        "no equilibrium is near: the specimen's smallest stiffness has fallen to "
        f"{100 * after / before:.2g} % (a limit point); see whether a finer mesh goes further, "
        "press less deep, or use another energy"
    )


def _stiffness_at(system: System, state: State) -> float:
    """Smallest stiffness of a state, N/mm; 0 where it has vanished."""
    system.assemble(state)
    try:
        system.factorize()
        return max(least_stiffness(system)[0], 0.0)
    except (SingularMatrixError, np.linalg.LinAlgError):
        return 0.0


#: points that are looked at: where an energy gives way it does so where it is stretched most
_LOOKED_AT = 500


def lost_ellipticity(system: System, state: State) -> str:
    """Say where the energy has lost its ellipticity at a state; empty where it has not.

    The place that is said is the one furthest beyond, among the points of quadrature that are
    stretched most.
    """
    if always_elliptic(system.material):
        return ""
    F = deformation_gradient(system.space, system.displacements(state.x))
    F = F.reshape(3, 3, -1)
    most = np.argsort(-np.einsum("ijq,ijq->q", F, F))[:_LOOKED_AT]
    found = np.linalg.svd(np.moveaxis(F[:, :, most], -1, 0), compute_uv=False)
    stretches: Array = np.array(found.T, dtype=np.float64)
    margin = ellipticity(system.material, stretches)
    if margin.min() > 0:
        return ""
    largest = " x ".join(f"{s:.3g}" for s in stretches[:, margin.argmin()])
    return f"with these constants the energy is no longer elliptic where it is stretched {largest}"


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
_LOAD_PATH_HALVINGS = 3

#: Times that steps are added to a curve whose interpolation is not as near as asked.
_ROUNDS = 8


#: what a load step starts from, so that it can be taken once more in halves: the state and the one
#: before, J, length and smallest J
_Place = tuple[State, State | None, Array, float, float]


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
        self._follows = self.warm is not None and options.same_points
        self.progress = progress or (lambda _: None)
        self.rest: State | None = system.start()  # None where the weight has no equilibrium
        if system.weight is not None:
            self.rest = sagged_state(system, options.newton)
            system = self.system = system if self.rest is None else system.sagged(self.rest)
        self.state, self.previous = self.rest or system.start(), None  # type: State, State | None
        self.J = system.volume_ratios(self.state.x)
        self.rule = problem.setup.step_rule(options.steps, system.mesh.height_mm)
        self.step_mm = self.rule.first_mm
        self.logbook = Logbook(system, problem, self.wanted, options.curve_error)
        self.min_j, self.reason = 1.0, ""
        self.instability: Instability | None = None
        self._known_to_stand, self._local_surplus = 0.0, 0
        self._reach_of: tuple[State, str] | None = None
        self._latest: tuple[NewtonResult, StepGradients] | None = None

    def to_the_end(self) -> LoadPath:
        """Go through the requested steps for as long as they converge."""
        if self.rest is None:
            self.reason = FALLS
            return self
        for target, asked in self._targets():
            if not self._advance(target, _LOAD_PATH_HALVINGS):
                break
            self.logbook.requested += asked
            self.progress(target / self.problem.test.depth_mm)
        if self.options.curve_error and not self._follows and not self.system.sticks:
            self._fill_in(self.options.curve_error)
        self._look_back()
        return self

    def _targets(self) -> list[tuple[float, bool]]:
        """Displacements, and whether they are requested; an earlier solve's may be among them.

        Curves of one problem then have the same points, and their difference is one of forces.
        """
        test = self.problem.test
        asked = [test.depth_mm * k / test.steps for k in range(1, test.steps + 1)]
        followed = (
            self._warm_steps if self._follows and self.options.curve_error is not None else ()
        )
        added = [d for d in followed if d < asked[-1]]
        near = 1e-9 * self.system.mesh.height_mm
        others = [d for d in added if min(abs(d - own) for own in asked) > near]
        return sorted([(d, True) for d in asked] + [(d, False) for d in others])

    def _advance(self, target: float, halvings: int) -> bool:
        """Reach a displacement and write it down, in halves where energy does not add up."""
        place, snaps = self._place(), len(self.logbook.snaps)
        result, spent = self._reach(target)
        if result is None:
            return False
        # made here, for other steps may be assembled before it is written down
        step = self._step(result, self.state, spent)
        unstable = self._gives_way()
        known = len(self.logbook.snaps) > snaps
        jumped = not known and self.logbook.jumped_to(step)
        if jumped and halvings and not self.system.sticks:
            there, middle = self._place(), 0.5 * (place[0].displacement_mm + target)
            self._return_to(place)
            if self._advance(middle, halvings - 1) and self._advance(target, halvings - 1):
                return True
            self._return_to(there)  # smaller steps found nothing
        if unstable:
            self._refuse(self.state, self.system)
            return False
        if jumped:
            self.logbook.snaps.append(self.logbook.reached[-1])
        self.logbook.add(step)
        return True

    def _gives_way(self) -> bool:
        """Whether the state just looked at is unstable, by its own factors if those at hand say so.

        Those at hand are of a late Newton iterate and cost nothing. Factors of an earlier step tell
        nothing of this one.
        """
        here_mm, count = self.state.displacement_mm, None
        if self.system.kept.factorized_at_mm == here_mm:
            count = surplus(self.system)
        if count is not None and count > self._local_surplus:
            if is_unstable(self.system, self.state):
                return True
            self._local_surplus = count  # the next one more may be of the body
        self._known_to_stand = self._known_to_stand if count is None else here_mm
        return False

    def _look_back(self) -> None:
        """Drop the steps from where the last one is unstable, or sways as no quarter can.

        The last step gets factors of its own where those at hand told nothing of it.
        """
        last = self.logbook.last
        if last is None or self.instability is not None:
            return
        if last.displacement_mm > self._known_to_stand and is_unstable(self.system, last):
            self._refuse(last, self.system)
            return
        found = swaying(self.system, self.problem)
        if found is not None and is_unstable(found[0], last):
            self._refuse(last, *found)

    def _refuse(
        self, unstable: State, system: System, sway: str = "", parity: tuple[int, ...] = (1, 1, 1)
    ) -> None:
        """Go back to the last stable step, by bisection, and say where stability was lost."""
        place_mm = unstable.displacement_mm
        steps = [step.state for step in self.logbook.steps]
        states = [s for s in steps if s.displacement_mm < place_mm] + [unstable]
        stable, first = -1, len(states) - 1
        if first and not is_unstable(system, states[first - 1]):  # as a rule
            stable = first - 1
        while first - stable > 1:
            middle = (stable + first) // 2
            bad = is_unstable(system, states[middle])
            stable, first = (stable, middle) if bad else (middle, first)
        before = (self.rest or self.system.start()) if stable < 0 else states[stable]
        is_unstable(system, before)
        k0 = least_stiffness(system)[0]
        is_unstable(system, states[first])
        k1, mode = least_stiffness(system)
        a, b = before.displacement_mm, states[first].displacement_mm
        share = k0 / (k0 - k1) if k1 < 0 < k0 else 1.0
        self.instability = Instability(a + share * (b - a), a, b, sway, mode, parity)
        self.logbook.drop_from(b)
        self.reason, self.state = self.instability.sentence, before
        self.J = self.system.volume_ratios(before.x)
        self.min_j = float(self.J.min())

    def _place(self) -> _Place:
        return self.state, self.previous, self.J, self.step_mm, self.min_j

    def _return_to(self, place: _Place) -> None:
        """Go back; what was found in between is no start for the steps to come."""
        self.state, self.previous, self.J, self.step_mm, self.min_j = place
        self.reason = ""
        # the way that led past the last step written down is given up, and its jumps with it
        last_mm = self.logbook.reached[-1] if self.logbook.reached else 0.0
        self.logbook.snaps = [at for at in self.logbook.snaps if at < last_mm]

    def _fill_in(self, error: float) -> None:
        """Add steps in the middle of intervals in which the curve bends.

        What is missed where no more can be added, or after the last round, is said in the message.
        """
        failed = set[float]()  # their intervals stay, and so would what was found there
        for _ in range(_ROUNDS):
            places = [mm for mm in self.logbook.coarse_intervals(error) if mm not in failed]
            added = [mm for mm in places if self._insert(mm)]
            failed.update(set(places).difference(added))
            if not added:
                return

    def _insert(self, displacement: float) -> bool:
        """Write down an equilibrium between two steps, where it lies on the way between them."""
        before, after = self.logbook.around(displacement)
        left = (self.rest or self.system.start()) if before is None else before
        end = self._place()
        result = self._halfway(left, after, displacement)
        if result is None:  # reached from there by load steps like any others
            self.state, self.previous, self.J = left, None, self.system.volume_ratios(left.x)
            self.step_mm = min(self.rule.first_mm, displacement - left.displacement_mm)
            result = self._reach(displacement)[0]
        is_added = False
        if result is not None:
            step = self._step(result, result.state, result.iterations)
            is_added = self.logbook.lies_between(step)
            if is_added:
                self.logbook.add(step)
        self._return_to(end)
        return is_added

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

    def may_do_better(self) -> bool:
        """Whether a run that stopped short is to be tried from the unloaded state.

        Where a surface is about to snap, the way that led there decides whether it is passed.
        """
        done = self.logbook.complete or self.instability is not None
        return not done and not self._lost()

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
                depth = self.state.displacement_mm
                self.step_mm = self.rule.next_mm(self.step_mm, step, result.iterations, depth)
                self._accept(result)
                continue
            self.step_mm = step / 2
            if self._too_short(self.step_mm):
                may_snap = self.options.snaps and not self._lost()
                through = self._through(target) if may_snap else None
                if through is None:
                    self.reason = result.reason
                    return None, spent
                result, spent = through, spent + through.iterations
                self._accept(result)
        return result, spent

    def _at(self, target: float) -> bool:
        return abs(self.state.displacement_mm - target) < 1e-9 * self.system.mesh.height_mm

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
        arrived = self._step(landing, landed, landing.iterations)
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
        arrived: Step | None = None,
    ) -> None:
        """Write down an equilibrium near a state, at the first of some places that has one.

        Not one that would have to jump to where the specimen ``arrived``.
        """
        for place_mm in places_mm:
            start = replace(state, displacement_mm=place_mm)
            found = solve_step(self.system, start, self.options.newton, lifted_from=lift)
            if not (found.converged and _near(found, self.system.volume_ratios(state.x))):
                continue
            step = self._step(found, found.state, found.iterations)
            if arrived is None or not self.logbook.lies_apart(step, arrived):
                self.logbook.add(step)
                return

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
        near = [d for d in self._warm_steps if abs(d - target) < 1e-9 * self.system.mesh.height_mm]
        if self.warm is None or self.system.sticks or not near:
            return None
        step = self._warm_steps[near[0]]
        x, multipliers = step.state.x.copy(), list(step.state.multipliers)
        for name, rate in step.gradients.constants.items():
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

    def _accept(self, result: NewtonResult) -> None:
        assembly = result.equilibrium()
        self.previous, self.state, self.J = self.state, result.state, result.J
        self.min_j = assembly.min_j
        if self.system.sticks:
            rates = self._gradients(result).constants if self.wanted else {}
            along = {name: rate.x for name, rate in rates.items()}
            self.state = self.system.held(result.state, assembly, along)

    def _step(self, result: NewtonResult, state: State, spent: int) -> Step:
        """Step of a converged result, whose state may be held by a bonded indenter meanwhile."""
        sense, row = self.problem.setup.kind.sense, self._gradients(result)
        return Step.of(self.system, state, result.equilibrium(), row, spent, sense)

    def _gradients(self, result: NewtonResult) -> StepGradients:
        """Force and derivatives of a converged state, computed once."""
        if self._latest is None or self._latest[0] is not result:
            assembly = result.equilibrium()
            row = step_gradients(self.system, result.state, assembly, wanted=self.wanted)
            self._latest = result, row
        return self._latest[1]

    def solution(self, seconds: float) -> Solution:
        """Return what was written down; ``seconds`` is the time that it took."""
        ended = self._lost(), self._why()
        return self.logbook.solution(self.state, self.min_j, *ended, seconds, self.instability)

    def _why(self) -> str:
        """Why the run went no further: a limit point is no failure of the iteration."""
        steps = self.logbook.steps
        if self.logbook.complete or self.instability or self._lost() or not steps:
            return self.reason
        return gives_way(self.system, steps[0].state, self.state) or self.reason


def _near(result: NewtonResult, J: Array) -> bool:
    """Whether a state has still much of the ``J`` of the one that it was reached from."""
    return bool((_LEAPT * J < result.J).all())


# -------------------------------------------------------------------------------------------------
# Equilibria under any motion of a plate, and how they move with it.
#
# A load path brings a specimen to one motion. Equilibria at others are reached from there along
# the derivatives by the motion, which one factorization gives for all of its components: of an
# elastic body the way does not matter.

#: components of a motion: towards the specimen, x and y (mm), three rotations (rad), spread
COMPONENTS = 1 + BESIDES

#: residual of the derivatives over the forces that they balance
_PRESCRIBED_MOTION_TOLERANCE = 1e-6

#: halvings of a change of motion that is too large for one step
_PRESCRIBED_MOTION_HALVINGS = 5


@dataclass(frozen=True)
class MovedPlate:
    """Equilibrium at a motion of the plate."""

    #: shape (7,); down, x and y in mm, rotations about x, y and the axis in rad, spread.
    motion: Array
    state: State
    #: shape (n_nodes, 3); of the nodes, mm.
    displacement: Array
    #: shape (n_nodes, 3, 7); derivatives of the displacements by the motion.
    rates: Array


class NoEquilibrium(Exception):
    """No equilibrium was found at a motion of the plate."""


class PrescribedMotion:
    """A solved plate motion that can be taken elsewhere."""

    def __init__(self, problem: Problem, solution: Solution) -> None:
        if solution.warm is None or not solution.converged:
            raise NoEquilibrium(solution.message)
        self.system = solution.warm.system
        self._modes = _modes(self.system)
        self._settings = NewtonSettings()
        state, besides = solution.warm.steps[-1].state, problem.test.motion
        others = np.zeros(BESIDES) if besides is None else besides.components()
        motion = np.concatenate([[problem.test.depth_mm], others])
        self.start = self._described(self._under(motion), motion, state)

    def at(self, motion: Array, near: MovedPlate) -> MovedPlate:
        """Equilibrium at another motion.

        Shapes: motion (7,).
        """
        if not motion[0] > 0:
            raise NoEquilibrium(f"the plate would move by {motion[0]:.3g} mm, off the specimen")
        return self._reached(motion, near, _PRESCRIBED_MOTION_HALVINGS)

    def _reached(self, motion: Array, near: MovedPlate, halvings: int) -> MovedPlate:
        system = self._under(motion)
        guess = near.state.x.copy()
        moved = near.displacement + near.rates @ (motion - near.motion)
        guess[: system.space.n_displacement] = moved.ravel()
        guess[system.constraints.dofs] = system.prescribed(float(motion[0]))
        start = replace(near.state, displacement_mm=float(motion[0]), x=guess)
        if (system.volume_ratios(guess) > 0).all():
            found = solve_step(system, start, self._settings)
            if found.converged:
                return self._described(system, motion, found.state)
        if not halvings:
            raise NoEquilibrium("no equilibrium was found at the plate motion that fits")
        middle = self._reached(0.5 * (motion + near.motion), near, halvings - 1)
        return self._reached(motion, middle, halvings - 1)

    def _under(self, motion: Array) -> System:
        """Return the same equations under another motion; solver and arrays are shared."""
        rate = self._modes @ motion / motion[0]
        constraints = replace(self.system.constraints, rate=rate)
        return replace(self.system, constraints=constraints, latest=replace(self.system.latest))

    def _described(self, system: System, motion: Array, state: State) -> MovedPlate:
        rates = self._rates(system, state, system.assemble(state))
        shape = (*system.space.nodes.shape, COMPONENTS)
        return MovedPlate(
            motion=motion.copy(),
            state=state,
            displacement=system.displacements(state.x).copy(),
            rates=rates[: system.space.n_displacement].reshape(shape),
        )

    def _rates(self, system: System, state: State, assembly: Assembly) -> Array:
        """Differentiate all unknowns by the motion, shape (n, 7)."""
        start = np.zeros((system.space.n, COMPONENTS))
        start[system.constraints.dofs] = self._modes
        targets = []
        for points, touch in zip(system.contact, assembly.contact, strict=True):
            target = np.zeros((points.size, COMPONENTS))  # sideways motion opens no plane contact
            target[:, 0] = -touch.normal()[:, -1] * points.surface.speed
            targets.append(target)
        loads = Loads(np.zeros_like(start), start, tuple(targets))
        rates = linear_rates(system, assembly, loads, _PRESCRIBED_MOTION_TOLERANCE)
        if rates.excess > 1:
            raise NoEquilibrium("the derivatives by the plate motion did not converge")
        return rates.x


def _modes(system: System) -> Array:
    """Values of the constrained unknowns for a unit of every component, shape (n_held, 7)."""
    dim, dofs = system.space.dim, system.constraints.dofs
    top = at_level(system.space, system.mesh, system.mesh.height_mm)
    values = np.zeros((system.space.n, COMPONENTS))
    moved = (top[:, None] * dim + np.arange(dim)).ravel()
    if np.setdiff1d(moved, dofs).size:
        raise NoEquilibrium("the plate above must hold the face that it moves")
    down = np.zeros((top.size, dim, 1))
    down[:, -1] = -1.0
    every = np.concatenate([down, face_motions(system.space, top)], axis=2)
    values[moved] = every.reshape(-1, COMPONENTS)
    return values[dofs]
