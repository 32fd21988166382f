"""Kind ``d-optimal`` of ``[design]``: fewer cells than combinations, of factors with any levels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Literal

import numpy as np

from study.ground.arrays import Array
from study.ground.declaration import (
    AsWritten,
    Bad,
    Reads,
    choice,
    integer,
    section,
    shown,
)
from study.ground.diagnostics import Faults, noted, read_table
from study.ground.errors import nearest
from study.harness.design import generators
from study.harness.design.generators import Word, d_optimal, efficiency
from study.harness.design.layouts import (
    MAX_CELLS,
    BoxBehnken,
    CentralComposite,
    Fractional,
    Full,
    LatinHypercube,
    Layout,
    Listed,
    Made,
    Morris,
    PlackettBurman,
    Request,
    Sobol,
    placed,
)
from study.harness.design.spec import Factor, Scheme
from study.harness.design.study_file import Sequential


@section
class DOptimal:
    """Cells that tell given terms apart best."""

    runs: Annotated[int, Reads(integer(2, 1024), mend="say how many, for example 12")]
    kind: Literal["d-optimal"] = "d-optimal"
    #: Highest order of interaction, or a list of terms such as ``["material", "material:mesh"]``;
    #: main effects by default.
    terms: AsWritten = None
    #: Of the search; that of ``[study]`` by default.
    seed: Annotated[int | None, Reads(integer(0, 2**32 - 1))] = None

    def make(self, request: Request) -> Made:
        """StagedSearch the cells, and say how good they are."""
        names = [factor.name for factor in request.factors]
        sizes = [len(factor.levels) for factor in request.factors]
        words = noted(
            partial(words_of, names), 1 if self.terms is None else self.terms, "design.terms",
            request.faults,
        )  # fmt: skip
        if words is None or not self._fits(request, sizes, words):
            return request.nothing
        seed = request.seed if self.seed is None else self.seed
        rows = d_optimal(sizes, words, self.runs, seed)
        precision = efficiency(rows, sizes, words)
        if not precision:
            rule = f"{self.runs} cells were not found that tell all terms apart"
            request.fault("runs", rule, "add cells, or ask for fewer terms")
        text = f"{100 * precision:.1f} % of the precision of as many cells of an orthogonal design"
        summary = f"D-optimal: {self.runs} of {math.prod(sizes)} cells, {text}"
        terms = tuple(":".join(names[k] for k in word) for word in words)
        note = f"told apart: {', '.join(terms)}; every other interaction may be mixed with these"
        return request.factors, Scheme(self.kind, rows, summary, (note,), terms=terms)

    def _fits(self, request: Request, sizes: Sequence[int], words: Sequence[Word]) -> bool:
        """Check the number of cells against the factors and the terms."""
        before, every = len(request.faults), math.prod(sizes)
        needed = 1 + sum(math.prod(sizes[k] - 1 for k in word) for word in words)
        if any(factor.span is not None for factor in request.factors):
            mend = 'list its levels, or use kind = "central-composite"'
            request.fault("kind", "a D-optimal design takes listed levels, no range", mend)
        if every > MAX_CELLS:
            request.fault(
                "kind", f"{every} combinations are more than {MAX_CELLS}", "use fewer levels"
            )
        if self.runs < needed:
            rule = f"{self.runs} cells cannot tell {needed} numbers (the mean and the terms)"
            request.fault("runs", rule, f"at least {needed}")
        if self.runs > every:
            rule = f"{self.runs} cells, of which there are {every}"
            request.fault("runs", rule, 'at most as many, or kind = "full"')
        return len(request.faults) == before


def words_of(names: Sequence[str], value: object) -> tuple[Word, ...]:
    """Read an order of interaction or a list of terms as the numbers of their factors."""
    if isinstance(value, list) and value:
        return tuple(dict.fromkeys(word_of(names, term) for term in value))
    highest = integer(1, len(names))(value)
    orders = range(1, highest + 1)
    return tuple(w for order in orders for w in itertools.combinations(range(len(names)), order))


def word_of(names: Sequence[str], term: object) -> Word:
    """Read a term such as ``"A:B"`` as the numbers of its factors."""
    parts = [part.strip() for part in term.split(":")] if isinstance(term, str) else [term]
    for part in parts:
        if part not in names:
            raise Bad(f"no factor {shown(part)}", nearest(str(part)[:80], names))
    if len(set(parts)) < len(parts):
        raise Bad(f"a factor stands twice in {shown(term)}")
    return tuple(k for k, name in enumerate(names) if name in parts)


# Kind ``adaptive`` of ``[design]``: a Latin hypercube, and cells that are added while it runs.

#: fewest cells at the beginning for each range: an emulator needs three
FEWEST = 3


@section
class Adaptive(Sequential):
    """Cells that are chosen by what those before them have shown."""

    def make(self, request: Request) -> Made:
        """Draw the first cells, and place those that were added."""
        factors = request.factors
        ranges = [factor for factor in factors if factor.span is not None]
        others = [len(factor.levels) for factor in factors if factor.span is None]
        if not self._fits(request, len(ranges), math.prod(others)):
            return request.nothing
        seed = request.seed if self.seed is None else self.seed
        shares = _start(factors, self.start // math.prod(others), seed)
        every = np.vstack([shares, *(np.array([c]) for c in self.added)])
        factors, rows = placed(factors, every, each_alone=True)
        if len(set(rows)) < len(rows):
            request.fault("added", "two cells are the same", "leave it to `study run`")
        note = "cells are added where an emulator is least sure: see the surface"
        settings = replace(self, seed=seed)
        return factors, Scheme(self.kind, rows, self._summary(seed), (note,), sequential=settings)

    def _summary(self, seed: int) -> str:
        goal = (
            f"the leave-one-out Q2 of every response is {self.q2:g}"
            if self.until == "q2"
            else "every factor has a verdict"
        )
        more = f", {len(self.added)} cells were added" if self.added else ""
        return (
            f"Adaptive: {self.start} cells of a Latin hypercube (seed {seed}){more}; {self.batch} "
            f"at a time are added where the emulator is least sure, until {goal}, at most "
            f"{self.budget} cells"
        )

    def _fits(self, request: Request, ranges: int, others: int) -> bool:
        """Check the numbers of cells against each other and against the factors."""
        before = len(request.faults)
        if not ranges:
            mend = 'write one as { low = "28 mm", high = "32 mm" }'
            request.fault("kind", "no factor is a range to be filled", mend)
            return False
        least = FEWEST * ranges * others
        if self.start < least or self.start % others:
            whole = others * math.ceil(max(self.start, least) / others)
            rule = f"{self.start} cells do not carry an emulator of {ranges} ranges"
            if self.start >= least:
                rule = f"{self.start} cells cannot be shared by {others} combinations of levels"
            request.fault("start", rule, f"for example {whole}")
        if self.budget < self.start + len(self.added):
            rule = f"{self.budget} is less than the {self.start + len(self.added)} cells there are"
            request.fault("budget", rule, f"for example {2 * self.start}")
        if any(len(cell) != len(request.factors) for cell in self.added):
            rule = f"every cell needs a share of each of the {len(request.factors)} factors"
            request.fault("added", rule, "leave it to `study run`")
        return len(request.faults) == before


def _start(factors: Sequence[Factor], runs: int, seed: int) -> Array:
    """Shares of a Latin hypercube of its own at every combination of the listed levels."""
    ranged = [j for j, factor in enumerate(factors) if factor.span is not None]
    listed = [j for j, factor in enumerate(factors) if factor.span is None]
    parts = []
    combinations = itertools.product(*(range(len(factors[j].levels)) for j in listed))
    for number_of, combination in enumerate(combinations):
        part = np.empty((runs, len(factors)))
        part[:, ranged] = generators.latin_hypercube(len(ranged), runs, seed + number_of)
        for j, index in zip(listed, combination, strict=True):
            part[:, j] = share_of(index, len(factors[j].levels))
        parts.append(part)
    return np.vstack(parts)


def share_of(index: int, count: int) -> float:
    """Share that stands for one of some listed levels."""
    return (index + 0.5) / count


# Table ``[design]``: which combinations of the levels are run (docs/writing-designs.md).

#: every kind of ``[design]`` by its name
LAYOUTS: Mapping[str, type[Layout]] = {
    "full": Full,
    "fractional": Fractional,
    "plackett-burman": PlackettBurman,
    "central-composite": CentralComposite,
    "box-behnken": BoxBehnken,
    "latin-hypercube": LatinHypercube,
    "sobol": Sobol,
    "morris": Morris,
    "adaptive": Adaptive,
    "d-optimal": DOptimal,
    "listed": Listed,
}


def scheme_from(
    table: object, factors: tuple[Factor, ...], seed: int, excluding: bool, faults: Faults
) -> Made:
    """Read ``[design]`` (None where it is left out) and give every factor the levels it needs."""
    written = {} if table is None else table
    word = written.get("kind", "full") if isinstance(written, Mapping) else "full"
    kind = noted(choice(*LAYOUTS), word, "design.kind", faults)
    if kind is None or not factors:
        return _few(factors), Scheme()
    before = len(faults)
    if excluding and kind not in ("full", "listed"):
        faults.add("exclude", f"a {kind} design cannot lose runs", 'use kind = "full", or none')
    layout = read_table(LAYOUTS[kind], written, "design", faults)
    factors_and_scheme = factors, Scheme()
    # of a key that nobody declares the others do not depend
    if all(fault.rule == "unknown key" for fault in faults[before:]):
        factors_and_scheme = layout.make(Request(factors, seed, faults))
    return (_few(factors), Scheme()) if len(faults) > before else factors_and_scheme


def _few(factors: tuple[Factor, ...]) -> tuple[Factor, ...]:
    """Factors of a faulty table, for checks of their cells; none where these are too many."""
    return factors if math.prod(len(f.levels) for f in factors) <= MAX_CELLS else ()
