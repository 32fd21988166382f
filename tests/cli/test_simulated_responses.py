"""Studies without measurements: responses of the simulation alone, through the public verbs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.small import CSV, pressed, responses, study, success

HEIGHT_MM = 20.0
DEPTH_MM = 4.0
PLACE_MM = 2.5
PRACTICAL_N = 0.2

#: an incompressible cylinder between frictionless plates stays a cylinder: all is known by hand
DESIGN = pressed(
    """[material]
model = "neo-hookean"
C10 = "5 kPa"
incompressible = true
[model]
mesh_size = "5 mm"
[factors]
material.C10 = ["5 kPa", "10 kPa"]
specimen.radius = ["10 mm", "10.1 mm"]
"""
    + responses(peak_force="0.2 N", force_at="", stiffness_at="0.5 N/mm", work="10 N mm",
                peak_contact_pressure="0.5 kPa", contact_area="1 mm^2", dofs="")
    + CSV,
    study='[study]\nname = "alone"\n',
    test='displacement = "4 mm"\nsteps = 8\n',
)  # fmt: skip
for _name in ("force_at", "stiffness_at"):
    DESIGN = DESIGN.replace(f'"{_name}"\n', f'"{_name}"\ndisplacement = "2.5 mm"\n')


def _nominal_MPa(c10_kPa: float, d_mm: float) -> float:  # noqa: N802, N803
    """Nominal stress of the neo-Hookean cylinder (Treloar 1975), positive in compression."""
    stretch = 1 - d_mm / HEIGHT_MM
    return 2e-3 * c10_kPa * (stretch**-2 - stretch)


def _by_hand(c10_kPa: float, radius_mm: float) -> dict[str, float]:  # noqa: N803
    area, end = np.pi * radius_mm**2, 1 - DEPTH_MM / HEIGHT_MM
    at = 1 - PLACE_MM / HEIGHT_MM
    energy = 1e-3 * c10_kPa * (end**2 + 2 / end - 3)
    return {
        "peak_force": area * _nominal_MPa(c10_kPa, DEPTH_MM),
        "force_at_2.5_mm": area * _nominal_MPa(c10_kPa, PLACE_MM),
        "stiffness_at_2.5_mm": area * 2e-3 * c10_kPa * (2 * at**-3 + 1) / HEIGHT_MM,
        "work": area * HEIGHT_MM * energy,
        "peak_contact_pressure": 1e3 * end * _nominal_MPa(c10_kPa, DEPTH_MM),
    }


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "alone.toml").write_text(DESIGN)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_simulated_responses_are_those_of_the_closed_form(folder: Path) -> None:
    found = success("run", "alone.toml", "--jobs", 1, "--json").json
    assert found["cases"] == {"total": 4, "done": 4, "failed": 0, "missing": 0}

    shown = {(row["response"], row["factor"]): row for row in found["verdicts"]}
    assert all(row["p"] is None and row["ci95"] is None for row in shown.values())
    for response in _by_hand(5, 10):
        soft = np.mean([_by_hand(5, radius)[response] for radius in (10, 10.1)])
        # twice the constant is twice the force, so the difference is the mean of the softer three;
        # between two of eight steps the polynomial of fourth degree misses 1e-4 of the tangent
        effect = shown[response, "material.C10"]["effect"]
        assert effect == pytest.approx(soft, rel=1e-3), response

    wider = np.pi * (10.1**2 - 10**2) / (1 - DEPTH_MM / HEIGHT_MM)
    assert shown["contact_area", "specimen.radius"]["effect"] == pytest.approx(wider, rel=1e-3)

    force = shown["peak_force", "material.C10"]
    assert force["verdict"] == "matters"
    assert force["practical"] == PRACTICAL_N
    assert shown["force_at_2.5_mm", "material.C10"]["verdict"] is None  # no practical

    # 2 % of area at 10 kPa are 0.10 N, and 0.20 N is what matters
    assert _by_hand(10, 10.1)["peak_force"] - _by_hand(10, 10)["peak_force"] < PRACTICAL_N
    assert shown["peak_force", "specimen.radius"]["verdict"] == "no practical difference"

    listed = (folder / "reports/alone/alone-data/cases.csv").read_text().splitlines()
    assert "work" in listed[0]

    # what is finished is read again by the verbs that compute nothing
    for verb in ("report", "status"):
        assert study(verb, "alone", "--json").json["cases"]["done"] == len(listed) - 1


@pytest.mark.slow
@pytest.mark.verify
def test_two_studies_of_simulations_are_compared(folder: Path) -> None:
    other = DESIGN.replace('"alone"', '"harder"').replace('"5 kPa", "10 kPa"', '"5 kPa", "20 kPa"')
    (folder / "harder.toml").write_text(other)
    for name in ("alone", "harder"):
        assert study("run", f"{name}.toml", "--jobs", 1, "--json").code == 0
    found = success("diff", "alone", "harder", "--json")
    rows = [row for row in found.json["conclusions"] if row["response"] == "peak_force"]
    assert rows


def test_more_runs_of_a_simulation_are_not_advised(folder: Path) -> None:
    """A simulation gives the same answer again; a finer mesh may give another."""
    design = folder / "alone.toml"
    text = design.read_text().replace('interface = "frictionless"', 'interface = "bonded"')
    design.write_text(text.replace('format = ["csv"]', 'format = ["html"]'))
    found = success("run", design, "--no-refine", "-j", "1")
    said = " ".join(found.out.split()).partition("What would change this?")[2][:400]
    assert "a refined mesh, which was not tried, could move every result" in said
    assert "replicate" not in said
    page = (folder / "reports" / "alone" / "alone-details.html").read_text()
    assert "none: every response is one of the simulation alone" in page
