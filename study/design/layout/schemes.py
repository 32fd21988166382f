"""Table ``[design]``: which combinations of the levels are run.

::

    [design]
    kind = "fractional"        # full | fractional | plackett-burman | central-composite
                               # | box-behnken | latin-hypercube | sobol | listed
    generators = ["model.element_order = material:plates"]     # fractional; or
    resolution = 4                                             # the smallest fraction that has it
    star = "inscribed"         # central-composite: or "faced"
    runs = 32                  # latin-hypercube, sobol (a power of two)
    seed = 7                   # of these two; that of [study] by default
    treatments = [{ material = "yeoh", plates = "bonded" }]    # listed: exactly these cells
    zip = [["specimen.height", "test.displacement"]]           # full: levels change together
    [[design.nested]]          # full: levels that exist only within a level of another factor
    factor = "model.mesh_size"
    within = "model.space"
    levels = { axisymmetric = ["1 mm", "2 mm"], 3d = ["3 mm", "4 mm"] }
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from study.arrays import Array
from study.design import overview
from study.design.diagnostics import Faults
from study.design.factors import levels_at
from study.design.layout import generators
from study.design.reader import Section
from study.design.spec import Factor, Scheme
from study.design.study_file import Analysis
from study.errors import nearest
from study.setup.quantity import integer, shown
from study.setup.section import Bad
from study.setup.text import choice

Made = tuple[tuple[Factor, ...], Scheme]

#: factors of a two-level design: every product of its columns is formed
MAX_FRACTION = 12
MAX_SCREENED = 15
MAX_RUNS = 1024


@dataclass(frozen=True)
class Request:
    """What a maker of a design is given."""

    section: Section
    factors: tuple[Factor, ...]
    seed: int


def read_scheme(
    table: Any, factors: tuple[Factor, ...], seed: int, excluding: bool, faults: Faults
) -> Made:
    """Read ``[design]`` and give every factor the levels that it needs.

    Parameters
    ----------
    factors : tuple of Factor
        As listed; a range has its two ends as levels.
    seed : int
        Of the study, for designs that draw.
    excluding : bool
        Whether the file excludes cells.
    """
    section = Section({} if table is None else table, "design", faults)
    kind = section.take("kind", choice(*MAKERS), "full")
    before = len(faults)
    if kind is None or not factors:
        return _small(factors), Scheme()
    if excluding and kind not in ("full", "listed"):
        faults.add("exclude", f"a {kind} design cannot lose runs", 'use kind = "full", or none')
    made = MAKERS[kind](Request(section, factors, seed))
    section.finish()
    return (_small(factors), Scheme()) if len(faults) > before else made


def _small(factors: tuple[Factor, ...]) -> tuple[Factor, ...]:
    """Factors of a faulty table, for checks of their cells; none where these are too many."""
    return factors if math.prod(len(f.levels) for f in factors) <= generators.MAX_CELLS else ()


def default_model(scheme: Scheme, factors: Sequence[Factor], spec: Analysis) -> Analysis:
    """Terms that a design can tell, where the file does not ask for others."""
    if scheme.kind == "full":
        terms = generators.model_terms(scheme, factors)
        return spec if terms is None else replace(spec, model=terms)
    if scheme.kind == "fractional":
        order = overview.clear_order(scheme.resolution)
        return spec if order is None else replace(spec, model=min(order, len(factors)))
    return replace(spec, model=1)


def _full(request: Request) -> Made:
    return generators.full(request.section, request.factors)


def _listed(request: Request) -> Made:
    return generators.listed(request.section, request.factors)


def _two_levels(request: Request, least: int, most: int) -> bool:
    """Whether a two-level design can be made of the factors; faults say why not."""
    wrong = [f for f in request.factors if len(f.levels) != 2]
    for factor in wrong:
        rule = f"has {len(factor.levels)} levels, a two-level design needs 2"
        request.section.faults.add(f"factors.{factor.name}", rule, "list two, or write a range")
    count = len(request.factors)
    if not least <= count <= most:
        rule = f"takes {least} to {most} factors, got {count}"
        request.section.fault("kind", rule)
        return False
    return not wrong


def _fractional(request: Request) -> Made:
    section, factors = request.section, request.factors
    labels = [factor.name for factor in factors]
    given = section.take("generators", lambda raw: _generators(raw, labels), None)
    wanted = section.take("resolution", integer(3, 12), None)
    if ("generators" in section) == ("resolution" in section):
        section.fault("generators", "or a resolution must be given, and not both",
                      'for example generators = ["C = A:B"], or resolution = 4')  # fmt: skip
        return factors, Scheme()
    if not _two_levels(request, 3, MAX_FRACTION) or (given is None and wanted is None):
        return factors, Scheme()
    if given is not None:
        runs = generators.fractional(labels, given)
    else:
        try:
            runs = generators.by_resolution(len(factors), int(wanted))
        except ValueError:
            rule = f"{len(factors)} factors have no fraction of resolution {wanted}"
            section.fault("resolution", rule, 'lower it, or use kind = "full"')
            return factors, Scheme()
    return _verified(request, runs, wanted)


def _verified(request: Request, runs: Array, wanted: int | None) -> Made:
    """Scheme of a fraction whose resolution was found by brute force, not believed."""
    factors, labels = request.factors, [factor.name for factor in request.factors]
    found = overview.resolution(runs)
    if found is not None and found < (wanted or 3):
        rule = f"give resolution {found}: {overview.defining_relation(runs, labels)}"
        mend = "main effects would be one another; generate with more factors"
        request.section.fault("generators", rule, mend)
    count = 2 ** len(factors)
    word = "full" if found is None else overview.ROMAN[found]
    summary = (
        f"two-level fractional factorial: {len(runs)} of {count} cells, resolution {word}, "
        f"verified over all {count - 1} products of columns"
    )
    scheme = Scheme(
        "fractional", _rows(runs), summary, tuple(overview.sentences(runs, labels)), found,
        overview.defining_relation(runs, labels),
    )  # fmt: skip
    return factors, scheme


def _rows(runs: Array) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(int(x > 0) for x in run) for run in runs)


def _generators(raw: Any, labels: Sequence[str]) -> dict[str, tuple[int, list[str]]]:
    """Read ``"C = A:B"`` or ``"C = -A:B"``, each structured and never run as code."""
    if not isinstance(raw, list) or not raw:
        raise Bad(f"must be a list, got {shown(raw)}", 'for example ["C = A:B"]')
    found: dict[str, tuple[int, list[str]]] = {}
    for item in raw:
        left, equals, right = str(item).partition("=")
        if not isinstance(item, str) or not equals:
            raise Bad(f"must be NAME = A:B, got {shown(item)}", 'for example "C = A:B"')
        right = right.strip()
        sign = -1 if right.startswith("-") else 1
        parts = [part.strip() for part in right.removeprefix("-").split(":")]
        for part in (left.strip(), *parts):
            if part not in labels:
                raise Bad(f"no factor {shown(part)}", nearest(part[:80], labels))
        if left.strip() in found:
            raise Bad(f"{left.strip()!r} is generated twice", "leave one out")
        if len(set(parts)) < max(2, len(parts)):
            raise Bad(f"{shown(item)} needs two or more different factors on the right")
        found[left.strip()] = (sign, parts)
    if len({frozenset(parts) for _, parts in found.values()}) < len(found):
        raise Bad("two factors have the same generator", "they would be one another")
    for _, parts in found.values():
        for part in parts:
            if part in found:
                raise Bad(f"{part!r} is generated itself", "generate from the other factors")
    return found


def _plackett_burman(request: Request) -> Made:
    if not _two_levels(request, 2, MAX_SCREENED):
        return request.factors, Scheme()
    labels = [factor.name for factor in request.factors]
    runs = generators.plackett_burman(len(labels))
    found = overview.resolution(runs)
    if found is not None and found < 3:
        request.section.fault("kind", f"the design of {len(labels)} factors has aliased effects")
    summary = (
        f"Plackett-Burman: {len(runs)} of {2 ** len(labels)} cells; main effects are free of one "
        "another (verified), and each is mixed with interactions"
    )
    told = overview.sentences(runs, labels)
    return request.factors, Scheme("plackett-burman", _rows(runs), summary, tuple(told), found)


def _spans(request: Request, least: int) -> bool:
    """Whether every factor is a range; faults say which is not."""
    faults = request.section.faults
    wrong = [factor for factor in request.factors if factor.span is None]
    for factor in wrong:
        mend = 'write { low = "28 mm", high = "32 mm" }'
        faults.add(f"factors.{factor.name}", "must be a range for this design", mend)
    if len(request.factors) < least:
        request.section.fault("kind", f"takes at least {least} factors, got {len(request.factors)}")
        return False
    if len(request.factors) > 10:
        request.section.fault("kind", f"takes at most 10 factors, got {len(request.factors)}")
        return False
    return not wrong


def _surface(request: Request, kind: str, runs: Array, what: str) -> Made:
    """Response-surface design: levels of each factor are the coded values that it takes."""
    note = (
        "made for a quadratic model of the values, from the table of cases; "
        "the analysis of levels has main effects only"
    )
    words = f"{what}: {len(runs)} cells, the center once"
    return _placed(request, kind, (runs + 1) / 2, words, note)


def _central_composite(request: Request) -> Made:
    star = request.section.take("star", choice("inscribed", "faced"), "inscribed")
    if star is None or not _spans(request, 2):
        return request.factors, Scheme()
    runs = generators.central_composite(len(request.factors), star)
    what = "rotatable" if star == "inscribed" else "face-centered"
    return _surface(request, "central-composite", runs, f"{what} central composite design")


def _box_behnken(request: Request) -> Made:
    if not _spans(request, 3):
        return request.factors, Scheme()
    runs = generators.box_behnken(len(request.factors))
    return _surface(request, "box-behnken", runs, "Box-Behnken design")


def _filling(kind: str, draw: Callable[[int, int, int], Array]) -> Callable[[Request], Made]:
    """Maker of a space-filling design; a factor with listed levels takes them in equal shares."""

    def make(request: Request) -> Made:
        section, factors = request.section, request.factors
        runs = section.take("runs", integer(2, MAX_RUNS), mend="say how many, for example 32")
        seed = section.take("seed", integer(0, 2**32 - 1), request.seed)
        if runs and kind == "sobol" and runs & (runs - 1):
            near = 2 ** round(math.log2(runs))
            section.fault("runs", f"must be a power of two, got {runs}", f"for example {near}")
            return factors, Scheme()
        if all(factor.span is None for factor in factors):
            mend = 'write one as { low = "28 mm", high = "32 mm" }'
            section.fault("kind", "no factor is a range to be filled", mend)
        if not runs or seed is None:
            return factors, Scheme()
        words = f"{kind.replace('-', ' ')}: {runs} cells, seed {seed}".capitalize()
        note = (
            "every level of a range stands in one cell: fit a model of the values to the table of "
            "cases; an analysis of levels cannot tell the factors apart"
        )
        return _placed(request, kind, draw(len(factors), runs, seed), words, note)

    return make


def _placed(request: Request, kind: str, shares: Array, summary: str, note: str) -> Made:
    """Levels and rows of a design given as shares of each range, shape (runs, factors)."""
    made, columns = [], []
    for factor, column in zip(request.factors, shares.T, strict=True):
        if factor.span is None:
            count = len(factor.levels)
            made.append(factor)
            columns.append([min(int(x * count), count - 1) for x in column])
            continue
        rounded = np.round(column, 12)
        values, index = np.unique(rounded, return_inverse=True)
        levels = levels_at(factor.name, factor.span, values.tolist())
        made.append(replace(factor, levels=levels))
        columns.append(index.tolist())
    rows = tuple(zip(*columns, strict=True))
    if len(set(rows)) < len(rows):
        request.section.fault("runs", "two runs are the same cell", "use another seed or fewer")
    return tuple(made), Scheme(kind, rows, summary, (note,))


MAKERS: dict[str, Callable[[Request], Made]] = {
    "full": _full,
    "fractional": _fractional,
    "plackett-burman": _plackett_burman,
    "central-composite": _central_composite,
    "box-behnken": _box_behnken,
    "latin-hypercube": _filling("latin-hypercube", generators.latin_hypercube),
    "sobol": _filling("sobol", generators.sobol),
    "listed": _listed,
}
