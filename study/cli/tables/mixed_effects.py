"""A mixed model as the terminal shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from study.canonical import plain
from study.cli import output
from study.cli.tables.surface_tables import names
from study.errors import Fault, InputError

if TYPE_CHECKING:
    from study.analysis.error.mixed_model import MixedModel
    from study.api.statistics.mixed_effects import MixedOptions


#: flags that a mixed model has a use for
USED = frozenset({
    "--response", "--factors", "--block", "--error", "--model", "--alpha", "--decimal", "--random",
    "--covariates", "--practical", "--contrast",
})  # fmt: skip


def show(
    source: Path,
    flags: Mapping[str, str | None],
    options: MixedOptions,
    results: Path,
    as_json: bool,
) -> None:
    """Fit a mixed model and print it; ``options`` holds what is no text in the flags."""
    from study.api.statistics.mixed_effects import fit_mixed_model

    unused = [flag for flag, value in flags.items() if value and flag not in USED]
    if unused:
        rule = "has no meaning for a mixed model"
        raise InputError([Fault(flag, rule, "leave it out") for flag in unused])
    options["random"], options["covariates"] = (
        names(flags["--random"]),
        names(flags["--covariates"]),
    )
    if blocks := names(flags["--block"]):
        options["block"] = blocks
    if practical := flags["--practical"]:
        options["practical"] = practical
    factors = names(flags["--factors"])
    model = fit_mixed_model(
        source, flags["--response"], factors, options, results=results,
        decimal=flags["--decimal"] or ".",
    )  # fmt: skip
    alpha = options.get("alpha", 0.05)
    if as_json:
        output.print_json(mixed_json(model, alpha))
    else:
        print_mixed(model, alpha)


def check_none(flags: Mapping[str, str | None]) -> None:
    """Refuse what only a mixed model has, where none is asked for."""
    faults = [
        Fault(flag, "belongs to a mixed model", "add --error reml")
        for flag in ("--random", "--covariates")
        if flags[flag]
    ]
    if faults:
        raise InputError(faults)


def mixed_json(model: MixedModel, alpha: float) -> dict[str, object]:
    """Document of a mixed model as ``--json`` shows it; a limit that is not known is null."""
    return {
        "method": "REML",
        "alpha": alpha,
        "rows": model.rows,
        "deviance": model.deviance,
        "components": [plain(component) for component in model.components],
        "terms": [asdict(term) for term in model.terms],
        "slopes": [asdict(slope) for slope in model.slopes],
        "effects": [plain(effect) for effect in model.effects],
        "contrasts": [plain(contrast) for contrast in model.contrasts],
    }


def print_mixed(model: MixedModel, alpha: float) -> None:
    """Print variance components, tests, slopes, means, effects and contrasts."""
    from study.cli.tables.analysis_tables import print_effects

    ends = f"{100 * (1 - alpha):.4g} % interval"
    rows = [["Source", "standard deviation", ends, "share of the variance"]]
    rows += [
        [c.source, output.number(c.sd), _between(c.low, c.high), f"{100 * c.share:.0f} %"]
        for c in model.components
    ]
    output.table(rows, f"Scatter by source (REML, {model.rows} rows)")
    print()
    if model.terms:
        rows = [["Term", "DF", "F-Value", "DF of error", "P-Value"]]
        rows += [
            [term.term, str(term.df), f"{term.f:.2f}", f"{term.df_error:.1f}", _p(term.p)]
            for term in model.terms
        ]
        output.table(rows, "Tests of the fixed terms (Kenward and Roger)")
        print()
    if model.slopes:
        rows = [["Covariate", "change for each unit", ends]]
        rows += [
            [slope.covariate, output.number(slope.value), _between(slope.low, slope.high)]
            for slope in model.slopes
        ]
        output.table(rows, "Slopes")
        print()
    if model.effects:
        print_effects(model.effects, {}, alpha)
    if model.contrasts:
        rows = [["asked for", "difference", f"{ends}, all together", "DF", "p", "verdict"]]
        rows += [
            [c.name, output.number(c.difference), _between(*(c.ci_simultaneous or c.ci or (0, 0))),
             "" if c.df is None else f"{c.df:.1f}", "" if c.p is None else _p(c.p), c.verdict]
            for c in model.contrasts
        ]  # fmt: skip
        output.table(rows, "Differences that were asked for")
        print()


def _between(low: float, high: float) -> str:
    return f"{output.number(low)} to {'unknown' if high == float('inf') else output.number(high)}"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
