"""The verb optimize against optima that are known by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from study.statistics.surfaces import surface_optimum
from tests.cli.small import study
from tests.cli.test_numeric_factors import DESIGN, _force
from tests.response_surface.functions import hypercube


def _bowl(folder: Path) -> str:
    """f has its least value 1 at (3, 2); c is x + y."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 5, 5), np.linspace(0, 5, 5)))
    frame = pd.DataFrame({"x": x, "y": y, "f": (x - 3) ** 2 + (y - 2) ** 2 + 1, "c": x + y})
    frame.to_csv(folder / "bowl.csv", index=False)
    return str(folder / "bowl.csv")


def test_a_limit_moves_the_optimum_to_the_point_of_lagrange(tmp_path: Path) -> None:
    # x + y <= 3: (3, 2) moves along (1, 1) to (2, 1), where f = 3; the multiplier is 2
    asked = ("optimize", _bowl(tmp_path), "--numeric", "x,y", "--minimize", "f", "--json")
    free = study(*asked)
    (one,) = free.json["recommendations"]
    assert one["settings"] == pytest.approx({"x": 3.0, "y": 2.0}, abs=1e-5)
    assert one["value"] == pytest.approx(1.0, abs=1e-9)
    bound = study(*asked, "--subject-to", "c <= 3")
    (one,) = bound.json["recommendations"]
    assert one["settings"] == pytest.approx({"x": 2.0, "y": 1.0}, abs=1e-5)
    assert one["value"] == pytest.approx(3.0, abs=1e-5)
    assert one["limits_hold"] == "surely"
    assert "confirm it by a run at x = 2, y = 1" in bound.err


def test_a_search_that_has_not_converged_recommends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surface_optimum, "STEPS", 1)
    asked = ("optimize", _bowl(tmp_path), "--numeric", "x,y", "--minimize", "f")
    answer = study(*asked, "--subject-to", "c <= 3")
    assert answer.code == 3
    assert "the search for the best setting has not converged in 1 steps" in answer.err


def test_a_held_factor_and_an_end_of_the_range(tmp_path: Path) -> None:
    answer = study("optimize", _bowl(tmp_path), "--numeric", "x,y", "--maximize", "f",
                   "--at", "x=3", "--json")  # fmt: skip
    (one,) = answer.json["recommendations"]
    assert one["settings"] == pytest.approx({"y": 5.0})
    assert one["value"] == pytest.approx(10.0)
    assert one["at_end_of_range"] == ["y"]


def test_an_emulator_finds_one_of_the_minima_of_branin(tmp_path: Path) -> None:
    # Dixon and Szego 1978: .397887 at (-pi, 12.275), (pi, 2.275), (9.42478, 2.475)
    u = hypercube(2, 80, 1)
    x, y = -5 + 15 * u[:, 0], 15 * u[:, 1]
    wave = 10 * (1 - 1 / (8 * np.pi)) * np.cos(x) + 10
    value = (y - 5.1 / (4 * np.pi**2) * x**2 + 5 / np.pi * x - 6) ** 2 + wave
    pd.DataFrame({"x": x, "y": y, "b": value}).to_csv(tmp_path / "branin.csv", index=False)
    answer = study("optimize", str(tmp_path / "branin.csv"), "--numeric", "x=-5..10,y=0..15",
                   "--minimize", "b", "--json")  # fmt: skip
    (one,) = answer.json["recommendations"]
    assert one["low"] <= 0.397887 <= one["high"]
    found = np.array([one["settings"]["x"], one["settings"]["y"]])
    minima = np.array([[-np.pi, 12.275], [np.pi, 2.275], [9.42478, 2.475]])
    assert np.abs(minima - found).max(axis=1).min() < 0.02


def test_what_cannot_be_optimized_is_refused(tmp_path: Path) -> None:
    bowl = _bowl(tmp_path)
    rng = np.random.default_rng(0)
    noise = pd.DataFrame(rng.random((30, 3)), columns=["x", "y", "f"])
    noise.to_csv(tmp_path / "noise.csv", index=False)
    for arguments, code, said in (
        ((bowl, "--minimize", "f", "--subject-to", "c >= 11"), 3, "nearest: c 10"),
        ((str(tmp_path / "noise.csv"), "--minimize", "f"), 3, "Q2"),
        ((bowl, "--minimize", "f", "--maximize", "c"), 2, "one response"),
        ((bowl, "--minimize", "f", "--subject-to", "c = 3"), 2, "cannot read"),
        ((bowl, "--minimize", "g"), 2, "'g'"),
        ((bowl, "--minimize", "f", "--at", "x=6"), 2, "outside the settings that were run"),
    ):
        answer = study("optimize", *arguments, "--numeric", "x,y")
        assert answer.code == code, answer.err
        assert said in answer.err


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Geometry is a choice, the constant an unknown."""
    home = tmp_path_factory.mktemp("optimum")
    text = DESIGN.replace('name = "ranges"', 'name = "ranges"\nassumed = ["material"]')
    asked = '[[response]]\nname = "stiffness_at"\ndisplacement = "3 mm"\n[report]'
    (home / "ranges.toml").write_text(text.replace("[report]", asked))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        answer = study("run", "ranges.toml", "--jobs", 1, "--json")
    assert answer.code == 0, answer.err
    return home


def test_a_study_recommends_choices_alone_and_runs_the_best(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Least force with a stiffness of at least .25 N/mm, by the closed form on a fine grid."""
    monkeypatch.chdir(folder)
    answer = study("optimize", "ranges", "--minimize", "peak_force", "--at",
                   "material.C10=7.5 kPa", "--subject-to", "stiffness_at >= 250 N/m",
                   "--json")  # fmt: skip
    assert answer.code == 0, answer.err
    (one,) = answer.json["recommendations"]
    assert set(one["settings"]) == {"specimen.radius", "specimen.height"}
    assert one["held"] == pytest.approx({"material.C10": 7.5})
    radius, height = np.meshgrid(np.linspace(9.05, 10.95, 400), np.linspace(18.1, 21.9, 400))
    force = _force(7.5, radius, height)
    stretch = 1 - 3.0 / height
    stiffness = np.pi * radius**2 * 15e-3 * (2 * stretch**-3 + 1) / height
    best = force[stiffness >= 0.25].min()
    assert one["value"] == pytest.approx(best, rel=0.01)
    run = one["confirmed"]
    assert run["inside_interval"]
    assert run["keeps_limits"]
    at = {name: float(label.split()[0]) for name, label in run["settings"].items()}
    exact = _force(7.5, 10 * at["specimen.radius"], at["specimen.height"])
    assert run["values"]["peak_force"] == pytest.approx(exact, rel=2e-3)
    # the run has joined: the surfaces now rest on 31 runs
    after = study("report", "ranges", "--json")
    assert {one["runs"] for one in after.json["surfaces"]} == {31}
    assert after.json["cases"]["total"] == 30


def test_an_unknown_is_not_recommended(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    asked = ("optimize", "ranges", "--minimize", "peak_force", "--no-confirm", "--json")
    (one,) = study(*asked).json["recommendations"]
    # as the file has it, or the nearest that was run
    assert one["held"] == pytest.approx({"material.C10": 5.0}, rel=0.03)
    spread = one["over_what_is_not_chosen"]
    assert spread["high"] / spread["low"] == pytest.approx(2.0, rel=0.1)
    every = study(*asked, "--at", "specimen.radius=10 mm, specimen.height=20 mm")
    assert every.code == 2
    assert "no factor is a choice" in every.err
    wrong = study(*asked, "--subject-to", "stiffness_at >= 3 N")
    assert wrong.code == 2
    assert "stiffness" in wrong.err
