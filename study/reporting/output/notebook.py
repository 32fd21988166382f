"""What Python returns, as a notebook and a prompt show it: its blocks in HTML and in text."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import fields
from io import StringIO
from typing import TYPE_CHECKING, Self

from study.ground.canonical import Dataclass
from study.reporting.output.page import fragment
from study.reporting.output.terminal import say

if TYPE_CHECKING:
    from study.reporting.content.blocks import Block


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
        """Blocks in HTML."""
        return fragment(self.blocks())

    def __repr__(self) -> str:
        """Blocks in text."""
        text = StringIO()
        say(self.blocks(), text)
        return text.getvalue().strip()
