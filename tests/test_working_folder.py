"""A stranger's working folder: no verb opens, runs or obeys a file that the user did not name."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import urllib.request
from dataclasses import dataclass
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from study.ground import working_folder
from study.laboratory.tracker.tracker_recording import Errors
from tests.cli.small import CSV, pressed, responses, write_files
from tests.cli.test_numeric_factors import CENTRE
from tests.cli.test_numeric_factors import DESIGN as RANGES
from tests.cli.test_program import verbs
from tests.cli.test_require import PLATES
from tests.execution.loopback import loopback
from tests.shape_validation.test_shape import cylinder, write_csv
from tests.tracker_accuracy import virtual
from tests.tracker_accuracy.test_tracking import DISTANCE, MARKERS

PROGRAM = (sys.executable, str(Path(sys.executable).with_name("study")))

#: modules that libraries import where they are installed, of which we have none
OPTIONAL = (
    "numexpr", "bottleneck", "pyarrow", "cupy", "IPython", "ipykernel", "sksparse", "scikits",
    "pyamg", "bokeh", "crick", "cramjam", "uvloop", "asyncssh", "lxml", "orjson", "simplejson",
    "viztracer", "coverage", "colorama", "tqdm", "sitecustomize", "usercustomize", "conftest",
)  # fmt: skip

#: what a planted module or pickle does
RAN = """
import posix
handle = posix.open({mark!r}, posix.O_CREAT | posix.O_WRONLY | posix.O_APPEND)
posix.write(handle, __name__.encode() + b" ")
posix.close(handle)
"""

SETTINGS = {
    ".numba_config.yaml": "CACHE_DIR: {folder}/kernels\nDISABLE_JIT: 1\n",
    "matplotlibrc": "figure.facecolor: red\nbackend: module://json\n",
    "dask.yaml": "distributed: {{comm: {{require-encryption: true}}}}\n",
    "distributed.yaml": "distributed: {{comm: {{require-encryption: true}}}}\n",
    ".pdbrc": "import os\n",
    ".gmshrc": "General.Terminal = 1;\n",
    ".gmsh-options": "General.Terminal = 1;\n",
    "pytest.ini": "[pytest]\naddopts = -p json\n",
    "pyproject.toml": "[tool]\n",
    "setup.cfg": "[tool]\n",
    ".env": "NUMBA_CACHE_DIR={folder}/kernels\n",
}

#: a user's function from a module beside his notebook, which workers get, and then all verbs in the
#: same process, with the working folder first on its path, as a notebook has it: a function of the
#: package does not import from there either
DRIVER = """
import sys
del sys.path[0]
import json, os, pathlib, signal, threading, time
import study
from study.cli.app import run
sys.path.insert(0, "")
import mine
answer = study.run("python.toml", forward=mine.force, version="1", jobs=1, reports=None)
print("forces", json.dumps(list(answer.table["peak_force"])))
codes = []
def stop_after_the_first_record():
    while not any(pathlib.Path("results/demo/fits").glob("*.json")):
        time.sleep(0.1)
    os.kill(os.getpid(), signal.SIGINT)
for arguments in json.load(open(sys.argv[1])):
    if arguments[0] == "why":
        record = next(pathlib.Path("results/ranges/cases").rglob("record.json"))
        arguments.append(record.parent.name)
    if arguments[0] == "demo":  # takes minutes; stopped once its processes did something
        threading.Thread(target=stop_after_the_first_record, daemon=True).start()
    try:
        codes.append([arguments[0], run(arguments)])
    except BaseException as error:
        codes.append([arguments[0], repr(error)])
print("codes", json.dumps(codes))
"""

#: a forward model whose version and curve are said by Python itself, and one with a module of its
#: own beside it
COMMANDS = pressed(
    """[material]
model = "neo-hookean"
C10 = "5 kPa"
incompressible = true
[presets.forward.text]
model = "command"
argv = [["python", "-c", '''TEXT''']]
version = ["python", "-c", "import json, colorsys; print(json.dumps(1))"]
[presets.forward.file]
model = "command"
argv = [["python", "solver.py"]]
files = ["solver.py", "helper.py"]
version = ["python", "-c", "print(1)"]
[factors]
forward = ["text", "file"]
"""
    + responses(peak_force="0.05 N")
    + CSV,
    study='[study]\nname = "programs"\n',
    test='displacement = "3 mm"\nsteps = 2\n',
)
TEXT = """
import colorsys, json
points = json.load(open("problem.json"))["displacement_mm"]
lines = ["displacement_mm,force_N"] + [f"{x},{2 * x}" for x in points]
open("curve.csv", "w").write(chr(10).join(lines) + chr(10))
"""


@dataclass
class Opened:
    """Files of a folder that any process has opened since the last question, by inotify(7)."""

    folder: Path

    def __post_init__(self):
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._handle = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        opened = 0x20
        assert self._libc.inotify_add_watch(self._handle, os.fsencode(self.folder), opened) > 0

    def names(self):
        found = set()
        while True:
            try:
                events = os.read(self._handle, 1 << 16)
            except BlockingIOError:
                return found
            while events:
                _, mask, _, size = struct.unpack("iIII", events[:16])
                assert not mask & 0x4000, "more was opened than the kernel remembers"
                found.add(events[16 : 16 + size].rstrip(b"\0").decode())
                events = events[16 + size :]

    def close(self):
        os.close(self._handle)


@dataclass
class Hostile:
    """The folder, what was planted in it, and the file that a planted module makes when it runs."""

    folder: Path
    planted: set[str]
    mark: Path
    opened: Opened

    def run(self, *command, text=""):
        done = subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, check=False, input=text
        )
        self.assert_untouched()
        return done

    def assert_untouched(self):
        assert not self.mark.exists(), f"planted files were run: {self.mark.read_text()}"
        assert self.opened.names() & self.planted == set()


@cache
def modules():
    """Names of all modules of the standard library and of everything that is installed."""
    return {*sys.stdlib_module_names, *packages_distributions(), *OPTIONAL, "study"} - {"tests"}


@pytest.fixture
def hostile(tmp_path):
    folder, mark = tmp_path / "folder", tmp_path / "ran"
    folder.mkdir()
    write_files(folder)
    files = {f"{name}.py": RAN.format(mark=str(mark)) for name in modules()}
    files |= {name: text.format(folder=folder) for name, text in SETTINGS.items()}
    for name, text in files.items():
        (folder / name).write_text(text)
    opened = Opened(folder)
    yield Hostile(folder, set(files), mark, opened)
    opened.close()


def test_the_gate_sees_what_is_opened_and_run(hostile):
    """Of an interpreter that nothing protects, the planted modules are found out."""
    subprocess.run(
        [sys.executable, "-c", "import colorsys"], cwd=hostile.folder, check=True,
        env={k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"},
    )  # fmt: skip
    assert hostile.mark.exists()
    assert "colorsys.py" in hostile.opened.names()


def test_a_run_with_a_worker_and_its_server(hostile):
    done = hostile.run(*PROGRAM, "run", "small.toml", "--data", "data", "--jobs", "1", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["cases"]["done"] == 12
    assert "warning" not in done.stderr
    with subprocess.Popen(
        [*PROGRAM, "serve", "--port", "0"], cwd=hostile.folder, stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        address = server.stdout.readline().split()[0]
        with urllib.request.urlopen(address) as answer:
            assert "small" in answer.read().decode()
        server.send_signal(signal.SIGINT)
    hostile.assert_untouched()


def write_programs(folder):
    """Studies of programs, and of a function whose module imports another one."""
    (folder / "solver.py").write_text("import helper\n")
    (folder / "helper.py").write_text(TEXT)
    (folder / "programs.toml").write_text(COMMANDS.replace("TEXT", TEXT))
    (folder / "mine.py").write_text(
        "import slopes\n"
        "def force(problem):\n"
        "    return [slopes.SLOPE * x for x in problem['displacement_mm']]\n"
    )
    (folder / "slopes.py").write_text("SLOPE = 2.0\n")
    head, _, tail = COMMANDS.partition("[presets.forward.text]")
    (folder / "python.toml").write_text(
        head.replace('"programs"', '"mine"')
        + '[forward]\nmodel = "python"\n[factors]\nmaterial.C10 = ["5 kPa", "6 kPa"]\n'
        + tail[tail.index("[[response]]"):]
    )  # fmt: skip


def test_every_other_verb_a_users_function_and_programs(hostile, tmp_path):
    folder = hostile.folder
    write_programs(folder)
    (folder / "ranges.toml").write_text(
        RANGES.replace('kind = "latin-hypercube"\nruns = 30', 'kind = "central-composite"')
    )
    harder = (folder / "ranges.toml").read_text().replace('"ranges"', '"harder"')
    (folder / "harder.toml").write_text(harder.replace('"5 kPa"', '"6 kPa"'))
    grid = [(x, y) for x in range(5) for y in range(5)]
    rows = [f"{x},{y},{(x - 3) ** 2 + (y - 2) ** 2 + 1}" for x, y in grid]
    (folder / "bowl.csv").write_text("\n".join(["x,y,f", *rows]))
    (folder / "plates.toml").write_text(PLATES)
    (folder / "tracker.toml").write_text(DISTANCE)
    virtual.write(folder / "markers.csv", MARKERS, virtual.rows_of(Errors(1), 50.0))
    write_csv(folder / "scan.csv", cylinder(11.2, 9.0, 400, 1))
    (folder / "m.csv").write_text("displacement_mm,force_N\n1,.2\n2,.5\n3,.9\n")
    small = ("small.toml", "--data", "data")
    tasks = [
        ["new", "mine.toml"],
        ["inspect", "m.csv"],
        ["import", "bowl.csv", "--factors", "x,y", "--responses", "f", "--name", "imported"],
        ["plan", *small],
        ["virtual", "made", "--from", *small[:1], "--specimens", "2"],
        ["power", *small],
        ["run", "programs.toml", "--allow-commands", "--jobs", "1"],
        ["run", "ranges.toml", "--jobs", "1"],
        ["status", "ranges"],
        ["why"],
        ["report", "ranges", "--format", "html"],
        ["verify", "ranges"],
        ["diff", "ranges.toml", "harder.toml"],
        ["analyze", "ranges"],
        ["predict", "ranges", "--at", CENTRE],
        ["optimize", "bowl.csv", "--numeric", "x,y", "--minimize", "f"],
        ["invert", "ranges", "--to", "m.csv", "--no-confirm"],
        ["export", "ranges", "--as", "emulator"],
        ["solve", "problem.toml", "--vtu", "solved.vtu"],
        ["converge", "problem.toml"],
        ["calibrate", "calibration.toml", "--data", "data"],
        ["require", "plates.toml"],
        ["tracking", "tracker.toml"],
        ["shape", "solved.vtu", "--scan", "scan.csv"],
        ["doctor"],
        ["demo", "--jobs", "1"],
    ]
    covered = {task[0] for task in tasks} | {"serve"}
    assert covered == verbs()
    (tmp_path / "tasks.json").write_text(json.dumps(tasks))
    done = hostile.run(sys.executable, "-c", DRIVER, str(tmp_path / "tasks.json"))
    assert done.returncode == 0, done.stderr
    codes = json.loads(done.stdout.rpartition("codes ")[2])
    # an emulator needs more runs than these, one of two studies was not run, and a demo that was
    # stopped ends with 130
    others = {(verb, code) for verb, code in codes if code != 0}
    assert others <= {("invert", 3), ("diff", 2), ("why", 2), ("demo", 130)}, (others, done.stderr)
    forces = done.stdout.partition("forces ")[2].splitlines()[0]
    assert json.loads(forces) == pytest.approx([6.0, 6.0])
    versions = [
        json.loads(path.read_text())["content"]["solver"]["program"]["version"]
        for path in (folder / "results" / "programs" / "cases").rglob("*.json")
    ]
    assert versions == ["1", "1"]


def test_a_run_on_a_cluster_that_was_started_there(hostile, monkeypatch):
    pytest.importorskip("distributed", reason="Dask is not installed (extra 'dask')")
    monkeypatch.setenv("PYTHONSAFEPATH", "1")  # as docs/clusters.md starts them
    with loopback(hostile.folder, workers=1, is_fresh=True) as cluster:
        monkeypatch.delenv("PYTHONSAFEPATH")
        monkeypatch.setenv("DASK_CONFIG", "dask.yaml")
        done = hostile.run(
            *PROGRAM, "run", "small.toml", "--data", "data", "--scheduler", str(cluster.file),
            "--json",
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["cases"]["done"] == 12
    assert "warning: DASK_CONFIG=dask.yaml is ignored" in done.stderr
    hostile.assert_untouched()


def test_the_package_imports_nothing_beside_or_below_a_users_function():
    """Another thread, or a module of the user's that imports this package, imports for itself."""
    code = "def asks(): return _package_imports(sys._getframe())"
    asks = []
    for name in ("study.api.somewhere", "mine"):
        space = {"__name__": name, "sys": sys, "_package_imports": working_folder._package_imports}
        exec(code, space)
        asks.append(space["asks"])
    package, user = asks
    answers = []
    with working_folder.UserImports():
        assert package()
        assert not user()
        thread = threading.Thread(target=lambda: answers.append(package()))
        thread.start()
        thread.join()
    assert answers == [True]
