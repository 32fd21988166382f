"""Numbers and names as a reader wants them: digits, units, lists, plurals, safe text."""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from study.ground import units

MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"
MISSING = "\N{EN DASH}"
THIN = "\N{NO-BREAK SPACE}"


def significant(value: float | None, digits: int = 3) -> str:
    """Three significant digits, never an exponent for the sizes met in a laboratory."""
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


def trimmed(value: float, digits: int = 3) -> str:
    """Significant digits without zeros at their end: ``0.5``, ``1,000,000``."""
    number, *exponent = significant(value, digits).partition("e")
    return (number.rstrip("0").rstrip(".") if "." in number else number) + "".join(exponent)


def p_value(p: float | None) -> str:
    """Write a p-value; a dash for none."""
    return MISSING if p is None or not math.isfinite(p) else units.written_p(p)


def p_phrase(p: float | None) -> str:
    """``p = .032`` or ``p < .001`` for a sentence."""
    return "no p" if p is None or not math.isfinite(p) else units.p_phrase(p)


def general(value: float | None, digits: int = 4) -> str:
    """Write a number to a precision, without zeros at its end; a dash for none."""
    return "-" if value is None else f"{value + 0.0:.{digits}g}"  # no minus zero


def between(ends: Sequence[float | None] | None, digits: int = 5) -> str:
    """Write both ends of an interval to a precision; a dash for none."""
    return "-" if ends is None else " to ".join(general(end, digits) for end in ends)


def quantity(value: float | None, unit: str = "", digits: int = 3) -> str:
    """Write a number with its unit, kept together by a space that does not break."""
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
    """Write the level of an interval."""
    return f"{100 * (1 - alpha):.4g}{THIN}%"


def interval(low: float | None, high: float | None, unit: str = "", digits: int = 3) -> str:
    """Write an interval with the decimals of its larger end, more where both would look alike."""
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    largest = max(abs(low), abs(high))
    if largest == 0 or not 1e-3 <= largest < 1e5:
        ends = [significant(low, digits), significant(high, digits)]
    else:
        ends = [_fixed(end, _decimals(largest, digits)) for end in (low, high)]
    if ends[0] == ends[1] and low != high and digits < 8:
        return interval(low, high, unit, digits + 1)
    return f"{ends[0]} to {ends[1]}" + (f"{THIN}{unit}" if unit else "")


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:,.{decimals}f}"
    if float(text.replace(",", "")) == 0:
        text = text.lstrip("-")
    return text.replace("-", MINUS)


def decimals_that_count(step: float | None) -> int | None:
    """Decimals that a thousandth of what matters can be read at; None: unknown, or too many."""
    if step is None or not math.isfinite(step) or step <= 0:
        return None
    decimals = max(math.floor(-math.log10(step / 1000) + 1e-9), 0)
    return decimals if decimals < 10 else None


#: from here on all digits of a whole number mean nothing
HUGE = 1e6


def rounded(value: float | None, decimals: int | None, digits: int = 3) -> str:
    """Three significant digits, but no finer than ``decimals``; ``< 0.001`` below them."""
    if value is None or decimals is None or value == 0 or not abs(value) < HUGE:
        return significant(value, digits)
    least = 10.0**-decimals
    if abs(value) < least / 2:
        return f"{'' if value > 0 else MINUS}< {least:.{decimals}f}"
    return _fixed(value, min(_decimals(abs(value), digits), decimals))


def span(low: float | None, high: float | None, decimals: int | None, digits: int = 3) -> str:
    """Write both ends with the same decimals: as few as tell them apart, at most ``decimals``."""
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    largest = max(abs(low), abs(high))
    if decimals is None or largest >= HUGE:
        return interval(low, high, "", digits)
    places = min(_decimals(largest, digits), decimals) if largest else 0
    while places < decimals and round(low, places) == round(high, places):
        places += 1
    return f"{_fixed(low, places)} to {_fixed(high, places)}"


def inside(
    value: float | None, low: float | None, high: float | None, shown: str, ends: str
) -> str:
    """Write an estimate as finely as its interval where it would else stand outside of it."""
    places = [len(text.partition(".")[2]) for text in (shown, ends.partition(" to ")[0])]
    if value is None or low is None or high is None or places[1] <= places[0] or "e" in shown:
        return shown
    if round(low, places[1]) <= round(value, places[0]) <= round(high, places[1]):
        return shown
    return _fixed(value, places[1])


def _decimals(value: float, digits: int) -> int:
    # log10 of the value as it will be printed: 9.999 is 10.0
    exponent = math.floor(math.log10(float(f"{value:.{digits - 1}e}")))
    return max(digits - 1 - exponent, 0)


def f_value(value: float | None, most: float = 1e4) -> str:
    """F of a table; beyond ``most`` only said to be so, for its digits mean nothing."""
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


def duration(seconds: float | None) -> str:
    """Seconds in the unit a person would use."""
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    for limit, size, unit in ((1, 1e-3, "ms"), (60, 1, "s"), (3600, 60, "min")):
        if seconds < limit:
            return f"{float(f'{seconds / size:.2g}'):g}{THIN}{unit}"
    return f"{seconds / 3600:.3g}{THIN}h"


def case_counts(cases: Mapping[str, int]) -> str:
    """Cases in one line."""
    return (
        f"{cases['total']} cases: {cases['done']} done, {cases['failed']} failed, "
        f"{cases['missing']} missing"
    )


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


#: letters of a name of a file
LONGEST_NAME = 80


def slug(text: str, *, is_marked: bool = False) -> str:
    """File and id name made of letters, digits and hyphens alone.

    Where letters are lost, as those of Greek are, a mark tells the name from that of another text.
    """
    name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
    is_lossy = any(c.isalnum() and not c.isascii() for c in text) or len(name) > LONGEST_NAME
    if not (is_marked or is_lossy):
        return name or "response"
    mark = hashlib.sha256(text.encode()).hexdigest()[:6]
    return f"{name[:LONGEST_NAME].strip('-') or 'response'}-{mark}"


def slugs(texts: Iterable[str]) -> dict[str, str]:
    """File and id names of several texts, no two alike: ``F`` and ``f`` get a mark each."""
    names = {text: slug(text) for text in texts}
    shared = Counter(names.values())
    return {text: slug(text, is_marked=shared[name] > 1) for text, name in names.items()}


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
    return capital(closed)


def capital(text: str) -> str:
    """Text with a capital first letter; a symbol, such as ``y`` or ``mu0``, stays as it is."""
    first = re.split(r"\W", text, maxsplit=1)[0]
    is_symbol = (len(first) == 1 and first not in "aiAI") or bool(re.search(r"[\d_]", first))
    return text if is_symbol else text[:1].upper() + text[1:]
