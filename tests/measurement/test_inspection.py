"""``study inspect``: the table that it prints reads the file to the constant behind it."""

import gzip
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import study
from study.cli.app import app
from study.ground.errors import InputError
from study.mechanics.measurement.inspection import inspect
from study.mechanics.measurement.reading import read_measurements
from tests.cli.small import measured
from tests.measurement import layouts
from tests.measurement.layouts import AREA, C10, LENGTH, TIME, UP, calibration, force
from tests.record.samples import Spec

ROWS = [["Run of May", None, None], ["t", "Weg", "Kraft"], ["s", "mm", "N"]] + [
    [float(t), float(d), float(f)] for t, d, f in zip(TIME, UP, force(UP), strict=True)
]
PLAIN = "".join(f"{d:.4f} {f:.6f}\n" for d, f in zip(UP, force(UP), strict=True))
#: content, kind of test, what the table must say besides columns and units, rows read and used
FILES = {
    "bluehill.csv": (layouts.bluehill(), "tension", {"skip_lines": 3, "unit_row": True}, (41, 41)),
    "mts.txt": (
        layouts.mts(), "tension",
        {"skip_lines": 4, "unit_row": True, "displacement_zero": "first row"}, (41, 41),
    ),
    "zwick.asc": (
        layouts.testxpert(), "compression",
        {"skip_lines": 3, "unit_row": True, "decimal": ",", "sign": "negative"}, (41, 41),
    ),
    "ta.tab": (layouts.texture_analyser(), "compression", {"branch": "loading"}, (81, 41)),
    "cellscale.csv": (layouts.cellscale(), "tension", {"branch": "loading"}, (161, 41)),
    "piuma.txt": (
        layouts.optics11(), "compression",
        {"skip_lines": 6, "displacement_zero": "contact", "branch": "loading"}, (101, 41),
    ),
    "book.xlsx": (
        layouts.workbook({"notes": [["nothing"]], "Run 3": ROWS}), "tension",
        {"sheet": "Run 3", "skip_lines": 1, "unit_row": True}, (41, 41),
    ),
    "one.xlsx.gz": (
        gzip.compress(layouts.workbook({"Run": ROWS[1:]})), "tension", {"unit_row": True}, (41, 41)
    ),
    "bluehill.csv.gz": (
        gzip.compress(layouts.bluehill()), "tension", {"skip_lines": 3, "unit_row": True}, (41, 41)
    ),
    "commented.csv": (
        ("t;d_mm;f_N\n" + "".join(
            ("# paused\n" if k == 20 else "") + f"{t:.2f};{d:.4f};{f:.6f}\n"
            for k, (t, d, f) in enumerate(zip(TIME, UP, force(UP), strict=True))
        ).replace(".", ",")).encode("utf-8-sig"), "tension", {"decimal": ",", "comment": "#"},
        (41, 41),
    ),
}  # fmt: skip


def calibrated(folder, content, kind, change=lambda table: table, name="a.csv"):
    """Calibration by a file, with the table that is proposed for it."""
    (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    table = change(inspect(folder / name).toml)
    (folder / "c.toml").write_text(calibration(table, kind))
    return study.calibrate(folder / "c.toml", data=folder).to_json()


@pytest.mark.parametrize("name", FILES)
def test_the_table_reads_the_file_as_it_is(tmp_path, name):
    content, kind, says, (read, used) = FILES[name]
    made = calibrated(tmp_path, content, kind, name=name)
    table = dict(inspect(tmp_path / name).measurements)
    assert {k: v for k, v in table.items() if k not in ("file", "columns", "units")} == says
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=1e-4)
    assert (made["rows"]["read"], made["rows"]["used"]) == (read, used)
    assert sum(one["rows"] for one in made["rows"]["set_aside"]) == read - used
    assert made["curves"][0]["r_squared"] > 0.99999


def written(head, *columns, sep=","):
    return head + "".join(
        sep.join(f"{v:.6f}" for v in row) + "\n" for row in zip(*columns, strict=True)
    )


NOISE = 0.002 * np.random.default_rng(5).standard_normal(400)
AWAY = np.linspace(-12.0, -0.1, 100)
HELD = np.r_[UP, np.full(40, UP[-1]), UP[-2::-1]]
RELAXED = np.r_[
    force(UP), force(UP)[-1] * (0.7 + 0.3 * np.exp(-np.arange(40) / 20)), 0.65 * force(UP[-2::-1])
]
PRESSED = np.r_[0 * AWAY, force(UP, -1.0)] + NOISE[:141]
BOTH = np.linspace(-6.0, 6.0, 61)
SINE = 3 + 3 * np.sin(0.1 * np.arange(200))
POINTS = "".join(f"{1e3 * d:,.0f};{1e3 * f:,.0f}\n" for d, f in zip(UP, force(UP), strict=True))
QUOTED = "".join(f'"{d:.4f}","{f:.6f}"\n' for d, f in zip(UP, force(UP), strict=True))
#: recordings that are laid out or run otherwise than a plain test: text and kind of test
UGLY = {
    "units above the names": (
        written("mm,mN\nWeg,Kraft\n", UP, 1e3 * force(UP)).encode(), "tension"),
    "units below a second line of names": (
        written("Weg,Kraft\nK 1,K 2\num,mN\n", 1e3 * UP, 1e3 * force(UP)).encode(), "tension"),
    "points between thousands alone": (
        ("Weg [um];Kraft [mN]\n" + POINTS.replace(",", ".")).encode(), "tension"),
    "decimal commas in quotes between commas": (
        ("Weg_mm,Kraft_N\n" + layouts.german(QUOTED).replace('".', '",')).encode(), "tension"),
    "UTF-16 without its mark": (
        written("Weg (mm)\tKraft (N)\n", UP, force(UP), sep="\t").encode("utf-16-le"), "tension"),
    "typographic minus": (
        written("position_mm;force_N\n", -UP - 5, -force(UP, -1.0), sep=";")
        .replace("-", "\u2212").encode(), "compression"),
    "units behind a space": (written("Weg mm,Kraft kN\n", UP, force(UP) / 1e3).encode(), "tension"),
    "gram-force": (
        written("Weg_mm,Load_gram-force\n", UP, force(UP) / 9.80665e-3).encode(), "tension"),
    "grams in the row of units": (
        written("Weg,Kraft\nmm,grams\n", UP, force(UP) / 9.80665e-3).encode(), "tension"),
    "approach from zero, longer than the travel": (
        written("position_mm,force_N\n", np.r_[AWAY, UP] + 12, PRESSED).encode(), "compression"),
    "the same with a load cell that is not zeroed": (
        written("position_mm,force_N\n", np.r_[AWAY, UP] + 12, PRESSED + 0.5).encode(),
        "compression"),
    "a peak that is held while the machine trembles": (
        written("displacement_mm,force_N\n", HELD + 0.2 * NOISE[: HELD.size], RELAXED).encode(),
        "tension"),
    "the same without the way back": (
        written("displacement_mm,force_N\n", HELD[:81] + 0.2 * NOISE[:81], RELAXED[:81]).encode(),
        "tension"),
    "a signed test about the machine's 50 mm": (
        written("position_mm,force_N\n", 50 + BOTH, force(BOTH)).encode(), "tension"),
    "loaded already at its first row": (
        written("displacement_mm,force_N\n", UP + 0.8, force(UP + 0.8)).encode(), "tension"),
    "the way back alone": (
        written("position_mm,force_N\n", 20 + UP[::-1], force(UP)[::-1]).encode(), "tension"),
    "thousandths of an inch and gram-force": (
        written("Extension (mil),Load (gf)\n", UP / 0.0254, force(UP) / 9.80665e-3).encode(),
        "tension"),
    "units in words": (
        written("displacement microns,force mN\n", 1e3 * UP, 1e3 * force(UP)).encode(), "tension"),
    "names of one letter and units in the plural": (
        written("pos,F\nMillimeters,Newtons\n", UP, force(UP)).encode(), "tension"),
    "two specimens side by side": (
        written("A,,B,\nd (mm),F (N),d (mm),F (N)\n", UP, force(UP), UP, 1.1 * force(UP)).encode(),
        "tension"),
    "a column of events that is empty but once": (
        ("d_mm,f_N,event\n0,0,TRIGGER\n" + written("", UP[1:], force(UP[1:])).replace("\n", ",\n"))
        .encode(), "tension"),
    "bars between the cells": (written("d_mm|f_N\n", UP, force(UP), sep="|").encode(), "tension"),
    "a sine that begins in its middle": (
        written("d_mm,f_N\n", SINE, force(SINE)).encode(), "tension"),
    "an export that was appended to another, names and units again": (
        (written("Weg,Kraft\nmm,N\n", UP[:20], force(UP[:20]))
         + written("Weg,Kraft\nmm,N\n", UP[20:], force(UP[20:]))).encode(), "tension"),
    "slack of a twentieth of the travel": (
        written("d_mm,f_N\n", np.r_[0.0, 0.1, 0.2, UP + 0.33], np.r_[np.zeros(3), force(UP)])
        .encode(), "tension"),
}  # fmt: skip


@pytest.mark.parametrize("name", UGLY)
def test_ugly_recordings_give_the_constant_behind_them(tmp_path, name):
    made = calibrated(tmp_path, *UGLY[name])
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=2e-3)
    assert made["fit"]["verdict"] == "describes"


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (written("Weg,Kraft\nmm,V\n", UP, force(UP)), "'V' of 'Kraft' is no unit"),
        (
            written("strain,stress_kPa\n", UP[:27], force(UP[:27])),
            "or per cent .a stretch of 1.039",
        ),
        (
            written("Weg_mm,Kraft\n", UP, 1e3 * force(UP)),
            r"no unit of 'Kraft', 0 to \d{4}; N is the guess: write units.force = \"N\", or",
        ),
    ],
    ids=["unknown unit", "ratio or per cent", "millinewton without a word"],
)
def test_a_unit_that_is_open_is_left_to_the_user(tmp_path, content, rule):
    (tmp_path / "a.csv").write_text(content)
    table = inspect(tmp_path / "a.csv").toml
    assert re.search(rf"# .*{rule}", table)
    printed = CliRunner().invoke(app, ["inspect", str(tmp_path / "a.csv")])
    assert printed.exit_code == 0
    assert table in printed.stdout
    with pytest.raises(InputError, match="is missing|has no unit|V"):
        calibrated(tmp_path, content, "tension")


TWO = [1 + end * np.linspace(0.02, 1, 30) for end in (0.6, 0.3)]
BIAXIAL = [2e3 * C10 * (a - 1 / (a**3 * b**2)) for a, b in (TWO, TWO[::-1])]
SHEAR = 0.5 * np.sin(np.linspace(0, 2 * np.pi, 81))


@pytest.mark.parametrize(
    ("content", "kind", "change", "close", "used"),
    [
        # what a user types is the text behind 'write', below the table that was printed
        (written("Weg,Kraft [mN]\n", UP, 1e3 * force(UP)), "tension",
         lambda t: f'{t}\n{re.search(r"write (units.displacement = .mm.)", t)[1]}\n', 1e-4, 41),
        (written("stretch x,stretch y,stress x (kPa),stress y (kPa)\n", *TWO, *BIAXIAL), "biaxial",
         lambda t: t, 1e-4, 30),
        # to the right, back, to the left: stress is odd in the amount of shear
        (written("strain,stress_kPa\n", SHEAR, 2e3 * C10 * SHEAR), "simple-shear",
         lambda t: t.replace('"loading"', '"all"'), 1e-6, 81),
        (written("d_mm,f_N\n", BOTH, force(BOTH)), "tension",
         lambda t: f'{t}\nrange = ["-3 mm", "5 mm"]', 1e-5, 41),
        (written("position_mm,force_N\n", 4.0 - UP, -force(UP, -1.0)), "compression",
         lambda t: t, 1e-5, 41),
    ],
    ids=["an open unit", "biaxial", "shear to both sides", "a range below zero", "falling"],
)  # fmt: skip
def test_a_table_with_what_its_user_adds_gives_the_constant(
    tmp_path, content, kind, change, close, used
):
    made = calibrated(tmp_path, content, kind, change)
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=close)
    assert made["rows"]["used"] == used
    found = inspect(tmp_path / "a.csv").measurements
    falling = (found.get("direction"), found.get("displacement_zero")) == ("falling", "first row")
    assert falling == (kind == "compression")


def test_noise_about_zero_before_contact_is_no_test_of_both_signs(tmp_path):
    d = np.linspace(-0.6, 0.8, 60)
    noise = np.where(np.arange(60) % 2, 0.004, -0.004)
    text = written("Indentation (mm),Load (mN)\n", d, 30 * np.maximum(d, 0.0) ** 1.5 + noise)
    (tmp_path / "a.csv").write_text(text)
    assert not any("through zero" in note for note in inspect(tmp_path / "a.csv").notes)


def test_an_approach_over_a_third_of_the_travel_in_noise_begins_at_contact(tmp_path):
    """A falling position, a load cell that is not zeroed, noise of .2 % of the largest force."""
    place, load = np.r_[np.linspace(-4.0, 0.0, 40, endpoint=False), UP], force(UP, -1.0)
    load = np.r_[np.zeros(40), load] + load.max() * NOISE[:81]
    made = calibrated(
        tmp_path, written("Position (mm),Force (N)\n", 100 - place, -load - 0.2), "compression"
    )
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=0.02)
    assert made["fit"]["verdict"] == "describes"


@pytest.mark.parametrize(
    ("rows", "rule"),
    [
        (written("", UP, np.minimum(force(UP), 2.8)), "the load cell was at its limit.*range = "),
        (written("", UP, np.where(UP > 5, 0.05, force(UP))), "the specimen tore.*range = "),
        (written("", np.r_[0, UP + 0.4], np.r_[0, force(UP)]), "displacement_zero = "),
        (written("", UP, force(UP)) + "Maximum,6.0,5.0\n", "a.csv:43: has 3 cells"),
    ],
    ids=["saturated", "torn to less than its first rows", "slack", "line of results"],
)
def test_what_no_reading_mends_is_refused_with_what_to_write(tmp_path, rows, rule):
    with pytest.raises(InputError, match=f"(?s){rule}"):
        calibrated(tmp_path, "d_mm,f_N\n" + rows, "tension",
                   lambda table: table.replace('displacement_zero = "contact"', ""))  # fmt: skip


def test_lines_that_are_no_rows_are_named_and_a_single_row_turns_no_sign(tmp_path):
    text = written("d_mm,f_N\n0,10\n", UP[1:], force(UP[1:])) + "\nMaximum,6.0,5.0\nEnd of test\n"
    (tmp_path / "a.csv").write_text(text)
    found = inspect(tmp_path / "a.csv")
    assert any("are no rows: 44, 45: delete them" in note for note in found.notes)
    assert (found.rows, "sign" in found.measurements) == (41, False)


def test_the_sheet_that_holds_a_test_is_shown_and_the_others_are_named(tmp_path):
    signal = [["Time (s)", "Signal (V)"], *([0.1 * k, 0.5] for k in range(600))]
    sheets = {"notes": [["nothing"]], "Run 1": ROWS[1:], "Run 2": ROWS[1:-5], "check": signal}
    (tmp_path / "a.xlsx").write_bytes(layouts.workbook(sheets))
    found = inspect(tmp_path / "a.xlsx")
    assert (found.measurements["sheet"], found.rows, found.sheets) == ("Run 1", 41, tuple(sheets))
    assert "'Run 2' holds a test too" in found.notes[0]
    assert inspect(tmp_path / "a.xlsx", "Run 2").rows == 36


def test_a_slow_tear_is_refused(tmp_path):
    torn = force(UP) * np.where(UP > 5, 1 - 0.9 * np.clip((UP - 5) / 0.4, 0, 1), 1)
    with pytest.raises(InputError, match="the specimen tore"):
        calibrated(tmp_path, written("displacement_mm,force_N\n", UP, torn), "tension")


def test_forces_that_relax_at_each_step_are_not_averaged_in_silence(tmp_path):
    steps = np.repeat(UP[::4], 10)
    relaxed = force(steps) * np.tile(0.8 + 0.2 * np.exp(-np.arange(10) / 3), UP[::4].size)
    content = written("displacement_mm,force_N\n", steps, relaxed)
    warnings = calibrated(tmp_path, content, "tension")["warnings"]
    assert any("force falls by 19 %" in warning for warning in warnings)


def test_what_is_seen_is_said(tmp_path):
    (tmp_path / "piuma.txt").write_bytes(layouts.optics11())
    document = study.inspect(tmp_path / "piuma.txt").to_json()
    assert document["delimiter"] == "tab"
    assert (document["header_line"], document["first_line"], document["last_line"]) == (7, 8, 108)
    assert document["preamble"][1] == "X-position (um)\t0.0"
    held = {one["name"]: (one["unit"], one["quantity"]) for one in document["columns"]}
    assert held["Load (uN)"] == ("uN", "force")
    assert held["Indentation (nm)"] == ("nm", "displacement")
    assert held["Time (s)"] == ("s", "time")
    assert [one["phase"] for one in document["phases"]] == [
        "loading of cycle 1", "unloading of cycle 1"
    ]  # fmt: skip
    assert document["phases"][0]["lines"] == [8, 58]
    assert document["cycles"] == 1
    assert any("'Piezo (nm)'" in note for note in document["notes"])


def test_the_command_prints_the_table_and_one_document(tmp_path):
    (tmp_path / "mts.txt").write_bytes(layouts.mts())
    plain = CliRunner().invoke(app, ["inspect", str(tmp_path / "mts.txt")])
    assert plain.exit_code == 0
    assert plain.stdout.rstrip().endswith('displacement_zero = "first row"')
    assert "names in line 5, units in line 6, 41 rows in lines 7 to 47" in plain.stdout
    told = CliRunner().invoke(app, ["inspect", str(tmp_path / "mts.txt"), "--json"])
    assert json.loads(told.stdout)["measurements"]["units"]["force"] == "kN"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no block of 3 lines"),
        (b"only words\nand more\n", "no block of 3 lines"),
        (b"a,b\n1,2\n", "no block of 3 lines"),
        (b"d,f\n" + 5 * b"1.5 mm,12.3 N\n", "take '(mm|N)' out of the cells"),
        (b"d;f\n" + 5 * b"1.5D+00;1.23D+01\n", "write E for the D of the exponents"),
        (b"PK\x03\x04 no workbook", "no workbook that can be read"),
        (b"\xd0\xcf\x11\xe0 old", "workbook of Excel 2003"),
        (b"\x1f\x8b broken", "broken gzip"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, said):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(InputError, match=said):
        inspect(tmp_path / "a.csv")


def test_numbers_alone_have_no_meaning_but_are_read(tmp_path):
    (tmp_path / "a.dat").write_text(PLAIN)
    found = inspect(tmp_path / "a.dat")
    assert found.measurements["header"] is False
    assert found.measurements["delimiter"] == "space"
    assert [one.name for one in found.columns] == ["1", "2"]
    assert any("no column is known to hold" in note for note in found.notes)


def test_several_sheets_are_named(tmp_path):
    (tmp_path / "a.xlsx").write_bytes(layouts.workbook({"one": ROWS[1:], "two": ROWS[1:]}))
    spec = Spec(file="a.xlsx", columns={"displacement": "Weg", "force": "Kraft"})
    with pytest.raises(InputError, match="holds several sheets: 'one', 'two'"):
        read_measurements(spec, tmp_path)
    second = replace(spec, sheet="two")
    assert np.isfinite(read_measurements(second, tmp_path).curve().curve.force_N).all()


def test_a_sheet_of_a_workbook_is_analyzed(tmp_path):
    rows = [["group", "y"]] + [[g, float(v)] for g in "abc" for v in (1, 2, 4, "abc".index(g))]
    book = layouts.workbook({"notes": [["nothing"]], "Run 3": rows})
    (tmp_path / "b.xlsx").write_bytes(book)
    by_hand = study.analyze(pd.DataFrame(rows[1:], columns=rows[0]), "y", ["group"])
    sheet = study.analyze(tmp_path / "b.xlsx", "y", ["group"], sheet="Run 3")
    assert sheet.to_json()["anova"] == by_hand.to_json()["anova"]
    asked = ["analyze", str(tmp_path / "b.xlsx"), "--response", "y", "--factors", "group", "--json"]
    assert CliRunner().invoke(app, [*asked, "--sheet", "Run 3"]).exit_code == 0
    with pytest.raises(InputError, match="holds several sheets"):
        study.analyze(tmp_path / "b.xlsx", "y", ["group"])


@pytest.mark.parametrize("unit", ["in/in", "mm/mm", "in./in.", "m/m", "µm/µm"])
@pytest.mark.parametrize("name", ["Strain {}", "Tensile strain ({})", "strain_{}", "Strain, {}"])
def test_lengths_over_lengths_are_strains(tmp_path, name, unit):
    """``Strain mm/mm`` was read as a displacement in mm: 481 kPa of 30, and it described."""
    head = f"{name.format(unit)}\tStress (MPa)\n"
    text = head + "".join(f"{d / LENGTH:.6f}\t{force(d) / AREA:.9f}\n" for d in UP)
    made = calibrated(tmp_path, text, "tension")
    units = inspect(tmp_path / "a.csv").measurements["units"]
    assert units == {"strain": "1", "stress": "MPa"}
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=1e-4)


def test_the_column_of_remarks_that_no_row_has(tmp_path):
    """LabVIEW names a last column Comment, which its rows leave out."""
    head = "LabVIEW Measurement\n***End_of_Header***\nX_Value\tPosition (mm)\tForce (N)\tComment\n"
    made = calibrated(
        tmp_path, written(head, TIME, UP, force(UP), sep="\t"), "tension", name="a.lvm.txt"
    )
    columns = inspect(tmp_path / "a.lvm.txt").measurements["columns"]
    assert columns == {"displacement": "2", "force": "3"}
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=1e-4)


@pytest.mark.parametrize("travel", [1.0, 1.6, "compliant"])
def test_a_strain_beside_the_way_of_the_machine_is_named(tmp_path, travel):
    way = UP + force(UP) / 5.0 if travel == "compliant" else travel * UP
    head = "Crosshead (mm),Extensometer (strain) [%],Load (N),Stress (kPa)\n"
    text = written(head, way, 100 * UP / LENGTH, force(UP), 1000 * force(UP) / AREA)
    (tmp_path / "a.csv").write_text(text)
    notes = " ".join(inspect(tmp_path / "a.csv").notes)
    assert f"'Stress (kPa)' is 'Load (N)' over {AREA:g} mm^2: is that the area" in notes
    if travel == "compliant":
        assert "is in no proportion to 'Crosshead (mm)', in which frame, load cell" in notes
    else:
        assert f"is 'Crosshead (mm)' over {travel * LENGTH:g} mm: is that the length" in notes


@pytest.mark.parametrize("kind", ["tension", "compression"])
def test_the_machine_that_would_lower_moduli_by_a_hundredth_is_told(tmp_path, kind):
    """Of that stiffness the fit is off by 1 %, and the model still describes the rows."""
    (tmp_path / "c.toml").write_text(calibration(measured("a.csv"), kind))
    resists = force(UP, 1.0 if kind == "tension" else -1.0)
    fitted, noise = [], np.random.default_rng(1).normal(size=UP.size)
    stiffness = np.inf
    for _ in range(2):
        rows = UP + resists / stiffness, resists + 0.01 * resists.max() * noise
        (tmp_path / "a.csv").write_text(written("d,f\n", *rows))
        made = study.calibrate(tmp_path / "c.toml", data=tmp_path)
        fitted.append(made.fit.values[0])
        assert made.adequacy.verdict == "describes"
        (note,) = [note for note in made.notes if "grips" in note]
        stiffness = float(re.search(r"grips of ([\d.]+) N/mm", note)[1])
    assert 1 - fitted[1] / fitted[0] == pytest.approx(0.01, rel=0.1)
