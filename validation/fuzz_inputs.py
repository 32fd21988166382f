"""Inputs of the fuzz campaign: designs, tables, surfaces, records and folders, made or damaged.

Each maker takes a generator of random numbers, an empty project folder to fill, and the place of
the campaign. It gives back the verbs to be run there, as words after ``study``, and whether they
are to be run without rights.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import json
import math
import os
import shutil
import stat
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from study.cli.app import run
from study.ground.declaration import dump_toml
from validation.damage import WRONG, instead, places, sealed, without

Made = tuple[list[list[str]], bool]
Rows = list[list[str]]
Array = np.ndarray[Any, Any]

#: numbers, texts and other values that readers forget
NUMBERS = (
    0, -1, 1, 2, 7, 0.5, 1e200, -1e200, 1e308, 1e-300, 5e-324, math.nan, math.inf, -math.inf,
    2**31, 2**63, 2**70, -(2**70), 10**400, 1_000_000, 0.1 + 0.2,
)  # fmt: skip
WORDS = (
    "| |3 kg|mm|1e400 mm|-3 mm|0 mm|nan mm|inf mm|1e-300 mm|3|3 %|1e9 kPa|3 mm mm|3 mm/s|1/0 mm|"
    "9**9**9 mm|../../x|/etc/passwd|/dev/zero|..|.|~|a/b|a\0b|\u00e9|\u65e5|\U0001f600|\u202e|"
    "line\nbreak|{specimen}|{0}|%s|$HOME|<b>|None|true|nan|auto|[red]|__class__|C10|none|fem|"
    "surface|ogden|a:b|a,b|=1+1|\x1b[31m|\ufeff|" + "x" * 100_000
).split("|")
OTHERS: tuple[Any, ...] = (
    [], {}, [[]], [{}], True, False, ["a", "a"], ["", 1, True], [1, 2], {"": 1}, {"model": "fem"},
    [f"{k} mm" for k in range(3000)], list(range(-2, 400)), [f"{k}" for k in range(40)],
    ["1 mm", "0 mm"], ["1 kPa", "nan kPa"],
)  # fmt: skip
UNITS = ("mm", "m", "kPa", "MPa", "deg", "N", "s", "%", "kg/m^3", "1/s", "K", "parsec", "", "pp")

#: a study in closed form: no mesh, and seconds
STUDY = """schema = 1
study = { name = "small", question = "Does the energy or the range matter?", seed = 2011 }
specimen = { shape = "cylinder", radius = "25 mm", height = "30 mm" }
test = { kind = "compression", interface = "frictionless" }
material.incompressible = true
calibration.method = "analytic"
report.format = ["csv"]
response = [{ name = "relative_rms_force_error", practical = "0.5 pp" }]
[presets]
material.neo-hookean.model = "neo-hookean"
material.mooney-rivlin.model = "mooney-rivlin"
range.small.measurements.range = ["1 %", "10 %"]
range.large.measurements.range = ["1 %", "20 %"]
[factors]
material = ["neo-hookean", "mooney-rivlin"]
range = ["small", "large"]
"""
MEASURED = """[measurements]
file = "tests.csv"
columns = { displacement = "d_mm", force = "f_N" }
units = { displacement = "mm", force = "N" }
block = "mix"
fit = { specimen = "A" }
score = { specimen = "B" }
points = 30
"""
#: a study of a surface; its specimen and its test are put before it
SURFACE = """schema = 1
material = { model = "neo-hookean", bulk_modulus = "10 MPa" }
model.mesh_size = "3 mm"
response = [{ name = "mu0" }]
factors."test.interface" = ["frictionless", "bonded"]
"""
TESTS = (
    'kind = "compression"',
    'kind = "indentation", indenter = { shape = "sphere", radius = "2 mm" }',
    'kind = "indentation", indenter = { shape = "flat", radius = "3 mm", edge_radius = "1 mm" }',
)


@dataclass(frozen=True)
class Place:
    """Where a campaign works: its own folder, and the measurements that designs name."""

    campaign: str
    data: str

    @property
    def finished(self) -> Path:
        """Folder of the finished study."""
        return Path(self.campaign, "finished")


def pick(rng: Generator, items: Any) -> Any:
    """Draw one of several, whatever they are."""
    return items[int(rng.integers(len(items)))]


def measurements() -> str:
    """Six specimens of a neo-Hookean cylinder, each a little different, with noise."""
    d, rng, rows = np.linspace(0, 6.5, 66), np.random.default_rng(1), ["mix,specimen,d_mm,f_N"]
    for k, name in enumerate(("M1,A", "M1,B", "M2,A", "M2,B", "M3,A", "M3,B")):
        stretch = 1 - d / 30
        force = 1e-3 * (16 + k) * np.pi * 25**2 * (stretch**-2 - stretch)
        force += 0.01 * rng.standard_normal(d.size)
        rows += [f"{name},{x:.4f},{f:.8f}" for x, f in zip(d, force, strict=True)]
    return "\n".join(rows) + "\n"


def finish(kind: str, place: Place) -> None:
    """Run the small study once a campaign, if its kind damages one."""
    if kind not in ("records", "folders") or place.finished.exists():
        return
    made = place.finished.with_name("unfinished")
    (made / "data").mkdir(parents=True)
    (made / "small.toml").write_text(STUDY + MEASURED)
    (made / "data" / "tests.csv").write_text(measurements())
    os.chdir(made)
    with (
        open(os.devnull, "w") as no,
        contextlib.redirect_stdout(no),
        contextlib.redirect_stderr(no),
    ):
        codes = (
            run(["run", "small.toml", "--data", "data", "--jobs", "1"]),
            run(["report", "small", "--format", "csv,html"]),
        )
    if any(codes):
        raise RuntimeError(f"the study to be damaged ended with {codes}")
    os.chdir(place.campaign)
    made.rename(place.finished)


def write_neighbours(sandbox: Path, place: Place) -> None:
    """Write what lies beside a project and is none of its business; links may lead there."""
    other = sandbox / "other"
    (other / "empty").mkdir(parents=True)
    (other / "notes.txt").write_text("nobody's business\n")
    (sandbox / "x").write_text("a file that is named like an input\n")
    if place.finished.exists():
        shutil.copytree(place.finished / "results" / "small", other / "small")


# Trees, of TOML or of JSON


def spot(rng: Generator, node: Any) -> tuple[Any, Any] | None:
    """Find a container and a key by walking down: long lists do not hide the rest."""
    found = None
    while isinstance(node, (dict, list)) and len(node):
        found = node, pick(rng, list(node) if isinstance(node, dict) else range(len(node)))
        node = node[found[1]]
        if rng.random() < 0.15:
            break
    return found


def nasty(rng: Generator, donor: Any) -> Any:
    """Give a value that hardly any key can hold."""
    kind = rng.random()
    if kind < 0.6:
        return pick(rng, NUMBERS if kind < 0.3 else WORDS)
    if kind < 0.75 and (found := spot(rng, donor)) is not None:
        return copy.deepcopy(found[0][found[1]])
    if kind < 0.8:
        deep: Any = 1
        for _ in range(int(rng.integers(2, 80))):
            deep = [deep] if rng.random() < 0.7 else {"a": deep}
        return deep
    return copy.deepcopy(pick(rng, OTHERS))


def near(rng: Generator, value: Any) -> Any:
    """Give a value like another one, with another number, unit, type or length."""
    if isinstance(value, str):
        number, _, unit = value.partition(" ")
        if unit and rng.random() < 0.8:
            drawn = pick(rng, NUMBERS[:16]) if rng.random() < 0.5 else 10 ** rng.normal(0, 3)
            return f"{drawn:g} {unit}" if rng.random() < 0.7 else f"{number} {pick(rng, UNITS)}"
        return pick(
            rng, (value.upper(), value[:-1], value * 2, value + " ", [value], value + "/..")
        )
    if isinstance(value, bool) or value is None:
        return pick(rng, (not value, str(value), int(bool(value)), [value]))
    if isinstance(value, (int, float)):
        return pick(rng, (-value, value * 1e6, str(value), [value], value + 0.5, f"{value} mm", 0))
    if isinstance(value, list):
        return pick(rng, (value * 2, value[:1], value[1:], value[::-1], value * 200, [value]))
    return pick(rng, ([value], list(value), {k: v for k, v in value.items() if rng.random() < 0.5}))


def mutate(rng: Generator, tree: Any, donor: dict[str, Any]) -> None:
    """Change one thing in a tree of plain values, but hardly ever its version."""
    found = spot(rng, tree)
    if found is None or (found[1] == "schema" and rng.random() < 0.9):
        return
    (node, key), kind = found, int(rng.integers(12))
    if kind == 0:
        del node[key]
    elif kind == 1 and isinstance(node, dict):
        node[pick(rng, (*WORDS, *list(node), f"{key}2", str(key)[:-1]))] = node.pop(key)
    elif kind == 2:
        copied = copy.deepcopy(node[key])
        node.insert(key, copied) if isinstance(node, list) else node.update({f"{key}-2": copied})
    elif kind == 3 and isinstance(tree, dict):
        name = pick(rng, list(donor))
        tree[name] = copy.deepcopy(donor[name])
    else:
        node[key] = nasty(rng, donor) if kind < 6 else near(rng, node[key])


def damage(rng: Generator, data: bytes) -> bytes:
    """Break bytes: flipped, lost, repeated, cut short, emptied, or followed by others."""
    at = int(rng.integers(len(data) + 1))
    end = min(len(data), at + int(rng.integers(1, 60)))
    span = (0, 256) if rng.random() < 0.3 else (32, 127)
    noise = bytes(rng.integers(*span, int(rng.integers(1, 40)), dtype=np.uint8))
    marks = (b"\0", b'"', b"\n", b"[", b"{", b"=", b"\xff", b"\r", b"\xef\xbb\xbf", b"[" * 5000)
    bit = 1 << int(rng.integers(7))
    flipped = bytes(one ^ bit for one in data[at : at + 1])
    ways = (
        data[:at], data[:at] + data[end:], data[:at] + noise + data[end:], data[:end] + data[at:],
        data[:at] + pick(rng, marks) + data[at:], data + noise,
        data[:at] + flipped + data[at + 1 :],
    )  # fmt: skip
    return b"" if rng.random() < 0.02 else bytes(pick(rng, ways))


# Designs


@cache
def shipped() -> tuple[tuple[str, dict[str, Any]], ...]:
    """Text and tree of every shipped design and problem."""
    folder = Path(__file__).resolve().parents[1] / "designs"
    texts = [path.read_text() for path in sorted(folder.glob("*.toml"))]
    return tuple((text, tomllib.loads(text)) for text in texts)


def designs(rng: Generator, project: Path, place: Place) -> Made:
    """Damage a shipped design and plan it."""
    whole = [one for one in shipped() if "factors" in one[1]]
    text, tree = pick(rng, whole if rng.random() < 0.95 else shipped())
    data, many = text.encode(), int(rng.choice([1, 1, 1, 2, 2, 3, 4]))
    if rng.random() < 0.2:
        for _ in range(many):
            data = damage(rng, data)
    else:
        tree = copy.deepcopy(tree)
        for _ in range(many):
            mutate(rng, tree, pick(rng, shipped())[1])
        data = dump_toml(tree).encode()
    (project / "design.toml").write_bytes(data)
    words = ["plan", "design.toml", "--data", place.data, "--results", "R"]
    for more in (["--json"], ["--run-sheet", "sheet.csv"], ["--augment", "4"]):
        words += more if rng.random() < (0.1 if len(more) == 1 else 0.03) else []
    if rng.random() < 0.05:
        key = pick(rng, ("test.displacement", "model.mesh_size", "a.b", "[", "factors.x", ""))
        words += ["-s", f"{key}={pick(rng, WORDS)}".replace("\0", "")]
    return [words], False


# Tables

NAMES = (
    "a", "b", "a factor", "c", "d", "\u03b1", "<i>", "1", "Mean", "levels", "C(a)", "e", "f",
    "mean", "T:C", "a,b", "", " b",
)  # fmt: skip
LABELS = (
    'a|A|1|1.0|01|1e5|a:b|a b|\u00e9|x,y|say "so"|=1+1|<b>|True|\U0001f600|%|{x}|\\n|-|nan||a\nb|'
    "'|\u202e|[red]x[/red]|" + "l" * 300
).split("|")
CELLS = (
    "|NA|nan|*|inf|-inf|1e300|1e308|1e-320|0|-0|1,5|1.2.3|x|1e400| 7 |+3|0x10|1_000|\u0663|1e|--1|"
    "1 000|#N/A|\0|" + "9" * 400
).split("|")


def _cells(rng: Generator, count: int) -> tuple[Rows, list[str]]:
    """Every combination of levels of some factors, and the levels of the first one."""
    cells: Rows = [[]]
    first: list[str] = []
    for _ in range(count):
        size = int(rng.choice([1, 2, 2, 2, 3, 3, 4, 7, 30 if count < 3 else 5]))
        kind = rng.random()
        pool = (
            [f"l{k}" for k in range(40)]
            if kind < 0.4
            else LABELS
            if rng.random() < 0.4
            else LABELS[:18]
        )
        if kind > 0.6:
            pool = [f"{k * 10.0 ** rng.integers(-2, 3):g}" for k in range(40)]
        levels = [str(pool[k]) for k in rng.permutation(len(pool))[:size]]
        first = first or levels
        cells = [[*cell, label] for cell in cells for label in levels]
    return cells[:400], first


def _table(rng: Generator, count: int) -> tuple[Rows, list[str]]:
    """Header and rows of a crossed table with blocks, gaps, copies and odd numbers."""
    cells, levels = _cells(rng, count)
    blocks, repeats = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    rows = [[*cell, f"B{k}"] for k in range(blocks) for cell in cells for _ in range(repeats)]
    if rng.random() < 0.3:
        rows = [row for row in rows if rng.random() > 0.3] or rows[:1]
    y = rng.standard_normal(len(rows)) + rng.integers(0, 3) * np.arange(len(rows)) / 10
    y = np.round(y) if rng.random() < 0.15 else y
    y *= pick(rng, (1, 1, 1, 1, 0, 1e12, 1e-12, 1e200, 1e-200, 1e304))
    for row, value in zip(rows, y + pick(rng, (0, 0, 0, 10, 1e9)), strict=True):
        row.append(repr(float(value)))
    for _ in range(int(rng.integers(1, 5)) if rng.random() < 0.15 else 0):
        pick(rng, rows)[int(rng.integers(count + 2))] = pick(rng, CELLS)
    known = NAMES if rng.random() < 0.15 else NAMES[:13]
    names = [known[k] for k in rng.permutation(len(known))[:count]]
    return [[*names, "block", pick(rng, ("y", "y", "life [h]"))], *rows], levels


def _csv(rng: Generator, table: Rows) -> bytes:
    """Text of a table as one program or another writes it."""
    mark, ends = pick(rng, (",", ",", ",", ";", "\t", "|")), pick(rng, ("\n", "\n", "\r\n", "\r"))
    decimal, lines = rng.random() < 0.05, []
    for row in table:
        cells = [cell.replace(".", ",") if decimal else cell for cell in row]
        quote = rng.random() < 0.02
        odd = [quote or any(m in cell for m in (mark, '"', "\n")) for cell in cells]
        quoted = ['"' + cell.replace('"', '""') + '"' for cell in cells]
        lines.append(mark.join(q if o else c for o, q, c in zip(odd, quoted, cells, strict=True)))
    if rng.random() < 0.05:
        lines[-1] += pick(rng, (mark + "7", '"', mark * 3000, "\n" * 50, "\0"))
    text = ("\ufeff" if rng.random() < 0.1 else "") + ends.join(lines) + ends
    code = pick(rng, ("utf-8",) * 20 + ("utf-16", "latin-1", "cp1252", "utf-32", "shift_jis"))
    data = text.encode(code, errors="replace")
    return damage(rng, data) if rng.random() < 0.05 else data


def tables(rng: Generator, project: Path, place: Place) -> Made:
    """Write a table of any quality and analyze it."""
    count = int(rng.integers(1, 4))
    table, levels = _table(rng, count)
    (project / "t.csv").write_bytes(_csv(rng, table))
    a, z, block, y = table[0][0], *table[0][-3:]
    words = ["analyze", "t.csv", "--response", y, "--factors", ",".join(table[0][:count])]
    term = f"{a}={pick(rng, levels)} - {a}={pick(rng, levels)}"
    options: tuple[tuple[str, tuple[str, ...], float], ...] = (
        ("--block", (block, block, block, block, f"{block},{a}", "no"), 0.5),
        ("--unit", (block, z, "no"), 0.05), ("--whole-plot", (a, "no"), 0.05),
        ("--replicates", ("runs", "mesh-seeds", "noise", "no"), 0.06),
        ("--error", ("auto", "own", "pooled"), 0.2),
        ("--type", ("I", "II", "III", "III", "4"), 0.2),
        ("--transform", ("log", "none", "root"), 0.1),
        ("--model", ("1", "2", "full", "0", "99", f"{a}:{z}", "a:b:c"), 0.2),
        ("--practical", ("0.5", "0.1", "5 % of mean", "5 % of mean", "1e-300", "1e999", "x"), 0.3),
        ("--alpha", ("0.1", "0.01", "0", "1", "nan", "1e-300", "-1"), 0.07),
        ("--decimal", (".", ",", ";"), 0.03), ("--reference", (pick(rng, levels), "no"), 0.1),
        ("--contrast", (term, term, f"{a}={levels[0]}", "=", "2*" + term, " - "), 0.1),
    )  # fmt: skip
    numeric = ("--numeric", (a, ",".join(table[0][:count]), f"{a}=0..1", f"{a} log"), 1.0)
    surface = ("--surface", ("auto", "quadratic", "emulator", "none", "no"), 0.4)
    mixed = (
        ("--error", ("reml",), 1.0),
        ("--random", (a, block), 0.4),
        ("--covariates", (a, z), 0.2),
    )
    page = ("--report", ("out",), 1.0), ("--format", ("csv", "csv", "html", "tex", "no"), 0.8)
    kind = rng.random()
    if kind < 0.1:
        options = (options[0], numeric, surface)
    elif kind < 0.25:
        options = (options[0], *mixed, options[9])
    elif kind < 0.3:
        options += page
    for flag, values, share in options:
        words += [flag, str(pick(rng, values))] if rng.random() < share else []
    words += ["--json"] if rng.random() < 0.4 else []
    return [[word.replace("\0", "") for word in words]], False


# Surfaces


def _body(rng: Generator) -> tuple[Array, Array]:
    """Points and triangles of a tetrahedron, box, prism, or rounded body."""
    kind, size = int(rng.integers(4)), 10 ** rng.uniform(0.5, 1.1)
    if kind == 0:
        points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
        return size * points, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    n, rings = (4, 2) if kind == 1 else (int(rng.integers(3, 24)), int(rng.integers(2, 10)))
    heights, t = np.linspace(-1, 1, rings).repeat(n), np.tile(np.arange(n), rings) * 2 * np.pi / n
    radii = np.ones(n * rings) if kind < 3 else np.sqrt(1.2 - heights**2)
    points = np.column_stack([radii * np.cos(t), radii * np.sin(t), heights])
    cells = []
    for i, j in ((i, (i + 1) % n) for i in range(n)):
        cells += [(n * rings, j, i), (n * rings + 1, n * (rings - 1) + i, n * (rings - 1) + j)]
        for k in range(0, n * (rings - 1), n):
            cells += [(k + i, k + j, k + n + j), (k + i, k + n + j, k + n + i)]
    return size * np.vstack([points, [[0, 0, -1.0]], [[0, 0, 1.0]]]), np.array(cells)


def _spoil(rng: Generator, points: Array, cells: Array) -> tuple[Array, Array]:
    """Change the geometry of a surface, not its file."""
    kind, row, axis = int(rng.integers(11)), int(rng.integers(len(cells))), int(rng.integers(3))
    points, cells = points.copy(), cells.copy()
    if kind == 0:
        points[int(rng.integers(len(points))), axis] = float(pick(rng, NUMBERS[:14]))
    elif kind == 1:
        cells[row] = cells[row, ::-1]
    elif kind == 2:
        cells = np.delete(cells, row, axis=0)
    elif kind == 3:
        cells = np.vstack([cells, cells[[row]]])
    elif kind == 4:
        cells[row, 0] = cells[row, 1]
    elif kind == 5:  # two bodies, apart, touching, or one through the other
        shift = pick(rng, (0.0, 0.5, 1.0, 3.0)) * np.ptp(points, axis=0) * rng.integers(0, 2, 3)
        cells, points = np.vstack([cells, cells + len(points)]), np.vstack([points, points + shift])
    elif kind == 6:
        points *= pick(rng, (1e-300, 1e-9, 1e-3, 3, 1e3, 1e12, 1e38, 1e200, 0, -1))
    elif kind == 7:
        points += rng.standard_normal(points.shape) * 10 ** rng.uniform(-9, 1)
    elif kind == 8:
        cells[row, axis] = int(rng.integers(len(points)))
    elif kind == 9:
        points[:, axis] *= pick(rng, (0, 1e-8, 1e-4, 1e6))
    else:
        points += pick(rng, (1e3, 1e8, 1e16))
    return points, cells


def _stl(points: Array, cells: Array, promised: int) -> bytes:
    """Bytes of a binary STL file."""
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows = np.zeros(len(cells), dtype=facet)
    rows["corners"] = points[cells]
    return b"binary".ljust(80) + np.uint32(promised).tobytes() + rows.tobytes()


def _file(rng: Generator, points: Array, cells: Array, suffix: str) -> bytes:
    """Bytes of a surface file; its header may promise something else."""
    wrong = pick(rng, (0, 1, 2**31, 2**32 - 1, len(cells) + 1))
    promised, binary = wrong if rng.random() < 0.1 else len(cells), rng.random() < 0.5
    if suffix == ".stl" and binary:
        return _stl(points, cells, promised)
    texts = [" ".join(repr(float(v)) for v in point) + "\n" for point in points]
    if suffix == ".stl":
        corners = ["".join(f"vertex {texts[v]}" for v in cell) for cell in cells]
        facets = [f"facet normal 0 0 0\nouter loop\n{one}endloop\nendfacet\n" for one in corners]
        return ("solid s\n" + "".join(facets) + "endsolid s\n").encode()
    if suffix == ".obj":
        faces = [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in cells]
        return ("".join(f"v {text}" for text in texts) + "".join(faces)).encode()
    head = f"ply\nformat {'binary_little_endian' if binary else 'ascii'} 1.0\n"
    head += (
        f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
    )
    head += f"element face {promised}\nproperty list uchar int vertex_indices\nend_header\n"
    if not binary:
        return (head + "".join([*texts, *(f"3 {a} {b} {c}\n" for a, b, c in cells)])).encode()
    rows = b"".join(b"\x03" + np.asarray(cell, "<i4").tobytes() for cell in cells)
    return head.encode() + points.astype("<f8").tobytes() + rows


def surfaces(rng: Generator, project: Path, place: Place) -> Made:
    """Write a surface, and plan a small design of it."""
    points, cells = _body(rng)
    suffix = str(pick(rng, (".stl", ".stl", ".ply", ".obj")))
    with np.errstate(all="ignore"):
        for _ in range(int(rng.choice([0, 1, 1, 1, 2, 3]))):
            points, cells = _spoil(rng, points, cells) if len(cells) else (points, cells)
        data = _file(rng, points, cells, suffix)
    for _ in range(int(rng.integers(1, 4)) if rng.random() < 0.3 else 0):
        data = damage(rng, data)
    end = pick(rng, (".STL", ".txt", ".obj", ".ply", "")) if rng.random() < 0.03 else suffix
    (project / f"body{end}").write_bytes(data)
    keys = (
        ("unit", ("mm",) * 80 + ("m", "in", "um", "kg", ""), 1.0),
        ("axis", ("z", "-z", "x", "-y", "w"), 0.2),
        ("clamp_below", ("1 mm", "0 mm", "-3 mm", "1e9 mm", "nan mm"), 0.1),
        ("press_x", ("1 mm", "-2 mm", "1e9 mm"), 0.1),
        ("plate_tolerance", ("1 mm", "0.1 mm", "0.1 mm", "0 mm", "1e9 mm"), 0.1),
    )  # fmt: skip
    more = "".join(f'{k} = "{pick(rng, v)}", ' for k, v, share in keys if rng.random() < share)
    text = f'specimen = {{ {more}shape = "surface", file = "body{end}" }}\n'
    text += f"test = {{ {pick(rng, TESTS)} }}\n{SURFACE}{MEASURED}range = ['0.1 mm', '0.6 mm']\n"
    (project / "design.toml").write_text(text)
    (project / "tests.csv").write_text(measurements())
    return [["plan", "design.toml", *(["--data", "."] if rng.random() < 0.7 else [])]], False


# Records and folders of a finished study


def _asked(rng: Generator, project: Path, place: Place) -> list[list[str]]:
    """Copy the finished study, and draw one or two verbs about it."""
    shutil.copytree(place.finished, project, dirs_exist_ok=True)
    case = pick(rng, sorted(path.name for path in (project / "results/small/cases").iterdir()))
    study = pick(rng, ("small", "small.toml", "results/small"))
    named = pick(rng, ([], ["--study", "small.toml", "--data", "data"], ["--study", study]))
    asked = (
        # a page is half a minute of a hundred examples: fewer of those that draw one
        (["status", study], 24), (["why", case[: int(rng.integers(4, 17))], *named], 24),
        (["plan", "small.toml", "--data", "data"], 24), (["analyze", study], 10),
        (["report", study, "--format", "csv"], 7), (["verify", "small"], 3),
        (["run", "small.toml", "--data", "data", "--jobs", "1"], 4),
        (["report", study, "--format", "html"], 1), (["diff", study, "../other/small"], 3),
    )  # fmt: skip
    share = np.array([weight for _, weight in asked])
    drawn = rng.choice(len(asked), int(rng.integers(1, 3)), p=share / share.sum())
    return [[*asked[k][0], *(["--json"] if rng.random() < 0.25 else [])] for k in drawn]


def _sealed(rng: Generator, content: Any) -> bytes:
    """Seal as the program does, but also what it never writes: NaN, another schema."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    checksum = hashlib.sha256(text.encode()).hexdigest()
    other = pick(rng, (0, 2, -1, '"1"', "null", "1.0", "true", 10**30))
    schema = other if rng.random() < 0.07 else 1
    return f'{{"schema":{schema},"checksum":"{checksum}","content":{text}}}\n'.encode()


def altered(rng: Generator, data: bytes) -> bytes:
    """Break a stored file, or make it whole and wrong."""
    kind, many = rng.random(), int(rng.integers(1, 4))
    if kind < 0.3:
        for _ in range(many):
            data = damage(rng, data)
        return data
    if kind < 0.33:
        deep = int(pick(rng, (100, 250, 1000, 100_000)))
        nested = b'{"schema":1,"checksum":"0","content":' + b"[" * deep + b"]" * deep + b"}"
        return bytes(100_000_000) if kind < 0.302 else nested
    whole = json.loads(data)
    if kind < 0.6:
        return _wrong(rng, whole["content"])
    donor = {"status": "failed", "message": "\ud800", "levels": {"material": 1}, "a": [None]}
    if kind < 0.63:  # the checksum is the old one
        mutate(rng, whole, donor)
        return json.dumps(whole).encode()
    for _ in range(many):
        mutate(rng, whole["content"], donor)
    return _sealed(rng, nasty(rng, donor) if kind > 0.97 else whole["content"])


def _wrong(rng: Generator, content: Any) -> bytes:
    """Damage one key of a stored file, or two, and seal it as the program does."""
    for _ in range(int(rng.choice([1, 1, 2]))):
        place = pick(rng, list(places(content)))
        change = without(content, place) if rng.random() < 0.3 else None
        content = (change or instead(content, place, pick(rng, WRONG))).content
    return sealed(content).encode()


#: raised where an earlier damage left no document that could be altered once more
UNALTERABLE = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
)  # fmt: skip


def records(rng: Generator, project: Path, place: Place) -> Made:
    """Alter one or two stored files of the finished study."""
    commands, folder = _asked(rng, project, place), project / "results" / "small"
    for _ in range(int(rng.choice([1, 1, 2]))):
        groups = ("cases/*/record.json", "cases/*/record.json", "fits/*", "*.json", "runs/*")
        paths = sorted(folder.glob(str(pick(rng, groups))))
        chosen = paths if rng.random() < 0.1 else [pick(rng, paths)]
        state = rng.bit_generator.state
        for path in chosen:  # the same change in all of them, as of another version
            rng.bit_generator.state = state
            with contextlib.suppress(*UNALTERABLE):
                path.write_bytes(altered(rng, path.read_bytes()))
    return commands, False


ODD = (
    "a b|\u00e9|\n|*|-rf|.hidden|record.json|study.json|\udcff|run-1.json|.record.json.1.part|"
    "record.json.corrupt-1|fields-0.npz|0123456789abcdef|run-x.json|unfinished.json|"
    "run-99999999999999999999.json|run-\u0663.json|run-\u00b2.json|" + "x" * 200
).split("|")
LOCKS = (b"", b"{}", b"[]", b'{"pid": 1}', b'{"pid": "x", "since": []}', b"\xff" * 600, b"[" * 5000)


def folders(rng: Generator, project: Path, place: Place) -> Made:
    """Delete, rename, replace, link, lock up or litter what lies in the finished study's folder."""
    commands, modest = _asked(rng, project, place), False
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        inside = sorted((project / "results").rglob("*"))
        inside += sorted((project / "reports").rglob("*")) if rng.random() < 0.2 else []
        # most files are of cases; the few others are as likely
        few = [path for path in inside if len(path.relative_to(project).parts) < 4]
        if inside:
            path = pick(rng, few if few and rng.random() < 0.5 else inside)
            modest |= _misplaced(rng, path, pick(rng, inside), project)
    stored = sorted(p for p in (project / "results").rglob("*.json") if _is_own(p))
    if rng.random() < 0.25 and stored:
        path = pick(rng, stored)
        with contextlib.suppress(*UNALTERABLE, OSError):
            path.write_bytes(_wrong(rng, json.loads(path.read_bytes())["content"]))
    return commands, modest


def _is_own(path: Path) -> bool:
    """Whether a file lies there itself: a link leads elsewhere or to itself, a pipe has no end."""
    with contextlib.suppress(OSError):
        return stat.S_ISREG(path.lstat().st_mode)
    return False


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _misplaced(rng: Generator, path: Path, other: Path, project: Path) -> bool:
    """Do one thing to a place; whether rights were taken away."""
    kind, was_folder = int(rng.choice(9, p=[0.124] * 8 + [0.008])), path.is_dir()
    folder, beside = path if was_folder else path.parent, project.parent / "other"
    if kind == 0:
        _remove(path)
    elif kind == 1:
        with contextlib.suppress(OSError):  # a folder does not take the name of a file
            path.rename(path.with_name(str(pick(rng, ODD)) + str(pick(rng, ("", "2")))))
    elif kind == 2:
        _remove(path)
        path.write_bytes(b"") if was_folder else path.mkdir()
    elif kind == 3:
        same = beside / "small" / Path(*path.relative_to(project).parts[2:])
        _remove(path)
        goals = (same, same, beside / "notes.txt", beside / "empty", beside / "no", path)
        path.symlink_to(pick(rng, goals))
    elif kind == 4:
        with contextlib.suppress(OSError):  # a link that an earlier round made leads nowhere
            path.chmod(int(pick(rng, (0o000, 0o444, 0o555, 0o200))))
        return True
    elif kind == 5:
        for number in range(int(rng.choice([1, 3, 2000], p=[0.5, 0.45, 0.05]))):
            stray = folder / f"{pick(rng, ODD)}{number or ''}"
            if not os.path.lexists(stray):
                stray.write_bytes(b"{}") if rng.random() < 0.7 else stray.mkdir()
    elif kind == 6:
        _remove(folder / ".lock")
        if rng.random() < 0.2:
            os.mkfifo(folder / ".lock")
        else:
            (folder / ".lock").write_bytes(pick(rng, LOCKS))
    elif kind == 7 and path not in (other, *other.parents) and other not in path.parents:
        _remove(path)
        other.rename(path)
    elif kind == 8:  # rare: a verb that reads without end costs as long as it may take
        _remove(path)
        os.mkfifo(path) if rng.random() < 0.5 else path.symlink_to("/dev/zero")
    return False


#: makers of examples
KINDS: dict[str, Callable[[Generator, Path, Place], Made]] = {
    "designs": designs,
    "tables": tables,
    "surfaces": surfaces,
    "records": records,
    "folders": folders,
}
