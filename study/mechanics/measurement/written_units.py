"""Units as instruments write them: in names of columns, rows of units and lines above the names."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import lru_cache

from study.ground.errors import UnitError
from study.ground.units import RECORDED, unit_factor
from study.mechanics.measurement.measurement_section import KINEMATIC, KINETIC

#: dimension of every quantity that a column may hold
DIMENSIONS: Mapping[str, str] = {
    **KINEMATIC, **KINETIC, "stretch_2": "ratio", "stress_2": "pressure", "time": "time"
}  # fmt: skip
#: words of column names (English, German, French) by quantity, the surest first
WORDS: Mapping[str, tuple[str, ...]] = {
    "true_strain": ("true strain", "log strain", "hencky"),
    "true_stress": ("true stress", "cauchy stress", "cauchy"),
    "time": ("time", "zeit", "temps", "elapsed"),
    "strain": ("strain", "dehnung", "stauchung", "déformation", "deformation"),
    "stretch": ("stretch", "lambda", "streckung"),
    "volume_ratio": ("volume ratio",),
    "stress": ("stress", "spannung", "contrainte"),
    "pressure": ("pressure", "druck"),
    "force": ("force", "load", "kraft", "last"),
    "displacement": (
        "indentation", "extension", "displacement", "standardweg", "weg", "elongation",
        "déplacement", "crosshead", "position", "stroke", "distance", "travel", "deflection",
        "disp", "gap",
    ),
}  # fmt: skip
#: how files write units that the program knows by another name, or in other capitals
_ALIASES = {
    "g": "gf", "sec": "s", "S": "s", "-": "1", "µm": "um",
    "μm": "um", "µN": "uN", "μN": "uN", "percent": "%", "pct": "%", "prozent": "%",
    "N/mm²": "N/mm^2", "N/mm2": "N/mm^2", "newton": "N", "millimeter": "mm", "inch": "in",
    "gram": "gf", "gram-force": "gf", "g-force": "gf", "kg": "kgf",
    "kilogram-force": "kgf", "kp": "kgf", "lb": "lbf", "inches": "in",
    "millimetre": "mm", "micron": "um", "mil": "thou", "in.": "in", "micrometer": "um",
    "centimeter": "cm", "millinewton": "mN", "kilonewton": "kN", "kilopascal": "kPa",
    "megapascal": "MPa", "pound": "lbf", "sek": "s", "second": "s", "minute": "min",
    "kilogram": "kgf", "gmf": "gf", "grf": "gf", "g-f": "gf", "gr": "gf", "oz": "ozf",
    "ounce": "ozf", "gf": "gf", "kgf": "kgf", "lbf": "lbf", "psi": "psi",
    "ksi": "ksi", "kpa": "kPa", "mpa": "MPa", "torr": "torr", "zoll": "in", "mm.": "mm",
    '"': "in", "mm": "mm", "in": "in", "psf": "lbf/ft^2",
}  # fmt: skip
#: letters from which a word in capitals is a unit where no brackets mark it: not "Load IN"
_LETTERS = 3
#: what a unit has
_LETTER = re.compile(r"[^\W\d_]|%")
#: a force over an area
_STRESS = re.compile(r"(?P<force>.+?)/\s*(sq\.?\s*)?(?P<length>[a-z]{1,2})(\^|\*\*)?[2²]?")
_IN_BRACKETS = re.compile(r"(?P<name>.*?)[\s_]*[\[(]\s*(?P<word>[^\[\]()]{1,14}?)\s*[\])]\s*")
_APART = re.compile(r"(?P<name>.*?)(?:[\s_]+in)?[\s_]+(?P<word>[^\s_\d][^\s_]{0,13})")
_BEHIND_BAR = re.compile(r"(?P<name>.*?)\s*/\s*(?P<word>[^\s/]{1,12})")
#: a line above the names that says the unit of a quantity, or the units of all
_PREAMBLE = re.compile(
    r"[\W_]*(?:units?\s+of\s+)?(?P<what>[^\W\d_][^\W\d_ ]*(?: [^\W\d_]+){0,2}?)"
    r"\s*(?:units?|einheit(?:en)?|unité)?[\s\"]*(?:[:=,;\t\[(]|\bin\s)[\s\"\[(]*"
    r"(?P<unit>[^\s\"\[\](),;:=]{1,12})[\s\"\])]*[,;\s]*",
    re.IGNORECASE,
)
_ALL_UNITS = re.compile(r"[\W_]*(?:units?|einheit(?:en)?)\s*[:=,;\t](?P<units>.+)", re.IGNORECASE)
#: sizes of a specimen in lines above the names (English, German, French)
_SIZES: Mapping[str, str] = {
    "diameter": "diameter|durchmesser|diamètre", "radius": "radius|rayon",
    "height": "height|höhe|hoehe|hauteur", "width": "width|breite|largeur",
    "thickness": "thickness|dicke|épaisseur", "length": "(?:gauge |grip )?length|(?:mess)?länge",
    "area": r"(?:cross[- ]section(?:al)?\s*)?area|querschnitt(?:sfläche)?|fläche|section",
}  # fmt: skip
_SIZE = re.compile(
    r"[\W_]*(?:(?:specimen|sample|initial|original|dimensions?|proben|probekörper)[\W_]*)*(?:"
    + "|".join(f"(?P<{size}>{words})" for size, words in _SIZES.items())
    + r")[\s\"]*(?:[\[(](?P<first>[^\[\]()]+)[\])])?[\s\"]*[:=,;\t][\s\":=,;]*"
    r"(?P<number>\d+(?:[.,]\d+)?)[\s\",;]*(?P<unit>[^\s\",;\d]\S*?)?[\s\",;]*",
    re.IGNORECASE,
)


@lru_cache(maxsize=256)
def written_unit(word: str, *, is_marked: bool = True) -> tuple[str, str] | None:
    """Give the unit as the program writes it, and its dimension; None where it is none.

    Examples
    --------
    >>> written_unit("g"), written_unit("LBF"), written_unit("kp/cm2"), written_unit("IN")
    (('gf', 'force'), ('lbf', 'force'), ('kgf/cm^2', 'pressure'), ('in', 'length'))
    >>> written_unit("IN", is_marked=False) is written_unit("tip") is None
    True
    """
    plain = word.strip()
    length, _, over = plain.partition("/")
    if over and length == over and written_unit(length):  # mm/mm, in./in.: a strain
        return "1", "ratio"
    forms = [plain, plain.lower(), plain.lower().removesuffix("s")]
    if not is_marked and len(plain) < _LETTERS and plain != plain.lower():
        del forms[1:]
    others = [_ALIASES.get(form, "") for form in forms]
    # mPa is no other way to write MPa
    others.insert(len(others) if plain.islower() else 1, plain)
    for unit in others:
        for dimension in RECORDED if unit else ():
            with suppress(UnitError):
                unit_factor(unit, dimension)
                return unit, dimension
    stress = _STRESS.fullmatch(plain)
    force = written_unit(stress["force"]) if stress else None
    if stress is None or force is None or force[1] != "force":
        return None
    unit = f"{force[0]}/{stress['length']}^2"
    with suppress(UnitError):
        unit_factor(unit, "pressure")
        return unit, "pressure"
    return None


def shows_unit(word: str) -> bool:
    """Whether a word is a unit of more than a digit or a dash, which may be anything."""
    return _LETTER.search(word) is not None and written_unit(word) is not None


def contradicts(word: str, declared: str, dimension: str, *, is_sure: bool) -> bool:
    """Whether a file shows another unit than is declared; if it ``is_sure``, of any dimension."""
    unit = written_unit(word) if shows_unit(word) else None
    if unit is None or unit[1] != dimension:
        return unit is not None and is_sure and len(unit[0]) > 1
    return not math.isclose(unit_factor(unit[0], dimension), unit_factor(declared, dimension))


def word_of_unit(name: str) -> tuple[str, str, bool]:
    """Split the name of a column into what it says and its unit; whether brackets mark the unit.

    Examples
    --------
    >>> word_of_unit("Force [kgf]"), word_of_unit("stress_N/mm2"), word_of_unit("force_tip")
    (('Force', 'kgf', True), ('stress', 'N/mm2', False), ('force_tip', '', False))
    """
    if marked := _IN_BRACKETS.fullmatch(name):
        return marked["name"], marked["word"], True
    for pattern in (_APART, _BEHIND_BAR):
        match = pattern.fullmatch(name)
        if match is None:
            continue
        plain = match["name"].lower().replace("_", " ")
        named = {DIMENSIONS[key] for key, words in WORDS.items() if any(w in plain for w in words)}
        unit = written_unit(match["word"], is_marked=bool(named) or pattern is _BEHIND_BAR)
        # Force_Min is the least force, and no length in mega-inches
        if unit and (not named or unit[1] in {*named, "ratio"}):
            return match["name"], match["word"], False
    return name, "", False


def units_above(lines: Iterable[str]) -> dict[str, str]:
    """Units by dimension that lines above the names say, such as ``Force unit: gf``."""
    shown: dict[str, set[str]] = {}
    for line in lines:
        words: list[tuple[str, str]] = []
        if match := _ALL_UNITS.fullmatch(line):
            words = [("", word) for word in re.split(r"[\s,;\t\"]+", match["units"]) if word]
        elif match := _PREAMBLE.fullmatch(line):
            words = [(match["what"].lower(), match["unit"])]
        for what, word in words:
            unit = written_unit(word)
            quantities = [quantity for quantity, names in WORDS.items() if what in names]
            if unit and (not what or unit[1] in {DIMENSIONS[quantity] for quantity in quantities}):
                shown.setdefault(unit[1], set()).add(unit[0])
    return {dimension: units.pop() for dimension, units in shown.items() if len(units) == 1}


def sizes_above(lines: Iterable[str]) -> dict[str, float]:
    """Sizes of the specimen that lines above the names say, mm and mm^2; of two values neither.

    Examples
    --------
    >>> sizes_above(["Specimen diameter: 2.5 cm", '"Height [mm]","10,00"', "Probe diameter: 5 mm"])
    {'diameter': 25.0, 'height': 10.0}
    """
    shown: dict[str, set[float]] = {}
    for line in lines:
        match = _SIZE.fullmatch(line)
        if match is None:
            continue
        size = next(name for name in _SIZES if match[name])
        power = 2 if size == "area" else 1
        word = (match["unit"] or match["first"] or "").strip()
        unit = written_unit(re.sub(r"\s*(\^|\*\*)?[2²]$", "", word) if power == 2 else word)
        if unit and unit[1] == "length":
            factor = unit_factor(*unit) ** power
            shown.setdefault(size, set()).add(float(match["number"].replace(",", ".")) * factor)
    return {size: values.pop() for size, values in shown.items() if len(values) == 1}
