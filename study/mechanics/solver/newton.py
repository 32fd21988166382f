"""Newton's method at one displacement: full steps, a filter on J, the active set of the contact."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from study.ground.arrays import Array, Flags
from study.mechanics.contact.contact import ContactState
from study.mechanics.setup.test_kind import StepSettings
from study.mechanics.solver.linear_solver import SingularMatrixError
from study.mechanics.solver.system import Assembly, Drag, State, System, Weight

#: why a state has no stress where no element is inverted
_OUT_OF_REACH = "a point is stretched beyond what the energy reaches, such as the end of its chains"

#: iterations after which a residual that was never below the next figure is given up
_HOPELESS = 9
_FAR = 0.1

#: relative residual below which contact may be decided point by point, and below which the
#: tangent changes little from one iteration to the next
_CALM = 0.01
_STEADY = 0.1

#: linear solves by an older factorization end at a share of what the Newton iteration itself
#: leaves, its residual squared, or at a share of the tolerance; and below the last in any case
_LINEAR = 0.03
_AT_LAST = 0.1
_LOOSEST = 0.01

#: the same where the tangent is no near one of the next state's
_ROUGH = 1e-3


#: a step is halved until no J falls below this fraction of its last value
_J_FILTER = 0.5

#: tolerance and gap of a state that only leads to the next
_PASSING_TOLERANCE = 1e-3
_PASSING_GAP = 2e-5

#: the same of one that sticks, which all later ones remember: forces are then off by some 1e-6,
#: where half the steps move them by some 5e-4
_REMEMBERED_TOLERANCE = 1e-6
_REMEMBERED_GAP = 1e-7


@dataclass(frozen=True)
class NewtonSettings:
    """When Newton stops."""

    #: On the residual of the free unknowns over the reaction.
    tolerance: float = 1e-8
    #: Largest |gap| of an active contact point, in multiples of the specimen's height, and of the
    #: displacement: the smaller counts.
    gap: float = 2e-9
    gap_of_displacement: float = 1e-3
    #: Largest tension of a held contact point over the largest contact pressure.
    pull: float = 0.05
    #: After as many the step has failed; the second counts while contact still changes.
    max_iterations: int = 25
    max_switching: int = 40

    def passing(self, *, remembered: bool = False) -> NewtonSettings:
        """For a state that nobody asked for: it only leads to the next, or is remembered too."""
        tolerance, gap, of_displacement = (
            (_REMEMBERED_TOLERANCE, _REMEMBERED_GAP, self.gap_of_displacement)
            if remembered
            else (_PASSING_TOLERANCE, _PASSING_GAP, 1.0)
        )
        tolerance, gap = max(self.tolerance, tolerance), max(self.gap, gap)
        return replace(self, tolerance=tolerance, gap=gap, gap_of_displacement=of_displacement)


@dataclass(frozen=True)
class NewtonResult:
    """A converged state, or the reason why there is none.

    ``J`` is that of the quadrature points, shape (n_elements, n_quadrature).
    """

    state: State
    converged: bool
    iterations: int
    reason: str
    residuals: tuple[float, ...]
    assembly: Assembly | None = None
    J: Array = field(default_factory=lambda: np.ones(0))

    def equilibrium(self) -> Assembly:
        """Return what was assembled at the converged state."""
        if self.assembly is None:
            raise RuntimeError(f"there is no equilibrium: {self.reason}")
        return self.assembly


def solve_step(
    system: System,
    guess: State,
    settings: NewtonSettings,
    *,
    lifted_from: State | None = None,
    held: tuple[Flags, ...] = (),
) -> NewtonResult:
    """Equilibrium at ``guess.displacement_mm`` by full steps.

    ``held`` are contact points that are held closed from the first iteration on.
    """
    state, lift = lifted_from or guess, np.zeros(0)
    if lifted_from is not None:  # the prescribed increment that the first solve has to spread
        lift = system.prescribed(guess.displacement_mm) - system.prescribed(state.displacement_mm)
    residuals: list[float] = []
    J = system.volume_ratios(state.x)
    switches, free, dim = Switches(system, held), system.pattern.free, system.space.dim
    for iteration in itertools.count():
        state = switches.decided(state, calm=not residuals or residuals[-1] < _CALM)
        assembly = system.assemble(state)
        if not assembly.min_j > 0:
            reason = _OUT_OF_REACH if (J > 0).all() else "an element is inverted"
            return NewtonResult(state, False, iteration, reason, ())
        right = -assembly.residual[free]
        if lift.size:
            right -= system.lift_product(lift)
        else:
            residuals.append(_relative(system, state, assembly))
            if _done(system, state, residuals[-1], assembly, settings):
                return NewtonResult(state, True, iteration, "converged", (*residuals,), assembly, J)
        if _hopeless(iteration, residuals, switches.changing, settings):
            break
        try:
            solution = _solved(system, residuals, right, (state, assembly), settings)
        except SingularMatrixError as error:
            return NewtonResult(state, False, iteration, f"singular tangent: {error}", ())
        increment = np.zeros(system.space.n)
        increment[free] = solution
        if not np.isfinite(increment).all():
            return NewtonResult(state, False, iteration, "singular tangent", ())
        if lift.size:
            increment[system.constraints.dofs] = lift
            state = replace(state, displacement_mm=guess.displacement_mm)
        fraction, J = _filtered(system, state.x, J, increment)
        if fraction == 0 or (lift.size and fraction < 1):  # the plate would stay on its way
            return NewtonResult(state, False, iteration, "an element would be inverted", ())
        each = zip(system.contact, state.multipliers, assembly.contact, strict=True)
        multipliers = tuple(
            old + fraction * (touch.new_multiplier(points, increment[points.dofs(dim)]) - old)
            for points, old, touch in each
        )
        state = replace(state, x=state.x + fraction * increment, multipliers=multipliers)
        lift = np.zeros(0)
    reason = f"no equilibrium after {iteration} iterations"
    return NewtonResult(state, False, iteration, reason, tuple(residuals))


def _hopeless(
    iteration: int, residuals: list[float], changing: bool, settings: NewtonSettings
) -> bool:
    """Whether to give up; ``changing`` says that contact still does."""
    if len(residuals) > _HOPELESS and min(residuals[-_HOPELESS:]) > _FAR:
        return True
    return iteration >= (settings.max_switching if changing else settings.max_iterations)


def _solved(
    system: System,
    residuals: list[float],
    right: Array,
    at: tuple[State, Assembly],
    settings: NewtonSettings,
) -> Array:
    """Solve with the tangent of a state; a steady one differs little from one factorized before.

    A linear solve may leave what the iteration itself leaves (Eisenstat and Walker 1996).
    """
    if residuals and residuals[-1] < _STEADY:
        # weights of the equations, so that forces and volumes can be added up
        reaction, volume = _measures(system, *at)
        is_force = system.pattern.free < system.space.n_displacement
        scale = np.where(is_force, 1.0 / reaction, 1.0 / volume)
        left = max(_LINEAR * residuals[-1] ** 2, _AT_LAST * settings.tolerance)
        size = float(np.linalg.norm(scale * right))  # gaps included
        return system.solve(right, scale, min(_LOOSEST, left / size), residuals[-1])
    system.factorize()
    # of a linear body the first solve is the last
    rough = _AT_LAST * settings.tolerance if system.material.small_strain else _ROUGH
    return system.solve_afresh(right, rough)


def _filtered(system: System, x: Array, before: Array, increment: Array) -> tuple[float, Array]:
    """Longest halving of a step that keeps every J, and what J is there; 0 where 1/1024 fails."""
    fraction = 1.0
    while fraction > 1e-3:
        J = system.volume_ratios(x + fraction * increment)
        if (_J_FILTER * before < J).all():
            return fraction, J
        fraction /= 2
    return 0.0, before


def _relative(system: System, state: State, assembly: Assembly) -> float:
    """Force residual over the reaction, or volume residual over the volume: the larger one."""
    n_u = system.space.n_displacement
    out_of_balance = assembly.residual.copy()
    for points, touch in zip(system.contact, assembly.contact, strict=True):
        dofs = points.dofs(system.space.dim).ravel()
        np.subtract.at(out_of_balance, dofs, points.regularization(touch).ravel())
    out_of_balance[system.constraints.dofs] = 0.0
    reaction, volume = _measures(system, state, assembly)
    force = float(np.linalg.norm(out_of_balance[:n_u])) / reaction
    return max(force, float(np.linalg.norm(out_of_balance[n_u:])) / volume)


def _measures(system: System, state: State, assembly: Assembly) -> tuple[float, float]:
    """Force and volume that residuals are compared with."""
    reaction = float(np.linalg.norm(assembly.internal[system.constraints.dofs]))
    # at first touch there is no reaction yet
    strain = max(abs(state.displacement_mm) / system.mesh.height_mm, 1e-12)
    mu, volume = system.material.mu0, float(system.space.weights.sum())
    # the cross-section of the whole: both its volume and its height are doubled in a half model
    area_mm2 = volume * system.force_scale / system.mesh.height_mm
    floor = max(1e-6 * mu * area_mm2 * strain, 0.5 * mu * system.touch_mm**2)
    # no residual falls below the rounding of the forces in it
    return max(reaction, floor, system.rounding_N / NewtonSettings.tolerance), volume


def _done(
    system: System, state: State, residual: float, assembly: Assembly, settings: NewtonSettings
) -> bool:
    """Whether a state is an equilibrium with its contact settled."""
    if not residual < settings.tolerance:
        return False
    gap, moved_mm = settings.gap * system.mesh.height_mm, abs(state.displacement_mm)
    if moved_mm > 0:
        gap = min(gap, settings.gap_of_displacement * moved_mm)
    touching = assembly.contact
    return all(t.settled(gap) and t.largest_pull() < settings.pull for t in touching)


#: iterations in which all points may change sides at once
_TOGETHER = 10

#: changes of side within one step after which a point is held closed
_RESTLESS = 4

#: number of changes from which none is counted up to that
_NEVER = -1_000


class Switches:
    """Active sets of one Newton solve, kept from going round in circles.

    A primal-dual active set lets every point decide at once (Hueeber and Wohlmuth 2005).
    The stiffness of quadratic elements has entries of both signs between neighbors, so
    that the decisions may undo each other for ever; then only the point that wants it most
    changes sides, as in the classical active-set method for quadratic programs. A point
    that never settles is held closed; a step counts only if such points hardly pull.
    """

    def __init__(self, system: System, held: tuple[Flags, ...] = ()) -> None:
        self._system = system
        self._last: list[Flags] = []
        restless = held or [np.zeros(points.size, dtype=bool) for points in system.contact]
        self._count = [_RESTLESS * flags.astype(int) for flags in restless]
        self._iteration = 0
        #: whether the last decision moved a point to the other side
        self.changing = False

    def decided(self, state: State, *, calm: bool) -> State:
        """Return a state with the active sets of the next iteration.

        ``calm`` says that the last residual was small enough for a decision to mean much.
        """
        if not self._system.contact:
            return state
        chosen, touching = list[Flags](), self._system.touching(state)
        if calm and self._iteration == _TOGETHER and self._last:
            self._let_go(touching)
        for number, touch in enumerate(touching):
            side = touch.closing.copy()
            if self._last:
                before, changed = self._last[number], touch.closing != self._last[number]
                if self._iteration >= _TOGETHER and changed.any():
                    side = before.copy()
                    if calm:
                        most = int(np.argmax(np.where(changed, np.abs(touch.urge), -1.0)))
                        side[most] = not before[most]
                self._count[number] += side != before
            chosen.append(side | (self._count[number] >= _RESTLESS))
        pairs = zip(chosen, self._last, strict=False)  # before the first decision there is none
        self.changing = any((side != before).any() for side, before in pairs)
        self._last, self._iteration = chosen, self._iteration + 1
        return replace(state, closed=tuple(chosen))

    def _let_go(self, touching: Sequence[ContactState]) -> None:
        """Hold no point any more where one that is held pulls too much, which fails the step.

        It changed sides while contact was far from settled: all decide together again, for longer.
        """
        for count, touch in zip(self._count, touching, strict=True):
            allowed = -NewtonSettings.pull * max(float(touch.urge.max(initial=0.0)), 0.0)
            if ((count >= _RESTLESS) & (touch.urge < allowed)).any():
                self._count = [np.full_like(each, _NEVER) for each in self._count]
                self._iteration = -_TOGETHER


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

#: iterations of an easy and a hard step; factors on the drag after each, and after a failed step
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
    (state, lift), spent = _lifted(system, guess, rough, lifted_from)
    drag, trials = _FIRST, 0
    for _ in range(_STEPS):
        dragged = replace(system, drag=Drag(drag * weights, state.x), latest=replace(system.latest))
        result = solve_step(dragged, state, rough, lifted_from=lift)
        spent += result.iterations
        if not result.converged:
            drag *= _MUCH_MORE
            if drag > _MOST:
                break
            continue
        moved = float(np.abs(result.state.x - state.x)[: system.space.n_displacement].max())
        state, lift = replace(result.state, closed=()), None
        still = drag <= _FIRST and moved < _STILL * system.mesh.contact_size_mm
        if drag < _LITTLE or still:
            result = solve_step(system, state, settings)
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


# -------------------------------------------------------------------------------------------------
# What shapes a forward run besides its problem.


@dataclass(frozen=True)
class Options:
    """Everything that shapes a run besides the problem; part of what makes a result.

    ``side_contact = False`` lets the free side pass through the plates: wrong physics, kept
    for comparisons with codes and tables that do so. ``snaps = False`` ends a run at the first
    limit point instead of looking for an equilibrium beyond it. ``curve_error`` asks for steps
    between the requested ones where the curve bends, until the estimated error of its
    interpolation is below this share of the force (root mean square over the displacement). A run
    that starts from an earlier solve takes that one's points (``same_points``), or adds its own.
    """

    newton: NewtonSettings = field(default_factory=NewtonSettings)
    steps: StepSettings = field(default_factory=StepSettings)
    linear_solver: str = "auto"
    side_contact: bool = True
    snaps: bool = True
    curve_error: float | None = None
    same_points: bool = True


# -------------------------------------------------------------------------------------------------
# A specimen under its own weight, before it is touched: gravity comes on in shares.

#: smallest share of the weight that is tried at a time
_SMALLEST = 1 / 64

#: why there is no test
FALLS = "the specimen finds no equilibrium under its own weight: check test.gravity.density"


def sagged_state(system: System, weight: Weight, settings: NewtonSettings) -> State | None:
    """Equilibrium under the weight alone, at no displacement of the test."""
    state, carried, share = system.start(), 0.0, 1.0
    while carried < 1.0:
        next_share = min(carried + share, 1.0)
        loose = settings if next_share == 1.0 else settings.passing()
        part = Weight(next_share * weight.forces)  # of the same equations, with their arrays
        step = solve_step(replace(system, weight=part, latest=replace(system.latest)), state, loose)
        if step.converged:
            state, carried, share = step.state, next_share, 2 * share
            continue
        share /= 2
        if share < _SMALLEST:
            return None
    return state
