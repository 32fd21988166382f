"""Names made of content: what was computed, from what, by which code."""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

import study
from study.ground.errors import StoreError
from study.ground.files import write_atomic

#: Modules that do the tasks of a worker; what they import decides the numbers.
_TASKS = ("study.simulation.case", "study.simulation.fit_task", "study.simulation.solve_task")

#: Rooms and modules in which imports are followed; reports and statistics may change without a
#: new run.
_NUMERIC_ROOMS = (
    "study.ground.arrays",
    "study.ground.compilation",
    "study.ground.curve",
    "study.ground.units",
    "study.external",
    "study.mechanics.calibration",
    "study.mechanics.contact",
    "study.mechanics.element",
    "study.mechanics.forward",
    "study.mechanics.material",
    "study.mechanics.mesh",
    "study.mechanics.setup",
    "study.mechanics.solver",
    "study.mechanics.surface",
    "study.simulation",
)

#: Modules that name results or foretell what they cost, and decide none of their numbers.
_WITHOUT_NUMBERS = (
    "study.mechanics.solver.solution_cost",
    "study.simulation.tasks",
    "study.simulation.provenance",
)
_PACKAGES = ("numpy", "scipy", "numba", "scikit-fem", "gmsh", "pypardiso", "mkl")


@functools.cache
def code_version() -> str:
    """Version of the package and a hash of the syntax, without docstrings, that decides a number.

    It is kept beside the compiled files until one of the sources changes on the disk.
    """
    root = Path(__file__).resolve().parents[1]
    state, cache = _state(root), root / "__pycache__" / "code-version"
    with contextlib.suppress(OSError, ValueError):
        cached_state, version = cache.read_text(encoding="ascii").split()
        if cached_state == state:
            return version
    sha = hashlib.sha256()
    for path, tree in _numeric_files(root):
        sha.update(str(path.relative_to(root)).encode())
        sha.update(_code_only(tree).encode())
    version = f"{study.__version__}+{sha.hexdigest()[:12]}"
    with contextlib.suppress(OSError, StoreError):  # an installation that may not be written to
        cache.parent.mkdir(exist_ok=True)
        write_atomic(cache, f"{state} {version}".encode("ascii"))
    return version


def _state(root: Path) -> str:
    """Name of the files as they lie on the disk: reading 110 of them takes a second, this 10 ms."""
    files = sorted(root.rglob("*.py"))
    facts = [(str(p), s.st_size, s.st_mtime_ns) for p in files for s in [p.stat()]]
    return hashlib.sha256(repr((study.__version__, facts)).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Versions of everything that may move a digit, for the record."""
    return {"study": code_version(), **libraries()}


@functools.cache
def libraries() -> Mapping[str, str]:
    """Versions of Python and of the libraries that compute, looked up once a process."""
    versions_read = {"python": platform.python_version()}
    for name in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions_read[name] = metadata.version(name)
    return versions_read


def _numeric_files(root: Path) -> Sequence[tuple[Path, ast.Module]]:
    """Files that the tasks of a worker import, one through the other, with their syntax."""
    trees: dict[str, tuple[Path, ast.Module]] = {}
    waiting = list(_TASKS)
    while waiting:
        module = waiting.pop()
        parts = module.split(".")
        home = root.joinpath(*parts[1:])
        files = (home.with_suffix(".py"), home / "__init__.py")
        path = next(filter(Path.is_file, files), None)  # a name may be no module
        if path is None or module in trees or module in _WITHOUT_NUMBERS:
            continue
        if not f"{module}.".startswith(tuple(f"{room}." for room in _NUMERIC_ROOMS)):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        trees[module] = (path, tree)
        waiting += _imported(tree)
        waiting += [".".join(parts[:k]) for k in range(2, len(parts))]
    return [trees[module] for module in sorted(trees)]


def _imported(tree: ast.Module) -> Sequence[str]:
    """Names of ours that a file imports, in functions too; what is for types alone is left out."""
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
        for statement in node.body
        for inner in ast.walk(statement)
    }
    nodes = [node for node in ast.walk(tree) if id(node) not in for_types]
    froms = [n for n in nodes if isinstance(n, ast.ImportFrom) and n.module]
    names = [f"{n.module}.{alias.name}" for n in froms for alias in n.names]
    names += [str(n.module) for n in froms]
    plain = [n for n in nodes if isinstance(n, ast.Import)]
    names += [alias.name for n in plain for alias in n.names]
    return [name for name in names if name.split(".")[0] == "study"]


def _code_only(tree: ast.Module) -> str:
    for node in ast.walk(tree):
        match getattr(node, "body", None):
            case [ast.Expr(ast.Constant(str())), *_] as body:
                body[0] = ast.Pass()
    return ast.unparse(tree)
