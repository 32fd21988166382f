"""Lines by room, and the numbers of the house that may only fall.

    python scripts/ledger.py             files and lines by room: code, docstrings, comments, blank
    python scripts/ledger.py --check     1 where a room is over its budget or a number has risen
    python scripts/ledger.py --write     set the budget and all numbers of [tool.house] to the tree
    python scripts/ledger.py --list NAME what a number counts, such as small_helpers

A room is a package of the first two levels below ``study`` with all that it holds, or the modules
that lie in a package of the first level itself; ``tests`` is one. ``--write`` replaces whatever
pyproject.toml has between its two marks and says which room has grown: a commit that lets a room
grow says for what.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))
from tests import house  # noqa: E402

BEGIN = "# numbers of the house: written by scripts/ledger.py --write\n"
END = "# end of the numbers of the house\n"


@dataclass
class Lines:
    """What a room holds."""

    files: int = 0
    code: int = 0
    docstring: int = 0
    comment: int = 0
    blank: int = 0

    @property
    def all(self) -> int:
        """Lines of every kind."""
        return self.code + self.docstring + self.comment + self.blank

    def __iadd__(self, more: Lines) -> Lines:
        """Add another file or room."""
        return Lines(*(a + b for a, b in zip(astuple(self), astuple(more), strict=True)))


def lines_of(text: str) -> Lines:
    """Count the lines of a module, each once."""
    tree = house.parsed(text)
    docstrings: set[int] = set()
    in_texts: set[int] = set()
    for node in house.walked(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            if ast.get_docstring(node, clean=False) is not None:
                docstrings |= _span(node.body[0])
        elif isinstance(node, ast.Constant | ast.JoinedStr) and node.lineno != node.end_lineno:
            in_texts |= _span(node)
    counts = Lines(files=1, docstring=len(docstrings))
    for number, line in enumerate(text.splitlines(), start=1):
        if number in docstrings:
            continue
        bare = line.strip()
        if not bare and number not in in_texts:
            counts.blank += 1
        elif bare.startswith("#") and number not in in_texts:
            counts.comment += 1
        else:
            counts.code += 1
    return counts


def _span(node: ast.stmt | ast.expr) -> set[int]:
    return set(range(node.lineno, (node.end_lineno or node.lineno) + 1))


def room_of(path: Path) -> str:
    """Room of a module, as its path below the root: at most two packages deep."""
    return "tests" if path.parts[0] == "tests" else "/".join(path.parent.parts[:3])


def ledger(root: Path) -> dict[str, Lines]:
    """Lines of every room, by its path."""
    rooms: dict[str, Lines] = {}
    for folder in ("study", "tests"):
        for path in sorted((root / folder).rglob("*.py")):
            room = room_of(path.relative_to(root))
            rooms.setdefault(room, Lines())
            rooms[room] += lines_of(path.read_text(encoding="utf-8"))
    return rooms


def table(rooms: dict[str, Lines]) -> Iterator[str]:
    """Give the ledger as lines of text, with the sum of what lies below ``study``."""
    heads = ("files", "code", "docstring", "comment", "blank", "all")
    yield f"{'room':36}" + "".join(f"{head:>11}" for head in heads)
    package = Lines()
    for name, room in rooms.items():
        package += room if name != "tests" else Lines()
    for name, room in [*sorted(rooms.items()), ("study, all rooms", package)]:
        yield f"{name:36}" + "".join(f"{n:11,}" for n in (*astuple(room), room.all))
    yield f"docstrings: {package.docstring / max(package.all, 1):.1%} of the lines of study"


@dataclass(frozen=True)
class Counts:
    """What a tree holds today: lines by room, and the numbers of the house."""

    rooms: dict[str, Lines]
    numbers: dict[str, int | list[str] | dict[str, int]]


def counts_of(root: Path) -> Counts:
    """Count a tree, every file of it parsed once."""
    return Counts(ledger(root), house.counted(root))


def risen(root: Path, counts: Counts) -> Iterator[str]:
    """Name the rooms over their budget, and the numbers above those of pyproject.toml."""
    let_in = house.let_in(root)
    budget = let_in.get("budget", {})
    for name, room in counts.rooms.items():
        most = budget.get(name, {"files": 0, "code": 0, "lines": 0})
        for key, count in _budget(room).items():
            if count > most[key]:
                yield f"{name}: {count:,} {key}, the budget is {most[key]:,}"
    for name, value in counts.numbers.items():
        yield from _risen(name, value, let_in.get(name))


def _risen(name: str, value: Any, most: Any) -> Iterator[str]:
    """Name what is new in a number, a list or a table of numbers."""
    if isinstance(value, int):
        if value > (most or 0):
            yield f"{name}: {value}, at most {most or 0} (python scripts/ledger.py --list {name})"
    elif isinstance(value, list):
        yield from (f"{name}: {item} is new" for item in value if item not in (most or []))
    else:
        for key, count in value.items():
            if count > (most or {}).get(key, 0):
                yield f"{name}: {key} has {count}, at most {(most or {}).get(key, 0)}"


def _budget(room: Lines) -> dict[str, int]:
    return {"files": room.files, "code": room.code, "lines": room.all}


def tables_of(counts: Counts) -> str:
    """Write counts as tables of pyproject.toml."""
    text = ["[tool.house.numbers]"]
    text += [
        f"{name} = {value}" for name, value in counts.numbers.items() if isinstance(value, int)
    ]
    for name, value in counts.numbers.items():
        if isinstance(value, list):
            text += [f"{name} = [", *(f'    "{item}",' for item in value), "]"]
    for name, value in counts.numbers.items():
        if isinstance(value, dict):
            text += ["", f"[tool.house.numbers.{name}]"]
            text += [f'"{key}" = {count}' for key, count in value.items()]
    text += ["", "[tool.house.numbers.budget]"]
    for name, room in sorted(counts.rooms.items()):
        pairs = ", ".join(f"{key} = {count}" for key, count in _budget(room).items())
        text.append(f'"{name}" = {{ {pairs} }}')
    return "\n".join(text) + "\n"


def write(root: Path, counts: Counts) -> None:
    """Set the numbers of pyproject.toml to what the tree has."""
    path = root / "pyproject.toml"
    before, _, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"pyproject.toml lacks the lines\n{BEGIN}{END}")
    path.write_text(f"{before}{BEGIN}{tables_of(counts)}{END}{after}", encoding="utf-8")


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Print, check or write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--list", metavar="NAME")
    options = parser.parse_args(arguments)
    if options.list:
        counter = getattr(house, options.list, None)
        if counter is None or options.list not in house.let_in(root)["numbers"]:
            print(f"no number {options.list}; there are {', '.join(house.let_in(root)['numbers'])}")
            return 2
        breaches = counter(root)
        lines = breaches.items() if isinstance(breaches, dict) else breaches
        print(*([breaches] if isinstance(breaches, int) else lines), sep="\n")
        return 0
    if not options.check and not options.write:
        print(*table(ledger(root)), sep="\n")
        return 0
    counts = counts_of(root)
    grown = list(risen(root, counts))
    if options.write:
        write(root, counts)
        print("numbers written to pyproject.toml", *(f"grown: {line}" for line in grown), sep="\n")
        return 0
    print(*(grown or ["nothing has risen"]), sep="\n")
    return 1 if grown else 0


if __name__ == "__main__":
    sys.exit(main())
