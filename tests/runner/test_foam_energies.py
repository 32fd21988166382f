"""``study calibrate --energies`` weighs foams where Poisson's ratio lets sides be free."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from study.api.calibrating import choose_energy
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import Material

HEAD = """
schema = 1
[specimen]
shape = "homogeneous"
[material]
model = "neo-hookean"
"""
TEST = """
[[tests]]
test = {{ kind = "{kind}" }}
[tests.measurements]
file = "{kind}.csv"
columns = {{ stretch = "l", stress = "P" }}
units = {{ stretch = "1", stress = "kPa" }}
sign = "{sign}"
"""


def written(folder: Path, compressibility: str) -> Path:
    """Tension and compression of a foam with 1 % of noise; mu = 20 kPa, alpha = 8."""
    foam = Material("ogden-hill", {"mu1": 0.02, "alpha1": 8.0}, poisson_ratio=0.2)
    rng, text = np.random.default_rng(3), f"{HEAD}{compressibility}\n"
    for kind, end, sign in (("tension", 1.5, "positive"), ("compression", 0.5, "negative")):
        stretch = np.linspace(1 + 0.04 * (end - 1), end, 25)
        stress = 1e3 * LOADINGS["uniaxial"].nominal(foam, stretch).stress
        stress += 0.01 * np.abs(stress).max() * rng.normal(size=stress.size)
        rows = [f"{a:.9f},{b:.9f}" for a, b in zip(stretch, stress, strict=True)]
        (folder / f"{kind}.csv").write_text("\n".join(["l,P", *rows]) + "\n")
        text += TEST.format(kind=kind, sign=sign)
    path = folder / "foam.toml"
    path.write_text(text)
    return path


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_a_foam_is_known_among_all_energies(tmp_path: Path) -> None:
    found = choose_energy(written(tmp_path, "poisson_ratio = 0.2"), data=tmp_path)
    assert found.best == "ogden-hill-1"
    # 1 % of noise in 50 rows
    assert found.fits["ogden-hill-1"].fit.values == pytest.approx([0.02, 8.0], rel=0.01)


@pytest.mark.slow
def test_an_incompressible_solid_is_no_foam(tmp_path: Path) -> None:
    found = choose_energy(written(tmp_path, "incompressible = true"), data=tmp_path)
    assert not [k for k in (*found.fits, *found.failures) if k.startswith("ogden-hill")]
