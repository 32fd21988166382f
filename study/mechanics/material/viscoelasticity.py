"""Compiled recursions over the time of a test: fading memories, and the free stretch with them.

Times come in intervals of three nodes, begin, middle and end; node 0 begins the first of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.ground.arrays import Array
from study.ground.compilation import kernel
from study.ground.errors import Fault, InputError
from study.mechanics.material.homogeneous import (
    CONFINED,
    LOADINGS,
    Loaded,
    Mode,
    deviator,
    response,
    sheared_stretches,
)
from study.mechanics.material.material import Material
from study.mechanics.material.relaxation import long_term_share, relaxation_names, shares, times


@kernel()
def accumulated(decay: Array, source: Array, first: Array) -> Array:
    """Sum up memories: m_j = decay_j m_begin + source_j.

    Shapes: decay (terms, intervals, 2); source (terms, parts, intervals, 2); first (terms, parts);
    returns (terms, parts, 2 intervals + 1).
    """
    terms, parts, intervals, _ = source.shape
    out = np.empty((terms, parts, 2 * intervals + 1))
    for term in range(terms):
        for part in range(parts):
            before = first[term, part]
            out[term, part, 0] = before
            for n in range(intervals):
                middle = decay[term, n, 0] * before + source[term, part, n, 0]
                before = decay[term, n, 1] * before + source[term, part, n, 1]
                out[term, part, 2 * n + 1] = middle
                out[term, part, 2 * n + 2] = before
    return out


@kernel()
def free_steps(
    decay: Array, weight: Array, share: Array, stays: float,
    pull: Array, rate: Array, free: Array, residual: Array,
) -> Array:  # fmt: skip
    """Solve the linearized condition of a stress-free side at every node, memories included.

    Shapes: decay (terms, intervals, 2); weight (terms, intervals, 2, 3); share (terms,); pull (3,
    nodes); rate (3, nodes); own (nodes,); residual (nodes,); returns (nodes,).
    """
    terms, intervals, _ = decay.shape
    step = np.empty(2 * intervals + 1)
    total = free[0]
    for k in range(3):
        total += pull[k, 0] * rate[k, 0]
    step[0] = -residual[0] / total
    memory = np.empty((terms, 3))
    for term in range(terms):
        for k in range(3):
            memory[term, k] = rate[k, 0] * step[0]
    left = np.empty((2, 2))
    right = np.empty(2)
    for n in range(intervals):
        begin = 2 * n
        for j in range(2):
            node = begin + 1 + j
            right[j] = -residual[node]
            left[j, 0] = 0.0
            left[j, 1] = 0.0
            left[j, j] = free[node]
            for k in range(3):
                left[j, j] += pull[k, node] * stays * rate[k, node]
                for term in range(terms):
                    w = pull[k, node] * share[term]
                    carried = decay[term, n, j] * memory[term, k]
                    carried += weight[term, n, j, 0] * rate[k, begin] * step[begin]
                    right[j] -= w * carried
                    left[j, 0] += w * weight[term, n, j, 1] * rate[k, begin + 1]
                    left[j, 1] += w * weight[term, n, j, 2] * rate[k, begin + 2]
        determinant = left[0, 0] * left[1, 1] - left[0, 1] * left[1, 0]
        step[begin + 1] = (right[0] * left[1, 1] - right[1] * left[0, 1]) / determinant
        step[begin + 2] = (right[1] * left[0, 0] - right[0] * left[1, 0]) / determinant
        for term in range(terms):
            for k in range(3):
                added = 0.0
                for i in range(3):
                    node = begin + i
                    added += weight[term, n, 1, i] * rate[k, node] * step[node]
                memory[term, k] = decay[term, n, 1] * memory[term, k] + added
    return step


# Memory of a homogeneous test: stresses interpolated quadratically in parts and convolved exactly
# with each exponential function (cf. Taylor, Pister and Goudreau 1970, Int. J. Numer. Methods
# Eng. 2, 45, with straight lines).

#: largest change of the logarithm of a stretch, or of an amount of shear, within a part
LARGEST_STEP = 0.02
#: first part of an interval over the shortest time, where a free side creeps, and their growth
_FIRST_PART = 0.1
_GROWTH = 1.25
#: argument below which the functions of the exponential are summed as power series
_SMALL = 1.0
_POWERS = 22


@dataclass(frozen=True)
class Memory:
    """A test in parts that are short enough, three nodes to each, and the memory of each term."""

    material: Material
    #: shape (intervals,); duration of every part.
    length_s: Array
    #: shape (2 intervals + 1,); at the nodes.
    measure: Array
    #: shape (n,); nodes that are rows of the test.
    rows: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        material: Material,
        time: Array,
        measure: Array,
        *,
        is_shear: bool = False,
        creeps: bool = False,
    ) -> Memory:
        """Divide the intervals between rows."""
        moved = np.abs(np.diff(measure if is_shear else np.log(measure)))
        count = np.maximum(np.ceil(moved / LARGEST_STEP), 1).astype(int)
        whole = np.diff(time)
        parts = [np.linspace(0.0, 1.0, k + 1)[1:] for k in count]
        if creeps:
            first = _FIRST_PART * float(times(material.relaxation).min())
            parts = [
                np.union1d(even, _growing(first / span))
                for even, span in zip(parts, whole, strict=True)
            ]
        sizes = np.array([part.size for part in parts], int)
        ends = np.concatenate([np.zeros(1), *(n + p for n, p in enumerate(parts))])
        nodes = np.empty(2 * ends.size - 1)
        nodes[::2], nodes[1::2] = ends, 0.5 * (ends[1:] + ends[:-1])
        length = np.repeat(whole, sizes) * np.diff(ends)
        rows = 2 * np.concatenate([np.zeros(1, int), np.cumsum(sizes)]).astype(np.int64)
        return cls(material, length, np.interp(nodes, np.arange(time.size), measure), rows)

    @cached_property
    def shares(self) -> Array:
        """Shape (terms,)."""
        return shares(self.material.relaxation)

    @cached_property
    def reduced(self) -> Array:
        """Duration of every part over the time of every term, shape (terms, intervals)."""
        return np.asarray(self.length_s / times(self.material.relaxation)[:, None])

    @cached_property
    def decay(self) -> Array:
        """Shape (terms, intervals, 2), at the middle and the end."""
        return np.asarray(np.exp(-self.reduced[..., None] * np.array([0.5, 1.0])))

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """Weights, and their derivatives by the reduced duration, (terms, intervals, 2, 3)."""
        return _weights(self.reduced)

    def memories(self, values: Array) -> Array:
        """Every term's memory of stresses, (parts, nodes) to (terms, parts, nodes)."""
        source = np.einsum("tnjk,pnk->tpnj", self.weights[0], _by_interval(values))
        first = np.broadcast_to(values[:, 0], (self.shares.size, values.shape[0]))
        return np.asarray(accumulated(self.decay, source, np.ascontiguousarray(first)))

    def convolved(self, values: Array, memories: Array | None = None) -> Array:
        """Stress that is left of values, shape (parts, nodes)."""
        carried = self.memories(values) if memories is None else memories
        return np.asarray(
            long_term_share(self.material.relaxation) * values
            + np.einsum("t,tpn->pn", self.shares, carried)
        )

    def memory_rate(self, term: int, values: Array, memory: Array) -> Array:
        """Differentiate one memory (parts, nodes) by its time, MPa/s."""
        x, time = self.reduced[term], self.material.relaxation[term].time_s
        by_x = np.einsum("njk,pnk->pnj", self.weights[1][term], _by_interval(values))
        by_x -= (np.array([0.5, 1.0]) * self.decay[term]) * memory[:, :-1:2, None]
        source = (-x / time)[:, None] * by_x
        first = np.zeros((1, values.shape[0]))
        return np.asarray(accumulated(self.decay[term : term + 1], source[None], first)[0])

    def by_relaxation(self, values: Array, memories: Array) -> dict[str, Array]:
        """Differentiate what is left of values by every share and time, (parts, nodes) each."""
        by_term = {}
        for k, term in enumerate(self.material.relaxation):
            by_term[f"share{k + 1}"] = memories[k] - values
            by_term[f"time{k + 1}"] = term.share * self.memory_rate(k, values, memories[k])
        return by_term


def _growing(first: float) -> Array:
    """Shares of an interval that begin with ``first`` and grow, the last one being 1."""
    if first >= 1:
        return np.ones(1)
    count = math.ceil(math.log1p((_GROWTH - 1) / first) / math.log(_GROWTH))
    ends = first * (_GROWTH ** np.arange(1, count + 1) - 1) / (_GROWTH - 1)
    return np.append(ends[ends < 1 - 1e-9], 1.0)


def _by_interval(values: Array) -> Array:
    """Values (parts, nodes) at the three nodes of every interval, (parts, intervals, 3)."""
    return np.stack([values[:, :-1:2], values[:, 1::2], values[:, 2::2]], axis=-1)


def _weights(x: Array) -> tuple[Array, Array]:
    """Integrals of exp(-(c - s) x) L_k'(s) from 0 to c, for c = 1/2 and 1, and their slopes by x.

    ``L_k`` are Lagrange's polynomials of the nodes 0, 1/2 and 1, with the derivatives 4 s - 3,
    4 - 8 s and 4 s - 1. Shapes (..., 2, 3).
    """
    c = np.array([0.5, 1.0])
    first, second, first_rate, second_rate = _exponential_functions(x[..., None] * c)
    slope, at_zero = np.array([4.0, -8.0, 4.0]), np.array([-3.0, 4.0, -1.0])

    def joined(block: Array, s: Array) -> Array:
        return np.asarray(block[..., None] * at_zero + s[..., None] * slope)

    return joined(c * first, c**2 * second), joined(c**2 * first_rate, c**3 * second_rate)


def _exponential_functions(y: Array) -> tuple[Array, Array, Array, Array]:
    """(1 - e^-y) / y and (y - 1 + e^-y) / y^2, and their derivatives."""
    near = y < _SMALL
    far = np.where(near, 1.0, y)
    first = -np.expm1(-far) / far
    second = (1 - first) / far
    first_rate = (np.exp(-far) - first) / far
    second_rate = -(first_rate + second) / far
    small, powers = np.where(near, y, 0.0)[..., None], np.arange(_POWERS)
    factorial = np.array([math.factorial(k) for k in range(_POWERS + 4)], float)
    terms = (-small) ** powers
    series = (
        (terms / factorial[1 : _POWERS + 1]).sum(-1),
        (terms / factorial[2 : _POWERS + 2]).sum(-1),
        -(terms * (powers + 1) / factorial[2 : _POWERS + 2]).sum(-1),
        -(terms * (powers + 1) / factorial[3 : _POWERS + 3]).sum(-1),
    )
    apart = (first, second, first_rate, second_rate)
    a, b, c, d = (np.where(near, s, f) for s, f in zip(series, apart, strict=True))
    return a, b, c, d


# Stress of a homogeneous test over time: finite viscoelasticity of Simo (1987).
# What relaxes is the isochoric second Piola-Kirchhoff stress, taken to the reference configuration
# without its volume change (Simo 1987, Comput. Methods Appl. Mech. Eng. 60, 153; Simo and Hughes
# 1998, ch. 10; the same as Abaqus' law for hyperelastic materials with ``*Viscoelastic``):
#     Pi(s) = DEV_s [2 dW/dCbar],    H(t) = integral g(t - s) dPi(s),
#     tau(t) = dev (Fbar H Fbar') + K J (J - 1) 1,
# with W the instantaneous energy and g of ``relaxation``. In a test without
# shear all of them are diagonal. Between two rows of a test its stretch (or amount of shear) is
# linear in time. Pi is interpolated quadratically in parts of these intervals and convolved
# exactly with each exponential function, whether an interval lasts a thousandth or a thousand of
# its times (:mod:`study.mechanics.material.viscoelasticity`).
# Where K is finite the free stretch is solved from zero lateral stress at every node, by Newton's
# method on the whole test at once. Gradients by all constants, shares and times are those of the
# discrete equations, exact to rounding.

_MOST_ITERATIONS = 40


def relaxing(material: Material, loading: str, time_s: Array, measure: Array) -> Loaded:
    """Nominal stress of a test whose course in time is known. Shapes: time_s (n,); measure (n,)."""
    time, values = np.asarray(time_s, float), np.asarray(measure, float)
    _check(material, loading, time, values)
    if loading == "volumetric" or not material.relaxation:  # K does not relax
        elastic = LOADINGS[loading].nominal(material, values)
        zero = dict.fromkeys(relaxation_names(material.relaxation), np.zeros_like(values))
        return Loaded(elastic.stress, {**elastic.gradient, **zero})
    mode = LOADINGS[loading].mode
    with np.errstate(all="ignore"):  # constants of a fit may overflow: NaN says so
        if mode is None:
            return _sheared(material, Memory.of(material, time, values, is_shear=True))
        creeps = mode is not CONFINED and not material.incompressible
        return _stretched(material, mode, Memory.of(material, time, values, creeps=creeps))


def _check(material: Material, loading: str, time: Array, measure: Array) -> None:
    if material.small_strain or material.compressible is not None:
        rule = f"relaxation is one of an isochoric energy, which {material.model} is not"
        mend = 'write model = "neo-hookean", or another energy with an isochoric part'
        raise InputError(Fault("material.relaxation", rule, mend))
    if time.shape != measure.shape or time.ndim != 1 or not time.size:
        raise InputError(f"{time.size} times do not belong to {measure.size} deformations")
    if not (np.isfinite(time).all() and np.isfinite(measure).all()):
        raise InputError("times and deformations must be finite")
    if (np.diff(time) <= 0).any():
        raise InputError("times must increase from row to row")
    if not LOADINGS[loading].is_shear and not (measure > 0).all():
        raise InputError(f"stretches must be positive, got {measure.min():g}")
    if loading == "confined" and material.incompressible:
        raise InputError("an incompressible material cannot be compressed in a rigid box")


def _sheared(material: Material, memory: Memory) -> Loaded:
    """Stress in simple shear, P_12 = H_12 + shear H_22, where the volume is kept."""
    shear = memory.measure
    longest, *_ = bar = np.stack(sheared_stretches(shear))

    def pulled_back(principal: Array) -> Array:
        """Components 12 and 22 of the second Piola-Kirchhoff stress, shape (2, nodes)."""
        largest, _, least = deviator(principal)
        share = 1 / (1 + longest**2)  # of the longest line along the second axis, squared
        tau22 = share * largest + (1 - share) * least
        tau12 = np.sign(shear) * (largest - least) / (longest + 1 / longest)
        return np.stack([tau12 - shear * tau22, tau22])

    def nominal(left: Array) -> Array:
        return np.asarray((left[0] + shear * left[1])[memory.rows])

    energy, constants = material.isochoric, material.constants
    values = pulled_back(energy.principal_stress(constants, bar))
    memories = memory.memories(values)
    partial = energy.principal_stress_gradient(constants, bar)
    gradient = {n: nominal(memory.convolved(pulled_back(g))) for n, g in partial.items()}
    for name, slope in memory.by_relaxation(values, memories).items():
        gradient[name] = nominal(slope)
    return Loaded(nominal(memory.convolved(values, memories)), gradient)


@dataclass(frozen=True)
class _MemoryState:
    """Stresses of a test along principal directions, all at every node."""

    #: shape (3, nodes); isochoric stretches.
    bar: Array
    #: shape (nodes,); volume ratio.
    J: Array
    #: shape (3, nodes); pi, MPa.
    values: Array
    #: shape (terms, 3, nodes); of Pi.
    memories: Array
    #: shape (3, nodes); bar^2 H, MPa.
    left: Array

    @classmethod
    def at(cls, memory: Memory, mode: Mode, z: Array) -> _MemoryState:
        """State where the logarithm of the free stretch is z."""
        material = memory.material
        a, v = np.array(mode.loaded, float), np.array(mode.free, float)
        log = a[:, None] * np.log(memory.measure) + v[:, None] * z
        bar = np.exp(deviator(log))
        kirchhoff = deviator(material.isochoric.principal_stress(material.constants, bar))
        values = kirchhoff / bar**2
        memories = memory.memories(values)
        left = bar**2 * memory.convolved(values, memories)
        return cls(bar, np.exp(log.sum(0)), values, memories, left)


@dataclass(frozen=True)
class _Condition:
    """Zero stress of the free side, linearized: a march over the test solves it."""

    memory: Memory
    #: shape (3, nodes); see :func:`study.mechanics.material.viscoelasticity.free_steps`.
    pull: Array
    rate: Array
    #: shape (nodes,); as there.
    relaxed: Array
    residual: Array

    @classmethod
    def at(cls, memory: Memory, mode: Mode, state: _MemoryState) -> _Condition:
        """Linearize at a state."""
        material, v = memory.material, np.array(mode.free, float)
        turn = deviator(v)
        slope = deviator(
            material.isochoric.principal_stress_slope(material.constants, state.bar, turn)
        )
        rate = slope / state.bar**2 - 2 * turn[:, None] * state.values
        side = np.eye(3)[mode.free_axis] - 1 / 3
        J, bulk = state.J, material.bulk
        second_piola = 2 * (side * turn) @ state.left + bulk * (2 * J - 1) * J * v.sum()
        residual = side @ state.left + bulk * J * (J - 1)
        return cls(memory, side[:, None] * state.bar**2, rate, second_piola, residual)

    def steps(self, residual: Array | None = None) -> Array:
        """Find the free logarithmic stretch's changes that make a residual (or its own) zero."""
        memory = self.memory
        return np.asarray(
            free_steps(
                memory.decay, memory.weights[0], memory.shares,
                long_term_share(memory.material.relaxation), self.pull,
                np.ascontiguousarray(self.rate), self.relaxed,
                np.ascontiguousarray(self.residual if residual is None else residual),
            )
        )  # fmt: skip


def _stretched(material: Material, mode: Mode, memory: Memory) -> Loaded:
    """Stress where principal directions stay: uniaxial, equibiaxial, planar, confined."""
    z, is_free = _free(material, mode, memory)
    state = _MemoryState.at(memory, mode, z)
    stretch = memory.measure
    # of a stress-free side, or in a rigid box of the mean with the pressure
    taken = np.eye(3)[0] - (1 / 3 if mode is CONFINED else np.eye(3)[mode.free_axis])
    total = taken @ state.left
    volume = state.J * (state.J - 1)
    if mode is CONFINED:
        total = total + material.bulk * volume
    partial = material.isochoric.principal_stress_gradient(material.constants, state.bar)
    changes = {n: memory.convolved(deviator(g) / state.bar**2) for n, g in partial.items()}
    changes |= memory.by_relaxation(state.values, state.memories)
    bulk = {**dict.fromkeys(changes, 0.0), **material.bulk_gradient()}
    condition = _Condition.at(memory, mode, state) if is_free else None
    gradient = {}
    for name, change in changes.items():
        slope = taken @ (state.bar**2 * change)
        if mode is CONFINED:
            slope = slope + bulk[name] * volume
        if condition is not None:
            residual = (condition.pull * change).sum(0) + bulk[name] * volume
            dz = condition.steps(residual)
            turn = deviator(np.array(mode.free, float))
            moved = state.bar**2 * condition.memory.convolved(condition.rate * dz)
            slope = slope + np.asarray(taken @ (moved + 2 * turn[:, None] * state.left * dz))
        gradient[name] = (slope / stretch)[memory.rows]
    return Loaded((total / stretch)[memory.rows], gradient)


def _free(material: Material, mode: Mode, memory: Memory) -> tuple[Array, bool]:
    """Logarithm of the free stretch at every node, and whether it had to be solved."""
    x = np.log(memory.measure)
    if mode is CONFINED:
        return np.zeros_like(x), False
    if material.incompressible:
        return -x * sum(mode.loaded) / sum(mode.free), False
    z = np.log(response(material, mode, memory.measure).free_stretch)
    last = math.inf
    for _ in range(_MOST_ITERATIONS):
        step = _Condition.at(memory, mode, _MemoryState.at(memory, mode, z)).steps()
        z = z + step
        moved = float(np.nanmax(np.abs(step), initial=0.0))
        # rounding of the stress leaves the last digits of z moving to and fro
        if moved <= 1e-15 or last <= moved < 1e-11:
            return z, True
        last = moved
    return np.where(np.abs(step) < 1e-9, z, np.nan), True
