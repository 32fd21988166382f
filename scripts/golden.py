"""What the program answers, digit by digit: shows that a rebuilding changed nothing.

    python scripts/golden.py write FILE        before
    python scripts/golden.py compare FILE      after: 0 the same, 1 something differs, 2 bad input

Kept are forces and gradients of every energy under plates and indenters, the ids of all cases of
``designs/``, and of a small study the records, the ``--json`` of its verbs, the text of its report
and the data of its figures. Floats are kept in hexadecimal; solids under a cone repeat to 1e-9
only, because the parallel factorization does (``--rtol``). Left out are times, versions, paths
and whatever is a hash of the code. Everything is reached through the public verbs.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import math
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import study
from study import api
from study.design.cases import cases

ROOT = Path(__file__).resolve().parents[1]
#: keys that name a time, a version, a place or a hash of the code
VOLATILE = re.compile(
    "seconds|timings|total|key|checksum|versions|input_hash|source|path|folder|memory_MB|code|started|at"
)
MATERIALS = {
    "linear-elastic": 'youngs_modulus = "30 kPa"',
    "neo-hookean": 'C10 = "5 kPa"',
    "mooney-rivlin": 'C10 = "4 kPa"\nC01 = "1 kPa"',
    "reduced-polynomial": 'C10 = "5 kPa"\nC20 = "1 kPa"',
    "polynomial": 'C10 = "4 kPa"\nC01 = "1 kPa"\nC11 = "200 Pa"',
    "ogden": 'mu = ["6 kPa", "3 kPa"]\nalpha = [1.3, 5.0]',
}
TESTS = {
    "compression": 'kind = "compression"\ndisplacement = "2 mm"',
    "flat": 'kind = "indentation"\ndisplacement = "0.5 mm"\nindenter = { shape = "flat", '
    'radius = "3 mm", edge_radius = "1 mm" }',
    "cone": 'kind = "indentation"\ndisplacement = "0.5 mm"\nindenter = { shape = "cone", '
    'half_angle = "30 deg", tip_radius = "1 mm" }',
}
PROBLEM = """
schema = 1
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "10 mm"
[test]
{test}
interface = "{interface}"
steps = 3
[material]
model = "{energy}"
{constants}
poisson_ratio = 0.4995
[model]
space = "{space}"
mesh = "coarse"
"""


def forces() -> Iterator[tuple[str, Any]]:
    """Curve of every energy, test and interface; in 3D of one energy."""
    for energy, name, interface in itertools.product(MATERIALS, TESTS, ("frictionless", "bonded")):
        if energy == "linear-elastic" and name != "compression":
            continue
        for space in ("axisymmetric", "3d") if energy == "neo-hookean" else ("axisymmetric",):
            text = PROBLEM.format(
                test=TESTS[name],
                interface=interface,
                energy=energy,
                constants=MATERIALS[energy],
                space=space,
            )
            yield f"{energy} {name} {interface} {space}", _curve(text)


def _curve(text: str) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.toml"
        path.write_text(text)
        found = study.solve(path)
    curve = found.curve
    gradient = {name: value.tolist() for name, value in sorted(curve.force_gradient.items())}
    return [
        found.status,
        found.dofs,
        curve.force_N.tolist(),
        curve.stiffness_N_per_mm.tolist(),
        gradient,
    ]


def plans() -> Iterator[tuple[str, Any]]:
    """Ids of the cells of every design that ships."""
    for path in sorted((ROOT / "designs").glob("*.toml")):
        text = path.read_text(encoding="utf-8")
        if "[factors]" in text:
            yield path.stem, _cells(path)


def _cells(path: Path) -> Any:
    return [
        [case.case_id, dict(case.levels)] for case in cases(study.load_design(path), ["a", "b"])
    ]


def a_study() -> Iterator[tuple[str, Any]]:
    """Run a small study: its records, document, words of the report, data of the figures."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        design = ROOT / "designs" / "noise.toml"
        api.virtual(Path("measurements"), design)
        found = study.run(design, data="measurements", jobs=1)
        yield "study", _still(found.to_json())
        for record in sorted(found.records, key=lambda r: r.case_id):
            yield f"record {record.case_id}", _still(json.loads(record.to_json()))
        for path in sorted(Path("reports").rglob("*.csv")):
            yield f"data {path.name}", _columns(path)
        for path in sorted(Path("reports").rglob("*.html")):
            yield f"page {path.name}", _words(path.read_text(encoding="utf-8"))


def _columns(path: Path) -> Any:
    """Columns of a CSV by their names, without times, versions and hashes."""
    with path.open(newline="", encoding="utf-8") as lines:
        header, *rows = csv.reader(lines)
    changing = re.compile("seconds|version|memory|hash|time|^study$|traceback")
    return {
        name: [row[number] for row in rows]
        for number, name in enumerate(header)
        if not changing.search(name)
    }


def _words(page: str) -> list[str]:
    """Words of a page without drawings, styles and numbers."""
    plain = re.sub(r"(?s)<(svg|style|script|pre)\b.*?</\1>", " ", page)
    words = re.sub(r"<[^>]+>|\s+", " ", plain).split()
    # figures are compared in the data beside the page; times stand among them here
    return [word for word in words if not re.search(r"\d", word)]


def _still(value: Any) -> Any:
    """Leave out what changes from run to run; floats in hexadecimal."""
    if isinstance(value, dict):
        return {k: _still(v) for k, v in value.items() if not VOLATILE.fullmatch(str(k))}
    if isinstance(value, (list, tuple)):
        return [_still(v) for v in value]
    return value.hex() if isinstance(value, float) else value


def golden() -> dict[str, Any]:
    """Everything that must stay."""
    parts = {"forces": forces, "plans": plans, "study": a_study}
    return {
        f"{part}: {name}": _still(value) for part, make in parts.items() for name, value in make()
    }


def differences(old: Any, new: Any, where: str, rtol: float) -> Iterator[str]:
    """Places where two values differ, each with both."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}", rtol)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, f"{where}[{number}]", rtol)
    elif old != new and not _near(old, new, rtol):
        yield f"{where}: {str(old)[:60]} -> {str(new)[:60]}"


def _near(old: Any, new: Any, rtol: float) -> bool:
    try:
        first, second = float.fromhex(old), float.fromhex(new)
    except (TypeError, ValueError):
        return False
    return math.isclose(first, second, rel_tol=rtol, abs_tol=0.0)


def main(arguments: list[str] | None = None) -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("write", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--rtol", type=float, default=0.0, help="relative tolerance of floats")
    asked = parser.parse_args(arguments)
    if asked.what == "compare" and not asked.file.is_file():
        print(f"there is no file {asked.file}: write one first", file=sys.stderr)
        return 2
    found = golden()
    if asked.what == "write":
        asked.file.write_text(json.dumps(found, indent=0, sort_keys=True))
        print(f"{len(found)} answers written to {asked.file}")
        return 0
    kept = json.loads(asked.file.read_text())
    told = list(differences(kept, json.loads(json.dumps(found)), "", asked.rtol))
    for line in told[:40]:
        print(line.lstrip("."))
    print(f"{len(kept)} answers compared, {len(told)} differences")
    return 1 if told else 0


if __name__ == "__main__":
    sys.exit(main())
