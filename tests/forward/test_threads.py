"""Threads change how long a simulation takes, and no digit of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from study.forward import threads
from study.forward.mesh import build_mesh
from study.forward.problem import Cylinder, Model, Problem, Test
from study.forward.system import System
from study.material import Material

GEL = Material("neo-hookean", {"C10": 5e-3}, bulk_modulus=10.0)


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
@pytest.mark.parametrize("formulation", ["mixed", "displacement"])
def test_elements_in_slices_give_the_same_bits(
    space: Any, formulation: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = Model(space, "quadratic", formulation=formulation, mesh_size_mm=8.0)
    problem = Problem(
        Cylinder(25.0, 50.0), Test("compression", 2.0, "bonded", "bonded"), GEL, model
    )
    system = System.build(problem, build_mesh(problem))
    x = 1e-2 * np.random.default_rng(7).normal(size=system.space.n)
    found = []
    for count in (1, 2, 3):
        monkeypatch.setattr(threads, "_FEW", 0)
        monkeypatch.setattr(threads._CONFIG, "NUMBA_NUM_THREADS", count)
        system.internal.residuals[:] = system.internal.tangents[:] = np.nan
        smallest = system.internal.evaluate(GEL, x, tangent=True)
        J = system.volume_ratios(x)
        found.append(
            (smallest, J, system.internal.residuals.copy(), system.internal.tangents.copy())
        )
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)
    assert np.isfinite(found[0][3]).all()


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
def test_a_tangent_summed_by_two_threads_has_the_same_bits(
    space: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = Problem(
        Cylinder(25.0, 50.0), Test("compression", 2.0, "bonded", "bonded"), GEL,
        Model(space, "quadratic", mesh_size_mm=6.0),
    )  # fmt: skip
    system = System.build(problem, build_mesh(problem))
    first, apart, between = system.pattern.groups
    assert between.size
    assert apart.size or space == "axisymmetric"  # whose triangles come in two lists
    np.testing.assert_array_equal(
        np.sort(np.concatenate([first, apart, between])), np.arange(system.space.n_elements)
    )
    assert not np.intersect1d(system.space.dofs[first], system.space.dofs[apart]).size
    packed = system.internal.tangents
    packed[:] = np.random.default_rng(3).normal(size=packed.shape)
    monkeypatch.setattr(threads, "_FEW", 0)
    found = []
    for count in (1, 2):
        monkeypatch.setattr(threads._CONFIG, "NUMBA_NUM_THREADS", count)
        data = np.full(system.pattern.indices.size, np.nan)
        system.internal.scatter(system.pattern, data)
        found.append(data)
    np.testing.assert_array_equal(*found)
    positions = system.pattern.positions
    inside = positions >= 0
    expected = np.bincount(positions[inside], packed.ravel()[inside], minlength=found[0].size)
    np.testing.assert_allclose(found[0], expected, atol=1e-13)


def test_an_error_in_a_slice_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    def loop(part: slice) -> float:
        if part.start:
            raise ZeroDivisionError
        return 1.0

    monkeypatch.setattr(threads, "_FEW", 0)
    monkeypatch.setattr(threads._CONFIG, "NUMBA_NUM_THREADS", 2)
    with pytest.raises(ZeroDivisionError):
        threads.smallest_in_slices((10, 4), loop)


def openblas() -> list[int]:
    return [lib["num_threads"] for lib in threadpool_info() if lib["internal_api"] == "openblas"]


def test_vectors_are_added_up_alone_and_only_for_a_while() -> None:
    before = openblas()
    with threads.vectors_alone():
        assert set(openblas()) <= {1}
    assert openblas() == before
