"""Factors, preset sets and exclusions of a design."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import cast

from study.external.parameters import number_and_unit, parameter_name
from study.ground.declaration import (
    MAX_NAME,
    Bad,
    choice,
    name,
    number,
    quoted,
    shown,
    written_keys,
)
from study.ground.diagnostics import (
    Faults,
    Table,
    entries,
    flatten,
    is_known,
    noted,
    quoted_path,
    with_values,
)
from study.ground.errors import nearest
from study.ground.units import parse
from study.harness.design.spec import DesignFile, Exclusion, Factor, Level
from study.simulation import overlay
from study.statistics.surfaces.surface_factors import DISTRIBUTION_KEYS, NumericFactor

MAX_FACTORS = 20
MAX_LEVELS = 100
#: set -> label -> dotted keys laid over the file
Presets = Mapping[str, Mapping[str, Table]]


def presets_from(table: object, faults: Faults) -> Presets:
    """Read ``[presets.SET.LEVEL]``: dotted keys of the whole file for every level."""
    # A set named like a table of the file is laid over that table.
    presets: dict[str, dict[str, Table]] = {}
    for set_name, levels in entries(table, "presets", faults).items():
        where = f"presets.{quoted(set_name)}"
        if not _readable(set_name, where, faults):
            continue
        prefix = f"{set_name}." if set_name in overlay.TABLES else ""
        presets[set_name] = {
            label.strip(): _settings(level, prefix, f"{where}.{quoted(label)}", faults)
            for label, level in entries(levels, where, faults).items()
            if _readable(label, f"{where}.{quoted(label)}", faults)
        }
    return presets


def _settings(level: object, prefix: str, where: str, faults: Faults) -> Table:
    settings = flatten(entries(level, where, faults), prefix, overlay.WHOLE)
    for key in [key for key in settings if not overlay.may_vary(key)]:
        inner = quoted_path(key.removeprefix(prefix))
        faults.add(f"{where}.{inner}", "unknown key", overlay.suggestion(key))
        del settings[key]
    return settings


def _readable(value: str, where: str, faults: Faults) -> bool:
    try:
        return bool(name(value))
    except Bad as bad:
        faults.add(where, f"this name {bad.rule}", bad.mend)
        return False


def factors_from(table: object, presets: Presets, faults: Faults) -> tuple[Factor, ...]:
    """Read ``[factors]`` with the levels of every factor; a faulty factor is left out."""
    written = entries(table, "factors", faults)
    if not written:
        faults.add("factors", "is missing", 'for example model.space = ["axisymmetric", "3d"]')
    if len(written) > MAX_FACTORS:
        faults.add("factors", f"has {len(written)} factors, the limit is {MAX_FACTORS}")
        return ()
    parted = [key.rpartition(".") for key in written]
    for key in sorted(set(written) & {start for start, _, end in parted if end in RANGE_KEYS}):
        rule = "stands twice, with levels and with an end of a range"
        faults.add(f"factors.{quoted_path(key)}", rule, "keep one of the two")
    factors: list[Factor] = []
    for key, value in grouped(written).items():
        if isinstance(value, Mapping) and key not in presets and overlay.may_vary(key):
            factors += _range(key, value, f"factors.{quoted_path(key)}", faults)
        elif levels := _levels(key, value, presets, faults):
            factors.append(Factor(key, levels))
    _check_overlap(factors, faults)
    return tuple(factors)


def _levels(key: str, value: object, presets: Presets, faults: Faults) -> tuple[Level, ...]:
    where = f"factors.{quoted_path(key)}"
    if key not in presets and not overlay.may_vary(key):
        table, _, rest = key.partition(".")
        if table == "parameters":  # whose names are the user's own
            noted(parameter_name, rest, where, faults)
            return ()
        valid = [*presets, *(k for k in overlay.VARYING if k.partition(".")[0] == table)]
        mend = nearest(key[:MAX_NAME], valid) if valid else overlay.suggestion(key)
        if table in written_keys(DesignFile) and table not in overlay.TABLES:
            mend = f"[{table}] is the same in every cell; keys of these may vary: "
            mend += ", ".join(overlay.TABLES)
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
        at, label = f"{where}[{i}]", noted(level_label, raw, f"{where}[{i}]", faults)
        if label in levels:
            rule = f"levels must be distinct, got {label!r} again ({shown(raw)})"
            faults.add(at, rule, "leave one out")
        elif label is not None and label not in presets.get(key, {label}):
            mend = nearest(label, presets[key])
            faults.add(at, f"no preset {label!r} in presets.{key}", mend)
        elif label is not None:
            levels[label] = Level(label, presets[key][label] if key in presets else {key: raw})
    return tuple(levels.values())


def level_label(raw: object) -> str:
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
        slots = set()
        for key in factor.keys:  # or the first of the keys that cannot stand beside it
            table, _, last = key.rpartition(".")
            alternatives = overlay.PLACES[table].alternatives if table in overlay.PLACES else ()
            slots.add(f"{table}.{alternatives[0]}" if last in alternatives else key)
        for slot in slots:
            if owner.setdefault(slot, factor.name) != factor.name:
                rule = f"sets {slot}, which the factor {owner[slot]!r} sets too"
                faults.add(f"factors.{factor.name}", rule, "let one of the two set it")


def exclusions_from(
    tables: Sequence[Exclusion],
    factors: Sequence[Factor],
    declared: Collection[str],
    faults: Faults,
) -> tuple[Exclusion, ...]:
    """Say of every ``[[exclude]]`` which cells it leaves out."""
    by_name = {factor.name: factor for factor in factors}
    exclusions = []
    for i, table in enumerate(tables):
        before, where = len(faults), f"exclude[{i}].when"
        if not is_known(table.why, table.when):
            continue
        written, labels = entries(table.when, where, faults), {}
        if isinstance(table.when, Mapping) and not written:
            faults.add(where, "is empty: it would leave out every cell")
        for key, raw in written.items():
            if key in by_name:
                labels[key] = noted(partial(_chosen, by_name[key]), raw, f"{where}.{key}", faults)
            elif key not in declared:
                faults.add(f"{where}.{quoted(key)}", "unknown key", nearest(key, declared))
        if faults.mentions == before:
            exclusions.append(with_values(table, when=labels))
    return tuple(exclusions)


def _chosen(factor: Factor, raw: object) -> tuple[str, ...]:
    """Labels of the levels of a factor that one label, or a list of labels, names."""
    items = raw if isinstance(raw, list) and raw else [raw]
    return tuple(dict.fromkeys(known_level(item, factor) for item in items))


def known_level(raw: object, factor: Factor) -> str:
    """Label of a level, which the factor must have."""
    label = level_label(raw)
    if label not in factor.labels:
        raise Bad(f"no level {label!r} of {factor.name!r}", nearest(label, factor.labels))
    return label


ENDS = ("low", "high")
RANGE_KEYS = (*ENDS, "scale")
SCALES = ("linear", "log")
_QUANTITY = re.compile(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(\S.*?)\s*")


def grouped(table: Table, parts: Collection[str] = RANGE_KEYS) -> dict[str, object]:
    """Join the keys of a range or a distribution, which joining dotted keys took apart, to ``KEY``.

    Examples
    --------
    >>> grouped({"a.low": 1, "a.high": 2, "b": [3, 4]})
    {'a': {'low': 1, 'high': 2}, 'b': [3, 4]}
    """
    joined: dict[str, object] = {}
    ends: dict[str, dict[str, object]] = {}
    for key, value in table.items():
        name, _, end = key.rpartition(".")
        if name and end in parts and not overlay.may_vary(key):
            joined[name] = ends.setdefault(name, {})
            ends[name][end] = value
        else:
            joined[key] = value
    return joined


def set_whole(table: Table, key: str, value: object) -> dict[str, object]:
    """Copy of a table with a key set, in the place of its old value or of the parts of a range."""
    old = {key, *(f"{key}.{part}" for part in (*RANGE_KEYS, *DISTRIBUTION_KEYS))}
    copied: dict[str, object] = {}
    for old_key, old_value in table.items():
        copied |= {key: value} if old_key in old else {old_key: old_value}
    return {**copied, key: value}


def _range(key: str, value: Table, where: str, faults: Faults) -> list[Factor]:
    """Factor of a range, with its two ends as levels; none where it is faulty."""
    dimension = overlay.dimension(key)
    if dimension is None:
        faults.add(where, "is no number, so it has no range", "list its levels: [.., ..]")
        return []
    missing = [end for end in ENDS if end not in value]
    if missing:
        faults.add(where, f"has no {missing[0]}", "write { low = .., high = .. }")
        return []
    scale = noted(choice(*SCALES), value.get("scale", "linear"), f"{where}.scale", faults)
    log = scale == "log"
    span = noted(
        lambda _: _span(key, value["low"], value["high"], dimension, log), value, where, faults
    )
    return [] if span is None else [Factor(key, levels_at(span, (0.0, 1.0)), span)]


def _span(name: str, low: object, high: object, dimension: str, log: bool) -> NumericFactor:
    (first, unit), (last, other) = _end(low, dimension), _end(high, dimension)
    if unit != other:
        raise Bad(f"mixes {unit!r} and {other!r}", "write both ends in one unit")
    if not first < last:
        mend = "exchange low and high" if last < first else "give two ends that differ"
        raise Bad(f"must rise, got {shown(low)} to {shown(high)}", mend)
    if log and first <= 0:
        rule = f"has a logarithm of positive numbers alone, got {shown(low)}"
        raise Bad(rule, 'begin above 0, or leave scale = "log" out')
    return NumericFactor(name, first, last, log, unit)


def _end(raw: object, dimension: str) -> tuple[float, str]:
    """Value and unit of one end, the unit as written."""
    if dimension == "number":
        return number()(raw), ""
    if dimension == overlay.ANY:
        return number_and_unit(raw)
    parse(raw, dimension)
    match = _QUANTITY.fullmatch(str(raw))
    if match is None:
        raise Bad(f"must be a number and its unit, got {shown(raw)}", 'for example "28 mm"')
    return float(match[1]), match[2]


def levels_at(span: NumericFactor, shares: Sequence[float]) -> tuple[Level, ...]:
    """Levels at shares of a range, 0 its low and 1 its high end, in as few digits as tell them.

    Examples
    --------
    >>> [level.label for level in levels_at(NumericFactor("a", 1.0, 2.0, unit="mm"), [0, 1 / 3, 1])]
    ['1 mm', '1.3333 mm', '2 mm']
    >>> [level.label for level in levels_at(NumericFactor("a", 1.0, 100.0, log=True), [0, 0.5, 1])]
    ['1', '10', '100']
    """
    values = [span.at(share) for share in shares]
    for digits in range(1, 17):
        texts = [f"{value:.{digits}g}" for value in values]
        near = all(math.isclose(float(t), v, rel_tol=0, abs_tol=span.step(v))
                   for t, v in zip(texts, values, strict=True))  # fmt: skip
        if near and len(set(texts)) == len(set(values)):
            break
    return tuple(_range_level(span.name, _plain(text), span.unit) for text in texts)


def _plain(text: str) -> str:
    """Write a number of few digits without a power of ten, unless it is long: 1e+02 is 100."""
    return f"{float(text):g}" if "e" in text and float(f"{float(text):g}") == float(text) else text


def _range_level(key: str, text: str, unit: str) -> Level:
    written = f"{text} {unit}" if unit else float(text)
    return Level(f"{text} {unit}".strip(), {key: written})


def setting_in(factor: Factor, raw: object) -> Level:
    """Level of a factor with a range at one setting, as it is written: a number with its unit."""
    span = cast("NumericFactor", factor.span)
    value, unit = _end(raw, overlay.dimension(factor.name) or "number")
    if unit != span.unit:
        raise Bad(f"{shown(raw)} is not in {span.unit!r}, the unit of its range")
    if not span.low <= value <= span.high:
        raise Bad(f"{shown(raw)} lies outside {span.low:g} to {span.high:g}, its range")
    return _range_level(factor.name, level_label(value), unit)
