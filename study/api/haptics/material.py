"""A material as the input of another program: ``study export --as abaqus`` and ``--as febio``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from study.material import conversions
from study.material.convention import Converted
from study.material.input_file import abaqus_text, febio_text, material_name, remarks
from study.material.material import Material
from study.material.stability import check, stability
from study.record.atomic_files import write_atomic

#: what writes a material, and the ending of its file, by the name of the program
PROGRAMS: Mapping[str, tuple[Callable[[Material, str], str], str]] = {
    "abaqus": (abaqus_text, ".inp"),
    "febio": (febio_text, ".feb"),
}


@dataclass(frozen=True)
class MaterialExport:
    """A material in another program's words, and its file.

    Parameters
    ----------
    name : str
        Of the material there.
    converted : Converted
        Its constants.
    text : str
        Of the file.
    paths : tuple of Path
        The file.
    remarks : tuple of str
        Units, Drucker's criterion, and what differs.
    warnings : tuple of str
        Where the material is unstable.
    """

    name: str
    converted: Converted
    text: str
    paths: tuple[Path, ...]
    remarks: tuple[str, ...]
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, object]:
        """Document of ``study export --json``."""
        return {
            "name": self.name,
            "program": self.converted.convention,
            "keyword": self.converted.keyword,
            "constants": dict(self.converted.constants),
            "text": self.text,
            "files": {path.suffix.removeprefix("."): str(path) for path in self.paths},
            "remarks": list(self.remarks),
            "warnings": list(self.warnings),
        }

    def sentences(self) -> tuple[str, ...]:
        """Say what was written, and what must be known of it."""
        return (f"{self.name}: {self.converted.keyword}", *self.remarks)


def export_material(title: str, material: Material, program: str, folder: Path) -> MaterialExport:
    """Write a material for another program.

    Parameters
    ----------
    title : str
        Of the problem that it is of; its name and that of its file follow.
    material : Material
        With numbers.
    program : {"abaqus", "febio"}
        Which.
    folder : Path
        Of the file; made where it is missing.

    Raises
    ------
    InputError
        If the constants make no material, or the program has no such energy; nothing is written.
    """
    name = material_name(title)
    check(material, None)
    write, ending = PROGRAMS[program]
    text, converted = write(material, name), conversions.convert(material, program)
    judged = stability(material)
    warnings = () if judged.stable else (f"{judged.sentence}: Abaqus warns of it, FEBio does not",)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}{ending}"
    write_atomic(path, text.encode())
    return MaterialExport(name, converted, text, (path,), remarks(material, converted), warnings)
