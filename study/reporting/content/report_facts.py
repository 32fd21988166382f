"""One analysis as the report shows it, and the cells of a study gathered and named.

A log response is analyzed on logarithms; its effects arrive as ratios and its means as
geometric means, so everything downstream is in the response's own unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from study.record.record import answered_often, cell_names
from study.reporting.content.text import clean, name_of
from study.reporting.results.study_result import ReportData, ResponseAnalysis
from study.statistics.analysis.analysis_result import Assumptions
from study.statistics.analysis.anova_table import Effect, Row, SimpleEffect
from study.statistics.analysis.simple_effects import CLAIMS

if TYPE_CHECKING:
    import pandas as pd


#: what the effects are compared with, by its source
ERROR_TERMS = {
    "E0": "independent replicates in the cells",
    "E1": "measured replicates as blocks",
    "E2": "measurement noise, by bootstrap through the fit",
    "E3": "mesh-seed replicates",
    "E4": "numerical uncertainty",
    "E5": "pooled high-order interactions (an assumption)",
    "E6": "Lenth's pseudo standard error",
    "E7": "none",
}

_Value = TypeVar("_Value", Effect, SimpleEffect, Row)


def practical_of(facts: Facts, frame: pd.DataFrame) -> float:
    """Smallest difference that matters in the response's unit; 0 where none was declared."""
    value = facts.practical or 0.0
    return value * abs(float(frame["mean"].mean())) if facts.relative else value


@dataclass(frozen=True)
class Facts(ResponseAnalysis):
    """One response as a report shows it: its analysis, in the order of the design."""

    #: Effects with the levels in the order of the design; what is not finite is None.
    terms: tuple[Effect, ...] = ()
    #: Notes of the analysis, or why there is none.
    warnings: tuple[str, ...] = ()
    #: What the blocks are: phantom, batch.
    block: str = "block"
    is_table: bool = False

    @property
    def assumptions(self) -> Assumptions:
        """Tests of the assumptions; none where there is no analysis."""
        return Assumptions() if self.result is None else self.result.assumptions

    @property
    def rows(self) -> tuple[Row, ...]:
        """Rows of the ANOVA table; what is not finite is None."""
        return () if self.result is None else tuple(map(_finite, self.result.anova.rows))

    @property
    def noun(self) -> str:
        """Title inside a sentence: a column, or a symbol such as C10, has no article."""
        is_symbol = re.fullmatch(r"\S*\d\S*", self.title) is not None
        return self.title if self.is_table or is_symbol else f"the {self.title}"

    @property
    def is_mixed(self) -> bool:
        """Whether effects were tested in a mixed model by REML, as some blocks lack cells."""
        return any(row.error == "REML" for row in self.rows)

    @property
    def alpha(self) -> float:
        """One minus the level of the intervals."""
        return 0.05 if self.result is None else self.result.request.alpha

    @property
    def ratio(self) -> bool:
        """Whether effects are ratios."""
        return self.transform == "log"

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The main effects."""
        return tuple(effect for effect in self.terms if effect.is_main)

    @property
    def hang_on_missing(self) -> frozenset[str]:
        """Main effects whose claim another answer of the missing runs could take away."""
        claimed = {effect.term for effect in self.effects if effect.verdict in CLAIMS}
        bounds = () if self.result is None else self.result.failure_bounds
        return frozenset(b.term for b in bounds if b.can_change_verdict and b.term in claimed)

    @property
    def has_size(self) -> bool:
        """Whether a smallest difference that matters was given: without one there is no verdict."""
        return any(effect.practical is not None for effect in self.effects)

    @property
    def interactions(self) -> tuple[Effect, ...]:
        """The effects of more than one factor."""
        return tuple(effect for effect in self.terms if not effect.is_main)

    @property
    def difference_unit(self) -> str:
        """Unit of a difference: percentage points for a response in percent."""
        return "pp" if self.unit == "%" else self.unit

    @property
    def scale(self) -> str:
        """Unit of what is analyzed less its mean."""
        return "log ratio" if self.ratio else self.difference_unit


def facts(data: ReportData) -> tuple[Facts, ...]:
    """Read every analysis of a report."""
    return tuple(_read(data, response) for response in data.analyses)


def _read(data: ReportData, response: ResponseAnalysis) -> Facts:
    title, unit = response.title or name_of(response.name, data.labels), clean(response.unit)
    shown = Facts(
        **vars(response) | {"title": clean(title), "unit": unit, "is_table": data.is_table}
    )
    if (result := response.result) is None:
        return replace(shown, warnings=(response.refused,) if response.refused else ())
    terms = tuple(_as_designed(effect, data.factors) for effect in result.effects)
    return replace(shown, terms=terms, warnings=result.notes, block=clean(data.block) or "block")


def _finite(value: _Value) -> _Value:
    """Copy of a value with None for every number that is not finite: a dash is printed for it."""
    lost: dict[str, Any] = {
        item.name: None
        for item in fields(value)
        if isinstance(number := getattr(value, item.name), float) and not math.isfinite(number)
    }
    return replace(value, **lost) if lost else value


def _as_designed(effect: Effect, factors: Mapping[str, Sequence[str]]) -> Effect:
    """Effect with the levels of a factor, their means and intervals in the order of its design."""
    effect = replace(
        _finite(effect), simple_effects=tuple(_finite(item) for item in effect.simple_effects)
    )
    order = [effect.levels.index(v) for v in factors.get(effect.term, ()) if v in effect.levels]
    if len(order) != len(effect.levels):
        return effect
    ends, letters = effect.mean_ci95, effect.letters
    return replace(
        effect,
        levels=tuple(effect.levels[i] for i in order),
        mean=tuple(effect.mean[i] for i in order),
        mean_ci95=None if ends is None else tuple(ends[i] for i in order),
        letters=tuple(letters[i] for i in order) if letters else (),
    )


def is_effect(row: Row, factors: Sequence[str]) -> bool:
    """Whether a row of the table is an effect, not the blocks or an error stratum."""
    return set(row.term.split(":")) <= set(factors)


def comparable(data: ReportData, response: str) -> pd.DataFrame:
    """Rows with the response, of the blocks that every computed cell shares.

    Cells answered in half of the blocks or fewer are left out, as in the analysis. All rows
    where there are no blocks, or none that all cells share.
    """
    complete = data.table.dropna(subset=[response])
    if not data.blocks or "block" not in complete or complete.empty:
        return complete
    factors = list(data.factors)
    cell, block = cell_names(complete, factors), complete["block"].astype(str)
    if len({*zip(cell, block, strict=True)}) == len({*cell}) * len({*block}):  # all in each block
        return complete
    often = answered_often(complete, factors, "block", complete["block"].nunique())
    if not data.is_table and often.any():  # an analysis of a table leaves out none
        complete, cell = complete[often], cell[often]
    per_block = cell.groupby(complete["block"].astype(str)).nunique()
    whole = per_block.index[per_block == cell.nunique()]
    if len(whole) in (0, len(per_block)):
        return complete
    return complete[complete["block"].astype(str).isin(whole)]


def cells(data: ReportData, response: str, factors: Sequence[str] | None = None) -> pd.DataFrame:
    """Mean response of every cell, or by the levels of some factors; best (lowest) first."""
    factors = list(data.factors if factors is None else factors)
    rows = comparable(data, response)
    log = any(r.name == response and r.transform == "log" for r in data.analyses)
    values = rows[response].astype(float)
    rows = rows[factors].astype(str).assign(y=np.log(values) if log else values)
    grouped = rows.groupby(factors, sort=False)["y"].agg(["mean", "count"]).reset_index()
    if log:
        grouped["mean"] = np.exp(grouped["mean"])
    # where every case failed there is no row to join the levels of
    grouped["cell"] = cell_names(grouped, factors) if len(grouped) else ""
    renamed = grouped.rename(columns={"count": "n"})
    return renamed.sort_values("mean", kind="stable").reset_index(drop=True)


def block_name(block: str, data: ReportData) -> str:
    """Name of a block; a number alone is preceded by what it numbers."""
    return clean(f"{data.block} {block}" if data.block and block[:1].isdigit() else block)


def grouped_inputs(inputs: Mapping[str, str]) -> dict[str, str]:
    """Join inputs with dotted keys into one line for each first part, in the order given."""
    lines: dict[str, list[str]] = {}
    for key, value in inputs.items():
        part, _, rest = clean(key).partition(".")
        # a shape, a kind or a model is its own name
        names = [] if rest in ("", "shape", "kind", "model") else rest.split(".")
        lines.setdefault(part, []).append(" ".join([*map(name_of, names), clean(value)]))
    return {part: ", ".join(items) for part, items in lines.items()}
