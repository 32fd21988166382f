"""Coordinates of the machine: put into those of the specimen by what is declared, or refused."""

import re

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.measurement.conditioning import slack_end
from study.mechanics.measurement.measurement_section import Range
from study.mechanics.measurement.reading import read_measurements
from study.mechanics.measurement.recording import Gauge
from tests.record.samples import Spec

#: 6 mm of travel, 3 N/mm: what every file below records in its own coordinates
DEPTH = np.linspace(0.0, 6.0, 25)
STIFFNESS = 3.0
GAUGE = Gauge(20.0, 25.0, "uniaxial", 1.0, True)


def write(folder, place, force):
    rows = (f"{d:.6f},{f:.6f}\n" for d, f in zip(place, force, strict=True))
    (folder / "a.csv").write_text("d,f\n" + "".join(rows))


def spec(**changes):
    return Spec(**{"range": None, "points": "raw", **changes})


def read(folder, **changes):
    return read_measurements(spec(**changes), folder)


def stiffness(folder, **changes):
    found = read(folder, **changes).curve().curve
    d, f = found.displacement_mm, found.force_N
    return float(d @ f / (d @ d)), d.size


@pytest.mark.parametrize("start", [12.5, -40.0, 0.5])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_a_position_is_refused_until_its_zero_is_declared(tmp_path, start, way, turn):
    write(tmp_path, start + way * DEPTH, turn * STIFFNESS * DEPTH)
    sign = "positive" if turn > 0 else "negative"
    with pytest.raises(InputError, match="displacement_zero") as caught:
        read(tmp_path, sign=sign)
    assert f"unloaded at {start:g} mm" in str(caught.value)
    word = "rising" if way > 0 else "falling"
    for zero in ("first row", start):
        for direction in ("auto", word):
            declared = {"displacement_zero": zero, "direction": direction, "sign": sign}
            assert stiffness(tmp_path, **declared) == (pytest.approx(STIFFNESS, rel=1e-6), 25)
    notes = "\n".join(read(tmp_path, displacement_zero="first row", sign=sign).notes)
    assert f"displacement counts from {start:g} mm (first row), {word}" in notes
    other = "falling" if way > 0 else "rising"
    with pytest.raises(InputError, match=f'direction = "{word}"'):
        read(tmp_path, displacement_zero="first row", direction=other, sign=sign)


@pytest.mark.parametrize("approach", [1.0, 10.0])
@pytest.mark.parametrize("sign", ["positive", "negative"])
def test_an_approach_of_any_length_is_set_aside_and_counted(tmp_path, approach, sign):
    """Loading at 3 N/mm, unloading at 2.4 N/mm: the branches are never averaged."""
    turn = 1.0 if sign == "positive" else -1.0
    before = np.arange(-approach, 0.0, 0.25)
    place = np.r_[before, DEPTH, DEPTH[::-1], before[::-1]]
    force = np.r_[0 * before, 3.0 * DEPTH, 2.4 * DEPTH[::-1], 0 * before]
    write(tmp_path, place, turn * force)
    value, rows = stiffness(tmp_path, sign=sign)
    assert (value, rows) == (pytest.approx(STIFFNESS, rel=1e-6), 25)
    notes = "\n".join(read(tmp_path, sign=sign).notes)
    assert f"{25 + before.size} rows after the first loading left out" in notes
    assert f"{before.size} rows before displacement zero set aside" in notes
    # the same recorded as a position
    write(tmp_path, place + 80.0, turn * force)
    value, rows = stiffness(tmp_path, sign=sign, displacement_zero="contact")
    assert (value, rows) == (pytest.approx(STIFFNESS, rel=1e-6), 25)


#: force over the largest one at a share of the travel; whether it rises at once
LAWS = {
    "rubber in tension": (lambda x: x + 1 - (1 + x) ** -2.0, True),
    "rubber in compression": (lambda x: (1 - 0.3 * x) ** -2.0 - 1 + 0.3 * x, True),
    "tissue that stiffens": (lambda x: np.expm1(5 * x), False),
    "a sphere on a half-space": (lambda x: x**1.5, False),
    "a cone on a half-space": (lambda x: x**2.0, False),
}


@pytest.mark.parametrize("law", LAWS)
def test_slack_is_told_from_a_law_that_is_soft_at_first(law):
    """Noise of .2 % among 120 rows, 40 draws: no sound test is called slack; 6 % is found."""
    curve, at_once = LAWS[law]
    rng, x = np.random.default_rng(8), np.linspace(0.0, 1.0, 120)
    ends = {}
    for slack in (0.0, 0.06):
        force = curve(np.maximum(x - slack, 0.0) / (1 - slack)) / curve(1.0)
        draws = [slack_end(x, force + 0.002 * rng.normal(size=x.size)) for _ in range(40)]
        ends[slack] = [end for end in draws if end is not None]
    assert not ends[0.0]
    if at_once:
        assert len(ends[0.06]) == 40
        assert ends[0.06] == pytest.approx([0.06] * 40, abs=0.01)


@pytest.mark.parametrize("approach", [0.25, 0.4, 0.6])
def test_an_approach_longer_than_a_fifth_of_the_travel_is_told_in_noise(approach):
    """Noise of .3 % among 120 rows, 20 draws; a law that stiffens has no corner."""
    rng, x = np.random.default_rng(18), np.linspace(0.0, 1.0, 120)
    for law in ("rubber in tension", "tissue that stiffens"):
        curve, at_once = LAWS[law]
        force = curve(np.maximum(x - approach, 0.0) / (1 - approach)) / curve(1.0)
        ends = [slack_end(x, force + 0.003 * rng.normal(size=x.size)) for _ in range(20)]
        if at_once:
            assert ends == pytest.approx([approach] * 20, abs=0.02)
        else:
            assert ends == [None] * 20


def test_the_standard_error_of_a_contact_is_that_of_its_draws(tmp_path):
    """Noise of .5 % among 161 rows, 40 draws about a contact at 3.9 mm, none upon a row."""
    rng, place = np.random.default_rng(18), np.linspace(0.0, 10.0, 161)
    contacts, errors = [], []
    for _ in range(40):
        force = 3.0 * np.maximum(place - 3.9, 0.0)
        write(tmp_path, place, force + 0.005 * force.max() * rng.normal(size=place.size))
        text = "\n".join(read(tmp_path, displacement_zero="contact").notes)
        found = re.search(r"from (\S+) mm .contact, standard error (\S+) mm", text)
        contacts.append(float(found[1]))
        errors.append(float(found[2]))
    off = np.array(contacts) - 3.9
    assert np.sqrt(np.mean(off**2)) == pytest.approx(np.mean(errors), rel=0.4)


@pytest.mark.parametrize("power", [1.5, 2.0])
def test_a_contact_is_found_by_the_law_of_its_indenter(tmp_path, power):
    """A force that sets in without a slope: 20 draws, .3 % noise, contact at 3.93 mm."""
    rng, place = np.random.default_rng(18), np.linspace(0.0, 10.0, 161)
    gauge = Gauge(1000.0, 25.0, "uniaxial", -1.0, False, onset_power=power)
    contacts, errors = [], []
    for _ in range(20):
        force = np.maximum(place - 3.93, 0.0) ** power
        write(tmp_path, place, force + 0.003 * force.max() * rng.normal(size=place.size))
        read_as = spec(displacement_zero="contact")
        test = read_measurements(read_as, tmp_path, gauge=gauge).tests[0]
        contacts.append(-test.specimen.displacement_mm[0])
        errors.append(test.contact_error_mm)
    off = np.array(contacts) - 3.93
    assert np.sqrt(np.mean(off**2)) == pytest.approx(np.mean(errors), rel=0.5)
    assert abs(off.mean()) < np.mean(errors)


def test_the_load_cell_is_zeroed_by_the_whole_approach_where_contact_is_declared(tmp_path):
    """Twice as many rows as the first tenth, and no slope: its mean, to a rounding."""
    place = np.linspace(0.0, 10.0, 101)
    wave = 0.02 * np.where(np.arange(101) % 2, 1.0, -1.0)
    write(tmp_path, place, 0.5 + wave * (place < 3.95) + 3.0 * np.maximum(place - 4.0, 0.0))
    test = read(tmp_path, displacement_zero="contact", zero="fit").tests[0]
    assert test.zero_N == pytest.approx(0.5, abs=1.5e-3)


def test_rows_out_of_order_are_sorted_and_told(tmp_path):
    """In any order, or a single row at the wrong end: no test that starts again."""
    order = np.random.default_rng(3).permutation(25)
    for rows in (order, np.r_[24, np.arange(24)]):
        write(tmp_path, DEPTH[rows], STIFFNESS * DEPTH[rows])
        assert stiffness(tmp_path) == (pytest.approx(STIFFNESS, rel=1e-9), 25)
        assert any("rows out of order sorted" in note for note in read(tmp_path).notes)
    back = np.r_[np.arange(1, 25), 0]  # the last row may be the way back
    write(tmp_path, DEPTH[back], STIFFNESS * DEPTH[back])
    assert stiffness(tmp_path) == (pytest.approx(STIFFNESS, rel=1e-9), 24)
    twice = np.r_[np.arange(25), np.arange(25)]
    write(tmp_path, DEPTH[twice], STIFFNESS * DEPTH[twice])
    with pytest.raises(InputError, match="starts again"):
        read(tmp_path)


@pytest.mark.parametrize("law", [*LAWS, "a rounded maximum"])
def test_a_load_cell_whose_limit_trembles_is_told_from_a_law_that_bends(tmp_path, law):
    """Readings within .01 % of the limit over the last tenth; 121 rows."""
    x = np.linspace(0.0, 1.0, 121)
    curve = (lambda v: v * (2.0 - v)) if law == "a rounded maximum" else LAWS[law][0]
    force = curve(x) / curve(1.0)
    write(tmp_path, 6 * x, force)
    assert read(tmp_path).curve().curve.force_N.size == 121
    if law == "a rounded maximum":
        return
    limit = force[108]
    trembling = limit * (1 + 1e-4 * np.random.default_rng(2).standard_normal(121))
    write(tmp_path, 6 * x, np.where(force > limit, trembling, force))
    with pytest.raises(InputError, match=r'at its limit(?s:.*)range = ."0 mm", "5\.35 mm"'):
        read(tmp_path)


def test_a_preload_is_no_reading_of_the_load_cell(tmp_path):
    """Displacement was set to 0 after 0.8 mm: the line says what to write, and that is right."""
    write(tmp_path, DEPTH, STIFFNESS * (DEPTH + 0.8))
    assert any("displacement_zero with the way that it had gone" in n for n in read(tmp_path).notes)
    declared = {"displacement_zero": -0.8}
    assert stiffness(tmp_path, **declared) == (pytest.approx(STIFFNESS, rel=1e-6), 25)


def test_the_range_before_a_saturated_load_cell_holds_no_row_at_its_limit(tmp_path):
    """Of seven rows the fifth is the first at the limit, and its true force is not known."""
    place = np.linspace(0.0, 6.0, 13)
    write(tmp_path, place, np.minimum(STIFFNESS * place, 7.0))
    with pytest.raises(InputError, match="at its limit") as caught:
        read(tmp_path)
    ends = re.search(r'range = ."(\S+) mm", "(\S+) mm"', str(caught.value))
    declared = Range("mm", float(ends[1]), float(ends[2]))
    assert stiffness(tmp_path, range=declared) == (pytest.approx(STIFFNESS, rel=1e-12), 5)


def test_a_test_through_zero_is_one_test_or_split_by_its_ranges(tmp_path):
    place = np.linspace(-5.0, 10.0, 31)
    write(tmp_path, place, STIFFNESS * place)
    found = read_measurements(spec(), tmp_path, gauge=GAUGE).curve()
    assert found.curve.displacement_mm == pytest.approx(place, abs=1e-6)
    assert found.curve.force_N == pytest.approx(STIFFNESS * place, abs=1e-5)
    assert found.rows.as_dict() == {"read": 31, "used": 31, "set_aside": []}
    # the first row is loaded: it says nothing of the load cell
    with pytest.raises(InputError, match="runs through zero"):
        read_measurements(spec(zero="first"), tmp_path, gauge=GAUGE)
    tension = spec(range=Range("mm", 0.0, 10.0))
    assert len(read_measurements(tension, tmp_path, gauge=GAUGE).curve().curve) == 21
    write(tmp_path, -place, STIFFNESS * place)  # the sense of compression
    pressed = spec(range=Range("mm", 0.0, 5.0), sign="negative")
    found = read_measurements(pressed, tmp_path, gauge=GAUGE).curve()
    assert len(found.curve) == 11
    assert found.curve.force_N == pytest.approx(STIFFNESS * found.curve.displacement_mm, rel=1e-9)
    assert found.rows.aside == {"before displacement zero": 20}


#: up to 6 mm, back to 1 mm, and again: stiffnesses of each way
CYCLES = (("loading", 1, 3.0), ("unloading", 1, 2.4), ("loading", 2, 2.6), ("unloading", 2, 2.2))


def write_cycles(folder, ways=CYCLES):
    up = np.linspace(1.0, 6.0, 21)
    first = [DEPTH, up[-2::-1], up[1:], up[-2::-1]][: len(ways)]
    place = np.concatenate(first)
    force = np.concatenate([k * d for d, (_, _, k) in zip(first, ways, strict=True)])
    write(folder, place, force)


@pytest.mark.parametrize(
    ("declared", "stiff", "rows"),
    [
        ({}, 3.0, 25),
        ({"branch": "loading"}, 3.0, 25),
        ({"branch": "unloading"}, 2.4, 20),
        ({"branch": 1}, 3.0, 25),
        ({"branch": 2}, 2.6, 20),
        ({"branch": 2, "cycle": "unloading"}, 2.2, 20),
    ],
)
def test_a_branch_is_chosen_and_the_other_rows_are_counted(tmp_path, declared, stiff, rows):
    write_cycles(tmp_path)
    assert stiffness(tmp_path, **declared) == (pytest.approx(stiff, rel=1e-6), rows)
    found = read(tmp_path, **declared)
    count = found.curve().rows
    assert (count.read, count.used, sum(count.aside.values())) == (85, rows, 85 - rows)
    assert len(count.aside) == 3
    notes = "\n".join(found.notes)
    assert f"85 rows read, {rows} used, {85 - rows} set aside: " in notes
    assert "of cycle" in notes
    assert "(lines " in notes
    with pytest.raises(InputError, match="no loading of cycle 3: it holds loading of cycle 1"):
        read(tmp_path, branch=3)


def test_a_recording_that_begins_loaded_is_refused_with_its_readings(tmp_path):
    """From 6 mm back to 0 and up again with another stiffness: either may be meant."""
    place = np.r_[DEPTH[::-1], DEPTH[1:]]
    write(tmp_path, place, np.r_[2.4 * DEPTH[::-1], 3.0 * DEPTH[1:]])
    with pytest.raises(InputError, match="which of its branches is meant is open") as caught:
        read(tmp_path)
    assert "unloading before any loading, 6 to 0 mm" in str(caught.value)
    assert "loading of cycle 1" in str(caught.value)
    assert stiffness(tmp_path, branch="loading") == (pytest.approx(3.0, rel=1e-6), 24)
    assert stiffness(tmp_path, branch="unloading") == (pytest.approx(2.4, rel=1e-6), 25)


def test_a_torn_specimen_is_named_and_its_range_written(tmp_path):
    force = STIFFNESS * DEPTH
    force[20:] *= 0.2
    write(tmp_path, DEPTH, force)
    with pytest.raises(InputError, match="the specimen tore") as caught:
        read(tmp_path)
    assert 'range = ["0 mm", "4.75 mm"]' in str(caught.value)
    assert stiffness(tmp_path, range=Range("mm", 0.0, 4.75))[1] == 20
    force = STIFFNESS * DEPTH
    force[12] *= 5  # one wrong row is no rupture
    write(tmp_path, DEPTH, force)
    assert len(read(tmp_path).curve().curve) == 25


def test_keys_of_displacement_are_refused_for_a_stretch(tmp_path):
    (tmp_path / "a.csv").write_text("l,s\n1,0\n1.1,1\n1.2,2\n")
    stretch = spec(
        columns={"stretch": "l", "stress": "s"},
        units={"stretch": "1", "stress": "MPa"},
        displacement_zero="first row",
    )
    with pytest.raises(InputError, match="belongs to a column of displacement"):
        read_measurements(stretch, tmp_path, gauge=GAUGE)


BACK = np.arange(6.0, -4.0, -0.25)[1:]
#: place, force, and what is set aside of each
COURSES = {
    # the peak stands twice, with the force of either branch
    "unloading": (
        np.r_[DEPTH, DEPTH[::-1]], np.r_[3.0 * DEPTH, 2.4 * DEPTH[::-1]],
        {"unloading of cycle 1": 25},
    ),
    # the machine returns beyond its start
    "return": (
        np.r_[DEPTH, BACK], np.r_[3.0 * DEPTH, 2.4 * np.maximum(BACK, 0.0)],
        {"unloading of cycle 1": BACK.size},
    ),
    "falling": (DEPTH[::-1], 3.0 * DEPTH[::-1], {}),
    # the force relaxes to half while the machine stands at 6 mm
    "hold": (
        np.r_[DEPTH, np.full(40, 6.0)],
        np.r_[3.0 * DEPTH, 9.0 + 9.0 * np.exp(-np.arange(1, 41) / 10.0)], {"hold of cycle 1": 40},
    ),
    # readings that were repeated at every place are no hold
    "repeated": (np.repeat(DEPTH, 5), np.repeat(3.0 * DEPTH, 5), {}),
}  # fmt: skip


@pytest.mark.parametrize("course", COURSES)
def test_rows_of_the_first_loading_alone_count(tmp_path, course):
    place, force, aside = COURSES[course]
    write(tmp_path, place, force)
    found = read(tmp_path).curve()
    assert found.rows.aside == aside
    assert found.rows.used == place.size - sum(aside.values())
    d, f = found.curve.displacement_mm, found.curve.force_N
    assert (d[-1], f[-1]) == (pytest.approx(6.0), pytest.approx(18.0, rel=1e-12))
    assert d @ f / (d @ d) == pytest.approx(3.0, rel=1e-6)
    assert not any("out of order" in note for note in read(tmp_path).notes)
    # all of them where that is written
    every = read(tmp_path, branch="all").curve().rows
    assert every.used == np.count_nonzero(place >= 0)
    assert not any("cycle" in rows for rows in every.aside)


def test_repeats_at_other_places_share_a_grid_and_specimens_do_not(tmp_path):
    """Two specimens of two runs each: no two runs were recorded at the same displacements."""
    rows = []
    for specimen, stiff in (("A", 3.0), ("B", 4.0)):
        for run, size in ((1, 25), (2, 31)):
            place = np.linspace(0.0, 6.0, size)
            rows += [f"{specimen},{run},{d:.6f},{stiff * d:.6f}\n" for d in place]
    (tmp_path / "a.csv").write_text("specimen,run,d,f\n" + "".join(rows))
    several = spec(block="specimen", average=("run",))
    with pytest.raises(InputError, match="raw rows lie at other displacements"):
        read_measurements(several, tmp_path)
    found = read_measurements(several, tmp_path, own_rows=True)
    for specimen, stiff in (("A", 3.0), ("B", 4.0)):
        curve = found.curve(specimen)
        assert len(curve.curve) == 200
        assert curve.curve.force_N == pytest.approx(stiff * curve.curve.displacement_mm, abs=1e-5)
        assert (curve.rows.read, curve.rows.used) == (56, 56)
    one = "".join(row for row in rows if row.split(",")[1] == "2")
    (tmp_path / "a.csv").write_text("specimen,run,d,f\n" + one + "C,1,0,0\nC,1,1,3\nC,1,2,6\n")
    found = read_measurements(spec(block="specimen"), tmp_path, own_rows=True)
    assert [len(found.curve(label).curve) for label in "ABC"] == [31, 31, 3]
