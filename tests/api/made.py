"""Studies made of numbers alone: known effects, real analyses, nothing computed."""

from functools import cache
from itertools import product

import numpy as np
import pandas as pd

from study.api.assemble import Study
from study.harness.design.load import loads
from study.reporting.results.study_result import ResponseAnalysis
from study.statistics.analysis.anova import anova
from tests.cli.small import DESIGN

FACTORS = {"material": ("soft", "stiff", "other"), "space": ("flat", "full")}
BLOCKS = ("B1", "B2", "B3", "B4", "B5", "B6")


@cache
def analyzed(material, space, noise, practical, response, rename, transform):
    """Analysis of cell means, once for all studies that are made of it."""
    new = dict(rename)
    rng = np.random.default_rng(3)
    shift = rng.normal(0, 0.3, len(BLOCKS))
    rows = [
        {
            new.get("material", "material"): new.get(m, m),
            new.get("space", "space"): new.get(s, s),
            "block": b,
            response: mean + space * (s == "full") + shift[i] + noise * rng.normal(),
        }
        for (m, mean), s, (i, b) in product(
            zip(FACTORS["material"], material, strict=True), FACTORS["space"], enumerate(BLOCKS)
        )
    ]
    names = [new.get(f, f) for f in FACTORS]
    return anova(
        pd.DataFrame(rows), response, names, block="block", practical=practical, exact=False,
        transform=transform,
    )  # fmt: skip


def made(
    folder,
    *,
    name="first",
    material=(5.0, 7.0, 5.1),
    space=0.02,
    noise=0.02,
    height="30 mm",
    practical="0.5 pp",
    response="relative_rms_force_error",
    rename=None,
    better="lower",
    transform="none",
    **manifest,
):
    """Study whose cell means are ``material`` plus ``space`` for the second space.

    ``rename`` gives factors or levels other names.
    """
    renamed = tuple((rename or {}).items())
    result = analyzed(material, space, noise, practical, response, renamed, transform)
    limit = float(practical.split()[0])
    analysis = ResponseAnalysis(response, "%", result, limit, transform=transform, better=better)
    known = {"blocks": list(BLOCKS), "files": {"a.csv": "0" * 64}, "virtual": False,
             "versions": {"study": "1"}}  # fmt: skip
    text = DESIGN.replace('"small"', f'"{name}"', 1).replace('"30 mm"', f'"{height}"')
    design = loads(text.replace('"0.5 pp"', f'"{practical}"'), name)
    return Study(design, folder / name, (), 36, known | manifest, analyses=(analysis,))
