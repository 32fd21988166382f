"""A force law as JSON, CSV, a Python module and a C header."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import textwrap
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

import study
from study.haptics.force_law import ForceLaw, Table
from study.material.registry import is_dimensionless

#: Version of the JSON document.
SCHEMA = 1
#: Columns of a comment.
WIDTH = 90


def stem_of(name: str) -> str:
    """Name of a law as an identifier of Python and C, which is also that of its files.

    Parameters
    ----------
    name : str
        Name of the study; what no identifier holds becomes an underscore.

    Examples
    --------
    >>> stem_of("flat-indentation"), stem_of("2 mm")
    ('flat_indentation_force_law', 'law_2_mm_force_law')
    """
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "a"
    return f"{'law_' if plain[0].isdigit() else ''}{plain}_force_law"


def sentences(law: ForceLaw) -> list[str]:
    """Say where a law holds, how near it is, and what it does elsewhere.

    Parameters
    ----------
    law : ForceLaw
        With its held-out points and the ranges of its constants.
    """
    held, end = law.held_out, law.force.end_mm
    largest = f"{held.largest_N:.2g} N ({100 * law.relative_error:.2g} % of the largest force)"
    said = [
        f"Tested from 0 to {end:g} mm: within {largest} of the simulation on "
        f"{held.force_N.size} points solved between its {law.force.values.size} knots.",
        f"Below 0 mm it is zero and beyond {end:g} mm it goes on straight; no simulation says so, "
        "and is_tested tells where that is.",
        f"Its slope is continuous but at first touch, where it begins with "
        f"{law.force.slopes[0]:.4g} N/mm.",
        _monotone(law),
    ]
    return said + [_range(law, k) for k in range(len(law.ranges))]


def _monotone(law: ForceLaw) -> str:
    if law.limited:
        places = ", ".join(f"{law.displacement_mm[k]:.4g}" for k in law.limited)
        return f"It rises where the simulation does: its slope is limited at {places} mm."
    if law.is_monotone:
        return "It never falls, with the slopes of the simulation."
    return "The simulated force falls somewhere, and so does the law."


def _range(law: ForceLaw, k: int) -> str:
    one = law.ranges[k]
    factor, unit = (1.0, "") if is_dimensionless(one.name) else (1e3, " kPa")
    ends = f"{one.name} from {factor * one.low:.4g} to {factor * one.high:.4g}{unit}"
    if math.isnan(one.largest_N):
        return f"With {ends} alone the simulation does not reach the end: use no such constants."
    return f"With {ends} alone it is within {one.largest_N:.2g} N, to first order."


def document(law: ForceLaw) -> dict[str, object]:
    """Document of ``study export --as force-law --json``: plain values, units in the names.

    Parameters
    ----------
    law : ForceLaw
        Displacement in mm, force in N, constants in MPa (exponents plain).
    """
    return {
        "schema": SCHEMA,
        "kind": "force-law",
        "name": law.name,
        "displacement_mm": law.displacement_mm.tolist(),
        "force_N": law.force.values.tolist(),
        "stiffness_N_per_mm": law.force.slopes.tolist(),
        "constants_MPa": dict(law.constants),
        "force_gradient": {n: _table(t) for n, t in law.gradients.items()},
        "tested_mm": [0.0, law.force.end_mm],
        "continuation": {"below": "zero", "above": "linear", "simulated": False},
        "monotone": law.is_monotone,
        "limited_mm": [float(law.displacement_mm[k]) for k in law.limited],
        "error_bound": {
            "force_N": law.held_out.largest_N,
            "relative": law.relative_error,
            "at_mm": law.held_out.worst_mm,
            "points": law.held_out.force_N.size,
        },
        "held_out": {
            "displacement_mm": law.held_out.displacement_mm.tolist(),
            "force_N": law.held_out.force_N.tolist(),
            "deviation_N": law.held_out.deviation_N.tolist(),
        },
        "constant_ranges": [
            {"name": r.name, "low": r.low, "high": r.high, "largest_N": _finite(r.largest_N)}
            for r in law.ranges
        ],
        "standard_uncertainty_N": _uncertainty(law),
        "sentences": sentences(law),
        "version": study.__version__,
    }


def _table(table: Table) -> dict[str, list[float]]:
    return {"value": table.values.tolist(), "slope_per_mm": table.slopes.tolist()}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _uncertainty(law: ForceLaw) -> list[float] | None:
    found = law.standard_uncertainty_at(law.displacement_mm)
    return None if found is None or not np.isfinite(found).all() else found.tolist()


def csv_text(law: ForceLaw) -> str:
    """Knots as CSV: displacement, force, stiffness, gradients.

    Parameters
    ----------
    law : ForceLaw
        One row a knot: mm, N, N/mm, and N per MPa for each constant (N for a plain exponent).
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    gradients = [f"dF_d{name}" for name in law.gradients]
    writer.writerow(["displacement_mm", "force_N", "stiffness_N_per_mm", *gradients])
    columns = [law.displacement_mm, law.force.values, law.force.slopes]
    columns += [table.values for table in law.gradients.values()]
    writer.writerows([repr(float(v)) for v in row] for row in zip(*columns, strict=True))
    return stream.getvalue()


def python_text(law: ForceLaw) -> str:
    """Python module without imports.

    Parameters
    ----------
    law : ForceLaw
        Written into the module as numbers in mm, N and MPa.
    """
    return _rendered("force_law.py.j2", law)


def c_text(law: ForceLaw) -> str:
    """C header without includes.

    Parameters
    ----------
    law : ForceLaw
        Written into the header as numbers in mm, N and MPa.
    """
    return _rendered("force_law.h.j2", law)


def files(law: ForceLaw, folder: Path) -> dict[Path, str]:
    """Text of every file of a law, by its path in a folder; nothing is written.

    Parameters
    ----------
    law : ForceLaw
        Its name gives the names of the files.
    folder : Path
        It need not exist.

    Returns
    -------
    dict of Path to str
        JSON, CSV, Python module and C header.
    """
    stem = stem_of(law.name)
    text = json.dumps(document(law), indent=2, allow_nan=False) + "\n"
    made = {"json": text, "csv": csv_text(law), "py": python_text(law), "h": c_text(law)}
    return {folder / f"{stem}.{suffix}": content for suffix, content in made.items()}


def _rendered(template: str, law: ForceLaw) -> str:
    environment = Environment(
        loader=PackageLoader("study.haptics"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = _number
    environment.filters["folded"] = lambda line, mark: f"\n{mark}".join(textwrap.wrap(line, WIDTH))
    environment.filters["numbers"] = lambda values: ", ".join(map(_number, values))
    return environment.get_template(template).render(
        law=law,
        name=law.name,
        stem=stem_of(law.name),
        sentences=sentences(law),
        made_by=f"Made by study {study.__version__}.",
    )


def _number(value: float) -> str:
    """Shortest decimals that are read as the same float, in Python and in C."""
    return repr(float(value))
