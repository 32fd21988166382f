"""A force law as JSON, CSV, a Python module and a C header."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

import study
from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.laboratory.haptics.tabulated_force import (
    ConstantRange,
    ForceLaw,
    HeldOut,
    force_table,
    gradient_table,
)
from study.mechanics.forward.finite_element import at_steps
from study.mechanics.material.material import is_dimensionless
from study.mechanics.setup.setup import Problem

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution


SCHEMA = 1
#: Columns of a comment.
WIDTH = 90


def stem_of(name: str) -> str:
    """Name of a law as an identifier of Python and C, which is also that of its files.

    Examples
    --------
    >>> stem_of("flat-indentation"), stem_of("2 mm")
    ('flat_indentation_force_law', 'law_2_mm_force_law')
    """
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "a"
    return f"{'law_' if plain[0].isdigit() else ''}{plain}_force_law"


def sentences(law: ForceLaw) -> list[str]:
    """Say where a law holds, how near it is, and what it does elsewhere."""
    held, end = law.held_out, law.force.end_mm
    largest = f"{held.bound_N:.2g} N ({100 * law.relative_error:.2g} % of the largest force)"
    lines = [
        f"Tested from 0 to {end:g} mm: within {largest} of the simulation on "
        f"{held.force_N.size} points solved between its {law.force.values.size} knots.",
        f"Below 0 mm it is zero and beyond {end:g} mm it goes on straight; no simulation says so, "
        "and is_tested tells where that is.",
        f"Its slope is continuous but at first touch, where it begins with "
        f"{law.force.slopes[0]:.4g} N/mm.",
    ]
    if law.limited:
        places = ", ".join(f"{law.displacement_mm[k]:.4g}" for k in law.limited)
        lines += [f"It rises where the simulation does: its slope is limited at {places} mm."]
    elif law.is_monotone:
        lines += ["It never falls, with the slopes of the simulation."]
    else:
        lines += ["The simulated force falls somewhere, and so does the law."]
    return lines + [_range(constant) for constant in law.ranges]


def _range(constant: ConstantRange) -> str:
    factor, unit = (1.0, "") if is_dimensionless(constant.name) else (1e3, " kPa")
    ends = f"{constant.name} from {factor * constant.low:.4g} to {factor * constant.high:.4g}{unit}"
    if math.isnan(constant.largest_N):
        return f"With {ends} alone the simulation does not reach the end: use no such constants."
    return f"With {ends} alone it is within {constant.largest_N:.2g} N, to first order."


def document(law: ForceLaw) -> dict[str, object]:
    """Document of ``study export --as force-law --json``: plain values, units in the names."""
    # Units: law mm, N, MPa.
    uncertainty = law.standard_uncertainty_at(law.displacement_mm)
    return {
        "schema": SCHEMA,
        "kind": "force-law",
        "name": law.name,
        "displacement_mm": law.displacement_mm.tolist(),
        "force_N": law.force.values.tolist(),
        "stiffness_N_per_mm": law.force.slopes.tolist(),
        "constants_MPa": dict(law.constants),
        "force_gradient": {
            n: ({"value": t.values.tolist(), "slope_per_mm": t.slopes.tolist()})
            for n, t in law.gradients.items()
        },
        "tested_mm": [0.0, law.force.end_mm],
        "continuation": {"below": "zero", "above": "linear", "simulated": False},
        "monotone": law.is_monotone,
        "limited_mm": [float(law.displacement_mm[k]) for k in law.limited],
        "error_bound": {
            "force_N": law.held_out.bound_N,
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
            {**vars(r), "largest_N": r.largest_N if math.isfinite(r.largest_N) else None}
            for r in law.ranges
        ],
        "standard_uncertainty_N": None
        if uncertainty is None or not np.isfinite(uncertainty).all()
        else uncertainty.tolist(),
        "sentences": sentences(law),
        "version": study.__version__,
    }


def files(law: ForceLaw, folder: Path) -> dict[Path, str]:
    """Text of every file of a law, by its path in a folder; nothing is written."""
    stem = stem_of(law.name)
    text = json.dumps(document(law), indent=2, allow_nan=False) + "\n"
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    gradients = [f"dF_d{name}" for name in law.gradients]
    writer.writerow(["displacement_mm", "force_N", "stiffness_N_per_mm", *gradients])
    columns = [law.displacement_mm, law.force.values, law.force.slopes]
    columns += [table.values for table in law.gradients.values()]
    writer.writerows([repr(float(v)) for v in row] for row in zip(*columns, strict=True))
    made = {"json": text, "csv": stream.getvalue()}
    made |= {  # a Python module without imports, a C header without includes
        suffix: rendered(
            f"force_law.{suffix}.j2", law=law, name=law.name, stem=stem, sentences=sentences(law)
        )
        for suffix in ("py", "h")
    }
    return {folder / f"{stem}.{suffix}": content for suffix, content in made.items()}


def rendered(template: str, **content: object) -> str:
    """Text of a template of this package; it says what made it."""
    environment = Environment(
        loader=PackageLoader("study.laboratory.haptics"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = _number
    environment.filters["folded"] = lambda line, mark: f"\n{mark}".join(textwrap.wrap(line, WIDTH))
    environment.filters["numbers"] = lambda values: ", ".join(map(_number, values))
    made_by = f"Made by study {study.__version__}."
    return environment.get_template(template).render(made_by=made_by, **content)


def _number(value: float) -> str:
    """Shortest decimals that are read as the same float, in Python and in C."""
    return repr(float(value))


# Solve a test in steps fine enough for its force law, with points kept out to judge it.

#: Fewest intervals of a table: a spline through its gradients needs that many.
FEWEST_INTERVALS = 4
#: Most intervals of a table. Each doubling divides the error of a smooth force by 16; where 320
#: do not reach the tolerance, contact on the mesh is what bends the curve.
MOST_INTERVALS = 320
#: Points of a path for each interval of the table: all but one are kept out of it.
PARTS = 4
#: Error bound over the largest force. Hands tell forces apart by 5 to 10 % (Jones 1989).
TOLERANCE = 2e-3
#: Share of each constant by which it is moved to see what first order leaves out.
CONSTANT_SHARE = 0.1

Progress = Callable[[str], None]


@dataclass(frozen=True)
class ForceLawSource:
    """A problem, and what is known of its constants."""

    #: Of the file, the calibration, or the study and its case.
    name: str
    problem: Problem
    #: How far each constant is moved, MPa (exponents plain): two standard errors of calibrated
    #: ones; a tenth of those that are left out.
    half_ranges: Mapping[str, float] = field(default_factory=dict)
    #: shape (p, p); of calibrated constants, MPa^2.
    covariance: Array | None = None


def solved_force_law(
    source: ForceLawSource, tolerance: float = TOLERANCE, progress: Progress | None = None
) -> ForceLaw:
    """Force law of a problem, with intervals halved until its error bound is met."""
    say, name, problem = progress or (lambda text: None), source.name, source.problem
    intervals = max(problem.test.steps, FEWEST_INTERVALS)
    while True:
        solution = _solved(problem, PARTS * intervals)
        law = tabulated(name, problem, solution.curve)
        say(f"{intervals} intervals: {100 * law.relative_error:.2g} % of the largest force")
        if law.relative_error <= tolerance or 2 * intervals > MOST_INTERVALS:
            break
        intervals *= 2
    law = replace(law, covariance=source.covariance)
    return replace(law, ranges=tuple(_ranges(law, solution, source, say)))


def tabulated(name: str, problem: Problem, path: Curve) -> ForceLaw:
    """Tabulate every fourth point of a path in even steps; judge by the others, and between them.

    Between its points the path is its own interpolation, with the work that it does and without.
    """
    curve = _with_origin(path)
    if curve.stiffness_N_per_mm is None:
        raise ValueError("a force law needs the stiffness of its curve")
    knots = np.arange(0, len(curve), PARTS)
    others = np.setdiff1d(np.arange(len(curve)), knots)
    d, force_N, slopes = curve.displacement_mm, curve.force_N, curve.stiffness_N_per_mm[knots]
    force = force_table(float(d[PARTS]), force_N[knots], slopes)
    gradients = {
        name: gradient_table(float(d[PARTS]), values[knots])
        for name, values in curve.force_gradient.items()
    }
    between = np.linspace(0.0, float(d[-1]), PARTS * len(path) + 1)
    missed = [force.at(between) - one.force_at(between) for one in (path, curve)]
    return ForceLaw(
        name=name,
        force=force,
        gradients=gradients,
        constants=dict(problem.material.constants),
        limited=tuple(int(k) for k in np.flatnonzero(force.slopes[1:] != slopes[1:]) + 1),
        held_out=HeldOut(
            d[others], force_N[others], force.at(d[others]) - force_N[others],
            float(np.abs(missed).max()),
        ),
    )  # fmt: skip


def _solved(problem: Problem, steps: int, warm: Solution | None = None) -> Solution:
    """Solution in even steps."""
    asked_problem = replace(problem, test=replace(problem.test, steps=steps))
    if asked_problem.test.hold_s is not None or asked_problem.test.cycles is not None:
        rule = "makes a force over time, and a law is one over displacement"
        raise InputError(Fault("test", rule, "leave hold and cycles out"))
    solution = at_steps(asked_problem, warm=warm)
    if not solution.converged:
        rule = f"the simulation ends too early ({solution.status}): {solution.message}"
        mend = "press less deep: a law ends where the simulation does"
        raise InputError(Fault("test.displacement", rule, mend))
    return solution


def _with_origin(curve: Curve) -> Curve:
    """Begin a curve at the unloaded state, with the slope that its work implies."""
    # the law's first interval ends at the fourth point, whose work is known best
    first = curve.at_points(np.arange(PARTS - 1, len(curve), PARTS)).slope_at_origin()
    slopes = curve.stiffness_N_per_mm
    return Curve(
        np.r_[0.0, curve.displacement_mm],
        np.r_[0.0, curve.force_N],
        None if slopes is None else np.r_[first, slopes],
        {name: np.r_[0.0, values] for name, values in curve.force_gradient.items()},
    )


def _ranges(
    law: ForceLaw, solution: Solution, source: ForceLawSource, say: Progress
) -> list[ConstantRange]:
    """Move every constant alone to both ends of its range, and solve there."""
    ranges = []
    for name, value in law.constants.items():
        half = source.half_ranges.get(name, CONSTANT_SHARE * abs(value))
        ends = (value - half, value + half)
        # NaN, where one end has no answer, stays NaN
        off = float(
            np.max([_deviation(law, source.problem, solution, {name: end}) for end in ends])
        )
        ranges.append(ConstantRange(name, *ends, off))
        say(f"{name} from {ends[0]:.4g} to {ends[1]:.4g}: {off:.2g} N from first order")
    return ranges


def _deviation(
    law: ForceLaw, problem: Problem, solution: Solution, constants: Mapping[str, float]
) -> float:
    """Largest deviation in N at other constants; NaN where the simulation has no answer."""
    moved = replace(problem, material=problem.material.with_constants(constants))
    try:
        curve = _solved(moved, len(solution.curve), solution).curve
    except InputError:
        return float("nan")
    return float(np.abs(law.force_at(curve.displacement_mm, constants) - curve.force_N).max())
