"""Ranges in a study file: runs, surface, predictions, distributions and page, by closed forms."""

import math
import re

import numpy as np
import pandas as pd
import pytest

import study as public
from study.ground.errors import InputError
from tests.cli.small import CSV, pressed, refusal, responses, success
from tests.conftest import ROOT
from tests.pages import both_pages

#: an incompressible cylinder between frictionless plates: its force is known by hand
DESIGN = pressed(
    """[material]
model = "neo-hookean"
C10 = "5 kPa"
incompressible = true
[forward]
model = "closed-form"
[factors]
material.C10 = { low = "5 kPa", high = "10 kPa" }
specimen.radius = { low = "0.9 cm", high = "1.1 cm" }
specimen.height = { low = "18 mm", high = "22 mm" }
[design]
kind = "latin-hypercube"
runs = 30
"""
    + responses(peak_force="0.05 N")
    + CSV,
    study='[study]\nname = "ranges"\n',
    test='displacement = "3 mm"\nsteps = 2\n',
)
FACTORS = ("material.C10", "specimen.radius", "specimen.height")
CENTRE = "material.C10=7.3 kPa, specimen.radius=10.2 mm, specimen.height=19.5 mm"


def _force(c10_kPa, radius_mm, height_mm):  # noqa: N803
    """Force in N at 3 mm (Treloar 1975, The Physics of Rubber Elasticity)."""
    stretch = 1 - 3.0 / height_mm
    return np.pi * radius_mm**2 * 2e-3 * c10_kPa * (stretch**-2 - stretch)


def _shares():
    """Total indices on a grid: the force is a product, so its variance is one of products."""
    x = (np.arange(400) + 0.5) / 400
    parts = (5 + 5 * x, (9 + 2 * x) ** 2, _force(1.0, 1.0, 18 + 4 * x))
    spread = [float(np.var(p) / np.mean(p) ** 2) for p in parts]
    whole = np.prod([1 + s for s in spread]) - 1
    return [float(1 - (np.prod([1 + s for s in spread]) / (1 + s) - 1) / whole) for s in spread]


#: distributions of two of its inputs
UNCERTAIN = """
[uncertainty]
material.C10 = { distribution = "normal", mean = "7 kPa", sd = "0.4 kPa" }
specimen.radius = { distribution = "uniform", low = "9.8 mm", high = "10.2 mm" }
"""


@pytest.fixture
def ran(ranges, monkeypatch):
    """What the run printed, in its folder."""
    monkeypatch.chdir(ranges.folder)
    return ranges.answer


def test_total_indices_are_those_of_the_closed_form(ran):
    (surface,) = ran.json["surfaces"]
    assert surface["surface"]["kind"] == "emulator"
    assert surface["surface"]["q2"] > 0.99
    assert surface["runs"] == 30
    told = {row["factor"]: row for row in surface["sensitivity"]}
    for name, share in zip(FACTORS, _shares(), strict=True):
        low, high = told[name]["T_interval"]
        assert low <= share <= high, name
    shown = {row["factor"]: row for row in ran.json["verdicts"]}
    assert set(shown) == set(FACTORS)
    assert all(row["p"] is None for row in shown.values())
    # the least effect of the radius: 2 mm at the softest and tallest, six times what matters
    assert shown["specimen.radius"]["verdict"] == "matters, if confirmed"


@pytest.mark.usefixtures("ran")
def test_a_prediction_is_the_closed_form_within_its_interval():
    answer = success("predict", "ranges", "--at", CENTRE, "--json")
    (found,) = answer.json["predictions"]
    assert found["low"] <= _force(7.3, 10.2, 19.5) <= found["high"]
    assert found["high"] - found["low"] < 0.02 * found["value"]

    rng = np.random.default_rng(7)
    at = dict(
        zip(FACTORS, rng.uniform([5.2, 0.92, 18.2], [9.8, 1.08, 21.8], (200, 3)).T, strict=True)
    )
    (many,) = public.predict("ranges", at)
    c10, radius_cm, height = at.values()
    exact = _force(c10, 10 * radius_cm, height)
    assert np.mean((many.low <= exact) & (exact <= many.high)) >= 0.95


@pytest.mark.usefixtures("ran")
def test_what_cannot_be_predicted_is_refused():
    for at, told in (
        (CENTRE.replace("7.3", "11"), "outside the settings that were run"),
        (CENTRE.replace("7.3 kPa", "7.3 mm"), "must be a pressure"),
        (CENTRE.replace("radius", "raduis"), "specimen.radius"),
        (CENTRE.split(", ", maxsplit=1)[0], "has no setting"),
        ("material.C10", "cannot read"),
    ):
        assert told in refusal("predict", "ranges", "--at", at, "--json").err


def test_the_distribution_is_that_of_the_closed_form(ranges):
    (surface,) = ranges.answer.json["surfaces"]
    told = surface["uncertainty"]
    # F = c C10 R^2 at the file's height, 20 mm: a product of independent inputs
    stretch = 1 - 3.0 / 20
    c = math.pi * 2e-3 * (stretch**-2 - stretch)
    half = 0.2
    square = 10.0**2 + half**2 / 3
    fourth = 10.0**4 + 6 * 10.0**2 * half**2 / 3 + half**4 / 5
    mean = c * 7 * square
    variance = c**2 * ((7**2 + 0.4**2) * fourth - 7**2 * square**2)
    assert told["fixed"] == {"specimen.height": 20.0}
    assert abs(told["mean"]["value"] - mean) <= told["mean"]["own"] + 1e-4 * mean
    assert told["sd"]["value"] == pytest.approx(math.sqrt(variance), rel=0.01)
    first = told["inputs"][0]
    assert first["input"] == "material.C10"
    share = (c * 0.4) ** 2 * square**2 / variance
    low, high = first["S_interval"]
    assert low <= share <= high
    halved = c**2 * ((7**2 + 0.2**2) * fourth - 7**2 * square**2)
    assert first["sd_if_halved"] == pytest.approx(math.sqrt(halved), rel=0.01)
    assert first["gain"] == pytest.approx(1 - math.sqrt(halved / variance), abs=0.01)
    # the page says what to measure better
    page = both_pages(ranges.folder / ranges.answer.json["report"])
    assert "Uncertain inputs" in page
    assert "normal, mean 7 kPa, sd 0.4 kPa" in page
    assert "uniform, low 0.98 cm, high 1.02 cm" in page  # in the unit of the range
    assert "twice as well would lower the standard deviation by" in page
    assert "Held there for it" in page


def test_a_standard_uncertainty_is_about_the_value_of_the_file(tmp_path):
    (tmp_path / "ranges.toml").write_text(
        DESIGN + '\n[uncertainty]\nspecimen.radius = "0.2 mm"\nmaterial.C10 = "0.5 kPa"\n'
        + 'specimen.height = "0.1 mm"\n'
    )  # fmt: skip
    with pytest.raises(InputError, match="material.C10"):  # 5 kPa is the end of its range
        public.load_design(tmp_path / "ranges.toml")
    text = DESIGN.replace('C10 = "5 kPa"\nincompressible', 'C10 = "7 kPa"\nincompressible')
    (tmp_path / "ranges.toml").write_text(text + '\n[uncertainty]\nmaterial.C10 = "0.5 kPa"\n')
    found = public.load_design(tmp_path / "ranges.toml")
    assert found.uncertainty == pytest.approx({"material.C10": 0.0005})
    assert found.inputs["material.C10"].numbers == pytest.approx((7.0, 0.5))


def _words(page):
    text = re.sub(
        r"<svg.*?</svg>|<style.*?</style>|<script.*?</script>", "", page.read_text(), flags=re.S
    )
    plain = re.sub(r"<[^>]+>", " ", text).replace("\N{NARROW NO-BREAK SPACE}", " ")
    return re.sub(r"\s+", " ", plain.replace("\N{NO-BREAK SPACE}", " "))


@pytest.fixture
def ranged(ranges):
    return ranges.folder / "reports" / "ranges"


def test_the_answer_names_the_factors_by_what_they_do(ranged):
    words = _words(ranged / "ranges.html")
    answer = words[words.index("Answer Peak force") :].split("What would change")[0]
    found = re.search(
        r"C10 changes it by up to ([\d.]+) N, radius by up to ([\d.]+) N and height by up to "
        r"([\d.]+) N",
        answer,
    )
    assert found is not None, answer
    # the force is a product of three factors that grow or fall throughout, so the range along one
    # follows from its ends; 95 % of the settings of the other two stay below it
    rng = np.random.default_rng(1)
    c10, radius, height = rng.uniform([5, 9, 18], [10, 11, 22], (100_000, 3)).T
    exact = (
        _force(10, radius, height) - _force(5, radius, height),
        _force(c10, 11, height) - _force(c10, 9, height),
        _force(c10, radius, 18) - _force(c10, radius, 22),
    )
    for told, own in zip(found.groups(), exact, strict=True):
        assert float(told) == pytest.approx(float(np.quantile(own, 0.95)), rel=0.02)
    assert "C10, radius and height matter" in answer
    details = (ranged / "ranges-details.html").read_text()
    assert "Not analyzed" not in details
    assert "<h2>Error term" not in details


def test_its_pictures_hold_the_closed_form(ranged):
    data = ranged / "ranges-data"
    along = pd.read_csv(data / "figure-profiler.csv")
    middle = {"material.C10": 7.5, "specimen.radius": 10.0, "specimen.height": 20.0}
    for name, part in along.groupby("factor"):
        at = {**{k: np.full(len(part), v) for k, v in middle.items()}}
        at[str(name)] = part["setting"].to_numpy() * (10 if name == "specimen.radius" else 1)
        exact = _force(*at.values())
        assert ((part["low"] <= exact) & (exact <= part["high"])).all(), name
    reference = dict(zip(along["factor"], along["reference"], strict=True))
    assert reference == pytest.approx(middle | {"specimen.radius": 1.0})
    (predicted,) = public.predict(ranged.parents[1] / "results" / "ranges", reference)
    for name, part in along[along["setting"] == along["reference"]].groupby("factor"):
        told = part[["value", "low", "high"]].to_numpy().ravel()
        ends = (predicted.value[0], predicted.low[0], predicted.high[0])
        assert told == pytest.approx(ends, rel=1e-9), name
    over = pd.read_csv(data / "figure-surface-peak-force-contours.csv")
    assert list(over.columns) == ["material.C10", "specimen.radius", "value"]
    exact = _force(over["material.C10"], 10 * over["specimen.radius"], 20.0)
    assert np.allclose(over["value"], exact, rtol=0.005)
    left = pd.read_csv(data / "figure-surface-peak-force-left-out.csv")
    assert len(left) == 30
    assert np.abs(left["simulated"] - left["predicted"]).max() < 0.01
    assert left["simulated"].nunique() == 30
    shares = pd.read_csv(data / "figure-surface-peak-force-shares.csv").set_index("factor")
    for name, share in zip(middle, _shares(), strict=True):
        assert shares.loc[name, "low"] <= share <= shares.loc[name, "high"]


def test_a_table_has_the_same_page(inside):
    """Montgomery's example 11.2, whose numbers tests/response_surface compares with the book's."""
    chemical = ROOT / "validation" / "statistics" / "chemical_process.csv"
    numeric = "time_min=80..90,temperature_F=170..180"
    asked = ("--response", "yield", "--numeric", numeric, "--report", "out")
    page = inside / success("analyze", chemical, *asked, "--json").json["report"]
    assert "The largest prediction in these ranges is 80.2" in _words(page)
    words = _words(page.with_stem(f"{page.stem}-details"))
    table = pd.read_csv(next(page.parent.glob("*-data/table-coefficients-yield.csv")))
    assert float(table["coefficient"][0]) == pytest.approx(79.94, abs=0.002)
    at = "time_min 86.9 and temperature_F 177"
    assert f"level at a maximum of 80.2, inside the ranges: {at}" in words
    assert "Failures" not in words
    assert "chemical_process.csv --response yield" in words


def test_a_surface_that_cannot_rank_says_so(inside):
    rng = np.random.default_rng(5)
    frame = pd.DataFrame(rng.uniform(size=(40, 2)), columns=["a", "b"]).assign(
        y=rng.normal(size=40)
    )
    frame.to_csv("noise.csv", index=False)
    success("analyze", "noise.csv", "--response", "y", "--numeric", "a,b", "--report", "out")
    assert "fail Surface predicts runs left out" in _words(inside / "out" / "noise.html")
    words = _words(inside / "out" / "noise-details.html")
    assert "do not carry an emulator that could rank the factors: add runs" in words
