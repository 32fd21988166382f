"""What a surface over numeric factors says: sentences and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from study.reporting.content.content_table import Table
from study.reporting.content.numbers import (
    MISSING,
    interval,
    p_phrase,
    p_value,
    percent,
    quantity,
    significant,
)
from study.reporting.content.text import clean, count, listing, name_of, sentence
from study.statistics.analysis.simple_effects import MATTERS, NO_DIFFERENCE
from study.statistics.surfaces.emulator import Emulator
from study.statistics.surfaces.quadratic import QuadraticSurface
from study.statistics.surfaces.surface_profile import profiles, strongest

if TYPE_CHECKING:
    from study.reporting.results.study_result import ReportData
    from study.statistics.surfaces.surface_factors import Extreme
    from study.statistics.surfaces.surface_profile import FittedSurface
    from study.statistics.surfaces.surface_propagation import InputShare
    from study.statistics.surfaces.surface_result import Sensitivity, SurfaceAnalysis


# What uncertain inputs do to a response over ranges: sentences and the table of inputs.

#: a gain below this is no reason to measure an input better
WORTH = 0.01


def uncertainty_answer(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the answer: how sure the response is, and which input to measure better."""
    told = one.uncertain
    if told is None:
        return ()
    unit, ends = clean(one.unit), told.percentiles
    best = told.inputs[0]
    gain = told.gain(best)
    sure = (
        f"With these uncertain inputs it is {quantity(told.mean.value, unit)} with a standard "
        f"deviation of {quantity(told.sd.value, unit)}; 95 % of it lie between "
        f"{quantity(ends[2.5].value, unit)} and {quantity(ends[97.5].value, unit)}."
    )
    if gain < WORTH:
        return (sure, "Measuring one of them twice as well would change that by less than 1 %.")
    worth = (
        f"Knowing {name_of(best.name, data.labels)} twice as well would lower the standard "
        f"deviation by {percent(gain)}" + (", more than any other." if told.inputs[1:] else ".")
    )
    return (sure, worth)


def uncertainty_lines(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the section: the surface's own error, and what was held or cut off."""
    told = one.uncertain
    if told is None:
        return ()
    unit = clean(one.unit)
    ends = told.percentiles
    said = [
        "The surface itself may be off by "
        f"{quantity(told.mean.own, unit, 2)} in the mean, {quantity(told.sd.own, unit, 2)} in the "
        f"standard deviation and {quantity(max(t.own for t in ends.values()), unit, 2)} in the "
        "percentiles of the uncertain inputs' response; that is no part of these."
    ]
    if told.fixed:
        held = [
            f"{name_of(name, data.labels)} at {quantity(value, one.units.get(name, ''))}"
            for name, value in told.fixed.items()
        ]
        said.append(f"Held there for it: {listing(held)}.")
    cut = [f"{percent(p, 2)} of {name_of(n, data.labels)}" for n, p in told.cut.items() if p > 1e-4]
    if cut:
        said.append(f"Outside of the ranges that were run, and cut off: {listing(cut)}.")
    return tuple(said)


def table(one: FittedSurface, data: ReportData) -> Table | None:
    """List the inputs, the one that is worth measuring most first; None where none is uncertain."""
    told = one.uncertain
    if told is None:
        return None
    rows = tuple(
        (
            clean(name_of(item.name, data.labels)),
            clean(one.inputs.get(item.name, "")),
            *_shares(item),
            quantity(item.halved, clean(one.unit)),
            percent(told.gain(item)),
        )
        for item in told.inputs
    )
    columns = ("input", "distribution", "share alone", "share in all", "sd if halved", "gain")
    note = (
        f"Standard deviation of the response now: {quantity(told.sd.value, clean(one.unit))}. "
        "Shares of its variance by the input alone and with all its interactions. Gain: part of "
        "the standard deviation that goes when the input is known twice as well."
    )
    name = " ".join(("uncertain", one.response, *one.labels.values()))
    return Table(name, columns, rows, 2, 0, note)


def _shares(item: InputShare) -> tuple[str, str]:
    if item.index is None:
        return MISSING, MISSING
    return percent(item.index.first), percent(item.index.total)


def title(one: FittedSurface, data: ReportData) -> str:
    """Name of the response, and where the factors without numbers stand."""
    at = listing([f"{name_of(k, data.labels)} {clean(v)}" for k, v in one.labels.items()])
    named = clean(name_of(one.response, data.labels))
    return f"{named} at {at}" if at else named


def surface_answer(data: ReportData) -> tuple[str, ...]:
    """Sentences that answer which numbers drive each response, and how sure that is."""
    return tuple(_answer(one, data) for one in data.surfaces)


def would_change(data: ReportData) -> str:
    """Say what would make the answer surer."""
    good = [one.found for one in data.surfaces if one.found is not None]
    parts = []
    poor = [found for found in good if not found.model.q2 >= 0.9]
    if poor or len(good) < len(data.surfaces):
        parts.append("more runs would make the surface surer")
    if any(i.range is not None and i.range.claims for found in good for i in found.sensitivity):
        parts.append("the two runs that confirm each factor could overturn what is said of it")
    parts.append("wider ranges may show more, for nothing is said beyond those that were run")
    return sentence("; ".join(parts))


def accuracy(one: FittedSurface) -> str:
    """How well runs are predicted from the others."""
    found = one.found
    if found is None:
        return ""
    model = found.model
    loo = model.loo if isinstance(model, QuadraticSurface) else model
    runs = count(found.runs.response.size, "run")
    kind = "quadratic surface" if found.kind == "quadratic" else "Gaussian-process emulator"
    if loo is None:
        return f"A {kind} of {runs}; no run can be left out, so its error is not known."
    rms = loo.rms if hasattr(loo, "rms") else loo.loo_rms
    if _learns_from_others(found):
        runs += ", which learns from those at the other levels,"
    return (
        f"A {kind} of {runs} predicts each from all the others within "
        f"{quantity(rms, clean(one.unit))} (root mean square; Q2 {_q2(found.model.q2)})."
    )


def _learns_from_others(found: SurfaceAnalysis) -> bool:
    """Whether the runs at other levels were fitted together with those of a surface."""
    model = found.model
    each = getattr(model, "each", (model,))
    return any(isinstance(e, Emulator) and e.combination is not None for e in each)


def method(one: FittedSurface, data: ReportData) -> str:
    """Sentences for a methods paragraph: what was fitted, and how it was judged."""
    found = one.found
    if found is None:
        return ""
    how = (
        "all linear, square and product terms of the coded factors by least squares"
        if found.kind == "quadratic"
        else "a Gaussian process with a constant mean and one length per factor by restricted "
        "maximum likelihood, the kernel (Mat\N{LATIN SMALL LETTER E WITH ACUTE}rn 5/2 or Gaussian) "
        "by leave-one-out error"
    )
    if _learns_from_others(found):
        how += (
            ", together with the runs at the other levels, between whose functions a correlation "
            "was fitted (Qian, Wu and Wu 2008)"
        )
    shares = (
        "; shares of variance are Sobol indices of factors uniform over their ranges, by "
        "Jansen's estimators on posterior paths"
        if any(item.index is not None for item in found.sensitivity)
        else ""
    )
    return (
        f"{sentence(title(one, data)).rstrip('.')} was fitted with {how}{shares}. {accuracy(one)}"
    )


def extremes(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Smallest and largest prediction in the ranges, and where they are."""
    found = one.found
    if found is None:
        return ()
    return tuple(
        f"The {word} prediction in these ranges is {_extreme(extreme, one)} at "
        f"{settings(found.runs.settings(extreme.at), one, data)}."
        for word, extreme in (("smallest", found.smallest), ("largest", found.largest))
    )


def surface_lines(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the section of one surface: accuracy, extremes, what must still be run."""
    found = one.found
    if found is None:
        return (f"No surface: {clean(one.refused)}",)
    confirm = [
        f"That {name_of(item.factor, data.labels)} matters is claimed once these two were run: "
        + " and ".join(settings(found.runs.settings(at), one, data) for at in item.range.confirm)
        + "."
        for item in found.sensitivity
        if item.range is not None and item.range.claims
    ]
    return (
        accuracy(one),
        *_shape(one, data),
        *differences(one, data),
        *extremes(one, data),
        *confirm,
        *uncertainty_lines(one, data),
    )


def differences(one: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say what another level of a factor without numbers changes over the ranges."""
    unit = clean(one.unit)
    for told in one.differences:
        word = "more" if told.mean >= 0 else "less"
        ends = (told.low, told.high) if told.mean >= 0 else (-told.high, -told.low)
        said = {
            MATTERS: "this matters",
            NO_DIFFERENCE: "this makes no practical difference at any setting",
        }.get(told.verdict, "these runs cannot show whether this matters")
        limit = (
            ""
            if one.practical is None
            else f"; with {one.practical:.3g} {unit} as what matters, {said}"
        )
        yield sentence(
            f"{name_of(one.response, data.labels)} with {name_of(told.factor, data.labels)} "
            f"{clean(told.level)} is {quantity(abs(told.mean), unit)} {word} than with "
            f"{clean(told.other)} on average over the ranges, and between "
            f"{significant(ends[0])} and {quantity(ends[1], unit)} {word} at 95 % of the settings "
            f"(each \N{PLUS-MINUS SIGN} {significant(told.bound, 2)}){limit}"
        )


def _shape(one: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say where a quadratic surface is level, whether it fits, and what it cannot tell apart."""
    model = None if one.found is None else one.found.model
    if not isinstance(model, QuadraticSurface):
        return
    point = model.stationary
    if point is not None and point.established:
        where = "inside" if point.inside else "outside"
        at = settings(model.runs.settings(point.at), one, data)
        yield (
            f"The surface is level at a {point.kind} of {quantity(point.value, clean(one.unit))}, "
            f"{where} the ranges: {at}."
        )
    lack = model.lack_of_fit
    if lack is not None:
        yield (
            f"Lack of fit: F({lack.df:.3g}, {lack.df_error:.3g}) = {significant(lack.f)}, "
            f"{p_phrase(lack.p)}."
        )
    yield from (f"Not told apart: {clean(alias)}." for alias in model.aliases)


def settings(at: Mapping[str, float], one: FittedSurface, data: ReportData) -> str:
    """Write settings with their names and units."""
    return listing(
        [
            f"{name_of(name, data.labels)} {quantity(value, one.units.get(name, ''))}"
            for name, value in at.items()
        ]
    )


def sensitivity(one: FittedSurface, data: ReportData) -> Table | None:
    """Shares and ranges of the factors, the strongest first; None where none is told."""
    found = one.found
    if found is None or all(i.index is None and i.range is None for i in found.sensitivity):
        return None
    items = sorted(found.sensitivity, key=lambda item: item.rank)
    rows = tuple(_sensitivity_row(item, one, data) for item in items)
    columns = ("factor", "share alone", "share in all", "range", "bound", "verdict")
    moved = (
        "Range: 95 % of the settings of the other factors change the response by less along this "
        "one."
    )
    if found.kind == "quadratic":
        short = tuple((row[0], *row[3:]) for row in rows)
        heads = (columns[0], *columns[3:])
        return Table(_table_name("sensitivity", one), heads, short, 1, 1, moved)
    note = (
        "Shares of the variance of the response when every factor is uniform over its range: by "
        "the factor alone (first-order Sobol index) and with all its interactions (total index), "
        f"each with an interval of about 95 %. {moved}"
    )
    return Table(_table_name("sensitivity", one), columns, rows, 1, 1, note)


def coefficients(one: FittedSurface, data: ReportData) -> Table | None:
    """Coefficients of a quadratic surface in coded factors; None of an emulator."""
    model = None if one.found is None else one.found.model
    if not isinstance(model, QuadraticSurface):
        return None
    judged = model.error != "none"
    unit = clean(one.unit)
    rows = tuple(
        (
            clean(" \N{MULTIPLICATION SIGN} ".join(_term(t.term, data))),
            quantity(t.coefficient, unit, 4),
            *(
                (
                    MISSING if t.interval is None else interval(*t.interval),
                    MISSING if t.p is None else p_value(t.p),
                )
                if judged
                else ()
            ),
        )
        for t in model.terms
    )
    columns = ("term", "coefficient", *(("95 % interval", "p") if judged else ()))
    note = "Every factor runs from \N{MINUS SIGN}1 at its lower end to 1 at its upper end."
    if not judged:
        note += " No p: a simulation without scatter has misfit, not noise."
    return Table(_table_name("coefficients", one), columns, rows, 1, 0, note)


def _answer(one: FittedSurface, data: ReportData) -> str:
    named = sentence(title(one, data)).rstrip(".")
    if one.found is None:
        return f"{named}: no surface could be fitted. {clean(one.refused)}"
    moved = _ranges(one.found)
    gate = getattr(one.found.model, "gate", "given")
    ranked = [name_of(name, data.labels) for name in strongest(one.found)]
    if gate == "refused":
        said = "the runs do not carry an emulator that could rank the factors: add runs"
    elif not moved:
        said = f"the emulator ranks the factors, and says no more: {listing(ranked)}"
    else:
        sizes = [
            f"{name_of(name, data.labels)} {'changes it ' if not place else ''}by up to "
            f"{quantity(size, clean(one.unit))}"
            for place, (name, size) in enumerate(moved.items())
        ]
        said = f"over its range, {listing(sizes)}"
    beside = (_judged(one, data), *differences(one, data), accuracy(one))
    parts = (f"{named}: {said}.", *beside, *uncertainty_answer(one, data))
    return " ".join(text for text in parts if text)


def _ranges(found: SurfaceAnalysis) -> dict[str, float]:
    """Largest changes by factor: of an emulator where it may tell, of a profile of a quadratic."""
    order = strongest(found)
    told = {i.factor: i.range.value for i in found.sensitivity if i.range is not None}
    if not told and found.kind == "quadratic":
        told = {n: float(p.value.max() - p.value.min()) for n, (_, p) in profiles(found).items()}
    return {name: told[name] for name in order if name in told}


def _judged(one: FittedSurface, data: ReportData) -> str:
    """Which factors matter, against what does."""
    if one.practical is None or one.found is None:
        return ""
    by: dict[str, list[str]] = {}
    for item in one.found.sensitivity:
        if item.range is not None:
            by.setdefault(item.range.told, []).append(name_of(item.factor, data.labels))
    limit = f"{one.practical:.3g} {clean(one.unit)}".strip()
    said = []
    if MATTERS in by:
        verb = "matters" if len(by[MATTERS]) == 1 else "matter"
        said.append(f"{listing(by.pop(MATTERS))} {verb}")
    if (waiting := f"{MATTERS}, if confirmed") in by:
        verb = "matters" if len(by[waiting]) == 1 else "matter"
        said.append(f"{listing(by.pop(waiting))} {verb}, if the runs that are named confirm it")
    if NO_DIFFERENCE in by:
        verb = "makes" if len(by[NO_DIFFERENCE]) == 1 else "make"
        said.append(f"{listing(by.pop(NO_DIFFERENCE))} {verb} no practical difference")
    rest = [name for names in by.values() for name in names]
    if rest:
        said.append(f"these runs cannot show whether {listing(rest, 'or')} matters")
    return (
        sentence(f"with {limit} as the smallest difference that matters, {'; '.join(said)}")
        if said
        else ""
    )


def _sensitivity_row(item: Sensitivity, one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    index, effect, unit = item.index, item.range, clean(one.unit)
    shares = (MISSING, MISSING) if index is None else (
        _share(index.first, index.first_interval), _share(index.total, index.total_interval)
    )  # fmt: skip
    moved = (MISSING, MISSING, "cannot tell") if effect is None else (
        quantity(effect.value, unit), quantity(effect.bound, unit, 2),
        effect.told,
    )  # fmt: skip
    return (clean(name_of(item.factor, data.labels)), *shares, *moved)


def _share(value: float, ends: tuple[float, float]) -> str:
    low, high = (max(0.0, min(1.0, end)) for end in ends)
    return f"{percent(max(value, 0.0))} [{percent(low)}, {percent(high)}]"


def _extreme(extreme: Extreme, one: FittedSurface) -> str:
    value = quantity(extreme.value, clean(one.unit))
    if extreme.half_width != extreme.half_width:  # NaN where no run can be left out
        return value
    return f"{value} \N{PLUS-MINUS SIGN} {significant(extreme.half_width, 2)}"


def _term(term: str, data: ReportData) -> Sequence[str]:
    return [name_of(part.strip(), data.labels) for part in term.split(":")]


def _table_name(kind: str, one: FittedSurface) -> str:
    return " ".join((kind, one.response, *one.labels.values()))


def _q2(value: float) -> str:
    return f"{value:.3f}" if value < 0.9995 else "above 0.999"
