"""What every test shares: one thread a process, and the place of the shared measurements."""

import gc
import io
import os
import signal
import sys
import warnings
from pathlib import Path

import pytest
from hypothesis import settings

# Before any test imports numpy: pytest-xdist already uses the cores, and threads inside
# a worker would make times and the last digits of sums depend on the machine.
for _variable in (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
):
    os.environ.setdefault(_variable, "1")

# A process that imports the package takes 3.1 s where it compiles every module, and 1.0 s where an
# earlier one left them; tests start hundreds.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A sixth of the time of collecting 5,000 tests goes into looking for garbage, of which there is
# none: modules and tests stay. They are not looked at again while tests run, either.
gc.disable()

# A suite in the background of a shell is deaf to Ctrl-C, and so would be the programs that tests
# start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples every time, and no deadline: the first call of a kernel compiles it.
settings.register_profile("few", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("many", deadline=None, derandomize=True, max_examples=200)


def pytest_configure(config):
    """Try many examples in the long verification, and few in the suite."""
    settings.load_profile("many" if is_verification(config) else "few")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Let every test that is slow, or by examples, belong to the long verification too."""
    if is_verification(config):
        for item in items:
            if item.get_closest_marker("hypothesis") or item.get_closest_marker("slow"):
                item.add_marker(pytest.mark.verify)


def pytest_collection_finish():
    """Look for garbage from here on, as rarely as the program itself does."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


def is_verification(config):
    """Whether this is ``make verify``."""
    return config.getoption("markexpr") == "verify"


ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "tests" / "reporting"


@pytest.fixture(scope="session")
def data_dir():
    """Folder of the shared measurements: ``STUDY_DATA`` if set, else ``../shared/data``."""
    folder = Path(os.environ.get("STUDY_DATA") or ROOT.parent / "shared" / "data").resolve()
    if not folder.is_dir():
        pytest.skip(f"shared measurement folder not found: {folder} (set STUDY_DATA)")
    return folder


@pytest.fixture(autouse=True)
def _solutions_of_this_test_alone(monkeypatch):
    """Let no test see what another one solved, perhaps by a solver that it put in place of ours."""
    if fit_task := sys.modules.get("study.simulation.fit_task"):
        monkeypatch.setattr(fit_task, "_first_solutions", {})


@pytest.fixture(scope="session", autouse=True)
def _nothing_flushed():
    """Leave files to the cache of the system: what a test writes need outlive no power failure.

    A small study flushes 64 times. What a failure at each operation of the disk leaves behind is
    tested by a file system that forgets what was not flushed (``tests/record/disk.py``).
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _tasks_in_this_process():
    """Do what a study computes here: a process takes a second to start, and gives the same numbers.

    What has a limit of time still gets processes, and so does what tests ask :func:`processes` for.
    """
    from study.execution.local import Inline, Loky

    in_processes = Loky.run

    def run(self, tasks, finished=None):
        perform = self.perform
        if _apart or self.limit_s is not None or not perform.__module__.startswith("study."):
            return in_processes(self, tasks, finished)

        def quietly(task):
            with warnings.catch_warnings():  # a worker process shows its warnings to nobody
                warnings.simplefilter("ignore")
                return perform(task)

        return Inline(quietly).run(tasks, finished)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Loky, "run", run)
        yield


#: whether the test that runs now looks at drawings
_looked_at = False


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Write drawings for the tests of pages and for those that are marked, fixtures included."""
    global _looked_at
    _looked_at = item.path.is_relative_to(PAGES) or item.get_closest_marker("drawings") is not None


@pytest.fixture(scope="session", autouse=True)
def _drawings_without_ink():
    """Build every figure, and leave its file empty, for writing it is a third of a small report.

    What fails while a figure is built still fails; what is written is the business of
    ``tests/reporting``, and of tests that are marked with ``drawings``.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    whole = FigureCanvasSVG.print_svg

    def print_svg(sheet, target, **more):
        if _looked_at or not isinstance(target, io.StringIO):
            whole(sheet, target, **more)
        else:
            target.write('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"/>')

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FigureCanvasSVG, "print_svg", print_svg)
        yield


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without their drawings, for tests of their numbers: a drawing takes up to a second."""
    from study.api import calibrating
    from study.reporting.figures import axes, mesh_figures

    for module in (axes, mesh_figures, calibrating):
        monkeypatch.setattr(module, "render", lambda draw, name, title: "<svg/>")


#: one entry while a test that asked for processes runs
_apart = []


@pytest.fixture
def processes():
    """Processes for the tasks of a study, as users have them."""
    _apart.append(True)
    yield
    _apart.clear()
