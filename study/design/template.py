"""The commented design that ``study new`` writes; it loads as it stands."""

from __future__ import annotations

from importlib import resources


def template() -> str:
    """Text of a commented, valid design to start from.

    Examples
    --------
    >>> template().startswith("# A study")
    True
    """
    return resources.files("study.design").joinpath("template.toml").read_text(encoding="utf-8")
