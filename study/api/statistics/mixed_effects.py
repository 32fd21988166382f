"""A mixed model of a study, a table or a file: blocks and their interactions as random effects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from study import api
from study.analysis.error.mixed_model import MixedModel, mixed_model
from study.errors import Fault, InputError
from study.tidy_csv import read_csv

if TYPE_CHECKING:
    from study.analysis.linear_model.design_matrix import Model


def fit_mixed_model(  # noqa: PLR0913  # one keyword for each thing that may be asked
    source: str | Path,
    response: str | None,
    factors: Sequence[str],
    *,
    block: str | None = None,
    random: Sequence[str] = (),
    covariates: Sequence[str] = (),
    model: Model | None = None,
    alpha: float = 0.05,
    results: str | Path = Path("results"),
    decimal: str = ".",
) -> MixedModel:
    """Fit a mixed model by REML to one response of a study or of a CSV.

    Parameters
    ----------
    source : str or Path
        Results folder or design of a study, or a tidy CSV with one row a run.
    response : str or None
        Column of the response; the first response of a study by default.
    factors : sequence of str
        Columns of the fixed factors; all factors of a study by default.
    block, random, covariates, model, alpha
        As for :func:`study.mixed_model`; the blocks of a study are its specimens.
    results : Path
        Folder of the results, where ``source`` is the name of a study.
    decimal : {".", ","}
        Decimal mark of a CSV.

    Returns
    -------
    MixedModel
        Variance components with intervals, tests of the fixed terms, slopes.

    Raises
    ------
    InputError
        If a column is missing, or the rows cannot tell the terms.
    """
    path = Path(source)
    if path.is_file() and path.suffix != ".toml":
        faults = [
            Fault(flag, "is missing", mend)
            for flag, given, mend in (
                ("--response", response, "name the column of the response"),
                ("--block", block, "name the column of the specimens (blocks)"),
            )
            if not given
        ]
        if faults:
            raise InputError(faults)
        named, blocks = (factors, block) if factors else ([str(block)], None)
        table = read_csv(path, str(response), named, blocks, None, decimal, covariates)
        return mixed_model(
            table, str(response), factors, block=str(block), random=random,
            covariates=covariates, model="full" if model is None else model, alpha=alpha,
        )  # fmt: skip
    study = api.open_study(source, results)
    if covariates:
        rule = "a study has factors alone"
        raise InputError(Fault("--covariates", rule, "give a CSV with that column"))
    if len(study.manifest["blocks"]) < 3:
        rule = "a mixed model needs three blocks or more"
        raise InputError(Fault("measurements.block", rule, "add specimens, or leave out reml"))
    spec = study.design.analysis
    asked = spec.model if model is None else model
    return mixed_model(
        study.table, response or study.design.responses[0].name,
        list(factors) or [f.name for f in study.design.factors if len(f.levels) > 1],
        block=block or "block", random=random,
        model=asked if isinstance(asked, (str, int)) else list(asked), alpha=alpha,
    )  # fmt: skip
