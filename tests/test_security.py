"""SECURITY.md: what it claims is held by the tests that it names."""

import re

import pytest

from tests.conftest import ROOT

TEXT = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(test_\w+)`")
#: sections in which every point in bold letters is a claim that names its tests
SECTIONS = ("The working folder", "Caches", "Files that are read", "Programs")


def points(section):
    """Points of the lists of a section that begin with words in bold letters."""
    (body,) = re.findall(rf"^## {section}\n(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL)
    return re.findall(r"^- (\*\*.*)$", body, re.MULTILINE)


@pytest.mark.parametrize("section", SECTIONS)
def test_every_claim_names_a_test(section):
    claims = points(section)
    assert len(claims) >= 3
    assert [claim for claim in claims if not TEST.search(claim)] == []


def test_every_test_that_is_named_exists():
    named = TEST.findall(TEXT)
    assert named
    for file, name in named:
        assert re.search(rf"^def {name}\(", (ROOT / file).read_text(), re.MULTILINE), (file, name)
