"""What the program answers, digit by digit: shows that a rebuilding changed nothing.

    python scripts/golden.py write FILE        before
    python scripts/golden.py compare FILE      after: 0 the same, 1 something differs, 2 bad input
    python scripts/golden.py write FILE --part tables,faults      some parts alone

Parts: ``forces`` (force and its gradients of every energy, test and interface), ``energies``
(closed forms of every energy on a gauge section), ``designs`` (case ids of ``designs/``),
``faults`` (place and rule of every fault of ``tests/design/faulty_files``), ``tables`` (analysis
of every table of ``validation/statistics``), ``help`` (of all verbs), ``studies`` (``--json`` and
text of all verbs on a results folder that is made first; the records in it; text of every page;
every CSV, JSON and exported file of the reports).

Nothing of the package is imported but ``study``: the answers are those of the command line and of
files, so that no move of a module changes this script. Case ids and faults come from two modules
of tests, ``tests.design.test_case_ids`` and ``tests.design.faulty``, which move with the package.

Floats are kept in hexadecimal. Two runs of one commit in one folder are equal, on one machine with
one thread. What may differ otherwise:

- between machines, and between two compilations of the kernels (another processor, numba or
  LLVM; kernels from a cache of another version): the last digits of forces, gradients, fits and of
  whatever follows from them. Compare with ``--rtol 1e-9``; numbers inside texts are compared as
  texts, hence differ where rounding does.
- with more than one thread of BLAS, MKL or numba, which the script therefore sets to one: forces
  repeat to their last digits only, solids under a cone to 1e-9.

Left out are times and what follows from them (the front of accuracy against seconds, the cell that
is recommended because it is faster, the count of numbers on a page), memory, versions, dates,
hashes of the code and of files; folders and the repository are written as ``<folder>`` and
``<root>``.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import gzip
import importlib
import io
import itertools
import json
import math
import os
import re
import runpy
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import study

ROOT = Path(__file__).resolve().parents[1]
TABLES = ROOT / "validation" / "statistics"
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
#: keys that name a time, a version or a hash of the code
VOLATILE = re.compile(
    r".*seconds.*|.*_s|timings|.*checksum|versions?|input_hash|key|memory.*|.*_MB|code|started"
    r"|numbers_total|page|made_from|files|arithmetic|.*time(stamp)?|at|date|pid|host|.*hash|.*digest|rate|machine"
)
#: columns of the same kind
VOLATILE_COLUMN = re.compile("seconds|version|memory|hash|time$|^time|traceback")
#: texts of the same kind, and what stands for them
VOLATILE_TEXT = (
    (re.compile(r"\b\d{4}-\d\d-\d\d([ T]\d\d:\d\d(:\d\d(\.\d+)?)?)?(Z|\+\d\d:?\d\d)?"), "<date>"),
    (re.compile(r"\b\d{1,2}:\d\d(:\d\d)?\b"), "<clock>"),
    (
        re.compile(r"\b\d[\d.,]*(e-?\d+)?[\s~]?(ms|s|min|h|seconds?|minutes?|hours?|[kMG]B)\b"),
        "<time>",
    ),
    (re.compile(r"(?<= )\d\.\d{4} (\d\.\d{4}|-) \d+$"), "<seconds>"),
    # which cell is the cheapest, and how many numbers a page has that says so
    (
        re.compile(r"Use [^.]*\. ?\d*[^.]* in <time> a case.*|.*numbers computed again.*"),
        "<cheapest>",
    ),
    (re.compile(r"\b\d+\.\d+\.\d+(\.\d+)*\+[0-9a-f]{7,}(\.\w+)?"), "<version>"),
    (re.compile(r"\b[0-9a-f]{64}\b|\b[0-9a-f]{40}\b"), "<hash>"),
    # what is recommended where accuracy is equal depends on measured times
    (re.compile(r"^Use .* in <time> a case\..*$", re.MULTILINE), "<choice by time>"),
    (re.compile(r"\b\d+ numbers computed again.*"), "<count with times>"),
)

MATERIALS = {
    "linear-elastic": 'youngs_modulus = "30 kPa"',
    "neo-hookean": 'C10 = "5 kPa"',
    "mooney-rivlin": 'C10 = "4 kPa"\nC01 = "1 kPa"',
    "reduced-polynomial": 'C10 = "5 kPa"\nC20 = "1 kPa"',
    "polynomial": 'C10 = "4 kPa"\nC01 = "1 kPa"\nC11 = "200 Pa"',
    "ogden": 'mu = ["6 kPa", "3 kPa"]\nalpha = [1.3, 5.0]',
    "yeoh": 'C10 = "5 kPa"\nC20 = "1 kPa"\nC30 = "100 Pa"',
    "arruda-boyce": 'mu = "10 kPa"\nlambda_m = 3.0',
    "gent": 'mu = "10 kPa"\nJm = 20.0',
    "extended-tube": 'Gc = "5 kPa"\nGe = "5 kPa"\nbeta = 0.6\ndelta = 0.1',
    "van-der-waals": 'mu = "10 kPa"\nlambda_m = 6.0\na = 0.3\nbeta = 0.2',
    "veronda-westmann": 'C1 = "5 kPa"\nC2 = 2.0',
    "fung": 'mu = "10 kPa"\nb = 1.5',
    "ogden-hill": 'mu = ["6 kPa", "3 kPa"]\nalpha = [2.0, 5.0]',
}
#: energies that finite elements do not have
WITHOUT_ELEMENTS = {"ogden-hill"}
#: energies that are solved in 3D and under an indenter besides
THOROUGH = {"neo-hookean", "ogden", "gent"}
TESTS = {
    "compression": 'kind = "compression"\ndisplacement = "2 mm"',
    "flat": 'kind = "indentation"\ndisplacement = "0.5 mm"\nindenter = { shape = "flat", '
    'radius = "3 mm", edge_radius = "1 mm" }',
    "cone": 'kind = "indentation"\ndisplacement = "0.5 mm"\nindenter = { shape = "cone", '
    'half_angle = "30 deg", tip_radius = "1 mm" }',
    "sphere": 'kind = "indentation"\ndisplacement = "0.5 mm"\nindenter = { shape = "sphere", '
    'radius = "4 mm" }',
}
GAUGE_TESTS = {
    "tension": "10 mm",
    "compression": "8 mm",
    "equibiaxial": "6 mm",
    "planar": "10 mm",
    "simple-shear": "12 mm",
    "volumetric": "0.5 mm",
    "confined-compression": "0.5 mm",
}
PROBLEM = """
schema = 1
[specimen]
{specimen}
[test]
{test}
steps = 3
[material]
model = "{energy}"
{constants}
poisson_ratio = {poisson_ratio}
{model}
"""
CYLINDER = 'shape = "cylinder"\nradius = "10 mm"\nheight = "10 mm"'
GAUGE = 'shape = "homogeneous"\narea = "20 mm^2"\nlength = "25 mm"'
#: flags of ``study analyze`` for every table; several analyses of one table
ANALYSES: dict[str, tuple[str, ...]] = {
    "battery_life": (
        "--response life --factors material,temperature --practical 10",
        "--response life --factors material,temperature --transform log --reference material=1",
        "--response life --factors material,temperature --contrast 'material=1 - material=3'",
        "--response life --factors material --numeric temperature",
    ),
    "blocked": (
        "--response y --factors a,b --block s",
        "--response y --factors a,b --block s --error pooled",
        "--response y --factors a,b --block s --error own",
        "--response y --factors a,b --block s --error reml",
    ),
    "chemical_process": ("--response yield --numeric time_min,temperature_F --surface quadratic",),
    "crossed": (
        "--response y --factors a,b,c --type I",
        "--response y --factors a,b,c --type II --alpha 0.01",
        "--response y --factors a,b,c --type III",
        "--response y --factors a,b,c --model a,b,c,a:b",
    ),
    "etch_rate": ("--response etch_rate --factors power --practical '5 % of mean'",),
    "fraction": (
        "--response y --factors A,B,C,D --model A,B,C,D,A:B,A:C,B:C",
        "--response y --factors A,B,C,D",
    ),
    "incomplete": (
        "--response y --factors t --block k",
        "--response y --factors t --block k --error reml",
    ),
    "latin": ("--response y --factors t --block r,c",),
    "nested": (
        "--response y --factors mix --unit specimen",
        "--response y --factors mix,specimen --model mix,mix:specimen --type I",
    ),
    "paper_helicopter": (
        "--response flight_time_cs --surface quadratic "
        "--numeric wing_area_in2,wing_ratio,body_width_in,body_length_in",
        "--response flight_time_cs --surface emulator --numeric wing_area_in2,wing_ratio",
    ),
    "paper_strength": (
        "--response strength --factors method,temperature --block replicate --whole-plot method",
    ),
    "penicillin": (
        "--response yield --factors treatment --block blend --error pooled",
        "--response yield --factors treatment --block blend",
    ),
    "repeated": (
        "--response y --factors a,b --block s",
        "--response y --factors a,b --block s --error reml --random a",
    ),
    "splitblocks": ("--response y --factors v,n --block k --whole-plot v",),
    "splitplot": ("--response y --factors mix,speed --block specimen --whole-plot mix",),
}
#: tables that are no data but figures of another program
REFERENCES = {"reference_r", "reference_packages", "r_datasets"}
#: an incompressible cylinder between frictionless plates, whose size and constant have ranges
RANGES = """
schema = 1
[study]
name = "ranges"
assumed = ["material"]
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "20 mm"
[test]
kind = "compression"
interface = "frictionless"
displacement = "3 mm"
steps = 2
[material]
model = "neo-hookean"
C10 = "5 kPa"
incompressible = true
[model]
mesh_size = "10 mm"
[factors]
material.C10 = { low = "5 kPa", high = "10 kPa" }
specimen.radius = { low = "9 mm", high = "11 mm" }
[design]
kind = "latin-hypercube"
runs = 14
[analysis]
surface = "quadratic"
[[response]]
name = "peak_force"
practical = "0.05 N"
"""
#: energies and ranges of strain on specimens of three mixes, with a second study of one energy less
BLOCKS = """
schema = 1
[study]
name = "{name}"
question = "Does the energy or the range matter?"
seed = 2011
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
interface = "frictionless"
[material]
incompressible = true
[presets.material.neo-hookean]
model = "neo-hookean"
[presets.material.mooney-rivlin]
model = "mooney-rivlin"
[presets.material.yeoh]
model = "yeoh"
[presets.range.small]
measurements.range = ["1 %", "10 %"]
[presets.range.large]
measurements.range = ["1 %", "20 %"]
[measurements]
file = "blocks.csv"
columns = {{ displacement = "d_mm", force = "f_N" }}
units = {{ displacement = "mm", force = "N" }}
block = "mix"
average = ["repeat"]
points = 30
fit = {{ specimen = "A" }}
score = {{ specimen = "B" }}
[calibration]
method = "analytic"
[factors]
material = [{levels}]
range = ["small", "large"]
[[response]]
name = "relative_rms_force_error"
practical = "0.5 pp"
[[response]]
name = "mu0"
practical = "5 % of mean"
[report]
format = ["html", "csv", "tex"]
"""
#: elements whose numerical uncertainty is bounded by refinement
ELEMENTS = """
schema = 1
[study]
name = "elements"
question = "Do the interface and the element matter?"
assumed = ["specimen", "material"]
[specimen]
shape = "cylinder"
radius = "10 mm"
height = "10 mm"
[test]
kind = "compression"
displacement = "1 mm"
steps = 2
[material]
model = "neo-hookean"
C10 = "5 kPa"
poisson_ratio = 0.49
[model]
mesh_size = "4 mm"
[factors]
test.interface = ["frictionless", "bonded"]
model.element_order = ["linear", "quadratic"]
[[response]]
name = "peak_force"
practical = "1 % of mean"
"""
CALIBRATION = """
schema = 1
[study]
name = "calibration"
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[material]
model = "mooney-rivlin"
incompressible = true
[model]
space = "axisymmetric"
[[tests]]
weight = "equal"
test = { kind = "compression", interface = "frictionless" }
[tests.measurements]
file = "one.csv"
columns = { displacement = "d_mm", force = "f_N" }
units = { displacement = "mm", force = "N" }
average = ["repeat"]
range = ["1 %", "20 %"]
"""
#: (name, command); a name with + is run without --json as well, one with ! has no --json
COMMANDS = (
    ("new!", "new design.toml"),
    ("new calibration!", "new mine.toml --calibration"),
    ("virtual noise!", "virtual measurements --from {designs}/noise.toml"),
    ("virtual tracker!", "virtual measurements --from {designs}/tracker.toml"),
    ("virtual demo!", "virtual measurements --from {designs}/demo.toml --specimens 2"),
    (
        "plan noise+",
        "plan {designs}/noise.toml --data measurements -s replicates.noise=20",
    ),
    ("plan blocks+", "plan blocks.toml --data ."),
    ("plan elements", "plan elements.toml --run-sheet sheet.csv --specimens 3"),
    ("power+", "power blocks.toml --data . --sd 0.5"),
    (
        "run noise",
        "run {designs}/noise.toml --data measurements --jobs 1 -s replicates.noise=20",
    ),
    ("run blocks", "run blocks.toml --data . --jobs 1"),
    ("run fewer", "run fewer.toml --data . --jobs 1"),
    ("run ranges", "run ranges.toml --jobs 1"),
    ("run elements", "run elements.toml --jobs 1"),
    ("status+", "status blocks"),
    ("report blocks+", "report blocks"),
    ("report noise", "report noise"),
    ("report fewer", "report fewer --beside blocks"),
    ("verify+", "verify blocks"),
    ("diff+", "diff blocks fewer"),
    ("why+", "why {case} --study blocks"),
    ("analyze blocks+", "analyze results/blocks"),
    ("analyze page", "analyze {tables}/battery_life.csv {battery} --report reports/battery"),
    ("analyze split plot", "analyze {tables}/paper_strength.csv {split} --report reports/split"),
    ("analyze surface", "analyze {tables}/chemical_process.csv {surface} --report reports/surface"),
    ("predict+", "predict ranges --at '{centre}'"),
    ("optimize", "optimize ranges --minimize peak_force --at 'material.C10=7 kPa' --no-confirm"),
    (
        "optimize table+",
        "optimize {tables}/chemical_process.csv --numeric time_min,temperature_F --maximize yield",
    ),
    ("invert", "invert ranges --to measured.csv --at 'specimen.radius=10.2 mm'"),
    ("export emulator", "export ranges --as emulator"),
    ("export force law", "export problem.toml --as force-law --tolerance 0.02"),
    ("export abaqus", "export {designs}/flat-needle.toml --as abaqus"),
    ("export febio", "export {designs}/flat-needle.toml --as febio"),
    ("solve+", "solve problem.toml"),
    ("calibrate+", "calibrate calibration.toml --data ."),
    ("calibrate profile", "calibrate calibration.toml --data . --profile --bootstrap 200"),
    ("calibrate energies", "calibrate calibration.toml --data . --energies"),
    ("calibrate mine", "calibrate mine.toml --convention febio"),
    ("converge values+", "converge --values 1.01,1.0225,1.050625,1.1139 --sizes 1,1.5,2.25,3.375"),
    ("converge order 2", "converge --values 1.01,1.034,1.11 --sizes 1,1.5,2.25 --formal-order 2"),
    ("converge problem", "converge problem.toml"),
    ("converge elements", "converge results/elements"),
    ("tracking+", "tracking {designs}/tracker.toml --data measurements"),
    (
        "require+",
        "require {designs}/sensors.toml --jobs 1 -s requirement.samples=20 -s model.mesh=coarse",
    ),
    ("shape+", "shape problem.toml --scan scan.csv"),
    ("refused design", "run {designs}/solver-as-factor.toml --data measurements --jobs 1"),
    ("refused file", "plan {designs}/one-material.toml"),
)


def command(line: str) -> tuple[int, str, str]:
    """Exit code, output and messages of ``study LINE``, run in this process."""
    out, err = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["study", *shlex.split(line)]
    code: Any = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            runpy.run_module("study", run_name="__main__")
    except SystemExit as end:
        code = end.code or 0
    except Exception as error:  # an internal error is an answer, too
        code = 99
        print(type(error).__name__, error, file=err)
    finally:
        sys.argv = before
    return int(code), out.getvalue(), err.getvalue()


def answer(line: str, folder: Path) -> Any:
    """Code and document of a command with ``--json``; its messages where it has no document."""
    code, out, err = command(f"{line} --json")
    if not out:
        return [code, *plain(err, folder)]
    return [code, still(json.loads(out), folder)]


def text_of(line: str, folder: Path) -> Any:
    """Code and lines of a command."""
    code, out, err = command(line)
    return [code, *plain(out if out else err, folder)]


def plain(text: str, folder: Path) -> list[str]:
    """Lines of a text without times, versions and places."""
    text = text.replace(str(folder), "<folder>").replace(str(ROOT), "<root>")
    for pattern, name in VOLATILE_TEXT:
        text = pattern.sub(name, text)
    return [re.sub(r"[ \t]+", " ", line).strip() for line in text.splitlines() if line.strip()]


def still(value: Any, folder: Path) -> Any:
    """Leave out what changes from run to run; floats in hexadecimal."""
    if isinstance(value, dict):
        return {
            str(key): still(item, folder)
            for key, item in value.items()
            if not VOLATILE.fullmatch(str(key))
        }
    if isinstance(value, (list, tuple)):
        return [still(item, folder) for item in value]
    if isinstance(value, str):
        return "\n".join(plain(value, folder))
    return value.hex() if isinstance(value, float) else value


def forces(folder: Path) -> Iterator[tuple[str, Any]]:
    """Curve of every energy, test and interface; of a few under indenters and in 3D."""
    for energy, test, interface in itertools.product(MATERIALS, TESTS, ("frictionless", "bonded")):
        indented = test != "compression"
        if energy in WITHOUT_ELEMENTS or (indented and energy == "linear-elastic"):
            continue
        if indented and energy not in THOROUGH and (interface, test) != ("frictionless", "flat"):
            continue
        for space in ("axisymmetric", "3d") if energy == "neo-hookean" else ("axisymmetric",):
            if space == "3d" and test == "sphere":
                continue
            problem = PROBLEM.format(
                specimen=CYLINDER,
                test=f'{TESTS[test]}\ninterface = "{interface}"',
                energy=energy,
                constants=MATERIALS[energy],
                poisson_ratio=0.4995,
                model=f'[model]\nspace = "{space}"\nmesh = "coarse"',
            )
            yield f"{energy} {test} {interface} {space}", _curve(problem, folder)


def energies(folder: Path) -> Iterator[tuple[str, Any]]:
    """Give the closed form of every energy in every test of a gauge section, or its refusal."""
    for energy, (kind, displacement) in itertools.product(MATERIALS, GAUGE_TESTS.items()):
        problem = PROBLEM.format(
            specimen=GAUGE,
            test=f'kind = "{kind}"\ndisplacement = "{displacement}"',
            energy=energy,
            constants=MATERIALS[energy],
            poisson_ratio=0.48,
            model="",
        )
        (folder / "gauge.toml").write_text(problem)
        yield f"{energy} {kind}", answer("solve gauge.toml", folder)


def _curve(problem: str, folder: Path) -> Any:
    path = folder / "problem.toml"
    path.write_text(problem)
    try:
        solved = study.solve(path)
    except Exception as error:  # a crash or a refusal is an answer, too
        return [type(error).__name__, *plain(str(error), folder)]
    curve = solved.curve
    gradient = {name: value.tolist() for name, value in sorted(curve.force_gradient.items())}
    lists = [curve.force_N.tolist(), curve.stiffness_N_per_mm.tolist(), gradient]
    return still([solved.status, solved.dofs, *lists], folder)


def designs(folder: Path) -> Iterator[tuple[str, Any]]:
    """Names of the cases of every design that ships, and its plan without measurements."""
    case_ids = importlib.import_module("tests.design.test_case_ids")
    for design in case_ids.SHIPPED:
        yield f"{design} cases", case_ids.names_of(design)
        yield f"{design} plan", answer(f"plan {ROOT}/designs/{design}.toml --data .", folder)


def faults(_folder: Path) -> Iterator[tuple[str, Any]]:
    """Where every changed study file is at fault, and by which rule."""
    faulty = importlib.import_module("tests.design.faulty")
    for row in faulty.stored():
        pairs = [fault[:2] for fault in faulty.faults_of(row.base, row.change)]
        yield f"{row.base} {json.dumps(row.change, sort_keys=True)}", pairs


def tables(folder: Path) -> Iterator[tuple[str, Any]]:
    """Analyses of every table that ships; those with a column ``keep`` also without its zeros."""
    for path in sorted(TABLES.glob("*.csv")):
        if path.stem in REFERENCES:
            continue
        header, *lines = path.read_text(encoding="utf-8").splitlines()
        names = header.split(",")
        sources = {path.stem: path}
        if "keep" in names:
            place = names.index("keep")
            lines = [line for line in lines if line.split(",")[place] == "1"]
            sources[f"{path.stem} unbalanced"] = folder / f"{path.stem}-unbalanced.csv"
            sources[f"{path.stem} unbalanced"].write_text("\n".join([header, *lines]) + "\n")
        for (name, source), flags in itertools.product(sources.items(), ANALYSES[path.stem]):
            yield f"{name} {flags}", answer(f"analyze {source} {flags}", folder)
    yield "blocked text", text_of(f"analyze {TABLES}/blocked.csv {ANALYSES['blocked'][0]}", folder)


def helps(folder: Path) -> Iterator[tuple[str, Any]]:
    """Every verb's ``--help``."""
    overview = text_of("--help", folder)
    yield "study", overview
    for line in overview[1:]:
        if verb := re.match(r"│ ([a-z]+) ", line):
            yield verb[1], text_of(f"{verb[1]} --help", folder)


def studies(folder: Path) -> Iterator[tuple[str, Any]]:
    """All verbs on results that the first of them make, then every file that they left."""
    _write_inputs(folder)
    words = {
        "designs": ROOT / "designs",
        "tables": TABLES,
        "battery": ANALYSES["battery_life"][0],
        "split": ANALYSES["paper_strength"][0],
        "surface": ANALYSES["chemical_process"][0],
        "centre": "material.C10=7.3 kPa,specimen.radius=10.2 mm",
        "case": "",
    }
    for name, line in COMMANDS:
        if name == "why+":
            words["case"] = sorted(p.name for p in Path("results/blocks/cases").iterdir())[0]
        line = line.format(**words)
        if not name.endswith("!"):
            yield f"{name} --json", answer(line, folder)
        if name.endswith(("+", "!")):
            yield name, text_of(line, folder)
    _, out, _ = command("doctor --json")
    yield "doctor", sorted(json.loads(out))
    for path in sorted(Path("results").glob("*/cases/*/record.json")):
        content = json.loads(path.read_text(encoding="utf-8"))["content"]
        yield f"record {path.parts[1]} {path.parts[3]}", still(content, folder)
    for path in (p for p in sorted(folder.rglob("*")) if p.is_file()):
        if (content := _content(path, folder)) is not None:
            yield f"file {path.relative_to(folder)}", content


def _write_inputs(folder: Path) -> None:
    levels = ['"neo-hookean"', '"mooney-rivlin"', '"yeoh"']
    files = {
        "ranges.toml": RANGES,
        "blocks.toml": BLOCKS.format(name="blocks", levels=", ".join(levels)),
        "fewer.toml": BLOCKS.format(name="fewer", levels=", ".join(levels[:2])),
        "elements.toml": ELEMENTS,
        "calibration.toml": CALIBRATION,
        "problem.toml": PROBLEM.format(
            specimen=CYLINDER,
            test=TESTS["compression"] + '\ninterface = "bonded"',
            energy="reduced-polynomial",
            constants=MATERIALS["reduced-polynomial"],
            poisson_ratio=0.49,
            model='[model]\nspace = "axisymmetric"\nmesh_size = "4 mm"',
        ),
    }
    rows = ["mix,specimen,repeat,d_mm,f_N"]
    for number, mix in enumerate(("M1", "M2", "M3")):
        for (specimen, c10), repeat in itertools.product((("A", 8.0), ("B", 8.3)), (1, 2)):
            for step in range(66):
                stretch = 1 - step / 300
                stress = 2 * (c10 - number + (0.3 + 0.1 * number) / stretch)
                force = 1e-3 * math.pi * 25**2 * stress * (stretch**-2 - stretch)
                wave = 1 + 0.003 * math.sin(step * (1 + number)) + 0.01 * (repeat - 1.5)
                rows.append(f"{mix},{specimen},{repeat},{step / 10},{force * wave:.10f}")
    files["blocks.csv"] = "\n".join(rows) + "\n"
    one = [row for row in rows if row.startswith(("mix", "M1,A"))]
    files["one.csv"] = "".join(row.split(",", 2)[2] + "\n" for row in one)
    measured = ["displacement_mm,force_N"]
    for step in range(1, 13):
        stretch = 1 - step / 80
        force = math.pi * 10.2**2 * 2e-3 * 7.3 * (stretch**-2 - stretch)
        measured.append(f"{step / 4},{force:.8f}")
    files["measured.csv"] = "\n".join(measured) + "\n"
    # a barrel of 8 mm, turned by 5 degrees about x
    cos, sin = math.cos(math.radians(5)), math.sin(math.radians(5))
    scan = ["x,y,z"]
    for ring, point in itertools.product(range(17), range(40)):
        height = ring / 2
        radius = 10 * (1 + 0.16 * (1 - (height / 4 - 1) ** 2))
        angle = math.radians(9 * point + 4 * (ring % 2))
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        scan.append(f"{x:.6f},{cos * y - sin * height:.6f},{sin * y + cos * height:.6f}")
    files["scan.csv"] = "\n".join(scan) + "\n"
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


def _content(path: Path, folder: Path) -> Any:
    """Pages as words, tables by their columns, documents by their keys; None of anything else.

    Records are read elsewhere; fronts of accuracy against time are other ones in every run.
    """
    if path.is_relative_to(folder / "results") or path.name.endswith("-front.csv"):
        return None
    if path.name.endswith(".csv.gz"):
        return _columns(gzip.decompress(path.read_bytes()).decode())
    if path.suffix not in {".csv", ".html", ".json", ".tex", ".inp", ".feb", ".py", ".toml"}:
        return None
    if path.stem.endswith("-front"):  # in the order of the seconds that a case takes
        return None
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".csv":
        return _columns(text)
    if path.suffix == ".json":
        return still(json.loads(text), folder)
    if path.suffix == ".html":
        text = re.sub(r"(?s)<(svg|style|script)\b.*?</\1>", " ", text)
        text = re.sub(r"</(p|tr|li|h\d|div|td|th|pre|details|summary)>", "\n", text)
        text = re.sub(r"<[^>]+>", " ", text)
    return plain(text, folder)


def _columns(text: str) -> Any:
    """Columns of a CSV by their names, without times, versions and hashes."""
    lines = csv.reader(line for line in text.splitlines() if not line.startswith("#"))
    header, *rows = lines
    return {
        name: [row[number] if number < len(row) else "" for row in rows]
        for number, name in enumerate(header)
        if not VOLATILE_COLUMN.search(name)
    }


PARTS: dict[str, Callable[[Path], Iterator[tuple[str, Any]]]] = {
    "faults": faults,
    "designs": designs,
    "help": helps,
    "energies": energies,
    "tables": tables,
    "forces": forces,
    "studies": studies,
}


def golden(parts: list[str]) -> dict[str, Any]:
    """Everything that must stay."""
    # neither the terminal nor the number of threads may matter; numpy is not loaded yet
    os.environ.update(COLUMNS="100", NO_COLOR="1", TERM="dumb")
    os.environ.update(dict.fromkeys(THREADS, "1"))
    answers = {}
    for part in parts:
        start = time.process_time()
        with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
            for key, value in PARTS[part](Path(name).resolve()):
                answers[f"{part}: {key}"] = value
        print(f"{part}: {time.process_time() - start:.0f} CPU s", file=sys.stderr, flush=True)
    return answers


def differences(old: Any, new: Any, where: str, rtol: float) -> Iterator[str]:
    """Places where two values differ, each with both."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}", rtol)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, f"{where}[{number}]", rtol)
    elif old != new and not _near(old, new, rtol):
        yield f"{where}: {str(old)[:200]} -> {str(new)[:200]}"


def _near(old: Any, new: Any, rtol: float) -> bool:
    """Whether two floats, in hexadecimal or as a column of a CSV has them, differ by rounding."""
    for read in (float.fromhex, float):
        try:
            return rtol > 0 and math.isclose(read(old), read(new), rel_tol=rtol, abs_tol=0.0)
        except (TypeError, ValueError):
            continue
    return False


def main(arguments: list[str] | None = None) -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("write", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--rtol", type=float, default=0.0, help="relative tolerance of floats")
    parser.add_argument("--part", default=",".join(PARTS), help="parts, with commas; all")
    options = parser.parse_args(arguments)
    parts = options.part.split(",")
    if wrong := set(parts) - set(PARTS):
        print(f"no part {', '.join(sorted(wrong))}; there are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    if options.what == "compare" and not options.file.is_file():
        print(f"there is no file {options.file}: write one first", file=sys.stderr)
        return 2
    file = options.file.resolve()
    sys.path.insert(0, str(ROOT))
    answers = golden(parts)
    if options.what == "write":
        file.write_text(json.dumps(answers, indent=0, sort_keys=True))
        print(f"{len(answers)} answers written to {file}")
        return 0
    old = json.loads(file.read_text())
    old = {key: value for key, value in old.items() if key.partition(":")[0] in parts}
    lines = list(differences(old, json.loads(json.dumps(answers)), "", options.rtol))
    for line in lines[:40]:
        print(line.lstrip("."))
    print(f"{len(old)} answers compared, {len(lines)} differences")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
