"""How the table of cases is analyzed, as a design declares it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Analysis:
    """How the table of cases is analyzed.

    Parameters
    ----------
    model : "full", int or tuple of str
        Terms: all, those up to an order, or those listed, ``"A"`` or ``"A:B"``.
    type : {"I", "II", "III"}
        Of the sums of squares.
    error : {"auto", "pooled", "own", "replicates"}
        What effects are compared with.
    alpha : float
        Level of significance.
    roles : tuple of (str, str)
        Factors and what they are to the question (:data:`study.design.study_file.ROLES`).
    family : {"response", "study"}
        Tests that Holm's adjustment takes together: of one response, or of all.
    primary : tuple of str
        Terms declared before the run, which then are the family; all terms where it is empty.
    surface : {"auto", "quadratic", "emulator", "none"}
        What is fitted over the factors that are ranges.
    contrasts : tuple of str
        Differences of two settings that every response is asked for (:mod:`study.contrast`).
    """

    model: str | int | tuple[str, ...] = "full"
    type: str = "II"
    error: str = "auto"
    alpha: float = 0.05
    roles: tuple[tuple[str, str], ...] = ()
    family: str = "response"
    primary: tuple[str, ...] = ()
    surface: str = "auto"
    contrasts: tuple[str, ...] = ()
