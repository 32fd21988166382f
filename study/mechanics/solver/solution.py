"""What a forward simulation gives back."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.curve import Curve, hermite_work
from study.mechanics.setup.geometry import Enclosed
from study.mechanics.setup.setup import Problem
from study.mechanics.setup.test_kind import buckling_strain
from study.mechanics.solver.equilibrium import (
    ContactFigures,
    Equilibria,
    Instability,
    Resultant,
    contact_figures,
    nodal_reactions,
    resultants,
)
from study.mechanics.solver.internal_force import StoredEnergy
from study.mechanics.solver.sensitivity import StepGradients
from study.mechanics.solver.system import Assembly, State, System
from study.mechanics.surface.closed_surface import body

# -------------------------------------------------------------------------------------------------
# Work of the test against the energy that the specimen stores: what Newton's method cannot see.
#
# An equilibrium is found wherever the residual vanishes, also on the other side of a limit
# point, where the surface has jumped to another shape. The test then did work that the
# specimen does not hold (or holds energy that nobody put in), and the sum shows it. On a path
# without a jump the two differ by what the interpolation between two displacements is off.

#: Share of the stored energy that may be missing, or too much, between two displacements
#: before the specimen is said to have jumped. Interpolation over a tenth of a cone's depth
#: is off by up to 0.2 % of it, jumps begin at about 0.5 %.
JUMP_SHARE = 0.005

#: The same under an indenter that sticks. Its steps are a part of the answer and cannot be taken
#: again in halves, so that what interpolation is off must not look like a jump.
STICKING_JUMP_SHARE = 0.02

#: Energy that is counted at least, over force times the whole displacement: at first touch
#: a few contact points close one after the other, and next to nothing is stored.
LEAST_ENERGY = 0.1

#: values of a run without steps
_none = partial(np.zeros, 0)


def unexplained_work(before: Step, after: Step) -> float:
    """Work between two steps, interpolated, less the energy stored meanwhile, N mm."""
    ends = before, after
    work = hermite_work(
        np.array([step.state.displacement_mm for step in ends]),
        np.array([step.gradients.work_N for step in ends]),
        np.array([step.gradients.work_slope_N_per_mm for step in ends]),
    )
    return float(work[0]) - (after.stored.total - before.stored.total)


def jumped(before: Step, after: Step, whole_mm: float, share: float = JUMP_SHARE) -> bool:
    """Whether energy was lost or won between two steps."""
    least = LEAST_ENERGY * abs(after.gradients.work_N) * whole_mm
    held = max(after.stored.total, least)
    return abs(unexplained_work(before, after)) > share * held


@dataclass(frozen=True)
class EnergyBalance:
    """Energies of the requested displacements (whole specimen)."""

    #: shape (n,); energy of the material, and of the resistance to uneven volume.
    stored_Nmm: Array = field(default_factory=_none)
    stabilization_Nmm: Array = field(default_factory=_none)
    #: shape (n,); work so far, interpolated between the displacements, less the energy stored so
    #: far, over the largest energy stored. The work of the first interval, in which contact begins,
    #: is taken to be the energy stored there.
    mismatch: Array = field(default_factory=_none)
    #: Displacements at which the specimen jumped to another equilibrium.
    jumps_mm: tuple[float, ...] = ()

    def at_points(self, kept: Ints) -> EnergyBalance:
        """Return the balance at some of the displacements, given by their places."""
        return EnergyBalance(
            self.stored_Nmm[kept], self.stabilization_Nmm[kept], self.mismatch[kept], self.jumps_mm
        )

    @property
    def largest_mismatch(self) -> float:
        """Largest share of the stored energy by which the work is off; 0 of an empty run."""
        return float(np.abs(self.mismatch).max(initial=0.0))

    @property
    def stabilization_share(self) -> float:
        """Largest share of the stored energy that the stabilization holds."""
        total = self.stored_Nmm + self.stabilization_Nmm
        held = np.divide(self.stabilization_Nmm, total, out=np.zeros_like(total), where=total > 0)
        return float(held.max(initial=0.0))


def balanced(
    steps: list[Step],
    jumps_mm: tuple[float, ...],
    whole_mm: float,
    share: float = JUMP_SHARE,
) -> tuple[EnergyBalance, Array]:
    """Energy balance of a run, and the work done up to each step, shape (n,), N mm.

    The work is what the specimen stores, but where it jumped: there it is interpolated. A jump
    that is known counts however little energy was lost in it: as a missing work it would bend
    the curve of a short interval by more than the whole change of force.
    """
    if not steps:
        return EnergyBalance(), _none()
    total = np.array([step.stored.total for step in steps])
    missing, lost = np.zeros((2, len(steps)))
    for k, (before, after) in enumerate(pairwise(steps), start=1):
        missing[k] = unexplained_work(before, after)
        ends_mm = before.state.displacement_mm, after.state.displacement_mm
        holds_jump = any(ends_mm[0] <= place < ends_mm[1] for place in jumps_mm)
        if holds_jump or jumped(before, after, whole_mm, share):
            lost[k] = missing[k]
    largest = float(total.max())
    balance = EnergyBalance(
        np.array([step.stored.material for step in steps]),
        np.array([step.stored.stabilization for step in steps]),
        np.cumsum(missing) / (largest if largest > 0 else np.inf),
        jumps_mm,
    )
    return balance, total + np.cumsum(lost)


@dataclass(frozen=True)
class Step:
    """A converged step of a run."""

    state: State
    #: Force and its derivatives; those of the state are what a later solve is started along.
    gradients: StepGradients
    #: Of the whole specimen, N mm.
    stored: StoredEnergy
    #: What holds the specimen above and below, and what touches it.
    held: tuple[Resultant, Resultant, ContactFigures]
    #: Largest force of a pin over that of the test: zero where the loads balance.
    pinned: float
    #: Newton iterations, those of its sub-steps included.
    iterations: int

    @classmethod
    def of(
        cls, system: System, state: State, assembly: Assembly, row: StepGradients, spent: int,
        sense: float,
    ) -> Step:  # fmt: skip
        """Energy, reactions and contact of a converged state."""
        stored = (system.force_scale * part for part in system.stored_energy(state))
        forces = nodal_reactions(system, assembly)
        figures = contact_figures(system, state, assembly, forces[0])
        held = (*resultants(system, state, forces, sense), figures)
        pins = np.abs(assembly.residual[system.constraints.pins])
        pinned = float(pins.max()) / abs(row.force_N) if pins.size and row.force_N else 0.0
        return cls(state, row, StoredEnergy(*stored), held, pinned, spent)


@dataclass(frozen=True)
class Warm:
    """What a later solve of the same problem with other constants can start from."""

    system: System
    values: dict[str, float]
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Solution:
    """Result of one forward simulation; without its status nearly nothing of one that never began.

    Points and cells are the vertices of the mesh in mm, ``displacement`` is theirs at the last
    converged step.
    """

    #: ``converged``, ``not-converged``, ``mesh-failed``, ``unstable``, ``lost-contact`` or
    #: ``out-of-memory``.
    status: str
    #: One sentence that says why it ended.
    message: str
    mesh_size_mm: float
    seconds: dict[str, float]
    #: Requested steps up to the last converged one, with stiffness, gradients and work; and, if
    #: ``Options`` ask for it, steps added where the curve bends.
    curve: Curve = Curve(_none(), _none(), _none())
    #: Displacement of the last converged step, sub-steps of a cut-back included.
    reached_mm: float = 0.0
    #: Smallest J of the last converged step.
    min_j: float = 1.0
    #: Reactions and contact of each point, and where the equilibrium becomes unstable.
    equilibria: Equilibria = Equilibria()
    #: Stored energy and the work of the test, point by point of the curve.
    energy: EnergyBalance = EnergyBalance()
    #: Iterations of each point of the curve (its sub-steps added up).
    newton_iterations: tuple[int, ...] = ()
    dofs: int = 0
    elements: int = 0
    mesh_hash: str = ""
    solver: str = "none"
    #: shape (n_points, dim)
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    cells: Ints = field(default_factory=lambda: np.zeros((0, 4), np.int64))
    displacement: Array = field(default_factory=lambda: np.zeros((0, 3)))
    warm: Warm | None = None

    @property
    def base_reaction_N(self) -> Array:  # noqa: N802
        """Axial reaction of the base, to be compared with the force, shape (n_points,)."""
        return np.array([one.axial for one in self.equilibria.base])

    @property
    def instability(self) -> Instability | None:
        """Where the equilibrium becomes unstable; the curve ends before."""
        return self.equilibria.instability

    @property
    def converged(self) -> bool:
        """Whether every requested step was reached."""
        return self.status == "converged"


def without_answer(problem: Problem, status: str, message: str, seconds: float) -> Solution:
    """Solution of a problem that never came to its first step."""
    return Solution(status, message, problem.model.mesh_size_mm or 0.0, {"total": seconds})


#: what a user can do about an energy that is stretched too far
_OUT_OF_REACH = "no finer mesh goes further; press less deep, or use another energy"

#: part of the displacement up to which the specimen's surface may lie inside the moving one unsaid:
#: where a facet bridges the edge of a punch, the force is that of a blunter one
_INSIDE = 0.1

#: force of a pin over that of the test above which a specimen is not balanced
_UNBALANCED = 1e-3


@dataclass
class Logbook:
    """The requested steps of one run, as far as it came."""

    system: System
    problem: Problem
    #: Constants by which the force is differentiated.
    wanted: tuple[str, ...]
    #: Largest interpolation error (:class:`Options`); with one the solution holds the steps that
    #: were added, too.
    curve_error: float | None = None
    #: How many of the steps so far were asked for; others were added where energy was missing or
    #: the curve bends.
    requested: int = 0
    steps: list[Step] = field(default_factory=list)
    #: Displacements at which the surface snapped to another equilibrium, mm.
    snaps: list[float] = field(default_factory=list)

    @property
    def reached(self) -> list[float]:
        """Displacements of the steps, mm."""
        return [step.state.displacement_mm for step in self.steps]

    @property
    def last(self) -> State | None:
        """State of the last step."""
        return self.steps[-1].state if self.steps else None

    def drop_from(self, displacement_mm: float) -> None:
        """Forget the steps from a displacement on."""
        kept = int(np.searchsorted(self.reached, displacement_mm * (1 - 1e-12)))
        steps = np.array(self.reached[kept:]) * self.problem.test.steps / self._whole_mm
        self.requested -= int((np.abs(steps - np.round(steps)) < 1e-6).sum())
        del self.steps[kept:]
        self.snaps = [place for place in self.snaps if place < displacement_mm]

    @property
    def complete(self) -> bool:
        """Whether every requested step is there."""
        return self.requested == self.problem.test.steps

    def jumped_to(self, step: Step) -> bool:
        """Whether energy is missing, or too much, since the last step written down.

        Within the first requested step nothing is looked at: contact begins point by point there,
        and the slope at first touch is not known.
        """
        first_mm = self._whole_mm / self.problem.test.steps
        if not self.steps or self.reached[-1] < (1 - 1e-9) * first_mm:
            return False
        return self.lies_apart(self.steps[-1], step)

    def add(self, step: Step) -> None:
        """Write down a step that converged, in the order of displacements."""
        self.steps.insert(int(np.searchsorted(self.reached, step.state.displacement_mm)), step)

    def around(self, displacement_mm: float) -> tuple[State | None, State]:
        """States next to a displacement; before the first step there is none."""
        at = int(np.searchsorted(self.reached, displacement_mm))
        return self.steps[at - 1].state if at else None, self.steps[at].state

    def lies_apart(self, before: Step, after: Step) -> bool:
        """Whether energy is missing, or too much, between two states."""
        return jumped(before, after, self._whole_mm, self._share)

    def lies_between(self, step: Step) -> bool:
        """Whether a state is on the way between its neighbors.

        Of another branch energy is missing on the way there, and too much on the way back. Before
        the first state nothing is known that it could be held against.
        """
        at = int(np.searchsorted(self.reached, step.state.displacement_mm))
        there = at > 0 and self.lies_apart(self.steps[at - 1], step)
        return not (there and self.lies_apart(step, self.steps[at]))

    def equilibria(self, kept: Ints, instability: Instability | None = None) -> Equilibria:
        """Reactions and contact of some steps, given by their places."""
        plate, base, contact = (tuple(self.steps[n].held[k] for n in kept) for k in range(3))
        return Equilibria(plate, base, contact, instability)

    def balance(self) -> tuple[EnergyBalance, Array]:
        """Energy balance of the steps, and the work done up to each, shape (n,), N mm."""
        return balanced(self.steps, tuple(self.snaps), self._whole_mm, self._share)

    def coarse_intervals(self, error: float) -> list[float]:
        """Middles of the intervals that make interpolation worse than ``error``.

        ``error`` is a share of the force, root mean square over the displacement.
        """
        if not self.complete:
            return []
        return self.curve(self.balance()[1]).coarse_intervals(error)

    @property
    def _share(self) -> float:
        """Share of the stored energy above which something has jumped."""
        return STICKING_JUMP_SHARE if self.system.sticks else JUMP_SHARE

    @property
    def _whole_mm(self) -> float:
        return self.problem.test.depth_mm

    def curve(self, work_Nmm: Array) -> Curve:
        """Force-displacement curve with its gradients."""
        rows = [step.gradients for step in self.steps]
        return Curve(
            np.array(self.reached),
            np.array([row.force_N for row in rows]),
            np.array([row.stiffness_N_per_mm for row in rows]),
            {n: np.array([row.force_gradient[n] for row in rows]) for n in self.wanted},
            work_Nmm,
            is_conjugate=self.system.constraints.axial is None,
            quantities=self.equilibria(np.arange(len(rows))).quantities(),
        )

    def solution(
        self,
        state: State,
        min_j: float,
        lost: str,
        reason: str,
        seconds: float,
        instability: Instability | None = None,
    ) -> Solution:
        """Solution of a run that ended at ``state``.

        ``lost`` says where the energy has lost its ellipticity there, ``reason`` why the run
        went no further.
        """
        system, vertices = self.system, self.system.mesh.points.shape[0]
        # the steps that were requested, or all, with the iterations of those left out before them
        requested = np.array(self.reached) * self.problem.test.steps / self._whole_mm
        asked = np.abs(requested - np.round(requested)) < 1e-6
        kept = np.flatnonzero(asked | (self.curve_error is not None))
        total = np.cumsum([0, *(step.iterations for step in self.steps)])[np.r_[0, kept + 1]]
        balance, work = self.balance()
        curve, gave_way = self.curve(work), bool(lost) or instability is not None
        status = "converged" if self.complete else "unstable" if gave_way else "not-converged"
        apart = self._apart()
        if self.complete and apart:
            status = "lost-contact"
        return Solution(
            status=status,
            message=self._message(state, lost, reason, curve),
            curve=curve.at_points(kept),
            energy=balance.at_points(kept),
            reached_mm=state.displacement_mm,
            min_j=min_j,
            equilibria=self.equilibria(kept, instability),
            newton_iterations=tuple(int(n) for n in np.diff(total)),
            dofs=system.dofs,
            elements=system.space.n_elements,
            mesh_hash=system.mesh.digest(),
            mesh_size_mm=system.mesh.size_mm,
            solver=system.solver.name,
            seconds={**system.seconds, "total": seconds},
            points=system.mesh.points,
            cells=system.mesh.cells,
            displacement=system.displacements(state.x)[:vertices],
            warm=Warm(
                system,
                dict(self.problem.material.constants),
                tuple(self.steps[k] for k in kept),
            ),
        )

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
        return f"contact is lost at {self.reached[lost[0]]:.4g} mm" if lost.size else ""

    def _message(self, state: State, lost: str, reason: str, curve: Curve) -> str:
        """Say how the run ended, and what was mended or is not as it should be."""
        said = ["every step converged"]
        if self.snaps:
            places = ", ".join(f"{d:.3g}" for d in sorted(self.snaps))
            said.append(f"past {places} mm the surface snapped to another equilibrium")
        pinned = max((step.pinned for step in self.steps), default=0.0)
        if pinned > _UNBALANCED:
            said.append(
                "what only keeps the specimen from sliding or turning carries up to "
                f"{100 * pinned:.2g} % of the force: it is not balanced as it stands"
            )
        if not self.complete:
            reached, asked = state.displacement_mm, self.problem.test.depth_mm
            said = [f"stopped at {reached:.4g} mm of {asked:.4g} mm: {lost or reason}"]
            if lost:
                said.append(_OUT_OF_REACH)
        elif apart := self._apart():
            said = [apart]
        elif lost:
            said.append(f"{lost}: there the answer depends on the mesh")
        inside = max((step.held[2].penetration_mm for step in self.steps), default=0.0)
        if inside > _INSIDE * self._whole_mm:
            said.append(
                f"the specimen's surface lies up to {inside:.2g} mm inside the moving one, "
                f"{100 * inside / self._whole_mm:.2g} % of the displacement: use a smaller "
                "mesh_size, or press less deep"
            )
        said += self._cannot_sway()
        said += self._not_converged(curve)
        if isinstance(self.problem.specimen, Enclosed):
            said += body(self.problem.specimen).notes
        return "; ".join(said)

    def _cannot_sway(self) -> list[str]:
        """Say that a column went past Euler's load in a model whose axis holds it straight."""
        setup, height_mm = self.problem.setup, self.system.mesh.height_mm
        critical = buckling_strain(setup.test, setup.specimen)
        if self.system.space.dim == 3 or self.system.material.small_strain or critical is None:
            return []
        if not self.reached or self.reached[-1] < critical * height_mm:
            return []
        return [
            f"a column of this slenderness buckles at about {critical * height_mm:.3g} mm (Euler's "
            "load), which a model with an axis of symmetry cannot show"
        ]

    def _not_converged(self, curve: Curve) -> list[str]:
        """Say which iterations beside Newton's ended before their tolerance."""
        notes, missed = [], [step for step in self.steps if step.gradients.excess > 1]
        if missed:
            worst = max(missed, key=lambda step: step.gradients.excess)
            notes.append(
                f"the derivatives of {len(missed)} steps did not converge: at "
                f"{worst.state.displacement_mm:.4g} mm {worst.gradients.excess:.2g} times the "
                "residual that is allowed is left"
            )
        if self.complete and self.curve_error is not None:
            error = curve.relative_interpolation_error()
            if error > self.curve_error:
                notes.append(
                    f"between its points the curve may be off by {100 * error:.2g} % of the force, "
                    f"more than the {100 * self.curve_error:.2g} % asked for: use more steps"
                )
        return notes
