"""Polynomials of the isochoric invariants: W = sum C_ij (I1 - 3)^i (I2 - 3)^j."""

from __future__ import annotations

import functools
import re
from abc import ABC, abstractmethod
from collections.abc import Collection
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.polynomial.polyutils import trimseq

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.mechanics.material.energy import (
    FREE,
    POSITIVE,
    Bounds,
    Compressibility,
    Constants,
    IsochoricEnergy,
    Law,
    PointLaw,
)

# Energies W(I1, I2) of the isochoric invariants by ``a = I1 - 3`` and ``b = I2 - 3``; principal
# stresses follow by the chain rule (Holzapfel 2000, eqs. 6.32 and 6.52).


class Slopes(NamedTuple):
    """First derivatives of W, or of its derivative by a constant."""

    #: By I1 and I2, MPa.
    by_a: Array | float
    by_b: Array | float = 0.0


class Curvatures(NamedTuple):
    """Second derivatives of W."""

    #: By I1 twice, by both, by I2 twice, MPa.
    aa: Array | float
    ab: Array | float = 0.0
    bb: Array | float = 0.0


class Invariants(NamedTuple):
    """Squares of isochoric stretches and their invariants."""

    #: shape (3, ...); bar_i^2.
    squares: Array
    #: shape (...); I1, I1 - 3 and I2 - 3.
    i1: Array
    a: Array
    b: Array

    @classmethod
    def of(cls, bar: Array) -> Invariants:
        """Of isochoric principal stretches, shape (3, ...)."""
        b = bar**2
        i1 = np.add.reduce(b)
        i2 = b[0] * b[1] + b[1] * b[2] + b[2] * b[0]
        return cls(b, i1, i1 - 3, i2 - 3)


class Form(ABC):
    """Function of both invariants that one compiled law serves, with its coefficients."""

    @abstractmethod
    def slopes(self, a: Array, b: Array) -> Slopes:
        """First derivatives."""

    @abstractmethod
    def curvatures(self, a: Array, b: Array) -> Curvatures:
        """Second derivatives."""

    @abstractmethod
    def law(self) -> Law:
        """Coefficients as the compiled law takes them."""


class InvariantEnergy(IsochoricEnergy):
    """Energy of the isochoric invariants; NaN beyond a limit of the stretch, where it has one."""

    @abstractmethod
    def form(self, constants: Constants) -> Form:
        """W."""

    @abstractmethod
    def form_rate(self, constants: Constants, name: str) -> Form:
        """Differentiate W by a constant."""

    def law(self, constants: Constants, compressibility: Compressibility) -> Law:
        """Hand over the coefficients of W."""
        return self.form(constants).law()

    def law_rate(self, constants: Constants, compressibility: Compressibility, name: str) -> Law:
        """Hand over those of the derivative."""
        return self.form_rate(constants, name).law()

    def _forms(self, constants: Constants) -> tuple[Form, dict[str, Form]]:
        return _differentiated(self, tuple(constants.items()))

    def principal_stress(self, constants: Constants, bar: Array) -> Array:
        """2 b_i (W_1 + W_2 (I1 - b_i)) with b_i = bar_i^2."""
        at = Invariants.of(bar)
        return _stress(at, self._forms(constants)[0].slopes(at.a, at.b))

    def principal_stress_slope(self, constants: Constants, bar: Array, direction: Array) -> Array:
        """Differentiate by the chain rule through both invariants."""
        at, (form, _) = Invariants.of(bar), self._forms(constants)
        return _stress_slope(at, form.slopes(at.a, at.b), form.curvatures(at.a, at.b), direction)

    def stress_and_slope(
        self, constants: Constants, bar: Array, direction: Array
    ) -> tuple[Array, Array]:
        """Both from the same invariants and slopes of W."""
        at, (form, _) = Invariants.of(bar), self._forms(constants)
        slopes, curvatures = form.slopes(at.a, at.b), form.curvatures(at.a, at.b)
        return _stress(at, slopes), _stress_slope(at, slopes, curvatures, direction)

    def principal_stress_gradient(self, constants: Constants, bar: Array) -> dict[str, Array]:
        """Stress of each derivative of W."""
        at, (_, rates) = Invariants.of(bar), self._forms(constants)
        return {name: _stress(at, rate.slopes(at.a, at.b)) for name, rate in rates.items()}

    def initial_shear_modulus(
        self, constants: Constants, compressibility: Compressibility
    ) -> float:
        """2 (W_1 + W_2) at rest."""
        return _shear(self._forms(constants)[0])

    def initial_shear_modulus_gradient(
        self, constants: Constants, compressibility: Compressibility
    ) -> dict[str, float]:
        """Differentiate 2 (W_1 + W_2) at rest."""
        return {name: _shear(rate) for name, rate in self._forms(constants)[1].items()}


def _stress(at: Invariants, slopes: Slopes) -> Array:
    w1, w2 = slopes
    if _vanish(w2):
        return np.asarray(2 * at.squares * w1)
    return np.asarray(2 * at.squares * (w1 + w2 * (at.i1 - at.squares)))


def _stress_slope(
    at: Invariants, slopes: Slopes, curvatures: Curvatures, direction: Array
) -> Array:
    """Differentiate the stress along one direction or several, shape (..., 3, n)."""
    b = at.squares
    (w1, w2), w11, w12, w22 = slopes, curvatures.aa, curvatures.ab, curvatures.bb
    db = 2 * b * direction[..., None]
    di1 = np.add.reduce(db, axis=-2, keepdims=True)
    if _vanish(w2, w12, w22):
        return np.asarray(2 * db * w1 + 2 * b * (w11 * di1))
    rest = at.i1 - b
    di2 = np.add.reduce(rest * db, axis=-2, keepdims=True)
    dw1, dw2 = w11 * di1 + w12 * di2, w12 * di1 + w22 * di2
    return np.asarray(2 * db * (w1 + w2 * rest) + 2 * b * (dw1 + dw2 * rest + w2 * (di1 - db)))


def _vanish(*derivatives: Array | float) -> bool:
    """Whether derivatives are zero everywhere by the form of W, said by plain zeros."""
    return all(isinstance(value, float) and value == 0.0 for value in derivatives)


def _shear(form: Form) -> float:
    slopes = form.slopes(np.zeros(1), np.zeros(1))
    return float(2 * (np.ravel(slopes.by_a)[0] + np.ravel(slopes.by_b)[0]))


@functools.lru_cache(maxsize=64)
def _differentiated(
    energy: InvariantEnergy, constants: tuple[tuple[str, float], ...]
) -> tuple[Form, dict[str, Form]]:
    """W and its derivatives by the constants, once for all the states at which they are needed."""
    named = dict(constants)
    return energy.form(named), {name: energy.form_rate(named, name) for name in named}


#: coefficients of a polynomial in two variables, as :func:`_columns` orders them
Coefficients = tuple[tuple[float, ...], ...]
#: name of a constant: the power of the first invariant less 3, then a digit for the second
_NAME = re.compile(r"C(\d|[1-9]\d+)(\d)", re.ASCII)


class PolynomialTable(Form):
    """Polynomial of I1 - 3 and I2 - 3."""

    def __init__(self, coefficients: Array) -> None:
        #: shape (ni, nj); of (I1 - 3)^i (I2 - 3)^j, MPa.
        self.coefficients = coefficients

    @functools.cached_property
    def _first(self) -> list[Coefficients]:
        return [_columns(_derivative(self.coefficients, axis)) for axis in (0, 1)]

    @functools.cached_property
    def _second(self) -> list[Coefficients]:
        by_a, by_b = (_derivative(self.coefficients, axis) for axis in (0, 1))
        return [_columns(_derivative(*pair)) for pair in ((by_a, 0), (by_a, 1), (by_b, 1))]

    def slopes(self, a: Array, b: Array) -> Slopes:
        """By Horner's rule."""
        return Slopes(*(_value(columns, a, b) for columns in self._first))

    def curvatures(self, a: Array, b: Array) -> Curvatures:
        """By Horner's rule."""
        return Curvatures(*(_value(columns, a, b) for columns in self._second))

    def law(self) -> Law:
        """Hand over the table."""
        return Law(PointLaw.POLYNOMIAL, self.coefficients)


class PolynomialEnergy(InvariantEnergy):
    """What all polynomials of the invariants have in common."""

    shear_modulus_formula = "2 (C10 + C01)"

    def order_of(self, names: Collection[str]) -> int:
        """Return the highest degree i + j."""
        return max((sum(index_pair(name)) for name in names), default=0)

    def ordered(self, names: Collection[str]) -> tuple[str, ...]:
        """C10, C01, C20, C11, C02, ..."""
        return tuple(sorted(names, key=_rank))

    def bounds(self, constant: str) -> Bounds:
        """Constants of any sign."""
        return FREE

    def form(self, constants: Constants) -> PolynomialTable:
        """C_ij themselves."""
        return PolynomialTable(coefficient_table(constants))

    def form_rate(self, constants: Constants, name: str) -> PolynomialTable:
        """1 in the place of the constant: W is linear in them."""
        table = np.zeros_like(coefficient_table(constants))
        table[index_pair(name)] = 1.0
        return PolynomialTable(table)

    def always_elliptic(self, constants: Constants) -> bool:
        """Positive constants of the first invariant alone and of the second invariant itself."""
        # A sum of strongly elliptic energies is strongly elliptic.
        table = coefficient_table(constants)
        convex = table.copy()
        convex[:, 0] = convex[0, 1:2] = 0.0
        return bool((table >= 0).all() and not convex.any() and table.any())

    def always_stable(self, constants: Constants) -> bool:
        """Positive constants of the first invariant alone and of the second invariant itself."""
        # By logarithmic stretches the second derivatives of I1 are 4 diag(b), those of I2 are 4
        # diag(1 / b), with squares b of stretches: both positive, and a growing convex function of
        # I1 adds a square.
        resists = constants.get("C10", 0.0) + constants.get("C01", 0.0) > 0
        return resists and self.always_elliptic(constants)

    def starting_values(self, names: Collection[str], shear_modulus: float) -> dict[str, float]:
        """C10 alone: higher constants of a closed form soften too much for a bonded specimen."""
        return {"C10": shear_modulus / 2}


class MooneyRivlin(PolynomialEnergy):
    """W = C10 (I1 - 3) + C01 (I2 - 3)."""

    name = "mooney-rivlin"

    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """C10 and C01."""
        return ("C10", "C01")


class ReducedPolynomial(PolynomialEnergy):
    """W = sum C_i0 (I1 - 3)^i; of third order it is Yeoh's."""

    name = "reduced-polynomial"
    has_order = True
    #: Terms of an energy that leaves no choice of them.
    terms: ClassVar[int | None] = None

    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """C10, C20, ..."""
        return tuple(f"C{i}0" for i in range(1, (self.terms or order) + 1))

    def has_constant(self, name: str) -> bool:
        """Ci0 with a positive i."""
        if self.terms:
            return name in self.constant_names()
        return re.fullmatch(r"C[1-9]\d*0", name) is not None

    def bounds(self, constant: str) -> Bounds:
        """C10 is positive."""
        return POSITIVE if constant == "C10" else FREE

    def simpler(self, order: int) -> tuple[str, int | None] | None:
        """One order lower: a third order that starts from C10 alone softens without end."""
        terms = self.terms or order
        if terms > 2:
            return ReducedPolynomial.name, terms - 1
        return None if self.terms else super().simpler(order)


class NeoHookean(ReducedPolynomial):
    """W = C10 (I1 - 3)."""

    name = "neo-hookean"
    has_order = False
    terms = 1


class Yeoh(ReducedPolynomial):
    """The reduced polynomial of third order by its own name (Yeoh 1993)."""

    name = "yeoh"
    has_order = False
    terms = 3


class Polynomial(PolynomialEnergy):
    """All terms up to a degree; those left out are zero."""

    name = "polynomial"
    has_order = True
    sparse = True

    def constant_names(self, order: int = 1) -> tuple[str, ...]:
        """C10, C01, C20, C11, C02, ..."""
        return tuple(f"C{n - j}{j}" for n in range(1, order + 1) for j in range(n + 1))

    def has_constant(self, name: str) -> bool:
        """Cij; C00 would be an energy without a stress."""
        return name != "C00" and _NAME.fullmatch(name) is not None


@functools.cache
def index_pair(name: str) -> tuple[int, int]:
    """Powers (i, j) of a constant C_ij; the last digit is j."""
    match = _NAME.fullmatch(name)
    if match is None or match.groups() == ("0", "0"):
        raise InputError(Fault(f"material.{name}", "is not a polynomial constant such as C10"))
    return int(match[1]), int(match[2])


def coefficient_table(constants: Constants) -> Array:
    """Coefficients C_ij in MPa, shape (ni + 1, nj + 1)."""
    pairs = {name: index_pair(name) for name in constants}
    table = np.zeros((1 + max(i for i, _ in pairs.values()), 1 + max(j for _, j in pairs.values())))
    for name, pair in pairs.items():
        table[pair] = constants[name]
    return table


def _rank(name: str) -> tuple[int, int]:
    i, j = index_pair(name)
    return i + j, j


def _derivative(table: Array, axis: int) -> Array:
    """Coefficients of the derivative of a polynomial by one of its two variables."""
    # That of a constant is one zero, however many coefficients there are of the other variable.
    size = table.shape[axis]
    if size == 1:
        return np.zeros((1, 1))
    power = np.arange(1.0, size)
    return table[1:] * power[:, None] if axis == 0 else table[:, 1:] * power


def _columns(table: Array) -> Coefficients:
    """Coefficients of a polynomial in two variables by columns, from the highest power down."""
    # Those of the highest powers that are zero are left out.
    columns = [tuple(trimseq(column)[::-1]) for column in table.T[::-1].tolist()]
    while len(columns) > 1 and columns[0] == (0.0,):
        columns.pop(0)
    return tuple(columns)


def _value(columns: Coefficients, x: Array, y: Array) -> Array | float:
    """Value of a polynomial in two variables by Horner's rule; a plain number if it is constant."""
    # Of numpy's ``polyval2d``, which does the same, nine tenths of the time are checks: a fit in
    # closed form asks for some thousand values of a few points each.
    total = _horner(columns[0], x)
    for column in columns[1:]:
        total = _horner(column, x) + total * y
    return total


def _horner(coefficients: tuple[float, ...], x: Array) -> Array | float:
    first, *others = coefficients
    inner: Array | float = first
    for coefficient in others:
        inner = coefficient + inner * x
    return inner
