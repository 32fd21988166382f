"""Threads change how long a simulation takes, and no digit of it."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from study.ground import compilation
from study.mechanics.element import function_space
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver.system import System
from tests.fem.problems import GEL, NEEDLE, compression, indentation


def compressed(space, formulation="mixed", size=6.0):
    problem = compression(
        Cylinder(25.0, 50.0), 2.0, material=GEL, space=space, formulation=formulation,
        mesh_size_mm=size,
    )  # fmt: skip
    return System.build(problem, build_mesh(problem.setup))


@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
@pytest.mark.parametrize("formulation", ["mixed", "displacement"])
def test_any_number_of_threads_gives_the_same_bits(space, formulation, monkeypatch):
    """And those of all elements at once but for the order of sums."""
    whole = compressed(space, formulation)  # a small body is no work for threads
    assert len(whole.internal.phases) == 1
    monkeypatch.setattr(function_space, "_WORTH", 50)
    system = compressed(space, formulation)
    assert len(system.internal.phases) == 2
    assert len(system.internal.phases[0]) > 1
    x = 1e-2 * np.random.default_rng(7).normal(size=system.space.n)
    found = []
    for count in (1, 2, 3):
        monkeypatch.setattr(compilation._CONFIG, "NUMBA_NUM_THREADS", count)
        system.internal.residuals[:] = system.data[:] = system.tangent.sums.packed[:] = np.nan
        smallest = system.internal.evaluate(GEL, x, system.tangent)
        J = system.internal.volume_ratios(GEL, x)
        sums = system.data.copy(), system.tangent.sums.packed.copy()
        found.append((smallest, J, system.internal.residuals.copy(), *sums))
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)
    assert all(np.isfinite(part).all() for part in found[0])
    whole.internal.evaluate(GEL, x, whole.tangent)
    expected = whole.tangent.product(x)
    atol = 1e-12 * np.abs(expected).max()
    np.testing.assert_allclose(system.tangent.product(x), expected, atol=atol)


def under_a_needle():
    """A graded mesh: many elements in little room, and large ones around it."""
    problem = indentation(NEEDLE, 5.0, material=GEL, space="3d", mesh="coarse")
    return System.build(problem, build_mesh(problem.setup))


@pytest.mark.parametrize(
    ("built", "counts"),
    [
        (lambda: compressed("axisymmetric"), [2, 2]),
        (lambda: compressed("3d"), [2, 2]),
        (under_a_needle, [2, 1]),
    ],
    ids=["axisymmetric", "3d", "graded"],
)
def test_what_is_worked_on_at_once_shares_no_unknown(built, counts, monkeypatch):
    monkeypatch.setattr(function_space, "_COUNTS", (4,))
    monkeypatch.setattr(function_space, "_WORTH", 50)
    system = built()
    phases, dofs = system.internal.phases, system.space.dofs
    assert [len(phase) for phase in phases] == counts
    every = np.concatenate([part for phase in phases for part in phase])
    np.testing.assert_array_equal(np.sort(every), np.arange(system.space.n_elements))
    for phase in phases:
        met = np.concatenate([np.unique(dofs[part]) for part in phase])
        assert np.unique(met).size == met.size
    larger = max(part.size for part in phases[0])
    assert all(part.size > 0.4 * larger for part in phases[0])


def test_an_error_in_a_part_is_not_lost(monkeypatch):
    def loop(part):
        if part[0]:
            raise ZeroDivisionError
        return 1.0

    monkeypatch.setattr(compilation._CONFIG, "NUMBA_NUM_THREADS", 2)
    with pytest.raises(ZeroDivisionError):
        compilation.smallest([(np.array([0], np.uint32), np.array([1], np.uint32))], loop)


def openblas():
    return [lib["num_threads"] for lib in threadpool_info() if lib["internal_api"] == "openblas"]


def test_vectors_are_added_up_alone_and_only_for_a_while():
    before = openblas()
    with compilation.vectors_alone():
        assert set(openblas()) <= {1}
    assert openblas() == before
