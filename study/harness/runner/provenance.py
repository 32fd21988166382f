"""Names made of content: what was computed, from what, by which code."""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import study
from study.ground.bounded_file import sha256_of
from study.ground.errors import Fault, InputError, MissingDataError, StoreError, nearest
from study.harness.design.cell import Cell, CellProblem
from study.harness.design.forward_model import PlacedFile
from study.harness.record.atomic_files import write_atomic
from study.mechanics.measurement.marker_states import read_markers
from study.mechanics.measurement.measurement_section import MeasurementSpec
from study.mechanics.measurement.recording import check_relative, locate, locate_pattern
from study.mechanics.setup.geometry import Block, Enclosed, Surface

#: Modules that do the tasks of a worker; what they import decides the numbers.
_TASKS = (
    "study.harness.runner.case",
    "study.harness.runner.fit_task",
    "study.harness.runner.solve_task",
)

#: Rooms and modules in which imports are followed; reports and statistics may change without a
#: new run.
_NUMERIC_ROOMS = (
    "study.ground.arrays",
    "study.ground.compilation",
    "study.ground.curve",
    "study.ground.units",
    "study.harness.design.cell",
    "study.harness.external",
    "study.harness.runner",
    "study.mechanics.calibration",
    "study.mechanics.contact",
    "study.mechanics.element",
    "study.mechanics.forward",
    "study.mechanics.material",
    "study.mechanics.mesh",
    "study.mechanics.setup",
    "study.mechanics.solver",
    "study.mechanics.surface",
)

#: Modules that name results or foretell what they cost, and decide none of their numbers.
_WITHOUT_NUMBERS = (
    "study.mechanics.solver.solution_cost",
    "study.harness.runner.tasks",
    "study.harness.runner.provenance",
)
_PACKAGES = ("numpy", "scipy", "numba", "scikit-fem", "gmsh", "pypardiso", "mkl")


@functools.cache
def code_version() -> str:
    """Version of the package and a hash of the syntax, without docstrings, that decides a number.

    It is kept beside the compiled files until one of the sources changes on the disk.
    """
    root = Path(__file__).resolve().parents[2]
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


_WHERE = "specimen.file"

#: depth of a test over the height where the measurements have to give it
_USUAL_DEPTH = 0.1


def folders(source: str | Path, root: Path) -> tuple[Path, ...]:
    """Where a surface may be: the data root first, as measurements; then beside the design."""
    home = Path(source).resolve().parent if Path(source).is_file() else None
    places = [root, *([home] if home is not None else [])]
    return tuple(dict.fromkeys(folder.resolve() for folder in places))


def located(problem: CellProblem, places: Sequence[Path]) -> CellProblem:
    """Copy a problem with its surface found, and checked; another specimen has no file."""
    if not isinstance(problem.specimen, Surface):
        return problem
    from study.mechanics.solver.finite_element_solution import check

    placed = replace(problem, surface_file=_surface_file(problem.specimen, places))
    # Refuse what cannot be meshed or held, with placeholders for what a fit will find.
    depth = placed.depth_mm or _USUAL_DEPTH * (placed.height_mm or 1.0)
    check(placed.with_placeholder(depth, C10_MPa=0.005))
    return placed


def _surface_file(surface: Surface, places: Sequence[Path]) -> PlacedFile:
    from study.mechanics.surface.closed_surface import height_of

    path = find(surface.file, places)
    height = height_of(replace(surface, file=str(path)))
    return PlacedFile(str(path), sha256_of(path), height)


def located_cell(cell: Cell, places: Sequence[Path]) -> Cell:
    """Copy a cell with its surfaces and the file of its markers found."""
    other = cell.fitted_elsewhere
    if isinstance(other, CellProblem) and isinstance(other.specimen, Surface):
        other = replace(other, surface_file=_surface_file(other.specimen, places))
    problem = cell.problem
    if isinstance(problem, CellProblem):
        problem = _with_markers(located(problem, places), places)
    return replace(cell, problem=problem, fitted_elsewhere=other)


def _with_markers(problem: CellProblem, places: Sequence[Path]) -> CellProblem:
    """Copy a problem with the file of its markers found."""
    spec, missing = problem.markers, list[Fault]()
    if spec is None:
        return problem
    for folder in places:
        try:
            path = locate(spec.file, folder, citation=spec.citation, where="markers.file")
        except MissingDataError as error:
            missing += error.faults
            continue
        if isinstance(problem.specimen, Block):  # what is wrong with it is told before a run
            read_markers(spec, path, problem.specimen)
        return replace(problem, marker_file=PlacedFile(str(path), sha256_of(path)))
    raise MissingDataError(missing[:1])


def find(name: str, places: Sequence[Path]) -> Path:
    """Path of a surface file in or below one of some folders."""
    check_relative(name, _WHERE)
    for folder in places:
        with contextlib.suppress(MissingDataError):
            return locate(name, folder, where=_WHERE)
    looked = " or ".join(repr(str(folder)) for folder in places)
    files = (path for folder in places for path in (folder / Path(name).parent).glob("*"))
    names = sorted(p.name for p in files if p.suffix.lower() in (".stl", ".ply", ".obj"))
    mend = nearest(Path(name).name, names[:20]) if names else "name its folder with --data DIR"
    raise InputError(Fault(_WHERE, f"there is no file {name!r} below {looked}", mend))


def surface_notes(cells: Iterable[Cell]) -> tuple[str, ...]:
    """List what was mended in the surfaces of some cells, each once."""
    notes = dict[str, None]()
    for cell in cells:
        if isinstance(cell.problem, CellProblem) and isinstance(cell.problem.specimen, Surface):
            from study.mechanics.surface.closed_surface import body

            made = cell.problem.setup.specimen
            notes |= dict.fromkeys(body(made).notes if isinstance(made, Enclosed) else ())
    return tuple(notes)


def placed_files(cell: Cell) -> list[PlacedFile]:
    """Files of surfaces and markers that a cell uses, as they were found."""
    problems = [p for p in (cell.problem, cell.fitted_elsewhere) if isinstance(p, CellProblem)]
    files = (file for p in problems for file in (p.surface_file, p.marker_file))
    return [file for file in files if file is not None]


def data_root(
    source: str | Path, data: str | Path | None = None, named: Iterable[MeasurementSpec] = ()
) -> Path:
    """Folder that measurement files are relative to.

    Without a folder that the user named it is the first of three that holds the files:
    ``measurements/`` beside the design's folder, ``measurements/`` beside the design, the
    design's folder. Where none holds them it is the first that exists.
    """
    if data is not None:
        folder = Path(data)
        if not folder.is_dir():
            mend = "name the folder that holds the measurement files"
            raise InputError(Fault("--data", f"there is no folder {str(folder)!r}", mend))
        return folder
    home = Path(source).resolve().parent
    usual = [home.parent / "measurements", home / "measurements", home]
    there = [folder for folder in usual if folder.is_dir()]
    files = list(named)
    complete = [folder for folder in there if files and _holds(folder, files)]
    return next(iter([*complete, *there]), home)


def _holds(folder: Path, files: Iterable[MeasurementSpec]) -> bool:
    """Whether a folder has a file for each of some specifications."""
    try:
        for spec in files:
            if spec.file is not None:
                locate(spec.file, folder)
            elif spec.files is not None:
                locate_pattern(spec.files, folder)
    except InputError:
        return False
    return True
