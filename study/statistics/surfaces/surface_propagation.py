"""What uncertain inputs do to a response, through its surface (Saltelli et al. 2008; GUM S1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from study.ground.arrays import Array
from study.ground.errors import Fault, RefusedError
from study.statistics.surfaces.emulator import (
    GIVEN,
    NO_INDEX,
    RANKED,
    SAMPLE_ERROR,
    BlockedEmulator,
    Emulator,
    SobolIndex,
    jansen,
    sobol_indices,
)
from study.statistics.surfaces.input_distribution import InputDistribution
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_factors import Runs
from study.statistics.surfaces.surface_result import SurfaceAnalysis

#: points of the sample, as a power of two: 8,192
SAMPLE = 13
#: what is told of a distribution, in percent
PERCENTILES = np.array([2.5, 5.0, 25.0, 50.0, 75.0, 95.0, 97.5])
#: points at which the surface's own uncertainty is asked: 2,048
OWN_SAMPLE = 11

Model = QuadraticSurface | Emulator | BlockedEmulator


@dataclass(frozen=True)
class Told:
    """A number of the response's distribution, and what the surface may err in it."""

    value: float
    #: Half width of an interval of about 95 % for the surface's own error, in that unit.
    own: float


@dataclass(frozen=True)
class InputShare:
    """What one uncertain input does."""

    name: str
    #: Its share of the response's variance; None below a Q2 of .9.
    index: SobolIndex | None
    #: Standard deviation of the response if this input were known twice as well.
    halved: float


@dataclass(frozen=True)
class Propagated:
    """Distribution of a response whose inputs are uncertain."""

    mean: Told
    sd: Told
    percentiles: Mapping[float, Told]
    #: The one that is worth measuring most first.
    inputs: tuple[InputShare, ...]
    #: Settings of the factors that are not uncertain.
    fixed: Mapping[str, float]
    #: Probability of each input that lies outside its range, and was cut off.
    cut: Mapping[str, float]

    def gain(self, one: InputShare) -> float:
        """Share of the standard deviation that knowing an input twice as well would take away."""
        return 1.0 - one.halved / self.sd.value if self.sd.value > 0 else 0.0

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        told = {f"{percent:g}": vars(one) for percent, one in self.percentiles.items()}
        rows = [
            {
                "input": one.name,
                **(NO_INDEX if one.index is None else one.index.to_json()),
                "sd_if_halved": one.halved,
                "gain": self.gain(one),
            }
            for one in self.inputs
        ]
        return {
            "mean": vars(self.mean),
            "sd": vars(self.sd),
            "percentiles": told,
            "inputs": rows,
            "fixed": dict(self.fixed),
            "cut": dict(self.cut),
        }


def propagate(
    found: SurfaceAnalysis,
    inputs: Mapping[str, InputDistribution],
    fixed: Mapping[str, float],
    seed: int = 0,
) -> Propagated:
    """Carry the distributions of inputs through a surface."""
    from scipy.stats import qmc

    model = found.model
    q2 = model.q2
    if not q2 >= RANKED:
        rule = f"Q2 is {q2:.2f}, below {RANKED}: nothing is said of uncertain inputs"
        raise RefusedError(str(Fault("uncertainty", rule, "add runs")))
    own = _Inputs(found.runs, dict(inputs), dict(fixed))
    u = qmc.Sobol(len(inputs), seed=seed).random_base2(SAMPLE)
    values = model.value(own.coded(u))
    told, errors = _numbers(values[:, None])[:, 0], _own(model, own, seed)
    each = [Told(float(v), float(e)) for v, e in zip(told, errors, strict=True)]
    shares: Sequence[SobolIndex | None] = [None] * len(inputs)
    if q2 >= GIVEN:
        shares = _shares(model, own, q2, seed)
    rows = [
        InputShare(name, share, float(model.value(own.halved(name).coded(u)).std()))
        for name, share in zip(inputs, shares, strict=True)
    ]
    return Propagated(
        each[0],
        each[1],
        dict(zip(PERCENTILES.tolist(), each[2:], strict=True)),
        tuple(sorted(rows, key=lambda one: one.halved)),
        dict(fixed),
        {name: spread.outside for name, spread in inputs.items()},
    )


@dataclass(frozen=True)
class _Inputs:
    """Uncertain and fixed inputs of a surface."""

    runs: Runs
    spreads: Mapping[str, InputDistribution]
    fixed: Mapping[str, float]

    def coded(self, shares: Array) -> Array:
        """Coded points (m, k) of shares (m, inputs) of the distributions."""
        columns = dict(zip(self.spreads, shares.T, strict=True))
        made = [
            f.coded(self.spreads[f.name].quantile(columns[f.name]))
            if f.name in columns
            else np.full(len(shares), float(f.coded(np.array([self.fixed[f.name]]))[0]))
            for f in self.runs.factors
        ]
        return np.column_stack(made)

    def unit(self, shares: Array) -> Array:
        """Give the same in the unit box."""
        return 0.5 * (self.coded(shares) + 1.0)

    def halved(self, name: str) -> _Inputs:
        """Give the same with one of them known twice as well."""
        spreads = {n: s.halved() if n == name else s for n, s in self.spreads.items()}
        return _Inputs(self.runs, spreads, self.fixed)


def _numbers(values: Array) -> Array:
    """Mean, standard deviation and percentiles, shape (2 + percentiles, p), of values (n, p)."""
    middle = np.percentile(values, PERCENTILES, axis=0)
    return np.vstack([values.mean(axis=0), values.std(axis=0), middle])


def _own(model: Model, inputs: _Inputs, seed: int) -> Array:
    """Half widths for the surface's own error, shape (2 + percentiles,), in the response's unit."""
    from scipy.stats import qmc

    # Left-out runs are missed by that much on average: a number that belongs to one place of the
    # distribution may be, too. The mean and the spread average over places.
    if isinstance(model, QuadraticSurface):
        rms = 0.0 if model.loo is None else model.loo.rms
        return np.full(2 + PERCENTILES.size, 2.0 * rms)
    u = qmc.Sobol(len(inputs.spreads), seed=seed + 1).random_base2(OWN_SAMPLE)
    if isinstance(model, BlockedEmulator):
        told = np.column_stack([_numbers(e.value(inputs.coded(u))[:, None]) for e in model.each])
        blocks = told.shape[1]
        t = float(stdtrit(blocks - 1, 0.975))
        scatter = t * told.std(axis=1, ddof=1) / np.sqrt(blocks)
        return np.asarray(scatter + np.mean([_own(e, inputs, seed) for e in model.each], axis=0))
    paths = model.scale * model.paths(seed)(inputs.unit(u))
    told = _numbers(paths)
    scatter = np.sqrt(np.mean((told[:, 1:] - told[:, :1]) ** 2, axis=1))
    least = np.full(scatter.shape, model.loo_rms)
    least[:2] /= np.sqrt(model.runs.response.size)
    return np.asarray(1.96 * np.maximum(model.widening * scatter, least))


def _shares(model: Model, inputs: _Inputs, q2: float, seed: int) -> Sequence[SobolIndex]:
    """Sobol indices of the uncertain inputs."""
    k = len(inputs.spreads)
    if isinstance(model, Emulator):
        paths = model.paths(seed)
        return sobol_indices(lambda u: paths(inputs.unit(u)), k, q2, seed)
    # without paths the ends of an interval are the estimate's own, but for what Q2 leaves open
    indices = jansen(lambda u: model.value(inputs.coded(u))[:, None], k, seed)
    margin = 1.0 - q2 + SAMPLE_ERROR
    return [
        SobolIndex.of(s[0], np.repeat(np.clip(s, 0, 1), 2), t[0], np.repeat(np.clip(t, 0, 1), 2),
                      margin)
        for s, t in zip(*indices, strict=True)
    ]  # fmt: skip
