"""Studies of a function: runs that confirm, cells that are added, and combinations that fail."""

import inspect
import json

import numpy as np
import pytest

import study as public
from study.api.predicting import Permission
from study.external.command import PythonFunction
from study.ground.canonical import plain
from study.record.store import Store
from study.simulation.job import Allowed
from study.statistics.surfaces.emulator import fit_together
from study.statistics.surfaces.surface_result import level_difference
from tests.cli.small import CSV, measured, pressed, responses, study, success
from tests.response_surface import functions

#: the force is a product of functions of four inputs, one of which is no number
DESIGN = pressed(
    """[material]
model = "reduced-polynomial"
C10 = "5 kPa"
C20 = "1 kPa"
poisson_ratio = 0.45
[forward]
model = "python"
[factors]
material.C10 = { low = "5 kPa", high = "15 kPa" }
material.C20 = { low = "1 kPa", high = "3 kPa" }
specimen.height = { low = "18 mm", high = "22 mm" }
test.interface = ["frictionless", "bonded"]
[design]
kind = "latin-hypercube"
runs = 48
"""
    + responses(peak_force="0.2 N")
    + CSV,
    study='[study]\nname = "product"\n',
    test='displacement = "1 mm"\nsteps = 1\n',
)

COMMAND = (
    DESIGN.replace(
        'model = "python"',
        'model = "command"\nargv = [["python", "-I", "-S", "product.py"]]\nfiles = ["product.py"]',
    )
    .replace('material.C20 = { low = "1 kPa", high = "3 kPa" }\n', "")
    .replace('test.interface = ["frictionless", "bonded"]\n', "")
    .replace("runs = 48", "runs = 10")
)

BLOCKED = (
    DESIGN.replace(
        '[forward]\nmodel = "python"\n',
        measured("m.csv")
        + 'block = "mix"\npoints = 10\nrange = ["1 %", "10 %"]\n[calibration]\nmethod = "none"\n',
    )
    .replace('displacement = "1 mm"\n', "")
    .replace("poisson_ratio = 0.45", "incompressible = true")
)
BLOCKED = (
    BLOCKED[: BLOCKED.index("material.C20 = {")]
    + '[design]\nkind = "latin-hypercube"\nruns = 12\n'
    + responses(relative_rms_force_error="1 pp")
    + CSV
)


#: means and mean squares of exp(x), 1.25 + y/2 and 2 + z^2 over the unit box, and points there
MEANS = np.array([np.e - 1, 1.5, 7 / 3])
SQUARES = np.array([(np.e**2 - 1) / 2, (1.75**3 - 1.25**3) / 1.5, 4 + 4 / 3 + 1 / 5])
X = np.random.default_rng(5).random((4000, 3))


def forward(problem):
    """Give the product as a function: what `forward.model = "python"` stands for."""
    constants, height = problem["material"]["constants_MPa"], problem["specimen"]["height_mm"]
    x, z = 100 * constants["C10"] - 0.5, (height - 18) / 4
    share = 2.718281828459045**x * (2 + z * z) * (1 + 250 * constants["C20"])
    own = 3.0 if problem["test"]["interface"] == "bonded" else 1.0
    return [own * share * d for d in problem["displacement_mm"]]


#: the same as a program
PROGRAM = f"""
import csv, json
{inspect.getsource(forward)}
problem = json.load(open("problem.json"))
rows = [["displacement_mm", "force_N"], *zip(problem["displacement_mm"], forward(problem))]
csv.writer(open("curve.csv", "w", newline="")).writerows(rows)
"""


def multiplied(home, **more):
    """Run the study of the function."""
    return public.run(
        home / "product.toml", jobs=1, results=home / "results", reports=None, forward=forward,
        version="1", **more,
    )  # fmt: skip


@pytest.fixture(scope="module")
def product(tmp_path_factory):
    home = tmp_path_factory.mktemp("product")
    (home / "product.toml").write_text(DESIGN)
    return home, multiplied(home)


def test_indices_beside_a_list_of_levels_are_those_of_a_product(product):
    """24 runs a level, which learn from each other; shares do not depend on the level."""
    parts = SQUARES / MEANS**2 - 1
    whole = np.prod(1 + parts) - 1
    first = parts / whole
    total = 1 - (np.prod(1 + parts) / (1 + parts) - 1) / whole
    _, found = product
    assert [dict(one.labels)["test.interface"] for one in found.surfaces] == [
        "frictionless", "bonded",
    ]  # fmt: skip
    for one in found.surfaces:
        told = one.to_json()
        surface, rows = told["surface"], told["sensitivity"]
        assert surface["category_correlation"][0] > 0.9
        assert surface["q2"] > 0.99
        for row, s, t in zip(rows, first, total, strict=True):
            assert row["S_interval"][0] <= s <= row["S_interval"][1]
            assert row["T_interval"][0] <= t <= row["T_interval"][1]


def test_the_state_of_a_finished_study_holds_its_verdicts(product):
    """Those over numbers too: one row a factor and level, each with its interval."""
    home, found = product
    told = study("status", "product", "--results", home / "results", "--json").json["verdicts"]
    assert told == json.loads(json.dumps(found.verdicts))
    assert len(told) == 6
    assert all(len(row["ci95"]) == 2 for row in told)
    assert public.api.status("product", results=home / "results")["verdicts"] == []


def test_a_level_is_compared_over_the_ranges(product):
    """Bonded less frictionless is twice the product: its mean is that of the means."""
    _, found = product
    first, second = found.surfaces
    assert first.differences == ()
    (told,) = second.differences
    assert (told.factor, told.level, told.other) == ("test.interface", "bonded", "frictionless")
    assert told.mean == pytest.approx(2 * np.prod(MEANS), rel=0.02)
    box = 2 * (np.exp(X[:, 0]) * (1.25 + 0.5 * X[:, 1]) * (2 + X[:, 2] ** 2))
    ends = np.quantile(box, [0.025, 0.975])
    assert [told.low, told.high] == pytest.approx(ends, rel=0.05)  # of 256 points
    assert told.verdict == "matters"
    assert second.to_json()["differences"] == [plain(told)]


def test_a_level_that_changes_nothing_makes_no_practical_difference():
    x = functions.hypercube(2, 40, 1)
    y = np.sin(3 * x[:, 0]) + x[:, 1]
    same = (functions.unit_runs(x[:20], y[:20]), functions.unit_runs(x[20:], y[20:] + 0.01))
    first, second = fit_together(same, (2,))
    told = level_difference(("f", "b", "a"), (second, first), 0.2)
    assert told.mean == pytest.approx(0.01, abs=1e-3)
    assert told.verdict == "no practical difference"
    assert level_difference(("f", "b", "a"), (second, first), 0.011).verdict == "cannot tell"
    assert level_difference(("f", "b", "a"), (second, first), None).verdict == "cannot tell"


def test_a_level_is_chosen_with_the_numbers_and_confirmed_by_the_function(product):
    _, found = product
    allowed = Allowed(function=PythonFunction.of(forward, "1"))
    (told,) = public.optimize(found, maximize="peak_force", permission=Permission(allowed=allowed))
    assert told.settings["test.interface"] == "bonded"
    assert told.confirmed is not None
    assert told.confirmed.predicted
    (own,) = [one for one in public.report(found.folder, reports=None).surfaces
              if dict(one.labels) == {"test.interface": "bonded"}]  # fmt: skip
    assert own.surface is not None
    assert own.surface.runs.response.size == 25


def test_a_program_confirms_once_it_is_allowed(inside):
    (inside / "product.toml").write_text(COMMAND)
    (inside / "product.py").write_text(PROGRAM)
    answer = study("run", "product.toml", "--jobs", 1, "--allow-commands", "--json")
    assert _runs(answer) == 10
    asked = ("optimize", "product", "--minimize", "peak_force", "--json")
    refused = study(*asked)
    assert refused.code == 3
    assert "--allow-commands" in refused.err
    answer = success(*asked, "--allow-commands")
    (one,) = answer.json["recommendations"]
    at = one["settings"]
    x, z = at["material.C10"] / 10 - 0.5, (at["specimen.height"] - 18) / 4
    exact = np.exp(x) * (2 + z * z) * 1.25
    # settings of a run are rounded to a ten-thousandth of their range
    assert one["confirmed"]["values"]["peak_force"] == pytest.approx(exact, rel=1e-3)
    # the least product is that of the least factors that were run
    assert set(one["at_end_of_range"]) == {"material.C10", "specimen.height"}
    assert one["confirmed"]["inside_interval"]
    # the refused call has run nothing
    assert _runs(study("report", "product", "--json")) == 11


def test_every_block_confirms(inside):
    """Four cylinders of 7 to 10 kPa: the constant that is least wrong for all lies between."""
    (inside / "product.toml").write_text(BLOCKED)
    stretch = 1 - np.linspace(0, 2, 21) / 20
    lines = ["mix,d,f"]
    for mix, c10 in zip("ABCD", (7.0, 8.0, 9.0, 10.0), strict=True):
        force = np.pi * 100 * 2e-3 * c10 * (stretch**-2 - stretch)
        lines += [f"{mix},{20 * (1 - x):.6g},{f:.8g}" for x, f in zip(stretch, force, strict=True)]
    (inside / "m.csv").write_text("\n".join(lines) + "\n")
    asked = ("--data", ".", "--json")
    before = _runs(study("run", "product.toml", "--jobs", 1, *asked))
    answer = study("optimize", "product", "--minimize", "relative_rms_force_error", *asked)
    assert answer.code in (0, 1), answer.err
    (one,) = answer.json["recommendations"]
    assert 7.0 <= one["settings"]["material.C10"] <= 10.0
    assert _runs(study("report", "product", "--json")) == before + 4


def _runs(answer):
    """Runs of all surfaces of a study, from the answer of a run or a report."""
    assert answer.code == 0, answer.err
    return sum(one["runs"] for one in answer.json["surfaces"])


def test_a_claim_over_numbers_waits_for_the_runs_that_confirm_it(product):
    home, found = product
    rows = [row for row in found.verdicts if str(row["verdict"]).startswith("matters")]
    assert rows
    assert {row["verdict"] for row in rows} == {"matters, if confirmed"}
    assert all(row["ci95"][0] < row["effect"] < row["ci95"][1] for row in rows)
    # rows of different settings are told apart
    assert len({(row["factor"], *row["at"].items()) for row in rows}) == len(rows)
    sure = multiplied(home, confirm=True)
    claims = {(r["factor"], *r["at"].items()): r["verdict"] for r in sure.verdicts}
    confirmed = [claims[row["factor"], *row["at"].items()] for row in rows]
    assert confirmed.count("matters") >= len(rows) - 1
    # two runs of the true model stand behind each
    (surface, *_) = sure.surfaces
    for item in surface.surface.sensitivity:
        if item.range is not None and item.range.confirmed:
            low, high = surface.surface.runs.response.min(), surface.surface.runs.response.max()
            assert high - low > 0.2


def test_a_confirming_run_that_fails_is_named(tmp_path):
    def plane(case):
        if case.parameters.b > 0.9999:
            raise RuntimeError("no convergence at the edge")
        return {"y": 4.0 * case.parameters.a - 3.0 * case.parameters.b**2}

    spans = {f"parameters.{name}": {"low": 0.0, "high": 1.0} for name in "ab"}
    design = {
        "study": {"name": "edge"},
        "parameters": {"a": 0.5, "b": 0.5},
        "factors": spans,
        "design": {"kind": "latin-hypercube", "runs": 20},
        "response": [{"name": "y", "unit": "N", "practical": "0.5 N"}],
    }
    found = public.run(
        design, forward=plane, version="1", confirm=True, results=tmp_path, reports=None
    )
    verdicts = {row["factor"]: row["verdict"] for row in found.verdicts}
    assert verdicts["parameters.b"] == "matters, if confirmed"
    (failed,) = [text for text in found.warnings if text.startswith("a confirming run failed")]
    assert "b 1" in failed
    assert "no convergence at the edge" in failed


SCHEME = 'kind = "adaptive"\nstart = 20\nbatch = 4\nbudget = 28\nq2 = 0.99'
#: the force is a function of three numbers, with a hill in one corner of them; two batches
HILL = (
    DESIGN.replace('"product"', '"hill"')
    .replace('test.interface = ["frictionless", "bonded"]\n', "")
    .replace('kind = "latin-hypercube"\nruns = 48', SCHEME)
)


def hill(x):
    """A hill in one corner, and slopes, over the unit box."""
    apart = (x[:, 0] - 0.75) ** 2 + (x[:, 1] - 0.3) ** 2
    return 3.0 * np.exp(-60.0 * apart) + x[:, 0] * x[:, 1] + 0.3 * x[:, 2] + 1.0


def hill_forward(problem):
    """What `forward.model = "python"` stands for."""
    constants = problem["material"]["constants_MPa"]
    height = problem["specimen"]["height_mm"]
    x = [100 * constants["C10"] - 0.5, 500 * constants["C20"] - 0.5, (height - 18) / 4]
    return [float(hill(np.array([x]))[0]) * d for d in problem["displacement_mm"]]


def ran(folder, text=HILL, jobs=1, progress=None):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "hill.toml").write_text(text)
    return public.run(
        folder / "hill.toml", jobs=jobs, results=folder / "results", reports=None,
        forward=hill_forward, version="1", progress=progress,
    )  # fmt: skip


def missed(found):
    """Share of the function's variance that predictions of a study miss over the box."""
    from scipy.stats import qmc

    x = 0.02 + 0.96 * qmc.Sobol(3, seed=11).random_base2(10)
    at = {"material.C10": 5 + 10 * x[:, 0], "material.C20": 1 + 2 * x[:, 1],
          "specimen.height": 18 + 4 * x[:, 2]}  # fmt: skip
    (surface,) = found.surfaces
    points = surface.surface.runs
    coded = np.column_stack(
        [f.coded(at[f.name]) for f in points.factors]
    )  # a point beyond the outermost run is asked, too
    exact = hill(x)
    return float(np.mean((surface.surface.model.value(coded) - exact) ** 2) / exact.var())


@pytest.fixture(scope="module")
def adaptive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("adaptive")
    return folder, ran(folder)


def table(found):
    return [(record.case_id, record.value("peak_force")) for record in found.records]


@pytest.mark.slow
def test_it_knows_the_function_better_than_as_many_runs_of_a_hypercube(tmp_path):
    """Of eight seeds: a single one may well know less than its hypercube."""
    ours = []
    plain = []
    longer = HILL.replace("budget = 28", "budget = 44")
    cells = len(ran(tmp_path, longer).records)
    for seed in range(1, 9):
        own = longer.replace('name = "hill"', f'name = "hill"\nseed = {seed}')
        start, end = own.index("[design]"), own.index("[[response]]")
        cube = f'{own[:start]}[design]\nkind = "latin-hypercube"\nruns = {cells}\n{own[end:]}'
        plain.append(missed(ran(tmp_path / f"plain-{seed}", cube)))
        ours.append(missed(ran(tmp_path / f"adaptive-{seed}", own)))
    print({"adaptive": ours, "hypercube": plain})
    assert np.median(ours) <= np.median(plain)
    assert np.exp(np.mean(np.log(ours))) < 0.8 * np.exp(np.mean(np.log(plain)))


def test_it_ends_with_its_goal_or_its_budget(adaptive):
    _, found = adaptive
    history = found.to_json()["adaptive"]
    assert [step["cells"] for step in history] == list(range(20, len(found.records) + 1, 4))
    last = history[-1]
    assert ("Q2" in last["stopped"]) == (last["q2"]["peak_force"] >= 0.99)
    assert last["stopped"]
    assert not any(step["stopped"] for step in history[:-1])
    assert len(found.records) <= 28


@pytest.mark.slow
def test_it_is_the_same_for_any_number_of_workers(adaptive, processes, tmp_path):
    _, found = adaptive
    assert table(ran(tmp_path, jobs=2)) == table(found)


def test_an_interrupted_run_goes_on_to_the_same_table(adaptive, tmp_path):
    _, found = adaptive
    calls = []

    def stop(state):
        calls.append(state)
        if len(calls) == 22:  # in the middle of the first batch
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ran(tmp_path, progress=stop)
    store = Store(tmp_path / "results" / "hill")
    manifest = store.read_manifest()
    assert manifest is not None
    assert len(store.records(manifest["cases"])) < len(manifest["cases"]) < len(found.records)
    again = ran(tmp_path)
    assert table(again) == table(found)
    assert again.to_json()["adaptive"] == found.to_json()["adaptive"]
    # and once more: nothing is left to do
    assert table(ran(tmp_path)) == table(found)


def test_a_plan_says_start_batch_budget_and_cost(adaptive, inside):
    (inside / "hill.toml").write_text(HILL.replace('[forward]\nmodel = "python"\n', ""))
    answer = success("plan", "hill.toml", "--json")
    told = answer.json["adaptive"]
    assert (told["start"], told["batch"], told["budget"]) == (20, 4, 28)
    assert told["most_seconds"] == pytest.approx(answer.json["predicted_seconds"] * 28 / 20)
    shown = study("plan", "hill.toml")
    assert "at most 28 cells" in shown.out


def test_it_ends_where_every_factor_has_a_verdict(tmp_path):
    text = HILL.replace("q2 = 0.99", 'until = "verdict"').replace('"0.2 N"', '"2 N"')
    text = text.replace("start = 20", "start = 40").replace("budget = 28", "budget = 44")
    found = ran(tmp_path, text)
    stopped = found.to_json()["adaptive"][-1]["stopped"]
    verdicts = {row["factor"]: row["verdict"] for row in found.verdicts}
    judged = "cannot tell" not in verdicts.values()
    assert ("every factor has a verdict" if judged else "budget of 44") in stopped
    # 0.3 N along the height, by the formula
    assert verdicts["specimen.height"] != "matters"


def test_levels_have_as_many_cells_and_are_searched_each(tmp_path):
    text = HILL.replace(
        "specimen.height = {", 'test.interface = ["frictionless", "bonded"]\nspecimen.height = {'
    ).replace("start = 20", "start = 24").replace("q2 = 0.99", "q2 = 0.9")  # fmt: skip
    found = ran(tmp_path, text)
    first = [dict(one.levels)["test.interface"] for one in found.design.treatments[:24]]
    assert first.count("bonded") == 12
    assert len(found.surfaces) == 2


MATRIX = (
    DESIGN[: DESIGN.index("[factors]")].replace('name = "product"', 'name = "matrix"')
    + """[factors]
model.space = ["axisymmetric", "3d"]
model.element_order = ["linear", "quadratic"]
material.C10 = ["5 kPa", "9 kPa"]
specimen.height = ["18 mm", "20 mm", "22 mm"]
"""
    + responses(peak_force="0.2 N")
)


def failing(problem):
    """Force that grows with stiffness and falls with height; quadratic solids never converge."""
    model = problem["model"]
    if (str(model["space"]).lower(), model["element_order"]) == ("3d", "quadratic"):
        raise RuntimeError("did not converge")
    force = (
        1e3 * problem["material"]["constants_MPa"]["C10"] * 20 / problem["specimen"]["height_mm"]
    )
    return [force * d for d in problem["displacement_mm"]]


def test_good_cases_are_judged_and_no_sound_level_is_left_out(inside):
    (inside / "matrix.toml").write_text(MATRIX)
    matrix = public.run(
        "matrix.toml", jobs=1, reports=None, forward=failing, version="1", refine=False
    )
    verdicts = {row["factor"]: row for row in matrix.verdicts}
    assert verdicts["material.C10"]["verdict"] == "matters"
    assert verdicts["specimen.height"]["verdict"] == "matters"
    assert verdicts["specimen.height"]["effect"] == pytest.approx(7 * 20 * (1 / 18 - 1 / 22))
    assert verdicts["model.space"]["verdict"] == "no practical difference"
    assert "have an empty cell" in verdicts["model.space"]["why"]
    (analysis,) = matrix.analyses
    assert analysis.result.data.y.size == 18
    assert not [note for note in analysis.result.notes if "degrees of freedom are" in note]


def test_extremes_that_a_confirming_run_has_moved_are_run_too(tmp_path):
    """The range of z, .96 along 2 (z - .7)^2 - z / 40, is told by the runs for x alone."""
    design = {
        "study": {"name": "moved"},
        "parameters": {"x": 0.5, "z": 0.5, "kind": "fancy"},
        "factors": {
            "parameters.x": {"low": 0, "high": 1},
            "parameters.z": {"low": 0, "high": 1},
            "parameters.kind": ["fancy", "plain"],
        },
        "design": {"kind": "latin-hypercube", "runs": 14, "seed": 3},
        "response": [{"name": "y", "unit": "N", "practical": "0.8 N"}],
    }

    def bowl(case):
        x, z = case.parameters.x, case.parameters.z
        plain = 1.5 * (case.parameters.kind == "plain")
        return {"y": 1 + 4 * (x - 0.3) ** 2 + 2 * (z - 0.7) ** 2 + 0.5 * x * z + plain}

    asked = {"version": "1", "confirm": True, "results": tmp_path, "reports": None}
    found = public.run(design, forward=bowl, **asked)
    assert {v["verdict"] for v in found.verdicts} == {"matters"}
