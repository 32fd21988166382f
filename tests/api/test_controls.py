"""Cells that must agree: how far they may differ."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from study.api import assemble


@pytest.mark.parametrize(
    ("difference", "u_steps", "outcome"),
    [
        (0.0, None, "pass"),
        (5e-6, None, "pass"),
        (5e-5, None, "fail"),
        # both curves say that their interpolation between load steps may be off by this much
        (5e-5, 3e-5, "pass"),
        (5e-5, 1e-5, "fail"),
    ],
)
def test_they_may_differ_by_solver_and_interpolation(
    monkeypatch: pytest.MonkeyPatch, difference: float, u_steps: float | None, outcome: str
) -> None:
    cells = [SimpleNamespace(levels={"space": space}) for space in ("axisymmetric", "3d")]
    monkeypatch.setattr(assemble, "equivalent_groups", lambda _: [cells])

    def record(space: str, value: float) -> Any:
        response = {"value": value, "unit": "N", "u_steps": u_steps}
        return SimpleNamespace(
            levels={"space": space}, block="1", converged=True,
            responses={"rms_force_error": response}, value=lambda _: value,
        )  # fmt: skip

    records = (record("axisymmetric", 1.0), record("3d", 1.0 + difference))
    (check,) = assemble._controls(SimpleNamespace(), records)  # type: ignore[arg-type]
    assert check.outcome == outcome
