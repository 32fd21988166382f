"""Rules of the house that no linter knows: each looks at a folder and names every breach.

:mod:`tests.test_architecture` holds the project to them, :mod:`tests.test_gates` plants a
breach into a copy for each, because a gate that nobody has seen fail may check nothing.
"""

from __future__ import annotations

import ast
import csv
import inspect
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numpydoc.docscrape import FunctionDoc, NumpyDocString

LONGEST_FILE = 400
#: lines of code of a function, without its docstring
LONGEST_FUNCTION = 60
LARGEST_PACKAGE = 16
#: fields of a dataclass
MOST_FIELDS = 12
#: names of distributions that are imported under another name
IMPORTED_AS = {"scikit-fem": "skfem", "pydantic-core": "pydantic_core"}
#: extras of what the package itself never imports: tests, and the documentation site
OUTSIDE = {"test", "docs"}
#: rooms whose modules carry compiled kernels: importing one loads numba, so it may be late
COMPILED = {"fem", "surface", "viscoelasticity"}
#: rooms that may ask scipy.stats for distributions and tests
STATISTICS = {"analysis", "response_surface", "registration", "tracker_accuracy"}
#: what any room may ask it for: points that fill a space evenly
POINTS = "scipy.stats.qmc"
#: read the environment: the command line, and those who cap the threads of workers,
#: keep the working folder out of programs, or place the user's caches
MAY_READ_ENVIRONMENT = {"cli", "runner", "execution", "working_folder.py", "private_folder.py"}


def trees(root: Path) -> Iterator[tuple[Path, ast.Module]]:
    """Every module of the package below a root, with its syntax."""
    for path in sorted((root / "study").rglob("*.py")):
        yield path.relative_to(root), ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.Module) -> Iterator[str]:
    """Top-level names of the packages that a module imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


def declared(root: Path) -> set[str]:
    """Import names of everything that pyproject.toml lets the package use."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    extras = [
        name
        for extra, names in project["optional-dependencies"].items()
        if extra not in OUTSIDE
        for name in names
    ]
    names = {re.split(r"[\[><=;~! ]", item)[0] for item in [*project["dependencies"], *extras]}
    return {IMPORTED_AS.get(name, name) for name in names}


def undeclared_imports(root: Path) -> set[str]:
    """Packages that are imported and not declared."""
    known = declared(root) | set(sys.stdlib_module_names) | {"study"}
    return {
        f"{path}: {name}"
        for path, tree in trees(root)
        for name in imported(tree)
        if name not in known
    }


def unused_dependencies(root: Path) -> set[str]:
    """Packages that are declared and never imported."""
    return declared(root) - {name for _, tree in trees(root) for name in imported(tree)}


def long_files(root: Path) -> dict[str, int]:
    """Modules longer than anybody wants to read."""
    lengths = {
        str(path.relative_to(root)): len(path.read_text(encoding="utf-8").splitlines())
        for path in (root / "study").rglob("*.py")
    }
    return {path: n for path, n in lengths.items() if n > LONGEST_FILE}


def long_functions(root: Path) -> dict[str, int]:
    """Functions longer than a page."""
    lengths = {
        f"{path}:{node.name}": _lines_of_code(node)
        for path, tree in trees(root)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    }
    return {name: n for name, n in lengths.items() if n > LONGEST_FUNCTION}


def _lines_of_code(node: ast.FunctionDef) -> int:
    first = node.body[0]
    said = first if ast.get_docstring(node) else None
    length = (node.end_lineno or 0) - node.lineno + 1
    return length - ((said.end_lineno or 0) - said.lineno + 1 if said else 0)


def crowded_packages(root: Path) -> dict[str, int]:
    """Packages with more modules and sub-packages than a newcomer can hold."""
    found = {}
    for init in (root / "study").rglob("__init__.py"):
        folder = init.parent
        if folder == root / "study":
            continue  # the rooms themselves, listed in docs/architecture.md
        entries = [p for p in folder.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()]
        if len(entries) > LARGEST_PACKAGE:
            found[str(folder.relative_to(root))] = len(entries)
    return found


def late_imports(root: Path) -> list[str]:
    """Imports of the package's own modules inside functions, outside the command line.

    Modules with compiled kernels may be imported late: they load numba.
    """
    found = []
    for path, tree in trees(root):
        if path.parts[1] == "cli":
            continue
        own = path.parts[1] in COMPILED
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef):
                continue
            for node in ast.walk(function):
                if not isinstance(node, ast.ImportFrom) or not node.module:
                    continue
                parts = node.module.split(".")
                kernels = len(parts) > 1 and parts[1] in COMPILED and not own
                if parts[0] == "study" and not kernels:
                    found.append(f"{path}:{node.lineno}: {node.module}")
    return sorted(set(found))


def constants_in_tuples(root: Path) -> list[str]:
    """Several constants in one assignment: none of them has a line that says what it is."""
    return [
        f"{path}:{node.lineno}: {ast.unparse(node.targets[0])}"
        for path, tree in trees(root)
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
        and all(isinstance(t, ast.Name) and t.id.isupper() for t in node.targets[0].elts)
    ]


def terms(root: Path) -> set[str]:
    """Words that may name a module: terms of the field, each with its source."""
    with (root / "docs" / "terms.csv").open(newline="", encoding="utf-8") as lines:
        return {row["term"] for row in csv.DictReader(lines)}


def foreign_names(root: Path) -> list[str]:
    """Modules and packages whose name holds a word that is no term of the field."""
    known = terms(root)
    return [
        str(path)
        for path, _ in trees(root)
        if any(
            word not in known
            for part in path.with_suffix("").parts[1:]
            if part not in ("__init__", "__main__")
            for word in part.split("_")
        )
    ]


def untyped(root: Path) -> int:
    """How often ``Any`` stands in the package."""
    return sum(
        isinstance(node, ast.Name) and node.id == "Any"
        for _, tree in trees(root)
        for node in ast.walk(tree)
    )


def untyped_aliases(root: Path) -> list[str]:
    """Names that stand for a type with ``Any`` in it, by module: each hides many."""
    return [
        f"{path}: {ast.unparse(name)}"
        for path, tree in trees(root)
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and _names_any(node.value)
        for name in (node.targets if isinstance(node, ast.Assign) else [node.target])
    ]


def _names_any(value: ast.expr | None) -> bool:
    return value is not None and any(
        isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(value)
    )


def wide_classes(root: Path) -> dict[str, int]:
    """Dataclasses with more fields than a reader holds at once, and how many each has.

    Sections of the study file are none of them: they grow with the keys of the file.
    """
    fields = {
        f"{path}: {node.name}": sum(isinstance(line, ast.AnnAssign) for line in node.body)
        for path, tree in trees(root)
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        and any("dataclass" in ast.unparse(one) for one in node.decorator_list)
    }
    return {name: n for name, n in fields.items() if n > MOST_FIELDS}


def stray_statistics(root: Path) -> list[str]:
    """Imports of scipy.stats outside the rooms of statistics; sequences of points are for all.

    import-linter takes a package of others as a whole, so it cannot say this.
    """
    return [
        f"{path}:{node.lineno}: {ast.unparse(node)}"
        for path, tree in trees(root)
        if path.parts[1] not in STATISTICS
        for node in ast.walk(tree)
        if any(one.startswith("scipy.stats") and one != POINTS for one in _taken(node))
    ]


def _taken(node: ast.AST) -> list[str]:
    """Full names that an import takes."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def unexplained(function: Callable[..., object]) -> list[str]:
    """What the docstring of a public function does not say of its parameters and its answer."""
    said = FunctionDoc(function)
    taken = [p.lstrip("*") for p in inspect.signature(function).parameters]
    explained = [word.strip().lstrip("*") for p in said["Parameters"] for word in p.name.split(",")]
    lost = [f"parameters {explained}, not {taken}"] if explained != taken else []
    lost += [f"type of {p.name}" for p in said["Parameters"] if not p.type]
    return lost if said["Returns"] else [*lost, "what it returns"]


def undocumented_arguments(root: Path) -> dict[str, list[str]]:
    """Arguments of public functions that their docstring does not name.

    Commands are let off: each of their arguments has a help text, and the docstring is the help.
    """
    found: dict[str, list[str]] = {}
    commands = {
        name for path, tree in trees(root) if path.parts[1] == "cli" for name in _commands(tree)
    }
    for path, tree in trees(root):
        for node in tree.body:
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                continue
            if path.parts[1] == "cli" and node.name in commands:
                continue
            if "overload" in map(ast.unparse, node.decorator_list):
                continue
            every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            more = [one for one in (node.args.vararg, node.args.kwarg) if one is not None]
            lacking = {one.arg for one in (*every, *more)} - _documented(ast.get_docstring(node))
            if lacking:
                found[f"{path}:{node.name}"] = sorted(lacking)
    return found


def _commands(tree: ast.Module) -> set[str]:
    """Names that a module gives to the command line: those of ``VERBS``, and callbacks."""
    found = set()
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "VERBS" and node.value:
            found |= {one.id for one in ast.walk(node.value) if isinstance(one, ast.Name)}
            found |= {one.attr for one in ast.walk(node.value) if isinstance(one, ast.Attribute)}
        if isinstance(node, ast.FunctionDef) and any(
            "callback" in ast.unparse(one) for one in node.decorator_list
        ):
            found.add(node.name)
    return found


def _documented(text: str | None) -> set[str]:
    named = NumpyDocString(text or "")["Parameters"]
    return {one.strip(" *\\") for parameter in named for one in parameter.name.split(",")}


def let_in(root: Path) -> dict[str, Any]:
    """What pyproject.toml lets in for now: numbers and lists that may only become smaller."""
    found: dict[str, Any] = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["house"]
    return found


def contract(root: Path, name: str) -> dict[str, Any]:
    """One contract of import-linter, by its id."""
    tool = tomllib.loads((root / "pyproject.toml").read_text())["tool"]
    found: dict[str, Any] = next(c for c in tool["importlinter"]["contracts"] if c["id"] == name)
    return found


def reads_environment(tree: ast.Module) -> bool:
    """Whether a module looks at environment variables."""
    return any(
        isinstance(node, ast.Attribute) and node.attr in {"environ", "getenv", "putenv"}
        for node in ast.walk(tree)
    )


def environment_readers(root: Path) -> set[str]:
    """Modules below the command line that read environment variables."""
    return {
        str(path)
        for path, tree in trees(root)
        if reads_environment(tree) and path.parts[1] not in MAY_READ_ENVIRONMENT
    }


def _has_search_tree(tree: ast.Module) -> bool:
    """Whether a module imports the search tree of scipy."""
    names = (node.names for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return any(alias.name in {"KDTree", "cKDTree"} for aliases in names for alias in aliases)


def forbidden(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """What could run code from a file, or vanish under ``python -O``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield node.lineno, "assert (raise instead: asserts vanish under -O)"
        elif isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in {"eval", "exec"}:
                yield node.lineno, node.func.id
            elif isinstance(node.func, ast.Attribute) and node.func.attr in {"eval", "query"}:
                if node.func.attr == "query" and _has_search_tree(tree):
                    continue  # of points, not of a data frame
                yield node.lineno, f".{node.func.attr}() evaluates text as code"
    if {"pickle", "marshal", "shelve", "dill"} & set(imported(tree)):
        yield 1, "pickle and its kin run code when they are read"
