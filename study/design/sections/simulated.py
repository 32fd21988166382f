"""Responses of a predicted curve alone, by their names in a study file."""

from __future__ import annotations

#: responses of a predicted curve alone, with their units; those at a displacement name it, too
SIMULATED = {
    "peak_force": "N",
    "work": "N mm",
    "force_at": "N",
    "stiffness_at": "N/mm",
    "dofs": "",
}

AT_DISPLACEMENT = ("force_at", "stiffness_at")


def simulated_at(name: str) -> tuple[str, float | None]:
    """Split the name of a response at a displacement into the response and the place in mm.

    Parameters
    ----------
    name : str
        Of a response; one without a place is returned as it is, with None.

    Examples
    --------
    >>> simulated_at("force_at_2.5_mm"), simulated_at("work")
    (('force_at', 2.5), ('work', None))
    """
    for start in AT_DISPLACEMENT:
        place = name.removeprefix(f"{start}_").removesuffix("_mm")
        if name == f"{start}_{place}_mm":
            return start, float(place)
    return name, None


def is_simulated(name: str) -> bool:
    """Whether a response is one of the predicted curve alone.

    Parameters
    ----------
    name : str
        Of a response, such as ``work`` or ``force_at_2.5_mm``.
    """
    return simulated_at(name)[0] in SIMULATED
