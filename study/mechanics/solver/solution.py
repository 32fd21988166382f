"""What a forward simulation gives back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.curve import Curve, hermite_work
from study.mechanics.setup.setup import Problem
from study.mechanics.solver.equilibrium import (
    ContactFigures,
    Equilibria,
    Instability,
    Resultant,
)
from study.mechanics.solver.internal_force import StoredEnergy
from study.mechanics.solver.sensitivity import StepGradients
from study.mechanics.solver.system import State, System

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

    def at_points(self, indices: Ints) -> EnergyBalance:
        """Return the balance at some of the displacements, given by their places."""
        rows = ("stored_Nmm", "stabilization_Nmm", "mismatch")
        return replace(self, **{name: getattr(self, name)[indices] for name in rows})

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


def balanced(steps: list[Step], jumps_mm: tuple[float, ...]) -> tuple[EnergyBalance, Array]:
    """Energy balance of a run, and the work done up to each step, shape (n,), N mm.

    The work is what the specimen stores, but where it jumped: there it is interpolated, however
    little energy was lost: as a missing work it would bend the curve of a short interval by more
    than the whole change of force. Where no jump is known, a missing work tells that the curve
    bends between the two points.
    """
    if not steps:
        return EnergyBalance(), _none()
    total = np.array([step.stored.total for step in steps])
    missing, lost = np.zeros((2, len(steps)))
    for k, (before, after) in enumerate(pairwise(steps), start=1):
        missing[k] = unexplained_work(before, after)
        ends_mm = before.state.displacement_mm, after.state.displacement_mm
        holds_jump = any(ends_mm[0] <= jump_mm < ends_mm[1] for jump_mm in jumps_mm)
        if holds_jump:
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


@dataclass(frozen=True)
class Warm:
    """What a later solve of the same problem with other constants can start from."""

    system: System
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Solution:
    """Result of one forward simulation; nearly empty, but for its status, where none began.

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
        return np.array([equilibrium.axial for equilibrium in self.equilibria.base])

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
