"""Statistics on the records of a study: rows and question of each response, as its design says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from study.ground.errors import InputError
from study.ground.tabular import names_of
from study.harness.design.load import is_constant
from study.harness.record.record import answered_often, table
from study.harness.runner.study_uncertainty import finest_mesh, numerical_bound
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    ResponseScale,
    threshold,
)
from study.statistics.analysis.anova import analyze, effects
from study.statistics.analysis.linear_model import Model, terms_of
from study.statistics.analysis.repeats import common_seeds

if TYPE_CHECKING:
    import pandas as pd

    from study.harness.design.spec import Design
    from study.harness.design.study_file import ResponseSpec
    from study.harness.record.record import Record
    from study.statistics.analysis.analysis_request import AnovaOptions
    from study.statistics.analysis.analysis_result import AnalysisResult
    from study.statistics.analysis.anova_table import Effect
    from study.statistics.convergence.grid_convergence import NumericalUncertainty


def analyze_records(
    design: Design,
    records: Sequence[Record],
    response: ResponseSpec,
    numerical: Sequence[NumericalUncertainty] = (),
    factors: Sequence[str] = (),
    options: AnovaOptions | None = None,
) -> AnalysisResult:
    """Analyze one response of a study as its design says, but for options that are given."""
    rows, request, notes = _asked(design, records, response, numerical, factors, options or {})
    return analyze(rows, request).noted(*notes)


def effects_of_records(
    design: Design,
    records: Sequence[Record],
    response: ResponseSpec,
    numerical: Sequence[NumericalUncertainty] = (),
) -> tuple[Effect, ...]:
    """Effects alone of :func:`analyze_records`: no checks, and no block left out in turn."""
    rows, request, _ = _asked(design, records, response, numerical, (), {})
    return effects(rows, request)


def _asked(
    design: Design,
    records: Sequence[Record],
    response: ResponseSpec,
    numerical: Sequence[NumericalUncertainty],
    factors: Sequence[str],
    options: AnovaOptions,
) -> tuple[pd.DataFrame, AnalysisRequest, tuple[str, ...]]:
    """Rows to analyze, what is asked of them, and what was left out of them."""
    if not any(record.converged for record in records):
        raise InputError(f"no case has an answer for {response.name}")
    spec, blocks = design.analysis, {record.block for record in records} - {None}
    given: AnovaOptions = {
        "type": spec.type,
        "model": spec.model if isinstance(spec.model, (str, int)) else list(spec.model),
        "error": spec.error,
        "alpha": spec.alpha,
        "seed": design.seed,
        "practical": response.practical,
        "transform": response.transform,
        # what was simulated alone says nothing of specimens, and needs none
        "specimens": max(len(blocks), 1) if design.is_measured else None,
    }
    given.update(cast("AnovaOptions", {k: v for k, v in options.items() if v is not None}))
    block = given.get("block") or ("block" if len(blocks) > 1 else None)
    names = [f.name for f in design.factors]
    factors = list(factors) or [f.name for f in design.factors if len(f.levels) > 1]
    whole, gaps = table(list(records)), tuple[str, ...]()
    if isinstance(block, str | None):
        rows = rows_for(whole, response.name, names, given["error"], block)
        whole, gaps = without_gaps(
            design, rows.table, response.name, factors, rows.block, given["model"],
            finest_mesh(design, records),
        )  # fmt: skip
        block = rows.block
    else:  # blocks that cross, as in a Latin square
        rows = RecordRows(whole, None, options.get("error") or "auto")
    u_num = numerical_bound(design, numerical, records, whole, response.name, given["transform"])
    request = AnalysisRequest(
        response.name,
        tuple(factors),
        Blocking(
            names_of(block), given.get("unit"), names_of(given.get("whole_plot")),
            given.get("replicates", rows.replicates), given.get("copies", "refuse"),
        ),
        given["model"],
        given["type"],
        rows.error,
        ResponseScale(given["transform"], threshold(given["practical"]),
                      given.get("u_num", u_num), given.get("tolerance")),
        records=True,
        specimens=given["specimens"],
        alpha=given["alpha"],
        seed=given["seed"],
        exact=given.get("exact", True),
    )  # fmt: skip
    return whole, request, (*rows.notes, *gaps)


#: spread over the meshes of a cell, over the response, below which the mesh does not enter
_SAME = 1e-12
_NOISE = "noise_seed"
_MESH = "mesh_seed"
_RUN = "replicate"


@dataclass(frozen=True)
class RecordRows:
    """Rows to analyze, and what they are."""

    table: pd.DataFrame
    block: str | None
    #: {"auto", "pooled", "own"}: how the error is found.
    error: str = "auto"
    #: {"auto", "noise"}: what the rows of one cell are.
    replicates: str = "auto"
    #: What was left out and why.
    notes: tuple[str, ...] = ()


def rows_for(
    table: pd.DataFrame, response: str, factors: Sequence[str], error: str, block: str | None
) -> RecordRows:
    """Rows of a study's table for one response."""
    by_replicates = error == "replicates"
    how = "auto" if by_replicates else error
    if _RUN in table:
        kept = table.drop(columns=_RUN)
        return RecordRows(kept, block, how, "runs")
    if _NOISE in table:
        return _noise_rows(table, response, factors, error, block)
    if _MESH not in table:
        return RecordRows(table, block, how)
    cells = [*factors, *([block] if block else [])]
    groups = table.groupby(cells, sort=False, dropna=False)[response]
    widest = (groups.max() - groups.min()).max()
    if not bool(widest > _SAME * table[response].abs().max()):
        first = table[table[_MESH] == table[_MESH].min()].drop(columns=_MESH)
        note = f"the mesh does not enter {response}: it is the same on every mesh, no E3"
        return RecordRows(first, block, how, notes=(note,))
    if block and by_replicates:
        table, block = _over(table, response, [*factors, _MESH]), None
    if block:
        return RecordRows(table, block, how)
    labels = table[list(factors)].astype(str).itertuples(index=False, name=None)
    common, reason = common_seeds(list(labels), table[_MESH].tolist())
    if not common or how == "pooled":
        return RecordRows(table, None, how)
    rows = table[table[_MESH].astype(str).isin(common)]
    return RecordRows(rows, _MESH, how, "mesh-seeds", (reason,))


def _noise_rows(
    table: pd.DataFrame, response: str, factors: Sequence[str], error: str, block: str | None
) -> RecordRows:
    """Rows of the refits to resampled noise, or of the fits to the measured curves."""
    by_replicates = error == "replicates"
    how = "auto" if by_replicates else error
    fits = table[table[_NOISE] == 0].drop(columns=_NOISE)
    if not is_constant(response):
        note = f"resampled noise is fitted, not predicted with: no E2 for {response}"
        return RecordRows(fits, block, how, notes=(note,))
    if block and not by_replicates:
        note = (
            "several blocks are a better error term than resampled noise (E1 before E2): the fits "
            'to the measured curves are analyzed; [analysis] error = "replicates" asks for E2'
        )
        return RecordRows(fits, block, how, notes=(note,))
    again = table[table[_NOISE] > 0]
    if block:
        again = _over(again, response, [*factors, _NOISE])
    # pooled takes cells for independent, and has no resample in common
    common = None if how == "pooled" else _NOISE
    return RecordRows(again, common, how, "noise")


def _over(table: pd.DataFrame, response: str, keys: list[str]) -> pd.DataFrame:
    """Mean of the response over the blocks; missing where one of them is."""
    groups = table.groupby(keys, sort=False)[response]
    return groups.agg(lambda values: values.mean(skipna=False)).reset_index()


#: levels that a factor needs to be one
_FEWEST = 2
Cell = tuple[str, ...]


def without_gaps(
    design: Design,
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    block: str | None,
    model: Model,
    finest: tuple[str, str] | None = None,
) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Rows without the levels of which half of the cells or more have no answer.

    Such a level would leave all its siblings with few settings at which they can be compared. It
    is left out, and that is said. So is a level (an energy that is stretched beyond its
    ellipticity on every fine mesh) without any answer at ``finest``, factor and level of the
    finest mesh: what differs on coarser meshes may be their errors. Any other combination of
    levels that fails, while each is sound by itself, leaves no level out: its factors are judged
    at the settings that have answers.
    """
    cells = (tuple(str(t.levels[name]) for name in factors) for t in design.treatments)
    designed = list(dict.fromkeys(cells))
    complete = table.dropna(subset=[response])
    if block is not None and len(complete):
        complete = complete[answered_often(complete, factors, block, table[block].nunique())]
    answered = {tuple(map(str, row)) for row in complete[list(factors)].to_numpy()}
    terms = [[factors.index(name) for name in term] for term in terms_of(factors, model)]
    fine = None if finest is None else (factors.index(finest[0]), finest[1])
    notes = []
    while (worst := _worst(designed, answered, terms, fine)) is not None:
        place, level = worst
        cells_here = [cell for cell in designed if cell[place] == level]
        has = sum(cell in answered for cell in cells_here)
        notes.append(
            f"{level} ({factors[place]}) has an answer in {has} of {len(cells_here)} cells: it is "
            "left out of this analysis"
        )
        designed = [cell for cell in designed if cell[place] != level]
        table = table[table[factors[place]].astype(str) != level]
    return table, tuple(notes)


def _worst(
    designed: Sequence[Cell],
    answered: set[Cell],
    terms: Sequence[Sequence[int]],
    fine: tuple[int, str] | None,
) -> tuple[int, str] | None:
    """Level with most of its cells unanswered, of those that leave a combination empty."""
    answered_cells = [cell for cell in designed if cell in answered]
    shares: dict[tuple[int, str], float] = {}
    for term in terms:
        has = {tuple(cell[i] for i in term) for cell in answered_cells}
        for empty in {tuple(cell[i] for i in term) for cell in designed} - has:
            for place, level in zip(term, empty, strict=True):
                if len({cell[place] for cell in designed}) > _FEWEST:
                    cells = [cell for cell in designed if cell[place] == level]
                    on_finest = [cell for cell in cells if fine and cell[fine[0]] == fine[1]]
                    share = sum(cell in answered for cell in cells) / len(cells)
                    if share <= 0.5 or (on_finest and answered.isdisjoint(on_finest)):
                        shares[place, level] = 1 - share
    return max(sorted(shares), key=lambda key: shares[key], default=None)
