"""Mesh seeds as blocks: whether the seeds of a study are common to all of its cells.

A seed that every cell shares is a block: the effect is tested against its own interaction with
the seeds, and the question is whether another mesh of this size would change it. Seeds that
differ between cells are replicates within cells.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from study.errors import Fault, InputError

#: seeds that a plan should ask for: with 5 the power at correlation .5 is .26, with 8 .53
SEEDS_WANTED = 8


class SeedRole(StrEnum):
    """What the seeds of a study are."""

    BLOCKS = "blocks"
    AVERAGED = "averaged within blocks"
    WITHIN_CELLS = "replicates within cells"
    NONE = "none"


@dataclass(frozen=True)
class SeedDesign:
    """What the seeds are, which are used, and why.

    Parameters
    ----------
    role : SeedRole
        How the analysis uses the seeds.
    common : tuple of str
        Seeds that every cell has, in the order found.
    left_out : tuple of str
        Seeds that some cell lacks and that are therefore left out everywhere.
    reason : str
        Sentence for the report.
    """

    role: SeedRole
    common: tuple[str, ...]
    left_out: tuple[str, ...]
    reason: str


def seed_design(
    cells: Sequence[Hashable], seeds: Sequence[object], *, blocks: bool = False
) -> SeedDesign:
    """Decide from the labels whether seeds are common to all cells.

    Parameters
    ----------
    cells : sequence of hashable, length n
        Cell of each row.
    seeds : sequence of object, length n
        Label of the mesh seed of each row.
    blocks : bool
        Whether the study has real blocks (specimens); seeds are then averaged within them.

    Returns
    -------
    SeedDesign
        Blocks if at least two seeds, and at least half of all labels, occur in every cell.

    Raises
    ------
    InputError
        If the columns differ in length or are empty.

    Examples
    --------
    >>> seed_design(["a", "a", "b", "b"], [1, 2, 1, 2]).role.value
    'blocks'
    >>> seed_design(["a", "a", "b", "b"], [1, 2, 3, 4]).role.value
    'replicates within cells'
    """
    if not cells or len(cells) != len(seeds):
        rule = f"one seed for each of {len(cells)} rows is needed, got {len(seeds)}"
        raise InputError(Fault("seeds", rule))
    held: dict[Hashable, set[str]] = {}
    for cell, seed in zip(cells, seeds, strict=True):
        held.setdefault(cell, set()).add(str(seed))
    labels = tuple(dict.fromkeys(str(seed) for seed in seeds))
    common = tuple(s for s in labels if all(s in own for own in held.values()))
    left = tuple(s for s in labels if s not in common)
    if len(labels) == 1:
        return SeedDesign(SeedRole.NONE, common, left, "one mesh seed: its effect is not seen")
    shared = len(common) >= 2 and 2 * len(common) >= len(labels)
    if shared and blocks:
        why = f"the {len(common)} mesh seeds are averaged within each block first"
        return SeedDesign(SeedRole.AVERAGED, common, left, why + _left_out(left))
    if shared:
        why = f"the {len(common)} mesh seeds are common to all cells, so they are blocks"
        return SeedDesign(SeedRole.BLOCKS, common, left, why + _left_out(left))
    why = "mesh seeds differ between cells: replicates, pooled within cells"
    return SeedDesign(SeedRole.WITHIN_CELLS, common, (), why)


def _left_out(seeds: tuple[str, ...]) -> str:
    if not seeds:
        return ""
    return f"; missing in some cell and left out everywhere: {', '.join(seeds)}"
