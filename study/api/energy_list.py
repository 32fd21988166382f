"""Energies that a material may have."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from study.ground.canonical import Keyed
from study.mechanics.material.material import ENERGIES
from study.reporting.content.blocks import Block, Table


@dataclass(frozen=True)
class EnergyList(Keyed):
    """Constants of every energy by the energy's name."""

    KEYS = "constants"

    #: Of first order, in their order.
    constants: dict[str, tuple[str, ...]]

    def blocks(self) -> Iterator[Block]:
        """One row an energy."""
        rows = tuple((name, ", ".join(names)) for name, names in self.constants.items())
        yield Table("", ("energy", "constants"), rows, 2)


def energies() -> EnergyList:
    """Every energy that a study file may name."""
    return EnergyList({name: energy.constant_names(1) for name, energy in ENERGIES.items()})
