"""What Python returns, as a notebook and a prompt show it: the same few tables in HTML and text."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, ClassVar, Self

from study.ground.canonical import Dataclass

if TYPE_CHECKING:
    import pandas as pd


class Shown(ABC):
    """A result whose last line in a cell, or at a prompt, is a table and not all of its arrays."""

    #: significant digits of a number
    digits: ClassVar[int] = 4

    @classmethod
    def of(cls, result: Dataclass) -> Self:
        """Give a result the ways to be shown: a class of these and of its own has its fields."""
        return cls(**{item.name: getattr(result, item.name) for item in fields(result)})

    @abstractmethod
    def tables(self) -> Sequence[pd.DataFrame]:
        """Tables that say what was found, the most important last."""

    def _repr_html_(self) -> str:
        """Tables in HTML."""
        return "\n".join(
            frame.to_html(index=False, na_rep="", float_format=self._number)
            for frame in self.tables()
        )

    def __repr__(self) -> str:
        """Tables in text."""
        return "\n\n".join(
            frame.to_string(index=False, na_rep="", float_format=self._number)
            for frame in self.tables()
            if len(frame)
        )

    def _number(self, value: float) -> str:
        return f"{value:.{self.digits}g}"
