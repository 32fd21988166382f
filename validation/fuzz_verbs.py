"""Examples of every verb: sound inputs and options, and what is wrong with some of them.

Each maker writes the inputs of one verb into a copy of a small project and gives the words after
``study``. Somewhat more than half of the examples are then spoiled in one way: the bytes or the
tree of an input, a measured file, a stored record, a page of a report, a field file, the answer of
a program, an override ``-s``, or the value of an option.
"""

from __future__ import annotations

import contextlib
import inspect
import os
import shutil
import tomllib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.random import Generator

from study.cli.app import VERBS, run
from study.ground.declaration import dump_toml
from study.harness.design import load
from study.harness.design.load import loads
from study.harness.design.spec import Design
from validation.fuzz_inputs import (
    MEASURED,
    STUDY,
    UNALTERABLE,
    WORDS,
    Made,
    Place,
    altered,
    damage,
    measurements,
    mutate,
    near,
    pick,
)

Words = list[str]
Maker = Callable[[Generator, Path], Words]

#: share of examples in which something is wrong
SPOILED = 0.55

#: a study over numbers whose force is a closed form
RANGES = """schema = 1
study = { name = "ranges", seed = 4 }
specimen = { shape = "cylinder", radius = "10 mm", height = "20 mm" }
test = { kind = "compression", interface = "frictionless", displacement = "3 mm", steps = 2 }
material = { model = "neo-hookean", C10 = "5 kPa", incompressible = true }
forward.model = "closed-form"
response = [{ name = "peak_force", practical = "0.05 N" }]
report.format = ["csv"]
design = { kind = "latin-hypercube", runs = 16 }
[factors]
material.C10 = { low = "5 kPa", high = "10 kPa" }
specimen.radius = { low = "0.9 cm", high = "1.1 cm" }
"""
PROBLEM = """schema = 1
specimen = { shape = "cylinder", radius = "10 mm", height = "10 mm" }
test = { kind = "compression", interface = "frictionless", displacement = "1 mm", steps = 2 }
material = { model = "neo-hookean", C10 = "10 kPa", incompressible = true }
model = { space = "axisymmetric", mesh_size = "5 mm" }
"""
CALIBRATION = """schema = 1
specimen = { shape = "cylinder", radius = "25 mm", height = "30 mm" }
material = { model = "neo-hookean", incompressible = true }
model = { space = "axisymmetric", mesh_size = "10 mm" }
[[tests]]
test = { kind = "compression", interface = "frictionless" }
[tests.measurements]
file = "one.csv"
columns = { displacement = "displacement_mm", force = "force_N" }
units = { displacement = "mm", force = "N" }
range = ["1 %", "20 %"]
points = 20
"""
SENSORS = """schema = 1
study = { name = "sensors", seed = 3 }
specimen = { shape = "cylinder", radius = "10 mm", height = "10 mm" }
test = { kind = "compression", interface = "frictionless", displacement = "2 mm" }
material = { model = "neo-hookean", C10 = "10 kPa", incompressible = true }
model = { space = "axisymmetric", mesh_size = "10 mm" }
position = { offset = "0.02 mm", scale = "0.5 %", noise = "0.05 mm" }
force = { zero = "0.02 N", scale = "1 %", noise = "0.02 N" }
requirement = { points = 30, samples = 0 }
"""
TRACKING = """schema = 1
[recording]
file = "markers.csv"
unit = "mm"
time = "time"
stage = "stage"
markers = { a = ["ax", "ay", "az"], b = ["bx", "by", "bz"] }
"""
TRACKED = {
    "distance": 'distance = { markers = ["a", "b"], reference = "50 mm", uncertainty = "0.01 mm" }',
    "spheres": 'distance = { markers = ["a", "b"], spheres = ["s1.csv", "s2.csv"] }',
    "displacement": 'displacement = { marker = "a", commanded = "commanded" }',
    "reference": 'reference = { file = "laser.csv", marker = "a", stage = "stage", '
    'position = ["ax", "ay", "az"], axes = [["bx", "by", "bz"], ["cx", "cy", "cz"]] }',
}
PROGRAM = """schema = 1
study = { name = "programs" }
specimen = { shape = "cylinder", radius = "10 mm", height = "10 mm" }
test = { kind = "compression", interface = "frictionless", displacement = "1 mm", steps = 3 }
material = { model = "neo-hookean", C10 = "10 kPa", incompressible = true }
calibration.method = "none"
response = [{ name = "peak_force" }]
report.format = ["csv"]
[presets.forward.own]
model = "command"
argv = [["python", "own.py"]]
files = ["own.py"]
timeout = "5 s"
[presets.forward.closed]
model = "closed-form"
[factors]
forward = ["own", "closed"]
"""
#: what a program answers; the first one is right
ANSWERS = (
    "'displacement_mm,force_N\\n' + ''.join(f'{x},{3 * x}\\n' for x in d)",
    "''", "'displacement_mm,force_N\\n'", "'displacement_mm,force_N\\n0.5,nan\\n1.0,2\\n'",
    "'displacement_mm,force_N\\n' + ''.join(f'{x},1e308\\n' for x in d)",
    "'displacement_mm,force_N\\n1,2\\n0.5,1\\n'", "'a,b\\n1,2\\n'", "'x' * 1_000_000",
    "'displacement_mm,force_N,dforce_C10\\n' + ''.join(f'{x},{x},1e400\\n' for x in d)",
    "'displacement_mm,force_N\\n' + ''.join(f'{x},{x}\\n' for x in d[:1])",
    "'\\0' * 100", "'displacement_mm;force_N\\n1;2\\n'",
)  # fmt: skip
FACTS = (
    "", "", "{}", "[" * 5000, '{"dofs": -5, "elements": 1e400}', '{"dofs": "x"}', "null",
    '{"dofs": 12, "elements": 4}', "\udcff".encode(errors="surrogateescape").decode("latin-1"),
)  # fmt: skip
#: overrides that a problem takes, and others
SETTINGS = (
    "test.displacement=0.5 mm", "material.C10=8 kPa", "specimen.radius=11 mm", "test.steps=3",
    "specimen.height=12 mm", 'test.interface="bonded"', "model.mesh_size=3 mm",
)  # fmt: skip
KEYS = (
    "test.displacement", "material.C10", "model.mesh_size", "specimen", "a.b", "[", "factors.x", "",
    "material.model", "test.kind", "forward.model", "study.seed", "x" * 5000, "a" + ".a" * 300,
)  # fmt: skip
#: what is changed in the text of the demo
DEMO = {
    ', "reduced-polynomial-2"]': "]",
    'model.space = ["axisymmetric", "3d"]\n': "",
    'mesh_size = "4 mm"': 'mesh_size = "8 mm"',
    "steps = 6": "steps = 3",
}
#: options whose value is drawn by name, sound values first and half of the draws
TAKES: dict[str, tuple[str, ...]] = {
    "--jobs": ("1", "0", "-3", "x", "1e9"),
    "--format": ("csv", "csv,", "tex", "pdfx", "csv,csv,no"),
    "--tolerance": ("0.01", "0", "-1", "nan", "1e400"),
    "--response": ("peak_force", "no", "", "mu0"),
    "--at": ("material.C10=7 kPa, specimen.radius=10 mm", "material.C10=7", "=", "a=b,c", "nan"),
    "--within": ("2 %", "-1 %", "nan %", "0 %", "2 parsec"),
    "--units": ("mm,N", "mm", "parsec,kg", ",,", "N,mm"),
    "--unit": ("mm", "m", "kg", "", "parsec"),
    "--sd": ("0.3", "0", "-1", "nan", "1e308"),
    "--seed": ("3", "-1", "x", "99999999999999999999"),
    "--formal-order": ("2", "0", "-1", "nan", "1e9"),
    "--specimens": ("3", "0", "-4", "x"),
    "--truth": ("yeoh", "ogden", "no"),
    "--timeout": ("60", "0", "-1", "nan", "x"),
    "--memory": ("2 GB", "0 GB", "-1 GB", "nan GB", "x"),
    "--stale": ("warn", "rerun", "refuse", "no"),
    "--convention": ("abaqus", "febio", "ogden-classical", "no"),
    "--case": ("", "0", "zz", "\u00e9"),
    "--test": ("1", "2", "0", "-1"),
    "--augment": ("1", "0", "-2", "100000"),
    "--terms": ("2", "0", "99", "a:b", ""),
    "--minimize": ("peak_force", "no", ""),
    "--maximize": ("peak_force", "no", ""),
    "--subject-to": ("peak_force >= 1 N", "peak_force > x", ">=", "no <= 1", "peak_force <= nan N"),
    "--bootstrap": ("5", "0", "-1", "x"),
    "--method": ("auto", "analytic", "no"),
    "--by": ("test", "no", ""),
    "--beside": ("small", "results/small", "no", "/"),
    "--decimal": (".", ",", ";", ""),
    "--allow-digest": ("0", "zz", ""),
    "--surface": ("auto", "quadratic", "emulator", "no"),
}
TABLE = ["t.csv", "--response", "y", "--factors", "a,b"]


def cylinder_force(d: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[float]:
    """Force in N of a neo-Hookean cylinder between frictionless plates (Treloar 1975)."""
    stretch = 1 - d / 20
    return [float(f) for f in np.pi * 10**2 * 2e-3 * 7 * (stretch**-2 - stretch)]


def _csv(path: Path, head: str, rows: Sequence[Sequence[object]]) -> None:
    lines = [head, *(",".join(str(value) for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def write_project(folder: Path) -> None:
    """Write the inputs of all verbs."""
    data = folder / "data"
    data.mkdir(parents=True)
    texts = {
        "small.toml": STUDY + MEASURED, "ranges.toml": RANGES, "problem.toml": PROBLEM,
        "calibration.toml": CALIBRATION, "sensors.toml": SENSORS, "programs.toml": PROGRAM,
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
    (data / "tests.csv").write_text(measurements())
    d = np.linspace(0.25, 6, 24)
    curve = list(zip(d.tolist(), cylinder_force(d), strict=True))
    _csv(data / "one.csv", "displacement_mm,force_N", curve)
    _csv(folder / "curve.csv", "displacement_mm,force_N", curve[:12])
    rng = np.random.default_rng(5)
    rows, poses, time = [], [], 0
    for turn in range(4):
        for k, stage in enumerate(("rest", "advance", "turn", "home", "away")):
            a = np.array([10.0 * k, 3 * k**1.5, 5 * (k % 3)])
            b = a + [50, 0, 0]
            for _ in range(3):
                time += 1
                noise = rng.normal(0, 0.02, 6)
                both = np.concatenate([a, b]) + noise
                rows.append([time, stage, 10 * k, *both.round(5).tolist()])
            if not turn:
                poses.append([stage, *a, *(a + [0, 9, 0]), *(a + [0, 0, 7])])
    _csv(data / "markers.csv", "time,stage,commanded,ax,ay,az,bx,by,bz", rows)
    _csv(data / "laser.csv", "stage,ax,ay,az,bx,by,bz,cx,cy,cz", poses)
    for k in (1, 2):
        ball = rng.standard_normal((40, 3))
        ball = 9 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [50 * k, 0, 0]
        _csv(data / f"s{k}.csv", "x,y,z", ball.round(6).tolist())
    t = rng.random(400) * 2 * np.pi
    radius = 10 / np.sqrt(0.9)
    side = np.column_stack([radius * np.cos(t), radius * np.sin(t), 9 * rng.random(400) - 4.5])
    top = np.array([[0.9 * x, 0.9 * y, 4.5 * (-1) ** k] for k, (x, y, _) in enumerate(side)])
    _csv(folder / "scan.csv", "x,y,z", np.vstack([side, top]).round(5).tolist())
    levels = [(a, b) for a in "uvw" for b in "xy"] * 3
    _csv(folder / "t.csv", "a,b,y", [[a, b, f"{rng.normal():.4f}"] for a, b in levels])
    (folder / "own.py").write_text(_program(ANSWERS[0], ""))


def _program(answer: str, facts: str) -> str:
    return (
        "import json\n"
        "d = json.load(open('problem.json'))['displacement_mm']\n"
        f"open('curve.csv', 'w').write({answer})\n"
        f"facts = {facts!r}\n"
        "if facts:\n    open('facts.json', 'w').write(facts)\n"
    )


def prepare(campaign: str) -> None:
    """Make the project that every example copies: two studies run, one with its pages."""
    made = Path(campaign, "unfinished-verbs")
    write_project(made)
    os.chdir(made)
    steps = (
        ["run", "small.toml", "--data", "data", "--jobs", "1"],
        ["report", "small", "--format", "csv,html"],
        ["run", "ranges.toml", "--jobs", "1"],
        ["solve", "problem.toml", "--vtu", "body.vtu"],
        ["demo", "--jobs", "1"],
    )
    with (
        open(os.devnull, "w") as no,
        contextlib.redirect_stdout(no),
        contextlib.redirect_stderr(no),
        small_demo(),
    ):
        codes = [run(step) for step in steps]
    shutil.copytree(made / "results/small", made / "results/second")
    os.chdir(campaign)
    if any(codes):
        raise RuntimeError(f"the project to be copied ended with {codes}")
    made.rename(Path(campaign, "verbs"))


def small_demo() -> AbstractContextManager[object]:
    """Context in which the study of ``study demo``, which takes minutes, has four small cells."""

    def reduced(text: str, source: str, overrides: Sequence[str] = ()) -> Design:
        for before, after in DEMO.items():
            text = text.replace(before, after)
        return loads(text, source, ['report.format=["csv"]', *overrides])

    return mock.patch.object(load, "loads", reduced)


def _named(rng: Generator) -> str:
    return str(pick(rng, ("small", "small", "small.toml", "results/small")))


def _case(rng: Generator, project: Path) -> str:
    names = sorted(path.name for path in (project / "results/small/cases").iterdir())
    return str(pick(rng, names))[: int(rng.integers(4, 17))]


def _tracking(rng: Generator, project: Path) -> Words:
    kinds = sorted(TRACKED)
    chosen = [kinds[k] for k in rng.permutation(4)[: int(rng.choice([1, 1, 2]))]]
    chosen = chosen if set(chosen) != {"distance", "spheres"} else chosen[:1]
    text = "\n".join(TRACKED[kind] for kind in chosen)
    head, _, body = TRACKING.partition("\n")
    (project / "tracking.toml").write_text(f"{head}\n{text}\n{body}")
    return ["tracking", "tracking.toml", "--data", "data"]


def _shape(rng: Generator, project: Path) -> Words:
    body = pick(rng, ("body.vtu", "body.vtu", "problem.toml"))
    lies = ["--as-it-lies"] if rng.random() < 0.7 else []
    return ["shape", body, "--scan", "scan.csv", "--any-state", *lies]


def _converge(rng: Generator, project: Path) -> Words:
    if rng.random() < 0.8:
        sizes = [float(s) for s in np.sort(rng.choice([1, 2, 4, 8, 16], 3, replace=False))]
        values = [1 + 0.01 * s ** pick(rng, (0.5, 1, 2, 2, 7)) for s in sizes]
        values = [v * pick(rng, (1, 1, 1, 0, -1, 1e200)) for v in values]
        return ["converge", "--values", ",".join(map(str, values)), "--sizes",
                ",".join(map(str, sizes))]  # fmt: skip
    return ["converge", "problem.toml"]


def _run(rng: Generator, project: Path) -> Words:
    if rng.random() < 0.3:
        answer, facts = (ANSWERS[0], "") if rng.random() < 0.4 else (pick(rng, ANSWERS), "")
        facts = str(pick(rng, FACTS)) if rng.random() < 0.5 else facts
        (project / "own.py").write_text(_program(answer, facts), errors="surrogateescape")
        return ["run", "programs.toml", "--allow-commands", "--jobs", "1"]
    if rng.random() < 0.5:
        shutil.rmtree(project / "results/small/cases" / pick(rng, sorted(
            os.listdir(project / "results/small/cases"))))  # fmt: skip
    return ["run", "small.toml", "--data", "data", "--jobs", "1"]


def _demo(rng: Generator, project: Path) -> Words:
    cases = project / "results/demo/cases"
    if rng.random() < 0.3:  # to be computed once more
        shutil.rmtree(cases / pick(rng, sorted(os.listdir(cases))))
    places: tuple[Words, ...] = (
        [],
        [],
        ["--reports", "pages"],
        ["--results", "small.toml"],
        ["--reports", "own.py"],
    )
    return ["demo", "--jobs", "1", *pick(rng, places)]


MAKERS: dict[str, Maker] = {
    "demo": _demo,
    "plan": lambda rng, p: ["plan", *pick(rng, (["small.toml", "--data", "data"], ["ranges.toml"],
                                                ["programs.toml"]))],
    "run": _run,
    "import": lambda rng, p: ["import", TABLE[0], "--factors", "a,b", "--responses", "y"],
    "status": lambda rng, p: ["status", _named(rng)],
    "report": lambda rng, p: ["report", _named(rng), "--format", pick(rng, ("csv", "csv", "tex"))],
    "diff": lambda rng, p: ["diff", _named(rng), pick(rng, ("results/second",) * 3 + ("ranges",))],
    "why": lambda rng, p: ["why", _case(rng, p), "--study", "small.toml", "--data", "data"],
    "predict": lambda rng, p: ["predict", "ranges", "--at", TAKES["--at"][0]],
    "verify": lambda rng, p: ["verify", "small"],
    "power": lambda rng, p: ["power", "small.toml", "--data", "data", "--sd", "0.3"],
    "serve": lambda rng, p: ["serve", "--port", "0"],
    "analyze": lambda rng, p: ["analyze", *pick(rng, (TABLE, TABLE, ["results/small"]))],
    "optimize": lambda rng, p: ["optimize", "ranges", "--minimize", "peak_force", "--no-confirm"],
    "invert": lambda rng, p: ["invert", "ranges", "--to", "curve.csv", "--no-confirm"],
    "new": lambda rng, p: ["new", pick(rng, ("a.toml", "data/b.toml")),
                           *pick(rng, ([], [], ["--calibration"]))],
    "virtual": lambda rng, p: ["virtual", "V", "--specimens", "2",
                               *pick(rng, ([], ["--from", "small.toml"]))],
    "solve": lambda rng, p: ["solve", "problem.toml", *pick(rng, (
        [], ["--vtu", "o.vtu"], ["--picture", "o.svg"], ["-s", 'forward.model="closed-form"']))],
    "calibrate": lambda rng, p: ["calibrate", "calibration.toml", "--data", "data"],
    "converge": _converge,
    "doctor": lambda rng, p: ["doctor"],
    "inspect": lambda rng, p: ["inspect", pick(rng, ("curve.csv", "data/tests.csv", "data/one.csv",
                                                     "data/markers.csv", "data/laser.csv"))],
    "export": lambda rng, p: ["export", *pick(rng, (
        ["problem.toml", "-s", 'forward.model="closed-form"'], ["ranges", "--as", "emulator"],
        ["problem.toml", "--as", "abaqus"], ["problem.toml", "--as", "febio"]))],
    "require": lambda rng, p: ["require", "sensors.toml"],
    "tracking": _tracking,
    "shape": _shape,
}  # fmt: skip

#: how often a verb is drawn, where that is not once: those of seconds less, cheap ones more
WEIGHTS = {"run": 0.7, "report": 0.6, "verify": 0.6, "invert": 0.5, "shape": 0.6, "demo": 0.3,
           "doctor": 0.15, "optimize": 0.5, "export": 0.7, "serve": 0.3, "calibrate": 0.6,
           "tracking": 1.5, "solve": 1.5, "converge": 1.5, "plan": 1.5, "analyze": 1.5}  # fmt: skip


def options_of(verb: str) -> list[str]:
    """Long names of the options that a verb takes, by its signature."""
    named = {"formats": "--format", "form": "--as", "kind": "--type", "as_json": "--json"}
    function = {callable_.__name__: callable_ for callable_ in VERBS}[verb]
    parameters = inspect.signature(function).parameters
    return [named.get(name, "--" + name.replace("_", "-")) for name in parameters]


def _file(rng: Generator, project: Path, words: Words) -> Path | None:
    """Draw a file that a command reads: named, stored, or of the report."""
    named = [project / word for word in words if len(word) < 100 and (project / word).is_file()]
    data = sorted((project / "data").glob("*.csv"))
    stored = sorted((project / "results").rglob("*.json"))
    pages = [path for path in sorted((project / "reports").rglob("*")) if path.is_file()]
    if words[0] in ("status", "why", "diff", "report", "optimize", "predict", "serve"):
        named = [*named, pick(rng, stored)]
    if words[0] == "verify":
        named = [pick(rng, pages), pick(rng, pages), pick(rng, stored)]
    if words[0] in ("calibrate", "tracking", "run", "power", "plan"):
        named = [*named, pick(rng, data)]
    return pick(rng, named) if named else None


def _spoil_file(rng: Generator, path: Path) -> None:
    """Break the bytes of a file, or change its tree or its cells."""
    raw, kind = path.read_bytes(), rng.random()
    if path.suffix == ".json" and kind < 0.8:
        with contextlib.suppress(*UNALTERABLE):
            path.write_bytes(altered(rng, raw))
            return
    if path.suffix == ".toml" and kind < 0.8:
        tree = tomllib.loads(raw.decode())
        mutate(rng, tree, tomllib.loads(raw.decode()))
        path.write_bytes(dump_toml(tree).encode())
    elif path.suffix == ".csv" and kind < 0.7:
        path.write_text(_cells(rng, raw.decode()))
    else:
        path.write_bytes(damage(rng, raw))


def _cells(rng: Generator, text: str) -> str:
    """Change cells of a table: one, a column that becomes one value or a line, or rows lost."""
    rows = [line.split(",") for line in text.splitlines()]
    column, kind = int(rng.integers(len(rows[0]))), int(rng.integers(6))
    body = rows[1:]
    if kind == 0:
        pick(rng, body)[column] = str(pick(rng, (*WORDS[:60], "nan", "inf", "1e308", "-1")))
    elif kind == 1:
        for row in body:
            row[column] = body[0][column]
    elif kind == 2:  # points on a line, or at one place
        for row in body:
            row[-3:] = [row[-1]] * 3 if rng.random() < 0.5 else body[0][-3:]
    elif kind == 3:
        body = body[: int(rng.integers(0, 6))]
    elif kind == 4:
        body = [body[int(rng.integers(len(body)))] for _ in body]
    else:
        factor = pick(rng, (0, 1e-300, -1, 1e3, 1e200, 1e308))
        for row in body:
            with contextlib.suppress(ValueError):
                row[column] = str(float(row[column]) * factor)
    return "\n".join(",".join(row) for row in [rows[0], *body]) + "\n"


def _spoil_words(rng: Generator, words: Words) -> None:
    """Change a word behind the verb, lose it, repeat it, or add one."""
    at, kind = int(rng.integers(1, len(words) + 1)), int(rng.integers(5))
    word = str(pick(rng, WORDS)).replace("\0", "")[:2000]
    if kind == 0 and at < len(words):
        words[at] = word
    elif kind == 1 and at < len(words):
        words[at] = str(near(rng, words[at]))
    elif kind == 2 and at < len(words):
        del words[at]
    else:
        words.insert(at, word)


def every_verb(rng: Generator, project: Path, place: Place) -> Made:
    """Draw a verb, its inputs and options, and spoil somewhat more than half of the examples."""
    verbs = list(MAKERS)
    share = np.array([WEIGHTS.get(verb, 1.0) for verb in verbs])
    verb = verbs[int(rng.choice(len(verbs), p=share / share.sum()))]
    shutil.copytree(Path(place.campaign, "verbs"), project, dirs_exist_ok=True)
    words = MAKERS[verb](rng, project)
    takes = options_of(verb)
    spoiled = rng.random() < SPOILED
    usable = [name for name in takes if name in TAKES and name not in words]
    for name in usable:
        if rng.random() < (0.2 if spoiled else 0.08):
            values = TAKES[name]
            words += [name, str(pick(rng, values) if spoiled and rng.random() < 0.5 else values[0])]
    if "--settings" in takes and rng.random() < 0.4:
        sound = verb in ("solve", "require", "export") or not spoiled
        value = str(pick(rng, WORDS)).replace("\0", "")
        setting = pick(rng, SETTINGS) if sound else f"{pick(rng, KEYS)}={value}"
        words += ["-s", setting] if spoiled or verb in ("solve", "require", "export") else []
    if "--json" in takes and rng.random() < 0.4:
        words.append("--json")
    if spoiled:
        path = _file(rng, project, words)
        if path is not None and rng.random() < 0.7:
            _spoil_file(rng, path)
        elif rng.random() < 0.5:
            _spoil_words(rng, words)
    return [words], False
