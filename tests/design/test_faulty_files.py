"""Every key of a study file, wrong in every way: the same rule at the same place, and a mend."""

import re
from itertools import groupby

import pytest

from tests.design import faulty

STORED = faulty.stored()
GROUPS = {
    f"{base}: {table}": list(rows)
    for (base, table), rows in groupby(
        sorted(STORED, key=lambda one: (one.base, one.table)), lambda one: (one.base, one.table)
    )
}


@pytest.mark.parametrize("base", faulty.LOADERS | faulty.OF_SINGLE_RULES)
def test_the_sound_files_are_sound(base):
    assert faulty.faults_of(base, {}) == []


@pytest.mark.parametrize("group", GROUPS)
def test_faults_of_changed_files(group):
    differing, poorer = {}, {}
    for kept in GROUPS[group]:
        found = faulty.faults_of(kept.base, kept.change)
        if [fault[:2] for fault in found] != [fault[:2] for fault in kept.faults]:
            differing[str(kept.change)] = {"kept": kept.faults, "found": found}
        elif any(map(is_poorer, found, kept.faults)):
            poorer[str(kept.change)] = {"kept": kept.faults, "found": found}
    assert differing == {}
    assert poorer == {}


def is_poorer(found, kept):
    """Whether a mend is gone, or no longer names the nearest key."""
    named = re.match(r"did you mean '[^']*'", kept[2])
    return bool(kept[2] and not found[2]) or bool(named and named[0] not in found[2])


def test_every_key_is_changed():
    met = set()
    every = {(base, str(c)) for base in faulty.LOADERS for c in faulty.changes(base, met)}
    assert every <= {(one.base, str(one.change)) for one in STORED}
