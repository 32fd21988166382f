"""Faulty study files as data: sound files, changes of every key, and what the reader says of each.

``faulty_files/*.toml`` are the sound files, ``faulty_files/faults.jsonl`` holds one change a line
with the faults found. After a deliberate change of a rule, ``python -m tests.design.faulty``
writes the lines anew; their difference is then part of what is reviewed.
"""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from study.ground.errors import InputError
from study.harness.design.diagnostics import dump_toml, parse_toml
from study.harness.design.load import loads, loads_calibration, loads_problem

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
    "calibration": loads_calibration,
}
#: a key left out; TOML has no such value
ABSENT = None
TABLE_VALUES = ("text", [], 1)
LIST_VALUES = ([], "text", [1], {})
NUMBER_VALUES = ("0.5", -1, 1.5, float("nan"), True)
INTEGER_VALUES = (2.5, -1, "3", 10**9)
TEXT_VALUES = ("", 3, "=1+1", ["text"])
#: of a key that another table of the file has had in full
REPEATED_VALUES = (True, [])
#: changes of several keys, each pair of which cannot stand together
CONFLICTS: dict[str, tuple[dict[str, Any], ...]] = {
    "markers": (
        {"test.kind": "compression"},
        {"test.kind": "compression", "markers": ABSENT},
        {"specimen": {"shape": "cylinder", "radius": "20 mm", "height": "40 mm"}},
        {"model.space": "axisymmetric"},
        {"markers.layer": ABSENT},
        {"markers.fit": ABSENT, "markers.layer": ABSENT},
        {"test.displacement": "2 mm"},
        {"material.C10": ABSENT},
        {"markers": ABSENT, "test.displacement": "3 mm"},
        {"test.motion.tilt_x": "6 deg"},
    ),
    "problem": (
        {"material.poisson_ratio": 0.4},
        {"material.incompressible": True},
        {"material.bulk_modulus": ABSENT},
        {"material.bulk_modulus": ABSENT, "material.poisson_ratio": 0.5},
        {
            "material.bulk_modulus": ABSENT,
            "material.incompressible": True,
            "model.formulation": "displacement",
        },
        {"material.bulk_modulus": "1 kPa"},
        {"material.C30": "1 kPa"},
        {"material.C01": "1 kPa"},
        {"material.order": 3},
        {"material.C20": ABSENT},
        {"material.C10": ABSENT, "material.C20": ABSENT},
        {"material.model": "mooney-rivlin"},
        {"material.model": "polynomial"},
        {"material.model": "ogden"},
        {"material.model": "linear-elastic"},
        {"model.mesh": "fine"},
        {"test.displacement": "30 mm"},
        {"test.kind": "compression", "test.displacement": "25 mm", "material.C20": "-3 kPa"},
        {"test.indenter.tip_radius": "9 mm"},
        {"test.indenter.half_angle": "85 deg", "test.indenter.shaft_radius": ABSENT},
        {"test.indenter.shape": "flat"},
        {"test.indenter.shape": "sphere"},
        {"specimen.shape": "block"},
        {"specimen.shape": "surface"},
        {"measurements": {}},
        {"factors": {}},
        {"schema": 2},
        {"schema": True},
        {"specimen.radius": 25, "material.C10": "5 mm", "model.space": "2d", "colour": 1},
    ),
    "block": (
        {"material.alpha": [0, 5.0]},
        {"material.alpha": [1.3]},
        {"material.alpha": [31, 5.0]},
        {"material.alpha": ABSENT},
        {"material.mu": ABSENT},
        {"material.mu": ["6 kPa", "-8 kPa"]},
        {"material.mu": [6, "3 mm"]},
        {"material.order": 3},
        {"material.C10": "1 kPa"},
        {"test.indenter.radius": "25 mm"},
        {"test.indenter.edge_radius": "9 mm"},
        {"test.indenter": ABSENT},
        {"model.space": "axisymmetric"},
    ),
    "surface": (
        {"model.space": "axisymmetric"},
        {"model.element_shape": "hexahedron"},
        {"specimen.file": "/etc/organ.stl"},
        {"specimen.file": "../organ.stl"},
        {"specimen.unit": "kg"},
        {"specimen.axis": "+z"},
        {"material.incompressible": False},
    ),
    "design": (
        {"factors.model.space": ["3d"]},
        {"factors.model.space": ["3d", "3d"]},
        {"factors.model.space": ["3d", "4d"]},
        {"factors.model.spce": ["3d", "axisymmetric"]},
        {"factors.test.interface": ["bonded", "frictionless"]},
        {"factors.model.space": {"low": 1, "high": 2}},
        {"factors.specimen.height": {"low": "20 mm"}},
        {"factors.specimen.height": {"low": "30 mm", "high": "20 mm"}},
        {"factors.specimen.height": {"low": "3 cm", "high": "40 mm"}},
        {"factors.specimen.height": {"low": 3, "high": "40 mm"}},
        {"factors": ABSENT},
        {"factors": {}},
        {"presets.material.yeoh.mdoel": "ogden"},
        {"presets.plates.bonded.test.interface": "glued"},
        {"presets.plates.bonded.test.displacement": "31 mm"},
        {"presets.material.neo-hookean.order": 2},
        {"test.displacement": "7 mm"},
        {"measurements": ABSENT},
        {"measurements.files": "plates-{phantom}.csv"},
        {"measurements.file": ABSENT},
        {"measurements.score": ABSENT},
        {"measurements.fit": ABSENT},
        {"measurements.fit": ABSENT, "measurements.score": ABSENT},
        {"measurements.range": ["20 %", "1 %"]},
        {"measurements.range": ["1 %", "100 %"]},
        {"measurements.range": ["1 %", "20 mm"]},
        {"measurements.range": ["1", "20"]},
        {"calibration.method": "analytic"},
        {"calibration.method": "none"},
        {"calibration.method": "analytic", "calibration.problem.test.interface": "bonded"},
        {"calibration.problem.tests": {}},
        {"calibration.problem.measurements.block": "phantom"},
        {"calibration.problem.measurements.range": ["0.1 mm", "12 mm"]},
        {"response": ABSENT},
        {"response": []},
        {"response": [{"name": "C10"}, {"name": "C10"}]},
        {"response": [{"name": "C11"}]},
        {"response": [{"name": "work_error", "practical": "1 N"}]},
        {"response": [{"name": "peak_force_error", "practical": "1 pp"}]},
        {"response": [{"name": "mu0", "practical": 5}]},
        {"analysis.model": ["material:plate"]},
        {"analysis.model": ["material:material"]},
        {"analysis.model": 4},
        {"exclude": [{"when": {"material": "yeoh"}, "why": "all"}]},
        {"exclude": [{"when": {"plate": "bonded"}, "why": "x"}]},
        {"exclude": [{"when": {"plates": "glued"}, "why": "x"}]},
        {"exclude": [{"when": {}, "why": "x"}]},
        {"exclude": [{"when": {"plates": "bonded"}}]},
        {"replicates": {}},
        {"replicates": {"mesh_seeds": 5, "noise": 200}},
        {"replicates": {"mesh_seeds": 4}},
        {"replicates": {"noise": 19}},
        {"execution": {"retry": {"not-converged": ["smaler-steps"]}}},
        {"execution": {"retry": {"timeout": ["smaller-steps"]}}},
        {"execution": {"retry": {"tired": ["longer-limit"]}}},
        {"execution": {"retry": "finer-mesh"}},
        {"execution": {"retries": {}}},
        {"expected": [{"larger": "material", "than": "plate"}]},
        {"expected": [{"matters": "material", "best": {"material": "yeoh"}}]},
        {"expected": [{"source": "x"}]},
        {"uncertainty": {"specimen.hieght": "1 mm"}},
        {"study.assumed": ["specimen.hieght"]},
    ),
    "fraction": (
        {"design.generators": ["model.element_order = specimen.radius:specimen.radius"]},
        {"design.generators": ["model.element_order = colour:specimen.radius"]},
        {"design.generators": ABSENT, "design.resolution": 9},
        {"design.generators": ABSENT},
        {"design.resolution": 4},
        {"design.kind": "box-behnken", "design.generators": ABSENT},
        {"design.kind": "central-composite", "design.generators": ABSENT},
        {"design.kind": "plackett-burman"},
        {"exclude": [{"when": {"model.element_order": "linear"}, "why": "x"}]},
        {"replicates": ABSENT},
        {"replicates": {"noise": 200}},
        {"test.interface": "frictionless"},
    ),
    "sample": (
        {"design.kind": "sobol"},
        {"design.kind": "sobol", "design.runs": 6},
        {"design.kind": "full"},
        {"design.kind": "listed"},
        {"design.runs": 1},
        {"design.star": "faced"},
    ),
    "adaptive": (
        {"uncertainty.specimen.radius.sd": ABSENT},
        {"uncertainty.specimen.radius.sd": "9 mm"},
        {"uncertainty.specimen.radius.distribution": "gamma"},
        {"uncertainty.test.interface": "1 mm"},
        {"uncertainty.specimen.height": {"distribution": "uniform"}},
        {
            "uncertainty.test.displacement": {
                "distribution": "uniform",
                "low": "5 mm",
                "high": "4 mm",
            }
        },
        {"factors.specimen.radius.scale": "cubic"},
        {"factors.specimen.radius.low": "-1 mm"},
        {"design.start": 5},
        {"design.start": 7},
        {"design.budget": 8},
        {"design.added": [[0.5]]},
        {"design.added": [[0.25, 0.25, 2]]},
        {"design.until": "verdict"},
        {"analysis": {"surface": "quadratic"}},
    ),
    "nested": (
        {"design.zip": [["specimen.height", "model.mesh_size"]]},
        {"design.zip": [["specimen.height", "model.mesh"]]},
        {"design.zip": [["specimen.height"]]},
        {"design.nested.0.within": "model.mesh_size"},
        {"design.nested.0.levels.3d": ["1 mm"]},
        {"design.nested.0.levels.3d": ABSENT},
    ),
    "calibration": (
        {"tests": ABSENT},
        {"tests": []},
        {"tests.0.role": "held-out"},
        {"tests.0.weight": -1},
        {"tests.0.measurements.range": ABSENT},
        {"calibration.bounds.C30": ["1 kPa", "2 kPa"]},
        {"calibration.bounds.C10": ["2 kPa", "1 kPa"]},
        {"calibration.bounds.C10": [1, 2]},
        {"tests.1.test.displacement": "40 mm"},
        {"factors": {"model.space": ["3d", "axisymmetric"]}},
    ),
}


class Faulty(NamedTuple):
    """A change of a sound file and the faults that it causes: where, rule, mend."""

    base: str
    change: dict[str, Any]
    faults: list[list[str]]

    @property
    def table(self) -> str:
        """Table of the file that is changed."""
        return next(iter(self.change)).partition(".")[0]


def stored() -> list[Faulty]:
    """Every change with its faults, as kept."""
    lines = (FOLDER / "faults.jsonl").read_text(encoding="utf-8").splitlines()
    return [Faulty(**json.loads(line)) for line in lines]


def faults_of(base: str, change: dict[str, Any]) -> list[list[str]]:
    """Faults that today's reader finds in a changed file."""
    tables = copy.deepcopy(_tables(base))
    for key, value in change.items():
        _set(tables, key.split("."), value)
    try:
        LOADERS[base](dump_toml(tables), "x.toml")
    except InputError as error:
        found = [(f.where.removeprefix("x.toml: "), f.rule, f.mend) for f in error.faults]
        return sorted([where, rule, _shortened(mend)] for where, rule, mend in found)
    return []


def _shortened(mend: str) -> str:
    """Mend without the list of all valid names, which grows with every new key."""
    return re.sub(r"Valid: .*", "Valid:", mend, flags=re.DOTALL)


def _tables(base: str) -> dict[str, Any]:
    return parse_toml((FOLDER / f"{base}.toml").read_text(encoding="utf-8"), base)


def _set(node: Any, path: list[str], value: Any) -> None:
    for part in path[:-1]:
        node = node[int(part)] if isinstance(node, list) else node.setdefault(part, {})
    if value is ABSENT:
        del node[path[-1]]
    else:
        node[path[-1]] = value


def changes(base: str, met: set[str]) -> Iterator[dict[str, Any]]:
    """Every key left out, misspelt and with wrong values, then the conflicts."""
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
    yield from CONFLICTS[base]


def misspelt(key: str) -> str:
    """Key with two letters exchanged, or one more."""
    return key[0] + key[2] + key[1] + key[3:] if len(key) > 3 and key[1] != key[2] else f"{key}x"


def _keys(node: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        key = f"{prefix}{name}"
        yield key, value
        if isinstance(value, dict):
            yield from _keys(value, f"{key}.")
        elif isinstance(value, list) and isinstance(value[0], dict):
            for i, row in enumerate(value):
                yield from _keys(row, f"{key}.{i}.")


def _wrong(value: Any) -> tuple[Any, ...]:
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


def _wrong_quantity(text: str) -> tuple[Any, ...]:
    """Texts near to a number with a unit; none where the text is something else."""
    match = re.fullmatch(r"(-?[\d.]+) (\S+)", text)
    if match is None:
        return ()
    number, unit = match.groups()
    other = "kPa" if unit in ("mm", "deg", "%") else "mm"
    texts = (number, f"-{number} {unit}", f"{number} {other}", f"{number} {unit}x", f"nan {unit}")
    return (float(number), *texts)


def found_now() -> Iterator[Faulty]:
    """Every change of every sound file, with the faults that today's reader finds."""
    met: set[str] = set()
    for base in LOADERS:
        for change in changes(base, met):
            yield Faulty(base, change, faults_of(base, change))


if __name__ == "__main__":
    rows = [json.dumps(one._asdict(), ensure_ascii=False) for one in found_now()]
    (FOLDER / "faults.jsonl").write_text("\n".join(rows) + "\n", encoding="utf-8")
    print(len(rows), "changes written")
