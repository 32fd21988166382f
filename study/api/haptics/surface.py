"""The surfaces of a study as functions that need no package."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from study.api.folders import REPORTS, RESULTS
from study.api.opened_study import open_study
from study.errors import Fault, InputError, nearest
from study.haptics.surface import SurfaceFunction, surface_function
from study.record.atomic_files import write_atomic

if TYPE_CHECKING:
    from study.study_result.study_result import StudyResult


@dataclass(frozen=True)
class SurfaceExport:
    """Functions and the files that hold them.

    Parameters
    ----------
    functions : tuple of SurfaceFunction
        One for each response at each combination of the levels that are no numbers.
    paths : tuple of Path
        JSON and Python module of each.
    warnings : tuple of str
        Responses without a surface.
    """

    functions: tuple[SurfaceFunction, ...]
    paths: tuple[Path, ...]
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """Document of ``study export --as emulator --json``."""
        return {
            "functions": [one.document() for one in self.functions],
            "files": [str(path) for path in self.paths],
            "warnings": list(self.warnings),
        }


def export_surface(
    path: str | Path | StudyResult,
    *,
    response: str | None = None,
    out: str | Path = REPORTS,
    results: Path = RESULTS,
) -> SurfaceExport:
    """Write the surfaces of a study as JSON and as Python modules that import nothing.

    Parameters
    ----------
    path : str, Path or StudyResult
        Results folder, design file, name of the study, or the study itself.
    response : str, optional
        One response alone.
    out : str or Path
        Folder of the files; made where it is missing.
    results : Path
        Folder of the results, where ``path`` is a name.

    Returns
    -------
    SurfaceExport
        The functions, each with its error bound, and the files that were written.

    Raises
    ------
    InputError
        If the study has no surface, or not that response; nothing is written.
    """
    study = open_study(path, results) if isinstance(path, str | Path) else path
    names = list(dict.fromkeys(one.response for one in study.surfaces))
    if response is not None and names and response not in names:
        raise InputError(Fault("--response", f"there is no {response!r}", nearest(response, names)))
    asked = [one for one in study.surfaces if response in (None, one.response)]
    good = [one for one in asked if one.found is not None]
    if not good:
        rule = "has no surface that could be a function"
        said = next((one.refused for one in asked), "no factor is a range")
        raise InputError(Fault(study.design.name, rule, said))
    made = tuple(surface_function(study.design.name, one) for one in good)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {place: text for one in made for place, text in one.files(folder).items()}
    for place, text in texts.items():
        write_atomic(place, text.encode())
    missing = tuple(f"{one.response}: {one.refused}" for one in asked if one.found is None)
    return SurfaceExport(made, tuple(texts), missing)
