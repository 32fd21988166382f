"""Factors, preset sets and exclusions of a design."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from study.design import overlay, study_file
from study.design.diagnostics import Faults
from study.design.reader import Section
from study.design.spec import Exclusion, Factor, Level, Span
from study.design.toml_document import flatten
from study.errors import UnitError, nearest
from study.setup.quantity import number, shown
from study.setup.section import Bad, Read
from study.setup.text import MAX_NAME, name, quoted, text
from study.units import parse

MAX_FACTORS = 20
MAX_LEVELS = 100
MAX_EXCLUSIONS = 4096

#: set -> label -> dotted keys laid over the file
Presets = dict[str, dict[str, dict[str, Any]]]


def read_presets(table: Any, faults: Faults) -> Presets:
    """Read ``[presets.SET.LEVEL]``: dotted keys of the whole file for every level.

    A set named like a table of the file is laid over that table.
    """
    section = Section({} if table is None else table, "presets", faults)
    presets: Presets = {}
    for set_name, levels in section.table.items():
        where = f"presets.{quoted(set_name)}"
        if not _readable(set_name, where, faults):
            continue
        prefix = f"{set_name}." if set_name in overlay.TABLES else ""
        inner = Section(levels, where, faults)
        presets[set_name] = {
            label.strip(): _settings(level, prefix, f"{where}.{quoted(label)}", faults)
            for label, level in inner.table.items()
            if _readable(label, f"{where}.{quoted(label)}", faults)
        }
    return presets


def _settings(level: Any, prefix: str, where: str, faults: Faults) -> dict[str, Any]:
    if not isinstance(level, Mapping):
        faults.add(where, f"must be a table, got {shown(level)}", f"write [{where}]")
        return {}
    settings = flatten(level, prefix)
    for key in settings:
        if not overlay.may_vary(key):
            inner = quoted_path(key.removeprefix(prefix))
            faults.add(f"{where}.{inner}", "unknown key", overlay.suggestion(key))
    return {key: value for key, value in settings.items() if overlay.may_vary(key)}


def quoted_path(key: str) -> str:
    """Dotted key whose odd parts are quoted."""
    return ".".join(quoted(part) for part in key[:500].split("."))


def _readable(value: Any, where: str, faults: Faults) -> bool:
    try:
        name(value)
    except Bad as bad:
        faults.add(where, f"this name {bad.rule}", bad.mend)
        return False
    return True


def read_factors(table: Any, presets: Presets, faults: Faults) -> tuple[Factor, ...]:
    """Read ``[factors]`` (dotted keys already joined) with the levels of every factor."""
    section = Section({} if table is None else table, "factors", faults)
    if not section.table:
        faults.add("factors", "is missing", 'for example model.space = ["axisymmetric", "3d"]')
    if len(section.table) > MAX_FACTORS:
        faults.add("factors", f"has {len(section.table)} factors, the limit is {MAX_FACTORS}")
        return ()
    read = [_factor(key, value, presets, faults) for key, value in grouped(section.table).items()]
    found = [factor for factor in read if factor is not None]
    _check_overlap(found, faults)
    return tuple(found)


def _factor(key: str, value: Any, presets: Presets, faults: Faults) -> Factor | None:
    if isinstance(value, Mapping) and key not in presets and overlay.may_vary(key):
        return read_range(key, value, f"factors.{quoted_path(key)}", faults)
    levels = _levels(key, value, presets, faults)
    return Factor(key, levels) if levels else None


def _levels(key: str, value: Any, presets: Presets, faults: Faults) -> tuple[Level, ...]:
    where = f"factors.{quoted_path(key)}"
    if key not in presets and not overlay.may_vary(key):
        valid = [
            *presets,
            *(k for k in overlay.VARYING if k.partition(".")[0] == key.split(".")[0]),
        ]
        mend = nearest(key[:MAX_NAME], valid) if valid else overlay.suggestion(key)
        faults.add(where, "is neither a key that may vary nor a preset set", mend)
        return ()
    if not isinstance(value, list):
        faults.add(where, f"must be a list of levels, got {shown(value)}", "write [.., ..]")
        return ()
    if not 2 <= len(value) <= MAX_LEVELS:
        rule = f"needs 2 to {MAX_LEVELS} levels, got {len(value)}"
        faults.add(where, rule, "a factor with one level is no factor: set the key itself")
        return ()
    levels: dict[str, Level] = {}
    for i, raw in enumerate(value):
        level = _level(key, raw, presets, f"{where}[{i}]", faults)
        if level is not None and level.label in levels:
            rule = f"levels must be distinct, got {level.label!r} again ({shown(raw)})"
            faults.add(f"{where}[{i}]", rule, "leave one out")
        elif level is not None:
            levels[level.label] = level
    return tuple(levels.values())


def _level(key: str, raw: Any, presets: Presets, where: str, faults: Faults) -> Level | None:
    try:
        label = level_label(raw)
    except Bad as bad:
        faults.add(where, bad.rule, bad.mend)
        return None
    if key not in presets:
        return Level(label, {key: raw})
    if label not in presets[key]:
        faults.add(where, f"no preset {label!r} in presets.{key}", nearest(label, presets[key]))
        return None
    return Level(label, presets[key][label])


def level_label(raw: Any) -> str:
    """Label of a level's value: ``"1"``, ``1`` and ``1.0`` have the same.

    Examples
    --------
    >>> level_label(1.0), level_label(" 1"), level_label(["1 %", "20 %"])
    ('1', '1', '1 %, 20 %')
    """
    if isinstance(raw, bool):
        return "true" if raw else "false"
    if isinstance(raw, str):
        return name(raw)
    if isinstance(raw, (int, float)) and math.isfinite(raw):
        return repr(raw).removesuffix(".0")
    if isinstance(raw, list) and raw and len(raw) <= 9:
        return name(", ".join(level_label(item) for item in raw))
    mend = "give it a name: [presets.SET.LEVEL]" if isinstance(raw, Mapping) else ""
    raise Bad(f"is no level, got {shown(raw)}", mend)


def _check_overlap(factors: Sequence[Factor], faults: Faults) -> None:
    """Two factors that set one key would hide one another."""
    owner: dict[str, str] = {}
    for factor in factors:
        for slot in {_slot(key) for level in factor.levels for key in level.settings}:
            if owner.setdefault(slot, factor.name) != factor.name:
                rule = f"sets {slot}, which the factor {owner[slot]!r} sets too"
                faults.add(f"factors.{factor.name}", rule, "let one of the two set it")


def _slot(key: str) -> str:
    """Key, or the first of the keys that cannot stand beside it."""
    table, _, last = key.rpartition(".")
    alternatives = study_file.ALTERNATIVES.get(table, ())
    return f"{table}.{alternatives[0]}" if last in alternatives else key


def read_exclusions(
    value: Any, factors: Sequence[Factor], declared: Sequence[str], faults: Faults
) -> tuple[Exclusion, ...]:
    """Read every ``[[exclude]]``; ``declared`` has the factors that are faulty, too."""
    if value is None:
        return ()
    if not isinstance(value, list) or len(value) > MAX_EXCLUSIONS:
        faults.add("exclude", f"must be tables, got {shown(value)}", "write [[exclude]]")
        return ()
    return tuple(
        exclusion
        for i, table in enumerate(value)
        if (exclusion := _exclusion(table, f"exclude[{i}]", factors, declared, faults))
    )


def _exclusion(
    table: Any,
    where: str,
    factors: Sequence[Factor],
    declared: Sequence[str],
    faults: Faults,
) -> Exclusion | None:
    before = len(faults)
    section = Section(table, where, faults)
    why = section.take("why", text, mend='say why: why = "..."')
    when = section.take("when", lambda raw: raw, mend='when = { material = "ogden-1" }')
    section.finish()
    if why == "":
        section.fault("why", "is empty", "say why these cells are left out")
    if len(faults) > before:
        return None
    inner = Section(when, f"{where}.when", faults)
    if not inner.broken and not inner.table:
        section.fault("when", "is empty: it would leave out every cell")
    by_name = {factor.name: factor for factor in factors}
    labels = {
        key: inner.take(key, _choosing(by_name[key])) for key in inner.table if key in by_name
    }
    inner.finish(declared)
    return Exclusion(labels, why) if len(faults) == before else None


def _choosing(factor: Factor) -> Read:
    return lambda raw: _chosen(raw, factor)


def _chosen(raw: Any, factor: Factor) -> tuple[str, ...]:
    items = raw if isinstance(raw, list) and raw else [raw]
    labels = tuple(_known(level_label(item), factor) for item in items)
    return tuple(dict.fromkeys(labels))


def _known(label: str, factor: Factor) -> str:
    if label not in factor.labels:
        raise Bad(f"no level {label!r} of {factor.name!r}", nearest(label, factor.labels))
    return label


ENDS = ("low", "high")
_QUANTITY = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(\S.*?)\s*")


def grouped(table: Mapping[str, Any]) -> dict[str, Any]:
    """Join ``KEY.low`` and ``KEY.high``, which joining dotted keys took apart, to ``KEY``.

    Examples
    --------
    >>> grouped({"a.low": 1, "a.high": 2, "b": [3, 4]})
    {'a': {'low': 1, 'high': 2}, 'b': [3, 4]}
    """
    found: dict[str, Any] = {}
    for key, value in table.items():
        name, _, end = key.rpartition(".")
        if name and end in ENDS:
            found.setdefault(name, {})[end] = value
        else:
            found[key] = value
    return found


def read_range(key: str, value: Mapping[str, Any], where: str, faults: Faults) -> Factor | None:
    """Factor of a range, with its two ends as levels."""
    dimension = overlay.dimension(key)
    if dimension is None:
        faults.add(where, "is no number, so it has no range", "list its levels: [.., ..]")
        return None
    missing = [end for end in ENDS if end not in value]
    if missing:
        faults.add(where, f"has no {missing[0]}", "write { low = .., high = .. }")
        return None
    try:
        low, high = (_end(value[end], dimension) for end in ENDS)
    except (Bad, UnitError) as error:
        fault = error if isinstance(error, Bad) else error.faults[0]
        faults.add(where, fault.rule, fault.mend)
        return None
    if low[1] != high[1]:
        faults.add(where, f"mixes {low[1]!r} and {high[1]!r}", "write both ends in one unit")
        return None
    if not low[0] < high[0]:
        rule = f"must rise, got {shown(value['low'])} to {shown(value['high'])}"
        faults.add(where, rule, "exchange low and high")
        return None
    span = Span(low[0], high[0], low[1])
    return Factor(key, levels_at(key, span, (0.0, 1.0)), span)


def _end(raw: Any, dimension: str) -> tuple[float, str]:
    """Value and unit of one end, the unit as written."""
    if dimension == "number":
        return number()(raw), ""
    parse(raw, dimension)
    match = _QUANTITY.fullmatch(str(raw))
    if match is None:
        raise Bad(f"must be a number and its unit, got {shown(raw)}", 'for example "28 mm"')
    return float(match[1]), match[2]


def levels_at(key: str, span: Span, shares: Sequence[float]) -> tuple[Level, ...]:
    """Levels at shares of a range, 0 its low and 1 its high end, in as few digits as tell them.

    Examples
    --------
    >>> [level.label for level in levels_at("a", Span(1.0, 2.0, "mm"), [0, 1 / 3, 1])]
    ['1 mm', '1.3333 mm', '2 mm']
    """
    values = [span.low + share * (span.high - span.low) for share in shares]
    fine = 1e-4 * (span.high - span.low)
    for digits in range(1, 17):
        texts = [f"{value:.{digits}g}" for value in values]
        near = all(math.isclose(float(t), v, rel_tol=0, abs_tol=fine)
                   for t, v in zip(texts, values, strict=True))  # fmt: skip
        if near and len(set(texts)) == len(set(values)):
            break
    return tuple(_range_level(key, text, span.unit) for text in texts)


def _range_level(key: str, text: str, unit: str) -> Level:
    written = f"{text} {unit}" if unit else float(text)
    return Level(f"{text} {unit}".strip(), {key: written})
