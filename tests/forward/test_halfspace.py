"""Indentation in closed form, and the start that it gives to a fit."""

import numpy as np
import pytest

from study.ground.curve import Curve
from study.mechanics.forward import finite_element
from study.mechanics.forward.closed_form import indentation
from study.mechanics.setup.geometry import Cone
from study.simulation import fit_task
from study.simulation.cell import Cell, CellProblem
from study.simulation.job import fit_problem
from tests.fem.problems import LONG

HIGH = 1e9
NEO_HOOKEAN = 6e-3
INDENTERS = {
    "flat": {"shape": "flat", "radius_mm": 8.0, "edge_radius_mm": 1.0},
    "cone": {"shape": "cone", "half_angle_deg": 45.0, "tip_radius_mm": 2.0},
    "needle": {"shape": "cone", "half_angle_deg": 30.0, "tip_radius_mm": 1.0,
               "shaft_radius_mm": 3.0},
    "sphere": {"shape": "sphere", "radius_mm": 8.0},
}  # fmt: skip
SPECIMENS = {
    "thick cylinder": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
    "thin cylinder": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 8.0},
    "thick block": {"shape": "block", "width_mm": 60.0, "depth_mm": 60.0, "height_mm": 40.0},
    "thin block": {"shape": "block", "width_mm": 60.0, "depth_mm": 60.0, "height_mm": 8.0},
}


def test_a_rounded_tip_and_a_shaft():
    """A rounded tip lies its own rounding deeper than a sharp one; a shaft goes on as a punch."""
    depth = np.array([20.0, 30.0])
    sharp = indentation(Cone(45.0), depth + (np.sqrt(2) - 1) * 0.2, height_mm=HIGH)
    rounded = indentation(Cone(45.0, tip_radius_mm=0.2), depth, height_mm=HIGH)
    assert rounded == pytest.approx(sharp, rel=1e-4)
    shaft = indentation(Cone(45.0, shaft_radius_mm=3.0), depth, height_mm=HIGH)
    assert np.diff(shaft) == pytest.approx(2 * 3.0 * 10.0 / 0.75)


def setting(indenter, specimen, nu=0.4995):
    own = SPECIMENS[specimen]
    return {
        "specimen": own,
        "test": {"kind": "indentation", "interface": "frictionless", "base": "bonded",
                 "displacement_mm": min(5.0, 0.3 * own["height_mm"]), "steps": 10,
                 "indenter": INDENTERS[indenter]},
        "material": {"model": "neo-hookean", "constants": {}, "poisson_ratio": nu},
        "model": {"space": "axisymmetric", "element_order": "quadratic", "mesh": "coarse"},
    }  # fmt: skip


def calibrated(document, measured):
    problem = fit_problem(Cell(CellProblem.of(document), "auto"))
    return fit_task.fitted(fit_task.FitJob(problem, (measured,)))


def virtual(config):
    solution = finite_element.solve(
        CellProblem.of(config).at({"C10": NEO_HOOKEAN}), gradients=False
    )
    assert solution.status == "converged", solution.message
    return Curve(solution.curve.displacement_mm, solution.curve.force_N)


FITS = [  # each indenter and each specimen once in the suite, all pairs in the long verification
    pytest.param(indenter, specimen, marks=() if i == k else LONG)
    for i, indenter in enumerate(INDENTERS)
    for k, specimen in enumerate(SPECIMENS)
]


@pytest.mark.parametrize(("indenter", "specimen"), FITS)
def test_an_indentation_fit_starts_near_its_end(indenter, specimen):
    """Large strains, a layer and a finite width are in the data: a factor of 1.25 at most."""
    config = setting(indenter, specimen)
    measured = virtual(config)
    _, start = fit_task.start_values(CellProblem.of(config), [measured], None)
    assert 1 / 1.25 < start[0] / NEO_HOOKEAN < 1.25
    found = calibrated(config, measured)
    assert found.status == "converged"
    assert found.constants["C10"] == pytest.approx(NEO_HOOKEAN, rel=1e-6)
    # the force is proportional to C10
    assert found.fit["solves"] == 1
