"""Records computed once more: an honest study agrees, and a falsified record is found."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.record.record import Record
from study.record.store import Store
from tests.cli.small import DESIGN, answer_of, study, write_files
from tests.cli.test_closed_form_studies import ALONE
from validation import recompute, recompute_forward, recompute_records
from validation.apart import Answer

#: closed form between frictionless plates, finite elements between bonded ones, both directions
TINY = (
    DESIGN.replace('name = "small"', 'name = "tiny"')
    .replace('interface = "frictionless"', "steps = 4")
    .replace('score = { specimen = "B" }', 'score = { specimen = "B" }\nswap = true')
    .replace('[calibration]\nmethod = "analytic"', "[calibration]\n" 'method = "auto"')
    .replace('material = ["neo-hookean", "mooney-rivlin"]\nrange = ["small", "large"]',
             'plates = ["closed", "bonded"]')
    .replace("incompressible = true", 'model = "neo-hookean"\npoisson_ratio = 0.49')
    .replace("[presets.range.small]\n", "")
    .replace('measurements.range = ["1 %", "10 %"]\n', "")
    .replace("[presets.range.large]\n", "")
    .replace('measurements.range = ["1 %", "20 %"]\n', "")
    .replace('[presets.material.neo-hookean]\nmodel = "neo-hookean"\n', "")
    .replace('[presets.material.mooney-rivlin]\nmodel = "mooney-rivlin"\n', "")
    .replace("points = 30", 'points = 30\nrange = ["1 %", "15 %"]')
    + """
[model]
element_order = "linear"
mesh_size = "8 mm"
[presets.plates.closed]
test.interface = "frictionless"
calibration.method = "analytic"
[presets.plates.bonded]
test.interface = "bonded"
"""
)  # fmt: skip
#: constants of the design, none of a fit, on five meshes
SEEDS = (
    TINY.replace('name = "tiny"', 'name = "seeded"')
    .replace('calibration.method = "analytic"\n', "")
    .replace('method = "auto"', 'method = "none"')
    .replace('model = "neo-hookean"', 'model = "neo-hookean"\nC10 = "8 kPa"')
    .replace("swap = true\n", "")
    + "[replicates]\nmesh_seeds = 5\n"
)  # fmt: skip


def run(home, text):
    """Results of a design that was run in a folder."""
    name = text.split('name = "')[1].split('"')[0]
    (home / f"{name}.toml").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        answer = study("run", f"{name}.toml", "--data", "data", "--jobs", 1, "--no-refine")
    assert answer.code == 0, answer.err
    return home / "results" / name


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recompute")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def finished(home):
    return run(home, TINY)


def answered_here(job, timeout_s):
    """What a process of its own would answer."""
    try:
        return Answer("ok", recompute_forward.recomputed(job))
    except Exception as error:
        return Answer("error", message=str(error))


@pytest.fixture(autouse=True)
def _records_in_this_process(request, monkeypatch):
    """A record is computed in tenths of a second, and a process for it takes two to start."""
    if "processes" not in request.fixturenames:
        monkeypatch.setattr(recompute, "_asked", answered_here)


@pytest.fixture
def results(finished, tmp_path):
    """Copy of the results, to falsify."""
    return Path(shutil.copytree(finished, tmp_path / "tiny"))


def recomputed(*arguments):
    return answer_of(recompute.main, *arguments)


def records(results, plates):
    stored = (Store(results).read(path.name) for path in sorted((results / "cases").iterdir()))
    return [r for r in stored if r is not None and r.levels["plates"] == plates]


Change = Callable[[Record], Record]


def falsify(results, plates, *changes):
    """Change records as the program itself would write them, their checksums with them.

    Those of these plates that have no change of theirs are honest.
    """
    store = Store(results)
    changed = list(zip(records(results, plates), changes, strict=False))
    with store.lock():
        for record, change in changed:
            store.write(change(record))
    return [record.case_id for record, _ in changed]


def moved(name, by):
    def change(record):
        entry = dict(record.responses[name])
        entry["value"] += by
        return replace(record, responses={**record.responses, name: entry})

    return change


def constants(times):
    def change(record):
        assert record.fit is not None
        fits = {
            k: {**v, "values": {"C10": times * v["values"]["C10"]}} for k, v in record.fit.items()
        }
        return replace(record, fit=fits)

    return change


def test_an_honest_study_agrees(finished, home, tmp_path):
    file = tmp_path / "found.json"
    found = recomputed(finished, "--sample", 4, "--data", home / "data", "--json", file)
    assert found.code == 0, found.out + found.err
    assert "4 of 6 records computed again with 4 times the load steps: worst" in found.out
    written = json.loads(file.read_text())
    assert written["sampled"] == 4
    assert len(written["lines"]) == 48  # the mean and two directions
    assert {line["levels"].split(" / ")[0] for line in written["lines"]} == {"closed", "bonded"}
    # the forces at the recorded steps are those of the solver to its own tolerance; the closed
    # form and elements agree to the same digits
    assert max(written["steps"].values()) < 1e-4
    # without derivatives of the constants dF/dd is good to its tolerance alone: 0.01 pp is more
    # than it does between plates
    assert written["worst"] < 0.01
    assert written["notes"] == []


def test_the_sample_is_a_matter_of_its_seed():
    jobs = list(range(50))
    first, again, other = (recompute.sampled(jobs, 5, seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert recompute.sampled(jobs, 99, 1) == jobs


def test_falsified_records_are_found(results):
    """0.06 pp where 0.05 are allowed; 1 N of 70 N and more; constants 1 % off, or below zero."""
    (peak,) = falsify(results, "closed", moved("peak_force_error", 1.0))
    percent, other, none = falsify(
        results, "bonded", moved("relative_rms_force_error", 0.06), constants(1.01), constants(-1.0)
    )
    found = recomputed(results, "--sample", 99)
    assert found.code == 1, found.out + found.err
    marked = [line for line in found.out.splitlines() if line.endswith("<")]
    assert all(any(case in line for line in marked) for case in (peak, percent, other))
    for case, response in ((peak, "peak_force_error"), (percent, "relative_rms_force_error")):
        (line,) = [line for line in marked if case in line]
        assert response in line
    honest = {r.case_id for r in records(results, "closed")} - {peak}
    assert not any(case in line for line in marked for case in honest)
    assert f"no answer: {none}" in found.out


@pytest.mark.usefixtures("processes")
def test_other_measurements_are_found_by_a_process_of_its_own(finished, home, tmp_path):
    rows = (home / "data" / "tests.csv").read_text().splitlines()
    cut = [row.rsplit(",", 1) for row in rows[1:]]
    raised = [f"{left},{1.02 * float(force):.10f}" for left, force in cut]
    (tmp_path / "tests.csv").write_text("\n".join([rows[0], *raised]) + "\n")
    assert recomputed(finished, "--sample", 1, "--data", tmp_path).code == 1


def test_records_without_a_curve_are_left_out_and_counted(results):
    falsify(
        results, "closed", lambda r: replace(r, status="timeout", message="too late"),
        lambda r: replace(r, curves={}, extra={"noise_seed": 3}),
    )  # fmt: skip
    for record in records(results, "bonded"):
        shutil.rmtree(results / "cases" / record.case_id)
    found = recomputed(results, "--sample", 9)
    assert found.code == 0, found.out + found.err
    assert "1 of 1 records" in found.out
    assert "left out: 1 without an answer (timeout)" in found.out
    assert "left out: 1 fits to resampled noise, which hold no curve" in found.out
    assert "left out: 3 not computed yet" in found.out


@pytest.mark.slow
def test_a_mesh_seed_is_solved_on_its_own_mesh(home):
    found = recomputed(run(home, SEEDS), "--sample", 4)
    assert found.code == 0, found.out + found.err
    assert "4 of 30 records" in found.out
    assert "its mesh is not the one of the record" not in found.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "no results of a study there"),
        (["RESULTS", "--sample", "0"], "--sample: must be at least 1, got 0"),
        (["RESULTS", "--bar", "-1"], "--bar: must be positive, got -1"),
        (["RESULTS", "--data", "nowhere"], "--data: there is no folder 'nowhere'"),
        (["RESULTS", "--data", "EMPTY"], "no file 'tests.csv' below"),
    ],
)
def test_bad_input(finished, tmp_path, arguments, message):
    names = {"RESULTS": str(finished), "EMPTY": str(tmp_path)}
    found = recomputed(*(names.get(word, word) for word in arguments))
    assert found.code == 2
    assert "cannot recompute" in found.err
    assert message in found.err
    assert "Traceback" not in found.err


@pytest.mark.parametrize(
    ("shape", "interface", "sticks"),
    [("sphere", "bonded", True), ("sphere", "frictionless", False), ("flat", "bonded", False)],
)
def test_which_indenters_make_load_steps_matter(shape, interface, sticks):
    # a flat end takes hold of its whole face at once, whatever the steps
    test = {"kind": "indentation", "interface": interface,
            "indenter": {"shape": shape, "radius_mm": 2.0}}  # fmt: skip
    cylinder = {"shape": "cylinder", "radius_mm": 9.0, "height_mm": 9.0}
    assert recompute_records._sticks({"specimen": cylinder, "test": test}) is sticks
    compressed = {"kind": "compression", "interface": "bonded"}
    assert not recompute_records._sticks({"specimen": cylinder, "test": compressed})


@pytest.mark.parametrize("monotone", [False, True])
def test_its_interpolation_of_a_hertz_curve(monotone):
    knots = np.linspace(0, 2, 21)[1:]
    at = np.linspace(0.25, 2, 50)
    found = recompute_forward.between(np.array([knots, knots**1.5]), at, monotone=monotone)
    # a tenth of the bar: what cannot be told apart is far below what is looked for
    assert np.abs(found - at**1.5).max() < 0.1 * recompute.BAR / 100 * 2**1.5


@pytest.mark.slow
def test_a_study_without_measurements_is_computed_again(tmp_path, monkeypatch):
    """The peak force, the force at a displacement and the work of a simulation alone."""
    monkeypatch.chdir(tmp_path)
    design = tmp_path / "alone.toml"
    bonded = ALONE.replace('"frictionless"', '"bonded"').replace('"2.5 mm"', '"1.3 mm"')
    design.write_text(bonded)
    made = study("run", design, "-j", 1, "--no-refine")
    assert made.code == 0, made.err
    file = tmp_path / "found.json"
    found = recomputed(tmp_path / "results" / "alone", "--sample", 4, "--json", file)
    assert found.code == 0, found.out + found.err
    lines = json.loads(file.read_text())["lines"]
    assert {line["response"] for line in lines} == {"peak_force", "force_at_1.3_mm", "work"}
    assert len(lines) == 12
    assert max(abs(line["difference"]) for line in lines) <= 0.05
