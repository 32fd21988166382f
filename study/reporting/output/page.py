"""Blocks as self-contained HTML pages, every word of a user escaped."""

from __future__ import annotations

import base64
import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Self

from markupsafe import Markup, escape

from study.ground.canonical import Dataclass
from study.ground.files import own_folder, write_atomic, write_error
from study.reporting.content import methods
from study.reporting.content.blocks import Block, Figure, Heading, Sentence, Table, flat
from study.reporting.content.effect_words import VERDICTS
from study.reporting.content.text import clean, sentence, slug
from study.reporting.output.terminal import say

if TYPE_CHECKING:
    from jinja2 import Environment


#: end of the name of the second page
DETAILS = "-details"


@dataclass(frozen=True)
class Page:
    """A page: its head, then blocks, of which headings of level 2 begin sections."""

    #: Of the window.
    title: str
    #: What kind of page it is, and the name of what it is about.
    kicker: str
    name: str
    question: str
    blocks: Sequence[Block | None]
    #: Of the folder of data beside the page, where its figures are files.
    files: str = ""
    #: Of the first page, on a second one; above its contents stands what both are about.
    back: str = ""
    about: str = ""
    flag: str = ""
    #: What is missing of a study that is not done.
    unfinished: str = ""
    #: Of a page whose rest a second one tells.
    footer: Sequence[Sentence] = ()

    @cached_property
    def flat(self) -> tuple[Block, ...]:
        """Every block, those that are folded away too."""
        return tuple(flat(block for block in self.blocks if block is not None))

    @property
    def tables(self) -> dict[str, Table]:
        """Tables by name."""
        return {block.name: block for block in self.flat if isinstance(block, Table)}

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures by name."""
        return {block.name: block for block in self.flat if isinstance(block, Figure)}

    def html(self) -> str:
        """Return the page as HTML.

        Nothing is loaded from anywhere: styles and drawings are inline, and the content security
        policy allows no script but the one that sorts and searches tables, by its hash. Every text
        that came from a user is escaped.
        """
        script, template = table_script(), _environment().get_template("page.html.j2")
        sections, trusted = list(_sections(self.blocks)), policy_hash(script)
        text = template.render(page=self, sections=sections, script=script, script_hash=trusted)
        # control and direction characters are no markup, yet no document may hold them
        return clean(text)


def fragment(blocks: Iterable[Block | None]) -> str:
    """Return blocks as HTML without a page around them."""
    nowhere = Page("", "", "", "", ())
    macros = _environment().get_template("blocks.html.j2").make_module({"page": nowhere})
    return clean("".join(macros.block(block) for block in blocks if block is not None))  # type: ignore[attr-defined]


def _sections(blocks: Iterable[Block | None]) -> Iterator[tuple[Heading | None, list[Block]]]:
    """Blocks of each section with its heading; those before the first have none."""
    heading: Heading | None = None
    members: list[Block] = []
    for block in (block for block in blocks if block is not None):
        if isinstance(block, Heading) and block.level == 2:
            if members:
                yield heading, members
            heading, members = block, []
        members.append(block)
    if members:
        yield heading, members


@dataclass(frozen=True)
class Pages:
    """The page of the answer, and that of everything else."""

    first: Page
    second: Page

    @property
    def tables(self) -> dict[str, Table]:
        """Tables by name."""
        return self.second.tables

    @property
    def figures(self) -> dict[str, Figure]:
        """Figures by name."""
        return {**self.first.figures, **self.second.figures}

    def html(self) -> tuple[str, str]:
        """Return the HTML of both."""
        return self.first.html(), self.second.html()


def page_names(stem: str) -> tuple[str, str]:
    """Names of the first page of a report and of the second."""
    return f"{stem}.html", f"{stem}{DETAILS}.html"


def printed(first: str, second: str) -> str:
    """Return both pages as one document, as a printer wants them."""
    return f"{first.partition('</main>')[0]}</main>\n<main>{second.partition('<main>')[2]}"


def table_script() -> Markup:
    """Return the script that sorts and searches tables, as it stands in the page."""
    return _packaged("tables.js")


def policy_hash(script: str) -> str:
    """Source expression (``sha256-`` and digest) that lets a page run this script alone."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


@cache  # a template is compiled once a process
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("study.reporting", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "kind": lambda block: type(block).__name__,
        "said": _said,
        "sub": _subscripts,
        # heading of a column, explained where the glossary holds it
        "term": lambda text: (
            methods.explained(text) if text in methods.TERMS else _subscripts(text)
        ),
        "cell": _cell,
        # only drawings that this package rendered pass unescaped
        "drawing": lambda figure: Markup(figure.svg),  # noqa: S704
        "slug": slug,
        "sentence": sentence,
    }
    return environment


def _said(block: Sentence) -> Markup:
    """Sentence with its lead in bold, its links, and the terms of the glossary explained."""
    # a note or a paragraph to be pasted explains no words
    text = _subscripts(block.words) if block.kind else _subscripts(methods.glossed(block.words))
    for words, address in block.links:
        link = Markup('<a href="{}">{}</a>').format(address, words)
        text = text.replace(escape(words), link, 1)
    return Markup("<b>{}</b> {}").format(block.lead, text) if block.lead else text


def _subscripts(text: str) -> Markup:
    """Text with ``u_num`` and its kin as a letter and its subscript, all else escaped."""
    if "u_" not in text:
        return escape(text)
    parts = re.sub(r"\bu_(num|val|input|D)\b", r"u<sub>\1</sub>", str(escape(text)))
    # escaped first, so nothing but these tags is markup
    return Markup(parts)  # noqa: S704


def _cell(text: str, column: str) -> Markup:
    """Cell of a table; a verdict and the outcome of a check have their color and their sign."""
    if column == "outcome":
        return Markup('<span class="outcome {}">{}</span>').format(slug(text), text)
    if column != "verdict" or text not in VERDICTS:
        return _subscripts(text)
    return Markup('<span class="verdict {}">{}</span>').format(slug(text), text)


# Files of a report: each replaced whole, none outside the folder it was asked for.
#
# A project may come from others, with links in it that lead elsewhere. The folder that the user
# names may be a link; what the program puts below it may not lead out again.


def data_folder(folder: Path, stem: str) -> Path:
    """Make the folder for what a page was drawn from, beside the page."""
    files = own_folder(folder, f"{stem}-data")
    try:
        files.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise write_error(files, error) from error
    return files


def replace_file(path: Path, text: str) -> None:
    """Write a text beside, then rename: a reader never sees half a file."""
    replace_bytes(path, text.encode())


def replace_bytes(path: Path, data: bytes) -> None:
    """Write the bytes of a file beside, then rename; see :func:`replace_file`."""
    write_atomic(path, data, flush=False)


@dataclass(frozen=True)
class StudyProgress:
    """How many computations of how many a runner has done, and the same in words."""

    done: int
    total: int
    said: str


@dataclass(frozen=True)
class StudyState:
    """One study as its folders show it: its cases in words, and the address of its report."""

    name: str
    question: str
    cases: str
    progress: StudyProgress | None
    page: str


def render_overview(states: Sequence[StudyState]) -> tuple[str, str]:
    """Return the page of every study, and the policy that lets it run its own script and style."""
    script, style = _packaged("overview.js"), _packaged("style.css") + _packaged("overview.css")
    text: str = _environment().get_template("overview.html.j2").render(
        running=[state for state in states if state.progress is not None],
        others=[state for state in states if state.progress is None],
        script=script,
        style=style,
        clean=clean,
    )  # fmt: skip
    policy = (
        f"default-src 'none'; style-src '{policy_hash(style)}'; "
        f"script-src '{policy_hash(script)}'; connect-src 'self'; img-src data:; "
        "form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
    )
    return text, policy


def _packaged(name: str) -> Markup:
    """Text of a file of this package, which holds no word of a user."""
    from importlib.resources import files

    text = (files("study.reporting") / "templates" / name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704


class Shown(ABC):
    """A result whose last line in a cell, or at a prompt, is what a terminal shows of it."""

    @classmethod
    def of(cls, result: Dataclass) -> Self:
        """Give a result the ways to be shown: a class of these and of its own has its fields."""
        return cls(**{item.name: getattr(result, item.name) for item in fields(result)})

    @abstractmethod
    def blocks(self) -> Iterable[Block | None]:
        """Return what the result says: headings, sentences, tables and figures."""

    def _repr_html_(self) -> str:
        return fragment(self.blocks())

    def __repr__(self) -> str:
        """Blocks in text."""
        text = StringIO()
        say(self.blocks(), text)
        return text.getvalue().strip()
