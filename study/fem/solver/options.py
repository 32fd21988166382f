"""What shapes a forward run besides its problem."""

from __future__ import annotations

from dataclasses import dataclass, field

from study.fem.solver.newton import NewtonSettings
from study.setup.load_steps import StepSettings


@dataclass(frozen=True)
class Options:
    """Everything that shapes a run besides the problem; part of what makes a result.

    ``side_contact = False`` lets the free side pass through the plates: wrong physics, kept
    for comparisons with codes and tables that do so. ``snaps = False`` ends a run at the first
    limit point instead of looking for an equilibrium beyond it. ``curve_error`` asks for steps
    between the requested ones where the curve bends, until the estimated error of its
    interpolation is below this share of the force (root mean square over the displacement).
    """

    newton: NewtonSettings = field(default_factory=NewtonSettings)
    steps: StepSettings = field(default_factory=StepSettings)
    linear_solver: str = "auto"
    side_contact: bool = True
    snaps: bool = True
    curve_error: float | None = None
