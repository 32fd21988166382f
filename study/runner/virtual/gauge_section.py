"""Virtual tests of material: what `study new --calibration` writes beside its file.

The solid is Gent's with the constants of :data:`TRUTH`; every stress has the normal noise of one
load cell, from a fixed seed, so that the files are always the same.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from study.arrays import Array
from study.material.loading import LOADINGS
from study.material.material import Material
from study.record.atomic_files import write_new

#: what a fit should find
TRUTH = Material("gent", {"mu": 0.03, "Jm": 8.0}, poisson_ratio=0.495)

#: standard deviation of the noise, kPa: 0.6 % of the largest stress
NOISE_KPA = 0.5

_SEED = 20261123
_LENGTH_MM = 25.0


def write_tests(folder: Path) -> list[Path]:
    """Write tension, simple shear and compression of one solid.

    Parameters
    ----------
    folder : Path
        Made if it does not exist; files in it are never overwritten.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    FileExistsError
        If one of them exists.
    """
    rng = np.random.default_rng(_SEED)
    stretch, shear = np.linspace(1.0, 2.2, 25), np.linspace(0.0, 1.0, 21)
    shortened = np.linspace(1.0, 0.7, 16)
    folder.mkdir(parents=True, exist_ok=True)
    return [
        _write(folder / "tension.csv", "stretch", stretch, _stress("uniaxial", stretch, rng)),
        _write(
            folder / "simple-shear.csv", "shear", 100 * shear, _stress("simple-shear", shear, rng)
        ),
        _write(
            folder / "compression.csv", "displacement_mm", _LENGTH_MM * (1 - shortened),
            _stress("uniaxial", shortened, rng),
        ),
    ]  # fmt: skip


def _stress(loading: str, measure: Array, rng: np.random.Generator) -> Array:
    """Nominal stress in kPa with its noise."""
    exact = 1e3 * LOADINGS[loading].nominal(TRUTH, measure).stress
    return np.asarray(exact + NOISE_KPA * rng.standard_normal(exact.size))


def _write(path: Path, column: str, measure: Array, stress: Array) -> Path:
    rows = [f"{m:.5f},{p:.4f}" for m, p in zip(measure, stress, strict=True)]
    write_new(path, "\n".join(["# virtual", f"{column},stress_kPa", *rows]) + "\n")
    return path
