"""A mixed model of a study, a table or a file: blocks and other columns as random factors."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from study import api
from study.analysis.error.mixed_model import MixedModel, mixed_model, random_terms
from study.errors import Fault, InputError
from study.tidy_csv import names_of, read_csv

if TYPE_CHECKING:
    from collections.abc import Sequence

    from study.analysis.linear_model.design_matrix import Model
    from study.analysis.request import Practical


class MixedOptions(TypedDict, total=False):
    """Keywords of :func:`study.mixed_model`, where they are described."""

    block: str | Sequence[str] | None
    random: Sequence[str]
    covariates: Sequence[str]
    model: Model
    practical: Practical
    contrasts: Sequence[str]
    alpha: float


def fit_mixed_model(
    source: str | Path,
    response: str | None,
    factors: Sequence[str],
    options: MixedOptions,
    *,
    results: str | Path = Path("results"),
    decimal: str = ".",
) -> MixedModel:
    """Fit a mixed model by REML to one response of a study or of a CSV with one row a run.

    A study lends its first response, its factors and its specimens as blocks where none are named.

    Raises
    ------
    InputError
        If a column is missing, or the rows cannot tell the terms.
    """
    path = Path(source)
    if path.is_file() and path.suffix != ".toml":
        if response is None:
            raise InputError(Fault("--response", "is missing", "name the column of the response"))
        blocks = names_of(options.get("block"))
        terms = random_terms(factors, blocks, options.get("random", ()))
        random = [n for n in dict.fromkeys(n for t in terms for n in t) if n not in factors]
        labels = (factors, random) if factors else (random[:1], random[1:])
        table = read_csv(path, response, *labels, None, decimal, options.get("covariates", ()))
        return mixed_model(table, response, factors, **options)
    study = api.open_study(source, results)
    if options.get("covariates"):
        rule = "a study has factors alone"
        raise InputError(Fault("--covariates", rule, "give a CSV with that column"))
    if len(study.manifest["blocks"]) < 3:
        rule = "a mixed model needs three blocks or more"
        raise InputError(Fault("measurements.block", rule, "add specimens, or leave out reml"))
    model = study.design.analysis.model
    defaults: MixedOptions = {"block": "block", "model": model if isinstance(model, str | int) else
                              list(model)}  # fmt: skip
    options = {**defaults, **options}
    chosen = next((r for r in study.design.responses if r.name == response), None)
    chosen = study.design.responses[0] if response is None else chosen
    if chosen is not None:
        options.setdefault("practical", chosen.practical)
    names = list(factors) or [f.name for f in study.design.factors if len(f.levels) > 1]
    named = str(response) if chosen is None else chosen.name
    return mixed_model(study.table, named, names, **options)
