"""The verb invert against a cylinder whose force is known by hand."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from study.api import optimizing
from study.statistics.surfaces import surface_inversion
from study.statistics.surfaces.surface_factors import NumericFactor, Runs
from study.statistics.surfaces.surface_inversion import agreeing
from study.statistics.surfaces.surface_profile import fit_curves
from tests.cli.small import Finished, study

KNOWN = "specimen.radius=10.2 mm, specimen.height=19.5 mm"


def _curve(displacement: np.ndarray) -> np.ndarray:
    """Force in N of C10 7.3 kPa, radius 10.2 mm, height 19.5 mm (Treloar 1975)."""
    stretch = 1 - displacement / 19.5
    return np.asarray(np.pi * 10.2**2 * 2e-3 * 7.3 * (stretch**-2 - stretch))


@pytest.fixture(scope="module")
def folder(ranges: Finished, tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("inversion") / "copy"
    shutil.copytree(ranges.folder, home)
    d = np.linspace(0.25, 3.0, 12)
    rows = [f"{x:.6g},{f:.8g}" for x, f in zip(d, _curve(d), strict=True)]
    (home / "m.csv").write_text("\n".join(["displacement_mm,force_N", *rows]))
    return home


def test_a_constant_is_found_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    answer = study("invert", "ranges", "--to", "m.csv", "--at", KNOWN, "--json")
    assert answer.code == 0, answer.err
    (one,) = answer.json["inputs"]
    assert one["name"] == "material.C10"
    assert one["verdict"] == "determined"
    assert one["low"] <= 7.3 <= one["high"]
    assert one["best"] == pytest.approx(7.3, rel=1e-3)
    assert answer.json["combinations"] == []
    assert answer.json["best_run"]["agrees"]


LONG = (pytest.mark.slow, pytest.mark.verify)


@pytest.mark.parametrize("runs", [0, pytest.param(2, marks=LONG)])
def test_a_set_is_told_where_only_a_product_is_determined(
    folder: Path, monkeypatch: pytest.MonkeyPatch, runs: int
) -> None:
    """At a known height the force is that of C10 times the square of the radius."""
    monkeypatch.chdir(folder)
    known = ("--at", "specimen.height=19.5 mm", *(() if runs else ("--no-confirm",)))
    answer = study("invert", "ranges", "--to", "m.csv", *known, "--json")
    assert answer.code == 0, answer.err
    found = {one["name"]: one for one in answer.json["inputs"]}
    assert {one["verdict"] for one in found.values()} == {"not determined"}
    (told,) = answer.json["combinations"]
    assert told["exponents"] == pytest.approx(
        {"material.C10": 1.0, "specimen.radius": 2.0}, abs=0.01
    )
    assert told["value"] == pytest.approx(7.3 * 1.02**2, rel=5e-3)
    assert told["ratio"] < 1.02
    # every radius that was run has its constant, and the true model agrees at both ends
    for end in ("low", "high"):
        other = {"low": "high", "high": "low"}[end]
        radius = found["specimen.radius"][other]
        assert found["material.C10"][end] == pytest.approx(7.3 * (1.02 / radius) ** 2, rel=2e-3)
    assert len(answer.json["end_runs"]) == runs
    assert all(run["agrees"] for run in answer.json["end_runs"])
    assert "it determines material.C10 * specimen.radius^2" in answer.json["sentence"]
    members = answer.json["members"]
    products = [one["material.C10"] * one["specimen.radius"] ** 2 for one in members]
    np.testing.assert_allclose(products, 7.3 * 1.02**2, rtol=5e-3)


def test_an_inversion_that_has_not_settled_says_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    asked = ("invert", "ranges", "--to", "m.csv", "--at", KNOWN)
    with monkeypatch.context() as patch:
        patch.setattr(surface_inversion, "EVALUATIONS", 1)
        patch.setattr(surface_inversion, "SEARCHES", 1)
        patch.setattr(surface_inversion, "NEGLIGIBLE", -1.0)
        answer = study(*asked)
        assert answer.code == 3
        assert "nearest to the measured one: the search has not converged" in answer.err
    # a true model that no emulator of these runs comes near
    with monkeypatch.context() as patch:
        force = optimizing._force
        patch.setattr(optimizing, "_force", lambda record, curve: 1.2 * force(record, curve))
        answer = study(*asked, "--json")
    assert answer.code == 1, answer.err
    (note,) = [one for one in answer.json["notes"] if one.startswith("after 4 runs")]
    assert "the emulator still misses the true model there by" in note


def test_what_cannot_be_inverted_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    (folder / "back.csv").write_text("displacement_mm,force_N\n1,1\n2,2\n1.5,1\n")
    (folder / "far.csv").write_text("displacement_mm,force_N\n1,1\n4,2\n5,3\n")
    (folder / "stiff.csv").write_text("displacement_mm,force_N\n1,10\n2,20\n3,30\n")
    every = KNOWN + ", material.C10=7 kPa"
    for arguments, code, said in (
        (("back.csv",), 2, "back.csv:4: column 'displacement_mm': displacements must increase"),
        (("far.csv",), 2, "where the runs end"),
        (("stiff.csv", "--within", "2 %"), 3, "no curve inside of what was run agrees"),
        (("m.csv", "--at", every), 2, "holds every number"),
        (("m.csv", "--at", "specimen.heigth=3 mm"), 2, "specimen.height"),
        (("m.csv", "--units", "N,mm"), 2, "length"),
    ):
        answer = study("invert", "ranges", "--to", *arguments, "--no-confirm")
        assert answer.code == code, answer.err
        assert said in answer.err


def test_every_branch_of_a_set_is_traced() -> None:
    factors = (NumericFactor("a", 5, 15), NumericFactor("b", 1, 3))
    cube = qmc.LatinHypercube(2, rng=np.random.default_rng(4), optimization="random-cd").random(60)
    a, b = 5 + 10 * cube[:, 0], 1 + 2 * cube[:, 1]
    depth = np.linspace(0.1, 1, 12)

    def curve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return depth * (1 + (a[:, None] - 10) ** 2 / 25) + depth**2 * b[:, None]

    model = fit_curves(Runs("force", factors, 2 * cube - 1, np.zeros(60)), curve(a, b))
    measured = curve(np.array([7.0]), np.array([2.0]))[0]
    found = agreeing(model, measured, np.full(2, np.nan), largest=0.02)
    settings = np.array([factors[0].setting(float(x)) for x in found.points[:, 0]])
    assert np.abs(settings - 7).min() < 0.2
    assert np.abs(settings - 13).min() < 0.2
    assert factors[0].setting(float(found.low[0])) == pytest.approx(7, abs=0.5)
    assert factors[0].setting(float(found.high[0])) == pytest.approx(13, abs=0.5)
    # no member lies outside what is told, and none breaks a rule
    grid = 2 * np.random.default_rng(1).random((4000, 2)) - 1
    grid = grid[np.abs(model.value(grid) - measured).max(axis=1) < 0.02]
    assert len(grid) > 0
    inside = np.abs(grid) < np.abs(2 * cube - 1).max(axis=0)
    members = np.vstack([found.points, grid[inside.all(axis=1)]])
    assert (found.points >= found.low - 1e-12).all()
    assert (found.points <= found.high + 1e-12).all()
    for rule in found.combinations:
        logs = np.log([[f.setting(float(x)) for f, x in zip(factors, one, strict=True)]
                       for one in members])  # fmt: skip
        off = np.abs(logs @ [rule.exponents[f.name] for f in factors] - np.log(rule.value))
        assert off.max() <= np.log(rule.ratio) * (1 + 1e-9)
