"""Numerical uncertainty on its way from refined records to the analysis."""

from __future__ import annotations

import pytest

from study.analysis.convergence.grid_convergence import NumericalUncertainty
from study.api.uncertainty.numerical import largest_u_num
from study.record.record import Record


def record(name: str, value: float) -> Record:
    return Record(name, "s", responses={"mu0": {"value": value, "unit": "kPa"}})


def row(value: float, u_num: float | None) -> NumericalUncertainty:
    return NumericalUncertainty({}, "mu0", value, u_num, "kPa", "monotone", "")


def test_numerical_uncertainty_of_a_log_response_is_a_share_of_its_own_block():
    rows = [row(16.0, 0.8), row(16.0, 0.4)]
    records = [record("a", 4.0), record("b", 1.0)]
    assert largest_u_num(rows, records, "mu0", "none") == 0.8
    # 5 % of the refined block; the geometric mean of the records is 2
    assert largest_u_num(rows, records, "mu0", "log") == pytest.approx(0.1)


def test_an_unknown_uncertainty_stays_unknown():
    assert largest_u_num([row(16.0, None)], [record("a", 1.0)], "mu0", "log") is None
    assert largest_u_num([], [], "mu0", "none") is None
