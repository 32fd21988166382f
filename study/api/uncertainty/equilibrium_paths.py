"""Checks of what lies between the load steps: energy, and the interpolation of the curve."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from study.reporting.numbers import percent, quantity
from study.reporting.text import count, listing, name_of
from study.study_result.report_data import Check

if TYPE_CHECKING:
    from study.record.record import Record


#: Largest share of the stored energy by which the work of a test may be off without a snap.
MISMATCH = 0.002

#: Largest change of a response in per cent where every other load step is left out, in
#: percentage points; a difference that matters to anybody is ten times larger.
STEP_CHANGE_PP = 0.05

#: Below this a change is one of rounding, in the unit of the response.
NOTHING = 1e-12


def checks_of_paths(records: Sequence[Record], responses: Sequence[str]) -> Iterator[Check]:
    """Check energy balance and load steps of every case that was simulated.

    Parameters
    ----------
    records : sequence of Record
        Of the study; those without an answer, or without an energy balance, are passed over.
    responses : sequence of str
        Names of the study's responses.
    """
    solved = [r for r in records if r.converged and "energy_mismatch" in r.solver]
    if solved:
        yield _energy(solved)
    steps = [
        (name, u, entry["unit"])
        for record in solved
        for name, entry in record.responses.items()
        if (u := entry.get("u_steps")) is not None and name in responses
    ]
    if steps:
        yield _load_steps(steps)


def _energy(solved: Sequence[Record]) -> Check:
    """Compare the work of the test with the energy stored."""
    name = "work of the test equals stored energy"
    snapped = [r for r in solved if r.solver.get("snaps_mm")]
    smooth = [r.solver["energy_mismatch"] for r in solved if not r.solver.get("snaps_mm")]
    worst = max(smooth, default=0.0)
    held = max(r.solver.get("stabilization_share", 0.0) for r in solved)
    finding = (
        f"the two differ by {_at_most(worst)} of the largest energy where nothing snaps; the "
        f"stabilization of the elements holds {_at_most(held)} of it"
    )
    if not snapped:
        good = worst <= MISMATCH
        mend = "" if good else "raise test.steps: the force between the load steps is not certain"
        return Check(name, "pass" if good else "caution", finding, mend)
    first = snapped[0]
    place = ", ".join(f"{d:.3g}" for d in first.solver["snaps_mm"])
    finding += (
        f"; in {count(len(snapped), 'case')} the surface snaps to another equilibrium, for "
        f"example past {place} mm in {' / '.join(first.levels.values())}"
    )
    return Check(
        name, "caution", finding,
        "beyond a snap the force depends on the mesh; see whether a finer mesh snaps as well",
    )  # fmt: skip


def _at_most(fraction: float) -> str:
    r"""Write an upper bound of a share.

    Examples
    --------
    >>> [_at_most(share).replace("\xa0", " ") for share in (0.004, 0.0001, 0.0)]
    ['at most 0.40 %', 'less than 0.1 %', 'none']
    """
    if fraction == 0:
        return "none"
    shown = percent(fraction, 2)
    return shown.replace("< ", "less than ") if shown.startswith("<") else f"at most {shown}"


def _load_steps(steps: Sequence[tuple[str, float, str]]) -> Check:
    """Say what every other load step changes, response by response."""
    worst: dict[str, tuple[float, str]] = {}
    for name, u, unit in steps:
        if u >= worst.get(name, (0.0, ""))[0]:
            worst[name] = u, "pp" if unit == "%" else unit
    told = [
        f"{name_of(name)} {quantity(u if u > NOTHING else 0.0, unit, 2)}"
        for name, (u, unit) in worst.items()
    ]
    finding = (
        "with every other load step left out, each response changes by no more than this: "
        f"{listing(told)}; it is part of the numerical uncertainty"
    )
    name = "responses do not depend on the load steps"
    if all(u <= STEP_CHANGE_PP for u, unit in worst.values() if unit == "pp"):
        return Check(name, "pass", finding)
    return Check(name, "caution", finding, "raise test.steps")
