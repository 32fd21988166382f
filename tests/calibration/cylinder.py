"""Closed-form compression of a cylinder, as the runner gives it to the fit."""

import numpy as np

from study.ground.curve import Curve
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.material.homogeneous import response
from study.mechanics.material.material import Material

AREA, HEIGHT = np.pi * 25.0**2, 30.0


def predictor(model, names, depth, mode="uniaxial", points=60, sign=-1.0, places=None):
    """Return predict(values) and the displacements; ``sign`` -1 compresses, +1 stretches."""
    d = np.linspace(depth / points, depth, points) if places is None else places
    stretch = 1 + sign * d / HEIGHT

    def predict(values):
        material = Material(model, dict(zip(names, values, strict=True)), incompressible=True)
        state = response(material, mode, stretch)
        gradient = {n: sign * AREA * g for n, g in state.gradient.items()}
        return [Curve(d, sign * AREA * state.stress, force_gradient=gradient)]

    return predict, d


def virtual(predict, values, d, noise=0.0, rng=None):
    """Return one measured curve made of a prediction and noise in N."""
    force = predict(np.asarray(values))[0].force_N
    if noise:
        force = force + noise * rng.normal(size=d.size)
    return [MeasuredCurve("virtual", Curve(d, force))]


def autoregression(rho, rng, rows):
    """Stationary errors of unit variance, of which neighbors have a correlation."""
    error = rng.normal(size=rows)
    for k in range(1, rows):
        error[k] = rho * error[k - 1] + np.sqrt(1 - rho**2) * error[k]
    return error
