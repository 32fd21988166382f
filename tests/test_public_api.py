"""The public names are a contract: this test changes only when the contract does."""

import importlib.metadata
import tomllib
from pathlib import Path

import pytest

import study
from study.ground.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
PUBLIC = {
    "load",
    "load_design",
    "run",
    "solve",
    "calibrate",
    "indentation_modulus",
    "analyze",
    "fit_surface",
    "fit_surfaces",
    "predict",
    "optimize",
    "inspect",
    "invert",
    "contrasts",
    "mixed_model",
    "converge",
    "report",
    "power",
    "export",
    "export_surface",
    "require",
    "anova",
    "ryan_joiner",
    "bartlett",
    "grid_convergence",
    "tracking",
    "shape",
}


def test_public_names_are_these():
    assert set(study.__all__) == PUBLIC | {"__version__"}


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="analyse"):
        _ = study.analyse


def test_version_is_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert study.__version__ == project["version"] == importlib.metadata.version("study")


def test_a_name_that_is_too_long_is_bad_input_of_every_function(tmp_path):
    long = "x" * 300
    asked = {
        "load": (long,),
        "load_design": (long,),
        "run": (long,),
        "report": (long,),
        "solve": (long,),
        "calibrate": (long,),
        "inspect": (long,),
        "converge": (long,),
        "analyze": (long, "y", ["a"]),
        "predict": (long, {"a": 1}),
        "invert": (long, long),
        "power": (long,),
        "require": (long,),
        "tracking": (long,),
        "export": (long,),
        "shape": (long, long),
    }
    for name, arguments in asked.items():
        with pytest.raises(InputError, match="too long"):
            getattr(study, name)(*arguments)
    with pytest.raises(InputError, match="too long"):
        study.optimize(long, minimize="y")
    assert study.run is study.run
