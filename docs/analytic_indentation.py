"""Figures of analytic-indentation.md: finite elements over the closed form, and coverage.

    python docs/analytic_indentation.py

It takes about a minute.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from study.mechanics.forward.contact_law import Layer, force_law
from study.mechanics.indentation.indentation_modulus import fit_modulus
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cone, Cylinder, Flat, Indenter, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve

NU = 0.4999
#: neo-Hookean of shear modulus 1/3 MPa
MATERIAL = Material("neo-hookean", {"C10": 1 / 6}, poisson_ratio=NU)
TIP = Sphere(5.0)
BALL = "sphere R 5 mm"
#: name, indenter, specimen, depth in mm, steps
CASES: tuple[tuple[str, Indenter, Cylinder, float, int], ...] = (
    (f"{BALL}, block of 50 mm", TIP, Cylinder(60, 50), 2.5, 10),
    (f"{BALL}, layer of 5 mm", TIP, Cylinder(40, 5), 1.5, 10),
    ("punch a 3 mm, edge 0.1 mm", Flat(3, 0.1), Cylinder(50, 50), 2.0, 10),
    *((f"cone {angle:g} deg", Cone(angle), Cylinder(50, 50), 2.0, 4) for angle in (30, 45, 60)),
    *((f"{BALL}, radius {r} mm", TIP, Cylinder(r, 50), 0.3, 3) for r in (8, 15, 30)),
)


def compare(name: str, tip: Indenter, block: Cylinder, depth: float, steps: int) -> None:
    """Print force of the finite elements over that of the closed form, less 1, in percent."""
    test = Test("indentation", depth, "frictionless", "bonded", steps, tip)
    found = solve(Problem(block, test, MATERIAL, replace(Model(), mesh="medium")), gradients=False)
    d, force = np.array(found.curve.displacement_mm), np.array(found.curve.force_N)
    plane_strain = 2 * MATERIAL.mu0 / (1 - NU)
    print(name, found.status)
    print("  d [mm]", *np.round(d, 3))
    for paraboloid in (False, True):
        law = force_law(tip, Layer(block.height_mm, NU), depth, paraboloid=paraboloid)
        off = 100 * (force / (plane_strain * law.force(d)) - 1)
        print("  paraboloid [%]" if paraboloid else "  exact [%]", *np.round(off, 1), flush=True)


def coverage(correlation: float, find_contact: bool, rows: int = 60, runs: int = 1000) -> float:
    """Share of 95 % intervals that hold the modulus, with noise of 2 % of the last force."""
    rng, law = np.random.default_rng(1), force_law(TIP, Layer(10.0, 0.5), 1.2)
    contact, hits = (0.1 if find_contact else 0.0), 0
    d = np.linspace(0.5 / rows, 0.5 + contact, rows)
    clean = law.force(d - contact)
    for _ in range(runs):
        noise = rng.normal(size=rows)
        for i in range(1, rows):
            noise[i] = correlation * noise[i - 1] + np.sqrt(1 - correlation**2) * noise[i]
        force = clean + 0.02 * clean[-1] * noise
        found = fit_modulus(
            d, force, law, poisson_ratio=0.5, deepest_mm=0.55, find_contact=find_contact
        )
        low, high = found.interval_MPa or (np.inf, -np.inf)
        hits += low <= 0.75 <= high
    return hits / runs


if __name__ == "__main__":
    for case in CASES:
        compare(*case)
    for correlation in (0.0, 0.5, 0.9):
        shares = [coverage(correlation, find_contact) for find_contact in (False, True)]
        print(f"correlation {correlation:g}: contact given, fitted:", *shares)
