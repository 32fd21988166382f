"""Where a study reads and writes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from study.ground.declaration import table_of
from study.ground.errors import Fault, InputError
from study.harness.design.load import from_tables, load, load_problem, loads, loads_problem
from study.harness.design.spec import Design
from study.mechanics.setup.setup import Tables
from study.record.document import ManifestDocument
from study.record.store import Store
from study.simulation.cell import CellProblem
from study.simulation.fit_problem import data_root, folders, located
from study.simulation.problem_file import CalibrationDesign
from study.simulation.resolve import LoadedProblem

RESULTS = Path("results")
REPORTS = Path("reports")


def load_design(
    design: Design | Mapping[str, object] | str | Path, overrides: Sequence[str] = ()
) -> Design:
    """Load a design from its file, or make it of the tables that a file would have.

    Parameters
    ----------
    design : Design, mapping, str or Path
        A file; or its keys, with texts that have a unit or numbers in mm, N, MPa and deg.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.

    Returns
    -------
    Design
        The validated study.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    if isinstance(design, Design):
        return design
    if isinstance(design, Mapping):
        return loads(from_tables(design), "design", overrides)
    return load(design, overrides)


def demo_design(overrides: Sequence[str] = ()) -> Design:
    """Design of the embedded study."""
    from importlib import resources

    text = resources.files("study.harness.runner").joinpath("demo.toml").read_text(encoding="utf-8")
    return loads(text, "demo.toml", overrides)


def loaded_problem(source: str | Path | Tables, overrides: Sequence[str] = ()) -> LoadedProblem:
    """Read a problem, from its file or from tables as a file has them, and find its surface."""
    if isinstance(source, Mapping):
        if "displacement_mm" in table_of(source, "test"):
            return LoadedProblem(CellProblem.of(source))
        loaded, path = loads_problem(from_tables(source), "problem", overrides), Path("problem")
    else:
        loaded, path = load_problem(source, overrides), Path(source)
    problem = located(loaded.problem, folders(path, data_root(path)))
    return replace(loaded, problem=problem)


def design_root(design: Design, data: str | Path | None = None) -> Path:
    """Folder that the measurement files of a design are relative to."""
    specs = [
        spec
        for cell in design.treatments
        for problem in (cell.cell.problem, cell.cell.fitted_elsewhere)
        if problem is not None and (spec := problem.measurements) is not None
    ]
    return data_root(design.source, data, {(s.file, s.files): s for s in specs}.values())


def calibration_root(
    config: CalibrationDesign, source: str | Path, data: str | Path | None = None
) -> Path:
    """Folder that the measurement files of a calibration are relative to."""
    return data_root(source, data, [test.measurements for test in config.tests])


def finished_manifest(store: Store) -> ManifestDocument:
    """Manifest of the run that is read from."""
    manifest = store.read_manifest()
    if manifest is None:
        raise InputError(f"{store.path}: its manifest is damaged; run the design again")
    return manifest


def results_folder(path: str | Path, results: str | Path = RESULTS) -> Path:
    """Results of a study, named by their folder, by its design file, or by the study's name."""
    given = Path(path)
    candidates = [given, Path(results) / given.name]
    if given.suffix == ".toml" and given.is_file():
        candidates = [Path(results) / load(given).name]
    for folder in candidates:
        if os.path.isfile(folder / "study.json"):  # of what may not be read nothing is known
            return folder
    looked = ", ".join(dict.fromkeys(map(str, candidates)))
    raise InputError(
        Fault(str(path), f"no results of a study there (looked in {looked})",
              "name a folder such as results/NAME, or run the design first")
    )  # fmt: skip
