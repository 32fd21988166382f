"""The emulator of 60 runs of the needle study against 20 simulations that it has not seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import study as public
from study.harness.design.factors import settings_of
from study.harness.record.record import Record
from study.reporting.results.study_result import StudyResult

DESIGN = Path(__file__).resolve().parents[2] / "designs" / "needle-geometry.toml"

#: the held-out runs lie inside of the settings of all 60: the emulator does not extrapolate
INNER = {
    '{ low = "0.6 mm", high = "1.5 mm" }': '{ low = "0.7 mm", high = "1.4 mm" }',
    '{ low = "25 deg", high = "45 deg" }': '{ low = "27 deg", high = "43 deg" }',
    '{ low = "15 mm", high = "35 mm" }': '{ low = "17.5 mm", high = "33 mm" }',
    '{ low = "5 kPa", high = "15 kPa" }': '{ low = "6 kPa", high = "14 kPa" }',
    '{ low = "0.5 kPa", high = "2 kPa" }': '{ low = "0.65 kPa", high = "1.85 kPa" }',
    "{ low = 0.45, high = 0.495 }": "{ low = 0.454, high = 0.491 }",
}


def _inner(folder: Path) -> Path:
    """Write the design with the ranges of the held-out runs."""
    text = DESIGN.read_text()
    for old, new in INNER.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "inner.toml").write_text(text)
    return folder / "inner.toml"


@pytest.mark.slow
@pytest.mark.verify
def test_held_out_needles_lie_in_their_intervals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sixty = public.run(
        DESIGN, overrides=["design.runs=60"], results=tmp_path / "60", reports=None, jobs=1
    )
    twenty = public.run(
        _inner(tmp_path), overrides=["design.runs=20", "design.seed=77"],
        results=tmp_path / "20", reports=None, jobs=1, refine=False,
    )  # fmt: skip
    known = {f.name: settings_of(f) for f in twenty.design.factors if f.span is not None}
    for response in ("peak_force", "stiffness_at_4_mm"):
        q2 = [one.found.model.q2 for one in sixty.surfaces
              if one.response == response and one.found is not None]  # fmt: skip
        told = [_told(sixty, known, record, response) for record in twenty.records]
        seen = np.array([record.response(response) for record in twenty.records])
        value, low, high = np.array(told).T
        inside = int(np.sum((low <= seen) & (seen <= high)))
        held = 1 - np.sum((value - seen) ** 2) / np.sum((seen - seen.mean()) ** 2)
        with capsys.disabled():
            print(f"\n{response}: {inside} of {seen.size} inside, Q2 {held:.4f} of them, "
                  f"{', '.join(f'{one:.4f}' for one in q2)} of left-out runs")  # fmt: skip
        assert inside >= 18
        assert held > 0.95
        # 30 runs an interface, which learn from each other
        assert len(q2) == 2
        assert min(q2) > 0.95


def _told(
    sixty: StudyResult, known: dict[str, dict[str, float]], record: Record, response: str
) -> tuple[float, float, float]:
    """Predict a run, with its interval."""
    at = {n: known[n][label] if n in known else label for n, label in record.levels.items()}
    (told,) = public.predict(sixty, at, response=response)
    return float(told.value[0]), float(told.low[0]), float(told.high[0])
