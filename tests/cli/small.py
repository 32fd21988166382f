"""A study that runs in seconds, its measurements, and the command line as a function."""

from __future__ import annotations

import io
import json
import shlex
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.cli.app import run

CSV = '[report]\nformat = ["csv"]\n'


def responses(**practical):
    """Tables of responses by name, each with the difference that matters, or none."""
    return "".join(
        f'[[response]]\nname = "{name}"\n' + (f'practical = "{least}"\n' if least else "")
        for name, least in practical.items()
    )


def measured(file, d="d", f="f"):
    """Table of measurements whose columns are a displacement in mm and a force in N."""
    return f"""[measurements]
file = "{file}"
columns = {{ displacement = "{d}", force = "{f}" }}
units = {{ displacement = "mm", force = "N" }}
"""


def pressed(rest, *, study="", radius=10, height=20, interface="frictionless", test=""):
    """Begin a file with a cylinder between plates, mm; `rest` begins with its material."""
    return f"""
schema = 1
{study}[specimen]
shape = "cylinder"
radius = "{radius} mm"
height = "{height} mm"
[test]
kind = "compression"
interface = "{interface}"
{test}{rest}"""


def gauge(material, size=""):
    """Begin a file with a section of uniform strain."""
    return f'schema = 1\n[specimen]\nshape = "homogeneous"\n{size}[material]\n{material}\n'


def recorded(folder, name, test, columns, more=""):
    """Write a recording, and return the table of its test: quantities by name, or labels."""
    rows = np.column_stack([values for _, values in columns.values()])
    head = ",".join(columns)
    np.savetxt(folder / f"{name}.csv", rows, "%.12g", ",", header=head, comments="")
    quantities = {name: unit for name, (unit, _) in columns.items() if unit}
    names = ", ".join(f'{name} = "{name}"' for name in quantities)
    units = ", ".join(f'{name} = "{unit}"' for name, unit in quantities.items())
    return (
        f'[[tests]]\ntest = {{ {test} }}\nmeasurements = {{ file = "{name}.csv", '
        f"columns = {{ {names} }}, units = {{ {units} }}{more} }}\n"
    )


def case_file(folder, *parts):
    path = folder / "case.toml"
    path.write_text("".join(parts), encoding="utf-8")
    return path


DESIGN = pressed(
    """[material]
incompressible = true
[presets.material.neo-hookean]
model = "neo-hookean"
[presets.material.mooney-rivlin]
model = "mooney-rivlin"
[presets.range.small]
measurements.range = ["1 %", "10 %"]
[presets.range.large]
measurements.range = ["1 %", "20 %"]
"""
    + measured("tests.csv", "d_mm", "f_N")
    + """block = "mix"
average = ["repeat"]
points = 30
fit = { specimen = "A" }
score = { specimen = "B" }
[calibration]
method = "analytic"
[factors]
material = ["neo-hookean", "mooney-rivlin"]
range = ["small", "large"]
"""
    + responses(relative_rms_force_error="0.5 pp")
    + CSV,
    study="""[study]
name = "small"
question = "Does the energy or the range matter?"
seed = 2011
""",
    radius=25,
    height=30,
)

PROBLEM = pressed(
    """[material]
model = "neo-hookean"
C10 = "10 kPa"
incompressible = true
[model]
space = "axisymmetric"
mesh_size = "5 mm"
""",
    height=10,
    test='displacement = "1 mm"\nsteps = 2\n',
)

CALIBRATION = """
schema = 1
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
role = "fit"
weight = "equal"
test = { kind = "compression", interface = "frictionless" }
[tests.measurements]
file = "one.csv"
columns = { displacement = "d_mm", force = "f_N" }
units = { displacement = "mm", force = "N" }
average = ["repeat"]
range = ["1 %", "20 %"]
"""

#: C10 and C01 in kPa of the two specimens of each mix
TRUTH = {
    ("M1", "A"): (8.0, 0.5),
    ("M1", "B"): (8.4, 0.4),
    ("M2", "A"): (5.0, 0.2),
    ("M2", "B"): (5.1, 0.3),
    ("M3", "A"): (6.0, 0.3),
    ("M3", "B"): (5.8, 0.3),
}


@dataclass(frozen=True)
class Answer:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        """Document on stdout; a bare NaN is no JSON."""
        return json.loads(self.out, parse_constant=_refuse)


def _refuse(word):
    raise AssertionError(f"{word} is no JSON")


def answer_of(main, *arguments):
    """Call a program in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return Answer(code, out.getvalue(), err.getvalue())


def study(*arguments):
    """Run the program in this process, as ``study ARGUMENTS`` does.

    A single argument is a whole line, split into words as a shell does.
    """
    if len(arguments) == 1:
        return answer_of(run, *shlex.split(str(arguments[0])))
    return answer_of(run, *arguments)


def success(*arguments, folder="."):
    """Run a command that must end well, in a folder."""
    with chdir(folder):
        answer = study(*arguments)
    assert answer.code == 0, answer.err
    return answer


def refusal(*arguments):
    """Run a command whose input must be refused."""
    answer = study(*arguments)
    assert answer.code == 2, answer.err
    assert "Traceback" not in answer.err
    return answer


def incompressible_force(c10_kPa, c01_kPa, d_mm):  # noqa: N803
    """Force in N of the cylinder between frictionless plates (Mooney 1940), by hand."""
    stretch = 1 - d_mm / 30.0
    nominal_kPa = 2 * (c10_kPa + c01_kPa / stretch) * (stretch**-2 - stretch)  # noqa: N806
    area = np.pi * 25.0**2
    return np.asarray(1e-3 * nominal_kPa * area)


def measured_rows():
    """Rows of the measurements: six specimens, two repeats with a known difference."""
    d = np.linspace(0.0, 6.5, 66)
    rows = ["mix,specimen,repeat,d_mm,f_N"]
    for (mix, specimen), constants in TRUTH.items():
        for repeat, scale in ((1, 0.995), (2, 1.005)):
            force = scale * incompressible_force(*constants, d)
            rows += [
                f"{mix},{specimen},{repeat},{x:.4f},{f:.10f}" for x, f in zip(d, force, strict=True)
            ]
    return rows


def write_files(home):
    """Design, problem, calibration and measurements in one folder."""
    (home / "small.toml").write_text(DESIGN)
    (home / "problem.toml").write_text(PROBLEM)
    (home / "calibration.toml").write_text(CALIBRATION)
    (home / "data").mkdir()
    rows = measured_rows()
    (home / "data" / "tests.csv").write_text("\n".join(rows) + "\n")
    one = [row.split(",", 2)[2] for row in rows if row.startswith(("mix", "M1,A"))]
    (home / "data" / "one.csv").write_text("\n".join(one) + "\n")


@dataclass(frozen=True)
class Finished:
    """A study that ran once in its own folder, and what the run printed."""

    folder: Path
    answer: Answer
