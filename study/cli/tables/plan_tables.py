"""A plan as the terminal shows it: cells, costs, further cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.cli import output
from study.reporting.text import count

if TYPE_CHECKING:
    from study.api.planning.augment import Augmentation
    from study.api.planning.plan import Plan
    from study.design.overview import Overview
    from study.design.spec import Scheme

#: levels of a factor beyond which a plan lists the ends only
MANY = 6
#: rows of a matrix that are looked at on a terminal; of a longer one the first stand for the rest
ROWS = 100
FIRST_ROWS = 20


def _print_scheme(scheme: Scheme) -> None:
    """Say what the choice of cells can and cannot tell."""
    if not scheme.summary:
        return
    print(scheme.summary)
    if scheme.defining_relation:
        print(f"defining relation: {scheme.defining_relation}")
    for sentence in scheme.aliases:
        print(f"  {sentence}")
    print()


def _print_overview(told: Overview) -> None:
    print(f"{told.design.name}: {told.design.question}\n")
    rows = [["cell", "computation", "calibration"]]
    rows += [
        [row.label, str(row.group), "-" if row.calibration is None else str(row.calibration)]
        for row in told.matrix
    ]
    more = len(told.matrix) - FIRST_ROWS if len(told.matrix) > ROWS else 0
    shown = rows[: 1 + FIRST_ROWS] if more else rows
    output.table(shown, f"{len(told.matrix)} cells, {told.distinct} distinct computations")
    if more:
        print(f"and {more:,} more cells: --json lists all of them")
    if told.distinct < len(told.matrix):
        print("cells with the same number of a computation must agree: they are controls")
    for one, why in told.excluded:
        print(f"excluded: {one.label}: {why}")
    print()
    _print_scheme(told.design.scheme)
    for factor in told.factors:
        levels = factor.levels
        if len(levels) > MANY:
            levels = (levels[0], f"{len(levels) - 2} more", levels[-1])
        print(f"{factor.name} ({', '.join(levels)}): {factor.note or 'varies'}")


def print_plan(found: Plan) -> None:
    """Print cells, costs and what is left to be done.

    Parameters
    ----------
    found : Plan
        Its warnings go to stderr; without predicted seconds no time is printed.
    """
    _print_overview(found.overview)
    print()
    if found.blocks:
        print(f"{len(found.blocks)} blocks: {', '.join(found.blocks)}")
    if found.overview.replicates is not None:
        print(f"replicates: {found.overview.replicates.sentence}")
    cells = len(found.overview.matrix)
    if len(found.blocks) > 1 and cells * len(found.blocks) == found.total:
        print(f"{cells} cells in {len(found.blocks)} blocks: a case is a cell in a block")
    print(output.counts(found.counts))
    if found.missing and found.fits:
        calibrations = count(found.fits, "calibration")
        print(f"{calibrations} to be made; each is shared by all cells that can")
    if found.controls:
        solutions = count(found.controls, "solution")
        print(f"{solutions} to be made of one cylinder in both spaces, a control")
    if found.commands:
        calls = count(found.program_calls, "call")
        print(f"{calls} of other programs, gradients by differences included:")
        print("\n".join(f"  {line}" for line in found.commands))
        print(f"  to allow exactly these: study run --allow-digest {found.digest}")
    if found.predicted_seconds is not None:
        time = output.seconds(found.predicted_seconds)
        workers, memory = count(found.jobs, "worker"), f"{found.memory_MB:.0f} MB of memory"
        print(f"predicted: {time} of computing on {workers}, {memory}")
    if found.most_seconds is not None:
        print(f"with all cells that may be added: {output.seconds(found.most_seconds)}")
    output.warn(found.warnings)


def print_further(found: Augmentation) -> None:
    """Print further cells, what they gain, and the table that runs them.

    Parameters
    ----------
    found : Augmentation
        With one further cell or more.
    """
    names = list(found.cells[0])
    rows = [names, *([cell[name] for name in names] for cell in found.cells)]
    print()
    output.table(rows, "Further cells")
    gain = f"{100 * found.before:.0f} % before, {100 * found.after:.0f} % after"
    output.paragraph(
        f"\nTold apart with them: {', '.join(found.terms)}. Precision, of that of an orthogonal "
        f"design of as many cells: {gain}. Put this in place of [design] (what is computed stays):"
    )
    print(f"\n{found.table()}")
