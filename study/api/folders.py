"""Where a study reads and writes."""

from __future__ import annotations

from pathlib import Path

from study.design.load import load
from study.errors import Fault, InputError

RESULTS = Path("results")
REPORTS = Path("reports")


def data_root(source: str | Path, data: str | Path | None = None) -> Path:
    """Folder that measurement files are relative to.

    Parameters
    ----------
    source : str or Path
        The design file.
    data : str or Path, optional
        The folder that the user named, which wins.

    Raises
    ------
    InputError
        If the named folder does not exist.
    """
    if data is not None:
        folder = Path(data)
        if not folder.is_dir():
            mend = "name the folder that holds the measurement files"
            raise InputError(Fault("--data", f"there is no folder {str(folder)!r}", mend))
        return folder
    home = Path(source).resolve().parent
    beside = home.parent / "measurements"
    return beside if beside.is_dir() else home


def results_folder(path: str | Path, results: Path = RESULTS) -> Path:
    """Results of a study, named by their folder, by its design file, or by the study's name.

    Raises
    ------
    InputError
        If nothing has been computed there.
    """
    given = Path(path)
    candidates = [given, results / given.name]
    if given.suffix == ".toml" and given.is_file():
        candidates = [results / load(given).name]
    for folder in candidates:
        if (folder / "study.json").is_file():
            return folder
    looked = ", ".join(dict.fromkeys(map(str, candidates)))
    raise InputError(
        Fault(str(path), f"no results of a study there (looked in {looked})",
              "name a folder such as results/NAME, or run the design first")
    )  # fmt: skip
