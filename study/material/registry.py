"""Every energy by the name that a study file says."""

from __future__ import annotations

import functools

from study.errors import Fault, InputError, nearest
from study.material.energies.arruda_boyce import ArrudaBoyce
from study.material.energies.extended_tube import ExtendedTube
from study.material.energies.fung import Fung
from study.material.energies.gent import Gent
from study.material.energies.linear_elastic import LinearElastic
from study.material.energies.ogden import Ogden
from study.material.energies.ogden_hill import OgdenHill
from study.material.energies.polynomial import (
    MooneyRivlin,
    NeoHookean,
    Polynomial,
    ReducedPolynomial,
    Yeoh,
)
from study.material.energies.van_der_waals import VanDerWaals
from study.material.energies.veronda_westmann import VerondaWestmann
from study.material.energy import Energy
from study.material.relaxation import is_of_relaxation, is_time

ENERGIES: dict[str, Energy] = {
    energy.name: energy
    for energy in (
        LinearElastic(),
        NeoHookean(),
        MooneyRivlin(),
        ReducedPolynomial(),
        Polynomial(),
        Ogden(),
        Yeoh(),
        ArrudaBoyce(),
        Gent(),
        ExtendedTube(),
        VanDerWaals(),
        VerondaWestmann(),
        Fung(),
        OgdenHill(),
    )
}

#: Names of all energies.
MODELS: tuple[str, ...] = tuple(ENERGIES)


def energy_named(model: str) -> Energy:
    """Find an energy by its name.

    Parameters
    ----------
    model : str
        As a study file says it, one of :data:`MODELS`.

    Raises
    ------
    InputError
        If there is no such energy; the message names the nearest one.
    """
    if model not in ENERGIES:
        raise InputError(Fault("material.model", f"no energy {model!r}", nearest(model, MODELS)))
    return ENERGIES[model]


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
    energy = energy_named(model)
    terms = 1 if order is None else order
    if isinstance(terms, bool) or int(terms) != terms or not 1 <= terms <= 9:
        raise InputError(
            Fault("material.order", f"must be a whole number from 1 to 9, got {order!r}")
        )
    if not energy.has_order and order not in (None, 1):
        raise InputError(Fault("material.order", f"{model} has no order, got {order!r}"))
    return energy.constant_names(int(terms))


def is_constant(name: str) -> bool:
    """Whether any energy, or a relaxation, has a constant of this name.

    Parameters
    ----------
    name : str
        Such as ``C10``, ``mu2`` or ``share1``.
    """
    known = any(energy.has_constant(name) for energy in ENERGIES.values())
    return known or is_of_relaxation(name)


def is_constant_key(key: str) -> bool:
    """Whether a study file may write this key for a constant of any energy.

    Parameters
    ----------
    key : str
        Of the table of a material; ``mu`` and ``alpha`` of Ogden's energy hold lists.

    Examples
    --------
    >>> is_constant_key("C20"), is_constant_key("mu"), is_constant_key("mu1")
    (True, True, False)
    """
    return any(energy.has_key(key) for energy in ENERGIES.values())


@functools.cache
def is_dimensionless(name: str) -> bool:
    """Whether a constant, or its key in a study file, is a plain number in an energy that has it.

    A share or time of relaxation counts as one too: neither is a modulus.

    Parameters
    ----------
    name : str
        Of the constant, or of its key; one that no energy has is no plain number.

    Examples
    --------
    >>> is_dimensionless("alpha2"), is_dimensionless("mu2")
    (True, False)
    """
    if is_of_relaxation(name):
        return True
    having = (e for e in ENERGIES.values() if e.has_constant(name) or e.has_key(name))
    return any(energy.is_dimensionless(name) for energy in having)


def unit_shown(name: str) -> str:
    """Return the unit in which people are told a constant: kPa, s, or none of a plain number.

    Parameters
    ----------
    name : str
        Such as ``C10``; one that no energy has counts as a modulus.

    Examples
    --------
    >>> unit_shown("C10"), unit_shown("time1"), unit_shown("alpha1")
    ('kPa', 's', '')
    """
    if is_time(name):
        return "s"
    return "" if is_dimensionless(name) else "kPa"
