"""A surface over ranges as a function that needs no package: JSON and a Python module."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np

import study
from study.laboratory.haptics.haptic_export import SCHEMA, rendered
from study.statistics.surfaces.emulator import BlockedEmulator, Emulator
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import box_points
from study.statistics.surfaces.surface_profile import FittedSurface

#: points of the box at which the error bound is looked for
ASKED = 4096


class Input(TypedDict):
    """An argument of the function: ends of its range in its unit."""

    name: str
    argument: str
    low: float
    high: float
    unit: str
    log: bool


class SurfacePart(TypedDict):
    """A sum of weights times correlations with points of the unit box."""

    kernel: str
    lengths: list[float]
    points: list[list[float]]
    weights: list[float]


class Product(TypedDict):
    """A coefficient times a product of coded inputs, which are -1 to 1 over their ranges."""

    inputs: list[int]
    coefficient: float


@dataclass(frozen=True)
class SurfaceFunction:
    """A surface as plain numbers."""

    #: Identifier, also the stem of its files.
    name: str
    surface: FittedSurface
    inputs: tuple[Input, ...]
    #: What is added to all sums, in the response's unit.
    constant: float
    #: Of an emulator, one a block.
    parts: tuple[SurfacePart, ...]
    products: tuple[Product, ...]
    #: Largest half width of the 95 % intervals in the ranges, in the response's unit.
    bound: float

    def sentences(self) -> tuple[str, ...]:
        """Say what it is, where it holds and how well."""
        fit = self.surface
        at = ", ".join(f"{name} = {label}" for name, label in fit.labels.items())
        what = f"{fit.response}{f' in {fit.unit}' if fit.unit else ''}{f' at {at}' if at else ''}"
        ranges = "; ".join(
            f"{i['argument']} ({i['name']}) {i['low']:g} to {i['high']:g} {i['unit']}".strip()
            for i in self.inputs
        )
        return (
            f"{what}, from {0 if fit.found is None else fit.found.runs.response.size} runs.",
            f"Ranges: {ranges}. Outside of them it raises ValueError: nothing was run there.",
            f"It is within {self.bound:.3g} {fit.unit} of the simulation at about 95 % of the "
            "settings: the largest half width of its intervals.",
        )

    def document(self) -> dict[str, object]:
        """Plain values, units in their own keys."""
        return {
            "schema": SCHEMA,
            "kind": "emulator" if self.parts else "quadratic",
            "name": self.name,
            "response": self.surface.response,
            "unit": self.surface.unit,
            "at": dict(self.surface.labels),
            "inputs": list(self.inputs),
            "constant": self.constant,
            "parts": list(self.parts),
            "products": list(self.products),
            "error_bound": self.bound,
            "sentences": list(self.sentences()),
            "version": study.__version__,
        }

    def files(self, folder: Path) -> dict[Path, str]:
        """Text of its files by their path in a folder."""
        text = json.dumps(self.document(), indent=1, allow_nan=False) + "\n"
        return {folder / f"{self.name}.json": text, folder / f"{self.name}.py": self.python()}

    def python(self) -> str:
        """Python module that imports nothing but math."""
        return rendered("surface.py.j2", f=self, said=self.sentences())


def surface_function(study_name: str, fitted: FittedSurface) -> SurfaceFunction:
    """Make the function of a surface."""
    if fitted.found is None:
        raise ValueError(fitted.refused)
    model, runs = fitted.found.model, fitted.found.runs
    arguments = _arguments(runs.names)
    inputs = tuple(
        Input(
            name=f.name, argument=arguments[f.name], low=f.low, high=f.high,
            unit=fitted.units.get(f.name, ""), log=f.log,
        )
        for f in runs.factors
    )  # fmt: skip
    name = _identifier(" ".join((study_name, fitted.response, *fitted.labels.values())))
    _, half = model.predict(box_points(len(inputs), ASKED))
    bound = float(np.max(half))
    if isinstance(model, QuadraticSurface):
        polynomial = model.polynomial
        products = tuple(
            Product(inputs=list(t.factors), coefficient=float(c))
            for t, c in zip(polynomial.terms, polynomial.coefficients, strict=True)
        )
        return SurfaceFunction(name, fitted, inputs, 0.0, (), products, bound)
    each = model.each if isinstance(model, BlockedEmulator) else (model,)
    made = [_part(emulator, len(each)) for emulator in each]
    constant = sum(level for level, _ in made)
    return SurfaceFunction(name, fitted, inputs, constant, tuple(p for _, p in made), (), bound)


def _part(emulator: Emulator, blocks: int) -> tuple[float, SurfacePart]:
    """Level and weights of a process, over the number of blocks."""
    process = emulator.process
    kernel = process.found.kernel
    levels, weights = process.solved
    combination = emulator.combination or 0
    if kernel.categories is not None:
        weights = weights * kernel.categories.matrix[combination, kernel.combination(process.x)]
    scale = emulator.scale / blocks
    part = SurfacePart(
        kernel=kernel.family,
        lengths=kernel.lengths.tolist(),
        points=kernel.numbers(process.x).tolist(),
        weights=(scale * process.found.variance * weights).tolist(),
    )
    return emulator.centre / blocks + scale * float(levels[combination]), part


def _arguments(names: tuple[str, ...]) -> dict[str, str]:
    """Last parts of dotted keys where these differ, else the whole keys."""
    last = [name.rpartition(".")[2] for name in names]
    chosen = last if len(set(last)) == len(last) else list(names)
    return {name: _identifier(word) for name, word in zip(names, chosen, strict=True)}


def _identifier(text: str) -> str:
    plain = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "x"
    return f"x_{plain}" if plain[0].isdigit() else plain
