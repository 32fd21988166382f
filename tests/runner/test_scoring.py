"""Responses of known curves."""

import numpy as np
import pytest

from study.ground.curve import Curve
from study.simulation import response

D = np.linspace(0.0, 2.0, 201)
MEASURED = Curve(D, 10 * D)


@pytest.mark.parametrize("factor", [1.1, 0.9])
def test_a_curve_ten_percent_off_is_ten_percent_off_in_every_measure(factor):
    predicted = Curve(D, factor * MEASURED.force_N)
    found = response.score(predicted, MEASURED)
    assert found["relative_rms_force_error"] == {"value": pytest.approx(10.0), "unit": "%"}
    assert found["work_error"] == {"value": pytest.approx(10.0), "unit": "%"}
    assert found["peak_force_error"] == {"value": pytest.approx(2.0), "unit": "N"}
    # RMS of d on [0, 2] is 2/sqrt(3), up to the grid's 1e-4
    assert found["rms_force_error"]["value"] == pytest.approx(2 / np.sqrt(3), rel=5e-3)
