"""What a forward model answers: a curve with its gradients, however it was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution


@dataclass(frozen=True)
class Prediction:
    """A forward solution and what it would have cost alone, in seconds."""

    solution: Solution
    cold_seconds: float
