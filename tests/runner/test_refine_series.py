"""Refinement series of problems: which meshes, when they end, what is said (fake solver)."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.api.converging import problem_cells, refined
from study.ground.curve import Curve
from study.ground.errors import InputError
from study.harness.design.load import loads, loads_problem
from study.mechanics.forward.formal_order import clamped_corner, formal_order
from study.record.store import Store
from study.simulation.cell import CellProblem
from study.simulation.job import located
from study.simulation.refinement import Budget, within
from study.simulation.solve_task import SolveResult, SolveTask, kept, solved
from study.statistics.convergence.grid_convergence import grid_convergence
from tests.cli.small import pressed
from tests.fem.surfaces import box, write

PROBLEM = pressed(
    """[material]
model = "neo-hookean"
C10 = "5 kPa"
bulk_modulus = "10 MPa"
[model]
element_order = "linear"
mesh_size = "4 mm"
[converge]
ratio = 1.5
""",
    radius=25,
    height=30,
    interface="bonded",
    test='displacement = "3 mm"\nsteps = 5\n',
)


class Fake:
    """Force 10 (1 + error h^order) d: a solver whose error is known; counts its solutions."""

    def __init__(self, order=1.2, error=1e-3, **wish):
        self.order, self.error, self.wish = order, error, wish
        self.sizes: list[float] = []

    def __call__(self, tasks):
        for task in tasks:
            yield task.key, self.one(task)

    def one(self, task):
        h, steps = task.problem.model.mesh_size_mm, task.problem.test.steps
        if steps == 5 and task.looser == 1.0:
            self.sizes.append(h)
        if any(abs(h - bad) < 1e-9 for bad in self.wish.get("fails", ())):
            return SolveResult("not-converged", "stopped at 1 mm of 3 mm")
        d = 3.0 * np.arange(1, steps + 1) / steps
        scale = 10 * (1 + self.error * h**self.order)
        scale *= 1 + self.wish.get("loose", 1e-9) * (task.looser - 1)
        scale *= 1 + self.wish.get("stepping", 0.0) / steps
        scale *= 1 + (self.wish.get("seeded", 0.0) if task.problem.model.mesh_seed else 0)
        curve = Curve(d, scale * d, np.full(steps, scale))
        elements = self.wish.get("elements") or round(1e4 / h**2)
        return SolveResult(
            "converged", curve=curve, elements=elements, dofs=3 * elements,
            seconds=1e-3 * elements, memory_MB=100 + 0.01 * elements, base_MB=100.0,
        )  # fmt: skip


def converged(fake, text="", **options):
    found = refined(loads_problem(PROBLEM + text, "p.toml"), "p", solve=fake, **options)
    return dict(found)


def test_three_meshes_give_order_limit_and_interval():
    fake = Fake()
    found = converged(fake)
    # the studies of steps and tolerance begin with the first mesh again
    assert fake.sizes == pytest.approx([4, 4 / 1.5, 4 / 2.25, 4])
    assert found["behaviour"] == "monotone"
    # elements are whole numbers: sizes differ from the nominal ones by up to 1e-4
    assert found["observed_order"] == pytest.approx(1.2, abs=0.01)
    assert found["extrapolated"] == pytest.approx(30, rel=1e-4)
    # bonded plates, 3 mm down on elements of 4 mm: the side folds onto them
    assert found["formal_order"] == 1.0
    assert "corner" in found["formal_reason"]
    assert set(found["quantities"]) == {"peak_force", "curve_rms", "work"}
    assert found["stopped"] == "3 meshes were asked for"
    assert found["mesh_size"] == sorted(found["mesh_size"])
    given = found["given_mesh"]
    assert given["mesh_size"] == pytest.approx(4, rel=1e-3)
    assert abs(given["value"] - 30) < given["u_num"]
    # costs are predicted from the first meshes; the fake's time is linear in its elements
    finest = found["meshes"][0]
    assert found["meshes"][-1]["predicted_seconds"] is None
    assert finest["predicted_seconds"] == pytest.approx(finest["seconds"], rel=0.02)
    assert finest["predicted_MB"] >= finest["memory_MB"]
    assert finest["predicted_unknowns"] == pytest.approx(finest["unknowns"], rel=0.01)


def test_refines_until_the_wanted_accuracy():
    fake = Fake()
    found = converged(fake, 'tolerance = "0.1 %"')
    assert found["stopped"] == "every quantity has the wanted accuracy"
    assert len(fake.sizes) > 3
    assert found["settled"]
    assert found["u_num"] <= 1e-3 * found["value"][0]
    # one mesh earlier it was not there yet
    assert found["quantities"]["work"]["u_num"] <= 1e-3 * found["quantities"]["work"]["value"][0]
    coarser = converged(Fake(), 'tolerance = "3 %"')
    assert len(coarser["mesh_size"]) == 3


def test_the_needed_size_follows_from_the_order():
    found = converged(Fake(), 'tolerance = "0.1 %"\nbudget = "5 s"')
    assert "which the budget does not have" in found["stopped"]
    assert not found["settled"]
    assert any("not within 0.1 %" in w for w in found["warnings"])
    needed = found["mesh_size_needed"]
    u = found["u_num"] * (needed / found["mesh_size"][0]) ** found["order_used"]
    assert u == pytest.approx(1e-3 * found["extrapolated"], rel=1e-9)


def test_a_hopeless_accuracy_is_said_early():
    """Half an order: the mesh for 0.1 % would take a thousand times the budget."""
    fake = Fake(order=0.6, error=5e-2)
    found = converged(fake, 'tolerance = "0.1 %"\nbudget = "30 s"')
    assert found["stopped"].startswith("the wanted accuracy needs a mesh size of about")
    assert len(found["mesh_size"]) == 3


def test_stops_before_the_memory_runs_out():
    found = converged(Fake(), memory_MB=120.0)
    assert "MB of 120 MB" in found["stopped"]
    assert found["behaviour"] == "two meshes"
    assert "there are 2" in found["verdict"]


def test_a_failed_level_is_said_and_replaced_by_a_finer_one():
    found = converged(Fake(fails=(4.0,)))
    assert any("4 mm gave no answer: stopped at 1 mm" in w for w in found["warnings"])
    assert len(found["mesh_size"]) == 3
    assert found["meshes"][-1]["status"] == "not-converged"


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"fails": [4 / 1.5**k for k in range(4)]}, "needs three meshes"),
        ({"elements": 120}, "the same 120 elements"),
    ],
)
def test_a_series_without_three_meshes_has_no_order(wish, words):
    found = converged(Fake(**wish))
    assert found["behaviour"] == "inconclusive"
    assert found["observed_order"] is None
    assert words in " ".join([found["verdict"], *found["warnings"]])


def test_divergence_is_an_answer():
    found = converged(Fake(order=-1.0, error=0.5))
    assert found["behaviour"] == "divergent"
    assert found["gci_fine"] is None
    finest = found["value"][:3]
    assert found["u_num"] == pytest.approx(3 * (max(finest) - min(finest)))
    assert not found["settled"]


def test_one_table_of_mesh_steps_and_tolerance():
    found = converged(Fake(stepping=0.05, loose=1e-6))
    rows = {(r["source"], r["quantity"]): r for r in found["sources"]}
    assert len(rows) == 9
    steps = rows["load steps", "peak_force"]
    assert steps["setting"] == [20, 10, 5]
    # first order in 1/steps: 5 steps are 1 % off, and the interval holds that
    assert steps["relative"] >= 0.0099
    loose = rows["solver tolerance", "peak_force"]
    assert loose["relative"] == pytest.approx(9e-6, rel=0.1)
    assert any("raise test.steps" in w for w in found["warnings"])
    assert not any("tolerance" in w for w in found["warnings"])


def test_a_surface_knows_how_far_two_meshes_of_one_size_differ(tmp_path):
    write(tmp_path / "box.stl", box(10, 8, 6))
    cylinder = 'shape = "cylinder"\nradius = "25 mm"\nheight = "30 mm"'
    text = PROBLEM.replace(cylinder, 'shape = "surface"\nfile = "box.stl"\nunit = "mm"')
    loaded = loads_problem(text, "p.toml")
    loaded = replace(loaded, problem=located(loaded.problem, (tmp_path,)))
    alike = refined(loaded, "p", solve=Fake())
    found = refined(loaded, "p", solve=Fake(seeded=0.01))
    (row,) = [
        r for r in found["sources"]
        if (r["source"], r["quantity"]) == ("another mesh", "peak_force")
    ]  # fmt: skip
    assert row["relative"] == pytest.approx(0.03)
    first, second = alike["given_mesh"]["u_num"], found["given_mesh"]["u_num"]
    assert second == pytest.approx(np.hypot(first, 0.03 * found["given_mesh"]["value"]))
    assert any("another mesh of the problem's own size" in w for w in found["warnings"])
    assert not any("another mesh" in w for w in alike["warnings"])


def test_stored_solutions_are_not_solved_again(tmp_path):
    first, second = Fake(), Fake()
    config = loads_problem(PROBLEM, "p.toml")
    one = refined(config, "p", solve=kept(first, Store(tmp_path)))
    two = refined(config, "p", solve=kept(second, Store(tmp_path)))
    assert len(first.sizes) == 3
    assert second.sizes == []
    assert one == two
    finer = loads_problem(PROBLEM + "levels = 4", "p.toml")
    refined(finer, "p", solve=kept(second, Store(tmp_path)))
    assert second.sizes == pytest.approx([4 / 1.5**3])


def test_a_quantity_that_needs_measurements_is_refused():
    with pytest.raises(InputError, match="needs measured curves"):
        converged(Fake(), 'qoi = "relative_rms_force_error"')


def punched(edge_mm=0.0, **more):
    """Test with a flat punch."""
    rounded = {"edge_radius_mm": edge_mm} if edge_mm else {}
    return {
        "kind": "indentation",
        "indenter": {"shape": "flat", "radius_mm": 3.0, **rounded},
        **more,
    }


def test_one_real_solution_and_a_budget_that_counts_from_its_start():
    result = solved(SolveTask.of(loads_problem(PROBLEM, "p.toml").problem, 6.0))
    assert result.converged
    assert result.elements > 10
    assert result.seconds > 0
    assert result.memory_MB >= result.base_MB > 10
    spent = Budget(10.0, 1e6, began=time.monotonic() - 8)
    assert "of 2" in spent.refuses(5.0, None) or "of 1.9" in spent.refuses(5.0, None)
    assert spent.refuses(1.0, None) == ""


@pytest.mark.parametrize(
    ("change", "order", "why"),
    [
        ({}, 1.0, "the side folds onto the plate"),
        ({"test": {"displacement_mm": 0.5}}, 2 * 0.5946, "the displacement goes as s^0.595 there"),
        ({"test": {"interface": "frictionless"}}, 2.0, "linear elements"),
        ({"model": {"space": "3d"}, "test": {"interface": "frictionless"}}, 2.0, "elements"),
        (
            {"test": {"interface": "frictionless"}, "model": {"element_order": "quadratic"}},
            4.0, "quadratic elements",
        ),
        (
            {"test": punched()},
            1.0, "sharp edge of the flat punch, where the contact pressure is singular as an "
            "inverse square root",
        ),
        (
            {"test": punched(interface="bonded"), "model": {"element_order": "quadratic"}},
            1.0, "the orders 2 of linear and 4 of quadratic elements need a smooth solution",
        ),
        ({"test": punched(1.0, interface="bonded")}, 1.0, "rim of the bonded face"),
        (
            {"test": punched(1.0, interface="frictionless"), "model": {"mesh_size_mm": 0.5}},
            2.0, "rounded edge of the flat punch (1 mm), which the meshes resolve",
        ),
        (
            {"test": punched(0.1, interface="frictionless"), "model": {"mesh_size_mm": 0.5}},
            1.0, "does not resolve",
        ),
        (
            {
                "test": {"kind": "indentation", "indenter": {"shape": "sphere", "radius_mm": 3.0}},
                "model": {"element_order": "quadratic"},
            },
            2.0, "rim of the contact",
        ),
    ],
)  # fmt: skip
def test_formal_orders(change, order, why):
    config = loads_problem(PROBLEM, "p.toml").problem.document()
    for name, section in change.items():
        config = {**config, name: {**config[name], "base": None, **section}}
    found = formal_order(CellProblem.of(config).at())
    assert found.order == pytest.approx(order, abs=1e-3)
    assert why in found.why


def test_williams_exponents():
    """Published: 0.7112 for nu = 0.3 (butt joint); 0.5946 for nu = 0.5; none for nu = 0."""
    assert clamped_corner(0.3) == pytest.approx(0.7112, abs=1e-4)
    assert clamped_corner(0.5) == pytest.approx(0.5946, abs=1e-4)
    assert clamped_corner(0.0) == pytest.approx(1.0, abs=1e-6)


CELLS = (
    PROBLEM.replace('element_order = "linear"\n', "")
    + """
tolerance = "0.5 %"
[study]
name = "elements"
[factors]
model.element_order = ["linear", "quadratic"]
"""
)


class TwoElements(Fake):
    """Quadratic elements: a twentieth of the error, three times the seconds."""

    def one(self, task):
        quadratic = task.problem.model.element_order == "quadratic"
        self.error = 5e-4 if quadratic else 1e-2
        result = super().one(task)
        return replace(result, seconds=result.seconds * (3 if quadratic else 1))


def test_which_element_is_cheapest_for_an_accuracy(tmp_path):
    fake = TwoElements()
    found = problem_cells(
        loads(CELLS, "elements.toml"), 1, tmp_path, lambda _: None, solve=fake,
        reports=tmp_path / "reports",
    )  # fmt: skip
    assert [cell["settled"] for cell in found["cells"]] == [True, True]
    (front,) = found["fronts"]
    assert front["reference"] == pytest.approx(30, rel=1e-3)
    first, second = front["ranking"]
    # 0.5 %: linear needs 1e-2 h^1.2 = 5e-3, quadratic is there on its first mesh
    assert first["cell"] == "quadratic"
    assert first["how"] == "coarsest mesh"
    assert second["mesh_size"] == pytest.approx(0.5 ** (1 / 1.2), rel=0.05)
    # a fifth of the reference's own uncertainty may lie in the seconds
    assert second["seconds"] == pytest.approx(1e-3 * 1e4 / second["mesh_size"] ** 2, rel=0.1)
    assert front["answer"].startswith("quadratic gives 0.5 % error for the least time")
    page = Path(found["report"]).read_text(encoding="utf-8")
    assert "Figure missing" not in page
    assert page.count("<svg") == 4


def test_a_design_without_measurements_needs_no_response():
    design = loads(CELLS, "elements.toml")
    assert design.responses == ()
    with pytest.raises(InputError, match="response"):
        loads(CELLS[: CELLS.index("[converge]")] + CELLS[CELLS.index("[study]") :], "x.toml")


def test_noise_below_the_accuracy_settles_without_an_order():
    """Changes that grow, but thrice the range of the finest three is below what is wanted."""
    small = grid_convergence([1, 2, 4], [1.0, 1.001, 1.0015])
    assert small.behaviour == "noise-floor"
    assert within({"f": small}, 0.01) == {"f": True}
    assert within({"f": small}, 0.004) == {"f": False}
