"""Parameters that nobody wants to know, but that move the constants: what became of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class NuisanceEstimate:
    """One nuisance parameter after the fit; mm, N, MPa, degrees or plain.

    Parameters
    ----------
    name, key : str
        What it is called, and its key in the file.
    treated : {"fitted", "propagated"}
        Whether the tests helped to find it, or its uncertainty was carried to the constants.
    expected : float
        Value that was expected before the fit.
    uncertainty : float or None
        Standard uncertainty of that; None where nothing was known.
    value, standard_error : float
        After the fit.
    ci95 : tuple of float
        95 % interval.
    shares : mapping of str to float
        By constant: share of its variance that would be gone if this were known exactly.
    """

    name: str
    key: str
    treated: Literal["fitted", "propagated"]
    expected: float
    uncertainty: float | None
    value: float
    standard_error: float
    ci95: tuple[float, float]
    shares: Mapping[str, float]
