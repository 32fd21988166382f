"""Measurement files: what they mean is read exactly, what is doubtful is refused by place."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from study.ground import files, tabular
from study.ground.declaration import Bad
from study.ground.errors import InputError
from study.mechanics.measurement.measurement_section import (
    Columns,
    MeasurementSpec,
    Range,
    Units,
    csv_pattern,
)
from study.mechanics.measurement.reading import read_measurements
from tests.measurement.layouts import german
from tests.record.samples import Spec

LINE = "d,f\n0,0\n1,2\n2,4\n3,6\n4,8\n"
REPEATS = "s,r,d,f\n" + "".join(
    f"{s},{r},{d},{d * (k + r)}\n" for k, s in enumerate("AB") for r in (1, 2) for d in range(5)
)


PLAIN = Spec()


def read(folder, text, spec=PLAIN, height_mm=None):
    data = text.encode() if isinstance(text, str) else text
    (folder / "a.csv").write_bytes(data)
    return read_measurements(spec, folder, height_mm)


def refusal(folder, text, spec=PLAIN):
    with pytest.raises(InputError) as caught:
        read(folder, text, spec)
    return str(caught.value)


def test_a_range_that_nobody_asked_for_begins_with_the_last_test(tmp_path):
    (tmp_path / "a.csv").write_text("s,d,f\nA,1,2\nA,2,4\nA,3,6\nA,4,8\nB,1.5,3\nB,3,6\nB,4,8\n")
    spec = MeasurementSpec(
        Columns(displacement="d", force="f"), Units(displacement="mm", force="N"), file="a.csv",
        block="s", points=6,
    )  # fmt: skip
    found = read_measurements(spec, tmp_path, displacement_mm=4.0)
    assert found.displacement_mm.tolist() == np.linspace(1.5, 4, 6).tolist()
    assert "the range begins at 1.5 mm, where the last test begins" in found.notes
    assert found.curve("A").curve.force_N == pytest.approx(2 * np.linspace(1.5, 4, 6), rel=1e-12)


OFFSET = "d,f\n" + "".join(f"{x:.4f},{2 * x + 0.5:.4f}\n" for x in np.linspace(0, 4, 81))
#: rows, keys of the table, forces at its points (by hand), and what is said of the rows
RULES = {
    "a straight line": (LINE, {"points": 9}, [0, 1, 2, 3, 4, 5, 6, 7, 8], ["1 test of 5 rows"]),
    "10 kN at 0.4 cm": (
        "d;f\n0;0\n0,1;2,5\n0,2;5\n0,4;10\n",
        {"decimal": ",", "units": {"displacement": "cm", "force": "kN"}},
        [0, 2500, 5000, 7500, 10_000], [],
    ),
    "rows out of order and of equal displacement": (
        "d,f\n0,0\n2,4\n1,1\n1,3\n3,5\n4,8\n", {}, [0, 2, 4, 5, 8],
        ["1 rows out of order sorted", "2 rows of equal displacement averaged (in 1 of 1 tests)"],
    ),
    "a force that is not monotone": ("d,f\n0,0\n1,3\n2,2\n3,6\n4,8\n", {}, [0, 3, 2, 6, 8], []),
    "an offset in the first row": (
        OFFSET, {"zero": "first"}, [0, 2, 4, 6, 8],
        ["load cell zero (first) subtracted: 0.5 to 0.5 N"],
    ),
    "an offset of the first tenth": (
        OFFSET, {"zero": "fit"}, [0, 2, 4, 6, 8], ["load cell zero (fit) subtracted: 0.5 to 0.5 N"]
    ),
    "no load to 1 mm, then 2 N/mm, past 0.2 N at 1.1 mm": (
        "d,f\n0,0\n0.5,0\n1,0\n2,2\n3,4\n4,6\n5.1,8.2\n", {"toe": 0.2},
        [0.2, 2.2, 4.2, 6.2, 8.2], ["3 rows before contact dropped (toe)", "1.1 to 1.1 mm"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("rule", RULES)
def test_rules_give_the_forces_worked_out_by_hand(tmp_path, rule):
    text, keys, forces, said = RULES[rule]
    found = read(tmp_path, text, Spec(**keys))
    made = found.curve()
    assert made.curve.displacement_mm.tolist() == np.linspace(0, 4, len(forces)).tolist()
    assert made.curve.force_N == pytest.approx(forces, abs=1e-9)
    assert (made.scatter_N, made.n_repeats) == (None, 1)
    assert all(words in "\n".join(found.notes) for words in said)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: b"\xef\xbb\xbf" + t.encode(),
        lambda t: t.replace("\n", "\r\n").encode(),
        lambda t: t.replace("\n", "\r").encode(),
        lambda t: gzip.compress(t.encode()),
        lambda t: t.replace(",", ";").encode(),
        lambda t: t.replace(",", "\t").encode(),
        lambda t: t.replace("d,f", '"d","f"').replace("1,2", '"1","2"').encode(),
        lambda t: t.replace(",", " , ").encode(),
        lambda t: (t + "\n\n").encode(),
        lambda t: t.replace("3,6", "+3.,.6e1").encode(),
    ],
    ids=["bom", "crlf", "cr", "gzip", "semicolon", "tab", "quotes", "spaces", "blank", "forms"],
)
def test_dress_of_the_file_does_not_matter(tmp_path, change):
    assert read(tmp_path, change(LINE)).curve().curve.force_N.tolist() == [0, 2, 4, 6, 8]


FORCE_N = [0.0, 400.0, 800.0, 1200.5, 1600.0]


def rows(cells):
    return "".join(cells.format(d=d, f=f, g=f"{f:,.2f}") for d, f in enumerate(FORCE_N))


DEGREE = "Zeit [s]\td\tf\tTemperatur [\u00b0C]\n"
FILES = {
    "row of units": (("d,f\n(mm),(N)\n" + rows('"{d}","{f}"\n')).encode(), {}),
    "units without brackets": (("t;d;f\n;mm;N\n" + rows("0;{d};{f}\n")).encode(), {}),
    "units of pint": (
        ("d,f\n[mm],[uN]\n" + rows("{d},{f}\n")).encode(),
        {"units": {"displacement": "mm", "force": "uN"}},
    ),
    "thousands": (("d,f\n" + rows('{d},"{g}"\n')).encode(), {}),
    "german thousands": (
        german("d;f\n" + rows("{d};{g}\n")).encode(),
        {"decimal": ","},
    ),
    "apostrophes": (("d,f\n" + rows("{d},{g}\n").replace(",1,", ",1'").replace(
        "3,1,200", "3,1'200").replace("4,1,600", "4,1'600")).encode(), {}),
    "narrow spaces": (
        ("d;f\n" + rows("{d};{g}\n").replace(",", "\u202f").replace(".", ",")).encode(),
        {"decimal": ","},
    ),
    "latin-1": ((DEGREE + rows("0\t{d}\t{f}\t23.1\n")).encode("latin-1"), {}),
    "trailing tabs": ((DEGREE + rows("0\t{d}\t{f}\t23.1\t\n")).encode("latin-1"), {}),
    "trailing comma of the header": (("d,f,,\n" + rows("{d},{f}\n")).encode(), {}),
    "utf-16": (("d\tf\n" + rows("{d}\t{f}\n")).encode("utf-16"), {}),
    "utf-16 big endian": (b"\xfe\xff" + ("d\tf\n" + rows("{d}\t{f}\n")).encode("utf-16-be"), {}),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_recording_is_read_to_its_last_digit(tmp_path, name):
    data, changes = FILES[name]
    factor = 1e-6 if "units" in changes else 1.0
    found = read(tmp_path, data, Spec(**changes)).curve().curve
    assert found.force_N == pytest.approx(factor * np.array(FORCE_N), rel=1e-14)


def test_what_the_reader_did_is_counted(tmp_path):
    data = (DEGREE + "s\tmm\tN\t\u00b0C\n" + rows("0\t{d}\t{f}\t23.1\t\n")).encode("latin-1")
    notes = "\n".join(read(tmp_path, data).notes)
    assert "a.csv: read as Windows-1252" in notes
    assert "a.csv:2: row of units" in notes
    assert "empty cells at the ends of 5 rows removed" in notes


def test_repeats_are_averaged_and_scatter_is_their_deviation(tmp_path):
    spec = Spec(block="s", average=("r",))
    found = read(tmp_path, REPEATS, spec)
    assert found.blocks == ("A", "B")
    mean = found.curve("A")
    # ANALYTIC: slopes 1 and 2: mean 1.5 d, deviation d / sqrt(2)
    assert mean.curve.force_N.tolist() == [0, 1.5, 3, 4.5, 6]
    assert mean.scatter_N == pytest.approx(np.arange(5) / np.sqrt(2), rel=1e-14)
    assert mean.n_repeats == 2


def test_fit_and_score_swap(tmp_path):
    spec = Spec(average=("r",), fit={"s": "A"}, score={"s": "B"}, swap=True)
    (fit, score), (fit2, score2) = read(tmp_path, REPEATS, spec).pairs()
    assert fit.curve.force_N[-1] == 6
    assert score.curve.force_N[-1] == 10
    assert (fit2, score2) == (score, fit)


def test_a_column_that_is_not_averaged_must_be_chosen(tmp_path):
    found = read(tmp_path, REPEATS, Spec(average=("r",), fit={"s": "A"}, score={"s": "B"}))
    with pytest.raises(InputError, match="several tests match the study: s = A, B"):
        found.curve()
    with pytest.raises(InputError, match="did you mean 's'|no grouping column 'sx'"):
        found.curve(sx="A")
    with pytest.raises(InputError, match="no test matches s = C"):
        found.curve(s="C")


def test_numbers_in_a_design_match_labels_in_a_file(tmp_path):
    found = read(tmp_path, REPEATS, Spec(average=("s",), fit={"r": 1}, score={"r": 2.0}))
    assert found.curve(r=1).n_repeats == 2
    assert found.curve(r=[1.0]).n_repeats == 2


@pytest.mark.parametrize(
    "text", ["d,f\n0,0\n1,-2\n2,-4\n3,-6\n4,-8\n", "d,f\n0,0\n-1,-2\n-2,-4\n-3,-6\n-4,-8\n"]
)
def test_sign_is_declared_and_mismatch_refused(tmp_path, text):
    assert 'sign = "negative"' in refusal(tmp_path, text)
    found = read(tmp_path, text, Spec(sign="negative"))
    assert found.curve().curve.force_N.tolist() == [0, 2, 4, 6, 8]
    assert 'sign = "positive"' in refusal(tmp_path, LINE, Spec(sign="negative"))


def test_range_in_percent_and_from_the_test(tmp_path):
    found = read(tmp_path, LINE, Spec(range=Range("percent", 10, 40)), height_mm=10)
    assert found.displacement_mm[[0, -1]].tolist() == [1, 4]
    (tmp_path / "a.csv").write_text(LINE)
    free = read_measurements(Spec(range=None), tmp_path, displacement_mm=4)
    assert free.displacement_mm[[0, -1]].tolist() == [0.8, 4]
    with pytest.raises(InputError, match="needs a specimen with a height"):
        read(tmp_path, LINE, Spec(range=Range("percent", 1, 40)))


BAD = {
    "empty": ("", "the file is empty"),
    "blank": ("\n \n", "the file is empty"),
    "header only": ("d,f\n", "no row of data"),
    "one row": ("d,f\n0,0\n", "has 1 rows, a curve needs at least 3"),
    "missing column": ("d,force\n0,0\n", "there is no column 'f'"),
    "duplicate column": ("d,f,f\n0,0,1\n", "stands 2 times"),
    "nan": (LINE.replace("2,4", "2,nan"), "a.csv:4: column 'f': must be a finite number"),
    "inf": (LINE.replace("2,4", "2,inf"), "a.csv:4"),
    "beyond": (LINE.replace("2,4", "2,1e300"), "a.csv:4: column 'f': 1e+300 N is beyond"),
    "overflow": (LINE.replace("2,4", "2,1e400"), "a.csv:4"),
    "text": (LINE.replace("2,4", "2,high"), "got 'high'"),
    "hole": (LINE.replace("2,4", "2,"), "the cell is empty"),
    "underscore": (LINE.replace("2,4", "2,1_0"), "only the digits 0 to 9"),
    "arabic": (LINE.replace("2,4", "2,\u0664"), "only the digits 0 to 9"),
    "hex": (LINE.replace("2,4", "2,0x4"), "got '0x4'"),
    "ragged": (LINE.replace("2,4", "2,4,5"), "a.csv:4: has 3 cells where the header has 2"),
    "decimal comma": ("d;f\n0,0;0,0\n1,5;2,0\n", "decimal comma"),
    "decimal comma below thousands": ("d;f\n0;1.250,61\n1;2.400,00\n", "holds a decimal comma"),
    "decimal comma in commas": ("d,f\n0,0,0,0\n1,5,2,0\n", "looks like a decimal comma"),
    "late decimal comma": ("d;f\n0;0\n1,5;2,0\n2;4\n3;6\n", "must be declared"),
    "too short": ("d,f\n0,0\n1,2\n2,4\n3,6\n", "ends at 3 mm, the range asks for 4 mm"),
    "starts late": ("d,f\n2,4\n3,6\n4,8\n5,10\n", "begins at 2 mm"),
    "starts unloaded": ("d,f\n2,0\n3,2\n4,4\n5,6\n", "displacement starts at 2 mm with 0 N"),
    "few in range": ("d,f\n0,0\n9,2\n10,4\n", "has 1 rows between"),
    "constant": ("d,f\n0,1\n1,1\n4,1\n", "the force is constant"),
    "squares of zero": ("d,f\n0,0\n1,1e-301\n4,4e-301\n", "the force is constant"),
    "still": ("d,f\n1,0\n1,1\n1,2\n", "the displacement is constant"),
    "nul": ("d,f\n0,0\n1,\0\n", "NUL"),
    "quote": ('d,f\n0,"0\n', "not well-formed"),
    "half utf-16": (LINE.encode("utf-16")[:-1], "is not UTF-16"),
    "latin-1": (LINE.replace("3,6", "\xb5,6").encode("latin-1"), "a.csv:5: column 'd'"),
    "broken gzip": (gzip.compress(LINE.encode())[:-9], "broken gzip"),
    "long line": ("d,f\n" + "1" * 100_001 + ",2\n", "at most 100000"),
    # the comma may be either mark where no cell shows a decimal point
    "a comma of two meanings": (b'd,f\n0,"1,200"\n1,"2,400"\n', "decimal comma"),
    "units of the row": (b"d,f\nmm,kN\n0,0\n1,1\n2,2\n", "the row of units says kN, but N is"),
    "first of both columns": (b"d,f\n0,x\ny,1\n", "a.csv:2: column 'f'"),
    "both columns": (b"d,f\n0,x\ny,1\n", "a.csv:3: column 'd'"),
    "preamble": (b"made by X,\nof 2020,\nd,f\n0,0\n", "line 3 names the columns"),
    "half utf-8": ("d,f,\u00b0C\n".encode() + b"0,0,\xb0\n", "a.csv:2: byte 0xb0"),
    "not text": (b"d,f\n0,\x81\n", "a.csv:2: byte 0x81"),
    "saved by MATLAB": (b"MATLAB 5.0 MAT-file\n\x0e\0\xe0\x01\0\n", "a.csv: is a binary file"),
    "filled beyond the header": (b"d,f\n0,0,\n1,1,5\n2,2,\n", "a.csv:3: has 3 cells"),
    "no group of three": (b'd,f\n0,"1,20.5"\n1,2\n', "a.csv:2: column 'f'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_by_place(tmp_path, case):
    text, words = BAD[case]
    assert words in refusal(tmp_path, text)


LABELS = ("=cmd|'/c calc'!A0", "@x", "a\u202eb", "x" * 201, "")


@pytest.mark.parametrize(
    ("data", "keys", "words"),
    [
        ("d;f\n0;0\n1.5;2,0\n2;4\n", {"decimal": ","}, ["a point has no place here"]),
        # lines are those of the file
        (
            "made by X\nof 2020\nd,f\n0,0\n# pause\n1,x\n2,y\n",
            {"skip_lines": 2, "comment": "#"},
            ["a.csv:6: column 'f'", "a.csv:7: column 'f'"],
        ),
        (REPEATS, {"block": "s"}, ["a.csv:7", "column 'r' changes there"]),
        (
            REPEATS,
            {"average": ("r",), "fit": {"s": "A"}, "score": {"s": "Q"}},
            ["no test matches s = Q"],
        ),
        # labels that could do harm
        *(
            ("s,d,f\n" + f"{label},1,1\n" * 5, {"block": "s"}, ["a.csv:2: column 's'"])
            for label in LABELS
        ),
    ],
)
def test_what_a_table_says_of_a_file_is_checked(tmp_path, data, keys, words):
    said = refusal(tmp_path, data, Spec(**keys))
    assert all(word in said for word in words), said


def test_all_bad_cells_come_at_once(tmp_path):
    words = refusal(tmp_path, "d,f\n" + "x,1\n" * 30)
    assert words.count("must be a finite number") == 20
    assert "10 more cells" in words


def test_a_unit_in_the_header_must_be_the_declared_one(tmp_path):
    columns = {"displacement": "d_mm", "force": "load_kN"}
    text = LINE.replace("d,f", "d_mm,load_kN")
    assert "its name says kN" in refusal(tmp_path, text, Spec(columns=columns))
    declared = Spec(columns=columns, units={"displacement": "mm", "force": "kN"})
    assert read(tmp_path, text, declared).curve().curve.force_N[-1] == pytest.approx(8000)
    plain = replace(declared, columns={"displacement": "d_mm", "force": "total_force"})
    assert read(tmp_path, text.replace("load_kN", "total_force"), plain).curve()


@pytest.mark.parametrize(
    "name",
    ["../a.csv", "/etc/passwd", "x/../../a.csv", "a\0b", "C:\\a.csv", "~/a.csv", "..\\a.csv", " "],
)
def test_paths_never_leave_the_root(tmp_path, name):
    with pytest.raises(InputError, match=r"--data"):
        read_measurements(Spec(file=name), tmp_path)


def test_links_out_of_the_root_are_refused(tmp_path):
    inside = tmp_path / "root"
    inside.mkdir()
    (tmp_path / "secret.csv").write_text(LINE)
    (inside / "a.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(InputError, match="through a link"):
        read_measurements(Spec(), inside)
    (inside / "l-1.csv").symlink_to(tmp_path / "secret.csv")
    with pytest.raises(InputError, match="through a link"):
        read_measurements(Spec(file=None, files="l-{n}.csv"), inside)


def test_a_missing_file_says_where_and_whence(tmp_path):
    with pytest.raises(InputError) as caught:
        read_measurements(Spec(file="b.csv", citation="Dawood et al. 2026"), tmp_path)
    words = str(caught.value)
    assert str(tmp_path) in words
    assert "--data DIR" in words
    assert "Dawood et al. 2026" in words


def test_groups_from_the_names_of_files(tmp_path):
    (tmp_path / "conical").mkdir()
    for k, name in enumerate(("S1", "S2")):
        text = LINE.replace("4,8", f"4,{8 + k}")
        (tmp_path / "conical" / f"indentation-{name}.csv").write_text(text)
    (tmp_path / "conical" / "notes.txt").write_text("not a test")
    spec = Spec(file=None, files="conical/indentation-{specimen}.csv", block="specimen")
    found = read_measurements(spec, tmp_path)
    assert found.blocks == ("S1", "S2")
    assert found.curve("S2").curve.force_N[-1] == 9
    assert list(found.files) == ["conical/indentation-S1.csv", "conical/indentation-S2.csv"]
    with pytest.raises(InputError, match="measurements.files"):
        read_measurements(replace(spec, files="conical/x-{specimen}.csv"), tmp_path)
    for pattern in ("{a}{a}.csv", "{a b}.csv", "{a.csv", "plain.csv"):
        with pytest.raises(Bad, match="group"):
            csv_pattern(pattern)


def test_size_caps(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MAX_BYTES", 1000)
    assert "holds more than" in refusal(tmp_path, LINE + "5,10\n" * 1000)
    assert "holds more than" in refusal(tmp_path, gzip.compress((LINE + "5,10\n" * 1000).encode()))
    monkeypatch.setattr(tabular, "MAX_ROWS", 10)
    assert "at most 10 are read" in refusal(tmp_path, LINE + "5,10\n" * 20)


ECOFLEX = Spec(
    file="ecoflex_compression/ef10_time_compression_load.csv.gz",
    columns={"displacement": "compression_mm", "force": "load_N"},
    block="phantom",
    average=("repeat",),
    range=Range("percent", 1, 20),
    points=200,
    fit={"specimen": "A"},
    score={"specimen": "B"},
    swap=True,
)


def test_ecoflex_force_at_6_mm_is_the_published_one(data_dir):
    """EXTERNAL: the force at 6 mm that was interpolated from the same tests by others."""
    import pandas as pd

    table = pd.read_csv(data_dir / "ecoflex_compression" / "factorial_3x5_force6mm.csv")
    found = read_measurements(ECOFLEX, data_dir, 30.0)
    ours = {
        tuple(t.groups[n] for n in ("phantom", "specimen", "repeat")): t.force_N[-1]
        for t in found.tests
    }
    compared = 0
    for row in table[table["family"] == 10].itertuples():
        name = f"EF10_{row.thinner_pct:g}T".replace(".", "_")
        # the table is printed to 4 decimals
        assert ours[name, row.specimen, str(row.repeat)] == pytest.approx(row.F_at_6mm_N, abs=6e-5)
        compared += 1
    assert compared == 50
