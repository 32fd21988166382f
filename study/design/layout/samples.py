"""Space-filling designs: samples of the ranges of the factors."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Literal

from study.arrays import Array
from study.design.layout import generators
from study.design.layout.request import Made, Request, placed
from study.setup.quantity import integer
from study.setup.section import Reads, section

MAX_RUNS = 1024

_Runs = Annotated[int, Reads(integer(2, MAX_RUNS), mend="say how many, for example 32")]
_Seed = Annotated[int | None, Reads(integer(0, 2**32 - 1))]


@section
class LatinHypercube:
    """Every range in as many slices as runs, each with one run.

    Parameters
    ----------
    runs : int
        Number of cells.
    seed : int, optional
        Of the draw; that of ``[study]`` by default.
    """

    runs: _Runs
    kind: Literal["latin-hypercube"] = "latin-hypercube"
    seed: _Seed = None

    def make(self, request: Request) -> Made:
        """Sample the ranges."""
        return _filled(request, self.kind, self.runs, self.seed, generators.latin_hypercube)


@section
class Sobol:
    """Scrambled Sobol sequence.

    Parameters
    ----------
    runs : int
        Number of cells, a power of two.
    seed : int, optional
        Of the scrambling; that of ``[study]`` by default.
    """

    runs: _Runs
    kind: Literal["sobol"] = "sobol"
    seed: _Seed = None

    def make(self, request: Request) -> Made:
        """Sample the ranges."""
        if self.runs and self.runs & (self.runs - 1):
            near = 2 ** round(math.log2(self.runs))
            rule = f"must be a power of two, got {self.runs}"
            request.fault("runs", rule, f"for example {near}")
            return request.nothing
        return _filled(request, self.kind, self.runs, self.seed, generators.sobol)


def _filled(
    request: Request,
    kind: str,
    runs: int,
    seed: int | None,
    draw: Callable[[int, int, int], Array],
) -> Made:
    if all(factor.span is None for factor in request.factors):
        mend = 'write one as { low = "28 mm", high = "32 mm" }'
        request.fault("kind", "no factor is a range to be filled", mend)
    if not runs or request.is_faulty("seed"):
        return request.nothing
    own = request.seed if seed is None else seed
    words = f"{kind.replace('-', ' ')}: {runs} cells, seed {own}".capitalize()
    note = (
        "every setting of a range stands in one cell: no table of levels, but a surface over the "
        "ranges tells the factors apart; study run fits it"
    )
    return placed(request, kind, draw(len(request.factors), runs, own), words, note)
