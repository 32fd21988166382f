"""Faulty study files as data: sound files, changes of every key, and what the reader says of each.

``faulty_files/*.toml`` are the sound files, ``faulty_files/faults.jsonl`` holds one change a line
with the faults found: those of every key by :func:`changes`, and others that were thought of, each
a line of its own (for a new one write base and change with no fault). After that, or a deliberate
change of a rule, ``python -m tests.design.faulty`` writes the faults anew; their difference is
then part of what is reviewed.
"""

from __future__ import annotations

import copy
import json
import re
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from study.ground.declaration import dump_toml, parse_toml
from study.ground.errors import InputError
from study.harness.design.load import CALIBRATION, loads, loads_problem

FOLDER = Path(__file__).parent / "faulty_files"
LOADERS = {
    "problem": loads_problem,
    "block": loads_problem,
    "surface": loads_problem,
    "design": loads,
    "fraction": loads,
    "sample": loads,
    "adaptive": loads,
    "nested": loads,
    "markers": loads,
    "calibration": CALIBRATION.loads,
}
#: files of which single rules are of interest, and not every key
OF_SINGLE_RULES = {
    "alone": loads,
    "mixed": loads,
    "ranges": loads,
    "spring": loads,
    "program": loads,
    "relaxed": loads_problem,
    "foam": loads_problem,
    "gauge": CALIBRATION.loads,
    "biaxial": CALIBRATION.loads,
    "courses": CALIBRATION.loads,
}
#: a small design to which tests add factors
BASE = """
schema = 1
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "bonded"
displacement = "6 mm"
[material]
model = "neo-hookean"
C10 = "5 kPa"
poisson_ratio = 0.4995
[model]
mesh = "coarse"
[[response]]
name = "seconds"
"""
#: a key left out; TOML has no such value
ABSENT = None
TABLE_VALUES = ("text", [], 1)
LIST_VALUES = ([], "text", [1], {})
NUMBER_VALUES = ("0.5", -1, 1.5, float("nan"), True)
INTEGER_VALUES = (2.5, -1, "3", 10**9)
TEXT_VALUES = ("", 3, "=1+1", ["text"])
#: of a key that another table of the file has had in full
REPEATED_VALUES = (True, [])


class Faulty(NamedTuple):
    """A change of a sound file and the faults that it causes: where, rule, mend."""

    base: str
    change: dict[str, Any]
    faults: list[list[str]]

    @property
    def table(self):
        """Table of the file that is changed."""
        return next(iter(self.change)).partition(".")[0]


def stored():
    """Every change with its faults, as kept."""
    lines = (FOLDER / "faults.jsonl").read_text(encoding="utf-8").splitlines()
    return [Faulty(**json.loads(line)) for line in lines]


def faults_of(base, change):
    """Faults that today's reader finds in a changed file."""
    tables = copy.deepcopy(_tables(base))
    for key, value in change.items():
        _set(tables, key.split("."), value)
    try:
        (LOADERS | OF_SINGLE_RULES)[base](dump_toml(tables), "x.toml")
    except InputError as error:
        found = [(f.where.removeprefix("x.toml: "), f.rule, f.mend) for f in error.faults]
        return sorted([where, rule, _shortened(mend)] for where, rule, mend in found)
    return []


def _shortened(mend):
    """Mend without the list of all valid names, which grows with every new key."""
    return re.sub(r"Valid: .*", "Valid:", mend, flags=re.DOTALL)


@cache
def _tables(base):
    return parse_toml((FOLDER / f"{base}.toml").read_text(encoding="utf-8"), base)


def _set(node, path, value):
    for part in path[:-1]:
        node = node[int(part)] if isinstance(node, list) else node.setdefault(part, {})
    if value is ABSENT:
        del node[path[-1]]
    else:
        node[path[-1]] = value


def changes(base, met):
    """Every key left out, misspelt and with wrong values."""
    for key, value in _keys(_tables(base), ""):
        plain = re.sub(r"^calibration\.problem\.|\btests\.\d+\.|\d+\.", "", key)
        first, elsewhere = plain not in met, plain != key
        met.add(plain)
        if first:
            table, _, last = key.rpartition(".")
            yield {key: ABSENT, f"{table}.{misspelt(last)}".lstrip("."): value}
        if first or elsewhere:
            yield {key: ABSENT}
            yield from ({key: wrong} for wrong in (_wrong(value) if first else REPEATED_VALUES))


def misspelt(key):
    """Key with two letters exchanged, or one more."""
    return key[0] + key[2] + key[1] + key[3:] if len(key) > 3 and key[1] != key[2] else f"{key}x"


def _keys(node, prefix):
    for name, value in node.items():
        key = f"{prefix}{name}"
        yield key, value
        if isinstance(value, dict):
            yield from _keys(value, f"{key}.")
        elif isinstance(value, list) and isinstance(value[0], dict):
            for i, row in enumerate(value):
                yield from _keys(row, f"{key}.{i}.")


def _wrong(value):
    if isinstance(value, bool):
        return ("true", 1)
    if isinstance(value, dict):
        return TABLE_VALUES
    if isinstance(value, list):
        return (*LIST_VALUES, [*value, value[0]])
    if isinstance(value, int):
        return INTEGER_VALUES
    if isinstance(value, float):
        return NUMBER_VALUES
    return _wrong_quantity(value) or (*TEXT_VALUES, misspelt(value))


def _wrong_quantity(text):
    """Texts near to a number with a unit; none where the text is something else."""
    match = re.fullmatch(r"(-?[\d.]+) (\S+)", text)
    if match is None:
        return ()
    number, unit = match.groups()
    other = "kPa" if unit in ("mm", "deg", "%") else "mm"
    texts = (number, f"-{number} {unit}", f"{number} {other}", f"{number} {unit}x", f"nan {unit}")
    return (float(number), *texts)


def found_now():
    """Changes of every key, then those that were thought of, with the faults of today's reader."""
    met = set()
    thought_of = stored()
    for base in LOADERS | OF_SINGLE_RULES:
        keys = changes(base, met) if base in LOADERS else ()
        every = {str(change): change for change in keys}
        every |= {str(row.change): row.change for row in thought_of if row.base == base}
        for change in every.values():
            yield Faulty(base, change, faults_of(base, change))


if __name__ == "__main__":
    rows = [json.dumps(one._asdict(), ensure_ascii=False) for one in found_now()]
    (FOLDER / "faults.jsonl").write_text("\n".join(rows) + "\n", encoding="utf-8")
    print(len(rows), "changes written")
