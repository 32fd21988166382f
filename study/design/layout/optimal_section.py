"""Kind ``d-optimal`` of ``[design]``: fewer cells than combinations, of factors with any levels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Literal

from study.design.diagnostics import noted
from study.design.layout.optimal import Word, d_optimal, efficiency
from study.design.layout.request import MAX_CELLS, Made, Request
from study.design.spec import Scheme
from study.errors import nearest
from study.setup.quantity import integer, shown
from study.setup.section import AsWritten, Bad, Reads, section


@section
class DOptimal:
    """Cells that tell given terms apart best.

    Parameters
    ----------
    runs : int
        Number of cells.
    terms
        Highest order of interaction, or a list of terms such as ``["material", "material:mesh"]``;
        main effects by default.
    seed : int, optional
        Of the search; that of ``[study]`` by default.
    """

    runs: Annotated[int, Reads(integer(2, 1024), mend="say how many, for example 12")]
    kind: Literal["d-optimal"] = "d-optimal"
    terms: AsWritten = None
    seed: Annotated[int | None, Reads(integer(0, 2**32 - 1))] = None

    def make(self, request: Request) -> Made:
        """Search the cells, and say how good they are."""
        names = [factor.name for factor in request.factors]
        sizes = [len(factor.levels) for factor in request.factors]
        words = noted(
            partial(words_of, names), 1 if self.terms is None else self.terms, "design.terms",
            request.faults,
        )  # fmt: skip
        if words is None or not self.runs or request.is_faulty("seed"):
            return request.nothing
        if not self._fits(request, sizes, words):
            return request.nothing
        seed = request.seed if self.seed is None else self.seed
        rows = d_optimal(sizes, words, self.runs, seed)
        found = efficiency(rows, sizes, words)
        if not found:
            rule = f"{self.runs} cells were not found that tell all terms apart"
            request.fault("runs", rule, "add cells, or ask for fewer terms")
        told = f"{100 * found:.1f} % of the precision of as many cells of an orthogonal design"
        summary = f"D-optimal: {self.runs} of {math.prod(sizes)} cells, {told}"
        terms = tuple(":".join(names[k] for k in word) for word in words)
        note = f"told apart: {', '.join(terms)}; every other interaction may be mixed with these"
        return request.factors, Scheme(self.kind, rows, summary, (note,), terms=terms)

    def _fits(self, request: Request, sizes: Sequence[int], words: Sequence[Word]) -> bool:
        """Check the number of cells against the factors and the terms."""
        before, every = len(request.faults), math.prod(sizes)
        wanted = 1 + sum(math.prod(sizes[k] - 1 for k in word) for word in words)
        if any(factor.span is not None for factor in request.factors):
            mend = 'list its levels, or use kind = "central-composite"'
            request.fault("kind", "a D-optimal design takes listed levels, no range", mend)
        if every > MAX_CELLS:
            request.fault(
                "kind", f"{every} combinations are more than {MAX_CELLS}", "use fewer levels"
            )
        if self.runs < wanted:
            rule = f"{self.runs} cells cannot tell {wanted} numbers (the mean and the terms)"
            request.fault("runs", rule, f"at least {wanted}")
        if self.runs > every:
            rule = f"{self.runs} cells, of which there are {every}"
            request.fault("runs", rule, 'at most as many, or kind = "full"')
        return len(request.faults) == before


def words_of(names: Sequence[str], value: object) -> tuple[Word, ...]:
    """Read an order of interaction or a list of terms as the numbers of their factors.

    Parameters
    ----------
    names : sequence of str
        Of all factors, in order.
    value
        Raw value: the highest order of interaction, or a list of terms such as ``"a:b"``.

    Returns
    -------
    tuple of tuple of int
        Numbers of the factors of every term, from 0 and rising.

    Raises
    ------
    Bad
        For a factor that does not exist, or stands twice in a term.
    """
    if isinstance(value, list) and value:
        return tuple(dict.fromkeys(_word(names, term) for term in value))
    highest = integer(1, len(names))(value)
    orders = range(1, highest + 1)
    return tuple(w for order in orders for w in itertools.combinations(range(len(names)), order))


def _word(names: Sequence[str], term: object) -> Word:
    parts = [part.strip() for part in term.split(":")] if isinstance(term, str) else []
    for part in parts or [shown(term)]:
        if part not in names:
            raise Bad(f"no factor {shown(part)}", nearest(part[:80], names))
    if len(set(parts)) < len(parts):
        raise Bad(f"a factor stands twice in {shown(term)}")
    return tuple(sorted(names.index(part) for part in parts))
