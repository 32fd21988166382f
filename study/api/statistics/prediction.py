"""The verb predict: what a response will be at settings that were not run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from study import api, units
from study.api.folders import RESULTS
from study.design import overlay
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    from study.arrays import Array
    from study.design.spec import Factor
    from study.study_result.response_surface import FittedSurface
    from study.study_result.study_result import StudyResult

#: setting of a factor: with its unit, a number or numbers in the unit of the design, or a label
Setting = str | ArrayLike


@dataclass(frozen=True)
class Predicted:
    """A response at settings that were not run.

    Parameters
    ----------
    response, unit : str
        The response and its unit.
    value, low, high : ndarray, shape (m,)
        Prediction and ends of its 95 % interval, in that unit.
    """

    response: str
    unit: str
    value: Array
    low: Array
    high: Array

    def to_json(self) -> dict[str, object]:
        """Plain values; a single point gives numbers, several give lists."""
        single = self.value.size == 1
        ends = {"value": self.value, "low": self.low, "high": self.high}
        told = {k: float(v[0]) if single else v.tolist() for k, v in ends.items()}
        return {"response": self.response, "unit": self.unit, **told}


def predict(
    path: str | Path | StudyResult,
    at: Mapping[str, Setting],
    *,
    response: str | None = None,
    results: str | Path = RESULTS,
) -> tuple[Predicted, ...]:
    """Predict the responses of a study with numeric factors.

    Parameters
    ----------
    path : str, Path or StudyResult
        Results folder, design file, name of the study, or the study itself.
    at : mapping
        Setting of every factor: ``"3 mm"``, numbers of shape (m,) in the unit of the design's
        range, or the label of a level where the factor is no number.
    response : str, optional
        One response alone.
    results : Path
        Folder of the results, where ``path`` is a name.

    Returns
    -------
    tuple of Predicted
        One for every response.

    Raises
    ------
    InputError
        If a factor is missing or unknown, a setting has another dimension, a point would have to
        be extrapolated, or the study has no surface.
    """
    study = api.open_study(path, results) if isinstance(path, str | Path) else path
    found = _surfaces(study, response)
    factors = {factor.name: factor for factor in study.design.factors}
    unknown = [
        Fault(n, "no such factor", nearest(n, list(factors))) for n in at if n not in factors
    ]
    unknown += [Fault(n, "has no setting", "give every factor one") for n in factors if n not in at]
    if unknown:
        raise InputError(unknown)
    labels = {n: _label(f, at[n]) for n, f in factors.items() if f.span is None}
    numbers = {n: number_in_unit(f, at[n]) for n, f in factors.items() if f.span is not None}
    return tuple(_predicted(one, numbers) for one in found if dict(one.labels) == labels)


def _surfaces(study: StudyResult, response: str | None) -> tuple[FittedSurface, ...]:
    if not study.surfaces:
        rule = "has no surface: no factor is a range"
        mend = 'write { low = "1 mm", high = "3 mm" } and [design] kind = "latin-hypercube"'
        raise InputError(Fault(study.design.name, rule, mend))
    names = list(dict.fromkeys(one.response for one in study.surfaces))
    if response is not None and response not in names:
        raise InputError(Fault("--response", f"there is no {response!r}", nearest(response, names)))
    return tuple(one for one in study.surfaces if response in (None, one.response))


def _label(factor: Factor, setting: Setting) -> str:
    if str(setting) not in factor.labels:
        mend = nearest(str(setting), factor.labels)
        raise InputError(Fault(factor.name, f"has no level {str(setting)!r}", mend))
    return str(setting)


def number_in_unit(factor: Factor, setting: Setting) -> Array:
    """Read settings in the unit of the factor's range.

    Parameters
    ----------
    factor : Factor
        One that is a range.
    setting : str, float or array of shape (m,)
        With its unit, or numbers in the unit of the range.

    Raises
    ------
    UnitError
        If a text has another dimension.
    """
    kind, unit = overlay.dimension(factor.name), "" if factor.span is None else factor.span.unit
    if not isinstance(setting, str):
        return np.atleast_1d(np.asarray(setting, dtype=np.float64))
    if kind is None or not unit:
        return np.array([units.parse_number(setting)])
    return np.array([units.parse(setting, kind) / units.parse(f"1 {unit}", kind)])


def _predicted(one: FittedSurface, at: Mapping[str, Array]) -> Predicted:
    if one.found is None:
        rule = f"{one.response} has no surface: {one.refused}"
        raise InputError(Fault("predict", rule, "add runs, or ask another --response"))
    told = one.found.predict(at)
    return Predicted(one.response, one.unit, told.value, told.low, told.high)
