"""Equilibria under any motion of a plate, and how they move with it.

A load path brings a specimen to one motion. Equilibria at others are reached from there along
the derivatives by the motion, which one factorization gives for all of its components: of an
elastic body the way does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.arrays import Array
from study.fem.contact.constraints import BESIDES, face_motions
from study.fem.element.function_space import at_level
from study.fem.solver.newton import NewtonSettings, solve_step
from study.fem.solver.sensitivity import Loads, linear_rates
from study.fem.solver.solution import Solution
from study.fem.solver.state import Assembly, State
from study.fem.solver.system import System
from study.setup.setup import Problem

#: components of a motion: towards the specimen, x and y (mm), three rotations (rad), spread
COMPONENTS = 1 + BESIDES

#: residual of the derivatives over the forces that they balance
_TOLERANCE = 1e-6

#: halvings of a change of motion that is too large for one step
_HALVINGS = 5


@dataclass(frozen=True)
class MovedPlate:
    """Equilibrium at a motion of the plate.

    Parameters
    ----------
    motion : ndarray, shape (7,)
        Down, x and y in mm, rotations about x, y and the axis in rad, spread.
    state : State
        Unknowns.
    displacement : ndarray, shape (n_nodes, 3)
        Of the nodes, mm.
    rates : ndarray, shape (n_nodes, 3, 7)
        Derivatives of the displacements by the motion.
    iterations : int
        Newton iterations since the last one.
    """

    motion: Array
    state: State
    displacement: Array
    rates: Array
    iterations: int


class NoEquilibrium(Exception):
    """No equilibrium was found at a motion of the plate."""


class PrescribedMotion:
    """A solved plate motion that can be taken elsewhere.

    Parameters
    ----------
    problem : Problem
        A test whose upper plate holds the face that it moves.
    solution : Solution
        Its solution, to the end.

    Raises
    ------
    NoEquilibrium
        If it has none there.
    """

    def __init__(self, problem: Problem, solution: Solution) -> None:
        if solution.warm is None or not solution.converged:
            raise NoEquilibrium(solution.message)
        self.system = solution.warm.system
        self._modes = _modes(self.system)
        self._settings = NewtonSettings()
        state, besides = solution.warm.steps[-1].state, problem.test.motion
        others = np.zeros(BESIDES) if besides is None else besides.components()
        motion = np.concatenate([[problem.test.depth_mm], others])
        self.start = self._described(self._under(motion), motion, state, 0)

    def at(self, motion: Array, near: MovedPlate) -> MovedPlate:
        """Equilibrium at another motion.

        Parameters
        ----------
        motion : ndarray, shape (7,)
            Wanted.
        near : MovedPlate
            To start from.

        Raises
        ------
        NoEquilibrium
            If none was found, or the plate is not pressed down.
        """
        if not motion[0] > 0:
            raise NoEquilibrium(f"the plate would move by {motion[0]:.3g} mm, off the specimen")
        return self._reached(motion, near, _HALVINGS)

    def stiffness(self, at: MovedPlate) -> Array:
        """Differentiate the forces that do the work of each component, shape (7, 7).

        Parameters
        ----------
        at : MovedPlate
            Equilibrium.
        """
        system = self._under(at.motion)
        rates = self._rates(system, at.state, system.assemble(at.state))
        forces = np.column_stack([system.tangent_product(column) for column in rates.T])
        return np.asarray(self._modes.T @ forces[system.constraints.dofs])

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
                return self._described(system, motion, found.state, found.iterations)
        if not halvings:
            raise NoEquilibrium("no equilibrium was found at the plate motion that fits")
        middle = self._reached(0.5 * (motion + near.motion), near, halvings - 1)
        return self._reached(motion, middle, halvings - 1)

    def _under(self, motion: Array) -> System:
        """Return the same equations under another motion; solver and arrays are shared."""
        rate = self._modes @ motion / motion[0]
        constraints = replace(self.system.constraints, rate=rate)
        return replace(self.system, constraints=constraints, latest=replace(self.system.latest))

    def _described(
        self, system: System, motion: Array, state: State, iterations: int
    ) -> MovedPlate:
        rates = self._rates(system, state, system.assemble(state))
        shape = (*system.space.nodes.shape, COMPONENTS)
        return MovedPlate(
            motion=motion.copy(),
            state=state,
            displacement=system.displacements(state.x).copy(),
            rates=rates[: system.space.n_displacement].reshape(shape),
            iterations=iterations,
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
        return linear_rates(system, assembly, loads, _TOLERANCE).x


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
