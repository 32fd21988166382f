"""Distributions of inputs in a study file: the response's distribution against closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import study as public
from study.ground.errors import InputError
from tests.cli.small import Finished
from tests.cli.test_numeric_factors import DESIGN
from tests.pages import both_pages


def test_the_distribution_is_that_of_the_closed_form(ranges: Finished) -> None:
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


def test_the_page_says_what_to_measure_better(ranges: Finished) -> None:
    page = both_pages(ranges.folder / ranges.answer.json["report"])
    assert "Uncertain inputs" in page
    assert "normal, mean 7 kPa, sd 0.4 kPa" in page
    assert "uniform, low 0.98 cm, high 1.02 cm" in page  # in the unit of the range
    assert "twice as well would lower the standard deviation by" in page
    assert "Held there for it" in page


@pytest.mark.parametrize(
    ("written", "told"),
    [
        ('material.C10 = { distribution = "gamma", mean = "7 kPa" }', "gamma"),
        ('material.C10 = { distribution = "normal", mean = "7 kPa" }', "sd: is missing"),
        (
            'material.C10 = { distribution = "normal", mean = "7 kPa", sd = "3 kPa" }',
            "% of it lies",
        ),
        ('material.C10 = { distribution = "normal", mean = "7 mm", sd = "1 kPa" }', "pressure"),
        ('material.C10 = { distribution = "uniform", low = "8 kPa", high = "6 kPa" }', "rise"),
        ('material.C10 = { distribution = "uniform", low = "6 kPa", high = "8 kPa", sd = "1 kPa" }',
         "is no number of a uniform"),
        ('test.displacement = { distribution = "uniform", low = "2 mm", high = "3 mm" }',
         "is no range of"),
        ('material.C10 = { distribution = "lognormal", median = "7 kPa", factor = 0.5 }', "factor"),
        ('material.C10 = "-1 kPa"', "must be above 0"),
    ],
)  # fmt: skip
def test_what_is_no_distribution_is_refused(tmp_path: Path, written: str, told: str) -> None:
    (tmp_path / "ranges.toml").write_text(f"{DESIGN}\n[uncertainty]\n{written}\n")
    with pytest.raises(InputError, match=told):
        public.load_design(tmp_path / "ranges.toml")


def test_a_standard_uncertainty_is_about_the_value_of_the_file(tmp_path: Path) -> None:
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
