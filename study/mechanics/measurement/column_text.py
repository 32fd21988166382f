"""Texts that are nearly CSV: lines before the header, comments, and other delimiters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from study.ground.arrays import Array
from study.ground.bounded_file import read_bytes, table_text
from study.ground.errors import Fault, InputError
from study.ground.tabular import CsvTable, parse_csv

#: what may part the cells of a file, by its name in a study file; found out where it is not said
DELIMITERS: Mapping[str, str | None] = {
    "comma": ",",
    "semicolon": ";",
    "tab": "\t",
    "space": None,
}


@dataclass(frozen=True)
class ColumnLayout:
    """How a text differs from a plain CSV file."""

    skip_lines: int = 0
    #: Beginning of lines that hold no row; none if empty.
    comment: str = ""
    #: One of :data:`DELIMITERS`; empty where the file shows it.
    delimiter: str = ""
    #: Whether a line names the columns; without one their names are 1, 2 and so on.
    header: bool = True
    #: Encoding, sheet of a workbook and mark of thousands; found where they are empty.
    encoding: str = ""
    sheet: str = ""
    thousands: str = ""
    #: Whether the line below the names holds units; None where the file shows it.
    unit_row: bool | None = None

    def plain(self, text: str, decimal: str) -> tuple[str, list[int], str]:
        r"""Text with a header line, where its lines stand, and its delimiter if that is known.

        Examples
        --------
        >>> ColumnLayout(1, "#", "space").plain("of 1944\nl  P\n# first row\n1.02   0.0255", ".")
        ('l\tP\n1.02\t0.0255', [2, 4], '\t')
        >>> ColumnLayout(header=False).plain("1.02, 0.0255\n1.1, 0.12", ".")
        ('1,2\n1.02, 0.0255\n1.1, 0.12', [1, 1, 2], ',')
        """
        lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        at = [
            k
            for k, line in enumerate(lines, 1)
            if k > self.skip_lines and not (self.comment and line.lstrip().startswith(self.comment))
        ]
        lines = [lines[k - 1] for k in at]
        first = next((line for line in lines if line.strip()), "")
        own = self.delimiter
        if not self.header:
            own = own or _shown_by(first, ";" if decimal == "," else ",")
        mark = "\t" if own == "space" else DELIMITERS[own] or "" if own else ""
        if own == "space":
            lines = ["\t".join(line.split()) for line in lines]
        if not self.header:
            widest = max((line.count(mark) + 1 for line in lines), default=0)
            lines.insert(0, mark.join(str(k + 1) for k in range(widest)))
            at.insert(0, at[0] if at else 1)
        return "\n".join(lines), at, mark


def _shown_by(line: str, mark: str) -> str:
    """Name of the delimiter that a line of numbers shows; spaces where it shows no other."""
    names = [name for name, sign in DELIMITERS.items() if sign in (mark, ";", "\t")]
    return next((name for name in names if (DELIMITERS[name] or "") in line), "space")


def read_table(
    path: Path, layout: ColumnLayout, required: Sequence[str], decimal: str, source: str
) -> CsvTable:
    """Read a measured file; see :func:`study.ground.tabular.read_csv`."""
    raw = read_bytes(path, source)
    text, encoding = table_text(
        raw, source, encoding=layout.encoding, sheet=layout.sheet, decimal=decimal
    )
    plain, at, mark = layout.plain(text, decimal)
    table = parse_csv(
        plain, required=required, numbers=() if layout.thousands == "," else None,
        decimal=decimal, source=source, numbered=at, delimiter=mark,
    )  # fmt: skip
    table = replace(table, thousands=layout.thousands)
    return table.without_units(required, layout.unit_row).of_file(raw, encoding)


# -------------------------------------------------------------------------------------------------
# Columns of a measured test: displacement and force, or measures of strain and stress.
#
# A curve is force over displacement. What was recorded as stretch, strain or stress becomes that
# of a
# gauge section of known length and area: displacement is the elongation (or offset) in the sense
# of the test, force is nominal stress times the reference area. True stress becomes nominal at
# constant volume, sigma / l, as rubber and soft tissue are evaluated (Treloar 1975, ch. 5).

#: columns that say how far the specimen was deformed, and their dimension
KINEMATIC: Mapping[str, str] = {
    "displacement": "length",
    "stretch": "ratio",
    "strain": "ratio",
    "true_strain": "ratio",
    "volume_ratio": "ratio",
    "stretch_1": "ratio",
}

#: columns that say how it resisted
KINETIC: Mapping[str, str] = {
    "force": "force",
    "stress": "pressure",
    "true_stress": "pressure",
    "pressure": "pressure",
    "stress_1": "pressure",
}

#: second direction of a biaxial test, by its first
SECOND: Mapping[str, str] = {"stretch_1": "stretch_2", "stress_1": "stress_2"}

#: stretch beyond that of rubber and tough gels
LARGEST_STRETCH = 20.0
#: stretch at which no recording of a specimen begins
_AT_REST = 5.0

#: modes of loading in which a column has a meaning; all where it is not listed
_MODES: Mapping[str, tuple[str, ...]] = {
    "stretch": ("uniaxial", "equibiaxial", "planar", "confined", "volumetric"),
    "true_strain": ("uniaxial", "equibiaxial", "planar", "confined", "volumetric"),
    "volume_ratio": ("confined", "volumetric"),
    "true_stress": ("uniaxial", "equibiaxial", "planar", "confined", "simple-shear"),
    "pressure": ("volumetric",),
    "stretch_1": ("biaxial",),
    "stress_1": ("biaxial",),
}

_TO_STRETCH: Mapping[str, Callable[[Array], Array]] = {
    "stretch": lambda value: value,
    "stretch_1": lambda value: value,
    "strain": lambda value: 1 + value,
    "true_strain": np.exp,
}


@dataclass(frozen=True)
class Gauge:
    """What turns stretch and stress into displacement and force."""

    #: Of the specimen before the test.
    area_mm2: float
    length_mm: float
    mode: str
    #: Elongation per displacement: -1 where the test shortens.
    sense: float
    #: Whether the specimen deforms the same everywhere, so that it has one stretch.
    is_homogeneous: bool


def displacement_and_force(
    kinematic: str,
    deformed: Array,
    kinetic: str,
    resisted: Array,
    gauge: Gauge | None,
    where: str,
    *,
    in_order: bool = False,
) -> tuple[Array, Array]:
    """Curve of a test as it was recorded.

    Shapes: deformed, resisted (rows,), mm, MPa; returns (rows,).
    """
    if gauge is not None and gauge.mode == "biaxial" and kinematic not in SECOND:
        rule = "a biaxial test has a stretch and a stress in each of two directions"
        mend = "name columns stretch_1, stretch_2, stress_1 and stress_2"
        raise InputError(Fault(where, rule, mend))
    if kinematic == "displacement" and kinetic == "force":
        return deformed, resisted
    known = _checked(kinematic, kinetic, gauge, where)
    if known.mode == "simple-shear":
        shear = deformed / known.length_mm if kinematic == "displacement" else deformed
        force = resisted if kinetic == "force" else known.area_mm2 * resisted
        turned = np.where(shear < 0, -1.0, 1.0)
        if in_order or (turned > 0).all():
            return shear * known.length_mm, force
        order = np.argsort(np.abs(shear), kind="stable")
        return np.abs(shear)[order] * known.length_mm, (turned * force)[order]
    stretch = _stretch(kinematic, deformed, known)
    percent = f'if {kinematic} is in per cent, write units = {{ {kinematic} = "%" }}'
    if not (stretch > 0).all():
        rule = f"{kinematic} of {deformed[np.argmin(stretch)]:g} leaves nothing of the specimen"
        raise InputError(Fault(where, rule, f"check the column and measurements.units: {percent}"))
    least = float(stretch.min()) if kinematic.startswith("stretch") else 1.0
    if stretch.max() > LARGEST_STRETCH and (least == 1.0 or least > _AT_REST):
        rule = (
            f"{kinematic} up to {deformed[np.argmax(stretch)]:g} means a stretch of "
            f"{stretch.max():.4g}, which no soft material bears ({LARGEST_STRETCH:g} at most)"
        )
        raise InputError(Fault(where, rule, percent))
    elongation = known.sense * (stretch - 1) * known.length_mm
    displacement = deformed if kinematic == "displacement" else elongation
    return displacement, _force(kinetic, resisted, stretch, known)


def _checked(kinematic: str, kinetic: str, gauge: Gauge | None, where: str) -> Gauge:
    if gauge is None or not gauge.is_homogeneous:
        rule = f"{kinematic} and {kinetic} are those of a specimen that deforms the same everywhere"
        mend = "give displacement and force, or a test without bonded faces"
        raise InputError(Fault(where, rule, mend))
    for column in (kinematic, kinetic):
        modes = _MODES.get(column, (gauge.mode,))
        if gauge.mode not in modes:
            rule = f"a column {column} has no meaning in {gauge.mode} loading"
            raise InputError(Fault(where, rule, f"it belongs to {', '.join(modes)}"))
    return gauge


def _stretch(kinematic: str, values: Array, gauge: Gauge) -> Array:
    if kinematic == "displacement":
        return np.asarray(1 + gauge.sense * values / gauge.length_mm)
    if kinematic == "volume_ratio":
        return np.asarray(values if gauge.mode == "confined" else np.cbrt(values))
    return np.asarray(_TO_STRETCH[kinematic](values))


def _force(kinetic: str, values: Array, stretch: Array, gauge: Gauge) -> Array:
    if kinetic == "force":
        return values
    if kinetic == "pressure":  # on faces whose area shrinks with l^2
        return np.asarray(gauge.area_mm2 * values * stretch**2)
    if kinetic == "true_stress" and gauge.mode != "confined":
        return np.asarray(gauge.area_mm2 * values / stretch)
    return np.asarray(gauge.area_mm2 * values)
