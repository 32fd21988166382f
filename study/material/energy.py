"""Every energy, declared once: its constants, their bounds and the family that computes it.

Strain energies per unit reference volume, with isochoric invariants and principal
stretches (Holzapfel 2000, eqs. 6.79-6.119; Ogden 1972) and, for every hyperelastic model,
the volumetric part U = K/2 (J - 1)^2:

* polynomial family: W = sum C_ij (I1 - 3)^i (I2 - 3)^j
* Ogden family: W = sum 2 mu_i / alpha_i^2 (l1^alpha_i + l2^alpha_i + l3^alpha_i - 3)
* linear-elastic: W = mu e:e + (K/2 - mu/3) (tr e)^2, small strain on purpose

Adding an energy
----------------
One :class:`Energy` in :data:`ENERGIES`, about ten lines, is all for a member of a family: for
example Yeoh's model with its own name is ::

    Energy(
        "yeoh",
        "polynomial",
        lambda order: ("C10", "C20", "C30"),
        "C10|C20|C30",
        _bounds_reduced,
    )

Design files, fits, closed forms, the stability check, and the solver with its tangent and
gradients then know it (a test declares just this one and solves with it). A formula outside
the three families also needs a family: its principal stresses and their derivatives in
``material/principal.py``, and the same, compiled, in ``forward/ogden.py``, whose spectral
tangent serves any energy of principal stretches.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from study.errors import Fault, InputError, nearest

Family = Literal["polynomial", "ogden", "linear-elastic"]
Bounds = tuple[float, float]
FREE: Bounds = (-math.inf, math.inf)
POSITIVE: Bounds = (0.0, math.inf)

#: beyond this |alpha| a stretch of 0.5 gives powers that only overfit
EXPONENT: Bounds = (-30.0, 30.0)


@dataclass(frozen=True)
class Energy:
    """One named energy.

    Parameters
    ----------
    name : str
        What a design file says.
    family : str
        Which formula computes it.
    names : callable
        Number of terms -> names of the constants, in order.
    grammar : str
        Regular expression that every constant's name obeys.
    bounds : callable
        Name of a constant -> (low, high) for a fit, in MPa (plain for an exponent).
    open_ended : bool
        Whether the number of terms is the user's choice.
    sparse : bool
        Whether constants may be left out (they are then zero).
    """

    name: str
    family: Family
    names: Callable[[int], tuple[str, ...]]
    grammar: str
    bounds: Callable[[str], Bounds]
    open_ended: bool = False
    sparse: bool = False


def _reduced(order: int) -> tuple[str, ...]:
    return tuple(f"C{i}0" for i in range(1, order + 1))


def _polynomial(order: int) -> tuple[str, ...]:
    return tuple(f"C{n - j}{j}" for n in range(1, order + 1) for j in range(n + 1))


def _ogden(order: int) -> tuple[str, ...]:
    return tuple(f"{kind}{i}" for i in range(1, order + 1) for kind in ("mu", "alpha"))


def _bounds_ogden(name: str) -> Bounds:
    return EXPONENT if name.startswith("alpha") else FREE


def _bounds_reduced(name: str) -> Bounds:
    return POSITIVE if name == "C10" else FREE


def energy(model: str) -> Energy:
    """Find the declaration of an energy by its name.

    Raises
    ------
    InputError
        If there is no such energy; the message names the nearest one.
    """
    if model not in ENERGIES:
        raise InputError(Fault("material.model", f"no energy {model!r}", nearest(model, MODELS)))
    return ENERGIES[model]


ENERGIES: dict[str, Energy] = {
    energy.name: energy
    for energy in (
        Energy(
            "linear-elastic",
            "linear-elastic",
            lambda order: ("youngs_modulus",),
            "youngs_modulus",
            lambda name: POSITIVE,
        ),
        Energy("neo-hookean", "polynomial", lambda order: ("C10",), "C10", lambda name: POSITIVE),
        Energy(
            "mooney-rivlin",
            "polynomial",
            lambda order: ("C10", "C01"),
            "C10|C01",
            lambda name: FREE,
        ),
        Energy(
            "reduced-polynomial",
            "polynomial",
            _reduced,
            r"C[1-9]\d*0",
            _bounds_reduced,
            open_ended=True,
        ),
        Energy(
            "polynomial",
            "polynomial",
            _polynomial,
            r"C\d+\d",
            lambda name: FREE,
            open_ended=True,
            sparse=True,
        ),
        Energy("ogden", "ogden", _ogden, r"(mu|alpha)[1-9]\d*", _bounds_ogden, open_ended=True),
    )
}

#: names of all energies, as a design file writes them
MODELS: tuple[str, ...] = tuple(ENERGIES)


def constant_names(model: str, order: int | None = None) -> tuple[str, ...]:
    """Names of an energy's constants, in order.

    Parameters
    ----------
    model : str
        Name of the energy.
    order : int, optional
        Number of terms, for energies that have a choice (default 1).

    Raises
    ------
    InputError
        If the energy is unknown, or its order is not a positive whole number.

    Examples
    --------
    >>> constant_names("reduced-polynomial", 3)
    ('C10', 'C20', 'C30')
    >>> constant_names("polynomial", 2)
    ('C10', 'C01', 'C20', 'C11', 'C02')
    >>> constant_names("ogden", 2)
    ('mu1', 'alpha1', 'mu2', 'alpha2')
    """
    declared = energy(model)
    terms = 1 if order is None else order
    if isinstance(terms, bool) or int(terms) != terms or not 1 <= terms <= 9:
        raise InputError(
            Fault("material.order", f"must be a whole number from 1 to 9, got {order!r}")
        )
    if not declared.open_ended and order not in (None, 1):
        raise InputError(Fault("material.order", f"{model} has no order, got {order!r}"))
    return declared.names(int(terms))


def index_pair(name: str) -> tuple[int, int]:
    """Powers (i, j) of a constant C_ij; the last digit is j.

    Examples
    --------
    >>> index_pair("C20"), index_pair("C01")
    ((2, 0), (0, 1))
    """
    match = re.fullmatch(r"C(\d+)(\d)", name)
    if match is None or match.groups() == ("0", "0"):
        raise InputError(Fault(f"material.{name}", "is not a polynomial constant such as C10"))
    return int(match[1]), int(match[2])
