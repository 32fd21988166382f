"""The project keeps the rules of the house; the layers are checked by import-linter."""

import ast
from pathlib import Path

import pytest

from scripts import ledger
from tests import house

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize(
    "breaches",
    [
        house.undeclared_imports,
        house.unused_dependencies,
        house.late_imports,
        house.constants_in_tuples,
        house.stray_statistics,
        house.unread_searches,
        house.environment_readers,
        house.poorly_explained,
    ],
    ids=lambda rule: rule.__name__,
)
def test_no_rule_of_the_house_is_broken(breaches):
    assert list(breaches(ROOT)) == []


def test_no_number_of_the_house_has_risen():
    """Budgets by room, and what ``[tool.house.numbers]`` lets in for now."""
    risen = list(ledger.risen(ROOT, ledger.counts_of(ROOT)))
    assert risen == [], "mend them, or run scripts/ledger.py --write and say for what it grew"


def test_every_room_is_closed_to_execution():
    """A room that is new stands in the contract, too."""
    rooms = _names("study/ground") | _names("study") - {"study.ground", "study.__main__"}
    open_to_it = {
        "execution",
        "ground.errors",
        "ground.files",
        "ground.working_folder",
    }
    assert set(_closed_to_execution()) == rooms - {f"study.{name}" for name in open_to_it}


def _names(package):
    """Full names of what stands in a package."""
    stems = {path.stem for path in (ROOT / package).iterdir() if path.stem != "__init__"}
    return {f"{package.replace('/', '.')}.{stem}" for stem in stems if stem != "__pycache__"}


def _closed_to_execution():
    return house.contract(ROOT, "execution")["forbidden_modules"]


def test_no_text_from_a_file_is_ever_run():
    found = [
        f"{path}:{line}: {what}"
        for path, tree in house.trees(ROOT)
        for line, what in house.forbidden(tree)
    ]
    assert found == []


@pytest.mark.parametrize(
    "code",
    ["assert x", "eval(x)", "exec(x)", "x.query(y)", "import pickle", "from pickle import load"],
)
def test_the_search_sees_a_breach(code):
    assert list(house.forbidden(ast.parse(code)))


def test_rooms_with_a_licence_exist():
    """A rule that names a room that is gone lets nobody off, and says nothing."""
    places = (*house.MAY_READ_ENVIRONMENT, *house.COMPILED, *house.STATISTICS)
    assert [place for place in places if not (ROOT / place).exists()] == []
