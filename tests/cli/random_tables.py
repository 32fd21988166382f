"""Random tables as people send them: gaps, copies, one level, text in numbers, odd names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

ODD_LABELS = (
    "a", "A", "1", "1.0", "01", "-3", "1e5", "a:b", "a b", "\u00e9t\u00e9", "\u65e5\u672c", "x,y",
    'say "so"', "=1+1", "<b>", "None", "True", "l" * 300, "\U0001f600", "0.1", "%", "{x}", "\\n",
)  # fmt: skip
ODD_NAMES = (
    "A",
    "B",
    "a factor",
    "D",
    "E",
    "F",
    "G",
    "H",
    "I",
    "J",
    "K",
    "L",
    "T:C",
    "\u03b1",
    "<i>",
    "x" * 120,
    "1",
    "mean",
    "level",
    "C(A)",
)
ODD_NUMBERS = (
    "", "NA", "nan", "*", "inf", "-inf", "1e300", "-1e300", "1e308", "1e-320", "0", "-0", "1,5",
    "1.2.3", "twelve", "1e400", " 7 ", "+3", "0x10", "1_000",
)  # fmt: skip


@dataclass(frozen=True)
class RandomTable:
    """A file and the command line that asks for its analysis."""

    data: bytes
    arguments: tuple[str, ...]


Values = np.ndarray
Spoil = Callable[[np.random.Generator, Values], Values]


def _scattered(rng: np.random.Generator, y: Values) -> Values:
    return y


def _constant(rng: np.random.Generator, y: Values) -> Values:
    return np.full_like(y, y[0])


def _copies(rng: np.random.Generator, y: Values) -> Values:
    return np.round(y) + 1e-13 * rng.standard_normal(y.size)


def _huge(rng: np.random.Generator, y: Values) -> Values:
    return y * 10.0 ** rng.integers(200, 301)


def _tiny(rng: np.random.Generator, y: Values) -> Values:
    return y * 10.0 ** -float(rng.integers(150, 310))


def _shifted(rng: np.random.Generator, y: Values) -> Values:
    return y + 1e12


def _few_values(rng: np.random.Generator, y: Values) -> Values:
    return np.sign(y)


def _outlier(rng: np.random.Generator, y: Values) -> Values:
    y = y.copy()
    y[rng.integers(y.size)] = 10.0 ** rng.integers(3, 300)
    return y


SPOILS: tuple[Spoil, ...] = (
    *[_scattered] * 8, _constant, _copies, _copies, _shifted, _shifted, _few_values, _huge, _tiny,
    _outlier,
)  # fmt: skip


def random_table(seed: int) -> RandomTable:
    """Table number ``seed``, always the same."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 4))
    names = [str(n) for n in rng.choice(ODD_NAMES, k + 2, replace=False)]
    *factors, block, response = names
    labels = [_labels(rng, int(rng.choice([1, 2, 2, 2, 3, 3, 3, 3, 4, 4]))) for _ in factors]
    blocks = [str(i) for i in range(int(rng.integers(1, 6)))]
    rows = _rows(rng, labels, blocks)
    y = rng.standard_normal(len(rows)) + rng.integers(0, 3) * np.arange(len(rows)) / 10
    texts = [repr(float(v)) for v in SPOILS[rng.integers(len(SPOILS))](rng, y)]
    if rng.random() < 0.25:
        for _ in range(int(rng.integers(1, 4))):
            texts[rng.integers(len(texts))] = str(rng.choice(ODD_NUMBERS))
    header = [*factors, block, response]
    if rng.random() < 0.03:
        header[0] = header[-1]  # a column twice
    body = [[*levels, at, text] for (levels, at), text in zip(rows, texts, strict=True)]
    data = _file(rng, header, body)
    if rng.random() < 0.02:
        data = bytes(rng.integers(0, 256, 80, dtype=np.uint8))
    if rng.random() < 0.02:
        data = data[: int(rng.integers(0, len(header[0]) + 2))]
    return RandomTable(data, tuple(_arguments(rng, factors, block, response)))


def _labels(rng: np.random.Generator, count: int) -> list[str]:
    if rng.random() < 0.6:
        return [f"l{i}" for i in range(count)]
    return [str(label) for label in rng.choice(ODD_LABELS, count, replace=False)]


def _rows(
    rng: np.random.Generator, labels: list[list[str]], blocks: list[str]
) -> list[tuple[list[str], str]]:
    """Every cell in every block, repeated; sometimes with gaps, sometimes in any order."""
    cells: list[list[str]] = [[]]
    for own in labels:
        cells = [[*cell, label] for cell in cells for label in own]
    repeats = int(rng.integers(1, 4))
    rows = [(cell, at) for at in blocks for cell in cells for _ in range(repeats)]
    if rng.random() < 0.3:
        rows = [row for row in rows if rng.random() > 0.25] or rows[:1]
    if rng.random() < 0.3:
        rows = [rows[i] for i in rng.permutation(len(rows))]
    return rows[:120]


def _file(rng: np.random.Generator, header: list[str], body: list[list[str]]) -> bytes:
    separator = str(rng.choice([",", ",", ",", ";", "\t"]))
    end = str(rng.choice(["\n", "\r\n"]))

    def cell(text: str) -> str:
        quoted = any(mark in text for mark in (separator, '"'))
        return '"' + text.replace('"', '""') + '"' if quoted else text

    lines = [separator.join(cell(text) for text in row) for row in [header, *body]]
    if rng.random() < 0.03:
        lines[-1] = lines[-1] + separator + "7"  # a row too long
    mark = "\ufeff" if rng.random() < 0.1 else ""
    return (mark + end.join(lines) + end).encode()


def _arguments(
    rng: np.random.Generator, factors: list[str], block: str, response: str
) -> list[str]:
    named = [name for name in factors if "," not in name]
    out = ["--response", response, "--factors", ",".join(named)]
    out += ["--block", block] if rng.random() < 0.4 else []
    options = (
        ("--practical", ("0.5", "5 % of mean", "1e-300"), 0.4),
        ("--transform", ("log",), 0.15),
        ("--type", ("I", "II", "III"), 0.3),
        ("--model", ("1", "2", "full"), 0.3),
        ("--error", ("own", "pooled"), 0.2),
        ("--alpha", ("0.1", "0.01"), 0.1),
        ("--reference", ("l0", "a"), 0.15),
    )
    for flag, values, share in options:
        if rng.random() < share:
            out += [flag, str(rng.choice(values))]
    return out
