"""Surfaces of a study as functions without packages: the same numbers, and what they refuse."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import study as public
from tests.cli.small import study
from tests.cli.test_numeric_factors import DESIGN, _force

LOG = DESIGN.replace('high = "10 kPa" }', 'high = "10 kPa", scale = "log" }')
QUADRATIC = DESIGN.replace('kind = "latin-hypercube"\nruns = 30', 'kind = "central-composite"')


@pytest.mark.parametrize(("text", "kind"), [(LOG, "emulator"), (QUADRATIC, "quadratic")])
def test_the_function_gives_what_the_surface_predicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ranges.toml").write_text(text)
    ran = study("run", "ranges.toml", "--jobs", 1, "--json")
    assert ran.code == 0, ran.err
    (surface,) = ran.json["surfaces"]
    assert surface["surface"]["kind"] == kind
    if kind == "quadratic":
        # the force is linear in C10: half the range times its slope, at the centre of the others
        linear = {row["term"]: row["coefficient"] for row in surface["surface"]["terms"]}
        assert linear["material.C10"] == pytest.approx(_force(10, 10, 20) / 4, rel=0.01)
        assert all(row["p"] is None for row in surface["surface"]["terms"])
    answer = study("export", "ranges", "--as", "emulator", "--json")
    assert answer.code == 0, answer.err
    (told,) = answer.json["functions"]
    assert told["kind"] == kind
    assert told["inputs"][0]["log"] == (text == LOG)
    module = Path(next(name for name in answer.json["files"] if name.endswith(".py")))
    rng = np.random.default_rng(3)
    points = rng.uniform([5.4, 0.93, 18.4], [9.6, 1.07, 21.6], (50, 3))
    at = dict(zip(("material.C10", "specimen.radius", "specimen.height"), points.T, strict=True))
    (known,) = public.predict("ranges", at)
    head = "import sys; sys.path.insert(0, '.'); import {0} as m; "
    asked = head + "print([m.peak_force(*p) for p in {1}])"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", asked.format(module.stem, points.tolist())],
        cwd=module.parent, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = np.array([float(x) for x in done.stdout.strip("[]\n").split(",")])
    assert found == pytest.approx(known.value, rel=1e-9)
    exact = _force(points[:, 0], 10 * points[:, 1], points[:, 2])
    assert np.mean(np.abs(found - exact) <= told["error_bound"]) >= 0.95
    assert told["error_bound"] < 0.05 * exact.mean()
    outside = head + "m.peak_force(4.0, 1.0, 20.0)"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", outside.format(module.stem)],
        cwd=module.parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "C10 = 4.0 is outside of 5.0 to 10.0" in done.stderr
    refused = study("export", "ranges", "--as", "emulator", "--response", "peak_farce", "--json")
    assert refused.code == 2
    assert "peak_force" in refused.err
