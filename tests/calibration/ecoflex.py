"""Published fits of silicone cylinders (Dawood et al. 2026) as problems for our own fit."""

import csv
import gzip
import json

import numpy as np

from study.ground.curve import Curve
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.material.homogeneous import response
from study.mechanics.material.material import Material
from tests.material.modes import uniaxial

AREA_MM2 = np.pi * 25.0**2
HEIGHT_MM = 30.0
KPA_PER_N = 1e3 / AREA_MM2


def averaged(folder):
    """Mix -> nominal stress in kPa, mean of its ten tests at 1000 equal strains to 2/3."""
    tests = {}
    path = folder / "ef10_time_compression_load.csv.gz"
    with gzip.open(path, "rt", newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = row["phantom"], row["specimen"], row["repeat"]
            tests.setdefault(key, []).append((float(row["compression_mm"]), float(row["load_N"])))
    strain = np.linspace(0, 2 / 3, 1000)
    mixes = {}
    for (mix, _, _), points in tests.items():
        d, load = np.array(points).T
        mixes.setdefault(mix, []).append(np.interp(strain * HEIGHT_MM, d, load))
    return strain, {mix: KPA_PER_N * np.mean(curves, axis=0) for mix, curves in mixes.items()}


def published(folder):
    """Mix -> energy -> the authors' parameters and sum of squares (kPa)."""
    text = (folder / "hyperelastic_parameters_ef10.json").read_text(encoding="utf-8")
    return json.loads(text)["engineering"]


def fitted(model, names, strain, stress_kPa, start):
    """Our fit of the closed form; constants in kPa, sum of squares in kPa^2."""
    d = strain * HEIGHT_MM
    measured = MeasuredCurve("mean", Curve(d, stress_kPa / KPA_PER_N))

    def predict(values):
        material = Material(model, dict(zip(names, values, strict=True)), incompressible=True)
        gradient = response(material, "uniaxial", 1 - strain).gradient
        return [
            Curve(
                d,
                -AREA_MM2 * uniaxial(material, 1 - strain),
                force_gradient={n: -AREA_MM2 * g for n, g in gradient.items()},
            )
        ]

    result = fit(predict, [measured], names, start)
    unit = np.array([1.0 if n.startswith("alpha") else 1e3 for n in names])
    return result, unit * result.values, result.rss * KPA_PER_N**2
