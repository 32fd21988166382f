"""Compiled loops of this process: loaded before a clock starts, so that none of them is timed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from study.runner import fits

#: spaces, families and tests whose compiled loops this process has used already
_LOADED: set[tuple[str, ...]] = set()


def load_compiled(problem: Any) -> None:
    """Solve a small relative of a problem, once for each kind."""
    key = (problem.model.space, problem.material.family, problem.test.kind)
    if key in _LOADED:
        return
    _LOADED.add(key)
    test = replace(problem.test, steps=1, displacement_mm=problem.test.displacement_mm / 50)
    model = replace(problem.model, mesh="coarse", mesh_size_mm=None)
    fits.solve(replace(problem, test=test, model=model), gradients=False)
