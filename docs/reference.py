"""The pages of the site that are made from the program: keys of a file, Python, shipped studies."""

from __future__ import annotations

import ast
import contextlib
import inspect
import io
import json
import pprint
import re
import shutil
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gallery_pictures

import study
from study.external.forward_model import ForwardModel
from study.ground import declaration, units
from study.harness.design import spec
from study.harness.design.layouts import LAYOUTS
from study.mechanics.measurement.measurement_section import MarkerSpec, MeasurementSpec
from study.mechanics.setup.calibration_table import Calibration
from study.mechanics.setup.geometry import INDENTERS, SPECIMENS
from study.mechanics.setup.setup import Model
from study.mechanics.setup.test_kind import Test
from study.simulation.problem_file import MaterialTable

HERE = Path(__file__).parent
#: Header of a table in a file, and the class that declares its keys.
TABLES: tuple[tuple[str, type], ...] = (
    *((f'[specimen] with shape = "{name}"', kind) for name, kind in SPECIMENS.items()),
    ("[test]", Test),
    *((f'indenter with shape = "{name}"', kind) for name, kind in INDENTERS.items()),
    ("[model]", Model),
    ("[material]", MaterialTable),
    ("[measurements]", MeasurementSpec),
    ("[markers]", MarkerSpec),
    ("[calibration]", Calibration),
    ("[forward]", ForwardModel),
    *((f'[design] with kind = "{name}"', kind) for name, kind in LAYOUTS.items()),
    *(
        (f"[[{key.written}]]" if key.rows else f"[{key.written}]", key.kind)
        for key in declaration.keys_of(spec.DesignFile)
        if key.kind is not None
    ),
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
    return _plain((inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " "))


def _plain(text: str) -> str:
    """Text of a docstring without the roles and the double quotes of reStructuredText."""
    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", text).replace("``", "`")


def _rows(kind: type) -> Iterable[str]:
    yield "| key | what it is | value | default |"
    yield "| --- | --- | --- | --- |"
    said = _said(kind)
    for key in declaration.keys_of(kind):
        if not key.is_derived:
            cells = (f"`{key.written}`", said.get(key.name, ""), _value(key), _default(key))
            yield f"| {' | '.join(_plain(cell).replace('|', chr(92) + '|') for cell in cells)} |"


def _said(kind: type) -> dict[str, str]:
    """Text of each field of a section: the comment above it, in the class or a base of it."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__[:-1]):
        lines: list[str] = []
        for line in inspect.getsource(base).splitlines():
            if line.startswith("    #: "):
                lines.append(line.removeprefix("    #: "))
            elif lines:
                text = " ".join(lines).rstrip(".")
                # the words themselves stand in the next column
                texts[line.split(":")[0].strip()] = "" if text.startswith("One of :data:") else text
                lines = []
    return texts


#: values that break every rule there is, each another one: of the type, of the range, of the words
WRONG = (10**18, object(), "?")
#: what a rule begins with, and what an example in a mend
RULE = re.compile(r"^(must be|may have|is) ")
EXAMPLE = re.compile(r"(?:^|write, |, )for example,? (.+)")


def _broken(reads: declaration.Reads) -> declaration.Faults:
    faults = declaration.Faults()
    for wrong in WRONG:
        declaration.noted(reads.read, wrong, "", faults)
    return faults


def _value(key: declaration.Key) -> str:
    """Say which values a key may have, and give one, from its declaration and its rules."""
    if key.kind is not None:
        return f"table with {', '.join(f'`{name}`' for name in declaration.written_keys(key.kind))}"
    if key.reads is None:  # the word that says which section this is
        return f"`{json.dumps(key.default)}`"
    broken = _broken(key.reads)
    given = key.mend or next((b.mend for b in broken if EXAMPLE.search(b.mend)), "")
    match = EXAMPLE.search(given)
    example = given.rpartition(": ")[2] if "=" in given else ""
    if match is not None:
        example = re.split(r" \(Valid|; ", match[1])[0]
    is_plain = key.reads.dimension in ("", "number")
    what = _rule(broken) if is_plain else f"{_article(key.reads.dimension)} with its unit"
    return ", ".join(part for part in (what, example and f"for example `{example}`") if part)


def _rule(broken: declaration.Faults) -> str:
    """Values that a rule allows: its words, the range of a number, or what it must be."""
    rules = {RULE.sub("", re.sub(r",? got .*", "", b.rule)): b.mend for b in broken}
    for mend in rules.values():
        if mend.startswith("Valid: "):
            return f"one of {mend.removeprefix('Valid: ')}"
    ranges = [rule for rule in rules if re.search(r"\b(from|between|at least|above)\b.*\d", rule)]
    rule = next(iter([*ranges, *rules]), "")
    return "a number with its unit" if rule.startswith("needs a unit") else rule


def _article(dimension: str) -> str:
    return f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension}"


def _default(key: declaration.Key) -> str:
    if key.must_be_written:
        return "must be written"
    if key.kind is not None or key.default in (None, "", ()):
        return ""
    values = key.default if isinstance(key.default, tuple) else (key.default,)
    return ", ".join(f"`{json.dumps(value)}`" for value in values)


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


def run_cell(text: str, names: dict[str, object]) -> object:
    """Run a cell as a notebook does: the value of a last expression is what it shows."""
    *body, last = ast.parse(text).body
    if not isinstance(last, ast.Expr):
        exec(compile(text, "a cell", "exec"), names)
        return None
    exec(compile(ast.Module(body, []), "a cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "a cell", "eval"), names)


def outputs_of(cell: Mapping[str, Any], number: int, names: dict[str, object]) -> list[Any]:
    """Run a cell of a notebook, and return what it prints and shows as a notebook keeps it."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        shown = run_cell("".join(cell["source"]), names)
    kept: list[Any] = []
    if text := printed.getvalue():
        kept.append({"name": "stdout", "output_type": "stream", "text": text.splitlines(True)})
    if shown is not None:
        data = {"text/plain": pprint.pformat(shown).splitlines(True)}
        if hasattr(shown, "_repr_svg_"):
            data = {"image/svg+xml": shown._repr_svg_().splitlines(True)}
        kept.append({"data": data, "execution_count": number, "metadata": {},
                     "output_type": "execute_result"})  # fmt: skip
    return kept


def keep_outputs(path: Path) -> None:
    """Run a notebook from top to bottom in an empty folder, and keep its outputs in it."""
    notebook, names = json.loads(path.read_text(encoding="utf-8")), dict[str, object]()
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for number, cell in enumerate(cells, 1):
            cell["execution_count"] = number
            cell["outputs"] = outputs_of(cell, number, names)
    text = json.dumps(notebook, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def cookbook(path: Path) -> str:
    """Return the page of the cookbook: its notebook, whose cells a test runs, with its outputs."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        parts += [f"```python\n{text}\n```" if cell["cell_type"] == "code" else text]
        for output in cell.get("outputs", ()):
            data = output.get("data", {"text/plain": output.get("text")})
            language, lines = next(iter(data.items()))
            kind = "{raw} html" if language == "image/svg+xml" else "text"
            parts += [f"```{kind}\n{''.join(lines).rstrip()}\n```"]
    note = f"The same as a notebook: {{download}}`{path.name}`."
    return "\n\n".join([parts[0], note, *parts[1:]]) + "\n"


def gallery(folder: Path, reports: Iterable[str] = ()) -> str:
    """Return the page of the shipped studies: question, factors, commands, answer and report.

    Parameters
    ----------
    folder : Path
        The folder of the design files.
    reports : iterable of str
        Addresses below the site of the reports that were found, `studies/<name>/<page>.html`.
    """
    answers = json.loads((HERE / "gallery" / "answers.json").read_text(encoding="utf-8"))
    links = {address.split("/")[1]: address for address in reports}
    parts = [
        "# Shipped studies",
        "",
        "Every file stands in `designs/` and runs with the commands below it. Where a command says "
        "`FOLDER`, put the folder of your measurements. `make gallery` runs those with a picture "
        "(some minutes) and takes the pictures; after it, and after a study of your own run of any "
        "other, `make docs` puts the whole report beside it.",
        "",
    ]
    for path in sorted(folder.glob("*.toml"), key=lambda path: (path.stem not in answers, path)):
        parts += _shipped(path, answers.get(path.stem, {}).get("answer", ""), links)
    return "\n".join(parts) + "\n"


def gather(designs: Path, folders: Iterable[Path], site: Path) -> list[str]:
    """Copy the reports of shipped studies to where the site takes them from.

    Parameters
    ----------
    designs : Path
        The folder of the design files.
    folders : iterable of Path
        Folders of reports; where two hold the same study, the later one counts.
    site : Path
        Folder that is copied into the site; it is made anew.

    Returns
    -------
    list of str
        The addresses of the reports below the site.
    """
    shutil.rmtree(site, ignore_errors=True)
    site.mkdir(parents=True)
    found = {}
    for folder in folders:
        for name in sorted(path.stem for path in designs.glob("*.toml")):
            page = gallery_pictures.report(name, folder)
            if page is not None:
                shutil.copytree(page.parent, site / "studies" / name, dirs_exist_ok=True)
                found[name] = f"studies/{name}/{page.name}"
    return list(found.values())


def _factors(table: Mapping[str, object], above: str = "") -> Iterator[str]:
    """One line for each factor; `model.space` is read as a table in a table."""
    for name, levels in table.items():
        if isinstance(levels, dict) and {"low", "high"} <= set(levels):
            yield f"- `{above}{name}`: {levels['low']} to {levels['high']}"
        elif isinstance(levels, dict):
            yield from _factors(levels, f"{above}{name}.")
        elif isinstance(levels, list):
            yield f"- `{above}{name}`: {', '.join(map(str, levels))}"


def _shipped(path: Path, answer: str, links: Mapping[str, str]) -> Iterator[str]:
    """Section of one shipped file."""
    text = path.read_text(encoding="utf-8")
    document = tomllib.loads(text)
    yield f"## {path.stem}"
    yield ""
    first = text.partition("\n")[0].removeprefix("# ")
    yield f"*{document.get('study', {}).get('question', first)}*"
    yield ""
    yield from _factors(document.get("factors", {}))
    yield ""
    yield "```sh"
    yield "\n".join(gallery_pictures.commands(text))
    yield "```"
    yield ""
    if answer:
        shown = gallery_pictures.SHOWN[path.stem].relative_to(HERE)
        yield f"{answer}"
        yield ""
        yield f"![First screen of the report of {path.stem}: {answer}]({shown})"
        yield ""
    if path.stem in links:
        yield f'<a href="{links[path.stem]}">The whole report of {path.stem}</a>'
        yield ""


if __name__ == "__main__":
    keep_outputs(HERE / "cookbook.ipynb")
