"""Stress of a homogeneous test over time: finite viscoelasticity of Simo (1987).

What relaxes is the isochoric second Piola-Kirchhoff stress, taken to the reference configuration
without its volume change (Simo 1987, Comput. Methods Appl. Mech. Eng. 60, 153; Simo and Hughes
1998, ch. 10; the same as Abaqus' law for hyperelastic materials with ``*Viscoelastic``):

    Pi(s) = DEV_s [2 dW/dCbar],    H(t) = integral g(t - s) dPi(s),
    tau(t) = dev (Fbar H Fbar') + K J (J - 1) 1,

with W the instantaneous energy and g of :mod:`study.material.relaxation`. In a test without
shear all of them are diagonal. Between two rows of a test its stretch (or amount of shear) is
linear in time. Pi is interpolated quadratically in parts of these intervals and convolved
exactly with each exponential function, whether an interval lasts a thousandth or a thousand of
its times (:mod:`study.viscoelasticity.memory`).
Where K is finite the free stretch is solved from zero lateral stress at every node, by Newton's
method on the whole test at once. Gradients by all constants, shares and times are those of the
discrete equations, exact to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.material.homogeneous import CONFINED, Mode, response
from study.material.loading import LOADINGS, Loaded
from study.material.material import Material
from study.material.relaxation import share_name, time_name
from study.material.stress import deviator
from study.viscoelasticity.convolution import free_steps
from study.viscoelasticity.memory import Memory

_MOST_ITERATIONS = 40


def relaxing(material: Material, loading: str, time_s: Array, measure: Array) -> Loaded:
    """Nominal stress of a test whose course in time is known.

    Parameters
    ----------
    material : Material
        Hyperelastic, with its relaxation.
    loading : str
        One of :data:`study.material.loading.LOADINGS`.
    time_s : ndarray, shape (n,)
        Increasing. The specimen was unloaded and at rest before the first of them; if that one
        is loaded, its load came at once.
    measure : ndarray, shape (n,)
        Stretch, or amount of shear; linear in between.

    Returns
    -------
    Loaded
        With derivatives by every constant of the energy, and by ``share1``, ``time1``, ...

    Raises
    ------
    InputError
        If times do not increase, a stretch is not positive, or the energy is not hyperelastic.
    """
    time, values = np.asarray(time_s, float), np.asarray(measure, float)
    _check(material, loading, time, values)
    if loading == "volumetric" or not material.relaxation:  # K does not relax
        elastic = LOADINGS[loading].nominal(material, values)
        zero = dict.fromkeys(_relaxation_names(material), np.zeros_like(values))
        return Loaded(elastic.stress, {**elastic.gradient, **zero})
    mode = LOADINGS[loading].mode
    with np.errstate(all="ignore"):  # constants of a fit may overflow: NaN says so
        if mode is None:
            return _sheared(material, Memory.of(material, time, values, is_shear=True))
        creeps = mode is not CONFINED and not material.incompressible
        return _stretched(material, mode, Memory.of(material, time, values, creeps=creeps))


def _relaxation_names(material: Material) -> list[str]:
    numbers = range(1, len(material.relaxation) + 1)
    return [name for number in numbers for name in (share_name(number), time_name(number))]


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
    longest = 0.5 * (np.abs(shear) + np.sqrt(shear**2 + 4))
    bar = np.stack([longest, np.ones_like(longest), 1 / longest])

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
class _State:
    """Stresses of a test along principal directions, all at every node.

    Parameters
    ----------
    bar : ndarray, shape (3, nodes)
        Isochoric stretches.
    J : ndarray, shape (nodes,)
        Volume ratio.
    values : ndarray, shape (3, nodes)
        Pi, MPa.
    memories : ndarray, shape (terms, 3, nodes)
        Of Pi.
    left : ndarray, shape (3, nodes)
        bar^2 H, MPa.
    """

    bar: Array
    J: Array
    values: Array
    memories: Array
    left: Array

    @classmethod
    def at(cls, memory: Memory, mode: Mode, z: Array) -> _State:
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
    """Zero stress of the free side, linearized: a march over the test solves it.

    Parameters
    ----------
    memory : Memory
        The test.
    pull, rate : ndarray, shape (3, nodes)
        See :func:`study.viscoelasticity.convolution.free_steps`.
    own, residual : ndarray, shape (nodes,)
        As there.
    side : ndarray, shape (3,)
        Weights of the Kirchhoff stresses in the deviatoric one of the free side.
    """

    memory: Memory
    pull: Array
    rate: Array
    own: Array
    residual: Array
    side: Array

    @classmethod
    def at(cls, memory: Memory, mode: Mode, state: _State) -> _Condition:
        """Linearize at a state."""
        material, v = memory.material, np.array(mode.free, float)
        turn = deviator(v)
        slope = deviator(
            material.isochoric.principal_stress_slope(material.constants, state.bar, turn)
        )
        rate = slope / state.bar**2 - 2 * turn[:, None] * state.values
        side = np.eye(3)[mode.free_axis] - 1 / 3
        J, bulk = state.J, material.bulk
        own = 2 * (side * turn) @ state.left + bulk * (2 * J - 1) * J * v.sum()
        residual = side @ state.left + bulk * J * (J - 1)
        return cls(memory, side[:, None] * state.bar**2, rate, own, residual, side)

    def steps(self, residual: Array | None = None) -> Array:
        """Find the free logarithmic stretch's changes that make a residual (or its own) zero."""
        memory = self.memory
        return np.asarray(
            free_steps(
                memory.decay, memory.weight, memory.shares, memory.stays, self.pull,
                np.ascontiguousarray(self.rate), self.own,
                np.ascontiguousarray(self.residual if residual is None else residual),
            )
        )  # fmt: skip


def _stretched(material: Material, mode: Mode, memory: Memory) -> Loaded:
    """Stress where principal directions stay: uniaxial, equibiaxial, planar, confined."""
    z, is_free = _free(material, mode, memory)
    state = _State.at(memory, mode, z)
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
            slope = slope + _by_free_side(state, mode, condition, residual, taken)
        gradient[name] = (slope / stretch)[memory.rows]
    return Loaded((total / stretch)[memory.rows], gradient)


def _by_free_side(
    state: _State, mode: Mode, condition: _Condition, residual: Array, taken: Array
) -> Array:
    """Change of the stress as the free side gives way to a change of its condition."""
    dz = condition.steps(residual)
    turn = deviator(np.array(mode.free, float))
    moved = state.bar**2 * condition.memory.convolved(condition.rate * dz)
    return np.asarray(taken @ (moved + 2 * turn[:, None] * state.left * dz))


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
        step = _Condition.at(memory, mode, _State.at(memory, mode, z)).steps()
        z = z + step
        moved = float(np.nanmax(np.abs(step), initial=0.0))
        # rounding of the stress leaves the last digits of z moving to and fro
        if moved <= 1e-15 or last <= moved < 1e-11:
            return z, True
        last = moved
    return np.where(np.abs(step) < 1e-9, z, np.nan), True
