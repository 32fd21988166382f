"""The verbs optimize and invert against optima and constants that are known by hand."""

import shutil

import numpy as np
import pandas as pd
import pytest
from scipy.stats import qmc

from study.api import optimizing
from study.statistics.surfaces import surface_optimum
from study.statistics.surfaces.surface_factors import NumericFactor, Runs
from study.statistics.surfaces.surface_optimum import NearestCurves, agreeing, fit_curves
from tests.cli.small import refusal, study, success
from tests.cli.test_numeric_factors import DESIGN, _force
from tests.response_surface.functions import hypercube

BOWL = "optimize bowl.csv --numeric x,y"


@pytest.fixture
def bowl(inside):
    """f has its least value 1 at (3, 2); c is x + y."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 5, 5), np.linspace(0, 5, 5)))
    frame = pd.DataFrame({"x": x, "y": y, "f": (x - 3) ** 2 + (y - 2) ** 2 + 1, "c": x + y})
    frame.to_csv("bowl.csv", index=False)


@pytest.mark.parametrize(
    ("asked", "settings", "value", "near"),
    [
        ("--minimize f", {"x": 3.0, "y": 2.0}, 1.0, 1e-9),
        # x + y <= 3: (3, 2) moves along (1, 1) to (2, 1), where f = 3; the multiplier is 2
        ("--minimize f --subject-to 'c <= 3'", {"x": 2.0, "y": 1.0}, 3.0, 1e-5),
        ("--maximize f --at x=3", {"y": 5.0}, 10.0, 1e-5),
    ],
)
@pytest.mark.usefixtures("bowl")
def test_an_optimum_is_that_of_the_bowl(asked, settings, value, near):
    answer = success(f"{BOWL} {asked} --json")
    (one,) = answer.json["recommendations"]
    assert one["settings"] == pytest.approx(settings, abs=1e-5)
    assert one["value"] == pytest.approx(value, abs=near)
    assert one["at_end_of_range"] == (["y"] if "at" in asked else [])
    if "c <=" in asked:
        assert one["limits_hold"] == "surely"
        assert "confirm it by a run at x = 2, y = 1" in answer.err


@pytest.mark.usefixtures("bowl")
def test_a_search_that_has_not_converged_recommends_nothing(monkeypatch):
    monkeypatch.setattr(surface_optimum, "STEPS", 1)
    answer = study(f"{BOWL} --minimize f --subject-to 'c <= 3'")
    assert answer.code == 3
    assert "the search for the best setting has not converged in 1 steps" in answer.err


def test_an_emulator_finds_one_of_the_minima_of_branin(tmp_path):
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


@pytest.mark.usefixtures("bowl")
def test_what_cannot_be_optimized_is_refused():
    rng = np.random.default_rng(0)
    noise = pd.DataFrame(rng.random((30, 3)), columns=["x", "y", "f"])
    noise.to_csv("noise.csv", index=False)
    for asked, code, said in (
        ("bowl.csv --minimize f --subject-to 'c >= 11'", 3, "nearest: c 10"),
        ("noise.csv --minimize f", 3, "Q2"),
        ("bowl.csv --minimize f --maximize c", 2, "one response"),
        ("bowl.csv --minimize f --subject-to 'c = 3'", 2, "cannot read"),
        ("bowl.csv --minimize g", 2, "'g'"),
        ("bowl.csv --minimize f --at x=6", 2, "outside the settings that were run"),
    ):
        answer = study(f"optimize {asked} --numeric x,y")
        assert answer.code == code, answer.err
        assert said in answer.err


@pytest.fixture(scope="module")
def ranged(tmp_path_factory):
    """Geometry is a choice, the constant an unknown."""
    home = tmp_path_factory.mktemp("optimum")
    text = DESIGN.replace('name = "ranges"', 'name = "ranges"\nassumed = ["material"]')
    asked = '[[response]]\nname = "stiffness_at"\ndisplacement = "3 mm"\n[report]'
    (home / "ranges.toml").write_text(text.replace("[report]", asked))
    success("run", "ranges.toml", "--jobs", 1, "--json", folder=home)
    return home


def test_a_study_recommends_choices_alone_and_runs_the_best(ranged):
    """Least force with a stiffness of at least .25 N/mm, by the closed form on a fine grid."""
    answer = success("optimize", "ranges", "--minimize", "peak_force", "--at",
                     "material.C10=7.5 kPa", "--subject-to", "stiffness_at >= 250 N/m",
                     "--json", folder=ranged)  # fmt: skip
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
    after = success("report", "ranges", "--json", folder=ranged)
    assert {one["runs"] for one in after.json["surfaces"]} == {31}
    assert after.json["cases"]["total"] == 30


def test_an_unknown_is_not_recommended(ranged, monkeypatch):
    monkeypatch.chdir(ranged)
    asked = ("optimize", "ranges", "--minimize", "peak_force", "--no-confirm", "--json")
    (one,) = study(*asked).json["recommendations"]
    # as the file has it, or the nearest that was run
    assert one["held"] == pytest.approx({"material.C10": 5.0}, rel=0.03)
    spread = one["over_what_is_not_chosen"]
    assert spread["high"] / spread["low"] == pytest.approx(2.0, rel=0.1)
    every = refusal(*asked, "--at", "specimen.radius=10 mm, specimen.height=20 mm")
    assert "no factor is a choice" in every.err
    wrong = refusal(*asked, "--subject-to", "stiffness_at >= 3 N")
    assert "stiffness" in wrong.err


KNOWN = "specimen.radius=10.2 mm, specimen.height=19.5 mm"


def _curve(displacement):
    """Force in N of C10 7.3 kPa, radius 10.2 mm, height 19.5 mm (Treloar 1975)."""
    stretch = 1 - displacement / 19.5
    return np.asarray(np.pi * 10.2**2 * 2e-3 * 7.3 * (stretch**-2 - stretch))


@pytest.fixture(scope="module")
def measured(ranges, tmp_path_factory):
    home = tmp_path_factory.mktemp("inversion") / "copy"
    shutil.copytree(ranges.folder, home)
    d = np.linspace(0.25, 3.0, 12)
    rows = [f"{x:.6g},{f:.8g}" for x, f in zip(d, _curve(d), strict=True)]
    (home / "m.csv").write_text("\n".join(["displacement_mm,force_N", *rows]))
    return home


@pytest.fixture
def here(measured, monkeypatch):
    monkeypatch.chdir(measured)
    return measured


@pytest.mark.usefixtures("here")
def test_a_constant_is_found_again():
    answer = success("invert", "ranges", "--to", "m.csv", "--at", KNOWN, "--json")
    (one,) = answer.json["inputs"]
    assert one["name"] == "material.C10"
    assert one["verdict"] == "determined"
    assert one["low"] <= 7.3 <= one["high"]
    assert one["best"] == pytest.approx(7.3, rel=1e-3)
    assert answer.json["combinations"] == []
    assert answer.json["best_run"]["agrees"]


LONG = (pytest.mark.slow, pytest.mark.verify)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("runs", [0, pytest.param(2, marks=LONG)])
def test_a_set_is_told_where_only_a_product_is_determined(runs):
    """At a known height the force is that of C10 times the square of the radius."""
    known = ("--at", "specimen.height=19.5 mm", *(() if runs else ("--no-confirm",)))
    answer = success("invert", "ranges", "--to", "m.csv", *known, "--json")
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


@pytest.mark.usefixtures("here")
def test_an_inversion_that_has_not_settled_says_so(monkeypatch):
    asked = ("invert", "ranges", "--to", "m.csv", "--at", KNOWN)
    with monkeypatch.context() as patch:
        patch.setattr(surface_optimum, "EVALUATIONS", 1)
        patch.setattr(surface_optimum, "SEARCHES", 1)
        patch.setattr(surface_optimum, "NEGLIGIBLE", -1.0)
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


@pytest.mark.parametrize(
    ("read_at", "sentence", "note"),
    [
        (lambda d: _curve(d), "the curve determines every input", ""),
        (lambda d: 2.5 * _curve(d), "use no input of it", "misses 45"),  # of 18 kPa
        (lambda d: -_curve(d), "use no input of it", "units, zero and sign"),
        # a load cell that was not zeroed, and one that drifts by a tenth
        (lambda d: _curve(d) + 0.3, "it is doubtful that the model", "along a line that no noise"),
        (lambda d: _curve(d) * (1 + d / 30), "it is doubtful that", "misses 1.8 % of the"),
    ],
    ids=["true", "outside", "negative", "zero", "drift"],
)
def test_a_curve_that_no_input_gives_is_said_to_be_none(here, read_at, sentence, note):
    """C10 of 7.3 kPa was 8.53 and 7.88 [7.65, 8.11] kPa, and every input "determined"."""
    d = np.linspace(0.25, 3.0, 12)
    rows = "".join(f"{x:.6g},{f:.8g}\n" for x, f in zip(d, read_at(d), strict=True))
    (here / "other.csv").write_text(f"displacement_mm,force_N\n{rows}")
    answer = success(
        "invert", "ranges", "--to", "other.csv", "--at", KNOWN, "--no-confirm", "--json"
    )
    assert sentence in answer.json["sentence"]
    assert note in " ".join(answer.json["notes"])
    assert answer.json["combinations"] == []


def test_a_column_of_another_unit_is_no_curve_to_invert(here):
    (here / "grams.csv").write_text("displacement_mm,force_gf\n1,1\n2,2\n3,3\n")
    asked = ("invert", "ranges", "--to", "grams.csv", "--columns", "displacement_mm,force_gf")
    assert "says gf, and it is read in N" in refusal(*asked, "--no-confirm").err


def test_what_cannot_be_inverted_is_refused(here):
    (here / "back.csv").write_text("displacement_mm,force_N\n1,1\n2,2\n1.5,1\n")
    (here / "far.csv").write_text("displacement_mm,force_N\n1,1\n4,2\n5,3\n")
    (here / "none.csv").write_text("displacement_mm,force_N\n1,1e-300\n2,2e-300\n3,3e-300\n")
    (here / "stiff.csv").write_text("displacement_mm,force_N\n1,10\n2,20\n3,30\n")
    every = KNOWN + ", material.C10=7 kPa"
    for arguments, code, said in (
        (("back.csv",), 2, "back.csv:4: column 'displacement_mm': displacements must increase"),
        (("far.csv",), 2, "where the runs end"),
        (("none.csv",), 2, "its largest force, 3e-300 N, is none beside the"),
        (("stiff.csv", "--within", "2 %"), 3, "no curve inside of what was run agrees"),
        (("m.csv", "--at", every), 2, "holds every number"),
        (("m.csv", "--at", "specimen.heigth=3 mm"), 2, "specimen.height"),
        (("m.csv", "--units", "N,mm"), 2, "length"),
    ):
        answer = study("invert", "ranges", "--to", *arguments, "--no-confirm")
        assert answer.code == code, answer.err
        assert said in answer.err


@pytest.mark.parametrize("seed", [6, 10])
def test_a_bent_set_ends_where_a_grid_says(seed):
    rng = np.random.default_rng(seed)
    cube = qmc.LatinHypercube(2, rng=rng).random(60)
    powers = rng.normal(size=5) * [1, 1, 1.5, 1.5, 1]
    depth = np.linspace(0.1, 1, 8)

    def curve(coded):
        x, y = coded.T
        return 5 + np.outer(np.array([x, y, x * x, y * y, x * y]).T @ powers, depth)

    factors = (NumericFactor("a", 0, 1), NumericFactor("b", 0, 1))
    model = fit_curves(Runs("force", factors, 2 * cube - 1, np.zeros(60)), curve(2 * cube - 1))
    measured = curve(2 * rng.random((1, 2)) - 1)[0]
    nearest = NearestCurves.of(model, measured, np.full(2, np.nan))
    answer = agreeing(nearest, largest=0.03)
    axes = np.linspace(nearest.space.low, nearest.space.high, 301).T
    grid = np.array(np.meshgrid(*axes)).reshape(2, -1).T
    agree = grid[nearest.each_rms(grid) <= 0.03]
    np.testing.assert_allclose(answer.low, agree.min(axis=0), atol=0.015)
    np.testing.assert_allclose(answer.high, agree.max(axis=0), atol=0.015)


def test_every_branch_of_a_set_is_traced():
    factors = (NumericFactor("a", 5, 15), NumericFactor("b", 1, 3))
    cube = qmc.LatinHypercube(2, rng=np.random.default_rng(4), optimization="random-cd").random(60)
    a, b = 5 + 10 * cube[:, 0], 1 + 2 * cube[:, 1]
    depth = np.linspace(0.1, 1, 12)

    def curve(a, b):
        return depth * (1 + (a[:, None] - 10) ** 2 / 25) + depth**2 * b[:, None]

    model = fit_curves(Runs("force", factors, 2 * cube - 1, np.zeros(60)), curve(a, b))
    measured = curve(np.array([7.0]), np.array([2.0]))[0]
    found = agreeing(NearestCurves.of(model, measured, np.full(2, np.nan)), largest=0.02)
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


def test_an_input_is_determined_where_others_make_up_for_each_other():
    """Force k d (1 + a d^2) / (1 + b): k and b go to the ends of the runs, and a stays where it is.

    The set is an ellipse in k / (1 + b) and a k / (1 + b), in which the force is linear.
    """
    factors = (NumericFactor("k", 1, 6), NumericFactor("a", 0.5, 2.5), NumericFactor("b", 0, 1))
    depth, cube = np.linspace(0.1, 2, 15), hypercube(3, 60, 3)
    k, a, b = (f.low + (f.high - f.low) * x for f, x in zip(factors, cube.T, strict=True))
    basis = np.column_stack([depth, depth**3])
    model = fit_curves(
        Runs("force", factors, 2 * cube - 1, np.zeros(60)),
        np.column_stack([k, k * a]) / (1 + b)[:, None] @ basis.T,
    )
    center = np.array([3.3, 3.3 * 1.2]) / 1.4
    measured = basis @ center
    largest = 0.01 * float(np.sqrt((measured**2).mean()))
    found = agreeing(NearestCurves.of(model, measured, np.full(3, np.nan)), largest=largest)
    np.testing.assert_array_equal(found.open_low, [True, False, True])
    np.testing.assert_array_equal(found.open_high, [True, False, True])
    turns = np.linspace(0, 2 * np.pi, 2001)
    circle = np.sqrt(depth.size) * largest * np.array([np.cos(turns), np.sin(turns)])
    edge = center[:, None] + np.linalg.solve(np.linalg.qr(basis)[1], circle)
    ends = [factors[1].setting(float(end[1])) for end in (found.low, found.high)]
    exact = edge[1] / edge[0]
    assert ends == pytest.approx([exact.min(), exact.max()], abs=0.01)
