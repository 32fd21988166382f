"""One file for each code that the same problem is given to; each runs in its own process.

The files import nothing but NumPy and their own code, so that any interpreter that has the
code can run them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Peer:
    """How a code is called, and how one gets it."""

    module: str
    title: str
    install: str
    #: Debian's packages serve the system's own interpreter
    python: str | None = None
    #: whether it can share the work among processes
    parallel: bool = False


_PYPI = "python -m pip install --group bench (or set --python {name}=INTERPRETER that has it)"

NAMES = {
    "study": Peer("ours", "study", "make setup"),
    "felupe": Peer("felupe", "FElupe", _PYPI.format(name="felupe")),
    "forms": Peer("forms", "plain scikit-fem forms", "make setup"),
    "ngsolve": Peer("ngsolve", "NGSolve", _PYPI.format(name="ngsolve")),
    "dolfinx": Peer(
        "dolfinx",
        "DOLFINx",
        "Debian or Ubuntu: apt-get install python3-dolfinx-real libopenblas0-pthread",
        "/usr/bin/python3",
        parallel=True,
    ),
    "dolfinx-expert": Peer(
        "dolfinx_expert",
        "DOLFINx with kept factors",
        "Debian or Ubuntu: apt-get install python3-dolfinx-real libopenblas0-pthread",
        "/usr/bin/python3",
        parallel=True,
    ),
    "calculix": Peer("calculix", "CalculiX", "Debian or Ubuntu: apt-get install calculix-ccx"),
}
