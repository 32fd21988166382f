"""[replicates]: what may be asked, and why something else is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.ground.errors import InputError
from study.harness.design import load, overview
from study.harness.design.study_file import Replicates

DESIGN = (Path(__file__).parents[2] / "designs" / "ecoflex-compression.toml").read_text()
MESHES, NOISE = "\n[replicates]\nmesh_seeds = 5\n", "\n[replicates]\nnoise = 200\n"


def faults(text: str) -> dict[str, str]:
    with pytest.raises(InputError) as caught:
        load.loads(text, "x.toml")
    return {f.where.removeprefix("x.toml: "): f"{f.rule} | {f.mend}" for f in caught.value.faults}


def test_both_kinds_are_read_and_described() -> None:
    assert load.loads(DESIGN).replicates == Replicates()
    meshes, noise = load.loads(DESIGN + MESHES), load.loads(DESIGN + NOISE)
    assert meshes.replicates == Replicates(mesh_seeds=5)
    assert noise.replicates == Replicates(noise=200)
    assert overview.replication(load.loads(DESIGN)) is None
    told = overview.overview(meshes).to_json()["replicates"]
    assert (told["kind"], told["count"]) == ("mesh-seeds", 5)
    assert "5 meshes" in told["sentence"]
    assert "(E3)" in told["sentence"]
    told = overview.overview(noise).to_json()["replicates"]
    assert (told["kind"], told["count"]) == ("noise", 200)
    assert "200 times" in told["sentence"]
    assert "(E2)" in told["sentence"]


def test_a_dump_keeps_them_and_an_override_changes_them() -> None:
    whole = load.loads(DESIGN + NOISE)
    assert load.loads(load.dump(whole)).replicates == whole.replicates
    changed = load.loads(DESIGN + NOISE, "x.toml", ["replicates.noise=50"])
    assert changed.replicates.noise == 50


@pytest.mark.parametrize(
    ("table", "where", "says"),
    [
        ("mesh_seed = 5", "replicates.mesh_seed", "mesh_seeds"),
        ("mesh_seeds = true", "replicates.mesh_seeds", "whole number"),
        ("noise = 20000", "replicates.noise", "from 0 to 10000"),
        ("noise = '200'", "replicates.noise", "whole number"),
    ],
)
def test_bad_values_say_the_rule_and_the_value(table: str, where: str, says: str) -> None:
    assert says in faults(f"{DESIGN}\n[replicates]\n{table}\n")[where]


def test_noise_needs_a_fit() -> None:
    given = DESIGN
    for energy in ("neo-hookean", "mooney-rivlin", "reduced-polynomial-2", "reduced-polynomial-3"):
        constant = '\nC10 = "10 kPa"' + ('\nC01 = "1 kPa"' if energy == "mooney-rivlin" else "")
        preset = f"[presets.material.{energy}]"
        given = given.replace(preset, preset + constant)
    given = given.replace('method = "auto"', 'method = "none"').replace("\norder = ", "\n#")
    found = faults(given + NOISE)["replicates.noise"]
    assert "in 32 of 32 cells the constants are given and nothing is fitted" in found
    assert "mesh_seeds" in found
    load.loads(given + MESHES)


def test_noise_needs_a_calibrated_constant_as_response() -> None:
    without = DESIGN.replace('name = "mu0"', 'name = "work_error"').replace(
        'transform = "log"\npractical = "10 % of mean"', ""
    )
    found = faults(without + NOISE)["replicates.noise"]
    assert "no response is one" in found
    assert 'name = "mu0"' in found
    load.loads(without + MESHES)  # which meshes do not need


def test_mesh_seeds_need_something_that_has_a_mesh() -> None:
    plates = 'plates = ["frictionless", "bonded"]\n'
    found = faults(DESIGN.replace(plates, "").replace(
        "[test]\n", '[test]\ninterface = "frictionless"\n'
    ) + MESHES)  # fmt: skip
    assert "the same on every mesh" in found["replicates.mesh_seeds"]


def test_their_scatter_as_error_needs_replicates() -> None:
    asked = DESIGN.replace('error = "auto"', 'error = "replicates"')
    assert "asks for none" in faults(asked)["analysis.error"]
    assert load.loads(asked + NOISE).analysis.error == "replicates"
