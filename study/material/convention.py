"""Constants of an energy as another code wants them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Converted:
    """Constants as another code wants them.

    Parameters
    ----------
    convention : str
        Which.
    keyword : str
        Name of the material there.
    constants : mapping of str to float
        MPa, exponents plain, D1 in 1/MPa.
    note : str
        What differs from our energy; empty if nothing does.
    """

    convention: str
    keyword: str
    constants: Mapping[str, float]
    note: str = ""


def abaqus_hyperelastic(keyword: str, constants: Mapping[str, float], bulk: float) -> Converted:
    """Return a hyperelastic material of Abaqus, whose constants are ours.

    Parameters
    ----------
    keyword : str
        Rest of the keyword line.
    constants : mapping of str to float
        In MPa, exponents plain.
    bulk : float
        K in MPa; infinite if incompressible, which D1 = 0 says there.
    """
    return Converted("abaqus", f"*Hyperelastic, {keyword}", {**constants, "D1": 2 / bulk})


def abaqus_logarithmic(keyword: str, constants: Mapping[str, float], bulk: float) -> Converted:
    """Return a material of Abaqus whose volumetric term is not ours.

    Parameters
    ----------
    keyword, constants, bulk
        As for :func:`abaqus_hyperelastic`.
    """
    note = "its volumetric term is ((J^2 - 1)/2 - ln J)/D: equal to ours only for J near 1"
    note = "" if math.isinf(bulk) else note
    return Converted("abaqus", f"*Hyperelastic, {keyword}", {**constants, "D": 2 / bulk}, note)


def febio_hyperelastic(keyword: str, constants: Mapping[str, float], bulk: float) -> Converted:
    """Return an uncoupled hyperelastic material of FEBio, with what differs there in volume.

    Parameters
    ----------
    keyword : str
        Type of the material there.
    constants : mapping of str to float
        As FEBio names them, without its bulk modulus k: MPa, exponents plain.
    bulk : float
        K in MPa; infinite if incompressible, which FEBio cannot say.
    """
    if math.isinf(bulk):
        note = "k must be finite there: choose about 1000 mu0"
        return Converted("febio", keyword, dict(constants), note)
    note = "its default volumetric term is k/2 (ln J)^2: equal to ours only for J near 1"
    return Converted("febio", keyword, {**constants, "k": bulk}, note)
