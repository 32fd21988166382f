"""One state, recorded in every way that a file may record it, is one curve."""

from dataclasses import replace

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.measurement.measurement_section import Columns, MeasurementSpec, Units
from study.mechanics.measurement.reading import read_measurements
from study.mechanics.measurement.recording import Gauge, Recording, displacement_and_force

PULLED = Gauge(area_mm2=4.0, length_mm=20.0, mode="uniaxial", sense=1.0, is_homogeneous=True)
#: elongation 5 mm and 12 N of a gauge section of 20 mm and 4 mm^2: l = 1.25, P = 3 MPa
DEFORMED = {"displacement": 5.0, "stretch": 1.25, "strain": 0.25, "true_strain": np.log(1.25)}
RESISTED = {"force": 12.0, "stress": 3.0, "true_stress": 3.0 * 1.25}


def rows(kinematic, deformed, kinetic, resisted, gauge):
    pair = np.array(deformed), np.array(resisted)
    recording = Recording("a.csv", {}, *pair, quantities=(kinematic, kinetic))
    return displacement_and_force(recording, gauge)


@pytest.mark.parametrize("kinetic", RESISTED)
@pytest.mark.parametrize("kinematic", DEFORMED)
def test_every_pair_of_columns_is_the_same_curve(kinematic, kinetic):
    d, f = rows(kinematic, [DEFORMED[kinematic]], kinetic, [RESISTED[kinetic]], PULLED)
    assert d == pytest.approx([5.0], rel=1e-14)
    assert f == pytest.approx([12.0], rel=1e-14)


@pytest.mark.parametrize("kinetic", RESISTED)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("kinematic", ["displacement", "strain", "true_strain"])
def test_a_shortening_is_the_same_curve_with_either_sign(kinematic, sign, kinetic):
    """Shortened by 5 mm and 12 N: l = 0.75, P = 3 MPa, and a true stress of 3 x 0.75 MPa."""
    pressed = replace(PULLED, sense=-1.0)
    shortened = {"displacement": 5.0, "strain": 0.25, "true_strain": -np.log(0.75)}
    resisted = {**RESISTED, "true_stress": 3.0 * 0.75}
    d, f = rows(kinematic, [0.0, sign * shortened[kinematic]], kinetic, [0.0, resisted[kinetic]],
                pressed)  # fmt: skip
    if (kinematic, kinetic) != ("displacement", "force"):  # these stay as they were recorded
        assert d == pytest.approx([0.0, 5.0], rel=1e-14)
    assert f == pytest.approx([0.0, 12.0], rel=1e-14)


def test_volume_and_pressure():
    """J = 0.729 is a stretch of 0.9; a pressure of 2 MPa on faces of 0.81 x 4 mm^2 is 6.48 N."""
    pressed = Gauge(4.0, 20.0, "volumetric", -1.0, True)
    d, f = rows("volume_ratio", [0.729], "pressure", [2.0], pressed)
    assert d == pytest.approx([2.0], rel=1e-12)
    assert f == pytest.approx([6.48], rel=1e-12)


@pytest.mark.parametrize(
    ("kinematic", "kinetic", "gauge", "words"),
    [
        ("stretch", "pressure", PULLED, "belongs to volumetric"),
        ("volume_ratio", "stress", PULLED, "no meaning in uniaxial loading"),
        ("stretch", "stress", None, "the same everywhere"),
        ("stretch", "stress", Gauge(4.0, 20.0, "uniaxial", -1.0, False), "bonded"),
    ],
)
def test_columns_without_meaning_are_refused(kinematic, kinetic, gauge, words):
    with pytest.raises(InputError, match=words):
        rows(kinematic, [1.1], kinetic, [1.1], gauge)


TABLE = MeasurementSpec(
    Columns(stretch="1", stress="2"), Units(stretch="1", stress="kPa"), file="ut.txt", points="raw",
    header=False,
)  # fmt: skip
COMMENTED = {
    "columns": Columns(stretch="l", stress="P"), "header": True, "skip_lines": 1, "comment": "#",
    "delimiter": "space",
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "changes"),
    [
        ("1.0, 0.0\n1.1, 0.1\n1.3, 0.31\n2.0, 0.55\n", {}),
        ("  1.0  0\n1.1\t0.1\n\n1.3 0.31\n2 0.55", {}),
        ("1.0;0\n1.1;0.1\n1.3;0.31\n2;0.55", {}),
        ("digitised 1944\n# UT\nl P\n1.0 0.0\n1.3 0.31\n# a gap\n1.1 0.1\n2.0 0.55\n", COMMENTED),
    ],
)
def test_every_row_of_a_text_counts_once_at_its_own_place(tmp_path, text, changes):
    """Columns without names have numbers, whatever parts them; lines keep theirs."""
    spec = replace(TABLE, **changes)
    (tmp_path / "ut.txt").write_text(text)
    curve = read_measurements(spec, tmp_path, gauge=PULLED).curve().curve
    assert curve.displacement_mm == pytest.approx([0.0, 2.0, 6.0, 20.0], rel=1e-12)
    assert curve.force_N == pytest.approx([0.0, 0.4e-3, 1.24e-3, 2.2e-3], rel=1e-12)
    (tmp_path / "ut.txt").write_text(text.replace("0.31", "high"))
    with pytest.raises(InputError, match=f"ut.txt:{text.split('0.31')[0].count(chr(10)) + 1}:"):
        read_measurements(spec, tmp_path, gauge=PULLED)
    if not changes:
        with pytest.raises(InputError, match="holds numbers: write header = false"):
            read_measurements(replace(spec, header=True), tmp_path, gauge=PULLED)


@pytest.mark.parametrize(
    ("kinematic", "values", "said"),
    [
        ("strain", [0.0, 150.0], "a stretch of 151"),
        ("strain", [0.0, -30.0], "leaves nothing of the specimen"),
        ("true_strain", [0.0, 4.0], "a stretch of 54.6"),
        ("stretch", [100.0, 250.0], "a stretch of 250"),
    ],
)
def test_per_cent_taken_for_a_ratio_is_refused(kinematic, values, said):
    with pytest.raises(InputError, match=said) as caught:
        rows(kinematic, values, "stress", [0.0, 1.0], PULLED)
    assert f'units = {{ {kinematic} = "%" }}' in str(caught.value)


def test_a_stretch_of_a_tough_gel_is_none_of_per_cent():
    d, _ = rows("stretch", [1.0, 18.0], "stress", [0.0, 1.0], PULLED)
    assert d == pytest.approx([0.0, 340.0])
