"""The public names are a contract: this test changes only when the contract does."""

import importlib.metadata
import tomllib
from pathlib import Path

import pytest

import study

ROOT = Path(__file__).resolve().parent.parent
PUBLIC = (
    "load load_design run solve calibrate indentation_modulus analyze fit_surface fit_surfaces "
    "predict optimize inspect invert contrasts mixed_model converge report power export "
    "export_surface require anova ryan_joiner bartlett grid_convergence tracking shape"
)


def test_public_names_are_these():
    assert set(study.__all__) == {*PUBLIC.split(), "__version__"}


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="analyse"):
        _ = study.analyse


def test_version_is_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert study.__version__ == project["version"] == importlib.metadata.version("study")
