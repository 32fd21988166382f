"""``study analyze --numeric`` with ``--factors``: one surface a combination of labels."""

import json

import numpy as np
import pytest
from scipy.stats import qmc

import study as public
from study.ground.errors import InputError
from tests.cli.small import study, success
from tests.pages import both_pages

#: times depth squared: what the second material adds to the force
EXTRA = 0.35


def table(folder, runs=24, lost=""):
    """Write runs of two materials: tip depth^1.5, and depth^2 besides in the second."""
    random = np.random.default_rng(3)
    rows = ["material,tip,depth,force"]
    depths = []
    for material, extra in (("neo-hookean", 0.0), ("ogden", EXTRA)):
        cube = qmc.LatinHypercube(2, rng=random, optimization="random-cd").random(runs)
        for u, v in cube:
            tip, depth = 0.5 + 1.5 * u, 1 + 3 * v
            depths.append(depth)
            force = tip * depth**1.5 + extra * depth**2
            rows.append(f"{material},{tip:.6f},{depth:.6f},{force:.9f}")
    (folder / "runs.csv").write_text("\n".join(rows + ([lost] if lost else [])) + "\n")
    return folder / "runs.csv", (min(depths), max(depths))


def test_labels_are_compared_over_the_ranges(tmp_path):
    path, (low, high) = table(tmp_path)
    one, other = public.fit_surfaces(path, "force", ["tip", "depth"], ["material"], practical=1.0)
    assert [surface.labels for surface in (one, other)] == [
        {"material": "neo-hookean"}, {"material": "ogden"},
    ]  # fmt: skip
    (told,) = other.differences
    square = (high**3 - low**3) / (3 * (high - low))
    assert (told.level, told.other, told.verdict) == ("ogden", "neo-hookean", "matters")
    assert told.mean == pytest.approx(EXTRA * square, abs=told.bound)
    assert one.differences == ()
    assert one.surface is not None
    at = one.surface.predict({"tip": [1.0], "depth": [2.0]})
    assert at.value[0] == pytest.approx(2**1.5, rel=0.01)


def test_terminal_page_and_json_have_every_combination(inside):
    table(inside, lost="ogden,1.0,2.0,")
    asked = ("analyze", "runs.csv", "--response", "force", "--numeric", "tip,depth",
             "--factors", "material", "--practical", "1")  # fmt: skip
    shown = success(*asked, "--report", "page")
    assert "Force at material neo-hookean" in shown.out
    assert "Force with material ogden is 2.4" in shown.out
    assert shown.err.count("1 run without a response left out") == 1
    page = both_pages(inside / "page" / "runs.html")
    assert "How does force depend on material, tip and depth?" in page
    assert "Force with material ogden is 2.4" in page
    found = json.loads(study(*asked, "--json").out)["surfaces"]
    assert [one["at"]["material"] for one in found] == ["neo-hookean", "ogden"]
    assert found[1]["differences"][0]["verdict"] == "matters"


def test_a_combination_without_a_surface_is_named_and_the_others_stand(inside):
    table(inside, lost="gent,1.0,2.0,3.0")
    shown = success("analyze runs.csv --response force --numeric tip,depth --factors material")
    assert "material = gent: factor 'tip': has one setting in every run" in shown.err
    assert "Force at material ogden" in shown.out
    assert "gent\nNo surface: factor 'tip': has one setting in every run" in shown.out


def test_labels_that_never_meet_are_compared_where_they_do(tmp_path):
    """Of three combinations the last has neither first level beside it at its other label."""
    x = np.random.default_rng(1).permutation(np.linspace(0, 1, 14))
    rows = [
        f"{m},{k},{v:.4f},{np.sin(3 * v) + (k == 'q') + 2 * (m == 'b'):.6f}"
        for m, k in (("a", "p"), ("a", "q"), ("b", "q"))
        for v in x
    ]
    (tmp_path / "gap.csv").write_text("\n".join(["m,k,x,y", *rows]))
    found = public.fit_surfaces(tmp_path / "gap.csv", "y", ["x"], ["m", "k"])
    told = [[(d.factor, d.level, round(d.mean, 2)) for d in one.differences] for one in found]
    assert told == [[], [("k", "q", 1.0)], [("m", "b", 2.0)]]


def test_labels_in_too_many_combinations_are_refused(tmp_path):
    rows = ["name,x,y", *(f"n{k},{k % 7},{k}" for k in range(130))]
    (tmp_path / "many.csv").write_text("\n".join(rows))
    with pytest.raises(InputError, match="130 combinations, and each gets a surface"):
        public.fit_surfaces(tmp_path / "many.csv", "y", ["x"], ["name"])
