"""A mixed model as the terminal shows it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from study.cli import output

if TYPE_CHECKING:
    from study.analysis.error.mixed_model import MixedModel


def mixed_json(found: MixedModel, alpha: float) -> dict[str, object]:
    """Document of a mixed model as ``--json`` shows it; a limit that is not known is null."""
    components = [
        asdict(one) | {"high": None if one.high == float("inf") else one.high}
        for one in found.components
    ]
    return {
        "method": "REML",
        "alpha": alpha,
        "rows": found.rows,
        "deviance": found.deviance,
        "components": components,
        "terms": [asdict(one) for one in found.terms],
        "slopes": [asdict(one) for one in found.slopes],
    }


def print_mixed(found: MixedModel, alpha: float) -> None:
    """Print variance components, tests and slopes of a mixed model."""
    ends = f"{100 * (1 - alpha):.4g} % interval"
    rows = [["Source", "standard deviation", ends, "share of the variance"]]
    rows += [
        [one.source, output.number(one.sd), _between(one.low, one.high), f"{100 * one.share:.0f} %"]
        for one in found.components
    ]
    output.table(rows, f"Scatter by source (REML, {found.rows} rows)")
    print()
    if found.terms:
        rows = [["Term", "DF", "F-Value", "DF of error", "P-Value"]]
        rows += [
            [one.term, str(one.df), f"{one.f:.2f}", f"{one.df_error:.1f}", _p(one.p)]
            for one in found.terms
        ]
        output.table(rows, "Tests of the fixed terms")
        print()
    if found.slopes:
        rows = [["Covariate", "change for each unit", ends]]
        rows += [
            [one.covariate, output.number(one.value), _between(one.low, one.high)]
            for one in found.slopes
        ]
        output.table(rows, "Slopes")
        print()


def _between(low: float, high: float) -> str:
    return f"{output.number(low)} to {'unknown' if high == float('inf') else output.number(high)}"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
