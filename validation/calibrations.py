"""Rates of what a calibration says, on drawn data whose truth is known.

``python -m validation.calibrations energies 200`` draws so many noisy tests of each of six rubbers
(tension to stretch 2 and planar tension to 1.8, 30 rows each, 1 and 3 % noise in turn) and prints
how often ``study calibrate --energies`` recommends the energy behind them, holds it among those
that cannot be told apart, or recommends another one. ``--only ogden-2`` draws one of them.

``python -m validation.calibrations coverage 200`` draws so many compressions of a bonded cylinder
for each kind of noise. Their force is that of a mesh three times finer than any that is fitted on;
meshes are taken in turn. It prints how often the 95 % interval of C10, noise and mesh together,
holds the truth. Offsets are drawn in ``tests/calibration/test_nuisance.py``, eight specimens in
``tests/calibration/test_random_effects.py``.

``python -m validation.calibrations drift 20`` draws so many tests of each of four solids with and
without a load cell that drifts by 5 % of the largest force, and prints how often that is told.

``python -m validation.calibrations setup 20`` draws so many tensions to stretch 1.4 of 60 rows for
each fault of a setup that only bends the curve a little: a machine that gives way beside the
specimen, a preload before displacement is set to zero, a load cell that is not zeroed. It prints
the mean of C10 over the truth, how often the model is said to describe the rows, and how often a
warning names an offset.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
from collections import Counter
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np

import study
from study.ground.arrays import Array
from study.ground.curve import Curve
from study.harness.design.load import load_calibration
from study.mechanics.calibration.fit import fit
from study.mechanics.calibration.fit_influence import with_serial_correlation
from study.mechanics.calibration.lack_of_fit import adequacy
from study.mechanics.calibration.residual_function import MeasuredCurve
from study.mechanics.forward.finite_element import solve
from study.mechanics.material.homogeneous import response
from study.mechanics.material.material import Material
from study.simulation.calibration.model_comparison import choose

#: energy and constants in MPa of six rubbers
TRUTHS = {
    "neo-hookean": ("neo-hookean", {"C10": 0.2}),
    "mooney-rivlin": ("mooney-rivlin", {"C10": 0.15, "C01": 0.06}),
    "reduced-polynomial-3": ("reduced-polynomial", {"C10": 0.18, "C20": -0.01, "C30": 0.006}),
    "ogden-1": ("ogden", {"mu1": 0.36, "alpha1": 3.2}),
    "ogden-2": ("ogden", {"mu1": 0.35, "alpha1": 1.3, "mu2": 0.01, "alpha2": 9.0}),
    "gent": ("gent", {"mu": 0.35, "Jm": 12.0}),
}
#: standard deviation of the rows over the largest stress
LEVELS = (0.01, 0.03)
AREA, LENGTH = 20.0, 25.0
RADIUS, HEIGHT, PRESSED = 10.0, 15.0, 3.0
MESHES = (1.0, 1.5, 2.0)
C10 = 0.007
KINDS = ("white", "correlated", "proportional")


def noise(kind: str, force: Array, size: float, rng: np.random.Generator) -> Array:
    """Errors of rows with a standard deviation of ``size`` over the largest force, or over each."""
    white = rng.normal(size=force.size)
    if kind == "proportional":
        return np.asarray(size * force * white)
    if kind == "correlated":
        for k in range(1, force.size):
            white[k] = 0.8 * white[k - 1] + 0.6 * white[k]
    return np.asarray(size * force.max() * white)


def _file(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def _rows(folder: Path, name: str, columns: str, *values: Array) -> None:
    lines = (",".join(f"{v:.9g}" for v in row) for row in zip(*values, strict=True))
    _file(folder, name, "\n".join([columns, *lines, ""]))


def _test(kind: str, file: str, columns: str, units: str, more: str = "") -> str:
    return (
        f'[[tests]]\ntest = {{ kind = "{kind}"{more} }}\n'
        f'measurements = {{ file = "{file}", columns = {{ {columns} }}, units = {{ {units} }} }}\n'
    )


def energies(draws: int, only: str | None = None) -> None:
    """Print the rates of the choice of an energy."""
    stretches = {
        "tension": np.linspace(1.03, 2.0, 30),
        "planar": np.linspace(1.03, 1.8, 30),
    }
    modes = {"tension": "uniaxial", "planar": "planar"}
    for label, (model, constants) in TRUTHS.items():
        if only not in (None, label):
            continue
        rng, counts = np.random.default_rng(2011), {level: Counter[str]() for level in LEVELS}
        material = Material(model, constants, incompressible=True)
        for number in range(draws):
            level = LEVELS[number % len(LEVELS)]
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                text = (
                    f'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "{AREA} mm^2"\n'
                    f'length = "{LENGTH} mm"\n[material]\nmodel = "neo-hookean"\n'
                    "incompressible = true\n"
                )
                for kind, stretch in stretches.items():
                    stress = response(material, modes[kind], stretch).stress
                    stress = stress + noise("white", stress, level, rng)
                    _rows(folder, f"{kind}.csv", "l,s", stretch, stress)
                    columns = 'stretch = "l", stress = "s"'
                    text += _test(kind, f"{kind}.csv", columns, 'stretch = "1", stress = "MPa"')
                choice = choose(load_calibration(_file(folder, "c.toml", text)), folder)
            count = counts[level]
            count["draws"] += 1
            count["truth recommended"] += choice.best == label
            count["truth among those that cannot be told apart"] += label in choice.alike
            count["nothing recommended"] += choice.best is None
            count["truth named as better, its constants not determined"] += choice.better == label
            if choice.best not in (label, None):
                count[f"{choice.best} recommended"] += 1
        for level, count in counts.items():
            shown = "; ".join(f"{what} {n}" for what, n in count.most_common())
            print(f"{label}, {100 * level:g} % noise: {shown}", flush=True)


def _cylinder(mesh: float) -> str:
    return (
        f'schema = 1\n[specimen]\nshape = "cylinder"\nradius = "{RADIUS} mm"\n'
        f'height = "{HEIGHT} mm"\n[material]\nmodel = "neo-hookean"\npoisson_ratio = 0.495\n'
        f'[model]\nspace = "axisymmetric"\nmesh_size = "{mesh} mm"\n'
    )


def _interval(folder: Path, text: str) -> tuple[float, float]:
    path = _file(folder, "c.toml", text)
    with contextlib.redirect_stderr(io.StringIO()):
        made = study.calibrate(path, data=folder).to_json()
    low, high = made["parameters"]["C10"]["ci95"]
    return float(low), float(high)


def _covered(draws: int, draw: Callable[[int, np.random.Generator], tuple[float, float]]) -> str:
    rng = np.random.default_rng(2011)
    held, widths = 0, []
    for number in range(draws):
        low, high = draw(number, rng)
        held += low <= 1e3 * C10 <= high
        widths.append((high - low) / 2 / (1e3 * C10))
    return f"{held} of {draws} intervals hold it, median half width {100 * np.median(widths):.2f} %"


def coverage(draws: int) -> None:
    """Print how often intervals hold the truth."""
    d = np.linspace(0.1, PRESSED, 40)
    columns, units = 'displacement = "d", force = "f"', 'displacement = "mm", force = "N"'
    moved = f', displacement = "{PRESSED} mm"'
    bonded = _test("compression", "a.csv", columns, units, moved + ', interface = "bonded"')
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _rows(folder, "a.csv", "d,f", d, d)
        fine = load_calibration(_file(folder, "t.toml", _cylinder(min(MESHES) / 3) + bonded))
        force = solve(fine.tests[0].problem.at({"C10": C10}, PRESSED)).curve.force_at(d)

        def of_mesh(kind: str) -> Callable[[int, np.random.Generator], tuple[float, float]]:
            def draw(number: int, rng: np.random.Generator) -> tuple[float, float]:
                size = (0.002, 0.02)[number % 2]
                _rows(folder, "a.csv", "d,f", d, force + noise(kind, force, size, rng))
                return _interval(folder, _cylinder(MESHES[number % 3]) + bonded)

            return draw

        for kind in KINDS:
            print(f"bonded, {kind} noise: {_covered(draws, of_mesh(kind))}", flush=True)


#: solids of the drift: energy, constants in MPa, largest elongation over the length
DRIFTING: tuple[tuple[str, dict[str, float], float], ...] = (
    ("neo-hookean", {"C10": 0.015}, 0.5),
    ("neo-hookean", {"C10": 0.015}, -0.3),
    ("reduced-polynomial", {"C10": 0.015, "C20": 0.003}, 1.0),
    ("mooney-rivlin", {"C10": 0.01, "C01": 0.005}, -0.3),
)


def drift(draws: int) -> None:
    """Print how often a drift in proportion to time is told, and how often one is that is none."""
    rng = np.random.default_rng(1)
    cases = product((0.05, 0.0), DRIFTING, (40, 100), (("white", 0.002), ("white", 0.01),
                    ("correlated", 0.01), ("proportional", 0.03)))  # fmt: skip
    for size, (model, constants, end), rows, (kind, level) in cases:
        names, d = tuple(constants), np.linspace(abs(end) / rows, abs(end), rows)
        sign = np.sign(end)

        def predict(values: Array, model: str = model, names: tuple[str, ...] = names,
                    d: Array = d, sign: float = sign) -> list[Curve]:  # fmt: skip
            material = Material(model, dict(zip(names, values, strict=True)), incompressible=True)
            state = response(material, "uniaxial", 1 + sign * d)
            slopes = {name: sign * slope for name, slope in state.gradient.items()}
            return [Curve(d, sign * state.stress, force_gradient=slopes)]

        truth, named = np.array(list(constants.values())), 0
        force = predict(truth)[0].force_N
        drifted = force + size * force.max() * np.linspace(0, 1, rows)
        for _ in range(draws):
            measured = [MeasuredCurve("a", Curve(d, drifted + noise(kind, force, level, rng)))]
            done = with_serial_correlation(fit(predict, measured, names, 0.9 * truth), measured)
            named += "drifts by" in adequacy(done, measured).sentence
        print(f"{model} to {100 * end:.0f} %, {rows} rows, {kind} noise of {100 * level:g} %, "
              f"drift of {100 * size:g} %: told in {named} of {draws}", flush=True)  # fmt: skip


def _tension(fault: str, share: float) -> tuple[Array, Array]:
    """Displacement (mm) and force (N) of a specimen of C10 in a setup with a fault."""
    d = np.linspace(0.0, 0.4 * LENGTH, 60)

    def resists(elongation: Array) -> Array:
        stretch = 1 + elongation / LENGTH
        return np.asarray(2 * AREA * C10 * (stretch - stretch**-2))

    force = resists(d)
    if fault == "machine":  # it takes this share of the way at first
        return d + force * share / (1 - share) / (6 * AREA * C10 / LENGTH), force
    if fault == "preload":
        return d, resists(d + np.interp(share * force[-1], force, d))
    return d, force + share * force[-1]


def setup(draws: int) -> None:
    """Print how often faults of a setup are told that bend a curve a little."""
    rng = np.random.default_rng(3)
    text = (
        f'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "{AREA} mm^2"\n'
        f'length = "{LENGTH} mm"\n[material]\nmodel = "neo-hookean"\nincompressible = true\n'
    )
    text += _test("tension", "a.csv", 'displacement = "d", force = "f"',
                  'displacement = "mm", force = "N"')  # fmt: skip
    cases = [("machine", 0.05), ("machine", 0.1), ("machine", 0.2)]
    cases += [(fault, share) for fault in ("preload", "offset") for share in (0.02, 0.04, 0.08)]
    for (fault, share), level in product(cases, (0.002, 0.01, 0.03)):
        d, force = _tension(fault, share)
        values, said = [], Counter[str]()
        with tempfile.TemporaryDirectory() as name:
            path = _file(Path(name), "c.toml", text)
            for _ in range(draws):
                _rows(Path(name), "a.csv", "d,f", d, force + noise("white", force, level, rng))
                with contextlib.redirect_stderr(io.StringIO()):
                    made = study.calibrate(path, data=Path(name))
                values.append(made.fit.values[0] / C10)
                said["described"] += made.adequacy.verdict == "describes"
                said["warned of an offset"] += "offset?" in " ".join(made.warnings)
        shown = ", ".join(f"{what} in {n}" for what, n in sorted(said.items()))
        print(f"{fault} {100 * share:g} %, {100 * level:g} % noise: C10 {np.mean(values):.3f} of "
              f"the truth, {shown} of {draws}", flush=True)  # fmt: skip


def main() -> None:
    """Print what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("energies", "coverage", "drift", "setup"))
    parser.add_argument("draws", type=int)
    parser.add_argument("--only", choices=tuple(TRUTHS), help="one truth of the energies")
    asked = parser.parse_args()
    if asked.what == "energies":
        energies(asked.draws, asked.only)
    else:
        {"coverage": coverage, "drift": drift, "setup": setup}[asked.what](asked.draws)


if __name__ == "__main__":
    main()
