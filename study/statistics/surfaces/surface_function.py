"""A fitted surface as plain numbers, which any language adds up: what ``study export`` writes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import study
from study.ground.arrays import gathered
from study.ground.canonical import Keyed
from study.statistics.surfaces.emulator import Emulator
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import box_points
from study.statistics.surfaces.surface_result import FittedSurface

#: points of the box at which the error bound is looked for
ASKED = 4096


@dataclass(frozen=True)
class SurfaceFunction(Keyed):
    """A surface as plain numbers, units in their own keys."""

    KEYS = (
        "schema kind name response=surface.response unit=surface.unit at=surface.labels inputs "
        "constant parts products error_bound=bound sentences version"
    )
    schema, version = 1, study.__version__

    #: Identifier, also the stem of its files.
    name: str
    surface: FittedSurface
    #: Arguments: name, argument, low and high in the unit, unit, log.
    inputs: tuple[Mapping[str, object], ...]
    #: What is added to all sums, in the response's unit.
    constant: float
    #: Of an emulator, one a block: sums of weights times correlations (kernel, lengths) with points
    #: of the unit box.
    parts: tuple[Mapping[str, object], ...]
    #: Of a quadratic: coefficients times products of coded inputs, -1 to 1 over their ranges.
    products: tuple[Mapping[str, object], ...]
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
        within = f"{self.bound:.3g} {fit.unit}".strip()
        return (
            f"{what}, from {0 if fit.surface is None else fit.surface.runs.response.size} runs.",
            f"Ranges: {ranges}. Outside of them it raises ValueError: nothing was run there.",
            f"It is within {within} of the simulation at about 95 % of the settings: the largest "
            "half width of its intervals.",
        )

    @property
    def kind(self) -> str:
        """What the surface is."""
        return "emulator" if self.parts else "quadratic"


def surface_functions(
    study_name: str, every: Sequence[FittedSurface], response: str | None = None
) -> list[SurfaceFunction]:
    """Make a function of each surface, or of those of a response; no two have one name."""
    texts = [" ".join((study_name, fit.response, *fit.labels.values())) for fit in every]
    names = _identifiers(texts)
    return [
        _surface_function(names[text], fit)
        for text, fit in zip(texts, every, strict=True)
        if fit.surface is not None and response in (None, fit.response)
    ]


def _surface_function(name: str, fitted: FittedSurface) -> SurfaceFunction:
    if fitted.surface is None:
        raise ValueError(fitted.refused)
    model, runs = fitted.surface.model, fitted.surface.runs
    # last parts of dotted keys where these differ, else the whole keys
    last = [name.rpartition(".")[2] for name in runs.names]
    chosen = last if len(set(last)) == len(last) else runs.names
    identifiers = _identifiers(chosen)
    arguments = {name: identifiers[word] for name, word in zip(runs.names, chosen, strict=True)}
    inputs = tuple(
        {"name": f.name, "argument": arguments[f.name], "low": f.low, "high": f.high,
         "unit": fitted.units.get(f.name, ""), "log": f.log}
        for f in runs.factors
    )  # fmt: skip
    _, half = model.predict(box_points(len(inputs), ASKED))
    bound = float(np.max(half))
    if isinstance(model, QuadraticSurface):
        polynomial = model.polynomial
        products = tuple(
            {"inputs": list(t), "coefficient": float(c)}
            for t, c in zip(polynomial.terms, polynomial.coefficients, strict=True)
        )
        return SurfaceFunction(name, fitted, inputs, 0.0, (), products, bound)
    levels, parts = zip(*(_part(e, len(model.each)) for e in model.each), strict=True)
    return SurfaceFunction(name, fitted, inputs, sum(levels), parts, (), bound)


def _part(emulator: Emulator, blocks: int) -> tuple[float, dict[str, object]]:
    """Level and weights of a process, over the number of blocks."""
    process = emulator.process
    kernel = process.hyperparameters.kernel
    levels, weights = process.solved
    combination = emulator.combination or 0
    if kernel.categories is not None:
        weights = weights * kernel.categories.matrix[combination, kernel.combination(process.x)]
    scale = emulator.scale / blocks
    part: dict[str, object] = {
        "kernel": kernel.family,
        "lengths": kernel.lengths.tolist(),
        "points": kernel.numbers(process.x).tolist(),
        "weights": (scale * process.hyperparameters.variance * weights).tolist(),
    }
    return emulator.centre / blocks + scale * float(levels[combination]), part


def _identifiers(texts: Sequence[str]) -> dict[str, str]:
    """Name several texts by identifiers; those that would be alike are numbered."""
    plain = {text: re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "x" for text in texts}
    named = ((f"x_{name}" if name[0].isdigit() else name, text) for text, name in plain.items())
    return {
        text: f"{name}_{number}" if alike[1:] else name
        for name, alike in gathered(named).items()
        for number, text in enumerate(alike, 1)
    }
