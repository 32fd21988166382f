"""A surface over the numeric factors of a study, for one response."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from study.response_surface.level_difference import LevelDifference
    from study.response_surface.propagation import Propagated
    from study.response_surface.result import Sensitivity, SurfaceAnalysis


@dataclass(frozen=True)
class FittedSurface:
    """What the runs of a study say of one response over its numeric factors.

    Parameters
    ----------
    response, unit : str
        The response and its unit.
    found : SurfaceAnalysis or None
        The surface; None where the runs cannot carry one.
    refused : str
        Why there is none.
    labels : mapping of str to str
        Levels of the other factors: every combination of them has a surface of its own.
    practical : float, optional
        Smallest difference that matters, in the response's unit.
    bound : float, optional
        Bound of the numerical error of a difference of two settings, in the same unit.
    units : mapping of str to str
        Units of the factors that are numbers.
    uncertain : Propagated, optional
        The response's distribution where inputs are uncertain.
    inputs : mapping of str to str
        Distribution of each of them, in words.
    differences : tuple of LevelDifference
        From the surfaces at the first levels of the other factors, one factor at a time.
    """

    response: str
    unit: str
    found: SurfaceAnalysis | None
    refused: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    practical: float | None = None
    bound: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    uncertain: Propagated | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    differences: tuple[LevelDifference, ...] = ()

    @property
    def verdicts(self) -> list[dict[str, object]]:
        """One row a numeric factor, with the keys of a study's verdicts."""
        told = () if self.found is None else self.found.sensitivity
        return [self._row(item) for item in told]

    def to_json(self) -> dict[str, object]:
        """Plain values: the response, where the others stand, and the surface."""
        own: dict[str, object] = {
            "response": self.response,
            "unit": self.unit,
            "at": dict(self.labels),
            "practical": self.practical,
            "U": self.bound,
        }
        if self.found is None:
            return own | {"surface": None, "sensitivity": [], "refused": self.refused}
        told = own | self.found.to_json()
        if self.labels:
            told["differences"] = [one.to_json() for one in self.differences]
        if self.uncertain is not None:
            told["uncertainty"] = self.uncertain.to_json() | {"distributions": dict(self.inputs)}
        return told

    def _row(self, item: Sensitivity) -> dict[str, object]:
        effect = item.range
        return {
            "response": self.response,
            "factor": item.factor,
            "at": dict(self.labels),
            "verdict": "cannot tell" if effect is None else effect.verdict,
            "effect": None if effect is None else effect.value,
            "ci95": None,
            "practical": self.practical,
            "u_num": self.bound,
            "U": self.bound,
            "p": None,
        }
