"""Words of a report: names, lists, plurals, sentences, and text that is safe in a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from study.reporting.content.numbers import TIMES
from study.reporting.results.study_result import ReportData

_NAMES = {
    "relative_rms_force_error": "relative RMS force error",
    "rms_force_error": "RMS force error",
    "peak_force_error": "peak force error",
    "work_error": "work error",
    "curve_rms": "RMS force",
    "marker_error": "marker error",
    "predicted_marker_error": "error of predicted markers",
    "mu0": "initial shear modulus",
    "seconds": "computing time",
    "dofs": "unknowns",
    "poisson_ratio": "Poisson's ratio",
    "youngs_modulus": "Young's modulus",
}

# Characters that no XML document may hold, and those that reverse the reading direction.
_UNSAFE = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff\u202a-\u202e\u2066-\u2069]"
)


def count(number: int, noun: str, plural: str = "") -> str:
    """Write a counted noun: ``1 cell``, ``16 cells``, ``1,024 cells``."""
    return f"{number:,} {noun if number == 1 else plural or plural_of(noun)}"


def plural_of(noun: str) -> str:
    """Plural of a noun; a name that is no plain word only gets its s, one letter has levels."""
    if len(noun) == 1:
        return f"levels of {noun}"
    if noun.endswith(("s", "x", "z", "ch", "sh")):
        return noun + "es"
    if noun.endswith("y") and noun[-2:-1] not in tuple("aeiou"):
        return noun[:-1] + "ies"
    return noun + "s"


def clean(text: object, longest: int = 0) -> str:
    """User text without control and direction characters, shortened where asked.

    A character that XML forbids becomes the replacement character, so nothing vanishes.
    """
    shown = _UNSAFE.sub("\ufffd", str(text))
    if longest and len(shown) > longest:
        return shown[: longest - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return shown


def name_of(key: str, labels: Mapping[str, str] | None = None) -> str:
    """Readable name of a factor or a response."""
    if labels and key in labels:
        return clean(labels[key])
    if key in _NAMES:
        return _NAMES[key]
    # a dot between two digits is one of a number
    last = re.split(r"\.(?!\d)", key)[-1]
    return _NAMES.get(last) or clean(last.replace("_", " ") or key)


def term_name(term: str, labels: Mapping[str, str] | None = None) -> str:
    """Readable name of an ANOVA term, interactions with a multiplication sign."""
    if term == "residual":
        return "residual"
    return f" {TIMES} ".join(name_of(part, labels) for part in term.split(":"))


def listing(items: Sequence[str], word: str = "and") -> str:
    """Items as in a sentence."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {word} {items[-1]}"


def sentence(text: str) -> str:
    """Text with a capital first letter and a full stop."""
    text = text.strip()
    if not text:
        return ""
    closed = text if text[-1] in ".?!:" else text + "."
    return closed[0].upper() + closed[1:]


_MOST = 4


def folded(warnings: Sequence[tuple[str, str]], data: ReportData) -> tuple[str, ...]:
    """Fold warnings of several responses and terms that differ in names and numbers alone."""
    groups: dict[tuple[str, bool], list[tuple[str, str, str]]] = {}
    for title, warning in warnings:
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
