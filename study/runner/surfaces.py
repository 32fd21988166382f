"""Find the files of specimens that are given as surfaces, and check them before anything runs.

A configuration then carries where its file is (``path``, which names nothing), its content
(``sha256``, which does) and its height, so that whatever needs a height works as for a
cylinder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from study.errors import Fault, InputError, MissingDataError, nearest
from study.forward.problem import Surface
from study.record.paths import check_relative, locate
from study.runner import build

Config = Mapping[str, Any]

_WHERE = "specimen.file"
#: depth of a test over the height where the measurements have to give it
_USUAL_DEPTH = 0.1


def folders(source: str | Path, data_root: Path) -> tuple[Path, ...]:
    """Where a surface may be: the data root first, as measurements; then beside the design."""
    home = Path(source).resolve().parent if Path(source).is_file() else None
    found = [data_root, *([home] if home is not None else [])]
    return tuple(dict.fromkeys(folder.resolve() for folder in found))


def located(config: Config, places: Sequence[Path]) -> dict[str, Any]:
    """Copy a configuration with every surface in it found and checked.

    Parameters
    ----------
    config : mapping
        Resolved sections; specimens may also be in ``calibration.problem`` and ``tests``.
    places : sequence of Path
        Folders that a file may be in or below.

    Raises
    ------
    InputError
        If a file is missing or outside these folders, or its surface cannot be used.
    """
    found = cast(dict[str, Any], _walked(config, places))
    for one in found.get("tests") or [found]:
        if _is_surface(one.get("specimen")):
            _check_use(one)
    return found


def _is_surface(section: Any) -> bool:
    return isinstance(section, Mapping) and section.get("shape") == "surface"


def _walked(value: Any, places: Sequence[Path]) -> Any:
    if _is_surface(value):
        return _found(value, places)
    if isinstance(value, Mapping):
        return {k: _walked(v, places) for k, v in value.items()}
    return [_walked(v, places) for v in value] if isinstance(value, list) else value


def _found(section: Config, places: Sequence[Path]) -> dict[str, Any]:
    path = find(str(section["file"]), places)
    sha = hashlib.sha256(path.read_bytes()).hexdigest()
    whole = {**section, "path": str(path), "sha256": sha}
    return {**whole, "height_mm": build.specimen(whole).height_mm}


def find(name: str, places: Sequence[Path]) -> Path:
    """Path of a surface file in or below one of some folders.

    Raises
    ------
    InputError
        If it is in none of them, or a link leads out of them.
    """
    check_relative(name, _WHERE)
    for folder in places:
        try:
            return locate(name, folder, where=_WHERE)
        except MissingDataError:
            continue
    looked = " or ".join(repr(str(folder)) for folder in places)
    parent = Path(name).parent
    names = sorted(
        p.name
        for folder in places
        for p in (folder / parent).glob("*")
        if p.suffix.lower() in (".stl", ".ply", ".obj")
    )
    mend = nearest(Path(name).name, names[:20]) if names else "name its folder with --data DIR"
    raise InputError(Fault(_WHERE, f"there is no file {name!r} below {looked}", mend))


def _check_use(config: Config) -> None:
    """Refuse what cannot be meshed or held, with placeholders for what a fit will find."""
    from study.forward.checks import check

    material = {**config["material"], "model": "neo-hookean", "order": None, "constants": None}
    depth = config["test"].get("displacement_mm") or (
        _USUAL_DEPTH * float(config["specimen"]["height_mm"])
    )
    check(build.problem({**config, "material": material}, {"C10": 0.005}, depth))


def surface_notes(configs: Sequence[Config]) -> tuple[str, ...]:
    """List what was mended in the surfaces of some configurations, each once."""
    return tuple(dict.fromkeys(note for config in configs for note in _notes(config)))


def _notes(config: Config) -> Iterator[str]:
    if _is_surface(config.get("specimen")):
        made = build.specimen(config["specimen"])
        if isinstance(made, Surface):
            yield from made.notes


def fingerprints(config: Config) -> list[str]:
    """Hashes of the surfaces that a configuration uses."""
    own = (config.get("calibration") or {}).get("problem") or {}
    sections = [config.get("specimen") or {}, own.get("specimen") or {}]
    return [section["sha256"] for section in sections if section.get("sha256")]
