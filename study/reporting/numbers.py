"""Numbers and names as a reader wants them: three digits, units, p without a leading zero."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from study.study_result.report_data import ReportData

MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"
MISSING = "\N{EN DASH}"
THIN = "\N{NO-BREAK SPACE}"
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


def significant(value: float | None, digits: int = 3) -> str:
    """Three significant digits, never an exponent for the sizes met in a laboratory.

    Parameters
    ----------
    value, digits : float or None, int
        None and what is not finite become a dash; significant digits, at least 1.

    Examples
    --------
    >>> significant(0.0123456), significant(12345.6), significant(2.0), significant(None)
    ('0.0123', '12,300', '2.00', '\N{EN DASH}')
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if exponent < -4 or exponent > 6:
        mantissa = f"{rounded / 10.0**exponent:.{digits - 1}f}"
        return f"{mantissa}e{exponent}".replace("-", MINUS)
    return f"{rounded:,.{max(digits - 1 - exponent, 0)}f}".replace("-", MINUS)


def p_value(p: float | None) -> str:
    """Write a p-value: three decimals, no leading zero, bounds at the ends.

    Examples
    --------
    >>> p_value(0.0321), p_value(0.0004), p_value(0.9999), p_value(None)
    ('.032', '< .001', '> .999', '\N{EN DASH}')
    """
    if p is None or not math.isfinite(p):
        return MISSING
    if p < 0.0005:
        return "< .001"
    if p >= 0.9995:
        return "> .999"
    return f"{p:.3f}"[1:]


def p_phrase(p: float | None) -> str:
    """``p = .032`` or ``p < .001`` for a sentence."""
    text = p_value(p)
    if text == MISSING:
        return "no p"
    return f"p {text}" if text[0] in "<>" else f"p = {text}"


def quantity(value: float | None, unit: str = "", digits: int = 3) -> str:
    """Write a number with its unit, kept together by a space that does not break.

    Parameters
    ----------
    value, unit, digits : float or None, str, int
        As for :func:`significant`; a ``unit`` of ``""`` or ``"1"`` is not written.
    """
    number = significant(value, digits)
    if number == MISSING or unit in ("", "1"):
        return number
    return f"{number}{THIN}{unit}"


def percent(fraction: float | None, digits: int = 3) -> str:
    """Write a fraction as a percentage; below a tenth of a percent only said to be so."""
    if fraction is not None and 0 < abs(fraction) < 0.0005:
        return f"< 0.1{THIN}%" if fraction > 0 else f"{MINUS}< 0.1{THIN}%"
    if fraction is not None and abs(fraction) >= 0.9995:
        return quantity(100 * fraction, "%", max(digits, 3))
    return quantity(None if fraction is None else 100 * fraction, "%", digits)


def level(alpha: float) -> str:
    """Write the level of an interval.

    Examples
    --------
    >>> level(0.05).replace(THIN, " "), level(0.2).replace(THIN, " ")
    ('95 %', '80 %')
    """
    return f"{100 * (1 - alpha):.4g}{THIN}%"


def interval(low: float | None, high: float | None, unit: str = "", digits: int = 3) -> str:
    """Write a confidence interval, both ends with the decimals of the larger one."""
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    largest = max(abs(low), abs(high))
    if largest == 0 or not 1e-3 <= largest < 1e5:
        return f"{significant(low, digits)} to {quantity(high, unit, digits)}"
    ends = [_fixed(end, _decimals(largest, digits)) for end in (low, high)]
    return f"{ends[0]} to {ends[1]}" + (f"{THIN}{unit}" if unit else "")


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:,.{decimals}f}"
    if float(text.replace(",", "")) == 0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def decimals_that_count(step: float | None) -> int | None:
    """Decimals that a thousandth of what matters can be read at; None where that is unknown.

    Examples
    --------
    >>> decimals_that_count(0.5), decimals_that_count(5), decimals_that_count(None)
    (3, 2, None)
    """
    if step is None or not math.isfinite(step) or step <= 0:
        return None
    return max(math.floor(-math.log10(step / 1000) + 1e-9), 0)


def rounded(value: float | None, decimals: int | None, digits: int = 3) -> str:
    """Three significant digits, but no finer than ``decimals``; ``< 0.001`` below them.

    Examples
    --------
    >>> rounded(0.0912, 3), rounded(0.000267, 3), rounded(0.155, 3), rounded(0.0, 3)
    ('0.091', '< 0.001', '0.155', '0')
    """
    if value is None or decimals is None or value == 0 or not math.isfinite(value):
        return significant(value, digits)
    least = 10.0**-decimals
    if abs(value) < least / 2:
        return f"{'' if value > 0 else MINUS}< {least:.{decimals}f}"
    return _fixed(value, min(_decimals(abs(value), digits), decimals))


def span(low: float | None, high: float | None, decimals: int | None, digits: int = 3) -> str:
    """Write both ends with the same decimals: as few as tell them apart, at most ``decimals``.

    Examples
    --------
    >>> span(1.4336, 1.4341, 4), span(0.0249, 0.2854, 3), span(-3.9e-5, 5.7e-4, 3)
    ('1.4336 to 1.4341', '0.025 to 0.285', '0.000 to 0.001')
    """
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    if decimals is None:
        return interval(low, high, "", digits)
    largest = max(abs(low), abs(high))
    places = min(_decimals(largest, digits), decimals) if largest else 0
    while places < decimals and round(low, places) == round(high, places):
        places += 1
    return f"{_fixed(low, places)} to {_fixed(high, places)}"


def inside(
    value: float | None, low: float | None, high: float | None, shown: str, ends: str
) -> str:
    """Write an estimate as finely as its interval where it would else stand outside of it.

    Parameters
    ----------
    value, low, high : float or None
        Estimate and ends, not rounded; None where there is none.
    shown, ends : str
        The estimate and its interval as they would be printed.

    Examples
    --------
    >>> inside(1.42716, 1.4271, 1.4272, "1.43", "1.4271 to 1.4272")
    '1.4272'
    >>> inside(0.156, 0.026, 0.286, "0.156", "0.026 to 0.286")
    '0.156'
    """
    places = [len(text.partition(".")[2]) for text in (shown, ends.partition(" to ")[0])]
    if value is None or low is None or high is None or places[1] <= places[0]:
        return shown
    if round(low, places[1]) <= round(value, places[0]) <= round(high, places[1]):
        return shown
    return _fixed(value, places[1])


def _decimals(value: float, digits: int) -> int:
    # log10 of the value as it will be printed: 9.999 is 10.0
    exponent = math.floor(math.log10(float(f"{value:.{digits - 1}e}")))
    return max(digits - 1 - exponent, 0)


def f_value(value: float | None, most: float = 1e4) -> str:
    """F of a table; beyond ``most`` only said to be so, for its digits mean nothing.

    Examples
    --------
    >>> f_value(17.9), f_value(7.61e9), f_value(None)
    ('17.9', '> 10,000', '\N{EN DASH}')
    """
    if value is not None and math.isfinite(value) and value > most:
        return f"> {most:,.0f}"
    return significant(value)


def share(fraction: float | None) -> str:
    """Write a share of a total in percent with one decimal."""
    if fraction is None or not math.isfinite(fraction):
        return MISSING
    if 0 < fraction < 0.0005:
        return f"< 0.1{THIN}%"
    return f"{100 * fraction:.1f}{THIN}%"


def ratio_digits(value: float | None) -> int:
    """Digits that a ratio needs: more near 1, so that a small change is not hidden."""
    if value is None or not math.isfinite(value):
        return 3
    away = abs(value - 1)
    return 3 if away >= 0.05 else 4 if away >= 0.005 else 5


def ratio(value: float | None) -> str:
    """Write a ratio with a multiplication sign; ``1.0004`` keeps the digits that differ from 1."""
    text = significant(value, ratio_digits(value))
    return text if text == MISSING else f"{TIMES}{THIN}{text}"


def duration(seconds: float | None) -> str:
    """Seconds in the unit a person would use.

    Examples
    --------
    >>> [duration(s).replace(THIN, " ") for s in (0.02, 5.1, 90, 5400)]
    ['20 ms', '5.1 s', '1.5 min', '1.5 h']
    """
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    for limit, size, unit in ((1, 1e-3, "ms"), (60, 1, "s"), (3600, 60, "min")):
        if seconds < limit:
            return f"{float(f'{seconds / size:.2g}'):g}{THIN}{unit}"
    return f"{seconds / 3600:.3g}{THIN}h"


def count(number: int, noun: str, plural: str = "") -> str:
    """Write a counted noun: ``1 cell``, ``16 cells``, ``1,024 cells``."""
    return f"{number:,} {noun if number == 1 else plural or plural_of(noun)}"


def plural_of(noun: str) -> str:
    """Plural of a noun; a name that is no plain word only gets its s.

    Examples
    --------
    >>> plural_of("batch"), plural_of("phantom"), plural_of("assembly"), plural_of("day")
    ('batches', 'phantoms', 'assemblies', 'days')
    """
    if noun.endswith(("s", "x", "z", "ch", "sh")):
        return noun + "es"
    if noun.endswith("y") and noun[-2:-1] not in tuple("aeiou"):
        return noun[:-1] + "ies"
    return noun + "s"


def clean(text: object, longest: int = 0) -> str:
    """User text without control and direction characters, shortened where asked.

    A character that XML forbids becomes the replacement character, so nothing vanishes.

    Parameters
    ----------
    text, longest : object, int
        Whatever ``str`` takes; characters at most, 0 for all of them.
    """
    shown = _UNSAFE.sub("\ufffd", str(text))
    if longest and len(shown) > longest:
        return shown[: longest - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return shown


def name_of(key: str, labels: Mapping[str, str] | None = None) -> str:
    """Readable name of a factor or a response.

    Parameters
    ----------
    key, labels : str, mapping of str to str or None
        Column or dotted key; names by key that come before all others.

    Examples
    --------
    >>> name_of("model.element_order"), name_of("mu0"), name_of("force_at_2.5_mm")
    ('element order', 'initial shear modulus', 'force at 2.5 mm')
    """
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
    """Items as in a sentence.

    Examples
    --------
    >>> listing(["a"]), listing(["a", "b"]), listing(["a", "b", "c"])
    ('a', 'a and b', 'a, b and c')
    """
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


def folded(found: Sequence[tuple[str, str]], data: ReportData) -> tuple[str, ...]:
    """Fold warnings of several responses and terms that differ in names and numbers alone.

    Parameters
    ----------
    found : sequence of (str, str)
        Title of the response, warning; a warning about a term begins with it and a colon.
    data : ReportData
        For the factors, which terms are made of, and their shown names.

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
