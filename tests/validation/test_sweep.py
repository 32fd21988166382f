"""The sweep of random problems: what it draws, what it calls a silent miss, how it resumes."""

import json
from collections import Counter

import numpy as np
import pytest

from study.mechanics.mesh.mesher import mesh_size
from study.mechanics.setup.geometry import Block, Cone, Cylinder, Flat, Sphere
from study.mechanics.solver.solution_cost import expected_unknowns
from tests.cli.small import answer_of
from validation import sweep
from validation.sweep_problems import (
    ELEMENTS,
    MOST_UNKNOWNS,
    REFERENCE_UNKNOWNS,
    drawn,
    references,
)


@pytest.fixture(scope="module")
def problems():
    return [drawn(2011, number) for number in range(80)]


def test_a_problem_is_a_matter_of_its_seed_and_number(problems):
    assert drawn(2011, 7) == problems[7]
    assert drawn(2012, 7) != problems[7]


def test_every_kind_of_problem_is_drawn(problems):
    models = Counter(
        (p.model.space, p.model.element_order, p.model.element_shape) for p in problems
    )
    assert models == dict.fromkeys(
        ((m.space, m.element_order, m.element_shape) for m in ELEMENTS), 10
    )
    assert {type(p.specimen) for p in problems} == {Cylinder, Block}
    assert {type(p.test.indenter) for p in problems} == {type(None), Cone, Sphere, Flat}
    assert {p.test.interface for p in problems} == {"frictionless", "bonded"}
    assert {p.material.model for p in problems} == {
        "neo-hookean", "mooney-rivlin", "reduced-polynomial", "ogden",
    }  # fmt: skip
    assert {p.model.mesh_size_mm is None for p in problems} == {True, False}


def test_problems_are_wide_and_within_their_ranges(problems):
    height = np.array([p.specimen.height_mm for p in problems])
    bodies = [p.specimen for p in problems]
    half = [b.radius_mm if isinstance(b, Cylinder) else b.width_mm / 2 for b in bodies]
    ratio, depth = half / height, np.array([p.test.displacement_mm for p in problems]) / height
    nu = np.array([p.material.poisson_ratio for p in problems])
    for values, low, high in ((ratio, 0.2, 5.0), (depth, 0.05, 0.5), (nu, 0.45, 0.4999)):
        # three digits of a size move a ratio by a hundredth of itself
        assert 0.98 * low <= values.min()
        assert values.max() <= 1.02 * high
        assert np.ptp(values) > 0.7 * (high - low)


def test_references_are_finer_quadratic_and_affordable(problems):
    for problem in problems[:24]:
        assert expected_unknowns(problem.setup) < MOST_UNKNOWNS[problem.model.space]
        for one in references(problem):
            assert one.model.element_order == "quadratic"
            assert one.model.space == (
                "axisymmetric" if isinstance(problem.specimen, Cylinder) else "3d"
            )
            assert (one.specimen, one.test, one.material) == (
                problem.specimen, problem.test, problem.material,
            )  # fmt: skip
            assert expected_unknowns(one.setup) <= REFERENCE_UNKNOWNS[one.model.space]
            if one.model.element_shape == "simplex":  # solid bricks are dear
                assert mesh_size(one.setup) < mesh_size(problem.setup)


# What is found, with a solver whose errors are known

PROBLEM = drawn(2011, 0)  # a cylinder in the plane: its references are in the plane too


def solver(error, message=sweep.NOTHING, status="converged"):
    """Solver with a relative error of the last force; its meshes have 1 / h^2 elements."""

    def ask(problem):
        size, own = mesh_size(problem.setup), problem.model.element_order == "linear"
        force = np.linspace(0.2, 1, 6)
        force[-1] *= 1 + error(problem)
        return {
            "status": status if own else "converged",
            "message": message if own else sweep.NOTHING,
            "displacement_mm": [], "force_N": force.tolist(),
            "dofs": 1, "elements": round(1e4 / size**2), "mesh_size_mm": size, "seconds": 0.01,
        }  # fmt: skip

    return ask


def of_mesh(problem):
    """10 % on the problem's own mesh, of second order, and right on the reference."""
    if problem.model.element_order == "quadratic":
        return 0.0
    return 0.1 * (mesh_size(problem.setup) / mesh_size(PROBLEM.setup)) ** 2


def hidden(problem):
    """10 % that no mesh of the series shows."""
    return 0.0 if problem.model.element_order == "quadratic" else 0.1


def test_an_error_that_the_meshes_show_is_covered():
    found = sweep.outcome(PROBLEM, solver(of_mesh))
    assert found["verdict"] == "off, covered"
    assert found["last"] == pytest.approx(0.1, rel=1e-9)
    # safety factor 1.25 on the extrapolation of a series of order 2, over a force 10 % too large
    assert found["claimed"][-1] == pytest.approx(1.25 * 0.1 / 1.1, rel=0.02)


def of_one_reference(problem):
    """The first reference has simplices, and is wrong itself."""
    wrong = problem.model.element_order == "quadratic" and problem == references(PROBLEM)[0]
    return -0.2 if wrong else 0.0


@pytest.mark.parametrize(
    ("ask", "verdict"),
    [
        (solver(hidden), sweep.SILENT),
        (solver(hidden, f"{sweep.NOTHING}; past 1 mm the surface snapped"), "off, said"),
        (solver(hidden, "no", "not-converged"), "not-converged"),
        (solver(lambda _: 0.0), "right"),
        (solver(of_one_reference), "references differ"),
    ],
)
def test_an_error_is_silent_where_neither_mesh_nor_message_tells(ask, verdict):
    assert sweep.outcome(PROBLEM, ask)["verdict"] == verdict


# The file and the program


def program(*arguments):
    return answer_of(sweep.main, *arguments)


@pytest.mark.parametrize(
    ("error", "asked", "code", "line"),
    [
        # what the file holds is not computed again
        (hidden, (), 1, "\nsilent misses: 1\n"),
        # no time is left for the second problem
        (of_mesh, ("--count", 2, "--budget", 0), 0, "1 of 2 problems: 1 off, covered"),
        (of_mesh, ("--seed", 1), 2, "line 1: belongs to another seed or other problems"),
    ],
)
def test_a_file_is_gone_on_with_unless_it_is_of_another_seed(tmp_path, error, asked, code, line):
    file = tmp_path / "sweep.jsonl"
    row = {"seed": 2011, "number": 0, "problem": repr(PROBLEM)}
    file.write_text(json.dumps(row | sweep.outcome(PROBLEM, solver(error))) + "\n")
    found = program("--count", 1, "--file", file, *asked)
    assert found.code == code, found.err
    assert line in (found.err if code == 2 else found.out)
    assert (found.err == "") == (code < 2)


def test_a_problem_is_written_as_python(problems):
    found = program("--show", 3)
    assert found.code == 0
    names = {}
    exec(found.out.split("for one in")[0], names)  # its own output, of this very test
    assert names["problem"] == problems[3]
    assert names["reference"] == references(problems[3])[0]


@pytest.mark.slow
def test_one_problem_from_end_to_end(tmp_path):
    found = program("--count", 1, "--file", tmp_path / "one.jsonl")
    assert found.code == 0, found.out + found.err
    assert "1 of 1 problems" in found.out
    row = json.loads((tmp_path / "one.jsonl").read_text())
    assert row["own"]["status"] == row["reference"]["found"]["status"] == "converged"
