"""The table ``[parameters]``: names of the user's own, and what a program or function needs.

A value is a number with or without a unit, a text or a flag. A number is kept in the unit of its
first mention, and every level of a factor is converted to that.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated

from study.external.forward_model import ForwardCell, ForwardModel, Value
from study.ground import units
from study.ground.declaration import (
    MAX_NAME,
    Bad,
    Reads,
    quoted,
    reason,
    section,
    shown,
    table_of,
    text,
)
from study.ground.diagnostics import Faults, Table, noted
from study.ground.errors import UnitError, nearest

MOST_PARAMETERS = 1000
#: words that a range or a distribution of a factor has for itself
RESERVED = (
    "low", "high", "scale", "levels", "distribution", "mean", "sd", "median", "factor", "mode",
)  # fmt: skip
#: tables of the built-in mechanics: where one of them is written, a cell is one of its problems
MECHANICAL = ("specimen", "test", "material", "model")


def stands_alone(tables: Table) -> bool:
    """Whether a file describes parameters alone, for a program or function of somebody else."""
    if any(name in tables for name in MECHANICAL):
        return False
    model = table_of(tables, "forward").get("model")
    return "parameters" in tables or model in ("command", "python")


def parameter_name(name: object) -> str:
    """Read the name of a parameter, which is also one in templates and constraints."""
    if not isinstance(name, str):
        raise Bad(f"must be a name, got {shown(name)}")
    if len(name) > MAX_NAME or not name.replace("-", "_").isidentifier():
        rule = f"has letters, digits, - and _ alone and begins with a letter, got {shown(name)}"
        raise Bad(f"a parameter's name {rule}", "for example viscosity or mesh_size")
    if name in RESERVED or name.startswith("_"):
        mend = f"call it, for example, {name.strip('_')}_value"
        raise Bad(f"{name!r} is a word of the study file and no name of a parameter", mend)
    return name


def parameter_key(example: str, value: object) -> str:
    """Read a dotted key of ``[parameters]``."""
    if not isinstance(value, str) or not is_parameter(value):
        raise Bad(f"must be a key of [parameters], got {shown(value)}", f"for example {example}")
    return value


def is_parameter(key: str) -> bool:
    """Whether a dotted key is one of ``[parameters]``."""
    table, _, name = key.partition(".")
    with suppress(Bad):
        return table == "parameters" and bool(parameter_name(name))
    return False


def number_and_unit(raw: object) -> tuple[float, str]:
    """Read a plain number, or a number with a unit, which stays as written."""
    if isinstance(raw, int | float) and not isinstance(raw, bool):
        if not math.isfinite(raw) or abs(raw) > 1e300:
            raise Bad(f"must be a finite number, got {shown(raw)}")
        return float(raw), ""
    try:
        number, unit = units.split(str(raw))
    except UnitError as error:
        raise Bad(error.faults[0].rule, 'write 12.5, or "3 Pa s"') from error
    if not units.is_known(unit) and unit not in ("1", "%"):
        mend = "write a unit such as kg, N/m or Pa s; a text must not begin with a number"
        raise Bad(f"has the unknown unit {unit!r}, got {shown(raw)}", mend)
    return number, "" if unit == "1" else unit


def number_in(raw: object, unit: str) -> float:
    """Read the number of a value in some unit; raises :class:`Bad` where the two do not fit."""
    number, written = number_and_unit(raw)
    try:
        return units.converted(number, written, unit)
    except UnitError as error:
        raise Bad(f"{shown(raw)} {error.faults[0].rule}", error.faults[0].mend) from error


def _read(raw: object) -> tuple[Value, str]:
    """Value of a key, and the unit of a number."""
    if isinstance(raw, bool):
        return raw, ""
    if isinstance(raw, int | float):
        return number_and_unit(raw)
    if not isinstance(raw, str):
        mend = 'write a number, "3 Pa s", a text, true or false'
        raise Bad(f"must be a number, a text or a flag, got {shown(raw)}", mend)
    return _text(raw)


@lru_cache(maxsize=4096)
def _text(raw: str) -> tuple[Value, str]:
    """Value of a text, and the unit of a number: levels come again in many cells."""
    plain = text(raw)
    if plain[:1].isdigit() or plain[:2].lstrip("+-.")[:1].isdigit():
        return number_and_unit(plain)
    return plain, ""


def parameters_from(
    table: object, first: object, faults: Faults
) -> tuple[dict[str, Value], dict[str, str]]:
    """Values of a cell and their units; ``first`` is the table of the file, whose units count."""
    if not isinstance(table, Mapping):
        faults.add("parameters", f"must be a table, got {shown(table)}", "write [parameters]")
        return {}, {}
    if len(table) > MOST_PARAMETERS:
        rule = f"has {len(table)} parameters, the limit is {MOST_PARAMETERS}"
        faults.add("parameters", rule)
        return {}, {}
    usual = first if isinstance(first, Mapping) else {}
    read_all: dict[str, tuple[Value, str]] = {}
    for name, raw in table.items():
        where = f"parameters.{quoted(name)}"
        if noted(parameter_name, name, where, faults) is None:
            continue
        read = noted(_read, raw, where, faults)
        if read is not None and name in usual and usual[name] is not raw:
            with suppress(Bad):  # of the file's own value it is told where that stands
                read = noted(partial(_like, read, _read(usual[name])), raw, where, faults)
        if read is not None:
            read_all[name] = read
    values = {name: value for name, (value, _) in read_all.items()}
    return values, {name: unit for name, (_, unit) in read_all.items() if unit}


def overridden(name: str, raw: object, table: Table) -> object:
    """Value of ``-s parameters.name=..`` as the file would write it: its kind, in its unit.

    Programs get numbers without their unit, so that ``"12 cm"`` over ``"100 mm"`` is 120.
    """
    if name not in table:
        raise Bad("is no parameter of the file", nearest(name, table))
    try:
        first = _read(table[name])
    except Bad:  # told where that stands
        return raw
    read = _read(raw)
    value, unit = _like(read, first, raw)
    return raw if read[1] == unit else f"{value!r} {unit}"


def _like(read: tuple[Value, str], usual: tuple[Value, str], raw: object) -> tuple[Value, str]:
    """Value in the unit of the file's own one, of whose kind it must be."""
    (value, unit), (first, into) = read, usual
    if type(value) is not type(first):
        kinds = {float: "a number", str: "a text", bool: "a flag"}
        rule = f"is {kinds[type(value)]} here and {kinds[type(first)]} in [parameters]"
        mend = "write true or false" if isinstance(first, bool) else "make all its levels one kind"
        raise Bad(f"{rule}, got {shown(raw)}", mend)
    if isinstance(value, float):
        try:
            return units.converted(value, unit, into), into
        except UnitError as error:
            raise Bad(error.faults[0].rule, error.faults[0].mend) from error
    return value, unit


@dataclass(frozen=True, kw_only=True)
class ParameterProblem(ForwardCell):
    """Parameters alone, for a program or a function: no specimen, test, material or mesh."""

    forward: ForwardModel

    @property
    def discretization(self) -> str:
        """All cells of one forward model share an order in one parameter."""
        return "" if self.refinement is None else f"{self.forward.model} {self.refinement.name}"

    def document(self) -> dict[str, object]:
        """Plain values: parameters with their units, and what predicts."""
        units_of = {"units": dict(self.units)} if self.units else {}
        document = {"parameters": dict(self.parameters), **units_of}
        return {**document, "forward": self.forward.document()}


def check_names(config: Table, keys: Sequence[tuple[str, str]], faults: Faults) -> None:
    """Check that parameters that factors and presets set stand in ``[parameters]``, if it is there.

    ``keys`` are dotted keys with the place where each is written.
    """
    table = table_of(config, "parameters")
    for key, where in keys if table else ():
        if is_parameter(key) and key.partition(".")[2] not in table:
            near = nearest(key.partition(".")[2], list(table))
            mend = f"{near}; or give it a value in [parameters]"
            faults.add(where, f"sets {key}, which [parameters] does not have", mend)


# Constraints between parameters: read by their structure, never evaluated as code.

_OPERATORS: Mapping[type, Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_COMPARISONS: Mapping[type, Callable[[float, float], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
#: sides and operations that a constraint may have
_MOST_NODES = 60


@section
class Constraint:
    """One ``[[constraint]]``: an inequality of parameters, and why cells that break it go."""

    rule: Annotated[str, Reads(text, mend='rule = "inner < 0.9 * outer"')]
    why: Annotated[str, Reads(reason, mend='say why: why = "..."')]

    def holds(self, values: Mapping[str, Value]) -> bool:
        """Whether it holds of some values, each in its own unit."""
        if any(name not in values for name in self.names):
            return True  # a value that could not be read is told where it stands
        compared = _comparison(self.rule)
        sides = [_number(side, values) for side in (compared.left, *compared.comparators)]
        pairs = zip(sides, compared.ops, sides[1:], strict=False)
        return all(_COMPARISONS[type(op)](left, right) for left, op, right in pairs)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that it compares."""
        identifiers = (n.id for n in ast.walk(_comparison(self.rule)) if isinstance(n, ast.Name))
        return tuple(dict.fromkeys(identifiers))


def _comparison(rule: str) -> ast.Compare:
    """Structure of a constraint."""
    mend = "for example inner < 0.9 * outer"
    try:
        tree = ast.parse(rule.strip(), mode="eval").body
        nodes = list(ast.walk(tree))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise Bad(f"is no inequality: {shown(rule)}", mend) from None
    if not isinstance(tree, ast.Compare) or len(nodes) > _MOST_NODES:
        raise Bad(f"is no inequality of parameters: {shown(rule)}", mend)
    allowed = (ast.Compare, ast.BinOp, ast.UnaryOp, ast.USub, ast.Name, ast.Load, ast.Constant)
    for node in nodes:
        if not isinstance(node, (*allowed, *_OPERATORS, *_COMPARISONS)) or (
            isinstance(node, ast.Constant)
            and (type(node.value) not in (int, float) or not node.value < 1e300)  # type: ignore[operator]
        ):
            raise Bad(f"may have numbers, names, + - * / and < <= > >= alone: {shown(rule)}", mend)
    return tree


def _number(node: ast.expr, values: Mapping[str, Value]) -> float:
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]
    if isinstance(node, ast.Name):
        value = values[node.id]
        if isinstance(value, str):
            raise Bad(f"compares {node.id}, which is a text: {shown(value)}", "compare numbers")
        return float(value)
    if isinstance(node, ast.UnaryOp):
        return -_number(node.operand, values)
    if not isinstance(node, ast.BinOp):
        raise TypeError(f"a constraint has no {type(node).__name__}")
    right = _number(node.right, values)
    if isinstance(node.op, ast.Div) and right == 0:
        raise Bad("divides by a parameter that is 0", "multiply instead")
    return _OPERATORS[type(node.op)](_number(node.left, values), right)


def checked(config: Table, limit: Constraint) -> Constraint:
    """Give back a constraint whose names are parameters of the file, with units that agree."""
    named = table_of(config, "parameters")
    for name in limit.names:
        if name not in named:
            raise Bad(f"names {name!r}, which [parameters] does not have", nearest(name, named))
    compared = _comparison(limit.rule)
    written = {n: number_and_unit(named[n])[1] for n in limit.names if type(named[n]) is not bool}
    sides = [compared.left, *compared.comparators]
    plain = [written.get(side.id) for side in sides if isinstance(side, ast.Name)]
    if len(plain) == len(sides) and len(set(plain)) > 1:
        mend = "write all of them in one unit in [parameters]"
        raise Bad(f"compares numbers in {' and '.join(map(repr, plain))}", mend)
    return limit
