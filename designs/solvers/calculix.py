"""CalculiX as a forward model: compression of a cylinder, axisymmetric.

    argv = [["python", "calculix.py", "deck"], ["ccx", "-i", "model"],
            ["python", "calculix.py", "curve"]]

``deck`` reads problem.json and writes model.inp on the very mesh that the built-in solver would
use; ``curve`` reads model.dat and writes curve.csv. The elements follow the table ``[model]``:

    order      shape    displacement   mixed: the code's own remedy against locking
    linear     tensor   CAX4           none: refused
    quadratic  tensor   CAX8           CAX8R, reduced integration
    quadratic  simplex  CAX6           none: refused
"""

import csv
import json
import re
import sys

import numpy as np

ELEMENTS = {
    ("linear", "tensor", "displacement"): "CAX4",
    ("quadratic", "tensor", "displacement"): "CAX8",
    ("quadratic", "simplex", "displacement"): "CAX6",
    ("quadratic", "tensor", "mixed"): "CAX8R",
}
#: CalculiX computes, and prints the force of, a wedge of 2 degrees of an axisymmetric body
WEDGES = 180.0
#: a compliance that leaves the higher volumetric terms without effect; 0 would be replaced
NONE = 1e20
FORCE = re.compile(r"total force .* for set TOP and time\s+(\S+)")


def deck(problem: dict) -> str:
    """Text of the input file."""
    # the mesh generator takes a second to load, and the curve does not need it
    from study.mechanics.mesh.mesher import build_mesh
    from study.simulation.cell import CellProblem

    model, test, material = problem["model"], problem["test"], problem["material"]
    kind = ELEMENTS.get((model["element_order"], model["element_shape"], model["formulation"]))
    if kind is None or model["space"] != "axisymmetric" or test["kind"] != "compression":
        sys.exit("ERROR: this adapter knows compression in CAX4, CAX8, CAX8R and CAX6 alone")
    mesh = build_mesh(CellProblem.of(problem).setup)
    points, cells = mesh.points, mesh.cells
    if model["element_order"] == "quadratic":
        points, cells = with_midsides(points, cells)
    r, z = points.T
    near = 1e-9 * z.max()
    bottom, top = z < z.min() + near, z > z.max() - near
    share = 0.5 if mesh.half_height else 1.0
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{k}, {x:.15g}, {y:.15g}, 0." for k, (x, y) in enumerate(points, 1)]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=BODY"]
    lines += [f"{k}, " + ", ".join(str(n + 1) for n in cell) for k, cell in enumerate(cells, 1)]
    for name, chosen in (("AXIS", r < 1e-9 * r.max()), ("BOTTOM", bottom), ("TOP", top)):
        lines += [f"*NSET, NSET={name}", *(f"{k + 1}," for k in np.flatnonzero(chosen))]
    lines += ["*MATERIAL, NAME=RUBBER", *hyperelastic(material)]
    lines += ["*SOLID SECTION, ELSET=BODY, MATERIAL=RUBBER", "*BOUNDARY", "AXIS, 1, 1"]
    lines += ["BOTTOM, 2, 2"]
    if test["base"] == "bonded" and not mesh.half_height:
        lines += ["BOTTOM, 1, 1"]
    if test["interface"] == "bonded":
        lines += ["TOP, 1, 1"]
    step = 1 / test["steps"]
    lines += ["*STEP, NLGEOM, INC=1000", "*STATIC", f"{step:.12g}, 1., 1e-6, {step:.12g}"]
    lines += ["*BOUNDARY", f"TOP, 2, 2, {-share * test['displacement_mm']:.15g}"]
    lines += ["*NODE PRINT, NSET=TOP, TOTALS=ONLY", "RF", "*END STEP", ""]
    facts = {"elements": len(cells), "dofs": points.size}
    with open("facts.json", "w", encoding="utf-8") as stream:
        json.dump(facts, stream)
    return "\n".join(lines)


def hyperelastic(material: dict) -> list[str]:
    """Material of a reduced polynomial: W = sum Ck0 (I1 - 3)^k + K/2 (J - 1)^2."""
    constants = material["constants_MPa"]
    names = [f"C{k}0" for k in range(1, len(constants) + 1)]
    if list(constants) != names or len(names) > 3 or material["bulk_modulus_MPa"] is None:
        sys.exit("ERROR: this adapter knows C10, C20, C30 with a finite bulk modulus alone")
    volumetric = [2 / material["bulk_modulus_MPa"], NONE, NONE][: len(names)]
    values = [*constants.values(), *volumetric]
    kind = f"REDUCED POLYNOMIAL, N={len(names)}" if len(names) > 1 else "NEO HOOKE"
    return [f"*HYPERELASTIC, {kind}", ", ".join(f"{value:.15g}" for value in values)]


def with_midsides(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and cells with a node in the middle of every edge, after the corners."""
    corners = cells.shape[1]
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    once, place = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    middles = place.reshape(-1, corners) + len(points)
    return np.vstack([points, points[once].mean(axis=1)]), np.hstack([cells, middles])


def curve(problem: dict, text: str) -> list[tuple[float, float]]:
    """Displacement in mm and force in N of every increment."""
    depth, lines, rows = problem["test"]["displacement_mm"], iter(text.splitlines()), []
    for line in lines:
        found = FORCE.search(line)
        if found:
            values = next(after for after in lines if after.strip()).split()
            rows.append((float(found[1]) * depth, -WEDGES * float(values[1])))
    return rows


def main(what: str) -> None:
    """Write the input file, or the curve."""
    with open("problem.json", encoding="utf-8") as stream:
        problem = json.load(stream)
    if what == "deck":
        with open("model.inp", "w", encoding="ascii") as stream:
            stream.write(deck(problem))
        return
    with open("model.dat", encoding="ascii") as stream:
        rows = curve(problem, stream.read())
    with open("curve.csv", "w", newline="", encoding="ascii") as stream:
        csv.writer(stream).writerows([("displacement_mm", "force_N"), *rows])


if __name__ == "__main__":
    main(sys.argv[1])
