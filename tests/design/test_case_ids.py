"""Names of the cases of every design that ships: records on disk are found by them.

``python -m tests.design.test_case_ids`` writes the names anew, which loses every record that
anybody has computed with these designs.
"""

import csv
from pathlib import Path

import pytest

from study.harness.design.load import file_kind, load
from study.harness.design.spec import cases

DESIGNS = Path(__file__).parents[2] / "designs"
STORED = Path(__file__).parent / "case_ids.csv"
SHIPPED = [path.stem for path in sorted(DESIGNS.glob("*.toml")) if file_kind(path) == "design"]


def names_of(design):
    """Design, cell, case id, names of the fit and of what the cell computes."""
    return [
        [
            design,
            case.label,
            case.case_id,
            case.cell.calibration_key or "",
            case.cell.physical_key,
        ]
        for case in cases(load(DESIGNS / f"{design}.toml"))
    ]


@pytest.mark.parametrize("design", SHIPPED)
def test_names_of_cases(design):
    with STORED.open(encoding="utf-8", newline="") as file:
        kept = [row for row in csv.reader(file) if row[0] == design]
    assert kept
    assert names_of(design) == kept


if __name__ == "__main__":
    with STORED.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(
            row for design in SHIPPED for row in names_of(design)
        )
