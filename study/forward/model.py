"""What a forward model answers: a curve with its gradients, however it was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Prediction:
    """A forward solution and what it would have cost alone, in seconds."""

    solution: Any
    cold_seconds: float
