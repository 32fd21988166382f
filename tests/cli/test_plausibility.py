"""What the program warns of, through its verbs: units, sizes, meshes, offsets, unloading."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import Edit, incompressible_force, study


def scaled(home: Path, force: float = 1.0, add: float = 0.0) -> None:
    """Write the forces of the measurements multiplied and shifted."""
    path = home / "data" / "tests.csv"
    head, *rows = path.read_text().splitlines()
    cells = [row.rsplit(",", 1) for row in rows]
    path.write_text("\n".join([head, *(f"{a},{force * float(b) + add}" for a, b in cells)]))


def test_forces_in_another_unit(home: Path) -> None:
    scaled(home, force=1e4)
    answer = study("plan", "small.toml", "--data", "data")
    assert answer.code == 0, answer.err
    assert "that of no soft material" in answer.err
    assert "a force 1000 times smaller would be one" in answer.err
    sound = study("plan", "small.toml", "--data", "data", "-s", 'measurements.units.force="mN"')
    assert "soft material" not in sound.err


def test_a_load_cell_offset(home: Path) -> None:
    scaled(home, add=2.0)
    said = study("plan", "small.toml", "--data", "data").err
    assert "a load-cell offset?" in said
    assert "12 of 12 tests" in said
    zeroed = study("plan", "small.toml", "--data", "data", "-s", 'measurements.zero="first"').err
    assert "offset" not in zeroed


def test_calibration_uses_the_loading_branch_and_says_so(home: Path) -> None:
    d = np.linspace(0.0, 6.5, 66)
    force = incompressible_force(8.0, 0.5, d)
    rows = [*zip(d, force, strict=True), *zip(d[-2::-1], 0.7 * force[-2::-1], strict=True)]
    text = ["repeat,d_mm,f_N", *(f"1,{x:.4f},{f:.10f}" for x, f in rows)]
    (home / "data" / "one.csv").write_text("\n".join(text))
    answer = study("calibrate", "calibration.toml", "--data", "data", "--json")
    assert answer.code == 0, answer.err
    constants = answer.json["parameters"]
    # the constants of the way in; the mean of both ways would give 0.85 of them
    assert constants["C10"]["value"] == pytest.approx(8.0, rel=2e-3)
    assert constants["C01"]["value"] == pytest.approx(0.5, rel=3e-2)
    assert any("65 rows after the first loading left out" in w for w in answer.json["warnings"])


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ('model.mesh_size="50 mm"', "50 mm is larger than the specimen (10 mm"),
        ('specimen.radius="10 m"', "20000 mm is no usual size"),
        ('material.C10="10 GPa"', "the window of tissue and silicone"),
    ],
)
def test_a_problem_that_is_hardly_meant(home: Path, setting: str, says: str) -> None:
    assert says in study("solve", "problem.toml", "-s", setting).err
    assert study("solve", "problem.toml").err == ""


def test_meshes_larger_than_the_specimen_in_a_design(home: Path, edit: Edit) -> None:
    edit("[test]", '[model]\nmesh_size = "40 mm"\n[test]')
    assert "40 mm is larger than the specimen (25 mm" in study("plan", "small.toml").err


def test_a_value_far_from_its_limit() -> None:
    # f = 1.4 - 0.4 h: the finest of h = 1, 2, 4 is 0.4 from 1.4, 28.6 %
    far = study("converge", "--values", "1.0,0.6,-0.2", "--sizes", "1,2,4", "--json").json
    assert far["extrapolated"] == pytest.approx(1.4)
    assert any("28.6 % from its extrapolated value" in said for said in far["warnings"])
    near = study("converge", "--values", "0.97050,0.96854,0.96178", "--sizes", "1,2,4", "--json")
    assert near.json["warnings"] == []


TABLE = """material,Space,specimen,Force
soft,2d,1,1.00
soft,3d,1,1.10
stiff,2d,1,2.00
stiff,3d,1,2.20
soft,2d,2,1.05
soft,3d,2,1.15
{stiff},2d,2,2.10
stiff,3d,2,2.30
"""
ASKED = ("--response", "Force", "--factors", "material,Space", "--block", "specimen")


@pytest.mark.parametrize("label", ["Stiff", "st iff", "stiff"])
def test_levels_that_differ_in_capitals_or_spaces_alone_are_named(home: Path, label: str) -> None:
    (home / "t.csv").write_text(TABLE.format(stiff=label))
    answer = study("analyze", "t.csv", *ASKED, "--error", "pooled", "--model", "1", "--json")
    assert answer.code == 0, answer.err
    named = [one for one in answer.json["warnings"] if "differ in capitals or spaces" in one]
    assert len(named) == (label != "stiff")  # once, not by two rules
    assert all(f"'stiff' and '{label}'" in one for one in named)


def test_a_format_is_checked_before_anything_is_computed(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from study import api

    def compute(*_: object, **__: object) -> None:
        raise AssertionError("something was computed")

    (home / "t.csv").write_text(TABLE.format(stiff="stiff"))
    for verb in ("analyze", "load"):
        monkeypatch.setattr(api, verb, compute, raising=False)
    words = ("--report", "out", "--format", "htm")
    for command in (("analyze", "t.csv", *ASKED, *words), ("report", "small", "--format", "htm")):
        answer = study(*command)
        assert answer.code == 2
        assert "did you mean 'html'?" in answer.err
    assert not (home / "out").exists()
