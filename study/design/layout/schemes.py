"""Table ``[design]``: which combinations of the levels are run.

::

    [design]
    kind = "fractional"        # full | fractional | plackett-burman | central-composite
                               # | box-behnken | latin-hypercube | sobol | adaptive
                               # | d-optimal | listed
    generators = ["model.element_order = material:plates"]     # fractional; or
    resolution = 4                                             # the smallest fraction that has it
    star = "inscribed"         # central-composite: or "faced"
    runs = 32                  # latin-hypercube, sobol (a power of two), d-optimal
    seed = 7                   # of these three; that of [study] by default
    start = 30                 # adaptive: cells of a Latin hypercube that it begins with,
    batch = 4                  # cells added at a time,
    budget = 60                # most cells in all,
    until = "verdict"          # what ends it earlier: every factor has a verdict; or "q2":
    q2 = 0.95                  # leave-one-out Q2 that is enough
    terms = 2                  # d-optimal: highest order of interaction, or a list of terms
    treatments = [{ material = "yeoh", plates = "bonded" }]    # listed: exactly these cells
    zip = [["specimen.height", "test.displacement"]]           # full: levels change together
    [[design.nested]]          # full: levels that exist only within a level of another factor
    factor = "model.mesh_size"
    within = "model.space"
    levels = { axisymmetric = ["1 mm", "2 mm"], 3d = ["3 mm", "4 mm"] }
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from study.design.diagnostics import Faults, noted, read_table
from study.design.layout.adaptive import Adaptive
from study.design.layout.factorial import Full, Listed
from study.design.layout.fractional import Fractional, PlackettBurman
from study.design.layout.optimal_section import DOptimal
from study.design.layout.request import MAX_CELLS, Layout, Made, Request
from study.design.layout.response_surface import BoxBehnken, CentralComposite
from study.design.layout.samples import LatinHypercube, Sobol
from study.design.spec import Factor, Scheme
from study.setup.text import choice

#: every kind of ``[design]`` by its name
LAYOUTS: Mapping[str, type[Layout]] = {
    "full": Full,
    "fractional": Fractional,
    "plackett-burman": PlackettBurman,
    "central-composite": CentralComposite,
    "box-behnken": BoxBehnken,
    "latin-hypercube": LatinHypercube,
    "sobol": Sobol,
    "adaptive": Adaptive,
    "d-optimal": DOptimal,
    "listed": Listed,
}


def scheme_from(
    table: object, factors: tuple[Factor, ...], seed: int, excluding: bool, faults: Faults
) -> Made:
    """Read ``[design]`` and give every factor the levels that it needs.

    Parameters
    ----------
    table : mapping or None
        The table as written; None where it is left out.
    factors : tuple of Factor
        As listed; a range has its two ends as levels.
    seed : int
        Of the study, for designs that draw.
    excluding : bool
        Whether the file excludes cells.
    faults : Faults
        Where faults go.
    """
    written = {} if table is None else table
    asked = written.get("kind", "full") if isinstance(written, Mapping) else "full"
    kind = noted(choice(*LAYOUTS), asked, "design.kind", faults)
    if kind is None or not factors:
        return _few(factors), Scheme()
    before = len(faults)
    if excluding and kind not in ("full", "listed"):
        faults.add("exclude", f"a {kind} design cannot lose runs", 'use kind = "full", or none')
    made = read_table(LAYOUTS[kind], written, "design", faults).make(Request(factors, seed, faults))
    return (_few(factors), Scheme()) if len(faults) > before else made


def _few(factors: tuple[Factor, ...]) -> tuple[Factor, ...]:
    """Factors of a faulty table, for checks of their cells; none where these are too many."""
    return factors if math.prod(len(f.levels) for f in factors) <= MAX_CELLS else ()
