"""The page that watches studies: those at work with their progress, and all others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.reporting.content.text import clean
from study.reporting.output.page import _environment, policy_hash

if TYPE_CHECKING:
    from markupsafe import Markup


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
    script, style = _own("overview.js"), _own("style.css") + _own("overview.css")
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


def _own(name: str) -> Markup:
    """Text of a file of this package, which holds no word of a user."""
    from importlib.resources import files

    from markupsafe import Markup

    text = (files("study.reporting") / "templates" / name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704
