"""Which claims fall with one block: asked of a quick analysis first, then of the exact one."""

import numpy as np
import pandas as pd
import pytest

from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    ResponseScale,
    Threshold,
)
from study.statistics.analysis.anova import analyze, effects

TABLE = pd.DataFrame(
    [(a, c, b) for a in "hl" for c in "xy" for b in ("s1", "s2", "s3", "s4", "s5", "s6")],
    columns=["A", "C", "block"],
)


@pytest.mark.parametrize(
    ("seeds", "fewest"), [([2], 1), pytest.param(range(16), 3, marks=pytest.mark.slow)]
)
def test_the_quick_analysis_claims_no_more(seeds, fewest):
    """Blocks without which a claim falls are those of the exact analysis, table by table."""
    asked = AnalysisRequest(
        "y", ("A", "C"), Blocking(block=("block",)), "full",
        scale=ResponseScale(practical=Threshold(0.4)), exact=False,
    )  # fmt: skip
    differs = 0
    for seed in seeds:
        noise = np.random.default_rng(seed).normal(0, 0.35, len(TABLE))
        table = TABLE.assign(y=(TABLE["A"] == "h") + noise)
        whole = analyze(table, asked)
        for effect in whole.effects:
            if effect.lost_without is None:
                continue
            left_out = [
                {e.term: e.verdict for e in effects(table[table["block"] != name], asked)}
                for name in table["block"].unique()
            ]
            fallen = [found[effect.term] != effect.verdict for found in left_out]
            lost = tuple(table["block"].unique()[fallen])
            assert effect.lost_without == lost
            differs += len(lost) > 0
    assert differs >= fewest
