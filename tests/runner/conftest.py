"""A small study with a fake solver: seconds, not minutes."""

import numpy as np
import pytest

from study.execution.local import Answer, Inline
from study.harness.design.load import loads
from study.mechanics.forward import closed_form
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cylinder
from tests.cli.small import TRUTH as TRUTH_KPA
from tests.runner import fake_worker


class Mortal(Inline):
    """Does tasks here, and tells of those that the machine kills as a process of its own would.

    Real processes that die: ``tests/execution/test_loky.py``. Each takes a second or more to start.
    """

    def start(self, payloads, done, ticket):
        try:
            super().start(payloads, done, ticket)
        except fake_worker.Killed:
            done.put((ticket, Answer(death="crashed (signal 9) (out of memory?)")))


def fake():
    """The fake solver."""
    return Mortal(fake_worker.perform)


SPECIMEN = Cylinder(25.0, 30.0)


def compressed(model, interface, order=None, *, poisson_ratio=0.4995, steps=10, **mesh):
    """Document of a cell whose constants are calibrated."""
    return {
        "specimen": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
        "test": {"kind": "compression", "interface": interface, "base": None,
                 "displacement_mm": 6.0, "steps": steps},
        "material": {"model": model, "constants": {}, "poisson_ratio": poisson_ratio,
                     "order": order},
        "model": mesh,
    }  # fmt: skip


DESIGN = """
schema = 1
[study]
name = "small"
question = "Does anything matter?"
[specimen]
shape = "cylinder"
radius = "25 mm"
height = "30 mm"
[test]
kind = "compression"
steps = 10
[material]
poisson_ratio = 0.4995
[presets.material.neo-hookean]
model = "neo-hookean"
[presets.material.mooney-rivlin]
model = "mooney-rivlin"
[presets.plates.frictionless]
test.interface = "frictionless"
[presets.plates.bonded]
test.interface = "bonded"
[model]
space = "axisymmetric"
mesh = "coarse"
[measurements]
file = "tests.csv"
columns = { displacement = "d_mm", force = "f_N" }
units = { displacement = "mm", force = "N" }
block = "mix"
average = ["repeat"]
range = ["1 %", "20 %"]
points = 50
fit = { specimen = "A" }
score = { specimen = "B" }
swap = true
[factors]
material = ["neo-hookean", "mooney-rivlin"]
plates = ["frictionless", "bonded"]
[[response]]
name = "relative_rms_force_error"
practical = "0.5 pp"
[[response]]
name = "mu0"
transform = "log"
practical = "10 % of mean"
"""

#: C10 and C01 in MPa of the two specimens of each mix
TRUTH = {specimen: (1e-3 * c10, 1e-3 * c01) for specimen, (c10, c01) in TRUTH_KPA.items()}


def material(c10, c01):
    return Material("mooney-rivlin", {"C10": c10, "C01": c01}, poisson_ratio=0.4995)


@pytest.fixture
def design():
    return loads(DESIGN, "small.toml")


@pytest.fixture
def data(tmp_path):
    return make_data(tmp_path)


@pytest.fixture
def one_mix(tmp_path):
    """Data of a single mix."""
    return make_data(tmp_path, ("M1",))


def make_data(home, mixes=("M1", "M2", "M3")):
    """Exact Mooney-Rivlin tests between frictionless plates, two equal repeats each."""
    folder = home / "data"
    folder.mkdir()
    d = np.linspace(0.0, 6.5, 131)
    lines = ["mix,specimen,repeat,d_mm,f_N"]
    for (mix, specimen), constants in TRUTH.items():
        if mix not in mixes:
            continue
        force = closed_form.homogeneous(SPECIMEN, material(*constants), d).force_N
        for repeat in (1, 2):
            lines += [
                f"{mix},{specimen},{repeat},{x:.4f},{f:.10f}" for x, f in zip(d, force, strict=True)
            ]
    (folder / "tests.csv").write_text("\n".join(lines) + "\n")
    return folder
