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

#: rooms whose code decides a number; reports and statistics may change without a new run
_NUMERIC_ROOMS = ("curve.py", "units.py", "material", "forward", "calibration")
#: files of theirs that foretell what a computation costs, and decide none of its numbers
_FORETELLING = ("estimate.py", "expected.py")
_NUMERIC_RUNNER = (
    "anchors.py",
    "build.py",
    "closed_form.py",
    "described.py",
    "fits.py",
    "execute.py",
    "noise.py",
    "scoring.py",
    "staged.py",
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
    files: list[Path] = [root / "runner" / name for name in _NUMERIC_RUNNER]
    for room in _NUMERIC_ROOMS:
        path = root / room
        files += sorted(path.rglob("*.py")) if path.is_dir() else [path]
    return [path for path in files if path.exists() and path.name not in _FORETELLING]


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
