"""A mixed model as the terminal shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from study.cli import output
from study.cli.tables.surface_tables import names
from study.errors import Fault, InputError

if TYPE_CHECKING:
    from study.analysis.error.mixed_model import MixedModel


#: flags that a mixed model has a use for
USED = frozenset({
    "--response", "--factors", "--block", "--error", "--model", "--alpha", "--decimal", "--random",
    "--covariates",
})  # fmt: skip


def show(
    source: Path,
    flags: Mapping[str, str | None],
    model: str | int | list[str] | None,
    alpha: float | None,
    results: Path,
    as_json: bool,
) -> None:
    """Fit a mixed model and print it.

    Parameters
    ----------
    source : Path
        Results of a study, or a tidy CSV.
    flags : mapping of str to str or None
        Flags of the command, as they were given.
    model : str, int, list of str or None
        Terms, as it was read.
    alpha : float or None
        Size of the tests.
    results : Path
        Where results are kept.
    as_json : bool
        Whether a program reads it.
    """
    from study.api.statistics.mixed_effects import fit_mixed_model

    unused = [flag for flag, value in flags.items() if value and flag not in USED]
    if unused:
        rule = "has no meaning for a mixed model"
        raise InputError([Fault(flag, rule, "leave it out") for flag in unused])
    level = 0.05 if alpha is None else alpha
    found = fit_mixed_model(
        source, flags["--response"], names(flags["--factors"]), block=flags["--block"],
        random=names(flags["--random"]), covariates=names(flags["--covariates"]),
        model=model, alpha=level, results=results,
        decimal=flags["--decimal"] or ".",
    )  # fmt: skip
    if as_json:
        output.print_json(mixed_json(found, level))
        return
    print_mixed(found, level)


def check_none(flags: Mapping[str, str | None]) -> None:
    """Refuse what only a mixed model has, where none is asked for.

    Parameters
    ----------
    flags : mapping of str to str or None
        Flags of the command, as they were given; ``--random`` and ``--covariates`` must be among
        them.

    Raises
    ------
    InputError
        If one of these two is not empty.
    """
    faults = [
        Fault(flag, "belongs to a mixed model", "add --error reml")
        for flag in ("--random", "--covariates")
        if flags[flag]
    ]
    if faults:
        raise InputError(faults)


def mixed_json(found: MixedModel, alpha: float) -> dict[str, object]:
    """Document of a mixed model as ``--json`` shows it; a limit that is not known is null.

    Parameters
    ----------
    found : MixedModel
        Fitted by restricted maximum likelihood.
    alpha : float
        Size of the tests: its intervals have the level 1 - alpha.
    """
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
    """Print variance components, tests and slopes of a mixed model.

    Parameters
    ----------
    found, alpha : MixedModel, float
        As for :func:`mixed_json`.
    """
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
