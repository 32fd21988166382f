"""Two-level designs with fewer cells than combinations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Literal

from study.arrays import Array
from study.design.diagnostics import noted
from study.design.layout import aliases, generators
from study.design.layout.request import Made, Request
from study.design.spec import Scheme
from study.errors import nearest
from study.setup.quantity import integer, shown
from study.setup.section import AsWritten, Bad, Reads, section

#: factors of a two-level design: every product of its columns is formed
MAX_FRACTION = 12
MAX_SCREENED = 15

#: generated factor -> sign and factors of the product that it equals
Words = Mapping[str, tuple[int, Sequence[str]]]


@section
class Fractional:
    """Fraction of the two-level factorial.

    Parameters
    ----------
    generators
        List of ``"C = A:B"`` or ``"C = -A:B"``; or
    resolution : int
        The smallest fraction that has it is made.
    """

    kind: Literal["fractional"] = "fractional"
    generators: AsWritten = None
    resolution: Annotated[int | None, Reads(integer(3, 12))] = None

    def make(self, request: Request) -> Made:
        """Make the fraction, and verify its resolution."""
        labels = [factor.name for factor in request.factors]
        given = None
        if self.generators is not None:
            read = partial(_words, labels)
            given = noted(read, self.generators, "design.generators", request.faults)
        one = (self.generators is None) != (self.resolution is None)
        if not one and not request.is_faulty("resolution"):
            mend = 'for example generators = ["C = A:B"], or resolution = 4'
            request.fault("generators", "or a resolution must be given, and not both", mend)
            return request.nothing
        if not _two_levels(request, 3, MAX_FRACTION):
            return request.nothing
        if given is not None:
            return _verified(request, generators.fractional(labels, given), self.resolution)
        if self.resolution is not None:
            return _smallest(request, self.resolution)
        return request.nothing


def _smallest(request: Request, resolution: int) -> Made:
    """Smallest fraction of a resolution."""
    count = len(request.factors)
    try:
        runs = generators.by_resolution(count, resolution)
    except ValueError:
        rule = f"{count} factors have no fraction of resolution {resolution}"
        request.fault("resolution", rule, 'lower it, or use kind = "full"')
        return request.nothing
    return _verified(request, runs, resolution)


def _verified(request: Request, runs: Array, wanted: int | None) -> Made:
    """Scheme of a fraction whose resolution was found by brute force, not believed."""
    factors, labels = request.factors, [factor.name for factor in request.factors]
    found = aliases.resolution(runs)
    if found is not None and found < (wanted or 3):
        rule = f"give resolution {found}: {aliases.defining_relation(runs, labels)}"
        mend = "main effects would be one another; generate with more factors"
        request.fault("generators", rule, mend)
    count = 2 ** len(factors)
    word = "full" if found is None else aliases.ROMAN[found]
    summary = (
        f"two-level fractional factorial: {len(runs)} of {count} cells, resolution {word}, "
        f"verified over all {count - 1} products of columns"
    )
    scheme = Scheme(
        "fractional", _rows(runs), summary, tuple(aliases.sentences(runs, labels)), found,
        aliases.defining_relation(runs, labels),
    )  # fmt: skip
    return factors, scheme


def _words(labels: Sequence[str], value: object) -> Words:
    """Read ``"C = A:B"`` or ``"C = -A:B"``, each structured and never run as code."""
    if not isinstance(value, list) or not value:
        raise Bad(f"must be a list, got {shown(value)}", 'for example ["C = A:B"]')
    found: dict[str, tuple[int, list[str]]] = {}
    for item in value:
        name, sign, parts = _word(item)
        for part in (name, *parts):
            if part not in labels:
                raise Bad(f"no factor {shown(part)}", nearest(part[:80], labels))
        if name in found:
            raise Bad(f"{name!r} is generated twice", "leave one out")
        if len(set(parts)) < max(2, len(parts)):
            raise Bad(f"{shown(item)} needs two or more different factors on the right")
        found[name] = (sign, parts)
    if len({frozenset(parts) for _, parts in found.values()}) < len(found):
        raise Bad("two factors have the same generator", "they would be one another")
    for _, parts in found.values():
        for part in parts:
            if part in found:
                raise Bad(f"{part!r} is generated itself", "generate from the other factors")
    return found


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
        found = aliases.resolution(runs)
        if found is not None and found < 3:
            request.fault("kind", f"the design of {len(labels)} factors has aliased effects")
        summary = (
            f"Plackett-Burman: {len(runs)} of {2 ** len(labels)} cells; main effects are free of "
            "one another (verified), and each is mixed with interactions"
        )
        told = tuple(aliases.sentences(runs, labels))
        return request.factors, Scheme(self.kind, _rows(runs), summary, told, found)


def _two_levels(request: Request, least: int, most: int) -> bool:
    """Whether a two-level design can be made of the factors; faults say why not."""
    wrong = [f for f in request.factors if len(f.levels) != 2]
    for factor in wrong:
        rule = f"has {len(factor.levels)} levels, a two-level design needs 2"
        request.faults.add(f"factors.{factor.name}", rule, "list two, or write a range")
    count = len(request.factors)
    if not least <= count <= most:
        request.fault("kind", f"takes {least} to {most} factors, got {count}")
        return False
    return not wrong


def _rows(runs: Array) -> tuple[tuple[int, ...], ...]:
    return tuple(tuple(int(x > 0) for x in run) for run in runs)
