"""Ranges in a study file: runs, surface, predictions, against the closed form of the test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import study as public
from study.api.fitting_surfaces import surfaces
from tests.cli.small import Answer, Finished, study

#: an incompressible cylinder between frictionless plates: its force is known by hand
DESIGN = """
schema = 1
[study]
name = "ranges"
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "20 mm"
[test]
kind = "compression"
interface = "frictionless"
displacement = "3 mm"
steps = 2
[material]
model = "neo-hookean"
C10 = "5 kPa"
incompressible = true
[forward]
model = "closed-form"
[factors]
material.C10 = { low = "5 kPa", high = "10 kPa" }
specimen.radius = { low = "0.9 cm", high = "1.1 cm" }
specimen.height = { low = "18 mm", high = "22 mm" }
[design]
kind = "latin-hypercube"
runs = 30
[[response]]
name = "peak_force"
practical = "0.05 N"
[report]
format = ["csv"]
"""
FACTORS = ("material.C10", "specimen.radius", "specimen.height")
CENTRE = "material.C10=7.3 kPa, specimen.radius=10.2 mm, specimen.height=19.5 mm"


def _force(c10_kPa, radius_mm, height_mm):  # type: ignore[no-untyped-def]  # noqa: N803
    """Force in N at 3 mm (Treloar 1975, The Physics of Rubber Elasticity)."""
    stretch = 1 - 3.0 / height_mm
    return np.pi * radius_mm**2 * 2e-3 * c10_kPa * (stretch**-2 - stretch)


def _shares() -> list[float]:
    """Total indices on a grid: the force is a product, so its variance is one of products."""
    x = (np.arange(400) + 0.5) / 400
    parts = (5 + 5 * x, (9 + 2 * x) ** 2, _force(1.0, 1.0, 18 + 4 * x))
    spread = [float(np.var(p) / np.mean(p) ** 2) for p in parts]
    whole = np.prod([1 + s for s in spread]) - 1
    return [float(1 - (np.prod([1 + s for s in spread]) / (1 + s) - 1) / whole) for s in spread]


#: distributions of two of its inputs
UNCERTAIN = """
[uncertainty]
material.C10 = { distribution = "normal", mean = "7 kPa", sd = "0.4 kPa" }
specimen.radius = { distribution = "uniform", low = "9.8 mm", high = "10.2 mm" }
"""


@pytest.fixture
def folder(ranges: Finished) -> Path:
    return ranges.folder


@pytest.fixture
def ran(ranges: Finished) -> Answer:
    return ranges.answer


def test_total_indices_are_those_of_the_closed_form(ran: Answer) -> None:
    assert ran.code == 0, ran.err
    (surface,) = ran.json["surfaces"]
    assert surface["surface"]["kind"] == "emulator"
    assert surface["surface"]["q2"] > 0.99
    assert surface["runs"] == 30
    told = {row["factor"]: row for row in surface["sensitivity"]}
    for name, share in zip(FACTORS, _shares(), strict=True):
        low, high = told[name]["T_interval"]
        assert low <= share <= high, name
    shown = {row["factor"]: row for row in ran.json["verdicts"]}
    assert set(shown) == set(FACTORS)
    assert all(row["p"] is None for row in shown.values())
    # the least effect of the radius: 2 mm at the softest and tallest, six times what matters
    assert shown["specimen.radius"]["verdict"] == "matters, if confirmed"


def test_a_prediction_is_the_closed_form_within_its_interval(
    ran: Answer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    answer = study("predict", "ranges", "--at", CENTRE, "--json")
    assert answer.code == 0, answer.err
    (found,) = answer.json["predictions"]
    assert found["low"] <= _force(7.3, 10.2, 19.5) <= found["high"]
    assert found["high"] - found["low"] < 0.02 * found["value"]

    rng = np.random.default_rng(7)
    at = dict(
        zip(FACTORS, rng.uniform([5.2, 0.92, 18.2], [9.8, 1.08, 21.8], (200, 3)).T, strict=True)
    )
    (many,) = public.predict("ranges", at)
    c10, radius_cm, height = at.values()
    exact = _force(c10, 10 * radius_cm, height)
    assert np.mean((many.low <= exact) & (exact <= many.high)) >= 0.95


@pytest.mark.parametrize(
    ("at", "told"),
    [
        (CENTRE.replace("7.3", "11"), "outside the settings that were run"),
        (CENTRE.replace("7.3 kPa", "7.3 mm"), "must be a pressure"),
        (CENTRE.replace("radius", "raduis"), "specimen.radius"),
        (CENTRE.split(", ", maxsplit=1)[0], "has no setting"),
        ("material.C10", "cannot read"),
    ],
)
def test_what_cannot_be_predicted_is_refused(
    ran: Answer, folder: Path, monkeypatch: pytest.MonkeyPatch, at: str, told: str
) -> None:
    monkeypatch.chdir(folder)
    answer = study("predict", "ranges", "--at", at, "--json")
    assert answer.code == 2
    assert told in answer.err


def test_a_failed_run_is_left_out_and_said(
    ran: Answer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    opened = public.report("ranges", reports=None)
    first, *rest = opened.records
    lost = replace(first, status="unstable", responses={"peak_force": {"value": None, "unit": "N"}})
    (found,) = surfaces(opened.design, [lost, *rest], opened.numerical)
    assert found.found is not None
    assert found.found.runs.response.size == 29
    assert any("1 run without an answer left out" in note for note in found.found.notes)


def test_a_surface_without_a_range_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    start, end = DESIGN.index("[factors]"), DESIGN.index("[[response]]")
    factors = '[factors]\nmaterial.C10 = ["5 kPa", "10 kPa"]\n[analysis]\nsurface = "emulator"\n'
    (tmp_path / "ranges.toml").write_text(DESIGN[:start] + factors + DESIGN[end:])
    answer = study("plan", "ranges.toml", "--json")
    assert answer.code == 2
    assert "analysis.surface: no factor is a range" in answer.err
