"""One forward simulation: adaptive load steps to a force-displacement curve with gradients."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from study.compilation import vectors_alone
from study.errors import MeshError
from study.fem.checks import check, instability
from study.fem.mesh.mesh import Mesh
from study.fem.mesh.mesher import build_mesh
from study.fem.solver.load_path import LoadPath
from study.fem.solver.options import Options
from study.fem.solver.solution import Solution, without_answer
from study.fem.solver.system import System
from study.setup.setup import Problem

__all__ = ["Options", "solve"]


def solve(
    problem: Problem,
    *,
    gradients: bool = True,
    warm: Solution | None = None,
    progress: Callable[[float], None] | None = None,
    options: Options | None = None,
    mesh: Mesh | None = None,
) -> Solution:
    """Simulate one test.

    Parameters
    ----------
    problem : Problem
        What is simulated.
    gradients : bool
        Whether dF/dconstant is computed at every requested step.
    warm : Solution, optional
        An earlier solution of the same problem with other constants; its mesh, symbolic
        analysis and converged steps are reused.
    progress : callable, optional
        Called with the fraction of the displacement that is done.
    options : Options, optional
        Tolerances and step rule.
    mesh : Mesh, optional
        Use this mesh instead of the generated one.

    Returns
    -------
    Solution
        Expected failure is a status, not an exception.

    Raises
    ------
    InputError
        If the problem asks for something that is not modelled.
    """
    began = time.perf_counter()
    options = options or Options()
    check(problem)
    unstable = instability(problem)
    if unstable:
        return without_answer(problem, "unstable", unstable, time.perf_counter() - began)
    try:
        with vectors_alone():
            system = _system(problem, warm, options, mesh)
            start_from = partial(LoadPath, system, problem, options, gradients, progress)
            run = start_from(warm).to_the_end()
            if warm is not None and run.may_do_better():
                system.kept.forget()
                run = start_from(None).to_the_end()
            return run.solution(time.perf_counter() - began)
    except MemoryError as error:
        message = f"{error}: use a larger mesh_size, or axisymmetric space"
        return without_answer(problem, "out-of-memory", message, time.perf_counter() - began)
    except MeshError as error:
        return without_answer(problem, "mesh-failed", str(error), time.perf_counter() - began)


def _system(problem: Problem, warm: Solution | None, options: Options, mesh: Mesh | None) -> System:
    if warm is not None and warm.warm is not None:
        system = warm.warm.system.with_material(problem.material)
        system.kept.forget()
        return system
    return System.build(
        problem,
        build_mesh(problem.setup) if mesh is None else mesh,
        solver=options.linear_solver,
        folding=options.side_contact,
    )
