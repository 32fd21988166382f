"""Constants in other codes' conventions, and back from the classical Ogden form.

Ours are W = sum C_ij (I1-3)^i (I2-3)^j, W = sum 2 mu_i / alpha_i^2 (sum l^alpha_i - 3) and
U = K/2 (J-1)^2, which are Abaqus' forms with D1 = 2/K.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from study.errors import Fault, InputError, nearest
from study.material.material import Material

CONVENTIONS = ("study", "abaqus", "febio", "ogden-classical")


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


def convert(material: Material, convention: str) -> Converted:
    """Express a material in another code's convention.

    Parameters
    ----------
    material : Material
        With numbers.
    convention : str
        One of :data:`CONVENTIONS`.

    Raises
    ------
    InputError
        If the convention is unknown or cannot express this energy.
    """
    if convention == "study":
        return Converted("study", material.model, dict(material.constants))
    if convention == "abaqus":
        return _abaqus(material)
    if convention == "febio":
        return _febio(material)
    if convention == "ogden-classical":
        return _classical(material)
    raise InputError(Fault("convention", f"no {convention!r}", nearest(convention, CONVENTIONS)))


def from_ogden_classical(moduli: Mapping[int, tuple[float, float]]) -> dict[str, float]:
    """Ogden constants from the classical W = sum m_p / a_p (sum l^a_p - 3) (Ogden 1972).

    Parameters
    ----------
    moduli : mapping of int to (m, a)
        Term number -> classical modulus in MPa and exponent.

    Returns
    -------
    dict
        ``mu_p = m_p a_p / 2`` and ``alpha_p = a_p``.

    Examples
    --------
    >>> treloar = from_ogden_classical({1: (0.63, 1.3), 2: (0.0012, 5.0), 3: (-0.01, -2.0)})
    >>> round(sum(v for k, v in treloar.items() if k.startswith("mu")), 12)
    0.4225
    """
    constants: dict[str, float] = {}
    for i, (m, a) in sorted(moduli.items()):
        constants |= {f"mu{i}": 0.5 * m * a, f"alpha{i}": float(a)}
    return constants


def abaqus_d1(bulk_modulus: float) -> float:
    """D1 = 2/K in 1/MPa; zero for an incompressible material."""
    return 2 / bulk_modulus


def bulk_from_poisson(mu0: float, poisson_ratio: float) -> float:
    """K in MPa from the initial shear modulus and Poisson's ratio."""
    return 2 * mu0 * (1 + poisson_ratio) / (3 * (1 - 2 * poisson_ratio))


def poisson_from_bulk(mu0: float, bulk_modulus: float) -> float:
    """Poisson's ratio from the initial shear modulus and K (infinite K gives 0.5)."""
    ratio = mu0 / bulk_modulus
    return (3 - 2 * ratio) / (2 * (3 + ratio))


def _abaqus(material: Material) -> Converted:
    if material.family == "linear-elastic":
        nu = poisson_from_bulk(material.mu0, material.bulk)
        return Converted("abaqus", "*Elastic", {**material.constants, "poisson_ratio": nu})
    keywords = {
        "neo-hookean": "*Hyperelastic, neo hooke",
        "mooney-rivlin": "*Hyperelastic, mooney-rivlin",
        "reduced-polynomial": f"*Hyperelastic, reduced polynomial, n={len(material.names)}",
        "polynomial": "*Hyperelastic, polynomial",
        "ogden": f"*Hyperelastic, ogden, n={len(material.names) // 2}",
    }
    keyword = keywords.get(material.model, keywords[material.family])
    return Converted(
        "abaqus", keyword, {**material.constants, "D1": abaqus_d1(material.bulk)},
    )  # fmt: skip


def _febio(material: Material) -> Converted:
    if material.family == "linear-elastic":
        nu = poisson_from_bulk(material.mu0, material.bulk)
        note = "a small-strain material on both sides only where strains are small"
        values = {"E": material.constants["youngs_modulus"], "v": nu}
        return Converted("febio", "isotropic elastic", values, note)
    if math.isinf(material.bulk):
        note = "k must be finite there: choose about 1000 mu0"
        bulk: dict[str, float] = {}
    else:
        note = "its default volumetric term is k/2 (ln J)^2: equal to ours only for J near 1"
        bulk = {"k": material.bulk}
    if material.family == "ogden":
        mu, alpha = material.ogden_terms()
        terms = {f"c{i}": 2 * float(m) for i, m in enumerate(mu, 1)}
        terms |= {f"m{i}": float(a) for i, a in enumerate(alpha, 1)}
        return Converted("febio", "Ogden", {**terms, **bulk}, note)
    known = material.constants
    if set(known) <= {"C10", "C01"}:
        pair = {"c1": known.get("C10", 0.0), "c2": known.get("C01", 0.0)}
        return Converted("febio", "Mooney-Rivlin", {**pair, **bulk}, note)
    if all(name.endswith("0") for name in known) and len(known) <= 6:
        terms = {f"c{name[1:-1]}": value for name, value in known.items()}
        return Converted("febio", "Yeoh", {**terms, **bulk}, note)
    raise InputError(Fault("convention", f"febio has no energy with {', '.join(known)}"))


def _classical(material: Material) -> Converted:
    if material.family != "ogden":
        raise InputError(
            Fault("convention", f"ogden-classical is for ogden materials, not {material.model}")
        )
    mu, alpha = material.ogden_terms()
    if not alpha.all():
        raise InputError(Fault("convention", "the classical form needs exponents that are not 0"))
    pairs = enumerate(zip(mu, alpha, strict=True), 1)
    constants: dict[str, float] = {}
    for i, (m, a) in pairs:
        constants |= {f"m{i}": 2 * float(m / a), f"alpha{i}": float(a)}
    return Converted("ogden-classical", "Ogden (1972)", constants)
