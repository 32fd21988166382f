"""How often a claim is false where the gate has to withdraw it, and how often a right one stands.

``python -m validation.claims [SETS] [WORDS]`` simulates every table SETS times (1,000 by default),
those whose name holds one of WORDS, and prints for each the share of claims that the printed
analysis would make alone, and that of claims that pass the gate. A claim at a true difference of
exactly the practical one is false, whichever it is. Exit 1 where more than 5 % + 2 standard errors
of the claims are false.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np
import pandas as pd

from study.ground.arrays import Array
from study.ground.errors import RefusedError
from study.statistics.analysis import effects as judged_effects
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    ResponseScale,
    threshold,
)
from study.statistics.analysis.anova import effects
from study.statistics.analysis.simple_effects import CLAIMS

Draw = Callable[[np.random.Generator], pd.DataFrame]


@dataclass(frozen=True)
class Table:
    """One kind of table: how it is drawn, what is asked, and which claims of a factor are false."""

    name: str
    draw: Draw
    factors: tuple[str, ...]
    practical: float | str
    false: tuple[str, ...] = CLAIMS
    block: tuple[str, ...] = ()
    model: str | int | tuple[str, ...] = "full"
    judged: tuple[str, ...] = field(default=("a",))
    power: bool = False


def crossed(levels: Mapping[str, int]) -> pd.DataFrame:
    """Every combination of numbered levels once."""
    rows = itertools.product(*(range(k) for k in levels.values()))
    return pd.DataFrame(list(rows), columns=list(levels))


def one_way(counts: tuple[int, ...], sds: tuple[float, ...], shift: float) -> Draw:
    """Rows of some groups; the last one is shifted."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        code = np.repeat(np.arange(len(counts)), counts)
        y = random.normal(size=code.size) * np.array(sds)[code]
        return pd.DataFrame({"a": code, "y": 10 + y + shift * (code == len(counts) - 1)})

    return draw


def many(b: int, k: int) -> Draw:
    """Levels in b blocks, the first of which is larger by skewed differences."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": b, "a": k})
        size = np.repeat(skewed(random, b), k) * (table["a"] == 0)
        return table.assign(y=table["s"] + size + random.normal(0, 0.05, b * k))

    return draw


def blocks(b: int, noise: Callable[[np.random.Generator, int], Array], step: float = 0.0) -> Draw:
    """Two levels in b blocks; ``noise`` draws their differences or, with a step, readings."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": b, "a": 2})
        base = np.repeat(random.uniform(0, 10, b), 2)
        if step:
            y = base + noise(random, 2 * b) + 0.95 * table["a"]
            return table.assign(y=step * np.round(y / step))
        return table.assign(y=base + np.repeat(noise(random, b), 2) * table["a"])

    return draw


def skewed(random: np.random.Generator, n: int) -> Array:
    """Differences that are lognormal, with the mean one."""
    return np.asarray(random.lognormal(-0.72, 1.2, n))


def rough(random: np.random.Generator, n: int) -> Array:
    """Scatter of readings."""
    return np.asarray(random.normal(0, 0.42, n))


def unreplicated(interaction: float) -> Draw:
    """Two levels of four factors, once; A and B act through their interaction alone."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"a": 2, "b": 2, "c": 2, "d": 2})
        sign = (2 * table["a"] - 1) * (2 * table["b"] - 1)
        return table.assign(y=10 + interaction * sign + random.normal(0, 0.2, 16))

    return draw


def lost_runs(interaction: float, lost: int) -> Draw:
    """Two levels of four factors as :func:`unreplicated`, without some runs."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = unreplicated(interaction)(random)
        return table.loc[np.sort(random.permutation(16)[lost:])]

    return draw


def whole_units(difference: float, sd: float) -> Draw:
    """Two levels of four factors, once, of which one acts; read in whole units."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"a": 2, "b": 2, "c": 2, "d": 2})
        y = random.uniform(10, 11) + difference * table["a"] + random.normal(0, sd, 16)
        return table.assign(y=np.round(y))

    return draw


def fraction(interaction: float, lost: int) -> Draw:
    """Half of two levels of five factors, once, less some runs; A and B act together alone."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"a": 2, "b": 2, "c": 2, "d": 2})
        table["e"] = table.sum(axis=1) % 2
        sign = (2 * table["a"] - 1) * (2 * table["b"] - 1)
        table["y"] = 10 + interaction * sign + random.normal(0, 0.1, 16)
        return table.loc[np.sort(random.permutation(16)[lost:])]

    return draw


def interacting(b: int, size: float, noise: float) -> Draw:
    """Two by two in blocks, with an interaction that the declared model leaves out."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": b, "a": 2, "b": 2})
        sign = (2 * table["a"] - 1) * (2 * table["b"] - 1)
        base = np.repeat(random.normal(0, 3, b), 4)
        return table.assign(y=base + size / 2 * sign + random.normal(0, noise, 4 * b))

    return draw


def lacking(b: int, k: int) -> Draw:
    """Materials in blocks, one of which scatters; every block lacks one of the materials."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": b, "a": k})
        sd = np.where(table["a"] == 0, 1.5, 0.2)
        table["y"] = table["s"] + sd * random.normal(size=b * k) + (table["a"] == 0)
        gone = [s * k + 1 + (s % (k - 1)) for s in range(b)]
        return table.drop(index=gone)

    return draw


def gaps(b: int, noise: Callable[[np.random.Generator, int], Array], step: float = 0.0) -> Draw:
    """Four levels in b blocks, each of which lacks one; the first level differs from the rest.

    ``noise`` draws the difference of each block or, with a step, the scatter of readings.
    """

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": b, "a": 4})
        first = table["a"] == 0
        y = np.repeat(random.uniform(0, 10, b), 4)
        if step:
            y = step * np.round((y + noise(random, 4 * b) + 0.95 * first) / step)
        else:
            y = y + np.repeat(noise(random, b), 4) * first + random.normal(0, 0.05, 4 * b)
        return table.assign(y=y).drop(index=[s * 4 + 1 + s % 3 for s in range(b)])

    return draw


def latin(k: int, sds: tuple[float, float], shift: float) -> Draw:
    """Treatments in rows and columns; the last one is shifted and scatters by the second sd."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"r": k, "c": k})
        table["a"] = random.permutation(k)[(table["r"] + table["c"]) % k]
        last = table["a"] == k - 1
        base = random.normal(0, 1, k)[table["r"]] + random.normal(0, 1, k)[table["c"]]
        sd = np.where(last, sds[1], sds[0])
        return table.assign(y=base + sd * random.normal(size=k * k) + shift * last)

    return draw


def crossover(n: int, difference: float, carried: float) -> Draw:
    """Two treatments in two periods; the second one, given first, acts on in the second period."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": n, "p": 2})
        table["a"] = (table["s"] + table["p"]) % 2
        acts_on = carried * ((table["p"] == 1) & (table["a"] == 0))
        y = random.normal(0, 2, n)[table["s"]] + 0.5 * table["p"] + acts_on
        return table.assign(y=y + difference * table["a"] + random.normal(0, 0.6, 2 * n))

    return draw


def share(b: int) -> Draw:
    """Two levels that differ by 5 % of a mean that the blocks leave unsure."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed({"s": b, "a": 2})
        base = np.repeat(20 + 3 * random.normal(size=b), 2)
        return table.assign(y=base + (table["a"] - 0.5) + random.normal(0, 0.02, 2 * b))

    return draw


def repeated(random: np.random.Generator) -> pd.DataFrame:
    """Five rows of two groups, each three times."""
    table = pd.DataFrame({"a": np.repeat([0, 1], 5)})
    table["y"] = (random.normal(0, 0.3, 10) + 0.2 * table["a"]).round(4)
    return pd.concat([table] * 3, ignore_index=True)


def normal(levels: Mapping[str, int], sd: float) -> Draw:
    """Complete normal tables without any effect."""

    def draw(random: np.random.Generator) -> pd.DataFrame:
        table = crossed(levels)
        base = 0.0 if "s" not in levels else random.normal(0, 3, levels["s"])[table["s"]]
        return table.assign(y=10 + base + sd * random.normal(size=len(table)))

    return draw


def fractions(false: tuple[str, ...]) -> Iterator[Table]:
    """List declared models without repeats that leave out the one interaction there is."""
    for size, lost in ((0.55, 0), (0.55, 1), (0.7, 2)):
        yield Table(f"declared model, fraction less {lost}, {size}", fraction(size, lost),
                    ("a", "b", "c", "d", "e"), 1.0, false, model=1, judged=("a", "b"))  # fmt: skip


def single_runs() -> Iterator[Table]:
    """List factorials of one run a cell: complete, less a run, and read in whole units."""
    for size in (0.5, 2.0):
        yield Table(f"unreplicated, interaction {size}", unreplicated(size), ("a", "b", "c", "d"),
                    2 * size, judged=("a", "b"))  # fmt: skip
        yield Table(f"unreplicated less a run, interaction {size}", lost_runs(size, 1),
                    ("a", "b", "c", "d"), 2 * size, judged=("a", "b"))  # fmt: skip
    for sd in (0.05, 0.3):
        yield Table(f"unreplicated, whole units, sd {sd}", whole_units(0.9, sd),
                    ("a", "b", "c", "d"), 0.9)  # fmt: skip


def crossovers() -> Iterator[Table]:
    """List crossovers of two periods, in which a treatment acts on or none does."""
    for n in (12, 24):
        asked = ("a",), 1.0
        yield Table(f"crossover of {n}, acts on", crossover(n, 0, 4), *asked, ("matters",),
                    ("s", "p"))  # fmt: skip
        for size, right in ((2.0, "matters"), (0.0, "no practical difference")):
            yield Table(f"power, crossover of {n}, {size}", crossover(n, size, 0), *asked,
                        (right,), ("s", "p"), power=True)  # fmt: skip


def tables() -> Iterator[Table]:
    """All kinds of tables, one rule of the gate after the other."""
    no = ("no practical difference",)
    yield from single_runs()
    yield from fractions(no)
    for noise in (0.05, 0.3, 0.5, 0.8):
        yield Table(f"declared model, noise {noise}", interacting(5, 1, noise), ("a", "b"), 1.0,
                    no, ("s",), ("a", "b"))  # fmt: skip
    yield Table("6 blocks lack one of 8", lacking(6, 8), ("a",), 1.0, block=("s",))
    yield Table("10 blocks lack one of 16", lacking(10, 16), ("a",), 1.0, block=("s",))
    for b in (3, 5, 8):
        yield Table(f"rounded, {b} blocks lack one of 4", gaps(b, rough, 1.0), ("a",), 0.95,
                    block=("s",))  # fmt: skip
    for b in (5, 8):
        yield Table(f"skewed, {b} blocks lack one of 4", gaps(b, skewed), ("a",), 1.0, block=("s",))
    for counts, sds in (
        ((20, 20, 4), (0.3, 0.3, 1.0)), ((20, 20, 4), (0.3, 0.3, 0.6)), ((5, 5, 5), (0.3, 0.3, 1)),
        ((3,) * 4, (0.3, 0.3, 0.3, 1.0)), ((4,) * 4, (0.3, 0.3, 0.3, 1.0)),
        ((10, 2), (0.3, 1.0)), ((30, 5), (1.0, 0.2)),
    ):  # fmt: skip
        limit = 3 * float(np.hypot(sds[0] / counts[0] ** 0.5, sds[-1] / counts[-1] ** 0.5))
        yield Table(f"scatter {sds} of {counts} rows", one_way(counts, sds, limit), ("a",), limit)
    for b in (2, 3, 4, 5, 8, 10):
        yield Table(f"rounded, {b} blocks", blocks(b, rough, 1.0), ("a",), 0.95, block=("s",))
    for b in (5, 6, 8, 10):
        yield Table(f"skewed, {b} blocks", blocks(b, skewed), ("a",), 1.0, block=("s",))
    for b, k in ((5, 3), (5, 4), (6, 4), (8, 4)):
        yield Table(f"skewed, {b} blocks of {k}", many(b, k), ("a",), 1.0, block=("s",))
    for k, sds, limit in (
        (4, (0.2, 1.5), 1.5), (4, (0.3, 1.0), 1.0), (5, (0.2, 1.5), 1.5), (5, (0.3, 0.6), 0.7),
        (6, (0.2, 1.5), 1.5),
    ):  # fmt: skip
        yield Table(f"Latin square of {k}, scatter {sds}", latin(k, sds, limit), ("a",), limit,
                    block=("r", "c"))  # fmt: skip
    yield Table("power, Latin square of 5", latin(5, (0.35, 0.35), 0.0), ("a",), 1.0,
                ("no practical difference",), ("r", "c"), power=True)  # fmt: skip
    yield from crossovers()
    yield Table("rows copied", repeated, ("a",), 0.2)
    for b in (3, 5, 9):
        yield Table(f"share of the mean, {b} blocks", share(b), ("a",), "5 % of mean", block=("s",))
    for levels, sd in (
        ({"s": 5, "a": 2}, 0.2), ({"s": 3, "a": 2}, 0.2), ({"s": 6, "a": 3, "b": 2}, 0.2),
        ({"s": 9, "a": 2, "b": 2}, 0.3), ({"s": 5, "a": 4}, 0.2),
        ({"r": 5, "a": 3}, 0.3), ({"r": 10, "a": 3}, 0.45),
        ({"r": 3, "a": 2, "b": 2}, 0.22), ({"r": 2, "a": 2, "b": 2, "c": 2}, 0.22),
    ):  # fmt: skip
        factors = tuple(f for f in levels if f not in ("s", "r"))
        block = ("s",) if "s" in levels else ()
        yield Table(f"power, normal {levels}", normal(levels, sd), factors, 1.0, no, block,
                    power=True)  # fmt: skip


@contextmanager
def without_gate() -> Iterator[None]:
    """Let every claim of the printed analysis stand."""
    with patch.object(judged_effects, "_agreed", lambda printed, *_: printed):
        yield


def claims(kind: Table, table: pd.DataFrame) -> bool:
    """Whether one of the judged factors has a claim that is false (or, for power, right)."""
    request = AnalysisRequest(
        "y", kind.factors, Blocking(kind.block), kind.model, exact=False,
        scale=ResponseScale(practical=threshold(kind.practical)),
    )  # fmt: skip
    try:
        found = effects(table, request)
    except RefusedError:
        return False
    claimed = [e for e in found if e.term in kind.judged and e.verdict in kind.false]
    # what holds only if nothing acts on is no claim of tables in which something does
    return any(kind.power or not e.condition for e in claimed)


def main(sets: int = 1000, words: tuple[str, ...] = ()) -> int:
    """Simulate the tables and print both shares of each."""
    worst = 0.05 + 2 * (0.05 * 0.95 / sets) ** 0.5
    bad = 0
    for kind in tables():
        if words and not any(word in kind.name for word in words):
            continue
        drawn = [kind.draw(np.random.default_rng([7, i])) for i in range(sets)]
        with without_gate():
            claimed = [table for table in drawn if claims(kind, table)]
        # the gate only withdraws
        passed = sum(claims(kind, table) for table in claimed) / sets
        printed = len(claimed) / sets
        wrong = passed < 0.9 * printed if kind.power else passed > worst
        bad += wrong
        print(f"{kind.name:48s} {printed:6.3f} -> {passed:6.3f}{'  !' * wrong}", flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    given = sys.argv[1:]
    raise SystemExit(main(int(given[0]), tuple(given[1:])) if given else main())
