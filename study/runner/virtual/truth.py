"""Materials behind virtual specimens: energies with published constants, and how they scatter.

The truth of a virtual specimen should lie in no family that a design compares; otherwise
the member of that family wins by birth. Constants are those of Ecoflex 00-10, mix EF10_0T
(``hyperelastic_parameters_ef10.json`` of Dawood et al. 2026, data CC BY 4.0).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import factorial

from study.errors import Fault, InputError, nearest

Constants = Mapping[str, float]


@dataclass(frozen=True)
class Truth:
    """A material and the ways in which its shape of response scatters.

    Parameters
    ----------
    model : str
        Energy as the solver knows it.
    constants : mapping
        Its constants, MPa (exponents plain).
    directions : tuple of mapping
        Each is a change of the constants per unit of one standard normal number, before it
        is multiplied by the generator's ``shape_sd``; the stiffness scatters besides.
    words : str
        What it is, for the record.
    """

    model: str
    constants: Constants
    directions: tuple[Constants, ...]
    words: str


def _yeoh() -> Truth:
    constants = {"C10": 7.7021e-3, "C20": -0.0628e-3, "C30": 0.2479e-3}
    higher = tuple({n: constants[n]} for n in ("C20", "C30"))
    return Truth("reduced-polynomial", constants, higher, "reduced polynomial of order 3")


def _ogden() -> Truth:
    """Two terms; published as classical moduli m = 2 mu / alpha."""
    classical = ((0.12417390e-3, 10.490170), (10.288743e-3, 2.8092082))
    constants: dict[str, float] = {}
    for i, (m, alpha) in enumerate(classical, start=1):
        constants |= {f"mu{i}": m * alpha / 2, f"alpha{i}": alpha}
    directions = ({"alpha1": constants["alpha1"]}, {"alpha2": constants["alpha2"]})
    return Truth("ogden", constants, directions, "Ogden's energy of two terms")


def _humphrey(order: int = 9) -> Truth:
    """W = b (exp(c (I1 - 3)) - 1) (Humphrey and Yin 1987), as its power series.

    What nine terms leave out is below 4e-5 of the stress up to I1 - 3 = 6; a stretch of 2.5
    has 4. The exponent scatters at fixed initial modulus 2 b c.
    """
    b, c = 24.913774e-3, 0.25632133
    constants = {f"C{k}0": b * c**k / factorial(k) for k in range(1, order + 1)}
    exponent = {f"C{k}0": (k - 1) * constants[f"C{k}0"] for k in range(2, order + 1)}
    return Truth("reduced-polynomial", constants, (exponent,), "Humphrey's exponential energy")


TRUTHS: Mapping[str, Truth] = {"yeoh": _yeoh(), "ogden": _ogden(), "humphrey": _humphrey()}


def truth(name: str) -> Truth:
    """Find a truth by its name.

    Parameters
    ----------
    name : {"yeoh", "ogden", "humphrey"}
        Key of :data:`TRUTHS`.

    Raises
    ------
    InputError
        If there is none of this name.
    """
    if name not in TRUTHS:
        raise InputError(Fault("--truth", f"no truth {name!r}", nearest(name, TRUTHS)))
    return TRUTHS[name]
