"""One analysis as the report reads it: the only place that knows the shape of a result.

A log response is analyzed on logarithms; its effects arrive as ratios and its means as
geometric means, so everything downstream is in the response's own unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from typing import TYPE_CHECKING, Any

from study.record.table import answered_often, cell_names
from study.reporting.effect import Effect, effect_of
from study.reporting.numbers import clean, count, listing, name_of
from study.study_result.report_data import ReportData, ResponseAnalysis

if TYPE_CHECKING:
    import pandas as pd


def practical_of(facts: Facts, frame: pd.DataFrame) -> float:
    """Smallest difference that matters in the response's unit; 0 where none was declared."""
    value = facts.response.practical or 0.0
    return value * abs(float(frame["mean"].mean())) if facts.response.relative else value


@dataclass(frozen=True)
class Facts:
    """What is known about one response."""

    response: ResponseAnalysis
    title: str
    unit: str
    terms: tuple[Effect, ...] = ()
    rows: tuple[Mapping[str, Any], ...] = ()
    anova_type: str = ""
    source: str = ""
    question: str = ""
    reason: str = ""
    df: Any = None
    normality: Mapping[str, Any] | None = None
    variance: Mapping[str, Any] = field(default_factory=dict)
    sphericity: Mapping[str, Any] = field(default_factory=dict)
    non_additivity: Mapping[str, Any] | None = None
    warnings: tuple[str, ...] = ()
    residuals: pd.DataFrame | None = None
    distinct: int | None = None
    copies: tuple[tuple[str, ...], ...] = ()
    lenth: Mapping[str, Any] | None = None
    u_num_by_term: bool = False
    alpha: float = 0.05

    @property
    def name(self) -> str:
        """Column of the response."""
        return self.response.name

    @property
    def ratio(self) -> bool:
        """Whether effects are ratios."""
        return self.response.transform == "log"

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The main effects."""
        return tuple(effect for effect in self.terms if effect.is_main)

    @property
    def interactions(self) -> tuple[Effect, ...]:
        """The effects of more than one factor."""
        return tuple(effect for effect in self.terms if not effect.is_main)

    @property
    def difference_unit(self) -> str:
        """Unit of a difference: percentage points for a response in percent."""
        return "pp" if self.unit == "%" else self.unit

    def row(self, term: str) -> Mapping[str, Any] | None:
        """Row of the ANOVA table of a term."""
        return next((row for row in self.rows if row["term"] == term), None)


def facts(data: ReportData) -> tuple[Facts, ...]:
    """Read every analysis of a report."""
    return tuple(_read(data, response) for response in data.responses)


def _read(data: ReportData, response: ResponseAnalysis) -> Facts:
    title = clean(response.title or name_of(response.name, data.labels))
    if response.result is None:
        warned = (response.refused,) if response.refused else ()
        return Facts(response, title, clean(response.unit), warnings=warned)
    found: Mapping[str, Any] = response.result.to_json()
    error = found.get("error_term") or {}
    anova = found.get("anova") or {}
    distinct = found.get("distinct_computations")
    return Facts(
        response=response,
        title=title,
        unit=clean(response.unit),
        terms=tuple(effect_of(item, data.factors) for item in found.get("effects") or ()),
        rows=tuple(anova.get("rows") or ()),
        anova_type=str(anova.get("type") or ""),
        source=str(error.get("source") or ""),
        question=str(error.get("question") or ""),
        reason=str(error.get("reason") or ""),
        df=error.get("df"),
        normality=_whole(response.result, "normality", found.get("normality")),
        variance={
            name: _whole(response.result, name, test)
            for name, test in (found.get("variance") or {}).items()
        },
        sphericity=found.get("sphericity") or {},
        non_additivity=found.get("non_additivity"),
        warnings=tuple(str(warning) for warning in found.get("warnings") or ()),
        residuals=getattr(response.result, "residuals", None),
        distinct=distinct,
        copies=tuple(tuple(group) for group in found.get("copies") or ()),
        lenth=found.get("lenth"),
        u_num_by_term=bool(getattr(response.result, "u_num_by_term", False)),
        alpha=float(getattr(response.result, "alpha", 0.05)),
    )


def _whole(result: Any, name: str, fallback: Any) -> Any:
    """Return the named test with its reason, which the JSON keeps among the warnings."""
    test = getattr(result, name, None)
    return asdict(test) if is_dataclass(test) and not isinstance(test, type) else fallback


def deciding_p(row: Mapping[str, Any]) -> float | None:
    """Return the p that decides: Greenhouse-Geisser's where it applies."""
    corrected = row.get("p_gg")
    chosen = corrected if corrected is not None else row.get("p")
    return None if chosen is None else float(chosen)


def is_effect(row: Mapping[str, Any], factors: Sequence[str]) -> bool:
    """Whether a row of the table is an effect, not the blocks or an error stratum."""
    return set(str(row["term"]).split(":")) <= set(factors)


def comparable(data: ReportData, response: str) -> pd.DataFrame:
    """Rows with the response, of the blocks that every computed cell shares.

    Cells answered in half of the blocks or fewer are left out, as in the analysis. All rows
    where there are no blocks, or none that all cells share.
    """
    known = data.table.dropna(subset=[response])
    if not data.blocks or "block" not in known or known.empty:
        return known
    factors = list(data.factors)
    known = known[answered_often(known, factors, "block", known["block"].nunique())]
    cell = cell_names(known, factors)
    per_block = cell.groupby(known["block"].astype(str)).nunique()
    whole = per_block.index[per_block == cell.nunique()]
    if len(whole) in (0, len(per_block)):
        return known
    return known[known["block"].astype(str).isin(whole)]


def cells(data: ReportData, response: str, factors: Sequence[str] | None = None) -> pd.DataFrame:
    """Mean response of every cell, or by the levels of some factors; best (lowest) first.

    Returns
    -------
    DataFrame
        The factor columns, ``mean``, ``n``, ``cell`` (the levels joined by ':').
        A log response is averaged as it is analyzed: by the geometric mean. Where some cases
        failed, only blocks that every cell shares are averaged: cells would differ by theirs.
    """
    import numpy as np

    factors = list(data.factors if factors is None else factors)
    known = comparable(data, response)
    log = any(r.name == response and r.transform == "log" for r in data.responses)
    values = known[response].astype(float)
    known = known[factors].astype(str).assign(y=np.log(values) if log else values)
    grouped = known.groupby(factors, sort=False)["y"].agg(["mean", "count"]).reset_index()
    if log:
        grouped["mean"] = np.exp(grouped["mean"])
    grouped["cell"] = cell_names(grouped, factors)
    renamed = grouped.rename(columns={"count": "n"})
    return renamed.sort_values("mean", kind="stable").reset_index(drop=True)


@dataclass(frozen=True)
class Group:
    """Cells that agree in every block, with the mean of the first; ``members`` are their rows."""

    mean: float
    members: tuple[Mapping[str, str], ...]

    def __len__(self) -> int:
        return len(self.members)


def groups(data: ReportData, facts: Facts) -> tuple[Group, ...]:
    """Distinct computations of a response, lowest mean first."""
    frame = cells(data, facts.name)
    place = _places(data, facts, frame)
    found: dict[int, list[int]] = {}
    for row, key in enumerate(place):
        found.setdefault(key, []).append(row)
    levels = frame[list(data.factors)].astype(str).to_dict("records")
    means = frame["mean"].tolist()
    return tuple(
        Group(float(means[rows[0]]), tuple({str(k): v for k, v in levels[i].items()} for i in rows))
        for rows in found.values()
    )


def _places(data: ReportData, facts: Facts, frame: pd.DataFrame) -> list[int]:
    """Index of the group of every cell; a cell that no group names stands alone."""
    analyzed = [name for name, levels in data.factors.items() if len(levels) > 1]
    names = frame[analyzed].astype(str).agg(" ".join, axis=1).tolist() if analyzed else []
    known = {name: i for i, group in enumerate(facts.copies) for name in group}
    alone = len(facts.copies)
    return [known.get(name, alone + i) for i, name in enumerate(names or [""] * len(frame))]


def describe(group: Group, data: ReportData) -> str:
    """Name a group by its levels: ``reduced-polynomial-2, frictionless, any space``.

    Levels that a group shares with all others of their factor are only said to be any; a
    group that is no full crossing is named by its first cell.
    """
    chosen = {name: _levels(group, name, data) for name in data.factors}
    total = 1
    for levels in chosen.values():
        total *= len(levels)
    if total != len(group):
        first = ", ".join(clean(level) for level in group.members[0].values())
        block = clean(data.block) or "block"
        others = len(group) - 1
        agree = f"{count(others, 'cell')} that agree{'s' * (others == 1)} with it in every {block}"
        return f"{first} (and {agree})"
    return ", ".join(_words(name, levels, data) for name, levels in chosen.items())


def _levels(group: Group, name: str, data: ReportData) -> Sequence[str]:
    present = {member[name] for member in group.members}
    return [level for level in data.factors[name] if level in present]


def _words(name: str, levels: Sequence[str], data: ReportData) -> str:
    if len(levels) == len(data.factors[name]) > 1:
        return f"any {name_of(name, data.labels)}"
    return listing([clean(level) for level in levels], "or")


def grouped_inputs(inputs: Mapping[str, str]) -> dict[str, str]:
    """Join inputs with dotted keys into one line for each first part, in the order given.

    Examples
    --------
    >>> grouped_inputs({"specimen.shape": "cylinder", "specimen.radius": "25 mm", "mesh": "fine"})
    {'specimen': 'cylinder, radius 25 mm', 'mesh': 'fine'}
    """
    lines: dict[str, list[str]] = {}
    for key, value in inputs.items():
        part, _, rest = clean(key).partition(".")
        lines.setdefault(part, []).append(_phrase(rest, clean(value)))
    return {part: ", ".join(items) for part, items in lines.items()}


def _phrase(key: str, value: str) -> str:
    # a shape, a kind or a model is its own name
    if not key or key in ("shape", "kind", "model"):
        return value
    name = " ".join(name_of(part) for part in key.split("."))
    return f"{name} {value}"
