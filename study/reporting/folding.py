"""Many warnings that say one thing, as one line."""

from __future__ import annotations

import re
from collections.abc import Sequence

from study.reporting.data import ReportData
from study.reporting.text import listing, sentence, term_name

_MOST = 4


def folded(found: Sequence[tuple[str, str]], data: ReportData) -> tuple[str, ...]:
    """Fold warnings of several responses and terms that differ in names and numbers alone.

    Parameters
    ----------
    found : sequence of (str, str)
        Title of the response, warning; a warning about a term begins with it and a colon.

    Returns
    -------
    tuple of str
        Sentences in the order of their first appearance.
    """
    groups: dict[tuple[str, bool], list[tuple[str, str, str]]] = {}
    for title, warning in found:
        term, text = _split(warning, data)
        # warnings about a term may differ in their numbers, others must be the same
        key = re.sub(r"\d+", "#", text) if term else text
        groups.setdefault((key, bool(term)), []).append((title, term, text))
    return tuple(_line(items) for items in groups.values())


def _split(warning: str, data: ReportData) -> tuple[str, str]:
    """Term that a warning is about (empty for none) and what it says."""
    head, colon, rest = warning.partition(": ")
    if colon and set(head.split(":")) <= set(data.factors):
        return term_name(head, data.labels), rest
    return "", warning


def _line(items: Sequence[tuple[str, str, str]]) -> str:
    titles = listing(list(dict.fromkeys(title for title, _, _ in items)))
    terms = list(dict.fromkeys(term for _, term, _ in items if term))
    if len(terms) > _MOST:
        terms = [*terms[:_MOST], f"{len(terms) - _MOST} more terms"]
    about = f"{listing(terms)}: " if terms else ""
    return sentence(f"{titles}: {about}{items[0][2]}")
