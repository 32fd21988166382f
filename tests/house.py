"""Rules of the house that no linter knows: each looks at a folder and names every breach.

:mod:`tests.test_architecture` holds the project to them, :mod:`tests.test_gates` plants a
breach into a copy for each, because a gate that nobody has seen fail may check nothing.
"""

from __future__ import annotations

import ast
import importlib
import itertools
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import vulture
from numpydoc.validate import validate

#: fields of a dataclass
MOST_FIELDS = 12
#: lines of the body of a helper that is written where it is used
SMALL_BODY = 6
#: packages below the first
DEEPEST = 2
#: what numpydoc's validation may miss: links to other functions, examples, a second paragraph
OPTIONAL_SECTIONS = {"SA01", "EX01", "ES01", "SS05"}
#: a paper names its year
YEAR = re.compile(r"\b(1[89]|20)\d\d\b")
#: names of distributions that are imported under another name
IMPORTED_AS = {
    "scikit-fem": "skfem",
    "pydantic-core": "pydantic_core",
    "python-calamine": "python_calamine",
}
#: extras of what the package itself never imports: tests, and the documentation site
OUTSIDE = {"test", "docs"}
#: rooms whose modules carry compiled kernels: importing one loads numba, so it may be late
COMPILED = (
    "study/mechanics/mesh/",
    "study/mechanics/element/",
    "study/mechanics/contact/",
    "study/mechanics/solver/",
    "study/mechanics/solver/",
    "study/mechanics/surface/",
    "study/mechanics/material/",
)
#: rooms that may ask scipy.stats for distributions and tests
STATISTICS = (
    "study/statistics/analysis/",
    "study/statistics/convergence/",
    "study/statistics/surfaces/",
    "study/laboratory/registration/",
    "study/laboratory/tracker/",
    "study/ground/noncentral_f.py",
)
#: what any room may ask it for: points that fill a space evenly
POINTS = "scipy.stats.qmc"
#: read the environment: the command line, and those who cap the threads of workers
MAY_READ_ENVIRONMENT = (
    "study/cli/",
    "study/ground/working_folder.py",
    "study/ground/compilation.py",
)


def trees(root: Path) -> Iterator[tuple[Path, ast.Module]]:
    """Every module of the package below a root, with its syntax."""
    for path in sorted((root / "study").rglob("*.py")):
        yield path.relative_to(root), parsed(path.read_text(encoding="utf-8"))


@cache
def parsed(text: str) -> ast.Module:
    """Syntax of a text, made once for all rules."""
    return ast.parse(text)


@cache
def walked(tree: ast.Module) -> tuple[ast.AST, ...]:
    """Every node of a module."""
    return tuple(ast.walk(tree))


def imported(tree: ast.Module) -> Iterator[str]:
    """Top-level names of the packages that a module imports, anywhere in it."""
    for node in walked(tree):
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
    return {IMPORTED_AS.get(name, name).replace("-", "_") for name in names}


def undeclared_imports(root: Path) -> set[str]:
    """Packages that are imported and not declared."""
    # matplotlib brings mpl_toolkits with it
    known = declared(root) | set(sys.stdlib_module_names) | {"study", "mpl_toolkits"}
    return {
        f"{path}: {name}"
        for path, tree in trees(root)
        for name in imported(tree)
        if name not in known
    }


def unused_dependencies(root: Path) -> set[str]:
    """Packages that are declared and never imported."""
    return declared(root) - {name for _, tree in trees(root) for name in imported(tree)}


def late_imports(root: Path) -> list[str]:
    """Imports of the package's own modules inside functions, outside the command line.

    Modules with compiled kernels may be imported late: they load numba. So may figures, which load
    matplotlib and pandas.
    """
    found = []
    for path, tree in trees(root):
        if path.parts[1] == "cli":
            continue
        is_compiled = str(path).startswith(COMPILED)
        for function in walked(tree):
            if not isinstance(function, ast.FunctionDef):
                continue
            for node in ast.walk(function):
                if not isinstance(node, ast.ImportFrom) or not node.module:
                    continue
                parts = node.module.split(".")
                target = "/".join(parts) + "/"
                kernels = target.startswith(COMPILED) and not is_compiled
                drawn = target.startswith("study/reporting/figures/")
                if parts[0] == "study" and not kernels and not drawn:
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


def untyped(root: Path) -> int:
    """How often ``Any`` stands in the package."""
    return sum(
        isinstance(node, ast.Name) and node.id == "Any"
        for _, tree in trees(root)
        for node in walked(tree)
    )


def untyped_aliases(root: Path) -> list[str]:
    """Names that stand for a type with ``Any`` in it, by module: each hides many."""
    return [
        f"{path}: {ast.unparse(name)}"
        for path, tree in trees(root)
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        if any(isinstance(n, ast.Name) and n.id == "Any" for n in ast.walk(node.value))
        for name in (node.targets if isinstance(node, ast.Assign) else [node.target])
    ]


def wide_classes(root: Path) -> dict[str, int]:
    """Dataclasses with more fields than a reader holds at once, and how many each has.

    Sections of the study file are none of them: they grow with the keys of the file.
    """
    fields = {
        f"{path}: {node.name}": sum(isinstance(line, ast.AnnAssign) for line in node.body)
        for path, tree in trees(root)
        for node in walked(tree)
        if isinstance(node, ast.ClassDef)
        and any("dataclass" in ast.unparse(mark) for mark in node.decorator_list)
    }
    return {name: n for name, n in fields.items() if n > MOST_FIELDS}


def stray_statistics(root: Path) -> list[str]:
    """Imports of scipy.stats outside the rooms of statistics; sequences of points are for all.

    import-linter takes a package of others as a whole, so it cannot say this.
    """
    return [
        f"{path}:{node.lineno}: {ast.unparse(node)}"
        for path, tree in trees(root)
        if not str(path).startswith(STATISTICS)
        for node in walked(tree)
        if isinstance(node, ast.stmt)
        and any(name.startswith("scipy.stats") and name != POINTS for name in _taken(node))
    ]


#: searches of scipy.optimize whose result says whether they have converged; roots raise
SEARCHES = {"minimize", "minimize_scalar", "least_squares", "root", "root_scalar", "linprog"}


def unread_searches(root: Path) -> list[str]:
    """Functions that search with scipy and do not read how the search ended."""
    found = []
    for path, tree in trees(root):
        taken = {f"optimize.{name}" for name in SEARCHES}
        for node in walked(tree):
            if isinstance(node, ast.ImportFrom) and node.module == "scipy.optimize":
                taken |= {alias.name for alias in node.names} & SEARCHES
        classes = [node.body for node in tree.body if isinstance(node, ast.ClassDef)]
        for node in itertools.chain(tree.body, *classes):
            if isinstance(node, ast.FunctionDef):
                nodes = list(ast.walk(node))
                names = {n.attr for n in nodes if isinstance(n, ast.Attribute)}
                calls = {
                    ast.unparse(n.func).removeprefix("scipy.")
                    for n in nodes
                    if isinstance(n, ast.Call)
                }
                searches = calls & taken
                if searches and not {*names, *calls} & {"settled", "status", "success"}:
                    found.append(f"{path}: {node.name}")
    return found


def _taken(node: ast.AST) -> list[str]:
    """Full names that an import takes."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


def docstring_lines(node: ast.Module | ast.ClassDef | ast.FunctionDef) -> int:
    """Lines of a docstring, its quotes included."""
    first = node.body[0] if node.body else None
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        return (
            (first.end_lineno or 0) - first.lineno + 1 if isinstance(first.value.value, str) else 0
        )
    return 0


def small_helpers(root: Path) -> list[str]:
    """Private functions of a few lines that are called in one place, and are better written there.

    Let off are those that a test imports, that name a paper by its year, and decorated ones.
    """
    tests = (path.read_text(encoding="utf-8") for path in (root / "tests").rglob("*.py"))
    tested = {word for text in tests for word in re.findall(r"\b_\w+", text)}
    small = []
    for path, tree in trees(root):
        uses = Counter(node.id for node in walked(tree) if isinstance(node, ast.Name))
        calls = Counter(
            node.func.id
            for node in walked(tree)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        )
        for node in tree.body:
            if (
                isinstance(node, ast.FunctionDef)
                and node.name.startswith("_")
                and uses[node.name] == calls[node.name] == 1
                and node.name not in tested
                and not node.decorator_list
                and not YEAR.search(ast.get_docstring(node) or "")
                and _body_lines(node) <= SMALL_BODY
            ):
                small.append(f"{path}: {node.name}")
    return small


def _body_lines(node: ast.FunctionDef) -> int:
    body = node.body[1:] if ast.get_docstring(node) else node.body
    return (node.end_lineno or 0) - body[0].lineno + 1 if body else 0


def long_docstrings(root: Path) -> list[str]:
    """Functions whose docstring is longer than they are, outside the public interface."""
    public = public_names(root)
    extended = set(let_in(root)["extension_points"])
    off = {
        id(method)
        for _, tree in trees(root)
        for node in walked(tree)
        if isinstance(node, ast.ClassDef) and node.name in extended
        for method in node.body
    }
    return [
        f"{path}: {node.name}"
        for path, tree in trees(root)
        for node in walked(tree)
        if isinstance(node, ast.FunctionDef)
        # without decorators
        and 2 * docstring_lines(node) > (node.end_lineno or 0) - node.lineno + 1
        and node.name not in public
        and id(node) not in off
    ]


def public_names(root: Path) -> set[str]:
    """Names of ``study.__all__``: the tuple of what is loaded on first use."""
    tree = parsed((root / "study" / "__init__.py").read_text(encoding="utf-8"))
    return {
        str(name.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple)
        for name in node.value.elts
        if isinstance(name, ast.Constant)
    }


def deep_packages(root: Path) -> list[str]:
    """Packages below the second level."""
    paths = (path.parent for path, _ in trees(root) if path.name == "__init__.py")
    return [str(path) for path in paths if len(path.parts) - 1 > DEEPEST]


def empty_packages(root: Path) -> list[str]:
    """Files ``__init__.py`` without a name in them."""
    return [
        str(path)
        for path, tree in trees(root)
        if path.name == "__init__.py" and len(tree.body) <= bool(docstring_lines(tree))
    ]


def shared_module_names(root: Path) -> dict[str, list[str]]:
    """Names that several modules have."""
    return _shared(
        (path.stem, str(path)) for path, _ in trees(root) if not path.stem.startswith("__")
    )


def shared_class_names(root: Path) -> dict[str, list[str]]:
    """Names that several classes have."""
    return _shared(
        (node.name, str(path))
        for path, tree in trees(root)
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    )


#: words that do not say which quantity or thing a name holds
VAGUE = {"asked", "beside", "found", "kept", "known", "one", "own", "said", "told", "wanted"}
VAGUE |= {"made", "place"}


def vague_names(root: Path) -> list[str]:
    """Variables, arguments, fields and functions whose name says nothing of what they hold."""
    out: set[str] = set()
    for path, tree in trees(root):
        for node in walked(tree):
            match node:
                case ast.Name(id=name, ctx=ast.Store()) | ast.arg(arg=name):
                    pass
                case ast.FunctionDef(name=name):
                    pass
                case _:
                    continue
            if name in VAGUE:
                out.add(f"{path}:{node.lineno}: {name}")
    return sorted(out)


def _shared(places: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    by_name: dict[str, list[str]] = {}
    for name, place in places:
        by_name.setdefault(name, []).append(place)
    return {name: places for name, places in by_name.items() if len(places) > 1}


def tests_below_a_door(root: Path) -> list[str]:
    """Files of tests that import a module below a room: every move breaks them."""
    below = re.compile(r"^\s*(from study\.\w+\.\w+[\w.]* import|import study\.\w+\.\w+)", re.M)
    return [
        str(path.relative_to(root))
        for path in sorted((root / "tests").rglob("*.py"))
        if below.search(path.read_text(encoding="utf-8"))
    ]


def unused(root: Path) -> list[str]:
    """Names of functions, classes, methods, fields and variables that no module uses.

    Vulture knows names alone, so that one use of a name lets off all that bear it. Templates use
    names, too, and the keys that a class declares for its JSON; public names and hooks that other
    packages call are let off.
    """
    hooks = let_in(root)["hooks"]
    finder = vulture.Vulture(ignore_names=[*public_names(root), *hooks])
    finder.scavenge([root / "study"])
    pages = [path for kind in ("*.j2", "*.html") for path in (root / "study").rglob(kind)]
    templates = {word for path in pages for word in re.findall(r"\w+", path.read_text())}
    keys = {
        name
        for _, tree in trees(root)
        for node in walked(tree)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "KEYS"
        for name in re.findall(r"\w+", ast.unparse(node.value))
    }
    found = {str(item.name) for item in finder.get_unused_code(min_confidence=60)}
    return sorted(found - templates - keys)


def poorly_explained(root: Path) -> list[str]:
    """What numpydoc misses at the public functions and at the classes that others derive from."""
    names = [f"study.{name}" for name in sorted(public_names(root))]
    extended = set(let_in(root)["extension_points"])
    for path, tree in trees(root):
        module = ".".join(path.with_suffix("").parts)
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and node.name in extended:
                extended.remove(node.name)
                importlib.import_module(module)
                names.append(f"{module}.{node.name}")
    missing = [f"{name}: no class has this name" for name in sorted(extended)]
    return missing + [
        f"{name}: {code} {message}"
        for name in names
        for code, message in validate(name)["errors"]
        # the signature of a protocol is one that Python makes
        if code not in OPTIONAL_SECTIONS and not (code == "PR01" and "'*args'" in message)
    ]


def let_in(root: Path) -> dict[str, Any]:
    """What pyproject.toml lets in: names, and numbers and lists that may only become smaller."""
    table: dict[str, Any] = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["house"]
    return {**table, **table["numbers"]}


def counted(root: Path) -> dict[str, int | list[str] | dict[str, int]]:
    """What the tree holds today of all that ``[tool.house]`` lets in, by its names there."""
    return {
        "any": untyped(root),
        "small_helpers": len(small_helpers(root)),
        "long_docstrings": len(long_docstrings(root)),
        "deep_packages": len(deep_packages(root)),
        "empty_packages": len(empty_packages(root)),
        "shared_module_names": len(shared_module_names(root)),
        "shared_class_names": len(shared_class_names(root)),
        "vague_names": len(vague_names(root)),
        "tests_below_a_door": len(tests_below_a_door(root)),
        "untyped_aliases": untyped_aliases(root),
        "unused": unused(root),
        "wide_classes": wide_classes(root),
    }


def contract(root: Path, name: str) -> dict[str, Any]:
    """One contract of import-linter, by its id."""
    tool = tomllib.loads((root / "pyproject.toml").read_text())["tool"]
    found: dict[str, Any] = next(c for c in tool["importlinter"]["contracts"] if c["id"] == name)
    return found


def environment_readers(root: Path) -> set[str]:
    """Modules below the command line that read environment variables."""
    return {
        str(path)
        for path, tree in trees(root)
        if not str(path).startswith(MAY_READ_ENVIRONMENT)
        for node in walked(tree)
        if isinstance(node, ast.Attribute) and node.attr in {"environ", "getenv", "putenv"}
    }


def _has_search_tree(tree: ast.Module) -> bool:
    """Whether a module imports the search tree of scipy."""
    names = (node.names for node in walked(tree) if isinstance(node, ast.ImportFrom))
    return any(alias.name in {"KDTree", "cKDTree"} for aliases in names for alias in aliases)


def forbidden(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """What could run code from a file, or vanish under ``python -O``."""
    for node in walked(tree):
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
