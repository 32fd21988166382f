"""Closed form of an incompressible cylinder between lubricated plates, as another program.

    [forward]
    model = "command"
    argv = [["python", "closed_form.py"]]
    files = ["solvers/closed_form.py"]

Reads problem.json, writes curve.csv with the force of a reduced polynomial and, with the word
``gradients``, its derivatives by the constants. Nothing but Python's own library is needed.
"""

import csv
import json
import math
import sys


def main(with_gradients: bool) -> None:
    """Write the curve of the problem in this folder."""
    with open("problem.json", encoding="utf-8") as stream:
        problem = json.load(stream)
    constants = problem["material"]["constants_MPa"]
    height = problem["specimen"]["height_mm"]
    area = math.pi * problem["specimen"]["radius_mm"] ** 2
    names = list(constants) if with_gradients else []
    with open("curve.csv", "w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["displacement_mm", "force_N", *(f"dforce_{name}" for name in names)])
        for d in problem["displacement_mm"]:
            slopes = {name: area * slope(name, 1 - d / height) for name in constants}
            force = sum(constants[name] * slopes[name] for name in constants)
            table.writerow([repr(d), repr(force), *(repr(slopes[name]) for name in names)])


def slope(name: str, stretch: float) -> float:
    """Nominal stress in compression over the constant C10, C20 or C30: 2 k (I1 - 3)^(k - 1) ..."""
    order = int(name[1])
    invariant = stretch**2 + 2 / stretch
    return 2 * order * (invariant - 3) ** (order - 1) * (stretch**-2 - stretch)


main("gradients" in sys.argv[1:])
