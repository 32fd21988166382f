"""Response-surface designs: points for a quadratic model, inside the ranges of the factors."""

from __future__ import annotations

from typing import Annotated, Literal

from study.arrays import Array
from study.design.layout import generators
from study.design.layout.request import Made, Request, placed
from study.setup.section import Reads, section
from study.setup.text import choice

MAX_FACTORS = 10


@section
class CentralComposite:
    """Corners, stars and the center.

    Parameters
    ----------
    star : {"inscribed", "faced"}
        Whether the stars alone, or the corners too, lie at the ends of the ranges.
    """

    kind: Literal["central-composite"] = "central-composite"
    star: Annotated[str, Reads(choice("inscribed", "faced"))] = "inscribed"

    def make(self, request: Request) -> Made:
        """Rotatable design, or the face-centered one."""
        if not self.star or not _spans(request, 2):
            return request.nothing
        runs = generators.central_composite(len(request.factors), self.star)
        what = "rotatable" if self.star == "inscribed" else "face-centered"
        return _surface(request, self.kind, runs, f"{what} central composite design")


@section
class BoxBehnken:
    """Middles of edges and the center."""

    kind: Literal["box-behnken"] = "box-behnken"

    def make(self, request: Request) -> Made:
        """Box-Behnken design."""
        if not _spans(request, 3):
            return request.nothing
        runs = generators.box_behnken(len(request.factors))
        return _surface(request, self.kind, runs, "Box-Behnken design")


def _spans(request: Request, least: int) -> bool:
    """Whether every factor is a range; faults say which is not."""
    wrong = [factor for factor in request.factors if factor.span is None]
    for factor in wrong:
        mend = 'write { low = "28 mm", high = "32 mm" }'
        where = f"factors.{factor.name}"
        request.faults.add(where, "must be a range for this design", mend)
    count = len(request.factors)
    if count < least:
        request.fault("kind", f"takes at least {least} factors, got {count}")
        return False
    if count > MAX_FACTORS:
        request.fault("kind", f"takes at most {MAX_FACTORS} factors, got {count}")
        return False
    return not wrong


def _surface(request: Request, kind: str, runs: Array, what: str) -> Made:
    """Levels of each factor are the coded values that it takes."""
    note = (
        "made for a quadratic model of the values, from the table of cases; "
        "the analysis of levels has main effects only"
    )
    words = f"{what}: {len(runs)} cells, the center once"
    return placed(request, kind, (runs + 1) / 2, words, note)
