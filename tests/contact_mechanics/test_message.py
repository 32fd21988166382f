"""What a solution says where every step converged and the answer is another one."""

import pytest

import study


@pytest.mark.parametrize(("depth_mm", "is_said"), [(6.0, True), (1.0, False)])
def test_facets_that_bridge_the_edge_of_a_punch_are_said(depth_mm, is_said):
    """Their force is that of a blunter punch: meshes differ by 20 %, and Newton sees nothing."""
    found = study.solve({
        "specimen": {"shape": "cylinder", "radius": 20, "height": 10},
        "test": {
            "kind": "indentation", "interface": "frictionless", "displacement": depth_mm,
            "steps": 6, "indenter": {"shape": "flat", "radius": 4, "edge_radius": 0.5},
        },
        "material": {"model": "neo-hookean", "C10": "5 kPa", "poisson_ratio": 0.49},
        "model": {"mesh_size": 1.0},
    }, gradients=False)  # fmt: skip
    assert found.converged
    deepest = max(figures.penetration_mm for figures in found.equilibria.contact)
    assert (deepest > 0.1 * depth_mm) == is_said
    assert ("mm inside the moving one" in found.message) == is_said


@pytest.mark.parametrize(("height", "is_said"), [(40.0, True), (15.0, False)])
def test_an_axis_that_holds_a_column_straight_is_said(height, is_said):
    """In 3D the quarter of 40 mm buckles at 5.8 mm; Euler's load gives 5.3."""
    found = study.solve({
        "specimen": {"shape": "cylinder", "radius": 5, "height": height},
        "test": {"kind": "compression", "interface": "bonded", "displacement": 0.3 * height,
                 "steps": 2},
        "material": {"model": "neo-hookean", "C10": "5 kPa", "poisson_ratio": 0.45},
        "model": {"mesh_size": 2.5},
    }, gradients=False)  # fmt: skip
    assert found.converged
    assert ("buckles at about 5.32 mm" in found.message) == is_said
