"""A problem, a calibration or a case of a study for a device, or for another program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.api.folders import REPORTS
from study.api.haptics.material import PROGRAMS, MaterialExport, export_material
from study.api.haptics.problem import material_of, source_of
from study.errors import Fault, InputError, nearest
from study.haptics.export import document, files, sentences
from study.haptics.force_law import ForceLaw
from study.haptics.refinement import TOLERANCE, Wanted, solved_force_law
from study.material.stability import check
from study.record.atomic_files import write_atomic
from study.reporting.output.force_law_page import write_force_law

#: What a result can be exported as.
FORMS = ("force-law", "emulator", *PROGRAMS)


@dataclass(frozen=True)
class Export:
    """A force law and the files that hold it.

    Parameters
    ----------
    law : ForceLaw
        The function itself.
    paths : tuple of Path
        JSON, CSV, Python module, C header and report page.
    warnings : tuple of str
        Such as a tolerance that is not met.
    """

    law: ForceLaw
    paths: tuple[Path, ...]
    warnings: tuple[str, ...]

    def sentences(self) -> Sequence[str]:
        """Say where the law holds, and how near it is."""
        return sentences(self.law)

    def to_json(self) -> dict[str, object]:
        """Document of ``study export --json``."""
        written = {path.suffix.removeprefix("."): str(path) for path in self.paths}
        return {**document(self.law), "files": written, "warnings": list(self.warnings)}


def export(
    source: str | Path,
    *,
    form: str = "force-law",
    case: str = "",
    test: int = 1,
    overrides: Sequence[str] = (),
    tolerance: float = TOLERANCE,
    out: str | Path = REPORTS,
    progress: Callable[[str], None] | None = None,
) -> Export | MaterialExport:
    """Turn a simulated test into a function, or its material into input of another program.

    Parameters
    ----------
    source : str or Path
        Problem file, ``calibration.json`` of a calibration, or the results of a study.
    form : {"force-law", "abaqus", "febio"}
        What it becomes: a function of displacement and constants, or lines of an input file.
    case : str
        Case of a study, by the beginning of its id.
    test : int
        Number of the test of a calibration, from 1.
    overrides : sequence of str
        ``key=value`` each, laid over a problem file.
    tolerance : float
        Wanted error bound over the largest force.
    out : str or Path
        Folder of the files; made where it is missing.
    progress : callable, optional
        Gets a sentence after every solution.

    Returns
    -------
    Export or MaterialExport
        The law or the material, and the files that were written.

    Raises
    ------
    InputError
        For a faulty source, a simulation that does not reach its end, or a program that has no
        such energy; nothing is written.
    """
    if form not in FORMS:
        raise InputError(Fault("--as", f"no form {form!r}", nearest(form, FORMS)))
    if form == "emulator":
        rule = "is a function of the ranges of a study, not of one test"
        raise InputError(Fault("--as", rule, "use study.export_surface"))
    if not 0 < tolerance < 1:
        rule = f"must be a share between 0 and 1, got {tolerance:g}"
        raise InputError(Fault("--tolerance", rule, "for example 0.002"))
    if form in PROGRAMS:
        name, material = material_of(Path(source), case, test, overrides)
        return export_material(name, material, form, Path(out))
    found = source_of(Path(source), case, test, overrides)
    check(found.problem.material, None)
    wanted = Wanted(tolerance, found.half_ranges, found.covariance)
    law = solved_force_law(found.name, found.problem, wanted, progress)
    warnings = _warnings(law, tolerance)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    made = files(law, folder)
    for path, text in made.items():
        write_atomic(path, text.encode())
    question = "How does the force follow from displacement and constants?"
    page = write_force_law(law, question, folder, warnings)
    return Export(law, (*made, page), warnings)


def _warnings(law: ForceLaw, tolerance: float) -> tuple[str, ...]:
    said = []
    if law.relative_error > tolerance:
        said.append(
            f"the error bound is {100 * law.relative_error:.2g} % of the largest force, not "
            f"{100 * tolerance:.2g} %: a finer mesh bends the curve less where contact begins"
        )
    return tuple(said)
