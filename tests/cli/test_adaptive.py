"""Cells that are added to a study while it runs: a function whose answer is known everywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import study as public
from study.ground.errors import InputError
from study.harness.record.store import Store
from tests.cli.small import study, success
from tests.cli.test_confirming_runs import DESIGN as PRODUCT

SCHEME = 'kind = "adaptive"\nstart = 20\nbatch = 4\nbudget = 28\nq2 = 0.99'
#: the force is a function of three numbers, with a hill in one corner of them; two batches
DESIGN = (
    PRODUCT.replace('"product"', '"hill"')
    .replace('test.interface = ["frictionless", "bonded"]\n', "")
    .replace('kind = "latin-hypercube"\nruns = 48', SCHEME)
)


def hill(x):  # type: ignore[no-untyped-def]
    """A hill in one corner, and slopes, over the unit box."""
    apart = (x[:, 0] - 0.75) ** 2 + (x[:, 1] - 0.3) ** 2
    return 3.0 * np.exp(-60.0 * apart) + x[:, 0] * x[:, 1] + 0.3 * x[:, 2] + 1.0


def forward(problem):  # type: ignore[no-untyped-def]
    """What `forward.model = "python"` stands for."""
    constants = problem["material"]["constants_MPa"]
    height = problem["specimen"]["height_mm"]
    x = [100 * constants["C10"] - 0.5, 500 * constants["C20"] - 0.5, (height - 18) / 4]
    apart = (x[0] - 0.75) ** 2 + (x[1] - 0.3) ** 2
    force = 3.0 * 2.718281828459045 ** (-60.0 * apart) + x[0] * x[1] + 0.3 * x[2] + 1.0
    return [force * d for d in problem["displacement_mm"]]


def ran(folder: Path, text: str = DESIGN, jobs: int = 1):  # type: ignore[no-untyped-def]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "hill.toml").write_text(text)
    return public.run(
        folder / "hill.toml", jobs=jobs, results=folder / "results", reports=None,
        forward=forward, version="1",
    )  # fmt: skip


def missed(found) -> float:  # type: ignore[no-untyped-def]
    """Share of the function's variance that predictions of a study miss over the box."""
    from scipy.stats import qmc

    x = 0.02 + 0.96 * qmc.Sobol(3, seed=11).random_base2(10)
    at = {"material.C10": 5 + 10 * x[:, 0], "material.C20": 1 + 2 * x[:, 1],
          "specimen.height": 18 + 4 * x[:, 2]}  # fmt: skip
    (surface,) = found.surfaces
    points = surface.found.runs
    coded = np.column_stack(
        [f.coded(at[f.name]) for f in points.factors]
    )  # a point beyond the outermost run is asked, too
    exact = hill(x)
    return float(np.mean((surface.found.model.value(coded) - exact) ** 2) / exact.var())


@pytest.fixture(scope="module")
def adaptive(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    folder = tmp_path_factory.mktemp("adaptive")
    return folder, ran(folder)


def table(found) -> list[tuple[str, float]]:  # type: ignore[no-untyped-def]
    return [(record.case_id, record.value("peak_force")) for record in found.records]


@pytest.mark.slow
@pytest.mark.verify
def test_it_knows_the_function_better_than_as_many_runs_of_a_hypercube(tmp_path: Path) -> None:
    """Of eight seeds: a single one may well know less than its hypercube."""
    ours: list[float] = []
    plain: list[float] = []
    longer = DESIGN.replace("budget = 28", "budget = 44")
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


def test_it_ends_with_its_goal_or_its_budget(adaptive) -> None:  # type: ignore[no-untyped-def]
    _, found = adaptive
    history = found.to_json()["adaptive"]
    assert [step["cells"] for step in history] == list(range(20, len(found.records) + 1, 4))
    last = history[-1]
    assert ("Q2" in last["stopped"]) == (last["q2"]["peak_force"] >= 0.99)
    assert last["stopped"]
    assert not any(step["stopped"] for step in history[:-1])
    assert len(found.records) <= 28


@pytest.mark.slow
@pytest.mark.verify
def test_it_is_the_same_for_any_number_of_workers(adaptive, processes, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    _, found = adaptive
    assert table(ran(tmp_path, jobs=2)) == table(found)


def test_an_interrupted_run_goes_on_to_the_same_table(adaptive, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    _, found = adaptive
    calls = []

    def stop(state) -> None:  # type: ignore[no-untyped-def]
        calls.append(state)
        if len(calls) == 22:  # in the middle of the first batch
            raise KeyboardInterrupt

    (tmp_path / "hill.toml").write_text(DESIGN)
    given = {"results": tmp_path / "results", "reports": None, "forward": forward, "version": "1"}
    with pytest.raises(KeyboardInterrupt):
        public.run(tmp_path / "hill.toml", jobs=1, progress=stop, **given)
    store = Store(tmp_path / "results" / "hill")
    manifest = store.read_manifest()
    assert manifest is not None
    assert len(store.records(manifest["cases"])) < len(manifest["cases"]) < len(found.records)
    again = public.run(tmp_path / "hill.toml", jobs=1, **given)
    assert table(again) == table(found)
    assert again.to_json()["adaptive"] == found.to_json()["adaptive"]
    # and once more: nothing is left to do
    assert table(public.run(tmp_path / "hill.toml", jobs=1, **given)) == table(found)


def test_a_plan_says_start_batch_budget_and_cost(adaptive, inside: Path) -> None:  # type: ignore[no-untyped-def]
    (inside / "hill.toml").write_text(DESIGN.replace('[forward]\nmodel = "python"\n', ""))
    answer = success("plan", "hill.toml", "--json")
    told = answer.json["adaptive"]
    assert (told["start"], told["batch"], told["budget"]) == (20, 4, 28)
    assert told["most_seconds"] == pytest.approx(answer.json["predicted_seconds"] * 28 / 20)
    shown = study("plan", "hill.toml")
    assert "at most 28 cells" in shown.out


def test_it_ends_where_every_factor_has_a_verdict(tmp_path: Path) -> None:
    text = DESIGN.replace("q2 = 0.99", 'until = "verdict"').replace('"0.2 N"', '"2 N"')
    text = text.replace("start = 20", "start = 40").replace("budget = 28", "budget = 44")
    found = ran(tmp_path, text)
    last = found.to_json()["adaptive"][-1]
    verdicts = {row["factor"]: row["verdict"] for row in found.verdicts}
    if last["stopped"] == "every factor has a verdict":
        assert "cannot tell" not in verdicts.values()
    else:
        assert "budget of 44" in last["stopped"]
    # 0.3 N along the height, by the formula
    assert verdicts["specimen.height"] != "matters"


def test_levels_have_as_many_cells_and_are_searched_each(tmp_path: Path) -> None:
    text = DESIGN.replace(
        "specimen.height = {", 'test.interface = ["frictionless", "bonded"]\nspecimen.height = {'
    ).replace("start = 20", "start = 24").replace("q2 = 0.99", "q2 = 0.9")  # fmt: skip
    found = ran(tmp_path, text)
    first = [dict(one.levels)["test.interface"] for one in found.design.treatments[:24]]
    assert first.count("bonded") == 12
    assert len(found.surfaces) == 2


def test_an_odd_number_of_cells_is_refused(tmp_path: Path) -> None:
    for wrong, told in (
        ("start = 6", "do not carry an emulator"),
        ("start = 32", "is less than the 32 cells"),
    ):
        (tmp_path / "hill.toml").write_text(DESIGN.replace("start = 20", wrong))
        with pytest.raises(InputError, match=told):
            public.load_design(tmp_path / "hill.toml")
