"""The second computation of a study's figures: it agrees, and it finds what was falsified."""

import csv
import gzip
import importlib
import json
import shutil
from pathlib import Path

import pytest

from tests.cli.small import DESIGN, answer_of, success, write_files
from tests.conftest import ROOT

SCRIPT = ROOT / "validation" / "conical" / "second_way.py"
#: three energies, so that epsilon is no formality, and a response on the logarithm
THREE = DESIGN.replace(
    'material = ["neo-hookean", "mooney-rivlin"]',
    'material = ["neo-hookean", "mooney-rivlin", "reduced-polynomial-2"]',
).replace(
    "[presets.range.small]",
    '[presets.material.reduced-polynomial-2]\nmodel = "reduced-polynomial"\norder = 2\n'
    "[presets.range.small]",
).replace(
    "[report]",
    '[[response]]\nname = "peak_force_error"\npractical = "0.1 N"\n'
    '[[response]]\nname = "mu0"\npractical = "5 % of mean"\ntransform = "log"\n[report]',
)  # fmt: skip


def fourth_specimen(rows):
    """Add a mix: the normality of a contrast over blocks needs four of them."""
    last = rows[-1]["mix"]
    for row in [r for r in rows if r["mix"] == last]:
        d, force = float(row["d_mm"]), float(row["f_N"])
        rows.append(row | {"mix": "another", "f_N": repr(1.04 * force * (1 + 0.004 * d))})


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """Report of a small study in closed form."""
    folder = tmp_path_factory.mktemp("second")
    write_files(folder)
    change(folder / "data" / "tests.csv", fourth_specimen)
    (folder / "small.toml").write_text(THREE)
    success("run", "small.toml", "--data", "data", "--jobs", 1, folder=folder)
    return folder / "reports" / "small"


@pytest.fixture
def report(reported, tmp_path):
    """Copy of the report, to falsify."""
    return Path(shutil.copytree(reported, tmp_path / "small"))


def script(name):
    """Import a script from its folder, as Python does with one that it runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(SCRIPT.parent)
        return importlib.import_module(name)


def second_way(folder, *more):
    return answer_of(script("second_way").main, folder, *more)


def change(path, edit):
    """Change rows of a CSV, packed or not."""
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", newline="") as file:
        rows = list(csv.DictReader(file))
    edit(rows)
    with opened(path, "wt", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def scaled(column, factor):
    def edit(rows):
        rows[4][column] = repr(factor * float(rows[4][column]))

    return edit


def test_it_shares_no_code_with_the_program():
    for path in SCRIPT.parent.glob("*.py"):
        assert "import study" not in path.read_text()
        assert "from study" not in path.read_text()


def test_every_figure_agrees(report):
    found = second_way(report)
    assert found.code == 0, found.out + found.err
    assert ", 0 differ by more than 1e-06" in found.out
    for figure in ("relative_rms_force_error: F of material:range", "mu0: corrected p of material",
                   "mu0: largest ratio of range", "peak_force_error: Ryan-Joiner",
                   "mu0: Ryan-Joiner of contrast 2 of material", "epsilon of material",
                   "relative_rms_force_error of 24 cases", "peak_force_error of 24 cases",
                   ):  # fmt: skip
        assert figure in found.out, figure
    assert second_way(report / "small-data", "--all").code == 0


def falsify(path, name, row, key):
    """Change a number in numbers.json by a ten-thousandth."""
    numbers = json.loads(path.read_text())
    row(numbers["responses"][name])[key] *= 1.0001
    path.write_text(json.dumps(numbers))


def of_material(response):
    return next(r for r in response["anova"]["rows"] if r["term"] == "material")


ERROR = "relative_rms_force_error"


@pytest.mark.parametrize(
    ("file", "falsified", "said"),
    [
        # far below what a plot would show, above the 1e-6 that is asked for
        *(("cases.csv", lambda p, c=c: change(p, scaled(c, 1 + 1e-5)), f"{c}: mean at material")
          for c in (ERROR, "peak_force_error", "mu0")),
        ("curves.csv.gz", lambda p: change(p, scaled("predicted_N", 1.01)), f"{ERROR} of "),
        *(("numbers.json", lambda p, key=key: falsify(p, "mu0", of_material, key),
           ", 1 differ by more than") for key in ("f", "p", "epsilon_gg", "p_gg", "ss")),
        ("numbers.json", lambda p: falsify(p, ERROR, lambda r: r["normality"], "rj"), "differ"),
        ("numbers.json", lambda p: falsify(p, ERROR, lambda r: r["normality_rows"][0], "rj"),
         "differ"),
    ],
)  # fmt: skip
def test_what_was_falsified_is_found(report, file, falsified, said):
    falsified(report / "small-data" / file)
    found = second_way(report)
    assert found.code == 1
    assert said in found.out


def test_an_incomplete_table_is_no_silent_pass(report, tmp_path):
    change(report / "small-data" / "cases.csv", lambda rows: rows.pop(3) and None)
    found = second_way(report)
    assert found.code == 2
    assert "the table is not complete (1 cells without a value" in found.err
    missing = second_way(tmp_path)
    assert (missing.code, "cannot recompute" in missing.err) == (2, True)
