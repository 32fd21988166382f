"""Responses of known curves."""

from __future__ import annotations

import numpy as np
import pytest

from study.curve import Curve
from study.runner import response

D = np.linspace(0.0, 2.0, 201)
MEASURED = Curve(D, 10 * D)


@pytest.mark.parametrize("factor", [1.1, 0.9])
def test_a_curve_ten_percent_off_is_ten_percent_off_in_every_measure(factor: float) -> None:
    predicted = Curve(D, factor * MEASURED.force_N)
    found = response.score(predicted, MEASURED)
    assert found["relative_rms_force_error"] == (pytest.approx(10.0), "%")
    assert found["work_error"] == (pytest.approx(10.0), "%")
    assert found["peak_force_error"] == (pytest.approx(2.0), "N")
    # RMS of d on [0, 2] is 2/sqrt(3), up to the grid's 1e-4
    assert found["rms_force_error"][0] == pytest.approx(2 / np.sqrt(3), rel=5e-3)


def test_constants_are_reported_in_kpa_and_exponents_plain() -> None:
    found = response.constants_in_kPa({"mu0": 0.01, "values": {"mu1": 0.01, "alpha1": 2.0}})
    assert found == {"mu0": (10.0, "kPa"), "mu1": (10.0, "kPa"), "alpha1": (2.0, "")}


def test_directions_are_averaged() -> None:
    found = response.averaged([{"mu0": (10.0, "kPa")}, {"mu0": (12.0, "kPa")}])
    assert found == {"mu0": {"value": 11.0, "unit": "kPa"}}
