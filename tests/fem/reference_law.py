"""Stress by matrix functions in complex arithmetic: an independent law for complex steps.

No principal axes: with C = F'F and its isochoric logarithm L the Ogden stress is
``S = C^-1 dev(sum 2 mu/alpha (exp(alpha L) - 1))``. Logarithm and exponential are made of
sums, products and inverses only, so that tiny imaginary parts are carried exactly and
``Im P(F + i h D) / h`` is the derivative to rounding, at equal stretches too.
"""

import numpy as np

STEP = 1e-40


def logarithm(A):
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


def square_root(A):
    """Principal square root by the iteration of Denman and Beavers (Higham 2008, sec. 6.3)."""
    Y, Z = A, np.eye(3, dtype=complex)
    for _ in range(12):
        Y, Z = 0.5 * (Y + np.linalg.inv(Z)), 0.5 * (Z + np.linalg.inv(Y))
    return Y


def exponential_ratio(A):
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


def invariant_slopes(model, values, i1, i2):
    """dW/dI1 and dW/dI2 as the manuals of FEBio and Abaqus and the papers print them."""
    if model == "arruda-boyce":
        f = i1 / values["lambda_m"] ** 2
        series = (1 / 2, 1 / 10 * f, 11 / 350 * f**2, 19 / 1750 * f**3, 519 / 134750 * f**4)
        return values["mu"] * sum(series), 0j
    if model == "gent":
        return values["mu"] / 2 * values["Jm"] / (values["Jm"] - i1 + 3), 0j
    if model == "extended-tube":
        square = values["delta"] ** 2
        gap = 1 - square * (i1 - 3)
        return values["Gc"] / 2 * ((1 - square) / gap**2 - square / gap), 0j
    if model == "van-der-waals":
        beta = values["beta"]
        mixed = (1 - beta) * i1 + beta * i2 - 3
        eta = np.sqrt(mixed / (values["lambda_m"] ** 2 - 3))
        slope = values["mu"] / 2 * (1 / (1 - eta) - values["a"] * np.sqrt(mixed / 2))
        return (1 - beta) * slope, beta * slope
    if model == "veronda-westmann":
        c1, c2 = values["C1"], values["C2"]
        return c1 * c2 * np.exp(c2 * (i1 - 3)), -c1 * c2 / 2
    if model == "fung":
        return values["mu"] / 2 * np.exp(values["b"] * (i1 - 3)), 0j
    w1 = w2 = 0j
    for name, value in values.items():
        i, j = int(name[1:-1]), int(name[-1])
        w1 += value * i * (i1 - 3) ** max(i - 1, 0) * (i2 - 3) ** j
        w2 += value * j * (i1 - 3) ** i * (i2 - 3) ** max(j - 1, 0)
    return w1, w2


def stress(material, F, constants=None):
    """Isochoric nominal stress, shape (3, 3), complex."""
    values = dict(constants or material.constants)
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
        w1, w2 = invariant_slopes(material.model, values, i1, i2)
        source = 2 * C @ (w1 * eye + w2 * (i1 * eye - C))
    if material.model == "extended-tube":
        L = 0.5 * logarithm(C)
        source = source + 2 * values["Ge"] * L @ exponential_ratio(-values["beta"] * L)
    dev = source - np.trace(source) / 3 * eye
    return np.linalg.inv(F).T @ dev


def tangent(material, F):
    """dP/dF, shape (9, 9), by complex steps."""
    columns = []
    for n in range(9):
        D = np.zeros(9)
        D[n] = STEP
        columns.append(stress(material, F + 1j * D.reshape(3, 3)).imag.ravel() / STEP)
    return np.column_stack(columns)


def constant_derivative(material, F, name):
    """dP/dconstant by a complex step."""
    values = {**material.constants, name: material.constants[name] + 1j * STEP}
    return stress(material, F, values).imag / STEP
