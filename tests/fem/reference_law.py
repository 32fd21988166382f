"""Stress by matrix functions in complex arithmetic: an independent law for complex steps.

No principal axes: with C = F'F and its isochoric logarithm L the Ogden stress is
``S = C^-1 dev(sum 2 mu/alpha (exp(alpha L) - 1))``. Logarithm and exponential are made of
sums, products and inverses only, so that tiny imaginary parts are carried exactly and
``Im P(F + i h D) / h`` is the derivative to rounding, at equal stretches too.
"""

from __future__ import annotations

import numpy as np

from study.material.material import Material

Array = np.ndarray
STEP = 1e-40


def logarithm(A: Array) -> Array:
    """Matrix logarithm by inverse scaling and squaring (Higham 2008, sec. 11.5)."""
    scale = 1
    while np.abs(A.real - np.eye(3)).max() > 0.05:
        A, scale = square_root(A), 2 * scale
    Z = (A - np.eye(3)) @ np.linalg.inv(A + np.eye(3))
    power, total = Z.copy(), Z.copy()
    for k in range(3, 26, 2):
        power = power @ Z @ Z
        total = total + power / k
    return 2 * scale * total


def square_root(A: Array) -> Array:
    """Principal square root by the iteration of Denman and Beavers (Higham 2008, sec. 6.3)."""
    Y, Z = A, np.eye(3, dtype=complex)
    for _ in range(12):
        Y, Z = 0.5 * (Y + np.linalg.inv(Z)), 0.5 * (Z + np.linalg.inv(Y))
    return Y


def exponential_ratio(A: Array) -> Array:
    """(exp(A) - 1) A^-1 as a series, by halving the argument."""
    halvings = max(0, int(np.ceil(np.log2(np.abs(A).max() / 0.25 + 1e-300))))
    B = A / 2**halvings
    ratio, term = np.eye(3, dtype=complex), np.eye(3, dtype=complex)
    for k in range(2, 20):
        term = term @ B / k
        ratio = ratio + term
    for _ in range(halvings):  # (e^2x - 1) / 2x = (e^x - 1) / x * (e^x + 1) / 2
        ratio = ratio @ (B @ ratio / 2 + np.eye(3))
        B = 2 * B
    return ratio


def stress(material: Material, F: Array, constants: dict[str, complex] | None = None) -> Array:
    """Isochoric nominal stress, shape (3, 3), complex."""
    values: dict[str, complex] = dict(constants or material.constants)
    eye = np.eye(3)
    if material.small_strain:
        mu = values["youngs_modulus"] / 3
        strain = 0.5 * (F + F.T) - eye
        return 2 * mu * (strain - np.trace(strain) / 3 * eye)
    C = F.T @ F
    J = np.linalg.det(F)
    C = C.astype(complex) * J ** (-2 / 3)
    if material.model == "ogden":
        L = 0.5 * logarithm(C)
        source = np.zeros((3, 3), dtype=complex)
        for k in range(1, len(values) // 2 + 1):
            mu, alpha = values[f"mu{k}"], values[f"alpha{k}"]
            source = source + 2 * mu * L @ exponential_ratio(alpha * L)
    else:
        i1 = np.trace(C)
        i2 = (i1**2 - np.trace(C @ C)) / 2
        w1 = w2 = 0j
        for name, value in values.items():
            i, j = int(name[1:-1]), int(name[-1])
            w1 += value * i * (i1 - 3) ** max(i - 1, 0) * (i2 - 3) ** j
            w2 += value * j * (i1 - 3) ** i * (i2 - 3) ** max(j - 1, 0)
        source = 2 * C @ (w1 * eye + w2 * (i1 * eye - C))
    dev = source - np.trace(source) / 3 * eye
    return np.linalg.inv(F).T @ dev


def tangent(material: Material, F: Array) -> Array:
    """dP/dF, shape (9, 9), by complex steps."""
    columns = []
    for n in range(9):
        D = np.zeros(9)
        D[n] = STEP
        columns.append(stress(material, F + 1j * D.reshape(3, 3)).imag.ravel() / STEP)
    return np.column_stack(columns)


def constant_derivative(material: Material, F: Array, name: str) -> Array:
    """dP/dconstant by a complex step."""
    values = {**material.constants, name: material.constants[name] + 1j * STEP}
    return stress(material, F, values).imag / STEP
