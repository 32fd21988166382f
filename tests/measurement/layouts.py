"""Files as instruments lay them out, written for tests: one neo-Hookean specimen in each."""

import io
import zipfile
from xml.sax.saxutils import escape

import numpy as np

from tests.cli.small import gauge

#: gauge section of every file, mm^2 and mm, and the constant behind it, MPa
AREA, LENGTH, C10 = 80.0, 20.0, 0.03


def force(displacement, sense=1.0):
    """Force of the specimen that resists, N."""
    stretch = 1 + sense * displacement / LENGTH
    return sense * AREA * 2 * C10 * (stretch - stretch**-2)


#: the gauge section as a study file has it
SIZE = f'area = "{AREA} mm^2"\nlength = "{LENGTH} mm"\n'
UP = np.linspace(0.0, 6.0, 41)
TIME = 0.2 * np.arange(UP.size)


def calibration(table, kind, size=SIZE, model="neo-hookean"):
    """Calibration of the gauge section by one test with a table of measurements."""
    test = f'[[tests]]\ntest = {{ kind = "{kind}" }}\n'
    table = table.replace("[measurements]", "[tests.measurements]")
    return gauge(f'model = "{model}"\nincompressible = true', size) + test + table


def german(text):
    return text.replace(",", "\0").replace(".", ",").replace("\0", ".")


def bluehill():
    """Instron: a preamble of quoted pairs, names, units in brackets, quoted numbers."""
    head = (
        'Specimen label,"A 1"\nTest : Rate 1,"30.00000",mm/min\n\n'
        "Time,Extension,Load\n(s),(mm),(N)\n"
    )
    rows = (f'"{t:.4f}","{d:.5f}","{f:.6f}"\n' for t, d, f in zip(TIME, UP, force(UP), strict=True))
    return (head + "".join(rows)).encode()


def mts():
    """MTS: tabs, a block of words, names, units, the actuator's own position, kN."""
    head = (
        "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\n"
        "Data Header:\tTime:\t12.5\tSec\nData Acquisition: Timed\n"
        "Axial Displacement\tAxial Force\tRunning Time\nmm\tkN\tSec\n"
    )
    rows = (
        f"{d:.6f}\t{f:.9f}\t{t:.3f}\n"
        for t, d, f in zip(TIME, UP - 37.25, force(UP) / 1000, strict=True)
    )
    return (head + "".join(rows)).encode()


def testxpert():
    """Zwick: Latin-1, semicolons, decimal commas, points between thousands, a pressed specimen."""
    head = 'Prüfer;"Müller"\nTemperatur;23,5 °C\n\nPrüfzeit;Standardweg;Standardkraft\ns;mm;mN\n'
    rows = (
        f"{t:.2f};{d:.4f};{-1000 * f:,.2f}\n"
        for t, d, f in zip(TIME, UP, force(UP, -1.0), strict=True)
    )
    return (head + german("".join(rows))).encode("latin-1")


def texture_analyser():
    """TA.XT: gram-force, millimetres and seconds in the names, a load and an unload."""
    place = np.r_[UP, UP[-2::-1]]
    grams = np.r_[force(UP, -1.0), 0.8 * force(UP[-2::-1], -1.0)] / 9.80665e-3
    head = "Force (g),Distance (mm),Time (sec)\n"
    rows = (
        f"{f:.6f},{d:.5f},{0.1 * k:.1f}\n"
        for k, (d, f) in enumerate(zip(place, grams, strict=True))
    )
    return (head + "".join(rows)).encode()


def cellscale():
    """CellScale: units behind underscores, micrometres, millinewtons, cycles."""
    place = np.concatenate([UP, UP[-2::-1], UP[1:], UP[-2::-1]])
    factor = np.repeat([1.0, 0.9, 0.95, 0.9], [41, 40, 40, 40])
    ways = np.repeat(["Stretch", "Recover", "Stretch", "Recover"], [41, 40, 40, 40])
    head = "SetName,Cycle,Time_S,Size_um,Displacement_um,Force_mN\n"
    rows = (
        f"Test,{1 + (k > 80)}-{ways[k]},{0.2 * k:.1f},"
        f"{1000 * (LENGTH + d):.1f},{1000 * d:.1f},{1000 * f:.3f}\n"
        for k, (d, f) in enumerate(zip(place, factor * force(place), strict=True))
    )
    return (head + "".join(rows)).encode()


def optics11():
    """Optics11: tabs, a long preamble of pairs, nanometres and micronewtons, an approach."""
    before = np.arange(-1.5, 0.0, 0.15)
    place = np.r_[before, UP, UP[-2::-1], before[::-1]]
    load = np.r_[0 * before, force(UP, -1.0), 0.9 * force(UP[-2::-1], -1.0), 0 * before]
    head = (
        "Date\t01/01/2000\tTime\t10:00:00\tStatus\tOK\nX-position (um)\t0.0\nk (N/m)\t0.490\n"
        "Tip radius (um)\t25.000\nSMDuration (s)\t2.000\n\n"
        "Time (s)\tLoad (uN)\tIndentation (nm)\tCantilever (nm)\tPiezo (nm)\tAuxiliary\n"
    )
    rows = (
        f"{0.01 * k:.3f}\t{1e6 * f:.3f}\t{1e6 * d:.2f}\t{10 * f:.4f}\t{1e6 * d + 10 * f:.4f}\t0.0\n"
        for k, (d, f) in enumerate(zip(place, load, strict=True))
    )
    return (head + "".join(rows)).encode()


def workbook(sheets):
    """Excel workbook, written part by part."""
    names = list(sheets)
    kind = "application/vnd.openxmlformats-officedocument.spreadsheetml"
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    packed = "http://schemas.openxmlformats.org/package/2006"
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{packed}/content-types">'
        '<Default Extension="rels" ContentType='
        '"application/vnd.openxmlformats-package.relationships+xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{kind}.sheet.main+xml"/>'
        + "".join(
            f'<Override PartName="/xl/worksheets/s{k}.xml" ContentType="{kind}.worksheet+xml"/>'
            for k in range(len(names))
        )
        + "</Types>",
        "_rels/.rels": f'<Relationships xmlns="{packed}/relationships"><Relationship Id="r1" '
        f'Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{office}"><sheets>'
        + "".join(
            f'<sheet name="{escape(n)}" sheetId="{k + 1}" r:id="r{k}"/>'
            for k, n in enumerate(names)
        )
        + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{packed}/relationships">'
        + "".join(
            f'<Relationship Id="r{k}" Type="{office}/worksheet" Target="worksheets/s{k}.xml"/>'
            for k in range(len(names))
        )
        + "</Relationships>",
    }
    for k, rows in enumerate(sheets.values()):
        cells = "".join(
            f'<row r="{r}">' + "".join(_cell(c, r, value) for c, value in enumerate(row)) + "</row>"
            for r, row in enumerate(rows, 1)
        )
        parts[f"xl/worksheets/s{k}.xml"] = (
            f'<worksheet xmlns="{main}"><sheetData>{cells}</sheetData></worksheet>'
        )
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in parts.items():
            archive.writestr(name, text)
    return content.getvalue()


def _cell(column, row, value):
    if value is None:
        return ""
    place = f"{chr(ord('A') + column)}{row}"
    if isinstance(value, (int, float)):
        return f'<c r="{place}"><v>{value!r}</v></c>'
    return f'<c r="{place}" t="inlineStr"><is><t>{escape(str(value))}</t></is></c>'
