"""Fixed inputs as a reader wants them: one line a part of the design."""

from __future__ import annotations

from collections.abc import Mapping

from study.reporting.text import clean, name_of


def grouped_inputs(inputs: Mapping[str, str]) -> dict[str, str]:
    """Join inputs with dotted keys into one line for each first part, in the order given.

    Examples
    --------
    >>> grouped_inputs({"specimen.shape": "cylinder", "specimen.radius": "25 mm", "mesh": "fine"})
    {'specimen': 'cylinder, radius 25 mm', 'mesh': 'fine'}
    """
    lines: dict[str, list[str]] = {}
    for key, value in inputs.items():
        part, _, rest = clean(key).partition(".")
        lines.setdefault(part, []).append(_phrase(rest, clean(value)))
    return {part: ", ".join(items) for part, items in lines.items()}


def _phrase(key: str, value: str) -> str:
    # a shape, a kind or a model is its own name
    if not key or key in ("shape", "kind", "model"):
        return value
    name = " ".join(name_of(part) for part in key.split("."))
    return f"{name} {value}"
