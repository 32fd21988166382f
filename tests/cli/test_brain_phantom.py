"""The brain-shaped phantom from end to end: constants of a flat tip predict a needle elsewhere."""

from pathlib import Path

import pytest

from tests.cli.small import success

DESIGNS = Path(__file__).parents[2] / "designs"

TEST = """
[[tests]]
role = "{role}"
weight = "equal"
{table}
[tests.measurements]
file = "{name}.csv"
columns = {{ displacement = "displacement_mm", force = "force_N" }}
units = {{ displacement = "mm", force = "N" }}
range = ["0.5 mm", "2 mm"]
points = 4
"""

SPECIMEN = (
    'specimen = {{ shape = "brain", length = "80 mm", width = "60 mm", height = "50 mm",'
    ' fissure = "4 mm", clamp_below = "15 mm", press_x = "{x} mm", press_y = "{y} mm" }}\n'
    'test = {{ kind = "indentation", interface = "frictionless", displacement = "2 mm", steps = 4,'
    " indenter = {{ {indenter} }},"
    ' gravity = {{ density = "980 kg/m^3", direction = "down" }} }}'
)


def solved(name, *more):
    settings = [
        part for one in ("test.displacement=2 mm", "test.steps=4", *more) for part in ("-s", one)
    ]
    return success("solve", DESIGNS / f"brain-{name}.toml", "--json", *settings).json


def curve(path, found):
    rows = zip([0.0, *found["displacement_mm"]], [0.0, *found["force_N"]], strict=True)
    path.write_text("displacement_mm,force_N\n" + "".join(f"{d},{f}\n" for d, f in rows))


@pytest.mark.slow
def test_constants_of_a_flat_tip_predict_a_needle_elsewhere(tmp_path):
    """Both curves are made by the model itself (virtual): the constant is known to be 5 kPa."""
    truth = ("material.model=neo-hookean", "material.C10=5 kPa")
    places = {"tip": (10, -14, "fit"), "needle": (-12, 12, "held-out")}
    shapes = {
        "tip": 'shape = "flat", radius = "8 mm", edge_radius = "4 mm"',
        "needle": 'shape = "cone", half_angle = "60 deg", tip_radius = "8 mm"',
    }
    text = 'schema = 1\n[material]\nmodel = "neo-hookean"\nC10 = "4 kPa"\npoisson_ratio = 0.495\n'
    text += '[model]\nspace = "3d"\nelement_order = "linear"\nmesh = "coarse"\n'
    for name, (x, y, role) in places.items():
        curve(tmp_path / f"{name}.csv", solved(name, *truth))
        table = SPECIMEN.format(x=x, y=y, indenter=shapes[name])
        text += TEST.format(role=role, name=name, table=table)
    (tmp_path / "fit.toml").write_text(text)
    found = success(f"calibrate {tmp_path}/fit.toml --data {tmp_path} --json").json
    constant = found["parameters"]["C10"]

    # read at the load steps themselves, so that nothing is interpolated
    assert constant["value"] == pytest.approx(5, rel=1e-4)
    needle = next(one for one in found["curves"] if one["role"] == "held-out")
    assert needle["rms_force_error"] < 1e-4


def test_the_designs_solve_and_the_clamp_carries_the_tip_and_the_weight():
    found = solved("tip")
    assert found["force_N"][-1] > 0
    assert found["base_reaction_N"][-1] > found["force_N"][-1]
