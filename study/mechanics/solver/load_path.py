"""One run over the requested load steps: sub-steps, limit points, points where a curve bends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from study.ground.arrays import Array, Flags, Ints
from study.ground.curve import Curve
from study.mechanics.element.function_space import deformation_gradient
from study.mechanics.material.stability import always_elliptic, ellipticity
from study.mechanics.setup.geometry import Enclosed
from study.mechanics.setup.setup import Problem
from study.mechanics.setup.test_kind import (
    NEVER_BUCKLES,
    buckling_strain,
    unresolved_contact,
)
from study.mechanics.solver.equilibrium import (
    Equilibria,
    Instability,
    RandomLoad,
    are_factors_of_step,
    contact_figures,
    has_inertia_of_factors,
    is_unstable,
    least_stiffness,
    nodal_reactions,
    resultants,
    surplus,
    swaying,
)
from study.mechanics.solver.internal_force import StoredEnergy
from study.mechanics.solver.linear_solver import SingularMatrixError
from study.mechanics.solver.newton import (
    FALLS,
    NewtonResult,
    NewtonSettings,
    Options,
    sagged_state,
    solve_step,
    solve_through,
)
from study.mechanics.solver.sensitivity import StepGradients, step_gradients
from study.mechanics.solver.solution import (
    JUMP_SHARE,
    STICKING_JUMP_SHARE,
    EnergyBalance,
    Solution,
    Step,
    Warm,
    balanced,
    jumped,
)
from study.mechanics.solver.system import State, System
from study.mechanics.surface.closed_surface import body

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
    singular_values = np.linalg.svd(np.moveaxis(F[:, :, most], -1, 0), compute_uv=False)
    stretches: Array = np.array(singular_values.T, dtype=np.float64)
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


#: what a user can do about an energy that is stretched too far
_OUT_OF_REACH = "no finer mesh goes further; press less deep, or use another energy"

#: part of the displacement up to which the specimen's surface may lie inside the moving one unsaid:
#: where a facet bridges the edge of a punch, the force is that of a blunter one
_INSIDE = 0.1
#: the same from which a step is no answer: nodes have slipped past the contact points. Rounded
#: punches pressed in by 40 to 60 % of the height had forces from 1.35 to 4.4 N by mesh there
_THROUGH = 0.2

#: volume ratio within elements, root mean square, above which a mesh does not resolve the
#: deformation: linear simplices with .08 to .15 were 2 to 18 % too stiff, fine meshes have .05 at
#: most (bonded discs of two energies at 20 to 50 %)
_UNEVEN = 0.08

#: energy of uneven volumes over that stored above which an indenter meets elements that lock:
#: .07 to .15 where linear tetrahedra in layers of 1.7 to 2.6 elements were 24 to 210 % too stiff,
#: at most .06 where coarse linear elements were up to 15 % off, .023 in quadratic ones
_LOCKED = 0.06

#: the same in a specimen of fewer linear elements over its height, pressed by a large sphere: with
#: .025 to .048 forces were 5 to 15 % too high (nu .45 to .4995), below .018 up to 8 %
_LOCKED_FEW = 0.02
_FEW = 3.0

#: share of the energy lost in snaps above which it is no event of the surface alone
_MUCH_LOST = 0.05

#: rounding of the nodal forces over the force above which it is said, and no jump is looked for
_ROUNDED = 1e-3

#: force of a pin over that of the test above which a specimen is not balanced
_UNBALANCED = 1e-3


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
        self._whole_mm = problem.test.depth_mm
        #: share of the stored energy above which something has jumped
        self._share = STICKING_JUMP_SHARE if system.sticks else JUMP_SHARE
        self.gradients_of = problem.material.names if gradients else ()
        self.warm = warm.warm if warm is not None else None
        steps = () if self.warm is None else self.warm.steps
        self._warm_steps = {step.state.displacement_mm: step for step in steps}
        self._follows = self.warm is not None and options.same_points
        self.progress = progress or (lambda _: None)
        self.rest: State | None = system.start()  # None where the weight has no equilibrium
        if (weight := system.weight) is not None:
            self.rest = sagged_state(system, weight, options.newton)
            if self.rest is not None:  # the work of the test is counted from there
                lying = replace(weight, energy_at_rest=system.stored_energy(self.rest).total)
                system = self.system = replace(system, weight=lying)
        self.state, self.previous = self.rest or system.start(), None  # type: State, State | None
        self.J = system.volume_ratios(self.state.x)
        kind, height_mm = problem.setup.kind, system.mesh.height_mm
        self.rule = kind.steps(problem.test, height_mm, options.steps)
        self.step_mm = self.rule.first_mm
        self.steps: list[Step] = []
        #: displacements at which the surface snapped to another equilibrium, mm
        self.snaps: list[float] = []
        self.min_j, self.reason = 1.0, ""
        #: where snaps have lost much of the energy; empty where they have not
        self.collapse = ""
        self.instability: Instability | None = None
        self._known_to_stand, self._local_surplus = 0.0, 0
        self._reach_of: tuple[State, str] | None = None
        self._latest: tuple[NewtonResult, StepGradients] | None = None
        self._random_load: RandomLoad | None = None
        #: whether nodes of the last step lie far inside the moving surface
        self._is_through = False

    def to_the_end(self) -> LoadPath:
        """Go through the requested steps for as long as they converge."""
        if self.rest is None:
            self.reason = FALLS
            return self
        for target in self._targets():
            if not self._advance(target, _LOAD_PATH_HALVINGS):
                break
            self.progress(target / self._whole_mm)
        self._end_at_a_collapse()
        error, fills = self.options.curve_error, not (self._follows or self.system.sticks)
        if error and fills and self._complete:
            self._fill_in(error)
        self._look_back()
        return self

    def _targets(self) -> list[float]:
        """List the requested displacements; those of an earlier solve may be among them.

        Curves of one problem then have the same points, and their difference is one of forces.
        """
        test = self.problem.test
        steps = [test.depth_mm * k / test.steps for k in range(1, test.steps + 1)]
        is_refined = self.options.curve_error is not None
        followed = self._warm_steps if self._follows and is_refined else ()
        near = 1e-9 * self.system.mesh.height_mm
        apart = (d for d in followed if min(abs(d - depth) for depth in steps) > near)
        return sorted([*steps, *(d for d in apart if d < steps[-1])])

    def _advance(self, target: float, halvings: int) -> bool:
        """Reach a displacement and write it down, in halves where energy does not add up."""
        start, snaps = self._place(), len(self.snaps)
        result, spent = self._reach(target)
        if result is None:
            return False
        # made here, for other steps may be assembled before it is written down
        step = self._step(result, self.state, spent)
        inside_mm = step.held[2].penetration_mm
        self._is_through = inside_mm > _THROUGH * self._whole_mm
        if self._is_through:
            self.reason = (
                f"at {target:.4g} mm the specimen's surface lies {inside_mm:.2g} mm inside the "
                "moving one, past its contact points: use a smaller mesh_size, or press less deep"
            )
            return False
        unstable = self._gives_way(step)
        snapped = len(self.snaps) > snaps
        jumped = not snapped and self._jumped_to(step)
        if jumped and halvings and not self.system.sticks:
            there, middle = self._place(), 0.5 * (start[0].displacement_mm + target)
            self._return_to(start)
            if self._advance(middle, halvings - 1) and self._advance(target, halvings - 1):
                return True
            self._return_to(there)  # smaller steps found nothing
            self._is_through = False
        if unstable:
            self._refuse(self.state, self.system)
            return False
        if jumped:
            self.snaps.append(self._reached[-1])
        self._add(step)
        return True

    def _gives_way(self, step: Step) -> bool:
        """Whether the state just differentiated is unstable, by the factors at hand.

        They cost nothing, and may be of an earlier state: where the corrections of the derivatives
        converge, no motion that the load excites has become unstable in between. Where they say
        that it is unstable, it is factorized by itself. That the last one stands is known where
        corrections of a load that excites every motion converge as well.
        """
        count = surplus(self.system) if step.gradients.excess <= 1 else None
        if count is None:
            return False
        if count > self._local_surplus:
            if is_unstable(self.system, self.state):
                return True
            count = surplus(self.system) or 0  # of a few elements: one more may be of the body
        self._local_surplus = count
        is_near = are_factors_of_step(self.system, self.state, self._step_before())
        is_last = self._at(self._whole_mm)
        if is_near or (is_last and has_inertia_of_factors(self.system, self._random_load)):
            self._known_to_stand = self.state.displacement_mm
        return False

    def _step_before(self) -> State:
        """Last state that was written down."""
        return self.steps[-1].state if self.steps else self.rest or self.system.start()

    def _end_at_a_collapse(self) -> None:
        """Drop the steps from where snaps of a body between plates have lost much of its energy.

        Under an indenter the points of a coarse mesh that meet it at once lose as much.
        """
        if not self.snaps or len(self.steps) < 2 or self._lift() is None:
            return
        mismatch, reached = self._balance()[0].mismatch, np.array(self._reached)
        lost = np.diff(mismatch)
        snaps = np.searchsorted(np.sort(self.snaps), reached)
        lost_share = np.abs(np.cumsum(np.where(np.diff(snaps) > 0, lost, 0.0)))
        if not (beyond := np.flatnonzero(lost_share > _MUCH_LOST)).size:
            return
        first = int(beyond[0]) + 1
        snap_mm = max(mm for mm in self.snaps if mm < reached[first])
        self.collapse = (
            f"past {snap_mm:.3g} mm the specimen snapped to another equilibrium, and "
            f"{100 * lost_share[beyond[0]]:.2g} % of the energy was lost: the elements may have "
            "given way, so try a smaller mesh_size, or press less deep"
        )
        del self.steps[first:]
        self.snaps = [mm for mm in self.snaps if mm < reached[first - 1]]
        self._end_at(self.steps[-1].state, self.collapse)

    def _end_at(self, state: State, reason: str) -> None:
        """Take a state for the last one, and say why."""
        self.state, self.reason, self.J = state, reason, self.system.volume_ratios(state.x)
        self.min_j = float(self.J.min())

    def _look_back(self) -> None:
        """Drop the steps from where the last one is unstable, or sways as no quarter can.

        The last step gets factors of its own where those at hand told nothing of it.
        """
        if not self.steps or self.instability is not None:
            return
        last = self.steps[-1].state
        if last.displacement_mm > self._known_to_stand and is_unstable(self.system, last):
            self._refuse(last, self.system)
            return
        mode = swaying(self.system, self.problem)
        if mode is not None and is_unstable(mode[0], last):
            self._refuse(last, *mode)

    def _refuse(
        self,
        unstable: State,
        system: System,
        sway: str | None = None,
        parity: tuple[int, ...] = (1, 1, 1),
    ) -> None:
        """Go back to the last stable step, by bisection, and say where stability was lost."""
        place_mm = unstable.displacement_mm
        steps = [step.state for step in self.steps]
        states = [s for s in steps if s.displacement_mm < place_mm] + [unstable]
        stable, first = -1, len(states) - 1
        if first and not is_unstable(system, states[first - 1]):  # as a rule
            stable = first - 1
        while first - stable > 1:
            middle = (stable + first) // 2
            bad = is_unstable(system, states[middle])
            stable, first = (stable, middle) if bad else (middle, first)
        before = (self.rest or self.system.start()) if stable < 0 else states[stable]
        sags = is_unstable(system, before) and self.system.weight is not None
        k0 = least_stiffness(system)[0]
        is_unstable(system, states[first])
        k1, mode = least_stiffness(system)
        a, b = before.displacement_mm, states[first].displacement_mm
        if sags:  # it does not stand when the test begins
            b = a
        share = k0 / (k0 - k1) if k1 < 0 < k0 else 1.0
        self.instability = Instability(a + share * (b - a), a, b, sway, mode, parity)
        del self.steps[int(np.searchsorted(self._reached, b * (1 - 1e-12))) :]
        self.snaps = [snap_mm for snap_mm in self.snaps if snap_mm < b]
        self._end_at(before, self.instability.sentence)

    def _place(self) -> _Place:
        return self.state, self.previous, self.J, self.step_mm, self.min_j

    def _return_to(self, start: _Place) -> None:
        """Go back; what was found in between is no start for the steps to come."""
        self.state, self.previous, self.J, self.step_mm, self.min_j = start
        self.reason = ""
        # the way that led past the last step written down is given up, and its jumps with it
        last_mm = self._reached[-1] if self._reached else 0.0
        self.snaps = [at for at in self.snaps if at < last_mm]

    def _fill_in(self, error: float) -> None:
        """Add steps in the middle of intervals in which the curve bends.

        What is missed where no more can be added, or after the last round, is said in the message.
        """
        failed = set[float]()  # intervals that took no step: another try would fail again
        for _ in range(_ROUNDS):
            coarse = self._curve(self._balance()[1]).coarse_intervals(error)
            places = [mm for mm in coarse if mm not in failed]
            added = [mm for mm in places if self._insert(mm)]
            failed.update(set(places).difference(added))
            if not added:
                return

    def _insert(self, displacement: float) -> bool:
        """Write down an equilibrium between two steps, where it lies on the way between them."""
        at = int(np.searchsorted(self._reached, displacement))
        left = self.steps[at - 1].state if at else self.rest or self.system.start()
        after, end = self.steps[at].state, self._place()
        result = self._halfway(left, after, displacement)
        if result is None:  # reached from there by load steps like any others
            self.state, self.previous, self.J = left, None, self.system.volume_ratios(left.x)
            self.step_mm = min(self.rule.first_mm, displacement - left.displacement_mm)
            result = self._reach(displacement)[0]
        is_added = False
        if result is not None:
            step = self._step(result, result.state, result.iterations)
            is_added = self._lies_between(step)
            if is_added:
                self._add(step)
        self._return_to(end)
        return is_added

    def _halfway(self, left: State, right: State, displacement: float) -> NewtonResult | None:
        """Equilibrium near the mean of two states; None where there is none nearby."""
        J = self.system.volume_ratios(left.x)
        pairs = zip(left.multipliers, right.multipliers, strict=True)
        multipliers = [0.5 * (m + n) for m, n in pairs]
        sides = (self.system.held_against_wish(state) for state in (left, right))
        held = tuple(a & b for a, b in zip(*sides, strict=True))
        mean = State(displacement, 0.5 * (left.x + right.x), tuple(multipliers))
        return self._moved_to(mean, held, J)

    def _moved_to(self, guess: State, held: tuple[Flags, ...], J: Array) -> NewtonResult | None:
        """Equilibrium near a guess made of others, whose ``J`` it nearly has.

        Points that those held closed although they pull stay held: released, they change sides to
        and fro once more. None where there is none in a few iterations: load steps cost less.
        """
        each = zip(self.system.contact, guess.multipliers, held, strict=True)
        pressed = tuple(np.where(pull, m, points.admissible(m)) for points, m, pull in each)
        start = self._sound(replace(guess, multipliers=pressed), J, _MOVED)
        if start is None:
            return None
        quick = replace(self.options.newton, max_iterations=8, max_switching=8)
        result = solve_step(self.system, start, quick, held=held)
        return result if result.converged and _near(result, J) else None

    def may_do_better(self) -> bool:
        """Whether a run that stopped short is to be tried from the unloaded state.

        Where a surface is about to snap, the way that led there decides whether it is passed.
        """
        done = self._complete or self.instability is not None or bool(self.collapse)
        return not done and not self._lost()

    def _reach(self, target: float) -> tuple[NewtonResult | None, int]:
        """Equilibrium at a displacement, in sub-steps where needed, and the iterations spent."""
        spent, result = 0, self._from_warm(target)
        if result is not None:
            spent += result.iterations
            self._accept(result)
        elif self._follows and not self.options.snaps and self._lost():
            return None, spent  # a fit that hears so soon asks nearer, which costs less than a path
        while result is None or not self._at(target):
            remaining = target - self.state.displacement_mm
            pieces = max(1, int(np.ceil(remaining / self.step_mm - 1e-9)))
            step, newton = remaining / pieces, self.options.newton
            # what sticks remembers every state, and a difference of two curves every digit of it
            is_compared = bool(self.gradients_of) or self.warm is not None
            if pieces > 1 and not (self.system.sticks and is_compared):
                newton = newton.passing(remembered=self.system.sticks)
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
                if lift is not None or any(p.any() for p in self.state.multipliers):
                    self._write_down_both_sides(result)
                    self.snaps.append(here)  # at first touch nothing is stored that it could lose
                self.step_mm, self.previous = 0.5 * step, None
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
        way_mm = here_mm - (self._reached[-1] if self._reached else 0.0)
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
            lifted = solve_step(self.system, start, self.options.newton, lifted_from=lift)
            if not (lifted.converged and _near(lifted, self.system.volume_ratios(state.x))):
                continue
            step = self._step(lifted, lifted.state, lifted.iterations)
            if arrived is None or not self._lies_apart(step, arrived):
                self._add(step)
                return

    def _extrapolated(self, displacement: float) -> State | None:
        """Linear extrapolation of the last two states, where it keeps every J."""
        if self.previous is None:
            return None
        last, before = self.state, self.previous
        here_mm = last.displacement_mm
        ratio = (displacement - here_mm) / (here_mm - before.displacement_mm)
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
        now, then = self.problem.material.constants, self.warm.system.material.constants
        for name, rate in step.gradients.constants.items():
            change, pairs = now[name] - then[name], zip(multipliers, rate.multipliers, strict=True)
            x += change * rate.x
            multipliers = [m + change * r for m, r in pairs]
        held = self.system.held_against_wish(step.state)
        J = self.system.volume_ratios(step.state.x)
        return self._moved_to(State(target, x, tuple(multipliers)), held, J)

    def _sound(self, guess: State, J: Array, share: float) -> State | None:
        guess.x[self.system.constraints.dofs] = self.system.prescribed(guess.displacement_mm)
        return guess if (share * J < self.system.volume_ratios(guess.x)).all() else None

    def _accept(self, result: NewtonResult) -> None:
        assembly = result.equilibrium()
        self.previous, self.state, self.J = self.state, result.state, result.J
        self.min_j = assembly.min_j
        if self.system.sticks:
            rates = self._gradients(result).constants if self.gradients_of else {}
            along = {name: rate.x for name, rate in rates.items()}
            self.state = self.system.held(result.state, assembly, along)

    def _step(self, result: NewtonResult, state: State, spent: int) -> Step:
        """Step of a converged result, whose state may be held by a bonded indenter meanwhile."""
        system, assembly, row = self.system, result.equilibrium(), self._gradients(result)
        stored = (system.force_scale * part for part in system.stored_energy(state))
        forces = nodal_reactions(system, assembly)
        figures = contact_figures(system, state, assembly, forces[0])
        held = resultants(system, state, forces, self.problem.setup.kind.sense)
        pins = np.abs(assembly.residual[system.constraints.pins])
        pinned = float(pins.max()) / abs(row.force_N) if pins.size and row.force_N else 0.0
        return Step(state, row, StoredEnergy(*stored), (*held, figures), pinned, spent)

    def _gradients(self, result: NewtonResult) -> StepGradients:
        """Force and derivatives of a converged state, computed once."""
        if self._latest is None or self._latest[0] is not result:
            assembly, system = result.equilibrium(), self.system
            self._random_load = None
            is_last = result.state.displacement_mm == self._whole_mm
            if is_last and not are_factors_of_step(system, result.state, self._step_before()):
                self._random_load = RandomLoad.on(system)
            row = step_gradients(
                system,
                result.state,
                assembly,
                parameters=self.gradients_of,
                random_load=self._random_load,
            )
            self._latest = result, row
        return self._latest[1]

    def _why(self) -> str:
        """Why the run went no further: a limit point is no failure of the iteration."""
        steps = self.steps
        is_explained = self.instability or self.collapse or self._is_through or self._lost()
        if self._complete or is_explained or not steps:
            return self.reason
        return gives_way(self.system, steps[0].state, self.state) or self.reason

    @property
    def _reached(self) -> list[float]:
        """Displacements of the steps, mm."""
        return [step.state.displacement_mm for step in self.steps]

    @property
    def _asked(self) -> Flags:
        """Steps that were requested: others were added where energy is missing or a curve bends."""
        places = np.array(self._reached) * self.problem.test.steps / self._whole_mm
        return np.asarray(np.abs(places - np.round(places)) < 1e-6)

    @property
    def _complete(self) -> bool:
        """Whether every requested step is there."""
        return int(np.count_nonzero(self._asked)) == self.problem.test.steps

    def _add(self, step: Step) -> None:
        """Write down a step that converged, in the order of displacements."""
        self.steps.insert(int(np.searchsorted(self._reached, step.state.displacement_mm)), step)

    def _lies_apart(self, before: Step, after: Step) -> bool:
        """Whether energy is missing, or too much, between two states."""
        return jumped(before, after, self._whole_mm, self._share)

    def _jumped_to(self, step: Step) -> bool:
        """Whether energy is missing, or too much, since the last step written down.

        Within the first requested step nothing is looked at: contact begins point by point there,
        and the slope at first touch is not known.
        """
        first_mm = self._whole_mm / self.problem.test.steps
        begins = not self.steps or self._reached[-1] < (1 - 1e-9) * first_mm
        if begins or self._rounded(step) > _ROUNDED:
            return False
        return self._lies_apart(self.steps[-1], step)

    def _rounded(self, step: Step) -> float:
        """Return the rounding of the nodal forces over the force of a step."""
        rounding_N = self.system.rounding_N * self.system.force_scale  # noqa: N806
        force_N = abs(step.gradients.force_N)  # noqa: N806
        return rounding_N / force_N if force_N else 0.0

    def _lies_between(self, step: Step) -> bool:
        """Whether a state is on the way between its neighbors.

        Of another branch energy is missing on the way there, and too much on the way back. Before
        the first state nothing is known that it could be held against.
        """
        at = int(np.searchsorted(self._reached, step.state.displacement_mm))
        there = at > 0 and self._lies_apart(self.steps[at - 1], step)
        return not (there and self._lies_apart(step, self.steps[at]))

    def _equilibria(self, steps: Ints) -> Equilibria:
        """Reactions and contact of some steps, given by their places."""
        plate, base, contact = (tuple(self.steps[n].held[k] for n in steps) for k in range(3))
        return Equilibria(plate, base, contact, self.instability)

    def _balance(self) -> tuple[EnergyBalance, Array]:
        """Energy balance of the steps, and the work done up to each, shape (n,), N mm."""
        return balanced(self.steps, tuple(self.snaps))

    def _curve(self, work_Nmm: Array) -> Curve:
        """Force-displacement curve with its gradients."""
        rows = [step.gradients for step in self.steps]
        return Curve(
            np.array(self._reached),
            np.array([row.force_N for row in rows]),
            np.array([row.stiffness_N_per_mm for row in rows]),
            {n: np.array([row.force_gradient[n] for row in rows]) for n in self.gradients_of},
            work_Nmm,
            is_conjugate=self.system.constraints.axial is None,
            quantities=self._equilibria(np.arange(len(rows))).quantities(),
        )

    def solution(self, seconds: float) -> Solution:
        """Return what was written down; ``seconds`` is the time that it took."""
        system, state, lost = self.system, self.state, self._lost()
        # the steps that were requested, or all, with the iterations of those left out before them
        steps = np.flatnonzero(self._asked | (self.options.curve_error is not None))
        total = np.cumsum([0, *(step.iterations for step in self.steps)])[np.r_[0, steps + 1]]
        balance, work = self._balance()
        curve = self._curve(work)
        gave_way = bool(lost or self.collapse) or self.instability is not None
        status = "converged" if self._complete else "unstable" if gave_way else "not-converged"
        if self._complete and self._apart():
            status = "lost-contact"
        return Solution(
            status=status,
            message=self._message(lost, curve),
            curve=curve.at_points(steps),
            energy=balance.at_points(steps),
            reached_mm=state.displacement_mm,
            min_j=self.min_j,
            equilibria=self._equilibria(steps),
            newton_iterations=tuple(int(n) for n in np.diff(total)),
            dofs=system.dofs,
            elements=system.space.n_elements,
            mesh_hash=system.mesh.digest(),
            mesh_size_mm=system.mesh.size_mm,
            solver=system.solver.name,
            seconds={**system.seconds, "total": seconds},
            points=system.mesh.points,
            cells=system.mesh.cells,
            displacement=system.displacements(state.x)[: len(system.mesh.points)],
            warm=Warm(system, tuple(self.steps[k] for k in steps)),
        )

    def _message(self, lost: str, curve: Curve) -> str:
        """Say how the run ended, and what was mended or is not as it should be."""
        sentences = ["every step converged"]
        if self.snaps:
            places = ", ".join(f"{d:.3g}" for d in sorted(self.snaps))
            sentences.append(f"past {places} mm the surface snapped to another equilibrium")
            lost_share = self._balance()[0].largest_mismatch
            if lost_share > _MUCH_LOST:
                sentences.append(
                    f"{100 * lost_share:.2g} % of the energy was lost: it may be the elements that "
                    "gave way, so compare the force with that of a smaller mesh_size"
                )
        pinned = max((step.pinned for step in self.steps), default=0.0)
        if pinned > _UNBALANCED:
            sentences.append(
                "what only keeps the specimen from sliding or turning carries up to "
                f"{100 * pinned:.2g} % of the force: it is not balanced as it stands"
            )
        if not self._complete:
            reached, why = self.state.displacement_mm, self.collapse or lost or self._why()
            sentences = [f"stopped at {reached:.4g} mm of {self._whole_mm:.4g} mm: {why}"]
            if lost and not self.collapse:
                sentences.append(_OUT_OF_REACH)
        elif apart := self._apart():
            sentences = [apart]
        elif lost:
            sentences.append(f"{lost}: there the answer depends on the mesh")
        inside = max((step.held[2].penetration_mm for step in self.steps), default=0.0)
        if inside > _INSIDE * self._whole_mm and not self._is_through:
            sentences.append(
                f"the specimen's surface lies up to {inside:.2g} mm inside the moving one, "
                f"{100 * inside / self._whole_mm:.2g} % of the displacement: use a smaller "
                "mesh_size, or press less deep"
            )
        sentences += [*self._too_coarse(), *self._cannot_sway(), *self._not_converged(curve)]
        if isinstance(self.problem.specimen, Enclosed):
            sentences += body(self.problem.specimen).notes
        return "; ".join(sentences)

    def _too_coarse(self) -> Iterator[str]:
        """Say that the elements are too large for the deformation, or for what is touched."""
        model, internal, material = self.problem.model, self.system.internal, self.system.material
        uneven, _ = internal.uneven_volume(material, self.state.x)
        other = "" if model.element_order == "quadratic" else ", or quadratic elements"
        locked, at_mm = self._locked()
        elements = self.system.mesh.height_mm / self.system.mesh.contact_size_mm
        few = model.element_order == "linear" and elements < _FEW
        if uneven > _UNEVEN:
            yield (
                f"volumes within the elements are off by {100 * uneven:.2g} % (root mean square): "
                "the mesh is too coarse for this deformation, and the force too high by a few "
                f"percent or more; use a smaller mesh_size{other}"
            )
        elif locked > (_LOCKED_FEW if few else _LOCKED):
            much = "a tenth or far more" if locked > _LOCKED else "5 to 15 %"
            yield (
                f"uneven volumes within the elements stand for {100 * locked:.2g} % of the energy "
                f"at {at_mm:.3g} mm: the mesh is too coarse for what is pressed in, and the force "
                f"too high by {much}; use a smaller mesh_size{other}"
            )
        if contact := unresolved_contact(self.problem.test, model.mesh_size_mm):
            yield contact

    def _locked(self) -> tuple[float, float]:
        """Largest share of the energy in uneven volumes under an indenter, and where that is.

        Of the second half of the way: a first contact is one of a few points. Further on, a force
        that is far too high makes the share small again.
        """
        system, shares = self.system, [(0.0, 0.0)]
        for step in self.steps if self.problem.setup.kind.strains_locally else []:
            energy, place_mm = step.stored.material, step.state.displacement_mm
            if energy > 0 and place_mm >= 0.5 * self._whole_mm:
                _, uneven = system.internal.uneven_volume(system.material, step.state.x)
                shares.append((system.force_scale * uneven / energy, place_mm))
        return max(shares)

    def _apart(self) -> str:
        """Say where what moves has lost the specimen, or never met it; empty where it has not.

        A specimen that has yet to be reached is no loss, nor is a bonded plate that pulls.
        """
        slides = self.problem.test.interface == "frictionless"
        held = [step.held for step in self.steps]
        pulls = np.array([slides and above.axial < 0 for above, _, _ in held], dtype=bool)
        off = pulls | (np.array([figures.area_mm2 for _, _, figures in held]) == 0)
        if self.problem.setup.is_whole and not self.problem.setup.contacts:
            return ""
        met = np.flatnonzero(~off)
        if off.size and not met.size:
            return "nothing touches the specimen: it has sagged away, or the test ends too early"
        lost = np.flatnonzero(off & (np.arange(off.size) > (met[0] if met.size else 0)))
        return f"contact is lost at {self._reached[lost[0]]:.4g} mm" if lost.size else ""

    def _cannot_sway(self) -> Iterator[str]:
        """Say that a column went past Euler's load in a model whose axis holds it straight."""
        setup, height_mm = self.problem.setup, self.system.mesh.height_mm
        critical = buckling_strain(setup.test, setup.specimen)
        small = self.system.material.small_strain
        if (self.system.space.dim == 3 and not small) or critical is None or not self._reached:
            return
        if self._reached[-1] >= critical * height_mm:
            hidden = NEVER_BUCKLES if small else "a model with an axis of symmetry cannot show that"
            yield (
                f"a column of this slenderness buckles at about {critical * height_mm:.3g} mm "
                f"(Euler's load); {hidden}"
            )

    def _not_converged(self, curve: Curve) -> Iterator[str]:
        """Say which iterations beside Newton's ended before their tolerance."""
        missed = [step for step in self.steps if step.gradients.excess > 1]
        rounded = max(map(self._rounded, self.steps[-1:]), default=0.0)
        if rounded > _ROUNDED:
            share = self.steps[-1].state.displacement_mm / self.system.mesh.height_mm
            yield (
                f"rounding of the nodal forces is {100 * rounded:.2g} % of the force: the "
                f"displacement is {share:.2g} of the height; press deeper, or model a smaller "
                "specimen"
            )
        if missed:
            worst = max(missed, key=lambda step: step.gradients.excess)
            yield (
                f"the derivatives of {len(missed)} steps did not converge: at "
                f"{worst.state.displacement_mm:.4g} mm {worst.gradients.excess:.2g} times the "
                "residual that is allowed is left"
            )
        error, most = curve.relative_interpolation_error(), self.options.curve_error
        if self._complete and most is not None and error > most:
            yield (
                f"between its points the curve may be off by {100 * error:.2g} % of the force, "
                f"more than the {100 * most:.2g} % asked for: use more steps"
            )


def _near(result: NewtonResult, J: Array) -> bool:
    """Whether every J is above a quarter of its value in the state before."""
    return bool((_LEAPT * J < result.J).all())
