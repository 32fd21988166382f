"""Files as instruments write them: each is read to its last digit, or refused by its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from study.ground.errors import InputError
from study.mechanics.measurement.reading import read_measurements
from tests.record.samples import Spec

FORCE_N = [0.0, 400.0, 800.0, 1200.5, 1600.0]


def rows(cells: str) -> str:
    return "".join(
        cells.format(d=d, f=f, e=f"{d:.1f}".replace(".", ","), g=f"{f:,.2f}")
        for d, f in enumerate(FORCE_N)
    )


def german(text: str) -> str:
    return text.replace(",", "\0").replace(".", ",").replace("\0", ".")


DEGREE = "Zeit [s]\td\tf\tTemperatur [\u00b0C]\n"
FILES: dict[str, tuple[bytes, dict[str, object]]] = {
    "row of units": (("d,f\n(mm),(N)\n" + rows('"{d}","{f}"\n')).encode(), {}),
    "units without brackets": (("t;d;f\n;mm;N\n" + rows("0;{d};{f}\n")).encode(), {}),
    "units of pint": (("d,f\n[mm],[uN]\n" + rows("{d},{f}\n")).encode(), {"force": "uN"}),
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


def read(folder: Path, data: bytes, changes: dict[str, object]):
    (folder / "a.asc").write_bytes(data)
    force = changes.pop("force", "N")
    spec = Spec(file="a.asc", units={"displacement": "mm", "force": force}, **changes)
    return read_measurements(spec, folder)


@pytest.mark.parametrize("name", FILES)
def test_a_recording_is_read_to_its_last_digit(tmp_path, name):
    data, changes = FILES[name]
    factor = 1e-6 if changes.get("force") == "uN" else 1.0
    found = read(tmp_path, data, dict(changes)).curve().curve
    assert found.force_N == pytest.approx(factor * np.array(FORCE_N), rel=1e-14)


def test_what_the_reader_did_is_counted(tmp_path):
    data = (DEGREE + "s\tmm\tN\t\u00b0C\n" + rows("0\t{d}\t{f}\t23.1\t\n")).encode("latin-1")
    notes = "\n".join(read(tmp_path, data, {}).notes)
    assert "a.asc: read as Windows-1252" in notes
    assert "a.asc:2: row of units" in notes
    assert "empty cells at the ends of 5 rows removed" in notes


REFUSED: dict[str, tuple[bytes, dict[str, object], list[str]]] = {
    # the comma may be either mark where no cell shows a decimal point
    "a comma of two meanings": (b'd,f\n0,"1,200"\n1,"2,400"\n', {}, ["a.asc", "decimal comma"]),
    "units of the row": (
        b"d,f\nmm,kN\n0,0\n1,1\n2,2\n", {}, ["the row of units says kN, but N is declared"],
    ),
    "lines of the file": (
        b"made by X\nof 2020\nd,f\n0,0\n# pause\n1,x\n2,y\n", {"skip_lines": 2, "comment": "#"},
        ["a.asc:6: column 'f'", "a.asc:7: column 'f'"],
    ),
    "preamble": (b"made by X,\nof 2020,\nd,f\n0,0\n", {}, ["line 3 names the columns", "= 2"]),
    "both columns": (b"d,f\n0,x\ny,1\n", {}, ["a.asc:2: column 'f'", "a.asc:3: column 'd'"]),
    "half utf-8": ("d,f,\u00b0C\n".encode() + b"0,0,\xb0\n", {}, ["a.asc:2: byte 0xb0"]),
    "not text": (b"d,f\n0,\x81\n", {}, ["a.asc:2: byte 0x81", "not Windows-1252"]),
    "filled beyond the header": (b"d,f\n0,0,\n1,1,5\n2,2,\n", {}, ["a.asc:3: has 3 cells"]),
    "no group of three": (b'd,f\n0,"1,20.5"\n1,2\n', {}, ["a.asc:2: column 'f'"]),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_doubtful_is_refused_by_its_line(tmp_path, name):
    data, changes, words = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read(tmp_path, data, dict(changes))
    for word in words:
        assert word in str(caught.value)
