"""Other programs as forward models, end to end: consent, curves, failures, gradients, names."""

import io
import json
import math
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study import api
from study.api.opened_study import load as open_study
from study.external import answers, command
from study.external.answers import NoAnswer, values_of_files
from study.external.command import External
from study.external.forward_model import ForwardFiles, ForwardModel, ParameterProblem, ValueFile
from study.ground.curve import Curve
from study.ground.errors import InputError, RefusedError
from study.simulation.cell import Cell, CellProblem
from study.simulation.fit_task import fitted
from study.simulation.job import FitJob, fit_key, fit_problem, request
from tests.cli.small import CSV, measured, pressed, responses
from tests.waiting import CAP_S, is_alive, until

ROOT = Path(__file__).parents[2]
HEIGHT, RADIUS, C10, C20 = 25.0, 14.5, 0.006, 0.0011
POINTS = np.linspace(0.0, 5.0, 6)[1:]


def commands(argv, contents, **more):
    """Forward model of commands that find some files in their folder."""
    return External(ForwardModel(model="command", argv=argv, **more), contents, {}, None)


def solve_by_command(made, given, points):
    """Curve of a program that exchanges problem.json and curve.csv, and the report of its run."""
    written = json.dumps(request(given, points), indent=1)
    contents = {**made.contents, answers.PROBLEM_FILE: written}
    answer = command.run_commands(
        made.section, contents, lambda folder, said: answers.curve_answered(folder, points)
    )
    return answer, answer.solver["program"]


DESIGN = (
    pressed(
        '[material]\nmodel = "reduced-polynomial"\norder = 2\nincompressible = true\n',
        study='[study]\nname = "programs"\nquestion = "Does it matter who computes?"\n',
        radius=14.5,
        height=25,
    )
    + measured("m.csv")
    + """points = 12
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
"""
    + responses(C10="5 % of mean", C20="0.5 kPa")
    + CSV
)


def problem(**constants):
    return CellProblem.of(
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
    ).at()


def force(d):
    """Nominal stress of Yeoh's energy times the area, written down once more."""
    stretch = 1 - d / HEIGHT
    invariant = stretch**2 + 2 / stretch - 3
    slope = 2 * (stretch**-2 - stretch)
    return math.pi * RADIUS**2 * slope * (C10 + 2 * C20 * invariant)


def script(text, **more):
    return commands((("python", "run.py"),), {"run.py": text}, **more)


def refusal(made):
    with pytest.raises(NoAnswer) as caught:
        solve_by_command(made, problem(C10=C10), POINTS)
    return caught.value


WRITES = "open('curve.csv', 'w').write({!r})\n"
REPLACES = "import os, shutil; d = os.getcwd(); shutil.rmtree(d); os.symlink('/etc', d)"
CURVE = "displacement_mm,force_N\n1,1\n3,8\n5,20\n"


@pytest.mark.parametrize(
    ("made", "status", "said"),
    [
        (commands((("no-such-program-8141",),), {}), "failed", "no such program"),
        (script("raise SystemExit(3)"), "failed", "return code 3"),
        (script(""), "failed", "wrote no curve.csv"),
        (script("print('*ERROR reading')", failure="*ERROR"), "failed", "*ERROR reading"),
        (script("", success="finished"), "not-converged", "no command said"),
        (script(WRITES.format("displacement_mm,force_N\n2,1\n")), "not-converged", "ends at 2 mm"),
        (script("import os; os.kill(os.getpid(), 11)"), "failed", "return code -11"),
        (script("import os; os.symlink('/etc/hostname', 'curve.csv')"), "failed", "no curve.csv"),
        (script("import os; os.symlink('/dev/zero', 'curve.csv')"), "failed", "is a link"),
        (script("import os; os.mkdir('curve.csv')"), "failed", "is no file but a folder"),
        (script("open('curve.csv', 'wb').truncate(10**10)"), "failed", "return code 1"),
        (script("open('curve.csv', 'wb').truncate(10**9)"), "failed", "holds more than 20 MB"),
        (script("import os, shutil; shutil.rmtree(os.getcwd())"), "failed", "no curve.csv"),
        (script(REPLACES), "failed", "no curve.csv"),
        (script("import os; os.kill(os.getppid(), 9)"), "failed", "supervised it was killed"),
        (commands((("./run.py",),), {"run.py": "x"}), "failed", "no such program"),
        (commands((("python", "x" * 3_000_000),), {}), "failed", "could not be run"),
    ],
)
def test_what_a_program_does_wrong_is_a_status_that_says_it(made, status, said):
    found = refusal(made)
    assert (found.status, said in str(found)) == (status, True), str(found)


HEAD = "displacement_mm,force_N\n"


@pytest.mark.parametrize(
    ("curve", "facts", "status", "said"),
    [
        ("a,b\n1,2\n", "{}", "failed", "displacement_mm"),
        (f"{HEAD}1,x\n", "{}", "failed", "x"),
        (f"{HEAD}5,nan\n", "{}", "not-converged", "finite"),
        (f"{HEAD}2,1\n1,1\n", "{}", "failed", "rise"),
        ("\n" * 1_000_000, "{}", "failed", "is empty"),
        ("a" * 200_000 + "\n1", "{}", "failed", "needs one"),
        ("a," * 9_000_000 + "\n1", "{}", "failed", "10000 col"),
        (CURVE.replace("8", "-1e308"), "{}", "failed", "beyond 1e+30"),
        (CURVE.replace("8", "inf"), "{}", "not-converged", "finite"),
        (CURVE.replace("3,8", "3"), "{}", "failed", "curve.csv:3: has 1 columns"),
        (CURVE.replace("3,8", "5e-324,8"), "{}", "failed", "rise"),
        (f"{HEAD}5e-324,1\n1e-323,2\n5,3\n", "{}", "failed", "the curve"),
        (CURVE, '{"elements": 1e300}', "failed", "elements must be a whole number"),
        (CURVE, '{"dofs": "many"}', "failed", "dofs must be a whole number"),
        (CURVE, '{"dofs": true}', "failed", "dofs must be a whole number"),
        (CURVE, '{"elements": -5}', "failed", "elements must be a whole number"),
        (CURVE, "[" * 100_000, "failed", "facts.json: is not valid JSON"),
        (CURVE, '{"dofs": NaN}', "failed", "is not valid JSON"),
        (CURVE, "[1]", "failed", "must be an object"),
    ],
    ids=lambda text: text[:40],
)
def test_what_a_file_of_an_answer_has_wrong_is_a_status(tmp_path, curve, facts, status, said):
    (tmp_path / answers.CURVE_FILE).write_text(curve)
    (tmp_path / answers.FACTS_FILE).write_text(facts)
    with pytest.raises(NoAnswer, match=re.escape(said)) as caught:
        answers.curve_answered(tmp_path, POINTS)
    assert caught.value.status == status


LEAVES = """
import os, sys, time
def leave(new_session):
    if os.fork() == 0:
        if new_session:
            os.setsid()
            if os.fork():
                os._exit(0)
        with open({place!r} + str(new_session), "w") as stream:
            stream.write(str(os.getpid()))
        time.sleep(600)
        os._exit(0)
leave(0)
leave(1)
while not all(os.path.isfile({place!r} + w) and os.path.getsize({place!r} + w) for w in "01"):
    time.sleep(0.01)
"""


def left_behind(place):
    """Ids of the processes that a program left, which still run."""
    marks = [place.with_name(place.name + word) for word in "01"]
    pids = [mark.read_text() for mark in marks if mark.is_file()]
    return [pid for pid in pids if pid and is_alive(pid)]


NEEDS_PROC = pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="needs /proc")


@NEEDS_PROC
@pytest.mark.parametrize("end", ["", "time.sleep(600)", "raise SystemExit(3)", "os.abort()"])
def test_all_that_a_program_leaves_behind_ends_with_it(tmp_path, end):
    """In its own process group and in another session, whether it answers, fails or is late."""
    text = LEAVES.format(place=str(tmp_path / "pid")) + WRITES.format(CURVE) + end
    made = script(text, timeout_s=2.0 if "sleep" in end else None)
    if end:
        assert refusal(made).status == ("timeout" if "sleep" in end else "failed")
    else:
        solve_by_command(made, problem(C10=C10), POINTS)
    assert left_behind(tmp_path / "pid") == []


@NEEDS_PROC
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_all_of_a_program_ends_with_the_run_that_is_stopped(folder, tmp_path, number):
    text = LEAVES.format(place=str(tmp_path / "pid")) + "time.sleep(600)\n"
    (folder / "solvers/closed_form.py").write_text(text)
    run = subprocess.Popen(
        [sys.executable, "-m", "study", "run", "design.toml", "--data", ".", "--allow-commands",
         "--jobs", "1"], cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        until(lambda: len(left_behind(tmp_path / "pid")) == 2)
        run.send_signal(number)
        run.wait(60)
        until(lambda: not left_behind(tmp_path / "pid"))
    finally:
        run.kill()
        run.wait()
    assert left_behind(tmp_path / "pid") == []


@pytest.mark.parametrize(
    "deed", ["remove('.output')", "mkfifo('.output')", "symlink('/dev/zero', '.output')"]
)
def test_the_output_lies_out_of_reach_of_the_program(deed):
    text = f"import os\ntry:\n    os.{deed}\nexcept FileNotFoundError:\n    pass\n"
    made = script(text + "print('all went well')\n" + WRITES.format(CURVE))
    _, document = solve_by_command(made, problem(C10=C10), POINTS)
    assert document["steps"][0]["output"] == "all went well\n"


def test_output_without_end_ends_the_program(monkeypatch):
    monkeypatch.setattr(command.run, "__defaults__", (None, 1_000_000, None))
    found = refusal(script("while True: print('x' * 1000)"))
    assert (found.status, "said more than 1 MB" in str(found)) == ("failed", True)


def test_a_version_without_end_is_its_first_line():
    long = "print(); print('v2'); print('x' * 10**4)"
    assert command.said_version(("yes",), {}) == "y"
    assert command.said_version(("python", "-c", long), {}) == "v2"
    assert command.said_version(("no-such-program-8141",), {}) == ""


@pytest.mark.parametrize(
    ("deed", "said"),
    [
        ("open(str(k), 'wb').write(bytes(10**6))", "holds more than 0.01 GB"),
        ("open(str(k), 'wb').close()", "holds more than 500 files"),
    ],
)
def test_a_disk_is_not_filled(monkeypatch, deed, said):
    monkeypatch.setattr(command, "FOLDER_BYTES", 10_000_000)
    monkeypatch.setattr(command, "FOLDER_ENTRIES", 500)
    text = f"import time\nfor k in range(10**6):\n    {deed}\n    time.sleep(.001)\n"
    found = refusal(script(text))
    assert (found.status, said in str(found)) == ("failed", True), str(found)


def test_a_file_larger_than_the_folder_may_be_is_said(monkeypatch):
    monkeypatch.setattr(command, "FOLDER_BYTES", 10_000_000)
    found = refusal(commands((("dd", "if=/dev/zero", "of=big", "bs=1M", "count=100"),), {}))
    assert "wrote a file of more than 0.01 GB" in str(found)


def test_nothing_of_a_case_stays_in_the_temporary_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    deep = "import os\nos.mkdir('shut')\nopen('shut/file', 'w').close()\nos.chmod('shut', 0)\n"
    deep += "for k in range(2100):\n    os.mkdir('d')\n    os.chdir('d')\n"
    refusal(script(deep))
    assert list(tmp_path.iterdir()) == []


def test_limits_hold_in_threads_that_hear_no_signal(monkeypatch):
    """As those of a cluster's worker: the call is made in the main thread of another process."""
    monkeypatch.setattr(answers, "_MOST_SECONDS", 0.5)
    context = {"parameters": {"mass": 2}}
    # 10 thousand million rounds without a letter
    without_end = "{% for a in range(99999) %}{% for b in range(99999) %}{% endfor %}{% endfor %}"

    def refused(text):
        with pytest.raises(InputError) as caught:
            answers.rendered(text, context, "input.txt.j2")
        return str(caught.value)

    def slow_pattern():
        source = ValueFile(names=(("x", "", r"(?:a+)+b([-+]?\d+)", "", ""),))
        with pytest.raises(NoAnswer) as caught:
            values_of_files(source, Path(), "a" * 40 + "!")
        return str(caught.value)

    with ThreadPoolExecutor(1) as thread:
        late = thread.submit(refused, without_end).result()
        unknown = thread.submit(refused, "\n{{ parameters.mas }}").result()
        made = thread.submit(answers.rendered, "{{ parameters.mass }}", context, "a.j2").result()
        pattern = thread.submit(slow_pattern).result()
    assert re.match(r"input\.txt\.j2:1: cannot.*more than 0.5 s of computing", late)
    assert re.match(r"input\.txt\.j2:2: unknown name parameters\.mas\s.*mass", unknown)
    assert made == "2"
    for said in (pattern, slow_pattern()):
        assert "more than 0.5 s of computing: write it without a repeat" in said


def test_no_shell_reads_the_words(tmp_path):
    planted = tmp_path / "planted"
    made = commands((("python", "run.py", f"; touch {planted}"),), {"run.py": ""})
    assert refusal(made).status == "failed"
    assert not planted.exists()


def test_forces_of_the_shipped_closed_form_are_those_of_ours():
    text = (ROOT / "designs/solvers/closed_form.py").read_text()
    made = commands((("python", "closed_form.py", "gradients"),), {"closed_form.py": text})
    found, document = solve_by_command(made, problem(C10=C10, C20=C20), POINTS)
    np.testing.assert_allclose(found.curve.force_N, [force(d) for d in POINTS], rtol=1e-12)
    assert tuple(found.curve.force_gradient) == ("C10", "C20")
    assert document["steps"][0]["code"] == 0


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "solvers").mkdir()
    shutil.copy(ROOT / "designs/solvers/closed_form.py", tmp_path / "solvers")
    (tmp_path / "design.toml").write_text(DESIGN)
    rows = [f"{d!r},{force(d)!r}" for d in (5.2 * k / 40 for k in range(41))]
    (tmp_path / "m.csv").write_text("d,f\n" + "\n".join(rows) + "\n")
    return tmp_path


def study(folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "study", *words], cwd=folder, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=CAP_S, check=False,
    )  # fmt: skip


@pytest.mark.slow
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


def test_a_function_in_python_that_is_not_given_is_asked_for(folder):
    text = DESIGN.replace('model = "command"\nargv = [["python", "closed_form.py"]]\n'
                          'files = ["solvers/closed_form.py"]', 'model = "python"')  # fmt: skip
    (folder / "design.toml").write_text(text)
    with pytest.raises(RefusedError, match="given in Python"):
        api.run(folder / "design.toml", data=folder, results=folder / "r", reports=None, jobs=1)


def test_hostile_answers_are_statuses_of_their_cases(folder):
    """Through the public verb: every case ends, and says what was wrong."""
    large = WRITES.format("displacement_mm,force_N\n1,1e29\n6,-1e29\n")
    text = f"import os, sys\nif sys.argv[1:]: os.mkfifo('curve.csv')\nelse: {large}"
    (folder / "solvers/closed_form.py").write_text(text)
    study = api.run(
        folder / "design.toml", data=folder, results=folder / "results", reports=None, jobs=1,
        allow_commands=True,
    )  # fmt: skip
    records = {record.levels["forward"]: record for record in study.records}
    assert records.pop("built-in").status == "converged"
    assert "no file but a pipe" in records["gradients"].message
    assert not any("Traceback" in str(record.extra) for record in records.values())
    assert {record.status for record in records.values()} <= {"failed", "not-converged"}


def lubricated(order):
    """Problem whose closed form checks an adapter."""
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
    return CellProblem.of(tables).at()


def test_the_adapter_of_calculix_writes_its_input_without_the_program(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problem = request(lubricated("quadratic"), np.array([1.5, 3.75]))
    written = runpy.run_path(str(ROOT / "designs/solvers/calculix.py"))["deck"](problem)
    facts = json.loads((tmp_path / "facts.json").read_text())
    nodes, elements = (written.split(key)[1].split("*")[0].count("\n") - 1
                       for key in ("*NODE, NSET=ALL", "*ELEMENT, TYPE=CAX8"))  # fmt: skip
    assert facts == {"elements": elements, "dofs": 2 * nodes}
    assert elements > 0
    assert "TOP, 2, 2, -1.875" in written  # of the half height


@pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx: apt-get install calculix-ccx")
@pytest.mark.parametrize(("order", "close"), [("linear", 3e-4), ("quadratic", 1e-6)])
def test_calculix_gives_the_closed_form_between_lubricated_plates(order, close):
    """The check case of the adapter: a wrong wedge, sign, half height or K shows here."""
    text = (ROOT / "designs/solvers/calculix.py").read_text()
    argv = (
        ("python", "calculix.py", "deck"),
        ("ccx", "-i", "model"),
        ("python", "calculix.py", "curve"),
    )
    said = {"version": ("ccx", "-v"), "success": "Job finished", "failure": "*ERROR"}
    made = commands(argv, {"calculix.py": text}, **said)
    given = lubricated(order)
    found, document = solve_by_command(made, given, np.array([1.5, 3.75]))
    from study.mechanics.forward.closed_form import homogeneous

    exact = homogeneous(given.specimen, given.material, np.array([1.5, 3.75])).force_N
    np.testing.assert_allclose(found.curve.force_N, exact, rtol=close)
    assert document["version"].startswith("This is Version")
    assert found.mesh["elements"] > 0


def test_the_curve_of_a_coarse_program_is_a_spline_through_its_steps():
    found = answers.at_points(
        {"displacement_mm": np.array([1.0, 2.0, 3.0]), "force_N": np.array([1.0, 8.0, 27.0])},
        np.array([0.5, 2.5, 3.0]),
    )
    np.testing.assert_allclose(found.curve.force_N, [0.125, 15.625, 27.0], rtol=1e-12)


def test_a_folder_is_kept_whatever_its_names_and_depth(tmp_path):
    code = (
        "import os\n"
        "open(b'odd-\\xff.txt', 'w').write('odd')\n"
        "for _ in range(1200): os.mkdir('d'); os.chdir('d')\n"
        "open('deep.txt', 'w').write('deep')\n"
    )
    made = commands((("python", "make.py"),), {"make.py": code}, keep="all")
    kept = command.run_commands(made.section, made.contents, lambda *_: answers.PredictedCurve())
    names = zipfile.ZipFile(io.BytesIO(kept.folder)).namelist()
    assert {"make.py", "odd-?.txt"} <= set(names)
    assert [name for name in names if name.endswith("d/deep.txt")]


def test_a_digest_tells_a_rendered_file_from_a_copied_one():
    def digest_of(source):
        found = ForwardFiles(contents=(("a.py", "{{ 1 }}"),))
        argv, files = (("python", "a.py"),), (("a.py", source),)
        section = ForwardModel(model="command", argv=argv, files=files, installed=found)
        return External.of(ParameterProblem(forward=section)).digest

    assert digest_of("a.py.j2") != digest_of("a.py")


def test_the_program_of_a_fit_gets_the_parameters_of_the_user():
    """It got none, while the prediction with the fitted constants got all of them."""

    def forces(case):
        stretch = 1 - np.asarray(case["displacement_mm"]) / HEIGHT
        gain, constant = case["parameters"]["gain"], case["material"]["constants_MPa"]["C10"]
        return gain * 2 * math.pi * RADIUS**2 * constant * (stretch**-2 - stretch)

    function = command.PythonFunction.of(forces, "1")
    files = ForwardFiles(function=function.text, function_version="1")
    document = {
        "specimen": {"shape": "cylinder", "radius_mm": RADIUS, "height_mm": HEIGHT},
        "test": {"kind": "compression", "displacement_mm": 5.0},
        "material": {"model": "neo-hookean", "incompressible": True},
    }
    keys = {}
    for gain in (1.0, 3.0):
        forward = ForwardModel(model="python", installed=files)
        cell = replace(CellProblem.of(document), forward=forward, parameters={"gain": gain})
        fit = fit_problem(Cell(cell, "auto"))
        request = {"displacement_mm": POINTS, "material": {"constants_MPa": {"C10": C10}}}
        measured = Curve(POINTS, forces({**request, **cell.own_tables()}))
        assert fit.method == "external"
        found = fitted(FitJob(fit, (measured,)))
        assert found.constants == pytest.approx({"C10": C10}, rel=1e-4), found.message
        keys[gain] = fit_key(fit, [measured])
    assert keys[1.0] != keys[3.0]
