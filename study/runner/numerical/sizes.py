"""Meshes of a series that can be judged, and the sizes by which they are."""

from __future__ import annotations

from collections.abc import Sequence

from study.runner.numerical.formal_order import edge_rules
from study.runner.numerical.refinement import Level
from study.setup.setup import Setup


def usable(levels: Sequence[Level]) -> tuple[list[Level], list[str]]:
    """Meshes with an answer and with elements of their own, and what is wrong with the others.

    Parameters
    ----------
    levels : sequence of Level
        From coarse to fine, those without an answer too.
    """
    kept: list[Level] = []
    said = [
        f"the mesh of {level.mesh_size_mm:.4g} mm gave no answer: {level.result.message}"
        for level in levels
        if not level.converged
    ]
    for level in levels:
        if not level.converged:
            continue
        same = [k for k in kept if k.elements == level.elements and level.elements > 0]
        if same:
            said.append(
                f"the meshes of {same[0].mesh_size_mm:.4g} mm and {level.mesh_size_mm:.4g} mm "
                f"have the same {level.elements} elements: the coarser is left out; a larger "
                "ratio or a smaller mesh_size would refine"
            )
            kept.remove(same[0])
        kept.append(level)
    return kept, said


def representative_sizes(levels: Sequence[Level], setup: Setup) -> list[float]:
    """Sizes of solved meshes, scaled to the finest mesh's own size.

    Parameters
    ----------
    levels, setup : sequence of Level, Setup
        Meshes with an answer, from coarse to fine, and what is refined.
    """
    sizes = [level.mesh_size_mm for level in levels]
    return series_sizes(sizes, [level.elements for level in levels], setup)


def series_sizes(
    sizes: Sequence[float],
    elements: Sequence[int],
    setup: Setup,
    *,
    anchor: int = -1,
) -> list[float]:
    """Sizes by which a series is judged: by its elements, or those at a sharp edge.

    Parameters
    ----------
    sizes, elements : sequence of float, sequence of int
        Sizes asked for (mm), and elements of the meshes.
    setup : Setup
        What is refined.
    anchor : int
        Place of the mesh whose size stays.
    """
    if edge_rules(setup):
        return list(sizes)
    return by_elements(sizes, elements, setup.model.space, anchor=anchor)


def by_elements(
    sizes: Sequence[float], elements: Sequence[int], space: str, *, anchor: int = -1
) -> list[float]:
    """Sizes h = (V / N)^(1/d) of meshes with N elements, scaled to the size of one of them.

    What counts is the ratio, and the elements a mesh really has decide it (Celik et al. 2008):
    whole numbers of cells never give exactly the ratio that was asked for.

    Parameters
    ----------
    sizes, elements : sequence of float, sequence of int
        Sizes asked for (mm), and elements of the meshes; 0 where they are not known.
    space : {"axisymmetric", "3d"}
        Of the elements.
    anchor : int
        Place of the mesh whose size stays.

    Examples
    --------
    >>> by_elements([2.0, 1.0], [100, 441], "axisymmetric")
    [2.1, 1.0]
    """
    if min(elements) <= 0 or len(set(elements)) < len(elements):
        return list(sizes)
    power = 1 / (3 if space == "3d" else 2)
    return [sizes[anchor] * (elements[anchor] / n) ** power for n in elements]
