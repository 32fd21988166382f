"""What Python users hold and type: tables of a file, paths as text, results that are shown."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

import study
from study.cli.study_commands import settings
from study.ground.errors import InputError
from study.harness.design.load import file_kind, from_tables, load, load_problem, loads_problem
from tests.cli import small
from tests.cli.small import DESIGN, write_files

PROBLEM = {
    "specimen": {"shape": "cylinder", "radius": 10, "height": "1 cm"},
    "test": {"kind": "compression", "interface": "frictionless", "displacement": 1, "steps": 2},
    "material": {"model": "neo-hookean", "C10": 0.01, "incompressible": True},
    "model": {"mesh_size": "5 mm"},
}
NAMES = ("material", "range")
#: 2 C10 (1/l^2 - l) pi R^2 at l = 0.95 and 0.9
FORCE = [2 * 0.01 * (s**-2 - s) * math.pi * 100 for s in (0.95, 0.9)]


@pytest.fixture
def home(tmp_path, monkeypatch):
    write_files(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_problem_is_given_by_the_keys_of_its_file():
    found = study.solve(PROBLEM)
    assert found.curve.force_N == pytest.approx(FORCE, rel=1e-9)
    loaded = loads_problem(from_tables(PROBLEM)).problem
    for same in (
        {**PROBLEM, "material": {**PROBLEM["material"], "C10": "10 kPa"}},
        {**PROBLEM, "material": {**PROBLEM["material"], "C10": np.float64(0.01)}},
        loaded.document(),
        loaded.at(),
    ):
        assert study.solve(same).curve.force_N.tolist() == found.curve.force_N.tolist()
    twice = study.solve(PROBLEM, overrides=['material.C10="20 kPa"'])
    assert twice.curve.force_N == pytest.approx(2 * np.array(FORCE), rel=1e-9)


def test_faults_of_tables_are_those_of_a_file():
    wrong = {**PROBLEM, "specimen": {"shape": "cylinder", "radios": 10, "height": 10}}
    with pytest.raises(InputError, match="did you mean 'radius'"):
        study.solve(wrong)


@pytest.mark.parametrize(
    ("tables", "key", "labels"),
    [
        ({"specimen.radius": [24, 26.5]}, "specimen.radius", ("24 mm", "26.5 mm")),
        ({"model": {"mesh_size": [2, "0.3 cm"]}}, "model.mesh_size", ("2 mm", "0.3 cm")),
        ({"model.element_order": ["linear", "quadratic"]}, "model.element_order",
         ("linear", "quadratic")),
        ({"specimen.radius": {"low": 24, "high": 26}}, "specimen.radius", ("24 mm", "26 mm")),
    ],
)  # fmt: skip
def test_numbers_of_factors_have_the_units_of_their_keys(tables, key, labels):
    made = study.load_design(
        {
            **PROBLEM, "study": {"name": "numbers"},
            "factors": {**tables, "test.base": ["frictionless", "bonded"]},
            "response": [{"name": "peak_force", "practical": "0.1 N"}],
        }
    )  # fmt: skip
    factor = next(one for one in made.factors if one.name == key)
    assert factor.labels == labels


def test_presets_have_units_too():
    made = study.load_design(
        {
            **PROBLEM,
            "presets": {
                "material": {"soft": {"C10": 0.005}, "stiff": {"C10": "20 kPa"}},
                "depth": {
                    "small": {"test.displacement": 1},
                    "large": {"test": {"displacement": 2}},
                },
            },
            "factors": {"material": ["soft", "stiff"], "depth": ["small", "large"]},
            "response": [{"name": "peak_force", "practical": "0.1 N"}],
        }
    )
    cells = {one.label: one.cell.problem for one in made.treatments}
    soft, stiff = cells["soft / small"], cells["stiff / large"]
    assert soft.material.constants == {"C10": 0.005}
    assert stiff.material.constants == {"C10": 0.02}
    assert (soft.test.displacement_mm, stiff.test.displacement_mm) == (1.0, 2.0)


@pytest.mark.parametrize(
    "relaxation", [[{"share": 0.3, "time": 2}], [{"share": 0.3, "time": "2 s"}]]
)
def test_times_of_a_relaxation_are_in_seconds(relaxation):
    """A held strip: after 20 times the time, the share has gone."""
    gauge = {"shape": "homogeneous", "area": 100, "length": 10}
    test = {"kind": "tension", "displacement": 1, "speed": "1e3 mm/s", "hold": 40, "steps": 4}
    material = {"model": "neo-hookean", "C10": 0.01, "incompressible": True}
    held = study.solve(
        {"specimen": gauge, "test": test, "material": {**material, "relaxation": relaxation}}
    )
    stretch = 1.1
    at_once = 2 * 0.01 * 100 * (stretch - stretch**-2)  # N, of the instantaneous moduli
    assert held.curve.force_N[-1] == pytest.approx(0.7 * at_once, rel=1e-3)


def is_short(found, word):
    """Whether a prompt shows a table and no arrays: a solution printed 150 kB of its mesh."""
    lines = repr(found).splitlines()
    return word in repr(found) and "array(" not in repr(found) and len(lines) < 30


def test_a_solution_is_shown(home):
    found = study.solve("problem.toml")
    frame = found.to_frame()
    assert frame.force_N.to_list() == found.curve.force_N.tolist()
    assert "force_gradient_C10" in frame
    assert is_short(found, "converged")
    assert "converged" in found._repr_html_()
    assert f"{found.curve.force_N[-1]:.6g}" in found._repr_html_()
    (axes,) = found.plot().axes
    steps = axes.lines[1].get_xydata()
    assert steps.tolist() == frame[["displacement_mm", "force_N"]].to_numpy().tolist()
    assert found.plot()._repr_svg_() == found.plot()._repr_svg_()


def test_a_calibration_is_shown(home):
    found = study.calibrate("calibration.toml", data="data", results="here")
    assert (home / "here" / "calibration" / "calibration.json").is_file()
    frame = found.to_frame().set_index("constant")
    document = found.to_json()["parameters"]
    assert frame.value["C10"] == document["C10"]["value"]
    assert frame.loc["C10", ["low", "high"]].to_list() == document["C10"]["ci95"]
    assert "C01" in found._repr_html_()
    force, residual = found.plot().axes
    assert force.get_ylabel() == "force (N)"
    assert found.plot()._repr_svg_().startswith("<svg")


@pytest.mark.drawings
def test_a_study_is_shown_and_its_folders_are_texts(home):
    found = study.run("small.toml", data="data", results="out", reports="pages", jobs=1)
    assert str(found.report).startswith("pages")
    frame = found.to_frame()
    assert len(frame) == 12
    assert {"material", "range", "relative_rms_force_error"} <= set(frame)
    assert is_short(found, "relative RMS force error")
    html = found._repr_html_()
    mains = [row["verdict"] for row in found.verdicts if ":" not in str(row["factor"])]
    assert mains
    assert all(verdict in html for verdict in mains)
    drawn = found.plot()._repr_svg_()
    assert all(f">{name}<" in drawn for name in ("material", "range"))
    with pytest.raises(InputError, match="did you mean 'relative_rms_force_error'"):
        found.plot("relative_rms_force_eror")
    again = study.report("small", results="out", reports="pages")
    assert again.to_frame().equals(frame)
    own, named = (study.analyze("out/small", "work_error", names) for names in ((), NAMES))
    assert own.to_json() == named.to_json()
    assert own.anova.row("range").df == 1


def test_a_series_is_shown(home):
    found = study.converge("problem.toml", results="out")
    assert found["behaviour"] == "noise-floor"
    assert is_short(study.converge(tomllib.loads(Path("problem.toml").read_text())), "peak")
    frame = found.to_frame()
    assert frame.mesh_size.to_list() == found["mesh_size"]
    assert frame.value.to_list() == found["value"]
    assert "<table" in found._repr_html_()
    assert found.plot()._repr_svg_().startswith("<svg")
    resolved = load_problem("problem.toml").problem.document()
    assert study.converge(resolved, results="out")["value"] == found["value"]
    numbers = study.grid_convergence(sizes=[1, 2, 4], values=[0.97050, 0.96854, 0.96178])
    assert numbers.to_frame().value.to_list() == [0.97050, 0.96854, 0.96178]
    assert numbers.verdict[:20] in numbers._repr_html_()


@pytest.mark.drawings
def test_a_hostile_name_is_escaped_in_a_notebook(home):
    name = "<script>alert(1)</script>"
    table = study.run("small.toml", data="data", jobs=1, reports=None).to_frame()
    found = study.analyze(
        table.rename(columns={"material": name}), "relative_rms_force_error", [name, "range"],
        block="block",
    )  # fmt: skip
    assert name not in found._repr_html_()
    assert name not in found.plot()._repr_svg_()
    assert "&lt;script&gt;" in found._repr_html_()


def test_a_design_without_measurements_is_no_study(tmp_path):
    text = DESIGN[: DESIGN.index("[measurements]")] + DESIGN[DESIGN.index("[calibration]") :]
    with pytest.raises(InputError):
        study.run(written(tmp_path, text), results=tmp_path / "results")
    assert not (tmp_path / "results").exists()


def test_dir_lists_what_is_public():
    assert set(dir(study)) == set(study.__all__)


# What users type: the key ``kind`` of a file, settings of an option that is repeated.


PROBLEM_FILE = f'kind = "problem"\n{small.PROBLEM}'


def written(folder, text):
    path = folder / "file.toml"
    path.write_text(text)
    return path


def test_a_declared_kind_changes_nothing_of_what_is_read(tmp_path):
    plain = load(written(tmp_path, DESIGN))
    declared = load(written(tmp_path, f'kind = "study"\n{DESIGN}'))
    assert declared.config == plain.config
    problem = written(tmp_path, PROBLEM_FILE)
    assert file_kind(problem) == "problem"
    assert load_problem(problem).problem.height_mm == 10.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PROBLEM_FILE.replace('"problem"', '"studdy"'), "did you mean 'study'"),
        (
            PROBLEM_FILE.replace('kind = "problem"', 'kind = "calibration"'),
            "is a calibration",
        ),
        (f'kind = "problem"\n{DESIGN}', "is 'problem', and the tables are those of a design"),
    ],
)
def test_a_wrong_kind_gets_the_right_word(tmp_path, text, said):
    with pytest.raises(InputError) as caught:
        load_problem(written(tmp_path, text))
    assert said in str(caught.value)


def test_settings_of_a_repeated_option_all_hold():
    assert settings(["a=1,b=2 mm", "c=3"]) == {"a": "1", "b": "2 mm", "c": "3"}
    with pytest.raises(InputError, match="each once"):
        settings(["a=1", "a=2"])
