"""Which contact points are closed in the next Newton iteration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.forward.system import State, System

Flags = NDArray[np.bool_]

#: iterations in which all points may change sides at once
_TOGETHER = 10
#: changes of side within one step after which a point is held closed
_RESTLESS = 4


class Switches:
    """Active sets of one Newton solve, kept from going round in circles.

    A primal-dual active set lets every point decide at once (Hueeber and Wohlmuth 2005).
    The stiffness of quadratic elements has entries of both signs between neighbors, so
    that the decisions may undo each other for ever; then only the point that wants it most
    changes sides, as in the classical active-set method for quadratic programs. A point
    that never settles is held closed; a step counts only if such points hardly pull.
    """

    def __init__(self, system: System) -> None:
        self._system = system
        self._last: list[Flags] = []
        self._count = [np.zeros(points.size, dtype=int) for points in system.contact]
        self._iteration = 0
        #: whether the last decision moved a point to the other side
        self.changing = False

    def decided(self, state: State, *, calm: bool) -> State:
        """Return a state with the active sets of the next iteration.

        ``calm`` says that the last residual was small enough for a decision to mean much.
        """
        if not self._system.contact:
            return state
        chosen, self.changing = [], False
        for number, touch in enumerate(self._system.touching(state)):
            side = touch.wanted.copy()
            if self._last:
                before, changed = self._last[number], touch.wanted != self._last[number]
                if self._iteration >= _TOGETHER and changed.any():
                    side = before.copy()
                    if calm:
                        most = int(np.argmax(np.where(changed, np.abs(touch.urge), -1.0)))
                        side[most] = not before[most]
                self._count[number] += side != before
                side |= self._count[number] >= _RESTLESS
                self.changing |= bool((side != before).any())
            chosen.append(side)
        self._last, self._iteration = chosen, self._iteration + 1
        return replace(state, closed=tuple(chosen))
