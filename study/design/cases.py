"""Cells -> cases: every cell in every block, named by its content."""

from __future__ import annotations

from collections.abc import Sequence

from study.design.sections.content import block_ids
from study.design.spec import Case, Design
from study.errors import Fault, InputError

MAX_CASES = 100_000


def cases(design: Design, blocks: Sequence[str] = ()) -> tuple[Case, ...]:
    """Every cell in every block; one case a cell where there are no blocks.

    Parameters
    ----------
    design : Design
        The study.
    blocks : sequence of str
        Labels of the blocks, as the measurements have them.

    Raises
    ------
    InputError
        If a block stands twice, or there are too many cases.
    """
    if len(set(blocks)) < len(blocks):
        raise InputError(Fault("measurements.block", f"labels must be distinct, got {blocks}"))
    cells = design.treatments
    if len(cells) * max(1, len(blocks)) > MAX_CASES:
        rule = f"{len(cells)} cells in {len(blocks)} blocks are more than {MAX_CASES} cases"
        raise InputError(Fault("factors", rule, "use fewer levels, or several studies"))
    places = tuple(blocks) or (None,)
    return tuple(
        Case(cell, block, cell.config, name)
        for cell in cells
        for block, name in zip(places, block_ids(cell.config, places), strict=True)
    )
