"""Table ``[design]``: its kinds, which sample, list, choose or add cells."""

from __future__ import annotations

import itertools
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
    Faults,
    Reads,
    Rows,
    as_written,
    choice,
    flatten,
    integer,
    name,
    noted,
    read_table,
    section,
    shown,
)
from study.ground.errors import nearest
from study.harness.design import generators
from study.harness.design.generators import Word, d_optimal, efficiency
from study.harness.design.spec import (
    MAX_RUNS,
    CellCount,
    Factor,
    Scheme,
    Sequential,
    known_level,
    levels_at,
    setting_in,
    words_of,
)

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


# Full factorials, also with factors that change together or are nested; and listed cells.

#: parent of a nested factor, and the labels that exist within each of its levels
Nests = Mapping[str, tuple[str, Mapping[str, tuple[str, ...]]]]

_Name = Annotated[object, as_written("name a factor")]
_Within = Annotated[object, as_written("{ LEVEL = [..], LEVEL = [..] }")]
_Cells = Annotated[object, as_written("list the cells: treatments = [{ A = .., B = .. }]")]


@section
class Nested:
    """One ``[[design.nested]]``: levels that exist only within a level of another factor."""

    factor: _Name
    within: _Name
    levels: _Within


@section
class Full:
    """Every combination of the levels that the factors have."""

    kind: Literal["full"] = "full"
    #: List of lists of factors whose levels change together.
    zip: AsWritten = None
    #: Factors whose levels exist only within a level of another one.
    nested: Annotated[tuple[Nested, ...], Rows()] = ()

    def make(self, request: Request) -> Made:
        """Leave out the combinations that zipped or nested factors do not have."""
        factors = request.factors
        zipped: tuple[tuple[str, ...], ...] | None = ()
        if self.zip is not None:
            zipped = noted(partial(_zipped, factors), self.zip, "design.zip", request.faults)
        nests = _nests(self.nested, request)
        if zipped is None or nests is None:
            return request.nothing
        followers = {n for group in zipped for n in group[1:]}
        count = math.prod(len(f.levels) for f in factors if f.name not in followers)
        if count > MAX_CELLS:
            rule = f"give {count} cells, the limit is {MAX_CELLS}"
            request.faults.add("factors", rule, "use fewer levels, or several studies")
            return (), Scheme()
        if not zipped and not nests:
            return factors, Scheme()
        rows = []
        for row in _product(factors, zipped):
            labels = {f.name: f.labels[i] for f, i in zip(factors, row, strict=True)}
            if all(labels[child] in within[labels[of]] for child, (of, within) in nests.items()):
                rows.append(row)
        summary = f"{len(rows)} of {math.prod(len(f.levels) for f in factors)} combinations"
        return factors, Scheme("full", tuple(rows), summary, _told(zipped, nests))


def _told(zipped: Sequence[tuple[str, ...]], nests: Nests) -> tuple[str, ...]:
    """Say what zipped and nested factors cannot tell."""
    apart = "change together: nothing tells their effects apart"
    return (
        *(f"{' and '.join(group)} {apart}" for group in zipped),
        *(
            f"{child} is nested in {parent}: its levels are compared within one level of {parent}"
            for child, (parent, _) in nests.items()
        ),
    )


def _product(factors: Sequence[Factor], zipped: Sequence[tuple[str, ...]]) -> list[tuple[int, ...]]:
    leader = {f.name: f.name for f in factors} | {n: group[0] for group in zipped for n in group}
    free = {f.name: range(len(f.levels)) for f in factors if leader[f.name] == f.name}
    every = (dict(zip(free, index, strict=True)) for index in itertools.product(*free.values()))
    return [tuple(index[leader[f.name]] for f in factors) for index in every]


def _zipped(factors: Sequence[Factor], value: object) -> tuple[tuple[str, ...], ...]:
    lists = isinstance(value, list) and bool(value) and isinstance(value[0], list)
    groups: list[tuple[str, ...]] = []
    by_name = {factor.name: factor for factor in factors}
    seen: set[str] = set()
    for group in value if isinstance(value, list) and lists else [value]:
        if not isinstance(group, list) or len(group) < 2:
            raise Bad(f"must list two or more factors, got {shown(group)}", 'zip = [["A", "B"]]')
        for key in group:
            if not isinstance(key, str) or key not in by_name:
                raise Bad(f"no factor {shown(key)}", nearest(str(key)[:80], by_name))
            if key in seen:
                raise Bad(f"{key!r} stands twice", "a factor is zipped once")
            seen.add(key)
        counts = {key: len(by_name[key].levels) for key in group}
        if len(set(counts.values())) > 1:
            words = ", ".join(f"{key} has {count}" for key, count in counts.items())
            raise Bad(f"needs equal numbers of levels: {words}", "level k goes with level k")
        groups.append(tuple(group))
    return tuple(groups)


def _nests(tables: Sequence[Nested], request: Request) -> Nests | None:
    """Nested factors; None where one is faulty."""
    faults, before = request.faults, request.faults.mentions
    nests: dict[str, tuple[str, Mapping[str, tuple[str, ...]]]] = {}
    by_name = {factor.name: factor for factor in request.factors}
    for i, table in enumerate(tables):
        where = f"design.nested[{i}]"
        child, parent = (
            noted(partial(_known, by_name), value, f"{where}.{key}", faults)
            for key, value in (("factor", table.factor), ("within", table.within))
        )
        if child is None or parent is None:
            continue
        if child == parent or child in nests or parent in nests:
            faults.add(f"{where}.within", f"{child!r} in {parent!r} is no single nesting")
        else:
            read = partial(_levels_within, by_name[child], by_name[parent])
            nests[child] = (parent, noted(read, table.levels, f"{where}.levels", faults) or {})
    return nests if faults.mentions == before else None


def _known(by_name: Mapping[str, Factor], value: object) -> str:
    label = name(value)
    if label not in by_name:
        raise Bad(f"no factor {shown(value)}", nearest(label, by_name))
    return label


def _levels_within(child: Factor, parent: Factor, value: object) -> Mapping[str, tuple[str, ...]]:
    """Labels of the child within each level of the parent: every one in exactly one."""
    if not isinstance(value, Mapping):
        raise Bad(f"must be a table, got {shown(value)}", "{ LEVEL = [..], LEVEL = [..] }")
    labels_within: dict[str, tuple[str, ...]] = {}
    for label, items in value.items():
        if label not in parent.labels:
            raise Bad(f"no level {label!r} of {parent.name!r}", nearest(label, parent.labels))
        listed = items if isinstance(items, list) else [items]
        labels_within[label] = tuple(known_level(item, child) for item in listed)
    flat = [label for labels in labels_within.values() for label in labels]
    if sorted(flat) != sorted(child.labels) or set(labels_within) != set(parent.labels):
        rule = f"each level of {child.name!r} must stand in one level of {parent.name!r}"
        raise Bad(rule, f"levels: {', '.join(child.labels)}")
    return labels_within


@section
class Listed:
    """Exactly the treatments of a list, in its order."""

    #: List of tables, each with one level of every factor; of a range, a setting within it.
    treatments: _Cells
    kind: Literal["listed"] = "listed"

    def make(self, request: Request) -> Made:
        """Look up the levels of every treatment."""
        read = partial(_treatments, request.factors)
        factors_and_rows = noted(read, self.treatments, "design.treatments", request.faults)
        if factors_and_rows is None:
            return request.nothing
        factors, rows = factors_and_rows
        if any(factor.span for factor in factors):
            return factors, Scheme(self.kind, rows, f"{len(rows)} listed", (AT_EVERY_SETTING,))
        count = math.prod(len(factor.levels) for factor in factors)
        note = (
            "only the listed cells are run: terms that they do not separate are named by the "
            "analysis"
        )
        summary = f"{len(rows)} listed of {count} combinations"
        return factors, Scheme(self.kind, rows, summary, (note,))


def _treatments(
    factors: Sequence[Factor], value: object
) -> tuple[tuple[Factor, ...], tuple[tuple[int, ...], ...]]:
    """Factors with the listed settings of their ranges as levels, and the cells."""
    if not isinstance(value, list) or not 2 <= len(value) <= MAX_CELLS:
        raise Bad(f"must list 2 to {MAX_CELLS} treatments, got {shown(value)}")
    cells = [_cell(factors, item, i) for i, item in enumerate(value)]
    columns = [_levels_listed(factor, [cell[factor.name] for cell in cells]) for factor in factors]
    factors, rows = tuple(f for f, _ in columns), list(zip(*(at for _, at in columns), strict=True))
    first: dict[tuple[int, ...], int] = {}
    for index, row in enumerate(rows):
        first.setdefault(row, index)
    if len(first) < len(rows):
        again = next(first[row] for index, row in enumerate(rows) if first[row] < index) + 1
        raise Bad(f"treatment {again} stands twice", "the same simulation is no replicate")
    for f, column in zip(factors, zip(*rows, strict=True), strict=True):
        if len(set(column)) < len(f.levels):
            unused = next(lv for i, lv in enumerate(f.labels) if i not in column)
            raise Bad(f"no treatment has {f.name} = {unused!r}", "leave the level out")
    return factors, tuple(rows)


def _levels_listed(factor: Factor, given: Sequence[object]) -> tuple[Factor, list[int]]:
    """Factor and the level of every treatment; those of a range are the settings given."""
    if factor.span is None:
        labels = [known_level(raw, factor) for raw in given]
    else:
        levels = [setting_in(factor, raw) for raw in given]
        labels = [level.label for level in levels]
        unsorted = replace(factor, levels=tuple(dict(zip(labels, levels, strict=True)).values()))
        setting = unsorted.settings
        factor = replace(
            factor, levels=tuple(sorted(unsorted.levels, key=lambda level: setting[level.label]))
        )
    places = {label: index for index, label in enumerate(factor.labels)}
    return factor, [places[label] for label in labels]


def _cell(factors: Sequence[Factor], item: object, index: int) -> Mapping[str, object]:
    """One treatment: a value of every factor."""
    given = flatten(item) if isinstance(item, Mapping) else {}
    names = [factor.name for factor in factors]
    missing = [f"has no {name!r}" for name in names if name not in given]
    extra = [f"names no factor with {key!r}" for key in given if key not in names]
    for what in (*missing, *extra):
        rule = f"treatment {index + 1} {what}"
        raise Bad(rule, "each treatment gives one level of every factor")
    return given


# Kind ``d-optimal``: fewer cells than combinations, of factors with any levels.


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
