"""The pages of the site that are made from the program: keys of a file, Python, shipped studies."""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

from numpydoc.docscrape import NumpyDocString

import study
from study import units
from study.design import study_file
from study.design.layout.schemes import LAYOUTS
from study.design.sections.calibration import Calibration
from study.measurement.section import MeasurementSpec
from study.setup import section as declaration
from study.setup.geometry import INDENTERS, SPECIMENS
from study.setup.setup import Model
from study.setup.test_section import TestSection

#: Header of a table in a file, and the class that declares its keys.
TABLES: tuple[tuple[str, type], ...] = (
    ("[study]", study_file.Study),
    *((f'[specimen] with shape = "{name}"', kind) for name, kind in SPECIMENS.items()),
    ("[test]", TestSection),
    *((f'indenter with shape = "{name}"', kind) for name, kind in INDENTERS.items()),
    ("[model]", Model),
    ("[measurements]", MeasurementSpec),
    ("[calibration]", Calibration),
    *((f'[design] with kind = "{name}"', kind) for name, kind in LAYOUTS.items()),
    ("[[response]]", study_file.ResponseTable),
    ("[[exclude]]", study_file.ExclusionTable),
    ("[analysis]", study_file.AnalysisTable),
    ("[replicates]", study_file.Replicates),
    ("[execution]", study_file.Execution),
    ("[converge]", study_file.Converge),
    ("[report]", study_file.Report),
)


def design_file() -> str:
    """Return the reference of the study file, read from the declarations of its keys."""
    parts = [
        "# The design file: every key",
        "",
        "This page is made from the declarations that read the file, so it lists all keys "
        'and no others. A quantity is written as text with its unit (`"25 mm"`). '
        "`study new FILE` writes a commented file to start from.",
        "",
    ]
    for header, kind in TABLES:
        parts += [f"## `{header}`", "", _summary(kind), "", *_rows(kind), ""]
    parts += ["## Dimensions", "", "| dimension | inside the program |", "| --- | --- |"]
    parts += [f"| {name} | {unit} |" for name, unit in units.INTERNAL.items()]
    return "\n".join(parts) + "\n"


def _summary(kind: type) -> str:
    return (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")


def _rows(kind: type) -> Iterable[str]:
    yield "| key | what it holds | default |"
    yield "| --- | --- | --- |"
    said = _said(kind)
    for key in declaration.keys_of(kind):
        if not key.is_derived:
            yield f"| `{key.written}` | {_holds(key, said)} | {_default(key)} |"


def _said(kind: type) -> dict[str, str]:
    """Return what the docstring of a section says of its fields, by field."""
    written = NumpyDocString(inspect.getdoc(kind) or "")
    return {
        name.strip(): " ".join(one.desc).strip().rstrip(".")
        for one in written["Parameters"]
        for name in one.name.split(",")
    }


def _rule(reads: declaration.Reads) -> str:
    """Return the rule of a plain value: what its reader says of one that breaks every rule."""
    for wrong in ("?", object()):
        try:
            reads(wrong)
        except declaration.Bad as broken:
            if broken.mend.startswith("Valid: "):
                return f"one of {broken.mend.removeprefix('Valid: ')}"
            rule = re.sub(r",? got .*", "", broken.rule)
            return f"{rule}; {broken.mend}" if wrong == "?" and broken.mend else rule
    return ""


def _holds(key: declaration.Key, said: dict[str, str]) -> str:
    """Say what a key holds: its docstring, its unit, what to write where it is missing."""
    parts = [said.get(key.name, "")]
    if key.reads is not None and key.reads.dimension:
        parts.append(f"with a unit of {key.reads.dimension}")
    elif key.reads is not None:
        parts.append(_rule(key.reads))
    if key.reads is None or not key.reads.dimension:
        parts.append(key.mend)
    if key.kind is not None:
        parts.append(f"table with {', '.join(declaration.written_keys(key.kind))}")
    return "; ".join(part for part in parts if part).replace("|", "\\|")


def _default(key: declaration.Key) -> str:
    if key.must_be_written:
        return "must be written"
    if key.kind is not None or key.default is None:
        return ""
    return f"`{key.default!r}`".replace("|", "\\|")


def python() -> str:
    """Return the page of the public functions."""
    parts = [
        "# Python",
        "",
        "Everything that the command line does is a function of the package. Numbers are in mm, N, "
        "MPa and s; paths may be text.",
        "",
    ]
    for name in sorted(study.__all__):
        if callable(getattr(study, name)):
            parts += [f"## `study.{name}`", "", "```{eval-rst}", f".. autofunction:: study.{name}"]
            parts += ["```", ""]
    return "\n".join(parts)


def cookbook(path: Path) -> str:
    """Return the page of the cookbook: its notebook, whose cells a test runs."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts += [f"```python\n{text}\n```" if cell["cell_type"] == "code" else text]
    note = f"The same as a notebook: {{download}}`{path.name}`."
    return "\n\n".join([parts[0], note, *parts[1:]]) + "\n"


def gallery(folder: Path) -> str:
    """Return the page of the shipped studies: their question, factors and command."""
    parts = [
        "# Shipped studies",
        "",
        "Every file stands in `designs/` and runs with the command below it. What a file needs "
        "beforehand stands in its first lines.",
        "",
    ]
    for path in sorted(folder.glob("*.toml")):
        parts += _shipped(path)
    return "\n".join(parts) + "\n"


def _shipped(path: Path) -> Iterable[str]:
    """Section of one shipped file."""
    text = path.read_text(encoding="utf-8")
    document = tomllib.loads(text)
    yield f"## {path.stem}"
    yield ""
    question = document.get("study", {}).get("question", "")
    if question:
        yield f"*{question}*"
        yield ""
    for name, levels in document.get("factors", {}).items():
        shown = ", ".join(map(str, levels)) if isinstance(levels, list) else str(levels)
        yield f"- `{name}`: {shown}"
    yield ""
    commands = [
        line.removeprefix("#").strip()
        for line in text.splitlines()[:12]
        if line.startswith("#   study")
    ]
    yield "```sh"
    yield "\n".join(commands or [f"study run designs/{path.name}"])
    yield "```"
    yield ""
