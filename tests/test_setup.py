"""Set-up on a machine that lacks something: the message names the command that mends it."""

import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parent.parent
SH = shutil.which("sh") or "/bin/sh"
libraries = runpy.run_path(str(ROOT / "scripts" / "system_libraries.py"))

MISSING = "OSError: libGLU.so.1: cannot open shared object file: No such file or directory"
# What the gmsh wheel links, by the names of Debian and Ubuntu.
LINKED = (
    "libglu1-mesa libgl1 libopengl0 libxcursor1 libxft2 libxinerama1 libxrender1 libxfixes3 "
    "libxext6 libfontconfig1 libgomp1"
)
COMMAND = "sudo apt-get update && sudo apt-get install -y --no-install-recommends libglu1-mesa"


def test_message_names_the_command_and_every_library_but_for_a_missing_wheel():
    text = libraries["message"](MISSING)
    assert "libGLU.so.1" in text
    assert COMMAND in text
    assert set(text.split()) >= set(LINKED.split())
    text = libraries["message"]("ModuleNotFoundError: No module named 'gmsh'")
    assert "make setup" in text
    assert "apt-get" not in text


@pytest.mark.parametrize(
    ("answers", "mend", "code"),
    [
        ([None], None, 0),  # works: nothing is installed
        ([MISSING], None, 1),
        ([MISSING, None], lambda: True, 0),
        ([MISSING], lambda: False, 1),
    ],
)
def test_what_is_missing_is_installed_with_rights_or_its_command_is_printed(
    capsys, answers, mend, code
):
    left = iter(answers)
    found = libraries["main"](
        check=lambda: next(left),
        mend=mend or (lambda: pytest.fail("installed")),
        may_install=mend is not None,
    )
    assert found == code
    assert (COMMAND in capsys.readouterr().err) is (code == 1)


def test_install_goes_on_after_an_update_that_failed():
    calls = []

    def call(command):
        calls.append(list(command))
        return 100 if command[1] == "update" else 0

    assert libraries["install"](call)
    assert [command[1] for command in calls] == ["update", "install"]
    assert "libglu1-mesa" in calls[1]


def test_the_check_is_an_import(tmp_path, monkeypatch):
    (tmp_path / "gmsh.py").write_text(f"raise OSError({MISSING.removeprefix('OSError: ')!r})\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert libraries["import_error"](sys.executable) == MISSING
    assert libraries["is_missing_library"](MISSING)


def test_this_machine_is_set_up():
    assert libraries["import_error"](sys.executable) is None


@pytest.fixture
def machine(tmp_path):
    """Bare machine: a copy of the set-up script, and a PATH with the few tools it uses."""
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "setup.sh", tmp_path / "scripts")
    # Small programs of our own, never links to the real ones.
    tool(tmp_path, "dirname", 'echo "${1%/*}"')
    tool(tmp_path, "uname", "echo x86_64")
    tool(tmp_path, "id", "echo 1000")
    return tmp_path


def tool(machine, name, body, folder="bin"):
    """Put a small program on the PATH of the bare machine, or into its environment."""
    path = machine / folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    # Writing through a link would overwrite the real program of this machine.
    path.unlink(missing_ok=True)
    path.write_text(f"#!{SH}\n{body}\n")
    path.chmod(0o755)


def set_up(machine):
    script, path = str(machine / "scripts" / "setup.sh"), {"PATH": str(machine / "bin")}
    return subprocess.run([SH, script], env=path, capture_output=True, text=True, check=False)


ENVIRONMENT = ".venv/bin"
PYTHON_WITHOUT_VENV = 'case "$2" in *ensurepip*) exit 1 ;; *print*) echo 3.12 ;; esac'


@pytest.mark.parametrize(
    ("tools", "printed", "told"),
    [
        # The script asks for the version with -c, and prints it with --version.
        (
            {"python3": '[ "$1" = --version ] && echo Python 3.9.2 || exit 1'}, [],
            ["Python 3.11 or newer is needed; found: Python 3.9.2",
             "sudo apt-get install python3 python3-venv", "make PYTHON="],
        ),
        (
            {"python3": PYTHON_WITHOUT_VENV}, [],
            ["sudo apt-get update && sudo apt-get install -y python3.12-venv"],
        ),
        (
            {"python3": PYTHON_WITHOUT_VENV, "id": "echo 0",
             "apt-get": 'echo "apt-get $*"; exit 1'},
            ["apt-get install -y python3.12-venv"],
            ["apt-get could not install python3.12-venv"],
        ),
    ],
    ids=["old python", "no venv", "no venv, as root"],
)  # fmt: skip
def test_setup_says_what_is_missing_or_installs_it_as_root(machine, tools, printed, told):
    for name, body in tools.items():
        tool(machine, name, body)
    run = set_up(machine)
    assert run.returncode == 1
    assert [words for words in printed if words not in run.stdout] == []
    assert [words for words in told if words not in run.stderr] == []
    assert not (machine / ".venv").exists()


def test_setup_falls_back_without_the_fast_solver(machine):
    python = "case \"$*\" in *'.[fast'*) exit 1 ;; *'.[test]'*) echo installed ;; esac"
    tool(machine, "python", python, ENVIRONMENT)
    run = set_up(machine)
    assert run.returncode == 0, run.stderr
    assert "again without the fast 3D solver" in run.stderr
    assert "installed" in run.stdout


def test_setup_asks_for_the_fast_solver_on_x86_64_alone(machine):
    tool(machine, "python", 'echo "$*"', ENVIRONMENT)
    extras = {}
    for processor in ("x86_64", "aarch64"):
        tool(machine, "uname", f"echo {processor}")
        extras[processor] = re.findall(r"--editable \.\[(.*)\]", set_up(machine).stdout)
    assert extras == {"x86_64": ["fast,test"], "aarch64": ["test"]}


@pytest.mark.parametrize("works", [True, False])
def test_setup_installs_the_locked_versions_with_uv_or_else_with_pip(machine, works):
    python = 'case "$*" in *platform*) echo linux x86_64 3.11 ;; *) echo "python $*" ;; esac'
    tool(machine, "python", python, ENVIRONMENT)
    tool(machine, "uv", f'echo "uv $*"\nexit {int(not works)}', ENVIRONMENT)
    run = set_up(machine)
    assert run.returncode == 0, run.stderr
    installed = [line for line in run.stdout.splitlines() if "requirements.lock" in line]
    assert [line.split()[0] for line in installed] == (["uv"] if works else ["uv", "python"])
    assert all("--require-hashes" in line for line in installed)


def test_setup_fetches_nothing_without_a_hash_and_compiles_what_it_installs():
    script = (ROOT / "scripts" / "setup.sh").read_text(encoding="utf-8")
    locked = script[script.index("with_uv() {") : script.index("install_package() {")]
    (package,) = [line for line in locked.splitlines() if "--editable" in line]
    assert "--no-deps --no-build-isolation" in package
    assert "\nsetuptools==" in (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "pip install -q --compile-bytecode" in locked
    assert "-m compileall -q study" in script


def test_every_locked_version_is_one_for_the_oldest_python():
    """Debian 12 has Python 3.11.2: a version that asks for 3.11.5 ends the set-up there."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    oldest = project["requires-python"].removeprefix(">=") + ".0"
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    asked = {
        package.name: package.metadata.get("Requires-Python", "")
        for package in metadata.distributions()
        if f"\n{package.name}=={package.version} " in lock
    }
    if len(asked) < 50:
        pytest.skip("the newest versions are installed here, not those of the lock")
    assert [name for name, versions in asked.items() if oldest not in SpecifierSet(versions)] == []


TARGETS = ("setup", "demo", "test", "verify", "bench", "docs", "gallery", "check")


@pytest.mark.parametrize("target", TARGETS)
def test_make_knows_the_target(target):
    make = shutil.which("make")
    if make is None:
        pytest.skip("make is not on this machine")
    variables = {k: v for k, v in os.environ.items() if not k.startswith("MAKE")}
    run = subprocess.run(
        [make, "-n", target], cwd=ROOT, env=variables, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr


def test_readme_names_the_two_commands_first():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"^make (\w+)", readme, flags=re.MULTILINE)
    assert commands[:2] == ["demo", "test"]
    assert set(commands) <= set(TARGETS)
