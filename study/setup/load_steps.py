"""The load steps of a test, and the settings of the iteration that go with its size."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StepSettings:
    """Load steps as fractions of a length of the test.

    A step grows after few Newton iterations, shrinks after many and is halved on failure;
    the run ends as ``not-converged`` when a step falls below ``smallest``.

    Parameters
    ----------
    largest : float
        Largest step between plates over the specimen's height.
    first_touch, largest_touch : float
        First and largest step of an indentation over the indenter's own length.
    sticking : float
        Largest step of an indenter that holds what it touches: where a point is held depends on
        the step in which it was met. Forces of cones were 0.2 to 0.9 % low at 0.125, in proportion
        to the step.
    held_face : float
        The same of a flat indenter, which holds its face from the start.
    deeper : float
        Largest step over the depth reached, where that is more: a cone looks the same at
        every depth.
    smallest : float
        Smallest step over the largest one.
    """

    largest: float = 0.06
    first_touch: float = 0.15
    largest_touch: float = 0.25
    sticking: float = 0.015
    held_face: float = 0.125
    deeper: float = 0.08
    smallest: float = 0.03
    growth: float = 1.6
    easy: int = 4
    hard: int = 14


@dataclass(frozen=True)
class StepRule:
    """Step settings with the lengths of one test (mm).

    Parameters
    ----------
    settings : StepSettings
        As fractions.
    first_mm, base_mm : float
        First step, and the largest one at no depth.
    deeper : float
        Largest step over the depth reached, where that is more.
    """

    settings: StepSettings
    first_mm: float
    base_mm: float
    deeper: float = 0.0

    def largest_mm(self, depth_mm: float) -> float:
        """Largest step at a depth."""
        return max(self.base_mm, self.deeper * depth_mm)

    def smallest_mm(self) -> float:
        """Step below which the run gives up."""
        return self.settings.smallest * self.base_mm

    def next_mm(self, step_mm: float, last_mm: float, iterations: int, depth_mm: float) -> float:
        """Step after one of ``last_mm`` that took ``iterations``."""
        rule = self.settings
        if iterations <= rule.easy:
            return min(self.largest_mm(depth_mm), max(step_mm, last_mm * rule.growth))
        return 0.7 * last_mm if iterations > rule.hard else step_mm
