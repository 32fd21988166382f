"""The gates are alive: a breach is planted into a small copy of the house, and each one sees it.

A gate that nobody has seen fail may check nothing. The copy has the rooms of the project
with empty modules, and the project's own pyproject.toml.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numpydoc.validate import validate

from scripts import ledger
from tests import house as rules

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def house(tmp_path):
    """Copy of the project with a room and no content."""
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "study").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / "study" / "__init__.py").write_text('"""Nothing yet."""\n')
    return tmp_path


@pytest.fixture
def furnished(tmp_path):
    """Copy of the project with everything in it."""
    for name in ("pyproject.toml", "study", "docs"):
        source = ROOT / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "*.png", "*.svg")
            shutil.copytree(source, tmp_path / name, ignore=ignored)
        else:
            shutil.copy(source, tmp_path)
    return tmp_path


def gate(house, *command):
    """Run a gate in the copy, with the tools of this environment."""
    tool = str(Path(sys.executable).parent / command[0])
    environment = {**os.environ, "PYTHONPATH": str(house), "NO_COLOR": "1"}
    return subprocess.run(
        [tool, *command[1:]], cwd=house, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


def assert_breach(house, command, *said):
    """Run a gate that must see a breach, and say so."""
    run = gate(house, *command)
    assert run.returncode == 1, run.stdout + run.stderr
    for words in said:
        assert words in run.stdout + run.stderr


STYLE = ("ruff", "check", "--no-cache", ".")
FORMAT = ("ruff", "format", "--no-cache", "--check", ".")
TYPES = ("mypy", "study")
LAYERS = ("lint-imports", "--no-cache")
GENERATED = ("python", "scripts/generate_kernels.py", "--check")
TESTS = ("python", "-m", "pytest", "-q", "-p", "no:cacheprovider")


@pytest.mark.parametrize("command", [STYLE, FORMAT, TYPES], ids=lambda c: " ".join(c[:2]))
def test_a_gate_lets_the_clean_house_pass(house, command):
    run = gate(house, *command)
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize(
    ("code", "rule"),
    [
        ("import os\n", "F401"),
        ("def area(radius):\n    return radius\n", "D103"),
        ("import numpy as np\n\nnp.random.seed(1)\n", "NPY002"),
        ("x = 1  # " + 100 * "-" + "\n", "E501"),
        (f'def crowd({", ".join("abcdefghi")}):\n    """Take nine."""\n', "PLR0913"),
        ('def long():\n    """Do much."""\n' + 51 * "    print()\n", "PLR0915"),
        (
            'def branched(x):\n    """Go many ways."""\n'
            + "".join(f"    if x > {n}:\n        print({n})\n" for n in range(12)),
            "C901",
        ),
    ],
)
def test_style_sees(house, code, rule):
    (house / "study" / "breach.py").write_text('"""A breach."""\n\n' + code)
    assert_breach(house, STYLE, rule)


WRONG = "def area(radius):\n    return radius\n\n\nwidth: float = 'wide'\n"


def test_format_sees_single_quotes_and_types_a_missing_and_a_wrong_type(house):
    (house / "study" / "breach.py").write_text(WRONG)
    assert_breach(house, FORMAT, "breach.py")
    assert_breach(house, TYPES, "[no-untyped-def]", "[assignment]")


WINGS = "Each wing imports only those below it"
CIRCLE = "No circle between the modules of a room, nor between rooms"
# Module that breaks the rule, the import it makes, and the contract that must say so.
BREACHES = [
    ("ground/a", "study.mechanics.setup.setup", WINGS),
    ("mechanics/setup/a", "study.record.record", WINGS),
    ("statistics/analysis/a", "study.simulation.job", WINGS),
    ("harness/runner/a", "study.reporting.content.text", WINGS),
    ("utils", "study.ground.errors", WINGS),
    ("mechanics/element/a", "study.mechanics.forward.model", "Inside mechanics"),
    ("statistics/convergence/a", "study.statistics.analysis.anova", "Inside statistics"),
    ("harness/design/a", "study.harness.runner.batch", "Inside harness"),
    ("simulation/cell", "study.simulation.job", "Inside simulation"),
    ("laboratory/registration/a", "study.laboratory.haptics.haptic_export", "Inside laboratory"),
    ("reporting/content/a", "study.reporting.output.page", "Inside reporting"),
    ("harness/design/generators", "study.harness.design.layouts", CIRCLE),
    (
        "harness/runner/a",
        "study.mechanics.setup.setup",
        "harness computes no case: it asks a forward model",
    ),
    (
        "reporting/output/a",
        "study.mechanics.forward.model",
        "reporting knows statistics, records and results, no mechanics and no harness",
    ),
    (
        "laboratory/tracker/a",
        "study.harness.runner.batch",
        "laboratory uses mechanics, no design of experiments",
    ),
    (
        "mechanics/solver/a",
        "pandas",
        "the solver, forward models and calibration know no data frame",
    ),
    ("harness/runner/a", "gmsh", "gmsh, meshio and scikit-fem only in rooms of finite elements"),
    ("cli/a", "matplotlib.pyplot", "matplotlib and seaborn only in reporting"),
    ("reporting/output/a", "statsmodels.api", "statsmodels only in statistics"),
    ("harness/runner/a", "numba", "numba only through compilation"),
    ("harness/runner/a", "joblib", "joblib only in execution"),
    ("harness/runner/b", "pydantic", "pydantic only where keys of files are declared"),
    ("laboratory/tracker/a", "pydantic_core", "pydantic-core only where JSON is read"),
    ("api/a", "cloudpickle", "cloudpickle only for a function given to study.run"),
    (
        "execution/a",
        "study.ground.curve",
        "execution knows of errors, the working folder and the reader of files",
    ),
]


@pytest.mark.parametrize("breaches", [BREACHES[0::2], BREACHES[1::2]])
def test_layers_sees_every_breach(furnished, breaches):
    """Half of them are planted into one copy, to save time; each is named below its contract."""
    for number, (module, imported, _) in enumerate(breaches):
        # inside a function, because that is where an import of a heavy package stands
        plant(furnished, f"{module}.py", f"\n\ndef late_{number}():\n    import {imported}\n")
    run = gate(furnished, *LAYERS)
    assert run.returncode == 1
    broken = {line.partition(" BROKEN")[0] for line in run.stdout.splitlines() if "BROKEN" in line}
    # an import that goes up closes a circle, too
    assert broken == {contract for _, _, contract in breaches} | {CIRCLE}, run.stdout + run.stderr
    for module, _, contract in breaches:
        name = f".{module.rpartition('/')[2]} -> " if contract == CIRCLE else f"study.{module}"
        below = run.stdout.partition(f"\n{contract}\n---")[2]
        assert name.replace("/", ".") in below.partition("\n---")[0], (module, contract)


def test_layers_sees_an_exception_that_nobody_needs(furnished):
    text = (furnished / "pyproject.toml").read_text()
    stale = '"study.ground.compilation -> numba", "study.ground.units -> numba"'
    (furnished / "pyproject.toml").write_text(
        text.replace('"study.ground.compilation -> numba"', stale)
    )
    assert_breach(furnished, LAYERS, "study.ground.units -> numba")


def test_generated_sees_an_edited_coefficient(furnished):
    shutil.copytree(ROOT / "scripts", furnished / "scripts")
    assert gate(furnished, *GENERATED).returncode == 0
    kernels = furnished / "study" / "mechanics" / "element" / "element_stiffness.py"
    text = kernels.read_text(encoding="utf-8")
    edited = text.replace("c_FF * F + c_FG * G", "2.0 * c_FF * F + c_FG * G", 1)
    assert edited != text
    kernels.write_text(edited, encoding="utf-8")
    run = gate(furnished, *GENERATED)
    assert run.returncode == 1
    assert "+            nodal[a, 6 + i] = c_FF * F + c_FG * G" in run.stdout
    assert "python scripts/generate_kernels.py" in run.stderr
    # The check leaves the file as it is: a gate that mended it would hide the breach.
    assert kernels.read_text(encoding="utf-8") == edited


def plant(root, module, code):
    """Add code to a module of a copy, or make the module."""
    path = root / "study" / module
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(code)


def test_rules_see_a_declared_package_that_nobody_imports(furnished):
    for path in (furnished / "study").rglob("*.py"):
        path.write_text(path.read_text().replace("import seaborn", "import this"))
    assert rules.unused_dependencies(furnished) == {"seaborn"}


@pytest.mark.parametrize(
    ("rule", "module", "code", "breach"),
    [
        (rules.undeclared_imports, "ground/units", "import sympy", "study/ground/units.py: sympy"),
        (
            rules.late_imports, "api/doctor", "def late():\n    from study.ground.units import x",
            "study/api/doctor.py:{line}: study.ground.units",
        ),
        (rules.constants_in_tuples, "ground/units", "_A, _B = 1, 2",
         "study/ground/units.py:{line}: _A, _B"),
        (rules.environment_readers, "ground/units", "import os\n\nx = os.environ",
         "study/ground/units.py"),
    ],
)  # fmt: skip
def test_rules_see_a_breach_in_a_furnished_house(furnished, rule, module, code, breach):
    plant(furnished, f"{module}.py", f"\n\n{code}\n")
    line = len((furnished / "study" / f"{module}.py").read_text().splitlines())
    found = [name.replace("(_A, _B)", "_A, _B") for name in rule(furnished)]
    assert found == [breach.format(line=line)]


def test_rules_see_an_untyped_value(furnished):
    before = rules.untyped(furnished)
    plant(furnished, "ground/units.py", "\nx: Any = 1\n")
    assert rules.untyped(furnished) == before + 1


FIELDS = "".join(f"    x{k}: int\n" for k in range(rules.MOST_FIELDS))
WIDE = f"@dataclass(frozen=True)\nclass Wide:\n{FIELDS}"
LATE_STATISTICS = "from scipy.stats import qmc\n\n\ndef late():\n    {}\n"
SEARCH = "{}\n\n\ndef lowest(f):\n    return {}optimize.minimize(f, 0.0).x\n"
UNITS = "study/ground/units.py"


@pytest.mark.parametrize(
    ("rule", "code", "breaches"),
    [
        (
            rules.untyped_aliases, "Tables = dict[str, Any]\nFree: TypeAlias = Any\n",
            [f"{UNITS}: Tables", f"{UNITS}: Free"],
        ),
        (rules.wide_classes, WIDE, {}),
        (rules.wide_classes, WIDE + "    y: int\n", {f"{UNITS}: Wide": rules.MOST_FIELDS + 1}),
        *(
            (rules.stray_statistics, LATE_STATISTICS.format(line), [f"{UNITS}:5: {line}"])
            for line in (
                "import scipy.stats", "from scipy import stats", "from scipy.stats import t"
            )
        ),
        (
            rules.unread_searches, SEARCH.format("from scipy import optimize", ""),
            [f"{UNITS}: lowest"],
        ),
        (rules.unread_searches, SEARCH.format("import scipy", "scipy."), [f"{UNITS}: lowest"]),
        (
            rules.vague_names, "\n\ndef told(x, one):\n    made = x\n    return made\n",
            [f"{UNITS}:3: one", f"{UNITS}:3: told", f"{UNITS}:4: made"],
        ),
    ],
)  # fmt: skip
def test_rules_see_a_breach_in_a_bare_house(house, rule, code, breaches):
    plant(house, "ground/units.py", code)
    assert rule(house) == breaches


def test_rules_see_a_small_helper_with_one_caller(house):
    helper = '\n\ndef _half(x):\n    """Half."""\n    return x / 2\n'
    caller = "\n\ndef quarter(x):\n    return _half(x) / 2\n"
    plant(house, "ground/units.py", helper + caller)
    assert rules.small_helpers(house) == ["study/ground/units.py: _half"]
    plant(house, "ground/units.py", "\n\ndef third(x):\n    return _half(x) / 1.5\n")
    assert rules.small_helpers(house) == []
    plant(house, "a.py", helper.replace("Half.", "Half (Hardy 1908).") + caller)
    plant(house, "b.py", helper.replace("_half", "_tested") + caller.replace("_half", "_tested"))
    (house / "tests" / "test_b.py").write_text("from study.b import _tested\n")
    plant(house, "c.py", helper.replace("return", 6 * "x += 1\n    " + "return") + caller)
    assert rules.small_helpers(house) == []


def test_rules_see_a_docstring_longer_than_its_function(house):
    long = '\n\ndef {}(x):\n    """Give x.\n\n    As it is.\n    """\n    return x\n'
    plant(house, "ground/units.py", long.format("same") + "\n\ndef short(x):\n    return x\n")
    plant(house, "__init__.py", '\n_PUBLIC = ("solve",)\n')
    plant(house, "api.py", long.format("solve"))
    assert rules.long_docstrings(house) == ["study/ground/units.py: same"]


def test_rules_see_deep_empty_and_namesake_modules_and_classes(house):
    for folder in ("fem", "fem/mesh", "fem/mesh/size", "api"):
        (house / "study" / folder).mkdir()
        plant(house, f"{folder}/__init__.py", '"""A package."""\n')
    plant(house, "api/__init__.py", "\nNAMES = 1\n")
    for module in ("fem/result.py", "api/result.py", "api/other.py"):
        plant(house, module, "\n\nclass Response: ...\n")
    assert rules.deep_packages(house) == ["study/fem/mesh/size"]
    assert len(rules.empty_packages(house)) == 4  # study, and those of fem
    assert set(rules.shared_module_names(house)) == {"result"}
    assert set(rules.shared_class_names(house)) == {"Response"}
    assert len(rules.shared_class_names(house)["Response"]) == 3


def test_rules_see_a_name_that_nobody_uses(house):
    code = "\n\ndef lonely():\n    return 1\n\n\ndef shown():\n    return 1\n"
    plant(house, "ground/units.py", code)
    (house / "study" / "page.html").write_text("{{ table.shown }}")
    assert rules.unused(house) == ["lonely"]


def test_rules_see_a_test_below_a_door(house):
    (house / "tests" / "test_a.py").write_text("from study.mechanics.mesh import mesher\n")
    (house / "tests" / "test_b.py").write_text("import study\nfrom study.api import run\n")
    assert rules.tests_below_a_door(house) == ["tests/test_a.py"]


def test_rules_see_a_public_function_without_a_word():
    """A name that numpydoc finds fault with, and a class that is gone."""
    errors = dict(validate(f"{__name__}.unexplained")["errors"])
    assert {"PR01", "RT01"} <= set(errors)


def unexplained(steps):
    """Count."""
    return steps


def test_rules_see_an_extension_point_that_is_gone(house):
    assert "Energy: no class has this name" in rules.poorly_explained(house)


def test_the_ledger_counts_every_line_once():
    head = '"""Head.\n\nMore.\n"""\n\n# why\n'
    value = 'X = """\n\n# no comment\n"""\n\n\n'
    text = head + value + 'def f():\n    """Say."""\n    return X  # here\n'
    counts = ledger.lines_of(text)
    assert counts == ledger.Lines(files=1, code=6, docstring=5, comment=1, blank=3)
    assert counts.all == len(text.splitlines())


def test_the_ledger_sees_a_room_that_grows_and_writes_it_down(house, capsys):
    plant(house, "mechanics/solver/mesh.py", "x = 1\n")
    assert ledger.main(["--write"], root=house) == 0
    assert ledger.main(["--check"], root=house) == 0
    plant(house, "mechanics/solver/mesh.py", "y = 1\n\n\nclass Mesh: ...\n")
    capsys.readouterr()
    assert ledger.main(["--check"], root=house) == 1
    printed = capsys.readouterr().out
    assert "study/mechanics/solver: 3 code, the budget is 1" in printed
    assert "study/mechanics/solver: 5 lines, the budget is 1" in printed
    assert "unused: Mesh is new" in printed
    assert ledger.main(["--write"], root=house) == 0
    assert "grown: study/mechanics/solver: 3 code, the budget is 1" in capsys.readouterr().out
    assert ledger.main(["--check"], root=house) == 0


@pytest.mark.parametrize(
    ("file", "code", "said"),
    [
        ("tests/test_breach.py",
         "import warnings\n\n\ndef test_warns():\n    warnings.warn('careful', stacklevel=1)\n",
         "UserWarning: careful"),
        ("study/breach.py", '"""A breach.\n\n>>> 1 + 1\n3\n"""\n', "study.breach"),
    ],
)  # fmt: skip
def test_a_warning_fails_a_test_and_doctests_of_the_package_are_run(house, file, code, said):
    (house / file).write_text(code)
    assert_breach(house, (*TESTS, file.partition("/")[0]), said)


def test_slow_tests_are_left_out_unless_asked_for(house):
    (house / "tests" / "test_breach.py").write_text(
        "import pytest\n\n\n@pytest.mark.slow\n@pytest.mark.verify\n"
        "def test_long():\n    raise RuntimeError\n\n\ndef test_short():\n    pass\n"
    )
    assert gate(house, *TESTS, "tests").returncode == 0
    assert gate(house, *TESTS, "-m", "verify", "tests").returncode == 1


GATES = ("test", "lint", "format-check", "types", "layers", "generated")


@pytest.mark.parametrize("broken", [None, *GATES])
def test_ci_names_the_gate_that_failed(tmp_path, broken):
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
    make = tmp_path / "bin" / "make"
    make.parent.mkdir()
    make.write_text(
        f'#!/bin/sh\nfor last; do :; done\necho "ran $last"\n[ "$last" != "{broken}" ]\n'
    )
    make.chmod(0o755)
    run = subprocess.run(
        [str(tmp_path / ".ci" / "run")], env={"PATH": f"{make.parent}:{os.environ['PATH']}"},
        stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip
    # The others still run: one look at the log tells everything that is wrong.
    assert [name for name in GATES if f"ran {name}\n" not in run.stdout] == []
    assert run.returncode == (0 if broken is None else 1)
    assert run.stderr.strip() == ("" if broken is None else f"failed: {broken}")
