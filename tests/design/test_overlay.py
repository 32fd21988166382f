"""Keys that may vary: all of them declared, each with the dimension of its declaration."""

import pytest

from study.ground.declaration import keys_of, written_keys
from study.mechanics.material.material import ENERGIES
from study.simulation import problem_file


@pytest.mark.parametrize("name", problem_file.PLACES)
def test_keys_that_rule_exclude_or_vary_are_declared(name):
    place = problem_file.PLACES[name]
    declared = {key for kind in place.sections for key in written_keys(kind)}
    assert {*place.varying, *place.alternatives, place.ruling} - {""} <= declared
    assert all(problem_file.may_vary(f"{name}.{key}") for key in place.keys)


@pytest.mark.parametrize("name", [name for name in problem_file.PLACES if name != "measurements"])
def test_a_key_has_the_dimension_of_its_declaration(name):
    # keys of several tables share a name, such as the radius of a specimen and of an indenter
    for kind in problem_file.PLACES[name].sections:
        for key in keys_of(kind):
            if problem_file.may_vary(f"{name}.{key.written}"):
                said = key.reads.dimension if key.reads is not None else ""
                assert problem_file.dimension_of(f"{name}.{key.written}") == (said or None), (
                    key.written
                )


@pytest.mark.parametrize("energy", ENERGIES.values(), ids=list(ENERGIES))
def test_constants_of_every_energy_may_vary_and_take_the_place_of_others(energy):
    keys = energy.list_keys or energy.constant_names(1)
    for key in keys:
        assert problem_file.may_vary(f"material.{key}")
        plain = energy.is_dimensionless(key)
        assert problem_file.dimension_of(f"material.{key}") == ("number" if plain else "pressure")
    laid = problem_file.lay(
        {"material": {"model": "another", **dict.fromkeys(keys, 1), "no_constant": 1}},
        {"material.model": energy.name},
    )
    assert set(laid["material"]) == {"model", "no_constant", *keys}
    for other in ENERGIES.values():
        left = problem_file.lay(laid, {"material.model": other.name})["material"]
        assert all(other.has_key(key) for key in keys if key in left)
