"""Effects followed from mesh to mesh: errors that cancel, errors that do not, and gaps."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pandas as pd
import pytest

from study.ground.errors import InputError
from study.statistics.analysis.anova import anova
from study.statistics.analysis.work_precision import mesh_series

H = {"coarse": 4.0, "medium": 2.0, "fine": 1.0}
MESHES = tuple(H)
FACTORS = ["material", "space", "mesh"]
TRUE = {"soft": 5.0, "stiff": 9.0, "other": 6.0}


def study(
    error: Callable[[str, str], float], order: float = 2.0, blocks: int = 4, noise: float = 0.01
) -> pd.DataFrame:
    """Cells of a true value plus ``error(material, space) h**order``, in several blocks."""
    rng = np.random.default_rng(5)
    shift = rng.normal(0, 0.3, blocks)
    rows = [
        {
            "material": m, "space": s, "mesh": mesh, "block": f"B{b}",
            "y": TRUE[m] + error(m, s) * h**order + shift[b] + noise * rng.normal(),
        }
        for m, s, (mesh, h), b in product(TRUE, ("flat", "full"), H.items(), range(blocks))
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_an_error_that_all_materials_share_leaves_their_difference_alone() -> None:
    found = mesh_series(
        study(lambda m, s: 0.5, noise=0.0), "y", FACTORS, "mesh", MESHES, block="block"
    )
    assert set(found) == {"material", "space", "material:space"}
    for analyzed, values in found["material"].pairs():
        # the sums of twelve cells round in the last digits
        assert values == pytest.approx([analyzed] * 3, abs=1e-12)
    assert {round(abs(a), 9) for a, _ in found["material"].pairs()} == {4.0, 3.0, 1.0}


def test_an_error_of_its_own_is_in_the_series_of_the_difference() -> None:
    own = {"soft": 0.0, "stiff": 0.1, "other": 0.0}
    table = study(lambda m, s: own[m], noise=0.0)
    found = mesh_series(table, "y", FACTORS, "mesh", MESHES, block="block")
    pairs = {round(float(v[-1]), 6): (a, v) for a, v in found["material"].pairs()}
    # stiff over soft: 4 + 0.1 h^2 on each mesh, 4 + 0.1 (16 + 4 + 1) / 3 as analyzed
    analyzed, values = pairs[-4.1]
    assert values == pytest.approx([-5.6, -4.4, -4.1])
    assert analyzed == pytest.approx(-4.7)


def test_what_is_analyzed_is_what_the_analysis_reports() -> None:
    table = study(lambda m, s: 0.1 * (m == "stiff") + 0.05 * (s == "full"), noise=0.2)
    result = anova(
        table, "y", FACTORS, block="block", records=True, exact=False, practical=1.0, model=2
    )
    found = mesh_series(table, "y", FACTORS, "mesh", MESHES, block="block", model=2)
    for name, series in found.items():
        assert np.ptp(series.analyzed) == pytest.approx(result.effect(name).range)
        # averaged over the meshes, the effects of each are the effect
        assert series.by_mesh.mean(axis=0) == pytest.approx(series.analyzed)


def test_an_interaction_is_followed_by_its_pure_components() -> None:
    table = study(lambda m, s: 0.1 if (m, s) == ("stiff", "full") else 0.0, noise=0.0)
    found = mesh_series(table, "y", FACTORS, "mesh", MESHES, block="block")
    # the component of stiff and full is 1/3 of 0.1 h^2 (2/3 of the materials, 1/2 of the spaces)
    top = found["material:space"].by_mesh.max(axis=1)
    assert top == pytest.approx([1.6 / 3, 0.4 / 3, 0.1 / 3])
    # of fifteen pairs of six combinations several are one, up to the sign
    assert len(list(found["material:space"].pairs())) < 15


def test_a_log_response_is_followed_on_the_log() -> None:
    table = study(lambda m, s: 0.1 * (m == "stiff"), noise=0.0)
    table["y"] = np.exp(table["y"])
    found = mesh_series(table, "y", FACTORS, "mesh", MESHES, block="block", transform="log")
    ranges = np.ptp(found["material"].by_mesh, axis=1)
    assert ranges == pytest.approx([5.6, 4.4, 4.1])


def test_without_blocks_the_cells_are_the_series() -> None:
    table = study(lambda m, s: 0.1 * (m == "stiff"), blocks=1, noise=0.0)
    found = mesh_series(table, "y", FACTORS, "mesh", MESHES)
    assert np.ptp(found["material"].by_mesh, axis=1) == pytest.approx([5.6, 4.4, 4.1])


def test_a_cell_without_all_meshes_is_no_series_and_its_levels_fall_back() -> None:
    table = study(lambda m, s: 0.1 * (m == "stiff"), noise=0.0)
    gap = (table["material"] == "other") & (table["mesh"] == "fine")
    one = gap & (table["space"] == "flat")
    found = mesh_series(table[~one], "y", FACTORS, "mesh", MESHES, block="block", model=1)
    # other has a whole column left, in the full space
    assert set(found) == {"material", "space"}
    assert np.ptp(found["material"].by_mesh[-1]) == pytest.approx(4.1)
    found = mesh_series(table[~one], "y", FACTORS, "mesh", MESHES, block="block", model=2)
    # with their interaction in the model, both effects lean on the combination that is missing
    assert found == {}
    found = mesh_series(table[~gap], "y", FACTORS, "mesh", MESHES, block="block", model=1)
    assert set(found) == {"space"}
    scattered = table[(table["mesh"] == "fine") != (table["material"] == "soft")]
    assert mesh_series(scattered, "y", FACTORS, "mesh", MESHES, block="block", model=1) == {}


def test_every_effect_has_its_own_uncertainty_and_one_that_is_absent_none() -> None:
    table = study(lambda m, s: 0.1, noise=0.05)
    options = {"block": "block", "records": True, "exact": False, "practical": 1.0, "model": 1}
    result = anova(table, "y", FACTORS, u_num={"material": 0.5, "space": 2.0}, **options)  # type: ignore[arg-type]
    material, space, mesh = result.effects
    assert (material.u_num, space.u_num, mesh.u_num) == (0.5, 2.0, 0.0)
    assert material.effect_over_u_num == pytest.approx((material.range or 0) / 0.5)
    assert (material.verdict, mesh.verdict) == ("matters", "matters")
    assert (result.detection.u_num, result.detection.u_num_by_term) == (2.0, True)
    rows = {row["factor"]: row["u_num"] for row in result.verdicts()}
    assert rows == {"material": 0.5, "space": 2.0, "mesh": 0.0}
    worse = anova(table, "y", FACTORS, u_num={"material": 9.0}, **options)  # type: ignore[arg-type]
    assert worse.effect("material").verdict == "not resolved by the mesh"
    assert "numerical uncertainty would have to be below" in worse.effect("material").why
    one = anova(table, "y", FACTORS, u_num=2.0, **options)  # type: ignore[arg-type]
    assert {e.u_num for e in one.effects} == {2.0}
    assert not one.detection.u_num_by_term


def test_an_uncertainty_of_what_is_no_term_is_refused() -> None:
    table = study(lambda m, s: 0.1)
    with pytest.raises(InputError, match=r"'materials' is no term"):
        anova(table, "y", FACTORS, block="block", records=True, u_num={"materials": 1.0})


def test_cells_are_one_computation_within_the_smallest_uncertainty() -> None:
    """A large uncertainty of one contrast makes no copies of cells that another tells apart."""
    table = study(lambda m, s: 0.01, noise=0.001)
    options = {"block": "block", "records": True, "exact": False, "model": 1}
    # materials are 1 to 4 apart; the spaces agree, the meshes differ by up to 0.15
    apart = anova(table, "y", FACTORS, u_num={"material": 0.5, "space": 9.0}, **options)  # type: ignore[arg-type]
    assert apart.data.distinct == 3
    assert anova(table, "y", FACTORS, u_num=9.0, **options).data.distinct == 1  # type: ignore[arg-type]


def test_a_log_effect_is_held_against_its_share_of_the_mean() -> None:
    table = study(lambda m, s: 0.0, noise=0.01)
    tenth = 0.1 * float(np.exp(table["y"].mean()))
    table["y"] = np.exp(table["y"])
    result = anova(
        table, "y", FACTORS, block="block", records=True, exact=False, transform="log",
        practical="20 % of mean", u_num={"material": tenth}, model=1,
    )  # fmt: skip
    material = result.effect("material")
    # a ratio of exp(4), against a tenth on the log
    assert material.effect_over_u_num == pytest.approx(np.log(material.range or 1) / 0.1)
    assert material.effect_over_u_num == pytest.approx(40, rel=0.01)
