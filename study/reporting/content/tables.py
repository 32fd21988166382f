"""The tables of a report: shown text and, for the CSV beside the report, the raw values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import gathered
from study.ground.canonical import plain
from study.record.record import Record
from study.reporting.content import sentences
from study.reporting.content.blocks import Document, Table
from study.reporting.content.effect_words import numerical as u_num_of
from study.reporting.content.effect_words import practical, size, size_interval, told
from study.reporting.content.report_facts import Facts, block_name, cells, is_effect
from study.reporting.content.text import (
    MINUS,
    MISSING,
    THIN,
    clean,
    count,
    duration,
    f_value,
    interval,
    level,
    listing,
    name_of,
    p_phrase,
    p_value,
    plural_of,
    quantity,
    share,
    significant,
    term_name,
)
from study.reporting.results.study_result import ANY, FittedConstant, ReportData
from study.statistics.analysis.anova_table import Row
from study.statistics.analysis.failures import FailurePattern, FailureRule, FailureTest
from study.statistics.convergence.grid_convergence import NumericalUncertainty

if TYPE_CHECKING:
    import pandas as pd


def fit_name(fit: FittedConstant, data: ReportData) -> str:
    """Name a fit by its levels; a factor that one fit serves is any."""
    parts = (
        f"any {name_of(name, data.labels)}" if level == ANY else clean(level)
        for name, level in fit.levels.items()
    )
    return " \N{MIDDLE DOT} ".join(parts)


def fit_rank(levels: Mapping[str, str], data: ReportData) -> tuple[int, ...]:
    """Sort key of a fit: its levels in the order of the design."""
    places = ((data.factors.get(name, ()), level) for name, level in levels.items())
    return tuple(order.index(level) if level in order else -1 for order, level in places)


def fits(data: ReportData) -> Table:
    """Fitted constants over the blocks: median, range, uncertainty, identifiability."""
    ranked = sorted(data.fits, key=lambda fit: (fit_rank(fit.levels, data), fit.constant))
    groups = gathered(((fit_name(fit, data), clean(fit.constant)), fit) for fit in ranked)
    columns = (
        "fit", "constant", "median", "range over fits", "standard error", "correlation",
        "residual (RMS)", "identifiable",
    )  # fmt: skip
    rows = tuple((*key, *_summary(items)) for key, items in groups.items())
    # levels and correlations have columns of their own
    raw = tuple(
        {**fit.levels, **{k: v for k, v in vars(fit).items() if k not in ("levels", "correlated")}}
        | {f"correlation with {k}": v for k, v in fit.correlated.items()}
        for fit in data.fits
    )
    return Table("fits", columns, rows, 2, raw=raw, grouped=True)


def _summary(items: Sequence[FittedConstant]) -> tuple[str, ...]:
    """Median, range, relative standard error, correlation, residual, share that is determined."""
    values = np.array([i.value for i in items if i.value is not None], dtype=float)
    unit = items[0].unit
    relative = [
        abs(i.standard_error / i.value) for i in items if i.standard_error is not None and i.value
    ]
    residual = [i.residual_N for i in items if i.residual_N is not None]
    return (
        quantity(float(np.median(values)), unit) if values.size else MISSING,
        interval(float(values.min()), float(values.max()), unit) if values.size else MISSING,
        share(float(np.median(relative))) if relative else MISSING,
        _strongest(items),
        quantity(float(np.median(residual)), "N", 2) if residual else MISSING,
        f"{sum(item.identifiable for item in items)} of {len(items)}",
    )


def _strongest(items: Sequence[FittedConstant]) -> str:
    """Median correlation with the constant that a fit is most entangled with."""
    by_other = gathered(pair for item in items for pair in item.correlated.items())
    if not by_other:
        return MISSING
    medians = ((float(np.median(values)), other) for other, values in by_other.items())
    strongest, other = max(medians, key=lambda of: abs(of[0]))
    return f"{strongest:.3f} with {clean(other, 16)}".replace("-", MINUS)


def every_fit(data: ReportData) -> Table:
    """Every fitted constant with its 95 % interval."""
    return Table.of(
        "every-fit",
        sorted(data.fits, key=lambda fit: fit_rank(fit.levels, data)),
        {
            "fit": lambda fit: fit_name(fit, data),
            "constant": lambda fit: clean(fit.constant),
            data.block or "block": lambda fit: clean(fit.block),
            "specimen": lambda fit: clean(fit.specimen) or MISSING,
            "value": lambda fit: quantity(fit.value, fit.unit),
            "95 % interval": lambda fit: interval(fit.low, fit.high, fit.unit),
            "residual (RMS)": lambda fit: quantity(fit.residual_N, "N", 2),
            "identifiable": lambda fit: (
                ("yes" if fit.identifiable else "no")
                + (f": {clean(fit.reason, 160)}" if fit.reason else "")
            ),
        },
        left=4,
        tail=1,
        grouped=True,
    )


# Every case beside its record: where the mean of a cell comes from.

#: cases that a page lists: a row takes 400 bytes, and beyond these the CSV is quicker to search
MOST = 2000

#: start of the names that rows of a cell have in the page
CELL = "cell-"


def in_order(data: ReportData) -> pd.DataFrame:
    """Rows of the table in the order of the design, those of a cell in that of the blocks."""
    orders = {**data.factors, "block": data.blocks}
    ranks = {
        name: {label: k for k, label in enumerate(labels)}
        for name, labels in orders.items()
        if name in data.table
    }
    # a label that is not listed comes last
    return data.table.sort_values(
        list(ranks), key=lambda column: column.astype(str).map(ranks[str(column.name)])
    )


def lists_records(data: ReportData) -> bool:
    """Whether a page lists every case: each has a record, and they are not too many."""
    return not data.is_table and "case_id" in data.table and 0 < len(data.table) <= MOST


def case_records(data: ReportData, all_facts: Sequence[Facts]) -> Table | None:
    """Every case with its responses and the name of its record, cell by cell."""
    if not lists_records(data):
        return None
    listed = [facts for facts in all_facts if facts.name in data.table]
    blocked = bool(data.block) and "block" in data.table
    rows, anchors = [], []
    cells_in_order = in_order(data).groupby(list(data.factors), sort=False)
    for number, (levels, group) in enumerate(cells_in_order, 1):
        cell = tuple(clean(level) for level in levels)
        for record in group.to_dict("records"):
            block = (clean(str(record["block"])) or MISSING,) if blocked else ()
            shown = (quantity(record[f.name], f.unit) for f in listed)
            seconds = duration(record.get("seconds"))
            name = clean(str(record["case_id"]), 16)
            rows.append((*cell, *block, clean(str(record["status"])), *shown, seconds, name))
        anchors += [f"{CELL}{number}", *[""] * (len(group) - 1)]
    words = [name_of(factor, data.labels) for factor in data.factors]
    if blocked:
        words.append(name_of("block", {"block": data.block, **data.labels}))
    columns = (*words, "status", *(facts.title for facts in listed), "time", "record")
    return Table("records", columns, tuple(rows), len(words) + 1, 1, _NOTE, anchors=tuple(anchors))


_NOTE = (
    "The record of a case is cases/RECORD/record.json in the results folder of the study: inputs, "
    "constants, curve, responses, energy balance, versions."
)


def verdicts(all_facts: Sequence[Facts], data: ReportData) -> Table:
    """One row a factor and response, and interactions that are not negligible."""
    judged = [
        (facts, effect)
        for facts in all_facts
        for effect in (*facts.effects, *facts.interactions)
        if effect.is_main or effect.strength == "matters"
    ]
    term_table = Table.of(
        "verdicts",
        judged,
        {
            "response": lambda of: of[0].title,
            "factor": lambda of: term_name(of[1].term, data.labels),
            "verdict": lambda of: told(of[1]) if of[1].is_main else of[1].strength,
            "largest difference": lambda of: size(of[1], of[0]),
            f"{level(data.alpha)} interval".replace(THIN, " "): lambda of: size_interval(*of[::-1]),
            "matters from": lambda of: practical(of[1], of[0]),
            "U": lambda of: u_num_of(of[1], of[0]),
            "p": lambda of: p_value(of[1].p),
            "p (Holm)": lambda of: p_value(of[1].p_holm),
        },
        left=3,
        note=sentences.numerical(all_facts, data.refinement.name),
        grouped=True,
        raw=lambda of: {
            "response": of[0].name,
            "factor": of[1].term,
            "verdict": of[1].verdict if of[1].practical is None else told(of[1]),
            "effect": of[1].range,
            **{name: getattr(of[1], name) for name in _STORED},
            "scale": "ratio" if of[1].is_ratio else "difference",
        },
    )  # fmt: skip
    return replace(term_table, raw=(*term_table.raw, *_surface_verdicts(data)))


_STORED = ("low", "high", "practical", "u_num", "effect_over_u_num", "p", "p_holm")


def _surface_verdicts(data: ReportData) -> Iterator[dict[str, object]]:
    """Unrounded verdicts over numeric factors, which the page shows with their surfaces."""
    for fit, row in ((surface, row) for surface in data.surfaces for row in surface.verdicts):
        ends = row["ci95"] if isinstance(row["ci95"], list) else [None, None]
        yield {
            **{name: row[name] for name in ("response", "factor", "verdict", "effect")},
            "low": ends[0],
            "high": ends[1],
            "practical": row["practical"],
            "u_num": row["u_num"],
            "scale": "range",
            "at": ", ".join(f"{name}={level}" for name, level in fit.labels.items()),
        }


def anova(facts: Facts, data: ReportData, name: str = "") -> Table:
    """Source, DF, SS, MS, F, p for every term, the error and the total.

    A table has Minitab's five digits and all its error strata; the effects of a study, of which
    there may be as many strata, have the degrees of freedom of their errors beside their own.
    """
    table = None if facts.result is None else facts.result.anova
    digits = 5 if data.is_table else 3
    rows = [r for r in facts.rows if data.is_table or is_effect(r, [*data.factors])
            or ":" not in r.term]  # fmt: skip
    names = {**data.labels, "block": data.labels.get("block", data.block or "block")}
    how = "Seq" if table and table.type == "I" else "Adj"
    columns: dict[str, Callable[[Row], str]] = {
        "source": lambda row: "error" if row.term == "residual" else term_name(row.term, names),
        "DF": lambda row: (
            f"{row.df:g}"
            if data.is_table or row.df_error is None
            else f"{row.df:g}, {row.df_error:g}"
        ),
        f"{how} SS": lambda row: significant(row.ss, digits),
        f"{how} MS": lambda row: "" if row.ms is None else significant(row.ms, digits),
        "F": lambda row: "" if row.f is None else f_value(row.f),
        "p": lambda row: "" if row.p is None else p_value(row.p),
    }
    if not data.is_table and all(row.p is None for row in rows):
        del columns["F"], columns["p"]
    elif facts.result and facts.result.lenth:
        columns["p (Lenth)"] = columns.pop("p")
    if any(row.p_gg is not None for row in rows):
        columns["GG epsilon"] = lambda row: "" if row.p_gg is None else _thousandths(row.epsilon_gg)
        columns["p corrected"] = lambda row: "" if row.p_gg is None else p_value(row.p_gg)
    strata = data.is_table and len({row.error for row in rows if row.error}) > 1
    if strata:
        columns["tested against"] = lambda row: term_name(row.error or "", names)
    note = " ".join(_anova_notes(facts, data))
    sources = Table.of(name or f"{facts.name}-anova", rows, columns, tail=int(strata), note=note)
    sources = replace(sources, raw=tuple(map(plain, facts.rows)))
    if table is None or table.ss_total is None:
        return sources
    sums = significant(table.ss_total, digits)
    total = ("total", f"{table.df_total}", sums, *[""] * (len(columns) - 3))
    return replace(sources, rows=(*sources.rows, total))


def _anova_notes(facts: Facts, data: ReportData) -> Iterator[str]:
    """Say what a reader may stumble over: a huge F, a test that was not made."""
    effects, block = _effects_of(facts, data), clean(data.block)
    if any((row.f or 0) > 1e4 for row in effects):
        where = f"in every {block}" if block else "in every run"
        yield (
            f"F > 10,000: the effect is nearly the same {where}, so the error that it is compared "
            "with is nearly zero; read the size of the effect, not its F."
        )
    if any(not row.df for row in effects):
        yield "DF 0: not estimable from the cells that have a response."
    if block and any(row.f for row in effects) and any(row.f is None and row.df for row in effects):
        yield (
            f"Without F: the effect is the same in every {block} to the tolerance of the solver, "
            "so there is nothing to test it against."
        )


def _effects_of(facts: Facts, data: ReportData) -> list[Row]:
    return [row for row in facts.rows if is_effect(row, list(data.factors))]


SIZES = "Sizes of the effects as shares of the variation"


def sizes(facts: Facts, data: ReportData) -> Table:
    """Effects as shares of the variation."""
    effects = _effects_of(facts, data)
    columns: dict[str, Callable[[Row], str]] = {
        "term": lambda row: term_name(row.term, data.labels),
    }
    if any(row.omega_sq is not None for row in effects):
        columns["omega squared"] = lambda row: _thousandths(row.omega_sq)
        columns["partial eta squared"] = lambda row: (
            _thousandths(row.partial_eta_sq)
            + (f" ({interval(*row.partial_eta_sq_ci95)})" if row.partial_eta_sq_ci95 else "")
        )
    columns["share"] = lambda row: share(row.share) if row.df else MISSING
    note = f"Share: part of the total sum of squares, the {plural_of(data.block)} included."
    return Table.of(f"{facts.name}-sizes", effects, columns, note=note if data.block else "")


def _thousandths(value: float | None) -> str:
    if value is None:
        return MISSING
    return "< 0.001" if 0 < value < 0.0005 else f"{value:.3f}"


def matrix(data: ReportData, all_facts: Sequence[Facts]) -> Table:
    """Every cell: how many cases gave a response, its means, its cost."""
    factors = list(data.factors)
    listed = [facts for facts in all_facts if facts.name in data.table]
    means = {f.name: cells(data, f.name).set_index("cell")["mean"].to_dict() for f in listed}
    named, titles = (name_of(f, data.labels) for f in factors), (facts.title for facts in listed)
    columns = (*named, "cases", *titles, "mean time")
    rows, raw = [], []
    if data.table.empty:  # nothing is computed yet, or what was is lost
        return Table("cells", columns, (), len(factors))
    ordered, answered = in_order(data), data.table["status"] == "converged"
    groups = ordered.assign(answered=answered).groupby(factors, sort=False)
    counted = groups["answered"].agg(["sum", "size"]).itertuples()
    times = groups["seconds"].mean().tolist() if "seconds" in ordered else None
    for number, (levels, done, every) in enumerate(counted):
        labels = tuple(map(str, levels if len(factors) > 1 else [levels]))
        values = [means[facts.name].get(":".join(labels)) for facts in listed]
        seconds = None if times is None else times[number]
        shown = [quantity(v, f.unit) for v, f in zip(values, listed, strict=True)]
        rows.append((*map(clean, labels), f"{done} of {every}", *shown, duration(seconds)))
        counts = {"converged": int(done), "cases": int(every)}
        numbers = {**counts, **dict(zip(means, values, strict=True)), "seconds": seconds}
        raw.append(dict(zip(factors, labels, strict=True)) | numbers)
    return Table("cells", columns, tuple(rows), len(factors), raw=tuple(raw))


def numerical(items: Sequence[NumericalUncertainty], data: ReportData) -> Table:
    """Numerical uncertainty of each kind of discretization."""
    names = list(dict.fromkeys(name for item in items for name in item.levels))

    def meshes_of(item: NumericalUncertainty) -> str:
        # the levels of the cell stand in its row already
        cell, _, meshes = item.note.partition("; ")
        parts = [part for part in cell.split(" / ") if part not in item.levels.values()]
        named = [block_name(part, data) if part in data.blocks else clean(part) for part in parts]
        return "; ".join(filter(None, (" / ".join(named), clean(meshes))))

    columns: dict[str, Callable[[NumericalUncertainty], str]] = {
        name_of(name, data.labels): lambda item, name=name: clean(item.levels.get(name, MISSING))  # type: ignore[misc]
        for name in names
    }
    columns |= {
        "response": lambda item: name_of(item.response, data.labels),
        "value": lambda item: quantity(item.value, item.unit),
        "u_num": lambda item: quantity(item.u_num, "pp" if item.unit == "%" else item.unit, 2),
        "behavior": lambda item: clean(item.behaviour) or MISSING,
        "how": meshes_of,
    }
    stored = ("response", "value", "u_num", "unit", "behaviour", "note")
    return Table.of(
        "numerical",
        items,
        columns,
        left=len(names) + 1,
        tail=2,
        raw=lambda item: (
            {name: item.levels.get(name) for name in names}
            | {name: getattr(item, name) for name in stored}
        ),
    )


def _cell(item: Record) -> str:
    return " \N{MIDDLE DOT} ".join(clean(level) for level in item.levels.values())


def failures(data: ReportData) -> Table:
    """Every failed case with what was said."""
    return Table.of(
        "failures",
        data.failures,
        {
            "case": lambda item: clean(item.case_id, 16),
            "cell": _cell,
            data.block or "block": lambda item: clean(item.block or "") or MISSING,
            "status": lambda item: clean(item.status),
            "message": lambda item: clean(item.message, 400),
        },
        left=5,
    )


# Which settings fail: rules in words, then a test of every factor.

#: levels of a factor that the table lists, those that fail most, and causes in a sentence
_LISTED = 4
#: p below which a factor has to do with failing
_ALPHA = 0.05


def failure_sentences(pattern: FailurePattern, labels: Mapping[str, str]) -> tuple[str, ...]:
    """Say where cases fail, why, and which factors have to do with it."""
    counted = [f"{number:,} {clean(cause)}" for cause, number in pattern.causes.items()]
    others = sum(list(pattern.causes.values())[_LISTED:])
    causes = "; ".join([*counted[:_LISTED], *([f"{others:,} others"] if others else [])])
    if pattern.failed == pattern.total:
        return (
            f"Every case failed ({causes}): no setting of this study gives an answer, so none of "
            "its factors can be blamed.",
        )
    where = "; ".join(
        f"{', '.join(_settings(rule, labels))}: {rule.failed:,} of {rule.total:,}"
        for rule in pattern.rules
    )
    bad, rest = pattern.elsewhere
    text = f"Where cases fail: {where}{f'; elsewhere {bad:,} of {rest:,}' if rest else ''}."
    if not where:
        text = (
            f"{pattern.failed:,} of {pattern.total:,} cases failed. No level of a factor, and no "
            "combination of two or three, holds enough of them to be named as the place."
        )
    return text, f"Causes: {causes}.", _blamed(pattern, labels)


def _settings(rule: FailureRule, labels: Mapping[str, str]) -> list[str]:
    return [f"{name_of(factor, labels)} {clean(level)}" for factor, level in rule.settings.items()]


def _blamed(pattern: FailurePattern, labels: Mapping[str, str]) -> str:
    blamed = [
        f"{name_of(test.factor, labels)} ({p_phrase(test.p_holm)})"
        for test in pattern.tests
        if test.p_holm < _ALPHA
    ]
    pairs = [rule for rule in pattern.rules if len(rule.settings) > 1]
    joint = " and of ".join(listing(_settings(rule, labels)) for rule in pairs)
    if pairs:
        alone = f"; {listing(blamed)} differ already by themselves" if blamed else ""
        return f"What fails is the combination of {joint}{alone}."
    if not blamed:
        return (
            "No factor's levels differ in how often their cases fail by more than chance explains."
        )
    return f"Failing depends on {listing(blamed)}, adjusted for the number of factors."


def tests(pattern: FailurePattern, labels: Mapping[str, str]) -> Table:
    """Test of every factor: failed cases by level, p, and p adjusted for their number."""
    test_table = Table.of(
        "failure_tests",
        pattern.tests,
        {
            "factor": lambda test: name_of(test.factor, labels),
            "p": lambda test: p_value(test.p),
            "p (Holm)": lambda test: p_value(test.p_holm),
            "failed by level": _levels,
            "method": lambda test: test.method,
        },
        tail=2,
        note="Fisher's exact test of levels against failed and not failed (Freeman and Halton 1951 "
        "for more than two levels), with Holm's adjustment. Cases of one cell mostly fail "
        "together, so whole cells are permuted where a cell has several.",
    )
    raw = tuple(
        {"factor": test.factor, "level": level, "failed": bad, "cases": total, "p": test.p,
         "p_holm": test.p_holm, "method": test.method}
        for test in pattern.tests
        for level, (bad, total) in test.counts.items()
    )  # fmt: skip
    return replace(test_table, raw=raw)


def retried_sentence(items: Sequence[Record]) -> str:
    """Say how many cases have other settings than the design's; empty where none has."""
    if not items:
        return ""
    solved, were = sum(item.converged for item in items), "was" if len(items) == 1 else "were"
    return (
        f"{count(len(items), 'case')} failed as designed and {were} computed with other settings, "
        f"as the design declares: {solved:,} then gave an answer. What was changed is part of "
        "their difference from the other cases."
    )


def retried_table(items: Sequence[Record], block: str) -> Table:
    """List every case whose settings are not those of the design: why, what, and the outcome."""
    return Table.of(
        "retried",
        items,
        {
            "case": lambda item: clean(item.case_id, 16),
            "cell": _cell,
            block or "block": lambda item: clean(item.block or "") or MISSING,
            "failed": lambda item: "; then ".join(
                f"{clean(n['cause'])}: {clean(n['message'], 200)}" for n in item.retries
            ),
            "changed": lambda item: "; ".join(clean(n["what"]) for n in item.retries),
            "outcome": lambda item: clean(item.status),
        },
        left=6,
    )


def _levels(test: FailureTest) -> str:
    shares = sorted(test.counts.items(), key=lambda item: -item[1][0] / item[1][1])
    shown = [f"{clean(level)}: {bad:,} of {total:,}" for level, (bad, total) in shares[:_LISTED]]
    return "; ".join([*shown, *(["\N{HORIZONTAL ELLIPSIS}"] if len(shares) > _LISTED else [])])


#: what a plate is taken to do, in words
_PLATES = {"nominal": "as said", "rigid": "any rigid motion", "slipping": "rigid, face slips"}


def marker_errors(data: ReportData) -> Table:
    """RMS error of the markers of every case and plate, with the motion of the plate."""
    shown = [
        (case, marked, fit)
        for case in sorted(data.markers, key=lambda case: fit_rank(case.levels, data))
        for marked in case.markers
        for fit in marked["fits"]
    ]
    return Table.of(
        "marker-errors",
        shown,
        {
            "cell": lambda of: _cell(of[0]),
            "state": lambda of: clean(of[1]["state"]),
            "plate": lambda of: _PLATES.get(of[2]["plate"], clean(of[2]["plate"])),
            "told by": lambda of: clean(of[2]["fitted"]),
            "markers": lambda of: f"{of[2]['markers']}",
            "RMS error": lambda of: quantity(of[2]["error_mm"], "mm"),
            "floor": lambda of: quantity(of[1]["floor_mm"], "mm"),
            "down, x, y (mm)": lambda of: _values(of[2]["motion"], ("down", "x", "y")),
            "tilts, twist (deg)": lambda of: _values(
                of[2]["motion"], ("tilt_x", "tilt_y", "twist")
            ),
            "spread (%)": lambda of: _values(of[2]["motion"], ("spread",)),
        },
        left=4,
        tail=3,
        grouped=True,
        raw=lambda of: {
            **of[0].levels,
            "state": of[1]["state"],
            **{name: of[2][name] for name in ("plate", "fitted", "markers", "error_mm")},
            "floor_mm": of[1]["floor_mm"],
            **{f"{name}_{end}": v for name, pair in of[2]["motion"].items()
               for end, v in zip(("value", "standard_error"), pair, strict=True)},
            **{f"layer_{name}_mm": v for name, v in of[2]["error_by_layer_mm"].items()},
        },
    )  # fmt: skip


def _values(motion: dict[str, list[float | None]], names: tuple[str, ...]) -> str:
    """Components with their standard errors where they were fitted."""
    parts = [
        MISSING
        if value is None
        else f"{value:.2f} \N{PLUS-MINUS SIGN} {error:.2f}"
        if error
        else f"{value:.4g}"
        for value, error in (motion.get(name, (None, None)) for name in names)
    ]
    return ", ".join(parts).replace("-", MINUS)


def label_of(cell: Document) -> str:
    """Name of a cell: its levels, else the quantity where it has one."""
    levels = (cell.get("levels") or {}).values()
    return " / ".join(map(str, levels)) or str(cell.get("qoi", "all"))


def validation(rows: Sequence[Document], block: str) -> Table:
    """Compare every case at the end of its curve."""
    return Table.of(
        "validation",
        rows,
        {
            "cell": lambda row: clean(label_of(row)),
            block or "block": lambda row: clean(row["block"] or MISSING),
            **{
                head: lambda row, name=name: significant(row[name][-1])  # type: ignore[misc]
                for head, name in _AT_THE_END.items()
            },
            "curve outside": lambda row: f"{100 * row['outside']:.0f} %",
            "verdict": lambda row: clean(row["verdict"], 200),
        },
        left=2,
        tail=1,
        raw=lambda row: (
            {**row["levels"], "block": row["block"]}
            | {name: row[name][-1] for name in _AT_THE_END.values()}
            | {name: row[name] for name in ("outside", "verdict")}
        ),
    )


_AT_THE_END = {"E (N)": "error_N"} | {u: f"{u}_N" for u in ("u_num", "u_input", "u_data", "u_val")}
