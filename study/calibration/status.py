"""How a fit ended, in words that a report can print."""

from __future__ import annotations

from enum import Enum


class EvaluationFailed(Exception):
    """The model has no answer at these constants; the optimizer rejects the step."""


class Status(Enum):
    """How the optimizer ended; the value is a sentence."""

    converged_gradient = "the residual is orthogonal to every parameter's influence"
    converged_step = "the next full step would not change the parameters"
    converged_cost = "the sum of squares can fall no further within rounding"
    converged_zero = "the model meets the data within rounding"
    max_evaluations = "the evaluations allowed were used up before a minimum was reached"
    no_decrease = "no step lowers the sum of squares although its gradient is not zero"
    at_edge = "the sum of squares falls on towards constants at which the model has no answer"
    at_kink = (
        "the sum of squares has a kink at its lowest point: contact sets in on one side of it, "
        "so that a standard error would mean nothing"
    )
    no_influence = "a parameter lost all influence on the model: this is no minimum to trust"
    running_away = "a parameter runs to infinity: no minimum lies within reach"
    start_failed = "the model has no answer at the start values"
    too_many_failures = "the model had no answer in the whole neighborhood of the best point"
    stopped = "stopped by the caller"

    @property
    def converged(self) -> bool:
        """Whether a local minimum was reached."""
        return self.name.startswith("converged")

    @property
    def usable(self) -> bool:
        """Whether the constants describe the data as well as the model can."""
        return self.converged or self in (Status.at_edge, Status.at_kink)

    @property
    def sentence(self) -> str:
        """The end in words."""
        return str(self.value)
