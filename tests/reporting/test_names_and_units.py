"""Names and units of a table as its report writes them: files, labels, numbers."""

import csv
import math
import re
from itertools import product
from pathlib import Path

import pytest

from tests.cli.small import study

pytestmark = pytest.mark.usefixtures("undrawn")

LONG = "predicted_contact_pressure_at_the_outer_edge_of_the_{}_plate"
#: responses whose names are alike in the letters that a file has, and what b is above a
ALIKE = {
    "\N{GREEK SMALL LETTER SIGMA}": 20.0, "\N{GREEK SMALL LETTER TAU}": 3.0, "F": 7.0, "f": 0.5,
    LONG.format("upper"): 11.0, LONG.format("lower"): 13.0,
}  # fmt: skip


@pytest.fixture
def alike(tmp_path, monkeypatch):
    """Folder of the data of a report on responses whose names are alike."""
    monkeypatch.chdir(tmp_path)
    with open("runs.csv", "w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["plate", *ALIKE])
        for plate, noise in product("ab", (-0.02, 0.0, 0.01, 0.01)):
            rows.writerow(
                [plate, *(5 + noise + apart * (plate == "b") for apart in ALIKE.values())]
            )
    answer = study("import", "runs.csv", "--factors", "plate", "--responses", ",".join(ALIKE))
    assert answer.code == 0, answer.err
    return tmp_path / "reports" / "runs" / "runs-data"


def test_no_response_loses_its_files_to_another_of_a_like_name(alike):
    # of a row a group the difference d of two means of four rows has the sum of squares 2 d^2
    expected = sorted(2 * apart**2 for apart in ALIKE.values())
    tables = [path for path in alike.glob("table-*.csv") if "anova" in path.name]
    sums = []
    for path in tables:
        with path.open(encoding="utf-8", newline="") as file:
            sums += [float(row["ss"]) for row in csv.DictReader(file) if row["term"] == "plate"]
    assert sorted(sums) == pytest.approx(expected)
    assert len(list(alike.glob("figure-*-means.svg"))) == len(ALIKE)
    page = alike.parent.joinpath("runs-details.html").read_text("utf-8")
    anchors = re.findall(r'<section id="(r-[^"]+)"', page)
    assert len(set(anchors)) == len(anchors) == len(ALIKE)
    for anchor in anchors:
        assert f'href="#{anchor}"' in page


def test_a_unit_in_the_name_of_a_column_stands_beside_its_numbers(tmp_path):
    lines = ["lot,plates,force_mN [mN]"]
    for lot, (plates, base) in product(range(5), (("bonded", 500.0), ("free", 620.0))):
        lines.append(f"{lot},{plates},{base + 7 * lot + (lot % 3) * (plates == 'free')}")
    path = tmp_path / "force.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    answer = study("analyze", path, "--response", "force_mN [mN]", "--factors", "plates", "--block",
                 "lot", "--practical", "0.05 N", "--report", tmp_path / "out",
                 "--format", "html,tex")  # fmt: skip
    assert answer.code == 0, answer.err
    # the differences are 120, 121, 122, 120, 121
    assert re.search(r"plates +matters +121 mN .* mN +50 mN", answer.out)
    first = (tmp_path / "out" / "force-force-mn-mn.html").read_text("utf-8")
    assert "For force_mN, the choice of plates (121\N{NO-BREAK SPACE}mN between extremes)" in first
    tex = (tmp_path / "out" / "force-force-mn-mn.tex").read_text("utf-8")
    assert "a difference of 50~mN was declared to matter" in tex


def test_sizes_that_a_mixed_model_does_not_have_are_no_columns(tmp_path):
    lines = ["block,dose,wear"]
    for block, dose in product(range(6), range(3)):
        if (block + dose) % 5:
            noise = math.sin(31 * block + 5.3 * dose)
            lines.append(f"{block},{dose},{10 + 3 * dose + block % 4 + noise:.3f}")
    path = tmp_path / "wear.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    answer = study("analyze", path, "--response", "wear", "--factors", "dose", "--block", "block")
    assert "REML" in answer.out
    assert "omega squared" not in answer.out


def test_replicates_of_imported_runs_over_numbers_are_runs_of_their_surface(tmp_path, monkeypatch):
    """Each setting is run twice, 10 apart: the surface lies between, and says that they scatter."""
    monkeypatch.chdir(tmp_path)
    lines = ["speed,temp,y"]
    for speed, temp, apart in product(range(1, 6), (20, 40, 60), (0, 10)):
        lines.append(f"{speed},{temp},{100 + 20 * speed + temp / 2 + apart}")
    Path("two.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    made = study("import", "two.csv", "--numeric", "speed,temp", "--responses", "y")
    assert made.code == 0, made.err
    assert "of 30 runs" in made.out
    assert "run once" not in made.err
    predicted = study("predict", "two", "--at", "speed=3,temp=40", "--json").json["predictions"][0]
    assert predicted["value"] == pytest.approx(185.0)
    low, high = predicted["low"], predicted["high"]
    assert low < 180 < 190 < high


def test_no_function_of_a_surface_loses_its_file_to_another(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = ["side,speed,\N{GREEK SMALL LETTER SIGMA},\N{GREEK SMALL LETTER TAU}"]
    for side, speed in product(("a-1", "a+1"), range(5)):
        lines.append(f"{side},{speed},{speed**2 + 30 * (side == 'a+1')},{7 - speed}")
    Path("runs.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    made = study("import", "runs.csv", "--factors", "side", "--numeric", "speed", "--responses",
                 "\N{GREEK SMALL LETTER SIGMA},\N{GREEK SMALL LETTER TAU}")  # fmt: skip
    assert made.code == 0, made.err
    answer = study("export", "runs", "--as", "emulator", "--json")
    assert answer.code == 0, answer.err
    files = answer.json["files"]
    assert len(files) == len(set(files)) == 2 * len(answer.json["functions"]) == 8
    alone = study("export", "runs", "--as", "emulator", "--response", "\N{GREEK SMALL LETTER TAU}",
                "--json").json["files"]  # fmt: skip
    assert alone == files[4:]
