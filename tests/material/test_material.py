"""Declaration of energies, construction of materials, and conversions."""

import importlib
import inspect
import math
import pkgutil

import numpy as np
import pytest

import study.mechanics.material as room
from study.ground.errors import InputError
from study.mechanics.material.energy import Energy, poisson_from_bulk
from study.mechanics.material.input_file import convert
from study.mechanics.material.material import MODELS, Material, constant_names, energy_named
from study.mechanics.material.ogden import ogden_terms
from study.mechanics.material.polynomial import coefficient_table


def every_kind_of(base):
    """A class and all classes derived from it, at any depth."""
    return {base}.union(*(every_kind_of(one) for one in base.__subclasses__()))


def test_every_energy_has_its_name_and_its_line_in_the_registry():
    for module in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
        importlib.import_module(module.name)
    written = {
        kind.name
        for kind in every_kind_of(Energy)
        if not inspect.isabstract(kind) and kind.__module__.startswith(room.__name__)
    }
    assert set(MODELS) == written


def test_no_name_of_an_energy_is_ever_lost():
    """Study files that hold it are there; a new energy needs no place here."""
    assert set(MODELS) >= {
        "linear-elastic", "neo-hookean", "mooney-rivlin", "reduced-polynomial", "polynomial",
        "ogden", "yeoh", "arruda-boyce", "gent", "extended-tube", "van-der-waals",
        "veronda-westmann", "fung", "ogden-hill",
    }  # fmt: skip


def test_constants_have_the_names_that_their_energy_says():
    for model in MODELS:
        names = constant_names(model)
        material = Material(model, dict.fromkeys(names, 1.0), poisson_ratio=0.3)
        assert material.names == names


def test_constants_are_put_in_order():
    material = Material("ogden", {"alpha1": 4.0, "mu1": 1.0}, incompressible=True)
    assert material.names == ("mu1", "alpha1")
    mu, alpha = ogden_terms(material.constants)
    assert (mu[0], alpha[0]) == (1.0, 4.0)
    poly = Material("polynomial", {"C02": 3.0, "C10": 1.0, "C11": 2.0}, incompressible=True)
    assert poly.names == ("C10", "C11", "C02")
    assert coefficient_table(poly.constants).tolist() == [[0, 0, 3], [1, 2, 0]]


def test_shear_and_bulk_moduli():
    mr = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, poisson_ratio=0.4995)
    assert mr.mu0 == pytest.approx(1.0)
    assert mr.bulk == pytest.approx(2 * (1 + 0.4995) / (3 * (1 - 2 * 0.4995)))
    assert mr.bulk_gradient() == pytest.approx({"C10": 2 * mr.bulk, "C01": 2 * mr.bulk})
    assert poisson_from_bulk(mr.mu0, mr.bulk) == pytest.approx(0.4995, abs=1e-12)
    assert poisson_from_bulk(1.0, math.inf) == 0.5
    fixed = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, bulk_modulus=100)
    assert fixed.bulk_gradient() == {"C10": 0.0, "C01": 0.0}


def test_with_constants():
    material = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, incompressible=True)
    assert material.with_constants({"C01": 0.2}).constants == {"C10": 0.4, "C01": 0.2}
    assert material.with_constants(np.array([1, 2])).constants == {"C10": 1.0, "C01": 2.0}
    with pytest.raises(InputError, match="takes 2 constants"):
        material.with_constants([1, 2, 3])


@pytest.mark.parametrize(
    ("model", "constants", "rest", "words"),
    [
        ("neo-hokean", {"C10": 1}, {"incompressible": True}, "did you mean 'neo-hookean'"),
        ("neo-hookean", {"C01": 1}, {"incompressible": True}, "is no constant of neo-hookean"),
        ("mooney-rivlin", {"C10": 1}, {"incompressible": True}, "material.C01"),
        ("reduced-polynomial", {"C10": 1, "C30": 1}, {"incompressible": True}, "material.C20"),
        ("neo-hookean", {"C10": math.nan}, {"incompressible": True}, "must be finite"),
        ("neo-hookean", {"C10": 1}, {}, "exactly one of"),
        ("neo-hookean", {"C10": 1}, {"poisson_ratio": 0.4, "bulk_modulus": 1}, "exactly one of"),
        ("neo-hookean", {"C10": 1}, {"poisson_ratio": 0.5}, "incompressible = true"),
        ("neo-hookean", {"C10": 1}, {"poisson_ratio": -1.0}, "above -1"),
        ("neo-hookean", {"C10": 1}, {"bulk_modulus": -2.0}, "must be positive"),
    ],
)
def test_bad_materials(model, constants, rest, words):
    with pytest.raises(InputError, match=words):
        Material(model, constants, **rest)


@pytest.mark.parametrize("order", [0, -1, 2.5, True])
def test_bad_orders(order):
    with pytest.raises(InputError, match="whole number"):
        constant_names("ogden", order)
    with pytest.raises(InputError, match="has no order"):
        constant_names("neo-hookean", 2)


def test_ogden_classical_round_trip():
    # V44: Treloar's rubber, mu0 = 1/2 sum m a = 0.4225 MPa
    # classical: W = sum m / a (sum l^a - 3) (Ogden 1972), so mu = m a / 2
    treloar = enumerate([(0.63, 1.3), (0.0012, 5.0), (-0.01, -2.0)], start=1)
    constants = {
        k: v for i, (m, a) in treloar for k, v in ((f"mu{i}", m * a / 2), (f"alpha{i}", a))
    }
    material = Material("ogden", constants, incompressible=True)
    assert material.mu0 == pytest.approx(0.4225, rel=1e-15)
    back = convert(material, "ogden-classical").constants
    assert [back["m1"], back["m2"], back["m3"]] == pytest.approx([0.63, 0.0012, -0.01], rel=1e-14)


YEOH = {"C10": 1.0, "C20": 2.0, "C30": 3.0}


@pytest.mark.parametrize(
    ("model", "constants", "convention", "words"),
    [
        ("reduced-polynomial", YEOH, "abacus", "did you mean 'abaqus'"),
        ("reduced-polynomial", YEOH, "ogden-classical", "for ogden materials"),
    ],
)
def test_what_other_codes_have_not(model, constants, convention, words):
    with pytest.raises(InputError, match=words):
        convert(Material(model, constants, incompressible=True), convention)


@pytest.mark.parametrize("model", ["arruda-boyce", "gent", "extended-tube", "van-der-waals",
                                   "veronda-westmann", "fung"])  # fmt: skip
def test_starts_are_inside_bounds_and_have_the_modulus_asked_for(model):
    energy = energy_named(model)
    names = energy.constant_names()
    values = energy.starting_values(names, 0.4225)
    assert Material(model, values, incompressible=True).mu0 == pytest.approx(0.4225, rel=1e-12)
    assert energy.forbidden(values) == {}
    low = {name: energy.bounds(name)[0] - 1 for name in names}
    assert set(energy.forbidden(low)) == set(names)
