"""``study inspect``: the table that it prints reads the file to the constant behind it."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest
from typer.testing import CliRunner

import study
from study.cli.app import app
from study.ground.errors import InputError
from study.mechanics.measurement.inspection import inspect
from tests.measurement import layouts
from tests.measurement.layouts import AREA, C10, LENGTH, TIME, UP, force

ROWS = [["Run of May", None, None], ["t", "Weg", "Kraft"], ["s", "mm", "N"]] + [
    [float(t), float(d), float(f)] for t, d, f in zip(TIME, UP, force(UP), strict=True)
]
PLAIN = "".join(f"{d:.4f} {f:.6f}\n" for d, f in zip(UP, force(UP), strict=True))
#: content, kind of test, what the table must say besides columns and units, rows read and used
FILES: dict[str, tuple[bytes, str, dict[str, object], tuple[int, int]]] = {
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


def calibration(table: str, kind: str) -> str:
    return (
        f'schema = 1\n[specimen]\nshape = "homogeneous"\narea = "{AREA} mm^2"\n'
        f'length = "{LENGTH} mm"\n[material]\nmodel = "neo-hookean"\nincompressible = true\n'
        f'[[tests]]\ntest = {{ kind = "{kind}" }}\n'
        + table.replace("[measurements]", "[tests.measurements]")
    )


@pytest.mark.parametrize("name", FILES)
def test_the_table_reads_the_file_as_it_is(tmp_path, name):
    content, kind, says, (read, used) = FILES[name]
    (tmp_path / name).write_bytes(content)
    found = inspect(tmp_path / name)
    table = dict(found.measurements)
    assert {k: v for k, v in table.items() if k not in ("file", "columns", "units")} == says
    (tmp_path / "c.toml").write_text(calibration(found.toml, kind))
    made = study.calibrate(tmp_path / "c.toml", data=tmp_path).to_json()
    assert made["parameters"]["C10"]["value"] == pytest.approx(1e3 * C10, rel=1e-4)
    assert (made["rows"]["read"], made["rows"]["used"]) == (read, used)
    assert sum(one["rows"] for one in made["rows"]["set_aside"]) == read - used
    assert made["curves"][0]["r_squared"] > 0.99999


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


def test_a_falling_position_through_zero_is_placed(tmp_path):
    rows = (f"{4.0 - d:.4f},{-f:.6f}\n" for d, f in zip(UP, force(UP, -1.0), strict=True))
    (tmp_path / "a.csv").write_text("position_mm,force_N\n" + "".join(rows))
    found = inspect(tmp_path / "a.csv")
    assert found.measurements["direction"] == "falling"
    assert found.measurements["displacement_zero"] == "first row"
    (tmp_path / "c.toml").write_text(calibration(found.toml, "compression"))
    made = study.calibrate(tmp_path / "c.toml", data=tmp_path)
    assert made.fit.values[0] == pytest.approx(C10, rel=1e-5)
    assert made.fit.n == 41


def test_several_sheets_are_named(tmp_path):
    from study.mechanics.measurement.reading import read_measurements
    from tests.record.samples import Spec

    (tmp_path / "a.xlsx").write_bytes(layouts.workbook({"one": ROWS[1:], "two": ROWS[1:]}))
    spec = Spec(file="a.xlsx", columns={"displacement": "Weg", "force": "Kraft"})
    with pytest.raises(InputError, match="holds several sheets: 'one', 'two'"):
        read_measurements(spec, tmp_path)
    spec = Spec(file="a.xlsx", columns={"displacement": "Weg", "force": "Kraft"}, sheet="two")
    assert np.isfinite(read_measurements(spec, tmp_path).curve().curve.force_N).all()
