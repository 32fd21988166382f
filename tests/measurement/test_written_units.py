"""Units as instruments write them: proposed by ``inspect``, and held against what is declared."""

import numpy as np
import pytest

import study
from study.ground.errors import InputError
from study.ground.units import unit_factor
from tests.measurement.layouts import SIZE, calibration

#: how files write a unit, what it measures, and N, mm or MPa in one of it
WRITTEN = (
    ("g", "force", 9.80665e-3), ("gf", "force", 9.80665e-3), ("grams", "force", 9.80665e-3),
    ("kg", "force", 9.80665), ("KGF", "force", 9.80665), ("kp", "force", 9.80665),
    ("lb", "force", 4.4482216), ("Lbf", "force", 4.4482216), ("lbs", "force", 4.4482216),
    ("oz", "force", 0.27801385), ("cN", "force", 0.01), ("mN", "force", 1e-3),
    ("in", "displacement", 25.4), ("IN", "displacement", 25.4), ("mil", "displacement", 0.0254),
    ("um", "displacement", 1e-3), ("µm", "displacement", 1e-3), ("cm", "displacement", 10.0),
    ("psi", "stress", 6.894757e-3), ("PSI", "stress", 6.894757e-3), ("ksi", "stress", 6.894757),
    ("kPa", "stress", 1e-3), ("KPa", "stress", 1e-3), ("kgf/cm2", "stress", 0.0980665),
    ("N/m2", "stress", 1e-6), ("lb/in2", "stress", 6.894757e-3), ("mPa", "stress", 1e-9),
)  # fmt: skip
USUAL = {"force": "N", "displacement": "mm", "stress": "MPa", "strain": "1"}
PLACES = {
    "brackets": ("", "{0} ({1})", ""),
    "name": ("", "{0}_{1}", ""),
    "row": ("", "{0}", "{1}"),
    "above": ("Operator: A. B.\nLoad cell: 10 kN\n{0} unit: {1}\n", "{0}", ""),
}


def written(folder, quantity, word, place):
    """Write 20 rows; columns by quantity."""
    other = {"force": "displacement", "displacement": "force", "stress": "strain"}[quantity]
    above, name, row = (text.format(quantity, word) for text in PLACES[place])
    heads = {other: f"{other} [{USUAL[other]}]", quantity: name}
    lines = [",".join(heads.values())]
    if row:
        heads[other] = other
        lines = [",".join(heads), f"{USUAL[other]},{row}"]
    lines += [f"{0.01 * k},{0.02 * k}" for k in range(1, 21)]
    (folder / "a.csv").write_text(above + "\n".join(lines) + "\n")
    return heads, above.count("\n")


def declared(folder, heads, skip_lines=0, kind="tension", size=SIZE):
    """Calibration by a.csv, whose columns are declared in their usual units."""
    columns = ", ".join(f'{key} = "{name}"' for key, name in heads.items())
    units = ", ".join(f'{key} = "{USUAL[key]}"' for key in heads)
    table = f'[measurements]\nfile = "a.csv"\nskip_lines = {skip_lines}\n'
    table += f"columns = {{ {columns} }}\nunits = {{ {units} }}\n"
    (folder / "c.toml").write_text(calibration(table, kind, size))
    return folder / "c.toml"


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("word", "quantity", "size"), WRITTEN)
def test_a_unit_is_proposed_as_the_file_writes_it(tmp_path, word, quantity, size, place):
    written(tmp_path, quantity, word, place)
    proposed = study.inspect(tmp_path / "a.csv").measurements["units"][quantity]
    dimension = {"displacement": "length", "stress": "pressure"}.get(quantity, quantity)
    assert unit_factor(proposed, dimension) == pytest.approx(size, rel=1e-6)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("word", "quantity", "size"), WRITTEN)
def test_a_declared_unit_that_the_file_contradicts_is_refused(
    tmp_path, word, quantity, size, place
):
    """Grams of force read as N gave 3,061 kPa of 30, and the model "described" them."""
    heads, skipped = written(tmp_path, quantity, word, place)
    file = declared(tmp_path, heads, skipped)
    # a row that holds no unit that the program knows is none of units
    with pytest.raises(
        InputError, match="is declared in measurements.units|must be a finite number"
    ):
        study.calibrate(file, data=tmp_path)
    assert size != 1


@pytest.mark.parametrize(
    ("above", "names"),
    [
        ("Distance Units,mm\nForce Units,g\n", "Time,Distance,Force"),
        ("Y_Unit_Label,N\n\n", "Time (s),Distance (mm),Force (g)"),
        ("% force in g\n% distance in mm\n", "time,distance,force"),
        ("Load rate: N/s\nLoad cell: 10 kN\nUnits: mm, gf, s\n", "Time,Distance,Load"),
    ],
    ids=["a line each", "LabVIEW", "MATLAB", "all in one"],
)
def test_lines_above_the_names_are_no_row_of_units(tmp_path, above, names):
    rows = "".join(f"{k},{0.1 * k},{0.02 * k}\n" for k in range(1, 21))
    (tmp_path / "a.csv").write_text(f"{above}{names}\n{rows}")
    measurements = study.inspect(tmp_path / "a.csv").measurements
    assert measurements["units"] == {"displacement": "mm", "force": "gf"}
    assert list(measurements["columns"].values()) == names.split(",")[1:]


@pytest.mark.parametrize(
    ("far", "hard", "refused"),
    [
        ("d_mm", "F [N]", False),
        ("Weg in mm", "Kraft / N", False),
        ("position_max", "Force_Min", False),  # no mega-inches
        ("d [1]", "F (t)", False),
        ("a [N]", "b [mm]", True),
    ],
)
def test_names_that_hold_no_other_unit_are_read(tmp_path, far, hard, refused):
    rows = "".join(f"{0.1 * k},{0.02 * k}\n" for k in range(1, 21))
    (tmp_path / "a.csv").write_text(f"{far},{hard}\n{rows}")
    file = declared(tmp_path, {"displacement": far, "force": hard})
    if refused:
        with pytest.raises(InputError, match="its name says mm, but N is declared"):
            study.calibrate(file, data=tmp_path)
    else:
        assert study.calibrate(file, data=tmp_path).converged


@pytest.mark.parametrize(
    ("above", "note"),
    [
        ("Area,40.0,mm^2\n", "area 40 mm^2, [specimen] has 80 mm^2"),
        ("Specimen,S1\nWidth [mm],8\nThickness: 5 mm\n", "area 40 mm^2, [specimen] has 80 mm^2"),
        ('"Durchmesser","1,5","cm"\n', "area 176.7 mm^2, [specimen] has 80 mm^2"),
        ("# Gauge length: 25 mm\n", "length 25 mm, [specimen] has 20 mm"),
        ("Area,80.4,mm^2\nInitial length;20;mm\n", ""),  # as it was measured, to two digits
        ("Probe diameter: 5 mm\nLoad cell area: 3 mm^2\n", ""),  # of no specimen
        ("Area,40,mm^2\nArea,60,mm^2\n", ""),  # two specimens: which of them is not said
        ("Length: 25 s\nWidth,20\n", ""),  # of a pulse, and of no unit
    ],
)
def test_a_size_above_the_rows_that_is_another_one_is_named(tmp_path, above, note):
    """F = A mu (l - 1/l^2) with A of the file: half the constant, and a fit that describes all."""
    elongation_mm = 0.2 * np.arange(1, 31)
    stretch = 1 + elongation_mm / 20
    force_N = 40 * 0.06 * (stretch - stretch**-2)
    pairs = zip(elongation_mm.tolist(), force_N.tolist(), strict=True)
    rows = "".join(f"{d:.6f},{f:.8f}\n" for d, f in pairs)
    (tmp_path / "a.csv").write_text(f"{above}d,F\n{rows}")
    file = declared(tmp_path, {"displacement": "d", "force": "F"}, above.count("\n"))
    notes = study.calibrate(file, data=tmp_path).notes
    written = [each for each in notes if "a line above the rows says" in each]
    assert len(written) == bool(note)
    assert all(note in each for each in written)


def test_sides_of_a_pressed_block_are_no_area_by_themselves(tmp_path):
    """Width and thickness of 20 and 10 mm, pressed along the thickness: the area is 400 mm^2."""
    rows = "".join(f"{0.1 * k:.1f},{4 * k}\n" for k in range(1, 21))
    above = "Width: 20 mm\nThickness: 10 mm\nLength: 20 mm\n"
    (tmp_path / "a.csv").write_text(f"{above}d,F\n{rows}")
    size = 'area = "400 mm^2"\nlength = "10 mm"\n'
    file = declared(tmp_path, {"displacement": "d", "force": "F"}, 3, "compression", size)
    notes = study.calibrate(file, data=tmp_path).notes
    assert not [note for note in notes if "a line above the rows says" in note]
