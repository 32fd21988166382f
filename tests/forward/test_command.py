"""Other programs as forward models, end to end: consent, curves, failures, gradients, names."""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from study.api.opened_study import open_study
from study.errors import RefusedError
from study.forward import command, exchange
from study.forward.command import Command
from study.forward.exchange import NoAnswer
from study.forward.python_function import PythonFunction
from study.setup.setup import problem_of
from tests.waiting import CAP_S, is_alive, until

ROOT = Path(__file__).parents[2]
HEIGHT, RADIUS, C10, C20 = 25.0, 14.5, 0.006, 0.0011
POINTS = np.linspace(0.0, 5.0, 6)[1:]

DESIGN = """
schema = 1
[study]
name = "programs"
question = "Does it matter who computes?"
[specimen]
shape = "cylinder"
radius = "14.5 mm"
height = "25 mm"
[test]
kind = "compression"
interface = "frictionless"
[material]
model = "reduced-polynomial"
order = 2
incompressible = true
[measurements]
file = "m.csv"
columns = { displacement = "d", force = "f" }
units = { displacement = "mm", force = "N" }
points = 12
range = ["1 %", "20 %"]
[presets.forward.built-in]
model = "closed-form"
[presets.forward.differences]
model = "command"
argv = [["python", "closed_form.py"]]
files = ["solvers/closed_form.py"]
[presets.forward.gradients]
model = "command"
argv = [["python", "closed_form.py", "gradients"]]
files = ["solvers/closed_form.py"]
version = ["python", "--version"]
[factors]
forward = ["built-in", "differences", "gradients"]
[[response]]
name = "C10"
practical = "5 % of mean"
[[response]]
name = "C20"
practical = "0.5 kPa"
"""


def problem(**constants):
    return problem_of(
        {
            "specimen": {"shape": "cylinder", "radius_mm": RADIUS, "height_mm": HEIGHT},
            "test": {"kind": "compression", "interface": "frictionless", "displacement_mm": 5.0},
            "material": {
                "model": "reduced-polynomial",
                "order": len(constants),
                "constants": constants,
                "incompressible": True,
            },
        }
    )


def force(d: float) -> float:
    """Nominal stress of Yeoh's energy times the area, written down once more."""
    stretch = 1 - d / HEIGHT
    invariant = stretch**2 + 2 / stretch - 3
    slope = 2 * (stretch**-2 - stretch)
    return math.pi * RADIUS**2 * slope * (C10 + 2 * C20 * invariant)


def script(text: str, **more: object) -> Command:
    return Command((("python", "run.py"),), {"run.py": text}, **more)


def refusal(made: Command, seconds: float | None = None) -> NoAnswer:
    with pytest.raises(NoAnswer) as caught:
        command.solve(made, problem(C10=C10), POINTS)
    return caught.value


WRITES = "open('curve.csv', 'w').write({!r})\n"


@pytest.mark.parametrize(
    ("made", "status", "said"),
    [
        (Command((("no-such-program-8141",),), {}), "failed", "no such program"),
        (script("raise SystemExit(3)"), "failed", "return code 3"),
        (script(""), "failed", "wrote no curve.csv"),
        (script("print('*ERROR reading')", failure="*ERROR"), "failed", "*ERROR reading"),
        (script("", success="finished"), "not-converged", "no command said"),
        (script(WRITES.format("a,b\n1,2\n")), "failed", "displacement_mm"),
        (script(WRITES.format("displacement_mm,force_N\n1,x\n")), "failed", "x"),
        (script(WRITES.format("displacement_mm,force_N\n5,nan\n")), "not-converged", "finite"),
        (script(WRITES.format("displacement_mm,force_N\n2,1\n1,1\n")), "failed", "rise"),
        (script(WRITES.format("displacement_mm,force_N\n2,1\n")), "not-converged", "ends at 2 mm"),
        (script("import os; os.kill(os.getpid(), 11)"), "failed", "return code -11"),
        (script("import os; os.symlink('/etc/hostname', 'curve.csv')"), "failed", "no curve.csv"),
    ],
)
def test_what_a_program_does_wrong_is_a_status_that_says_it(made, status, said):
    found = refusal(made)
    assert (found.status, said in str(found)) == (status, True), str(found)


def test_a_program_that_takes_too_long_ends_with_all_that_it_started(tmp_path):
    mark = tmp_path / "pid"
    text = (
        "import subprocess, time\n"
        f"child = subprocess.Popen(['sleep', '{CAP_S:g}'])\n"
        f"open({str(mark)!r}, 'w').write(str(child.pid))\n"
        f"time.sleep({CAP_S:g})\n"
    )
    assert refusal(script(text, timeout_s=3.0)).status == "timeout"
    if mark.is_file() and Path("/proc").is_dir():
        until(lambda: not is_alive(mark.read_text()))


def test_no_shell_reads_the_words(tmp_path):
    planted = tmp_path / "planted"
    made = Command((("python", "run.py", f"; touch {planted}"),), {"run.py": ""})
    assert refusal(made).status == "failed"
    assert not planted.exists()


def test_forces_of_the_shipped_closed_form_are_those_of_ours():
    text = (ROOT / "designs/solvers/closed_form.py").read_text()
    made = Command((("python", "closed_form.py", "gradients"),), {"closed_form.py": text})
    found, document = command.solve(made, problem(C10=C10, C20=C20), POINTS)
    np.testing.assert_allclose(found.curve.force_N, [force(d) for d in POINTS], rtol=1e-12)
    assert found.gradients == ("C10", "C20")
    assert document["steps"][0]["code"] == 0


def test_a_function_gives_what_a_program_gives():
    def model(asked):
        return [force(d) for d in asked["displacement_mm"]]

    found = PythonFunction.of(model, "1").solve(problem(C10=C10), POINTS)
    np.testing.assert_array_equal(found.curve.force_N, [force(d) for d in POINTS])


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "solvers").mkdir()
    shutil.copy(ROOT / "designs/solvers/closed_form.py", tmp_path / "solvers")
    (tmp_path / "design.toml").write_text(DESIGN)
    rows = [f"{d!r},{force(d)!r}" for d in (5.2 * k / 40 for k in range(41))]
    (tmp_path / "m.csv").write_text("d,f\n" + "\n".join(rows) + "\n")
    return tmp_path


def study(folder: Path, *words: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "study", *words], cwd=folder, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=CAP_S, check=False,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.verify
def test_a_study_runs_programs_that_were_allowed_and_finds_the_built_in_constants(folder):
    refused = study(folder, "run", "design.toml", "--data", ".")
    assert refused.returncode == 3
    assert "runs: python closed_form.py gradients" in refused.stderr
    assert not (folder / "results").exists()
    plan = json.loads(study(folder, "plan", "design.toml", "--data", ".", "--json").stdout)
    # eight evaluations of each of two fits, with one more call for each of two constants
    assert plan["program_calls"] == 2 * 8 * 3
    digest = plan["commands_digest"]
    assert f"--allow-digest {digest}" in refused.stderr
    other = study(folder, "run", "design.toml", "--data", ".", "--allow-digest", "0" * 12)
    assert other.returncode == 3
    done = study(folder, "run", "design.toml", "--data", ".", "--allow-digest", digest)
    assert done.returncode == 0, done.stderr
    records = open_study(folder / "results/programs").records
    found = {record.levels["forward"]: record for record in records}
    for name in ("differences", "gradients"):
        for constant, truth in (("C10", C10), ("C20", C20)):
            value = found[name].value(constant)
            assert value == pytest.approx(found["built-in"].value(constant), rel=1e-7), name
            # measured points lie on chords between samples 0.13 mm apart
            assert value == pytest.approx(1e3 * truth, rel=2e-3), name
    steps = found["gradients"].solver["program"]["steps"]
    assert [step["code"] for step in steps] == [0]
    assert found["gradients"].solver["name"].startswith("Python 3")
    # another text of the adapter is another study, which has to be allowed again
    with (folder / "solvers/closed_form.py").open("a") as stream:
        stream.write("# changed\n")
    again = study(folder, "run", "design.toml", "--data", ".", "--allow-digest", digest)
    assert again.returncode == 3
    assert "other commands" in again.stderr


def test_a_function_in_python_is_a_level_like_any_other(folder):
    from study import api

    text = DESIGN.replace('model = "command"\nargv = [["python", "closed_form.py"]]\n'
                          'files = ["solvers/closed_form.py"]', 'model = "python"')  # fmt: skip
    text = text.replace('["built-in", "differences", "gradients"]', '["built-in", "differences"]')
    (folder / "design.toml").write_text(text)

    def model(asked):
        constants = asked["material"]["constants_MPa"]
        found = []
        for d in asked["displacement_mm"]:
            stretch = 1 - d / asked["specimen"]["height_mm"]
            invariant = stretch**2 + 2 / stretch - 3
            stress = 2 * (stretch**-2 - stretch) * (
                constants["C10"] + 2 * constants.get("C20", 0.0) * invariant
            )  # fmt: skip
            found.append(math.pi * asked["specimen"]["radius_mm"] ** 2 * stress)
        return found

    where = {"data": folder, "results": folder / "results", "reports": None, "jobs": 1}
    with pytest.raises(RefusedError, match="given in Python"):
        api.run(folder / "design.toml", **where)
    found = api.run(folder / "design.toml", forward=model, version="1", **where)
    values = [record.value("C10") for record in found.records]
    assert values[0] == pytest.approx(values[1], rel=1e-9)
    assert values == pytest.approx([1e3 * C10] * 2, rel=2e-4)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx: apt-get install calculix-ccx")
@pytest.mark.parametrize(("order", "close"), [("linear", 3e-4), ("quadratic", 1e-6)])
def test_calculix_gives_the_closed_form_between_lubricated_plates(order, close):
    """The check case of the adapter: a wrong wedge, sign, half height or K shows here."""
    tables = {
        "specimen": {"shape": "cylinder", "radius_mm": RADIUS, "height_mm": HEIGHT},
        "test": {"kind": "compression", "interface": "frictionless", "displacement_mm": 3.75},
        "material": {"model": "neo-hookean", "constants": {"C10": 0.01}, "poisson_ratio": 0.4995},
        "model": {
            "element_order": order,
            "element_shape": "tensor",
            "formulation": "displacement",
            "mesh_size_mm": 5.0,
        },
    }
    text = (ROOT / "designs/solvers/calculix.py").read_text()
    argv = (
        ("python", "calculix.py", "deck"),
        ("ccx", "-i", "model"),
        ("python", "calculix.py", "curve"),
    )
    made = Command(argv, {"calculix.py": text}, ("ccx", "-v"), "Job finished", "*ERROR")
    given = problem_of(tables)
    found, document = command.solve(made, given, np.array([1.5, 3.75]))
    from study.forward.closed_form import compression

    exact = compression(given.specimen, given.material, np.array([1.5, 3.75])).force_N
    np.testing.assert_allclose(found.curve.force_N, exact, rtol=close)
    assert document["version"].startswith("This is Version")
    assert found.elements > 0


def test_the_curve_of_a_coarse_program_is_a_spline_through_its_steps():
    found = exchange.at_points(
        {"displacement_mm": np.array([1.0, 2.0, 3.0]), "force_N": np.array([1.0, 8.0, 27.0])},
        np.array([0.5, 2.5, 3.0]),
        {},
    )
    np.testing.assert_allclose(found.curve.force_N, [0.125, 15.625, 27.0], rtol=1e-12)
