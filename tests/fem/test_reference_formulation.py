"""The compiled residual and tangent are those of the forms, for every element and energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from study.mechanics.material.material import Material
from study.mechanics.mesh.structured import Mesh, extrude, rectangle
from study.mechanics.setup.setup import Model
from study.mechanics.solver.system import System
from tests.fem.homogeneous import held, system_of
from tests.fem.problems import LONG, irregular
from tests.fem.reference_formulation import Formulation

MATERIALS = [
    Material("neo-hookean", {"C10": 0.4}, poisson_ratio=0.49),
    Material("mooney-rivlin", {"C10": 0.3, "C01": 0.2}, poisson_ratio=0.4995),
    Material("reduced-polynomial", {"C10": 0.4, "C20": -0.1, "C30": 0.2}, bulk_modulus=30.0),
    Material("polynomial", {"C10": 0.3, "C01": 0.1, "C11": 0.05}, poisson_ratio=0.49),
    Material("ogden", {"mu1": 0.5, "alpha1": 2.7, "mu2": 0.3, "alpha2": -1.4}, poisson_ratio=0.49),
    Material("linear-elastic", {"youngs_modulus": 1.2}, poisson_ratio=0.45),
]
ELEMENTS = [
    (space, order, shape, formulation)
    for space in ("axisymmetric", "3d")
    for order in ("linear", "quadratic")
    for shape in ("simplex", "tensor")
    for formulation in ("mixed", "displacement")
]


def made(
    space: str, order: str, shape: str, formulation: str, material: Material
) -> tuple[System, Mesh]:
    """Distorted elements whose volume is not stabilized, which is no integral of a point."""
    kinds = {"element_order": order, "element_shape": shape, "formulation": formulation}
    line = np.linspace(0, 1, 2 if space == "3d" else 3)
    points, cells = rectangle(line, line, shape)
    if space == "3d":
        points, cells = extrude(points, cells, line)
    mesh = irregular(Mesh(points, cells, False, 1 / (len(line) - 1)))
    system = system_of(material, mesh, space=space, **kinds)
    free = held(system, np.zeros(0, np.int64), np.zeros(0))
    return replace(free, internal=replace(free.internal, evenness=0.0, local_bulk=0.0)), mesh


def state(system: System, amplitude: float) -> np.ndarray:
    """Uneven displacements and pressures."""
    rng = np.random.default_rng(2011)
    x = amplitude * rng.standard_normal(system.space.n)
    nodes = system.space.nodes
    if system.space.dim == 2:  # nothing moves off the axis
        x[: system.space.n_displacement : 2][nodes[:, 0] == 0.0] = 0.0
    return x


#: in the suite each element with one energy, and each energy with one element of each space
PAIRS = [
    pytest.param(
        element, material, id=f"{material.model}-{'-'.join(element)}",
        marks=() if material is MATERIALS[1] or element[1:] == ELEMENTS[0][1:] else LONG,
    )
    for element in ELEMENTS
    for material in MATERIALS
]  # fmt: skip


@pytest.mark.parametrize(("element", "material"), PAIRS)
def test_kernels_are_the_forms(element: tuple[str, str, str, str], material: Material) -> None:
    system, mesh = made(*element, material)
    space, order, shape, formulation = element
    model = Model(space, order, element_shape=shape, formulation=formulation)  # type: ignore[arg-type]
    x = state(system, 0.02)
    system.internal.evaluate(material, x, system.tangent)
    n = system.space.n_displacement
    form = Formulation.of(mesh, model, system.space, material, x)
    residual = system.internal.gathered()
    scale = np.abs(residual[:n]).max()
    # both sum the same products in another order: rounding of the largest, and K stands in it
    assert residual[:n] == pytest.approx(form.forces(), abs=1e-12 * scale + 1e-13)
    assert residual[n:] == pytest.approx(form.volumes(), abs=1e-13)
    pattern = system.pattern
    half = sp.csr_matrix(
        (system.tangent.data, pattern.indices, pattern.indptr), (system.space.n,) * 2
    ).toarray()
    whole = half + half.T - np.diag(np.diag(half))
    expected = form.stiffness().toarray()
    assert whole[:n, :n] == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    assert whole[n:, :n] == pytest.approx(form.coupling(), abs=1e-13)
