"""``study tracking`` end to end: what was put into virtual recordings is found again."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom
from scipy.stats import f as f_distribution

import study
from study import api
from study.ground.errors import InputError
from study.laboratory.tracker.tracker_recording import (
    STAGES,
    Errors,
    load_tracking,
    write_recording,
)
from tests.cli.small import success
from tests.registration.bodies import cap
from tests.tracker_accuracy import virtual

DISTANCE = """
schema = 1
[recording]
file = "markers.csv"
unit = "mm"
time = "time"
stage = "stage"
markers = { a = ["ax", "ay", "az"], b = ["bx", "by", "bz"] }
[distance]
markers = ["a", "b"]
reference = "50 mm"
uncertainty = "0.005 mm"
practical = "0.1 mm"
"""
DISPLACEMENT = """
schema = 1
[recording]
file = "stage.csv"
unit = "mm"
stage = "stop"
markers = { tip = ["x", "y", "z"] }
[displacement]
marker = "tip"
commanded = "commanded"
uncertainty = "0.002 mm"
"""
REFERENCE = """
schema = 1
[recording]
file = "poses.csv"
unit = "mm"
stage = "pose"
markers = { body = ["x", "y", "z"] }
[reference]
file = "laser.csv"
marker = "body"
stage = "pose"
position = ["ox", "oy", "oz"]
axes = [["ax", "ay", "az"], ["bx", "by", "bz"]]
"""
MARKERS = "time,stage,ax,ay,az,bx,by,bz"
LASER = "pose,ox,oy,oz,ax,ay,az,bx,by,bz"


def distance_study(folder, seed, drift=0.0, **errors):
    rows = virtual.rows_of(Errors(seed, **errors), 50.0, drift_mm_per_h=drift)
    virtual.write(folder / "markers.csv", MARKERS, rows)
    (folder / "distance.toml").write_text(DISTANCE)
    return folder / "distance.toml"


def displacement_study(folder, sd, bow_mm=0.0):
    errors = Errors(3, passes=3, samples=3, scale=1.0, stop_sd_mm=sd, sample_sd_mm=0.0)
    rows = virtual.rows_of(errors, bow_mm=bow_mm)
    virtual.write(folder / "stage.csv", "time,stop,commanded,x,y,z", rows)
    (folder / "displacement.toml").write_text(DISPLACEMENT)
    return folder / "displacement.toml"


def reference_study(folder, seed, arm, turn, noise):
    seen, known = virtual.pose_rows(seed, arm, turn, noise)
    virtual.write(folder / "poses.csv", "pose,x,y,z", seen)
    virtual.write(folder / "laser.csv", LASER, known)
    (folder / "reference.toml").write_text(REFERENCE)
    return folder / "reference.toml"


def test_the_command_writes_a_page_and_one_document(tmp_path):
    command = ("tracking", distance_study(tmp_path, 1), "--reports", tmp_path / "reports")
    found = success(*command, "--json").json
    page = Path(found["report"]).read_text()
    assert "Figure missing" not in page
    assert not [word for word in ("https:", "src=") if word in page]
    assert page.count("<script") == 1  # the one that sorts tables
    assert [one["stage"] for one in found["distance"]["stages"]] == [name for name, _ in STAGES]
    data = Path(found["report"].replace(".html", "-data"))
    assert json.loads((data / "numbers.json").read_text())["distance"] == found["distance"]
    for table in data.glob("*.csv"):  # numbers in cells of their own, no values of Python
        assert "(" not in table.read_text()
    # the question is whether stages differ: its answer comes first
    shown = success(*command).out
    assert shown.startswith("Stages differ by up to")
    assert "matters" in shown


def test_the_error_term_is_stage_by_pass(tmp_path):
    """F of stages within passes, by the sums of squares of a randomized block by hand."""
    file = distance_study(tmp_path, 2)
    found = study.tracking(file).distance
    rows = virtual.rows_of(Errors(2), 50.0)
    length = np.array([np.linalg.norm(np.subtract(r[5:], r[2:5])) for r in rows])
    # of the ten stops of a pass the stages have 1, 4, 1 and 4, with 40 samples each
    parts = np.split(length.reshape(6, 400), [40, 200, 240], axis=1)
    cells = np.column_stack([part.mean(axis=1) for part in parts])
    stage = 6 * ((cells.mean(axis=0) - cells.mean()) ** 2).sum() / 3
    rest = cells - cells.mean(axis=0) - cells.mean(axis=1, keepdims=True) + cells.mean()
    f = stage / ((rest**2).sum() / 15)
    row = found.comparison.anova.rows[0]
    assert row.f == pytest.approx(f, rel=1e-9)
    assert row.p == pytest.approx(f_distribution.sf(f, 3, 15), rel=1e-6)
    assert found.comparison.effects[0].range == pytest.approx(Errors().bias_mm, abs=0.06)
    assert found.comparison.effects[0].verdict == "matters"


def test_samples_are_not_taken_for_independent(tmp_path):
    """A serial correlation of 0.8 makes a sample worth (1 - 0.8) / (1 + 0.8) of one."""
    found = study.tracking(distance_study(tmp_path, 3, passes=4, samples=800)).distance
    rest = found.stages[0]
    assert rest.independent / rest.samples == pytest.approx(1 / 9, rel=0.3)
    # of a difference of two markers
    assert rest.sd_mm == pytest.approx(np.sqrt(2) * Errors().sample_sd_mm, rel=0.1)


def test_a_drift_is_found_and_none_is_not_invented(tmp_path):
    drifting = study.tracking(distance_study(tmp_path, 4, drift=20.0)).distance.drift
    assert drifting.interval[0] < 20 < drifting.interval[1]
    assert drifting.p < 1e-3
    steady = study.tracking(distance_study(tmp_path, 5)).distance.drift
    assert steady.interval[0] < 0 < steady.interval[1]


def test_stages_visited_once_are_not_compared(tmp_path):
    found = study.tracking(distance_study(tmp_path, 6, passes=1)).distance
    assert found.comparison is None
    assert "visited once" in found.comparison_note
    assert found.bias_interval_mm is not None  # the four stages are four visits
    assert all(one.interval_mm is None for one in found.stages)


def test_the_standard_of_two_spheres_is_their_distance(tmp_path):
    file = distance_study(tmp_path, 7)
    rng = np.random.default_rng(7)
    centers = np.array([[10.0, 20, 30], [10.0, 20, 80]])
    for name, center in zip("ab", centers, strict=True):
        points = cap(center, 6.0, 0.3, 300, 0.02, rng)
        virtual.write(tmp_path / f"sphere-{name}.csv", "x,y,z", points)
    text = DISTANCE.replace('reference = "50 mm"', 'spheres = ["sphere-a.csv", "sphere-b.csv"]')
    file.write_text(text.replace('uncertainty = "0.005 mm"\n', ""))
    standard = study.tracking(file).distance.standard
    assert abs(standard.distance_mm - 50) < 3 * standard.uncertainty_mm
    assert 0.001 < standard.uncertainty_mm < 0.02


def test_the_straightness_is_that_put_in(tmp_path):
    found = study.tracking(displacement_study(tmp_path, sd=0.0, bow_mm=0.5)).displacement
    # stops lie evenly about the middle of the way: the line of least squares is parallel to it
    told = np.concatenate([stops for _, stops in STAGES]) / 50
    arc = 0.5 * 4 * told * (1 - told)
    assert found.straightness_rms_mm == pytest.approx(arc.std(), rel=1e-3)
    assert found.repeatability_mm == pytest.approx(0, abs=1e-9)


def test_limits_of_agreement_are_mean_and_deviation(tmp_path):
    found = study.tracking(displacement_study(tmp_path, sd=0.03)).displacement
    difference = found.measured_mm - found.commanded_mm
    assert found.agreement.bias == pytest.approx(difference.mean())
    assert found.agreement.upper - found.agreement.lower == pytest.approx(
        2 * 1.959964 * difference.std(ddof=1), rel=1e-6
    )


def test_the_lever_arm_put_in_is_found(tmp_path):
    arm = np.array([30.0, -50, 80])
    file = reference_study(tmp_path, 8, arm, turn=15.0, noise=0.1)
    found = study.tracking(file).reference
    assert np.abs(found.lever_arm.arm_mm - arm).max() < 4 * found.lever_arm.uncertainty_mm.max()
    # without it the body's turning moves the marker by centimeters
    assert found.fit.rms > 5
    assert found.lever_arm.rms_mm < 0.3
    assert found.lever_arm.left_out_rms_mm < 0.4
    written = found.to_json()["registration"]["rotation"]
    assert written == found.fit.motion.rotation.tolist()


def test_an_arm_that_the_poses_cannot_show_does_no_harm(tmp_path):
    file = reference_study(tmp_path, 9, np.array([30.0, -50, 80]), turn=0.0, noise=0.2)
    found = study.tracking(file).reference
    assert found.fit.localization_error == pytest.approx(0.2 * np.sqrt(3), rel=0.3)
    assert found.left_out_rms_mm < 0.6


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        (DISTANCE.replace('["a", "b"]', '["a", "c"]'), "no marker 'c'"),
        (DISTANCE.replace("[distance]", "[distanse]"), "unknown key"),
        (DISTANCE.replace('"50 mm"', "50"), "needs a unit"),
        (DISTANCE.split("[distance]")[0], "nothing says what to compare"),
        (DISTANCE.replace("schema = 1", ""), "schema"),
        (DISTANCE.replace('"ax", "ay", "az"', '"ax", "ay"'), "must be the columns of x, y and z"),
    ],
    ids=["marker", "table", "unit", "nothing", "schema", "columns"],
)
def test_a_faulty_file_is_refused_with_its_place(tmp_path, text, rule):
    file = distance_study(tmp_path, 1)
    file.write_text(text)
    with pytest.raises(InputError, match=rule):
        study.tracking(file)


def test_time_that_goes_backwards_is_refused_with_its_line(tmp_path):
    file = distance_study(tmp_path, 1)
    lines = (tmp_path / "markers.csv").read_text().splitlines()
    lines[10], lines[11] = lines[11], lines[10]
    (tmp_path / "markers.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"markers.csv:12: the time goes backwards"):
        study.tracking(file)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ("lost", r"marker b: 2 of 2400 rows stand at 0, 0, 0 mm, far from all others"),
        ("coded", r"marker b: 2 of 2400 rows stand at -9999, -9999, -9999 mm"),
        ("exchanged", r"markers.csv:12: the markers a and b change places, at 2 rows in all"),
        ("stamps in ms", "'time_ms' says ms, and it is read in s"),
        ("metres", r"'bx \[m\]' says m, and it is read in mm"),
    ],
)
def test_rows_that_are_no_places_of_their_marker_are_refused(tmp_path, change, rule):
    """Lost markers written as zeros gave a bias of 9.6 [5.2, 13.9] mm, of none."""
    file = distance_study(tmp_path, 1)
    lines = (tmp_path / "markers.csv").read_text().splitlines()
    for k in (10, 500) if change in ("lost", "coded") else ():
        place = "0" if change == "lost" else "-9999"
        lines[k] = ",".join([*lines[k].split(",")[:5], place, place, place])
    if change == "exchanged":
        for k in (11, 12, 13):
            time, stage, *places = lines[k].split(",")
            lines[k] = ",".join([time, stage, *places[3:], *places[:3]])
    if change == "stamps in ms":
        lines[0] = lines[0].replace("time", "time_ms")
        file.write_text(DISTANCE.replace('"time"', '"time_ms"'))
    if change == "metres":
        lines[0] = lines[0].replace("bx", "bx [m]")
        file.write_text(DISTANCE.replace('"bx"', '"bx [m]"'))
    (tmp_path / "markers.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=rule):
        study.tracking(file)


def test_rows_without_a_place_of_a_marker_are_left_out_and_counted(tmp_path):
    """The answer is that of the file without these rows, and with all visits where they were."""
    file = distance_study(tmp_path, 1)
    header, *rows = (tmp_path / "markers.csv").read_text().splitlines()
    gone, nothing = range(7, 2400, 31), ("", "NaN", "-")
    kept = [row for k, row in enumerate(rows) if k not in gone]
    (tmp_path / "markers.csv").write_text("\n".join([header, *kept]) + "\n")
    without = study.tracking(file).distance
    for k in gone:
        rows[k] = ",".join([*rows[k].split(",")[:5], *[nothing[k % 3]] * 3])
    (tmp_path / "markers.csv").write_text("\n".join([header, *rows]) + "\n")
    assert study.tracking(file).distance.to_json() == without.to_json()
    said = success("tracking", file, "--reports", tmp_path).err
    note = "marker b: 78 of 2400 rows have no place of it and are left out"
    assert note in " ".join(said.split())


def test_a_marker_that_repeats_its_last_place_is_named(tmp_path):
    file = distance_study(tmp_path, 1)
    assert study.tracking(file).notes == ()
    lines = (tmp_path / "markers.csv").read_text().splitlines()
    for k in range(20, 60):
        lines[k] = ",".join([*lines[k].split(",")[:5], *lines[19].split(",")[5:]])
    (tmp_path / "markers.csv").write_text("\n".join(lines) + "\n")
    (note,) = study.tracking(file).notes
    assert note.startswith("marker b: 40 of 2400 rows repeat the place of the row before")


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ("drop", "poses do not pair: p3 is missing"),
        ("shuffle", "the poses do not pair"),
        ("mirror", "mirrored"),
        ("metres", "0.001 times as far apart"),
        ("few", "2 poses are too few"),
    ],
)
def test_poses_that_cannot_be_registered_are_refused(tmp_path, change, rule):
    file = reference_study(tmp_path, 8, np.zeros(3), turn=5.0, noise=0.1)
    seen, known = virtual.pose_rows(8, np.zeros(3), 5.0, 0.1)
    if change == "drop":
        known = [row for row in known if row[0] != "p3"]
    elif change == "shuffle":
        known = [[row[0], *other[1:]] for row, other in zip(known, known[::-1], strict=True)]
    elif change == "mirror":
        seen = [[p, x, y, -z] for p, x, y, z in seen]
    elif change == "metres":
        known = [[row[0], *(v / 1000 for v in row[1:])] for row in known]
    else:
        seen, known = seen[:10], known[:2]
    virtual.write(tmp_path / "poses.csv", "pose,x,y,z", seen)
    virtual.write(tmp_path / "laser.csv", LASER, known)
    with pytest.raises(InputError, match=rule):
        study.tracking(file)


VIVE = """
schema = 1
[recording]
file = "20200827_Exp1_tracker_samples.csv.gz"
unit = "m"
stage = "point"
markers = { tracker = ["x_m", "y_m", "z_m"] }
[reference]
file = "tracker_vs_laser_points.csv"
marker = "tracker"
stage = "point"
position = ["las_origin_x_mm", "las_origin_y_mm", "las_origin_z_mm"]
axes = [
    ["las_xaxis_x", "las_xaxis_y", "las_xaxis_z"], ["las_yaxis_x", "las_yaxis_y", "las_yaxis_z"],
]
"""


def test_a_real_tracker_against_a_laser_tracker(tmp_path, data_dir):
    """11 poses x 1001 samples; the figures beside the data were computed by its collector."""
    folder = data_dir / "tracker_vive_laser"
    if not folder.is_dir():
        pytest.skip(f"no recordings of a tracker in {data_dir}")
    (tmp_path / "vive.toml").write_text(VIVE)
    found = study.tracking(tmp_path / "vive.toml", data=folder).reference
    # they come from medians of the samples, these from means: 0.02 mm apart at most
    assert found.fit.rms == pytest.approx(6.87, abs=0.02)
    assert found.distance_error_mean_mm == pytest.approx(3.5, abs=0.05)
    assert found.distance_error_sd_mm == pytest.approx(6.9, abs=0.1)
    # the lever arm: what it explains is real, but the plate turned by 2.5 deg only
    arm = found.lever_arm
    assert arm.p < 0.01
    assert arm.rms_mm < found.fit.rms
    assert arm.left_out_rms_mm < found.left_out_rms_mm
    assert arm.uncertainty_mm[2] > np.abs(arm.arm_mm[2])


# The shipped tracker study, from the generator to the answer.


DESIGN = Path(__file__).parents[2] / "designs" / "tracker.toml"


def test_two_commands_lead_from_nothing_to_the_page(tmp_path):
    assert "study tracking" in success("virtual", tmp_path, "--from", DESIGN).err
    told = json.loads((tmp_path / "tracker" / "markers.csv.virtual.json").read_text())
    found = success("tracking", DESIGN, "--data", tmp_path, "--reports", tmp_path, "--json").json
    assert "Figure missing" not in Path(found["report"]).read_text()
    distance, displacement = found["distance"], found["displacement"]
    assert [one["stage"] for one in distance["stages"]] == [name for name, _ in STAGES]
    # the error term of stages within passes: one visit to each in every pass
    rows = {row["term"]: row for row in distance["comparison"]["anova"]["rows"]}
    assert rows["stage"]["df_error"] == (len(STAGES) - 1) * (told["errors"]["passes"] - 1)
    (effect,) = distance["comparison"]["effects"]
    assert effect["verdict"] == "matters"
    assert effect["range"] == pytest.approx(told["errors"]["bias_mm"], abs=0.03)
    low, high = displacement["line"]["scale_interval"]
    assert low < told["errors"]["scale"] < high


@pytest.mark.parametrize("studies", [10, pytest.param(20, marks=pytest.mark.slow)])
def test_intervals_hold_what_was_put_in_95_times_of_100(tmp_path, studies):
    declared, held = load_tracking(DESIGN), np.zeros(4)
    for seed in range(studies):
        errors = replace(Errors(seed), samples=10)
        write_recording(declared, tmp_path, errors)
        found = study.tracking(DESIGN, data=tmp_path)
        bias, line = found.distance.bias_interval_mm, found.displacement.line
        home, apart = found.distance.stages[0], 80.0
        held += [
            bias[0] < errors.bias_mm / len(STAGES) < bias[1],
            line.scale_interval[0] < errors.scale < line.scale_interval[1],
            line.offset_interval[0] < 0 < line.offset_interval[1],
            home.interval_mm[0] < apart < home.interval_mm[1],
        ]
    print(f"held by {held} of {studies} intervals: bias, scale, offset, distance at home")
    assert (held >= binom.ppf(5e-4, studies, 0.95)).all(), held


def test_a_tracker_has_no_specimens(tmp_path):
    with pytest.raises(InputError, match="no design"):
        api.virtual(tmp_path, DESIGN, blocks=3)


def test_a_reference_cannot_be_made_up(tmp_path):
    file = tmp_path / "poses.toml"
    file.write_text(
        DESIGN.read_text() + '\n[reference]\nfile = "laser.csv"\nmarker = "tip"\n'
        'stage = "pose"\nposition = ["x", "y", "z"]\n'
    )
    with pytest.raises(InputError, match="have no reference"):
        api.virtual(tmp_path, file)
