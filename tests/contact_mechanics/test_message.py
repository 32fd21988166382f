"""What a message says of a surface that does not follow the indenter."""

from __future__ import annotations

import pytest

import study


@pytest.mark.parametrize(("depth_mm", "is_said"), [(6.0, True), (1.0, False)])
def test_facets_that_bridge_the_edge_of_a_punch_are_said(depth_mm: float, is_said: bool) -> None:
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
