"""The tables ``[calibration]``: of a design, and of a calibration file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal, get_args

from study.ground import units
from study.ground.declaration import AsWritten, Bad, Reads, choice, integer, section, shown
from study.ground.errors import nearest
from study.mechanics.material.material import is_dimensionless

METHODS = ("auto", "analytic", "inverse-fem", "none")
#: how residuals count: by squares, or beyond some noise in proportion (Huber 1964, Ann. Math. Stat.
#: 35, 73; Triggs et al. 2000, Bundle adjustment, sec. 4)
Loss = Literal["linear", "soft-l1", "huber"]
#: how the support of an indented layer may enter its closed form
Theory = Literal["integral-equation", "dimitriadis", "half-space"]
#: keys that mean something to it alone
ANALYTIC_KEYS = ("theory", "profile", "contact")
#: name of a constant -> its least and largest value, in MPa, exponents plain
Bounds = Mapping[str, tuple[float, float]]
#: value of ``leave_out`` that scores the curve fitted
NOTHING = "nothing"

_LeaveOut = Annotated[str | None, Reads(choice("specimen", "test"))]
_HeldOut = Annotated[str | None, Reads(choice("specimen", "test", NOTHING))]


@section
class CalibrationProblem:
    """Tables that replace the design's own where constants are fitted."""

    specimen: AsWritten = None
    test: AsWritten = None
    measurements: AsWritten = None


@section
class Calibration:
    """How the constants of a design are found."""

    #: By default ``"none"`` where the
    #: constants are given, else ``"auto"``.
    method: Annotated[str | None, Reads(choice(*METHODS))] = None
    #: What is predicted by constants that were fitted
    #: without it. By default the specimen, where the scored curve would be the fitted one and there
    #: are three specimens or more.
    leave_out: _HeldOut = None
    #: The fitted test, if it is another one than the scored.
    problem: CalibrationProblem | None = None


@section
class Fitting:
    """How a calibration file wants its constants found."""

    #: Whether all specimens share their constants, or every one is also fitted
    #: for itself.
    specimens: Annotated[str, Reads(choice("pooled", "each"))] = "pooled"
    #: What is predicted by constants that were fitted without it.
    leave_out: _LeaveOut = None
    #: As written; see :func:`bounds_of`.
    bounds: AsWritten = None
    #: Starts of the fit: its own, and others that are drawn.
    starts: Annotated[int, Reads(integer(1, 1000))] = 1
    seed: Annotated[int, Reads(integer(0, 2**32 - 1))] = 0
    #: Calls of the model in each search, and how long the whole calibration may take, s.
    max_evaluations: Annotated[int, Reads(integer(1, 100_000))] = 200
    max_time: Annotated[float | None, Reads(lambda value: units.parse(value, "time"))] = None
    #: How residuals count: by squares, or beyond their noise in proportion.
    loss: Annotated[Loss, Reads(choice(*get_args(Loss)))] = "linear"
    #: ``"analytic"``: Young's modulus of indentations in closed form, curve
    #: by curve.
    method: Annotated[str, Reads(choice("auto", "analytic"))] = "auto"
    #: How the support enters that closed form.
    theory: Annotated[Theory, Reads(choice(*get_args(Theory)))] = "integral-equation"
    #: What a sphere is there: itself, or Hertz's paraboloid, as the
    #: series has it.
    profile: Annotated[str, Reads(choice("sphere", "paraboloid"))] = "sphere"
    #: Whether contact is at displacement 0, or fitted in every curve of that
    #: closed form.
    contact: Annotated[str, Reads(choice("given", "fitted"))] = "given"
    #: Depth up to which rows are fitted there, in place of the least one at which an assumption
    #: ends.
    depth_limit: Annotated[float | None, Reads(lambda value: units.parse(value, "length"))] = None


def bounds_of(names: Sequence[str] | None) -> Callable[[object], Bounds]:
    """Reader of bounds, ``{ C10 = ["1 kPa", "20 kPa"] }``; of any constant without names."""

    def read(value: object) -> Bounds:
        if not isinstance(value, Mapping):
            raise Bad(f"must be a table, got {shown(value)}", 'C10 = ["1 kPa", "20 kPa"]')
        return {name: _pair(name, pair, names) for name, pair in value.items()}

    return read


def _pair(name: str, pair: object, names: Sequence[str] | None) -> tuple[float, float]:
    if names is not None and name not in names:
        raise Bad(f"{shown(name)} is no constant of this fit", nearest(str(name)[:80], names))
    if not isinstance(pair, list) or len(pair) != 2:
        raise Bad(f"{name} must be two values, got {shown(pair)}", '["1 kPa", "20 kPa"]')
    low, high = (_value(name, v) for v in pair)
    if not low < high:
        raise Bad(f"{name} must rise, got {shown(pair)}")
    return low, high


def _value(name: str, value: object) -> float:
    if not is_dimensionless(name):
        return units.parse(value, "pressure")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise Bad(f"{name} is a plain number, got {shown(value)}")
    return float(value)
