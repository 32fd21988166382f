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
from collections.abc import Mapping, Sequence

from study.ground.errors import Fault, InputError
from study.mechanics.material.energy import Converted
from study.mechanics.material.material import Material, constant_names
from study.mechanics.material.relaxation import long_term_share, shares, times
from study.mechanics.material.stability import stability

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
    """Return a name that both programs take: letters, digits and underscores, a letter first.

    Examples
    --------
    >>> material_name("2 mm gel"), material_name("ecoflex-10")
    ('material_2_mm_gel', 'ecoflex_10')
    """
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
    converted = material.energy.abaqus(material.constants, material.compressibility)
    keyword, values = _abaqus_values(material, converted)
    lines = [f"** {line}" for remark in remarks(material, converted) for line in _wrapped(remark)]
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
    converted = material.energy.febio(material.constants, material.compressibility)
    if len(material.relaxation) > MOST_OF_FEBIO:
        rule = f"FEBio takes {MOST_OF_FEBIO} terms at most, got {len(material.relaxation)}"
        raise InputError(Fault("material.relaxation", rule, "calibrate fewer terms"))
    lines = [line for remark in remarks(material, converted) for line in _wrapped(remark)]
    inner = _febio_material(material, converted, name)
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            "<!--",
            *lines,
            "-->",
            '<febio_spec version="4.0">',
            '  <Module type="solid"/>',
            "  <Material>",
            *(f"    {line}" for line in inner),
            "  </Material>",
            "</febio_spec>",
            "",
        ]
    )


def _febio_material(material: Material, converted: Converted, name: str) -> list[str]:
    constants = {n: v for n, v in converted.constants.items() if n != "k"}
    head = f'<material id="1" name="{name}"'
    if material.small_strain:
        return [f'{head} type="{converted.keyword}">', *_elements(constants), "</material>"]
    bulk = material.bulk
    volume = {"k": bulk if math.isfinite(bulk) else NEARLY_INCOMPRESSIBLE * material.mu0}
    around = [*_elements(volume), "  <pressure_model>Abaqus</pressure_model>"]
    if not material.relaxation:
        return [
            f'{head} type="{converted.keyword}">',
            *_elements(constants),
            *around,
            "</material>",
        ]
    fading = {"g0": long_term_share(material.relaxation)}
    fading |= {f"g{k}": float(v) for k, v in enumerate(shares(material.relaxation), 1)}
    fading |= {f"t{k}": float(v) for k, v in enumerate(times(material.relaxation), 1)}
    return [
        f'{head} type="uncoupled viscoelastic">',
        *around,
        *_elements(fading),
        f'  <elastic type="{converted.keyword}">',
        *(f"  {line}" for line in _elements(constants)),
        "  </elastic>",
        "</material>",
    ]


def _elements(values: Mapping[str, float]) -> Sequence[str]:
    return [f"  <{name}>{_number(value)}</{name}>" for name, value in values.items()]


def _number(value: float) -> str:
    """Every digit of a number, with a point, as Fortran wants it."""
    text = repr(float(value))
    return text if re.search(r"[.e]", text) else f"{text}."


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH)
