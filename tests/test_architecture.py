"""Rules of the house that no linter knows; the layers are checked by import-linter."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FILES = sorted((ROOT / "study").rglob("*.py"))
LONGEST_FILE = 400
# Names of distributions that are imported under another name.
IMPORTED_AS = {"scikit-fem": "skfem"}
# Read the environment: the command line, and the runner, which caps threads of its workers.
MAY_READ_ENVIRONMENT = {"cli.py", "runner"}


def trees() -> Iterator[tuple[Path, ast.Module]]:
    for path in FILES:
        yield path.relative_to(ROOT), ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.Module) -> Iterator[str]:
    """Top-level names of the packages that a module imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


def declared() -> set[str]:
    """Import names of everything that pyproject.toml lets the package use."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    requirements = [*project["dependencies"], *extras["fast"], *extras["dask"]]
    names = {re.split(r"[\[><=;~! ]", requirement)[0] for requirement in requirements}
    return {IMPORTED_AS.get(name, name) for name in names} | {"distributed"}


def test_every_imported_package_is_declared() -> None:
    known = declared() | set(sys.stdlib_module_names) | {"study"}
    strangers = {
        f"{path}: {name}" for path, tree in trees() for name in imported(tree) if name not in known
    }
    assert not strangers


def test_no_file_is_too_long() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in FILES}
    assert {path: n for path, n in lengths.items() if n > LONGEST_FILE} == {}


def forbidden(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """What could run code from a file, or vanish under ``python -O``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield node.lineno, "assert (raise instead: asserts vanish under -O)"
        elif isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec"}:
                yield node.lineno, node.func.id
            elif isinstance(node.func, ast.Attribute) and node.func.attr in {"eval", "query"}:
                yield node.lineno, f".{node.func.attr}() evaluates text as code"
    if {"pickle", "marshal", "shelve", "dill"} & set(imported(tree)):
        yield 1, "pickle and its kin run code when they are read"


def test_no_text_from_a_file_is_ever_run() -> None:
    found = [f"{path}:{line}: {what}" for path, tree in trees() for line, what in forbidden(tree)]
    assert found == []


@pytest.mark.parametrize(
    "code",
    [
        "assert x",
        "eval(x)",
        "exec(x)",
        "table.query(x)",
        "import pickle",
        "from pickle import load",
    ],
)
def test_the_search_sees_a_breach(code: str) -> None:
    assert list(forbidden(ast.parse(code)))


def reads_environment(tree: ast.Module) -> bool:
    return any(
        isinstance(node, ast.Attribute) and node.attr in {"environ", "getenv", "putenv"}
        for node in ast.walk(tree)
    )


def test_no_environment_variable_is_read_below_the_command_line() -> None:
    readers = {str(path) for path, tree in trees() if reads_environment(tree)}
    assert {p for p in readers if Path(p).parts[1] not in MAY_READ_ENVIRONMENT} == set()
