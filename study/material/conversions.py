"""Constants in other codes' conventions, and back from the classical Ogden form.

Ours are W = sum C_ij (I1-3)^i (I2-3)^j, W = sum 2 mu_i / alpha_i^2 (sum l^alpha_i - 3) and
U = K/2 (J-1)^2, which are Abaqus' forms with D1 = 2/K.
"""

from __future__ import annotations

from collections.abc import Mapping

from study.errors import Fault, InputError, nearest
from study.material.convention import Converted
from study.material.material import Material

CONVENTIONS = ("study", "abaqus", "febio", "ogden-classical")


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
        return material.energy.abaqus(material.constants, material.compressibility)
    if convention == "febio":
        return material.energy.febio(material.constants, material.compressibility)
    if convention == "ogden-classical":
        return material.energy.ogden_classical(material.constants)
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
