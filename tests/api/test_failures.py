"""A study in which cases fail: the report says which, why and where, also when all do."""

from collections.abc import Mapping

from study import api
from tests.pages import both_pages
from tests.runner.conftest import DESIGN, make_data

CONSTANTS = {
    'model = "neo-hookean"': 'model = "neo-hookean"\nC10 = "5 kPa"',
    'model = "mooney-rivlin"': 'model = "mooney-rivlin"\nC10 = "4 kPa"\nC01 = "1 kPa"',
    '[[response]]\nname = "mu0"\ntransform = "log"\npractical = "10 % of mean"\n': "",
}
PYTHON = DESIGN + '[calibration]\nmethod = "none"\n[forward]\nmodel = "python"\n'
for old, new in CONSTANTS.items():
    PYTHON = PYTHON.replace(old, new)


def stubborn(problem):
    """A model that knows no bonded plates of a Mooney-Rivlin material."""
    test, material = problem["test"], problem["material"]
    assert isinstance(test, Mapping)
    assert isinstance(material, Mapping)
    if test["interface"] == "bonded" and material["model"] == "mooney-rivlin":
        raise ArithmeticError("no step was found")
    depths = problem["displacement_mm"]
    return [2.0 * float(d) for d in depths]


def hopeless(problem):
    raise ArithmeticError("no step was found")


def run(folder, forward):
    (folder / "small.toml").write_text(PYTHON)
    return api.run(
        folder / "small.toml", data=make_data(folder), results=folder / "results",
        reports=folder / "reports", forward=forward, version="1", jobs=2, refine=False,
    )  # fmt: skip


def test_the_report_says_which_settings_fail_and_blames_no_factor_for_one_cell(tmp_path):
    found = run(tmp_path, stubborn)
    assert found.cases == {"total": 12, "done": 9, "failed": 3, "missing": 0}
    assert found.report is not None
    page = both_pages(found.report)
    assert "Where cases fail: " in page
    assert "mooney-rivlin" in page
    assert "3 of 3; elsewhere 0 of 9." in page
    assert "Causes: 3 failed: ArithmeticError: no step was found." in page
    assert "What fails is the combination of material mooney-rivlin and plates bonded." in page
    assert "differ already by themselves" not in page  # by no more than chance explains
    csv = (found.report.parent / "small-data" / "table-failure-tests.csv").read_text()
    assert csv.startswith("factor,level,failed,cases,p,p_holm,method\n")
    assert "plates,bonded,3,6," in csv
    document = found.to_json()["failures"]
    assert isinstance(document, dict)
    assert document["rules"][0]["settings"] == {"material": "mooney-rivlin", "plates": "bonded"}
    assert document["causes"] == {"failed: ArithmeticError: no step was found": 3}


def test_a_study_in_which_every_case_failed_has_a_report_that_says_so(tmp_path):
    found = run(tmp_path, hopeless)
    assert found.cases["failed"] == 12
    assert found.report is not None, found.warnings
    page = both_pages(found.report)
    assert "Every case failed (12 failed: ArithmeticError: no step was found)" in page
    assert "All 12 cases failed, so there is nothing to compare." in page
    assert "ArithmeticError: no step was found" in page
    assert [warning for warning in found.warnings if "could not be written" in warning] == []
