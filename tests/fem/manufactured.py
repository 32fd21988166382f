"""Manufactured solutions of nearly incompressible solids (V13): J = 1 exactly, p as wanted.

The fields of the verification table for the plane do not exist here; these are its
axisymmetric one, the same after a barreling that keeps the volume too, and a
three-dimensional one composed of shears.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from study.mechanics.material.homogeneous import first_piola
from study.mechanics.material.material import Material
from tests.fem.known import interpolated, load_vector, measure, pressures, solve

_STEP = 1e-3


@dataclass(frozen=True)
class Manufactured:
    """x(X) with det F = 1 and a pressure; loads follow from the material.

    Without being ``pressed`` p = 0 = K (J - 1): all that the displacement formulation can
    represent. With ``barrel``, axisymmetric alone, first r = R / sqrt(phi'), z = phi(Z) with
    phi' = 1 + barrel cos(2 pi Z). ``amplitude`` is over the unit size of the body.
    """

    axisymmetric: bool
    amplitude: float
    material: Material
    pressed: bool = True
    barrel: float = 0.0

    @cached_property
    def _incompressible(self):
        """Material whose stress has no pressure: what J = 1 leaves."""
        return Material(self.material.model, self.material.constants, incompressible=True)

    @property
    def dim(self):
        return 2 if self.axisymmetric else 3

    def displacement(self, x):
        a = self.amplitude
        if self.axisymmetric:
            r = x[0] * self.hoop(x)
            shift = self.barrel * np.sin(2 * np.pi * x[1]) / (2 * np.pi)
            return np.stack([r - x[0], shift + a * np.cos(np.pi * r / 2) ** 2])
        first = x[0] + a * np.sin(np.pi * x[1])
        second = x[1] + 0.8 * a * np.sin(np.pi * x[2])
        third = x[2] + 0.5 * a * np.sin(np.pi * first)
        return np.stack([first - x[0], second - x[1], third - x[2]])

    def hoop(self, x):
        """Hoop stretch of the axisymmetric field, r / R."""
        return (1 + self.barrel * np.cos(2 * np.pi * x[1])) ** -0.5

    def pressure(self, x):
        if not self.pressed:
            return 0 * x[0]
        p = np.cos(np.pi * x[0] / 2) * np.sin(np.pi * x[1]) + 0.3
        return p if self.axisymmetric else p * np.cos(np.pi * x[2] / 3)

    def gradient(self, x):
        """du_i/dX_j, shape (dim, dim, ...), in closed form."""
        a, pi = self.amplitude, np.pi
        zero = 0 * x[0]
        if self.axisymmetric:
            hoop = self.hoop(x)
            bulge = x[0] * self.barrel * pi * np.sin(2 * pi * x[1]) * hoop**3
            slope = -a * pi / 2 * np.sin(pi * x[0] * hoop)
            return np.stack([
                np.stack([hoop - 1, bulge]),
                np.stack([slope * hoop, hoop**-2 - 1 + slope * bulge]),
            ])  # fmt: skip
        shear = a * pi * np.cos(pi * x[1])
        third = 0.5 * a * pi * np.cos(pi * (x[0] + a * np.sin(pi * x[1])))
        return np.stack([
            np.stack([zero, shear, zero]),
            np.stack([zero, zero, 0.8 * a * pi * np.cos(pi * x[2])]),
            np.stack([third, third * shear, zero]),
        ])  # fmt: skip

    def _nominal(self, x):
        """Nominal stress with the hoop component, shape (3, 3, ...)."""
        F = np.zeros((3, 3, *x.shape[1:]))
        F[: self.dim, : self.dim] = self.gradient(x)
        for i in range(3):
            F[i, i] += 1.0
        if self.axisymmetric:  # components (r, z, theta)
            F[2, 2] = self.hoop(x)
        inverse = np.moveaxis(np.linalg.inv(np.moveaxis(F, (0, 1), (-2, -1))), (-2, -1), (0, 1))
        cofactor = np.swapaxes(inverse, 0, 1)  # J = 1
        stress = first_piola(self._incompressible, F)
        return stress + self.pressure(x) * cofactor

    def body_force(self, x):
        """-Div P by differences of fourth order (rounding and truncation below 1e-9)."""
        out = np.zeros_like(x)
        for j in range(self.dim):
            step = np.zeros((self.dim, *(1 for _ in x.shape[1:])))
            step[j] = _STEP
            one = self._nominal(x + step) - self._nominal(x - step)
            two = self._nominal(x + 2 * step) - self._nominal(x - 2 * step)
            out -= ((8 * one - two) / (12 * _STEP))[: self.dim, j]
        if self.axisymmetric:
            P = self._nominal(x)
            out[0] -= (P[0, 0] - P[2, 2]) / x[0]
            out[1] -= P[1, 0] / x[0]
        return out

    def traction(self, x):
        """P N on the upper face."""
        return self._nominal(x)[: self.dim, self.dim - 1]

    def solve(self, made, *, steps=2):
        """Displacements are held everywhere but on the upper face, which is pulled."""
        top = self.dim - 1
        held, values = [], []
        for axis in range(self.dim):
            chosen = made.dofs_where(self._held, axis)
            held.append(chosen)
            values.append(self.displacement(made.nodes[chosen // self.dim].T)[axis])
        if self.axisymmetric:  # on the axis only the radius is known
            axis_dofs = made.dofs_where(lambda X: X[:, 0] < 1e-12, 0)
            held.append(axis_dofs)
            values.append(np.zeros(axis_dofs.size))
        source = None
        if made.space.pressure_shape.shape[2]:

            def source(x):
                return -self.pressure(x) / self.material.bulk

        load = load_vector(
            made, self.body_force, source, self.traction, lambda x: x[top] > 1 - 1e-9
        )
        return solve(made, np.concatenate(held), np.concatenate(values), load, steps=steps)

    def errors(self, made, x):
        """Norms of the error: L2 of the displacement, H1 seminorm of it, L2 of the pressure."""
        basis = made.basis()
        at, dx = np.asarray(basis.global_coordinates()), measure(made, basis)
        fields = interpolated(made, basis, x)
        gap = np.array([np.asarray(f) for f in fields]) - self.displacement(at)
        slope = np.array([f.grad for f in fields]) - self.gradient(at)
        squares = [gap**2, slope**2, (pressures(made, basis, x) - self.pressure(at)) ** 2]
        u, gradient, p = (float(np.sqrt((square * dx).sum())) for square in squares)
        return u, gradient, p

    def _held(self, X):
        low = X[:, -1] < 1e-12
        if self.axisymmetric:
            return low | (X[:, 0] > 1 - 1e-12)
        side = (X[:, :2] < 1e-12) | (X[:, :2] > 1 - 1e-12)
        return low | side.any(axis=1)
