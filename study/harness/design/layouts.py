"""Kinds of ``[design]`` that sample: fractions, designs for surfaces, space-filling ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal, Protocol

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
from study.ground.diagnostics import Faults, noted
from study.ground.errors import nearest
from study.harness.design import generators
from study.harness.design.factors import levels_at
from study.harness.design.spec import MAX_RUNS, CellCount, Factor, Scheme

#: factors with the levels that a design needs, and which combinations of them are run
Made = tuple[tuple[Factor, ...], Scheme]

MAX_CELLS = 4096


@dataclass(frozen=True)
class Request:
    """What a design is made of."""

    #: As listed; a range has its two ends as levels.
    factors: tuple[Factor, ...]
    #: Of the study, for designs that draw.
    seed: int
    #: Where faults go.
    faults: Faults

    def fault(self, key: str, rule: str, mend: str = "") -> None:
        """Note a fault of a key of ``[design]``."""
        self.faults.add(f"design.{key}", rule, mend)

    @property
    def nothing(self) -> Made:
        """What is made where a fault was found: the factors, for checks of their cells."""
        return self.factors, Scheme()


class Layout(Protocol):
    """One kind of ``[design]``: a section whose keys are those that the kind has."""

    def make(self, request: Request) -> Made:
        """Levels and combinations; anything where a fault is noted."""


def placed(
    factors: Sequence[Factor], shares: Array, *, each_alone: bool = False
) -> tuple[tuple[Factor, ...], tuple[tuple[int, ...], ...]]:
    """Levels and rows of a design whose runs are shares of each range, (runs, factors).

    With ``each_alone`` a level is written by its own share alone, so that a cell stays what it is
    when more are added.
    """
    placed_factors, columns = [], []
    for factor, column in zip(factors, shares.T, strict=True):
        count, span = len(factor.levels), factor.span
        if span is None:
            placed_factors.append(factor)
            columns.append([min(int(x * count), count - 1) for x in column])
            continue
        if each_alone:
            alone = [levels_at(span, (float(share),))[0] for share in column]
            by_share = (alone[i] for i in np.argsort(column, kind="stable"))
            levels = tuple({level.label: level for level in by_share}.values())
            labels = [level.label for level in levels]
            index = [labels.index(level.label) for level in alone]
        else:
            values, inverse = np.unique(np.round(column, 12), return_inverse=True)
            levels, index = levels_at(span, values.tolist()), inverse.tolist()
        placed_factors.append(replace(factor, levels=levels))
        columns.append(index)
    return tuple(placed_factors), tuple(zip(*columns, strict=True))


#: of designs over ranges
AT_EVERY_SETTING = (
    "every setting of a range stands in one cell: no table of levels, but a surface over the "
    "ranges tells the factors apart; study run fits it"
)


def _sampled(request: Request, kind: str, shares: Array, summary: str, note: str) -> Made:
    """Design of runs that are shares of each range, no two of which may be one cell."""
    factors, rows = placed(request.factors, shares)
    if len(set(rows)) < len(rows):
        request.fault("runs", "two runs are the same cell", "use another seed or fewer")
    return factors, Scheme(kind, rows, summary, (note,))


# Two-level designs with fewer cells than combinations.

#: factors of a two-level design: every product of its columns is formed
MAX_FRACTION = 12
MAX_SCREENED = 15
#: generated factor -> sign and factors of the product that it equals
Words = Mapping[str, tuple[int, Sequence[str]]]


@section
class Fractional:
    """Fraction of the two-level factorial."""

    kind: Literal["fractional"] = "fractional"
    #: List of ``"C = A:B"`` or ``"C = -A:B"``; or
    generators: AsWritten = None
    #: The smallest fraction that has it is made.
    resolution: Annotated[int | None, Reads(integer(3, 12))] = None

    def make(self, request: Request) -> Made:
        """Make the fraction, and verify its resolution."""
        labels = [factor.name for factor in request.factors]
        given = None
        if self.generators is not None:
            read = partial(_words, labels)
            given = noted(read, self.generators, "design.generators", request.faults)
        if (self.generators is None) == (self.resolution is None):
            mend = 'for example generators = ["C = A:B"], or resolution = 4'
            request.fault("generators", "or a resolution must be given, and not both", mend)
            return request.nothing
        if not _two_levels(request, 3, MAX_FRACTION):
            return request.nothing
        if given is not None:
            return _verified(request, generators.fractional(labels, given), self.resolution)
        if self.resolution is None:
            return request.nothing
        try:
            runs = generators.by_resolution(len(labels), self.resolution)
        except ValueError:
            rule = f"{len(labels)} factors have no fraction of resolution {self.resolution}"
            request.fault("resolution", rule, 'lower it, or use kind = "full"')
            return request.nothing
        return _verified(request, runs, self.resolution)


def _verified(request: Request, runs: Array, least: int | None) -> Made:
    """Scheme of a fraction whose resolution was found by brute force, not believed."""
    factors, labels = request.factors, [factor.name for factor in request.factors]
    verified = generators.resolution(runs)
    if verified is not None and verified < (least or 3):
        rule = f"give resolution {verified}: {generators.defining_relation(runs, labels)}"
        mend = "main effects would be one another; generate with more factors"
        request.fault("generators", rule, mend)
    count = 2 ** len(factors)
    word = "full" if verified is None else generators.ROMAN[verified]
    summary = (
        f"two-level fractional factorial: {len(runs)} of {count} cells, resolution {word}, "
        f"verified over all {count - 1} products of columns"
    )
    scheme = Scheme(
        "fractional", _rows(runs), summary, tuple(generators.sentences(runs, labels)), verified,
        generators.defining_relation(runs, labels),
    )  # fmt: skip
    return factors, scheme


def _words(labels: Sequence[str], value: object) -> Words:
    """Read ``"C = A:B"`` or ``"C = -A:B"``, each structured and never run as code."""
    if not isinstance(value, list) or not value:
        raise Bad(f"must be a list, got {shown(value)}", 'for example ["C = A:B"]')
    words: dict[str, tuple[int, list[str]]] = {}
    for item in value:
        name, sign, parts = _word(item)
        for part in (name, *parts):
            if part not in labels:
                raise Bad(f"no factor {shown(part)}", nearest(part[:80], labels))
        if name in words:
            raise Bad(f"{name!r} is generated twice", "leave one out")
        if len(set(parts)) < max(2, len(parts)):
            raise Bad(f"{shown(item)} needs two or more different factors on the right")
        words[name] = (sign, parts)
    if len({frozenset(parts) for _, parts in words.values()}) < len(words):
        raise Bad("two factors have the same generator", "they would be one another")
    for part in (part for _, parts in words.values() for part in parts if part in words):
        raise Bad(f"{part!r} is generated itself", "generate from the other factors")
    return words


def _word(item: object) -> tuple[str, int, list[str]]:
    """Split a word into the generated factor, the sign, and the factors of the product."""
    left, equals, right = str(item).partition("=")
    if not isinstance(item, str) or not equals:
        raise Bad(f"must be NAME = A:B, got {shown(item)}", 'for example "C = A:B"')
    right = right.strip()
    parts = [part.strip() for part in right.removeprefix("-").split(":")]
    return left.strip(), -1 if right.startswith("-") else 1, parts


@section
class PlackettBurman:
    """Screening design for main effects alone."""

    kind: Literal["plackett-burman"] = "plackett-burman"

    def make(self, request: Request) -> Made:
        """Make the design, and verify that no main effects are aliased."""
        if not _two_levels(request, 2, MAX_SCREENED):
            return request.nothing
        labels = [factor.name for factor in request.factors]
        runs = generators.plackett_burman(len(labels))
        verified = generators.resolution(runs)
        if verified is not None and verified < 3:
            request.fault("kind", f"the design of {len(labels)} factors has aliased effects")
        summary = (
            f"Plackett-Burman: {len(runs)} of {2 ** len(labels)} cells; main effects are free of "
            "one another (verified), and each is mixed with interactions"
        )
        aliased = tuple(generators.sentences(runs, labels))
        return request.factors, Scheme(self.kind, _rows(runs), summary, aliased, verified)


def _suited(request: Request, least: int, most: int, faults: Mapping[str, tuple[str, str]]) -> bool:
    """Whether a design can be made of the factors: enough of them, and none with a fault."""
    for factor, (rule, mend) in faults.items():
        request.faults.add(f"factors.{factor}", rule, mend)
    count = len(request.factors)
    if not least <= count <= most:
        request.fault("kind", f"takes {least} to {most} factors, got {count}")
    return least <= count <= most and not faults


def _two_levels(request: Request, least: int, most: int) -> bool:
    """Whether a two-level design can be made of the factors; faults say why not."""
    rule, mend = "has {} levels, a two-level design needs 2", "list two, or write a range"
    counts = {factor.name: len(factor.levels) for factor in request.factors}
    wrong = {name: (rule.format(n), mend) for name, n in counts.items() if n != 2}
    return _suited(request, least, most, wrong)


def _rows(runs: Array) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(int(x > 0) for x in run) for run in runs)


# Response-surface designs: points for a quadratic model, inside the ranges of the factors.

MAX_FACTORS = 10


@section
class CentralComposite:
    """Corners, stars and the center."""

    kind: Literal["central-composite"] = "central-composite"
    #: Whether the stars alone, or the corners too, lie at the ends of the ranges.
    star: Annotated[str, Reads(choice("inscribed", "faced"))] = "inscribed"

    def make(self, request: Request) -> Made:
        """Rotatable design, or the face-centered one."""
        if not _spans(request, 2):
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


def _spans(request: Request, least: int, most: int = MAX_FACTORS) -> bool:
    """Whether every factor is a range; faults say which is not."""
    fault = "must be a range for this design", 'write { low = "28 mm", high = "32 mm" }'
    wrong = {factor.name: fault for factor in request.factors if factor.span is None}
    return _suited(request, least, most, wrong)


def _surface(request: Request, kind: str, runs: Array, what: str) -> Made:
    """Levels of each factor are the coded values that it takes."""
    note = (
        "made for a quadratic model of the values, from the table of cases; "
        "the analysis of levels has main effects only"
    )
    words = f"{what}: {len(runs)} cells, the center once"
    return _sampled(request, kind, (runs + 1) / 2, words, note)


# Space-filling designs: samples of the ranges of the factors.

_Seed = Annotated[int | None, Reads(integer(0, 2**32 - 1))]


@section
class LatinHypercube:
    """Every range in as many slices as runs, each with one run."""

    runs: CellCount
    kind: Literal["latin-hypercube"] = "latin-hypercube"
    #: Of the draw; that of ``[study]`` by default.
    seed: _Seed = None

    def make(self, request: Request) -> Made:
        """Sample the ranges."""
        return _filled(request, self.kind, self.runs, self.seed, generators.latin_hypercube)


@section
class Sobol:
    """Scrambled Sobol sequence."""

    #: Number of cells, a power of two.
    runs: CellCount
    kind: Literal["sobol"] = "sobol"
    #: Of the scrambling; that of ``[study]`` by default.
    seed: _Seed = None

    def make(self, request: Request) -> Made:
        """Sample the ranges."""
        if self.runs & (self.runs - 1):
            near = 2 ** round(math.log2(self.runs))
            rule = f"must be a power of two, got {self.runs}"
            request.fault("runs", rule, f"for example {near}")
            return request.nothing
        return _filled(request, self.kind, self.runs, self.seed, generators.sobol)


@section
class Morris:
    """Trajectories through a grid, each of which moves every factor once (Morris 1991)."""

    trajectories: CellCount
    kind: Literal["morris"] = "morris"
    #: Settings of each range, an even number; a factor moves by half of them.
    levels: Annotated[int, Reads(integer(2, 64))] = 4
    #: Of the draw; that of ``[study]`` by default.
    seed: _Seed = None

    def make(self, request: Request) -> Made:
        """Draw the trajectories."""
        if not _spans(request, 2, MAX_RUNS):
            return request.nothing
        if self.levels % 2:
            request.fault("levels", f"must be even, got {self.levels}", "for example 4")
            return request.nothing
        count, seed = len(request.factors), request.seed if self.seed is None else self.seed
        shares = generators.trajectories(count, self.trajectories, self.levels, seed)
        if (trajectory_count := len(shares) // (count + 1)) < self.trajectories:
            rule = f"{trajectory_count} trajectories without a common run fit {self.levels} levels"
            request.fault("trajectories", rule, "ask for fewer, or for more levels")
        summary = f"Morris: {trajectory_count} trajectories of {count + 1} cells, seed {seed}"
        note = "elementary effects rank the factors: they screen, and give no verdict"
        return _sampled(request, self.kind, shares, summary, note)


def _filled(
    request: Request, kind: str, runs: int, seed: int | None, draw: Callable[[int, int, int], Array]
) -> Made:
    if all(factor.span is None for factor in request.factors):
        mend = 'write one as { low = "28 mm", high = "32 mm" }'
        request.fault("kind", "no factor is a range to be filled", mend)
    drawn_seed = request.seed if seed is None else seed
    words = f"{kind.replace('-', ' ')}: {runs} cells, seed {drawn_seed}".capitalize()
    shares = draw(len(request.factors), runs, drawn_seed)
    return _sampled(request, kind, shares, words, AT_EVERY_SETTING)
