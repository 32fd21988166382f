"""F10: a matrix that leaves a motion free is told, and no kind of test leaves one."""

from __future__ import annotations

import numpy as np
import pytest

from study.mechanics.element.function_space import Pattern
from study.mechanics.setup.geometry import Cone
from study.mechanics.setup.test_kind import Test as Loading
from study.mechanics.setup.test_section import TEST_KINDS
from study.mechanics.solver.linear_solver import SingularMatrixError, SuperLU


def test_a_singular_matrix_is_told() -> None:
    """Two nodes on a spring that nobody holds: their common motion costs nothing."""
    index, upper = np.arange(2), np.array([0, 1, 1], np.int32)
    rows = np.array([0, 2, 3], np.int32)
    pattern = Pattern(index, index.astype(np.int32), rows, upper, np.zeros((1, 3), np.int32))
    solver = SuperLU(pattern)
    with pytest.raises(SingularMatrixError):
        solver.factorize(np.array([1.0, -1.0, 1.0]))
    solver.factorize(np.array([1.0, -1.0, 2.0]))  # one of them held by a second spring
    assert solver.solve(np.array([0.0, 1.0])) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize(
    "loading",
    [
        Loading("compression", 5.0, "frictionless", "frictionless"),
        Loading("indentation", 1.5, "frictionless", "frictionless", indenter=Cone(30.0, 1.0)),
    ],
)
def test_every_kind_of_test_holds_the_specimen(loading: Loading) -> None:
    """Symmetry holds it across the axis; along the axis a face has to."""
    faces = TEST_KINDS[loading.kind].faces(loading)
    assert any(face.face == "base" and face.axial == 0 for face in faces)
