"""A material as the input of Abaqus and FEBio, in their own conventions.

Abaqus: keywords ``*Hyperelastic`` and ``*Viscoelastic, time=prony`` (Abaqus Keywords Guide). The
constants are declared instantaneous, which is not the default there. FEBio: the section
``Material`` of a file of version 4 (FEBio User Manual, ch. 4), with the pressure model that has
our volumetric term, and ``uncoupled viscoelastic`` around the elastic material where it relaxes.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

from study.ground.errors import Fault, InputError, nearest
from study.mechanics.material.energy import poisson_from_bulk
from study.mechanics.material.material import Material, constant_names
from study.mechanics.material.ogden import ogden_terms
from study.mechanics.material.relaxation import long_term_share, shares, times
from study.mechanics.material.stability import stability

# Constants in other codes' conventions, and in the classical form of Ogden (1972); ours, sum C_ij
# (I1-3)^i (I2-3)^j, sum 2 mu_i / alpha_i^2 (sum l^alpha_i - 3) and K/2 (J-1)^2, are Abaqus' with
# D1 = 2/K.

CONVENTIONS = ("study", "abaqus", "febio", "ogden-classical")
#: keyword of ``*Hyperelastic`` by energy, with the number of its terms
_ABAQUS = {
    "neo-hookean": "neo hooke",
    "mooney-rivlin": "mooney-rivlin",
    "reduced-polynomial": "reduced polynomial, n={terms}",
    "polynomial": "polynomial",
    "yeoh": "yeoh",
    "ogden": "ogden, n={terms}",
    "arruda-boyce": "arruda-boyce",
    "van-der-waals": "van der waals",
}
#: energies whose volumetric term in Abaqus is another one than ours
_ABAQUS_LOGARITHMIC = ("arruda-boyce", "van-der-waals")
#: FEBio's name of an energy that has the same constants, and theirs
_FEBIO = {
    "gent": ("Gent", {"mu": "G", "Jm": "Jm"}),
    "veronda-westmann": ("Veronda-Westmann", {"C1": "c1", "C2": "c2"}),
}
#: terms of FEBio's polynomial of I1 - 3 at most
_MOST_OF_YEOH = 6


@dataclass(frozen=True)
class Converted:
    """Constants as another code wants them."""

    convention: str
    keyword: str
    #: MPa, exponents plain, D1 in 1/MPa.
    constants: Mapping[str, float]
    #: What differs from our energy; empty if nothing does.
    note: str = ""


def convert(material: Material, convention: str) -> Converted:
    """Express a material in another code's convention."""
    if convention == "study":
        return Converted("study", material.model, dict(material.constants))
    if convention == "abaqus":
        return _for_abaqus(material)
    if convention == "febio":
        return _for_febio(material)
    if convention != "ogden-classical":
        raise InputError(
            Fault("convention", f"no {convention!r}", nearest(convention, CONVENTIONS))
        )
    if material.model != "ogden":
        rule = f"ogden-classical is for ogden materials, not {material.model}"
        raise InputError(Fault("convention", rule))
    mu, alpha = ogden_terms(material.constants)
    if not alpha.all():
        raise InputError(Fault("convention", "the classical form needs exponents that are not 0"))
    values: dict[str, float] = {}
    for i, (m, a) in enumerate(zip(mu, alpha, strict=True), 1):
        # W = sum m_p / a_p (...), so m_p = 2 mu_p / alpha_p
        values |= {f"m{i}": 2 * float(m / a), f"alpha{i}": float(a)}
    return Converted("ogden-classical", "Ogden (1972)", values)


def _for_abaqus(material: Material) -> Converted:
    constants, model, bulk = material.constants, material.model, material.bulk
    terms = material.energy.order_of(constants)
    if material.small_strain:
        nu = poisson_from_bulk(material.mu0, bulk)
        return Converted("abaqus", "*Elastic", {**constants, "poisson_ratio": nu})
    if material.poisson_ratio is not None and model == "ogden-hill":
        nus = {f"nu{k}": material.poisson_ratio for k in range(1, terms + 1)}
        return Converted("abaqus", f"*Hyperfoam, n={terms}", {**constants, **nus})
    if model not in _ABAQUS:
        raise _no_counterpart("abaqus", material)
    keyword = f"*Hyperelastic, {_ABAQUS[model].format(terms=terms)}"
    if model not in _ABAQUS_LOGARITHMIC:
        return Converted("abaqus", keyword, {**constants, "D1": 2 / bulk})
    note = "its volumetric term is ((J^2 - 1)/2 - ln J)/D: equal to ours only for J near 1"
    note = "" if math.isinf(bulk) else note
    return Converted("abaqus", keyword, {**constants, "D": 2 / bulk}, note)


def _for_febio(material: Material) -> Converted:
    constants, bulk = material.constants, material.bulk
    if material.small_strain:
        note = "a small-strain material on both sides only where strains are small"
        values = {
            "E": constants["youngs_modulus"], "v": poisson_from_bulk(material.mu0, bulk)
        }  # fmt: skip
        return Converted("febio", "isotropic elastic", values, note)
    if material.model in _FEBIO:
        keyword, names = _FEBIO[material.model]
        values = {names[name]: value for name, value in constants.items()}
    elif material.model == "arruda-boyce":  # N links in a chain
        keyword = "Arruda-Boyce"
        values = {"mu": constants["mu"], "N": constants["lambda_m"] ** 2}
    elif material.model == "ogden":  # W = sum c_i / m_i^2 (...), so c_i = 2 mu_i
        keyword, (mu, alpha) = "Ogden", ogden_terms(constants)
        values = {f"c{i}": 2 * float(m) for i, m in enumerate(mu, 1)}
        values |= {f"m{i}": float(a) for i, a in enumerate(alpha, 1)}
    elif set(constants) <= {"C10", "C01"}:
        keyword = "Mooney-Rivlin"
        values = {"c1": constants.get("C10", 0.0), "c2": constants.get("C01", 0.0)}
    elif all(name.endswith("0") for name in constants) and len(constants) <= _MOST_OF_YEOH:
        keyword = "Yeoh"
        values = {f"c{name[1:-1]}": value for name, value in constants.items()}
    else:
        raise _no_counterpart("febio", material)
    if math.isinf(bulk):
        note = "k must be finite there: choose about 1000 mu0"
        return Converted("febio", keyword, values, note)
    note = "its default volumetric term is k/2 (ln J)^2: equal to ours only for J near 1"
    return Converted("febio", keyword, {**values, "k": bulk}, note)


def _no_counterpart(convention: str, material: Material) -> InputError:
    rule = f"{convention} has no energy with {', '.join(material.constants)}"
    mend = "fit an energy that it has, or give it this one as a user subroutine (Abaqus: UHYPER)"
    return InputError(Fault("convention", rule, mend))


# Files of the two programs.

#: terms of a series of ``*Hyperelastic`` at most
MOST_OF_ABAQUS = 6
#: relaxation terms of FEBio at most
MOST_OF_FEBIO = 6
#: values on a data line of Abaqus
_PER_LINE = 8
#: finite bulk modulus over the shear modulus, where FEBio needs one of an incompressible material
NEARLY_INCOMPRESSIBLE = 1000.0

_WIDTH = 90
_UNITS = "Units: mm, N, s, MPa."


def material_name(text: str) -> str:
    """Return a name that both programs take: letters, digits and underscores, a letter first."""
    plain = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")[:60] or "a"
    return plain if plain[0].isalpha() else f"material_{plain}"


def remarks(material: Material, converted: Converted) -> tuple[str, ...]:
    """Say what whoever uses the constants elsewhere must know."""
    lines = [_UNITS, f"Drucker's criterion: {stability(material).sentence}."]
    if converted.convention == "febio":
        if material.incompressible:
            finite = f"k = {NEARLY_INCOMPRESSIBLE:g} mu0 there, which must be finite."
            lines.append(f"Incompressible here; {finite}")
    elif converted.note:
        lines.append(f"{converted.note[0].upper()}{converted.note[1:]}.")
    if converted.convention == "abaqus" and material.incompressible and not material.small_strain:
        lines.append("Incompressible (D = 0): take hybrid elements, such as C3D8H or C3D10H.")
    if material.relaxation:
        lines.append("The constants are instantaneous ones; K does not relax.")
    if material.relaxation and converted.convention == "febio":
        lines.append(
            "FEBio fades the second Piola-Kirchhoff stress without its projection at the present "
            "state: the same where the volume is kept, as k does."
        )
    return tuple(lines)


def abaqus_text(material: Material, name: str) -> str:
    """Write the lines of a material for an Abaqus input file."""
    converted = convert(material, "abaqus")
    keyword, values = _abaqus_values(material, converted)
    lines = [f"** {line}" for line in _head(material, converted)]
    lines += [f"*Material, name={name}"]
    lines += [keyword + (", moduli=instantaneous" if material.relaxation else "")]
    rows = [values[k : k + _PER_LINE] for k in range(0, len(values), _PER_LINE)]
    lines += [", ".join(_number(value) for value in row) for row in rows]
    if material.relaxation:
        lines += ["*Viscoelastic, time=prony"]
        terms = zip(shares(material.relaxation), times(material.relaxation), strict=True)
        lines += [f"{_number(share)}, 0., {_number(time)}" for share, time in terms]
    return "\n".join(lines) + "\n"


def _abaqus_values(material: Material, converted: Converted) -> tuple[str, list[float]]:
    """Keyword line and data of a material, a volumetric constant for every term."""
    constants = dict(converted.constants)
    volume = constants.pop("D1", constants.pop("D", None))
    keyword, terms = converted.keyword, 1
    if keyword.endswith("polynomial"):
        terms = material.energy.order_of(constants)
        keyword = f"{keyword}, n={terms}"
        constants = {n: constants.get(n, 0.0) for n in constant_names("polynomial", terms)}
    elif keyword.endswith("yeoh"):
        terms = len(constants)
    elif count := re.search(r"n=(\d+)", keyword):
        terms = int(count[1])
    if terms > MOST_OF_ABAQUS:
        rule = f"Abaqus takes {MOST_OF_ABAQUS} terms of this energy at most, got {terms}"
        raise InputError(Fault("material.order", rule, "calibrate fewer terms"))
    if volume is None:
        return keyword, list(constants.values())
    return keyword, [*constants.values(), volume, *[0.0] * (terms - 1)]


def febio_text(material: Material, name: str) -> str:
    """Write a FEBio file that holds a material alone."""
    converted = convert(material, "febio")
    if len(material.relaxation) > MOST_OF_FEBIO:
        rule = f"FEBio takes {MOST_OF_FEBIO} terms at most, got {len(material.relaxation)}"
        raise InputError(Fault("material.relaxation", rule, "calibrate fewer terms"))
    kind, inner = _febio_material(material, converted)
    return _FEBIO_FILE.format(
        remarks="\n".join(_head(material, converted)), name=name, kind=kind,
        inner="\n".join(f"    {line}" for line in inner),
    )  # fmt: skip


_FEBIO_FILE = """\
<?xml version="1.0" encoding="UTF-8"?>
<!--
{remarks}
-->
<febio_spec version="4.0">
  <Module type="solid"/>
  <Material>
    <material id="1" name="{name}" type="{kind}">
{inner}
    </material>
  </Material>
</febio_spec>
"""


def _febio_material(material: Material, converted: Converted) -> tuple[str, list[str]]:
    """Type of a material, and the lines in it."""
    bulk, kind = material.bulk, converted.keyword
    constants = _elements({n: v for n, v in converted.constants.items() if n != "k"})
    if material.small_strain:
        return kind, constants
    volume = {"k": bulk if math.isfinite(bulk) else NEARLY_INCOMPRESSIBLE * material.mu0}
    around = [*_elements(volume), "  <pressure_model>Abaqus</pressure_model>"]
    if not material.relaxation:
        return kind, [*constants, *around]
    fading = {"g0": long_term_share(material.relaxation)}
    fading |= {f"g{k}": float(v) for k, v in enumerate(shares(material.relaxation), 1)}
    fading |= {f"t{k}": float(v) for k, v in enumerate(times(material.relaxation), 1)}
    elastic = [f'  <elastic type="{kind}">', *(f"  {e}" for e in constants), "  </elastic>"]
    return "uncoupled viscoelastic", [*around, *_elements(fading), *elastic]


def _elements(values: Mapping[str, float]) -> list[str]:
    return [f"  <{name}>{_number(value)}</{name}>" for name, value in values.items()]


def _number(value: float) -> str:
    """Every digit of a number, with a point, as Fortran wants it."""
    text = repr(float(value))
    return text if re.search(r"[.e]", text) else f"{text}."


def _head(material: Material, converted: Converted) -> list[str]:
    return [line for text in remarks(material, converted) for line in textwrap.wrap(text, _WIDTH)]
