"""Names made of content: what was computed, from what, by which code."""

from __future__ import annotations

import ast
import functools
import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import study

#: Modules that do the tasks of a worker; what they import decides the numbers.
_TASKS = ("execute", "fits", "noise", "refine_solve")
#: Rooms in which imports are followed; reports and statistics may change without a new run.
_NUMERIC_ROOMS = ("curve", "units", "material", "forward", "calibration", "runner")
#: Modules that name results or foretell what they cost, and decide none of their numbers.
_WITHOUT_NUMBERS = (
    "study.forward.estimate",
    "study.forward.expected",
    "study.runner.checkpoint",
    "study.runner.compiled",
    "study.runner.identity",
)
_PACKAGES = ("numpy", "scipy", "numba", "scikit-fem", "gmsh", "pypardiso", "mkl")


def canonical(value: Any) -> Any:
    """Plain JSON values with one spelling per number: ``1`` and ``1.0`` are the same."""
    if isinstance(value, Mapping):
        # where a file lies on this machine is no content; its sha256 stands beside it
        return {str(k): canonical(v) for k, v in value.items() if k != "path"}
    if isinstance(value, (list, tuple)):
        return [canonical(v) for v in value]
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    if isinstance(value, (int, float)):
        return float(value)
    if hasattr(value, "tolist"):
        return canonical(value.tolist())
    raise TypeError(f"cannot hash a {type(value).__name__}: {value!r}")


def digest(value: Any, length: int = 64) -> str:
    """Hex sha256 of the canonical JSON of a value.

    Examples
    --------
    >>> digest({"a": 1, "b": 2}) == digest({"b": 2.0, "a": 1.0})
    True
    """
    text = json.dumps(canonical(value), sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:length]


@functools.cache
def code_version() -> str:
    """Version of the package and a hash of the code that decides a number.

    The hash is taken of the syntax without docstrings, so that comments and
    formatting may change without sending a finished study back to work.
    """
    root = Path(__file__).resolve().parents[1]
    sha = hashlib.sha256()
    for path in _numeric_files(root):
        sha.update(str(path.relative_to(root)).encode())
        sha.update(_code_only(path.read_text(encoding="utf-8")).encode())
    return f"{study.__version__}+{sha.hexdigest()[:12]}"


def versions() -> dict[str, str]:
    """Versions of everything that may move a digit, for the record."""
    found = {"study": code_version(), "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _numeric_files(root: Path) -> Sequence[Path]:
    """Files that the tasks of a worker import, one through the other."""
    found: dict[str, Path] = {}
    waiting = [f"study.runner.{name}" for name in _TASKS]
    while waiting:
        module = waiting.pop()
        path = _file_of(root, module)
        parts = module.split(".")
        if path is None or module in found or module in _WITHOUT_NUMBERS:
            continue
        if len(parts) < 2 or parts[1] not in _NUMERIC_ROOMS:
            continue
        found[module] = path
        waiting += _imported(ast.parse(path.read_text(encoding="utf-8")))
        waiting += [".".join(parts[:k]) for k in range(2, len(parts))]
    return [found[module] for module in sorted(found)]


def _file_of(root: Path, module: str) -> Path | None:
    """File of a module or package of ours; None where a name is no module."""
    path = root.joinpath(*module.split(".")[1:])
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def _imported(tree: ast.Module) -> Sequence[str]:
    """Names of ours that a file imports, in functions too; what is for types alone is left out."""
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    froms = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and n.module]
    names = [f"{n.module}.{alias.name}" for n in froms for alias in n.names]
    names += [str(n.module) for n in froms]
    plain = [n for n in ast.walk(tree) if isinstance(n, ast.Import)]
    names += [alias.name for n in plain for alias in n.names]
    return [name for name in names if name.split(".")[0] == "study"]


def _code_only(source: str) -> str:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body and _is_text(body[0]):
            body[0] = ast.Pass()
    return ast.unparse(tree)


def _is_text(node: Any) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
