"""The shipped tracker study, from the generator to the answer: what was put in is found again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

import study
from study import api
from study.cli.app import run
from study.ground.errors import InputError
from study.laboratory.tracker.tracker_recording import (
    STAGES,
    Errors,
    load_tracking,
    write_recording,
)

DESIGN = Path(__file__).parents[2] / "designs" / "tracker.toml"


def test_two_commands_lead_from_nothing_to_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["virtual", str(tmp_path), "--from", str(DESIGN)]) == 0
    assert "study tracking" in capsys.readouterr().err
    told = json.loads((tmp_path / "tracker" / "markers.csv.virtual.json").read_text())
    again = ["tracking", str(DESIGN), "--data", str(tmp_path), "--reports", str(tmp_path)]
    assert run([*again, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "Figure missing" not in Path(found["report"]).read_text()
    distance, displacement = found["distance"], found["displacement"]
    assert [one["stage"] for one in distance["stages"]] == [name for name, _ in STAGES]
    # the error term of stages within passes: one visit to each in every pass
    rows = {row["term"]: row for row in distance["comparison"]["anova"]["rows"]}
    assert rows["stage"]["df_error"] == (len(STAGES) - 1) * (told["errors"]["passes"] - 1)
    (effect,) = distance["comparison"]["effects"]
    assert effect["verdict"] == "matters"
    assert effect["range"] == pytest.approx(told["errors"]["bias_mm"], abs=0.03)
    low, high = displacement["line"]["scale_interval"]
    assert low < told["errors"]["scale"] < high


def test_intervals_hold_what_was_put_in_95_times_of_100(tmp_path: Path) -> None:
    declared, held, studies = load_tracking(DESIGN), np.zeros(3), 20
    for seed in range(studies):
        errors = replace(Errors(seed), samples=10)
        write_recording(declared, tmp_path, errors)
        found = study.tracking(DESIGN, data=tmp_path)
        bias, line = found.distance.bias_interval_mm, found.displacement.line
        held += [
            bias[0] < errors.bias_mm / len(STAGES) < bias[1],
            line.scale_interval[0] < errors.scale < line.scale_interval[1],
            line.offset_interval[0] < 0 < line.offset_interval[1],
        ]
    print(f"held by {held} of {studies} intervals: bias, scale, offset")
    assert (held >= binom.ppf(5e-4, studies, 0.95)).all(), held


def test_a_tracker_has_no_specimens(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no design"):
        api.virtual(tmp_path, DESIGN, blocks=3)


def test_a_reference_cannot_be_made_up(tmp_path: Path) -> None:
    file = tmp_path / "poses.toml"
    file.write_text(
        DESIGN.read_text() + '\n[reference]\nfile = "laser.csv"\nmarker = "tip"\n'
        'stage = "pose"\nposition = ["x", "y", "z"]\n'
    )
    with pytest.raises(InputError, match="have no reference"):
        api.virtual(tmp_path, file)
