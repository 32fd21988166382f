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


def uncertainty_answer(fitted: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the answer: how sure the response is, and which input to measure better."""
    uncertain = fitted.uncertain
    if uncertain is None:
        return ()
    unit, ends = clean(fitted.unit), uncertain.percentiles
    best = uncertain.inputs[0]
    gain = uncertain.gain(best)
    sure = (
        f"With these uncertain inputs it is {quantity(uncertain.mean.value, unit)} with a standard "
        f"deviation of {quantity(uncertain.sd.value, unit)}; 95 % of it lie between "
        f"{quantity(ends[2.5].value, unit)} and {quantity(ends[97.5].value, unit)}."
    )
    if gain < WORTH:
        return (sure, "Measuring one of them twice as well would change that by less than 1 %.")
    worth = (
        f"Knowing {name_of(best.name, data.labels)} twice as well would lower the standard "
        f"deviation by {percent(gain)}"
        + (", more than any other." if uncertain.inputs[1:] else ".")
    )
    return (sure, worth)


def uncertainty_lines(fitted: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the section: the surface's own error, and what was held or cut off."""
    uncertain = fitted.uncertain
    if uncertain is None:
        return ()
    unit = clean(fitted.unit)
    ends = uncertain.percentiles
    lines = [
        "The surface itself may be off by "
        f"{quantity(uncertain.mean.own, unit, 2)} in the mean, "
        f"{quantity(uncertain.sd.own, unit, 2)} in the "
        f"standard deviation and {quantity(max(t.own for t in ends.values()), unit, 2)} in the "
        "percentiles of the uncertain inputs' response; that is no part of these."
    ]
    if uncertain.fixed:
        held = [
            f"{name_of(name, data.labels)} at {quantity(value, fitted.units.get(name, ''))}"
            for name, value in uncertain.fixed.items()
        ]
        lines.append(f"Held there for it: {listing(held)}.")
    cut = [
        f"{percent(p, 2)} of {name_of(n, data.labels)}"
        for n, p in uncertain.cut.items()
        if p > 1e-4
    ]
    if cut:
        lines.append(f"Outside of the ranges that were run, and cut off: {listing(cut)}.")
    return tuple(lines)


def table(fitted: FittedSurface, data: ReportData) -> Table | None:
    """List the inputs, the one that is worth measuring most first; None where none is uncertain."""
    uncertain = fitted.uncertain
    if uncertain is None:
        return None
    rows = tuple(
        (
            clean(name_of(item.name, data.labels)),
            clean(fitted.inputs.get(item.name, "")),
            *_shares(item),
            quantity(item.halved, clean(fitted.unit)),
            percent(uncertain.gain(item)),
        )
        for item in uncertain.inputs
    )
    columns = ("input", "distribution", "share alone", "share in all", "sd if halved", "gain")
    note = (
        "Standard deviation of the response now: "
        f"{quantity(uncertain.sd.value, clean(fitted.unit))}. "
        "Shares of its variance by the input alone and with all its interactions. Gain: part of "
        "the standard deviation that goes when the input is known twice as well."
    )
    name = " ".join(("uncertain", fitted.response, *fitted.labels.values()))
    return Table(name, columns, rows, 2, 0, note)


def _shares(item: InputShare) -> tuple[str, str]:
    if item.index is None:
        return MISSING, MISSING
    return percent(item.index.first), percent(item.index.total)


def title(fitted: FittedSurface, data: ReportData) -> str:
    """Name of the response, and where the factors without numbers stand."""
    at = listing([f"{name_of(k, data.labels)} {clean(v)}" for k, v in fitted.labels.items()])
    named = clean(name_of(fitted.response, data.labels))
    return f"{named} at {at}" if at else named


def surface_answer(data: ReportData) -> tuple[str, ...]:
    """Sentences that answer which numbers drive each response, and how sure that is."""
    return tuple(_answer(surface, data) for surface in data.surfaces)


def would_change(data: ReportData) -> str:
    """Say what would make the answer surer."""
    good = [fitted.found for fitted in data.surfaces if fitted.found is not None]
    parts = []
    poor = [surface for surface in good if not quality(surface) >= 0.9]
    if poor or len(good) < len(data.surfaces):
        parts.append("more runs would make the surface surer")
    if any(i.range is not None and i.range.claims for surface in good for i in surface.sensitivity):
        parts.append("the two runs that confirm each factor could overturn what is said of it")
    parts.append("wider ranges may show more, for nothing is said beyond those that were run")
    return sentence("; ".join(parts))


def quality(surface: SurfaceAnalysis) -> float:
    """Leave-one-out Q2; NaN where no run can be left out."""
    model = surface.model
    if not isinstance(model, QuadraticSurface):
        return model.q2
    return float("nan") if model.loo is None else model.loo.q2


def accuracy(fitted: FittedSurface) -> str:
    """How well runs are predicted from the others."""
    surface = fitted.found
    if surface is None:
        return ""
    model = surface.model
    loo = model.loo if isinstance(model, QuadraticSurface) else model
    runs = count(surface.runs.response.size, "run")
    kind = "quadratic surface" if surface.kind == "quadratic" else "Gaussian-process emulator"
    if loo is None:
        return f"A {kind} of {runs}; no run can be left out, so its error is not known."
    rms = loo.rms if hasattr(loo, "rms") else loo.loo_rms
    if _learns_from_others(surface):
        runs += ", which learns from those at the other levels,"
    return (
        f"A {kind} of {runs} predicts each from all the others within "
        f"{quantity(rms, clean(fitted.unit))} (root mean square; Q2 {_q2(quality(surface))})."
    )


def _learns_from_others(surface: SurfaceAnalysis) -> bool:
    """Whether the runs at other levels were fitted together with those of a surface."""
    model = surface.model
    each = getattr(model, "each", (model,))
    return any(isinstance(e, Emulator) and e.combination is not None for e in each)


def method(fitted: FittedSurface, data: ReportData) -> str:
    """Sentences for a methods paragraph: what was fitted, and how it was judged."""
    surface = fitted.found
    if surface is None:
        return ""
    how = (
        "all linear, square and product terms of the coded factors by least squares"
        if surface.kind == "quadratic"
        else "a Gaussian process with a constant mean and one length per factor by restricted "
        "maximum likelihood, the kernel (Mat\N{LATIN SMALL LETTER E WITH ACUTE}rn 5/2 or Gaussian) "
        "by leave-one-out error"
    )
    if _learns_from_others(surface):
        how += (
            ", together with the runs at the other levels, between whose functions a correlation "
            "was fitted (Qian, Wu and Wu 2008)"
        )
    shares = (
        "; shares of variance are Sobol indices of factors uniform over their ranges, by "
        "Jansen's estimators on posterior paths"
        if any(item.index is not None for item in surface.sensitivity)
        else ""
    )
    name = sentence(title(fitted, data)).rstrip(".")
    return f"{name} was fitted with {how}{shares}. {accuracy(fitted)}"


def surface_lines(fitted: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the section of one surface: accuracy, extremes, what must still be run."""
    surface = fitted.found
    if surface is None:
        return (f"No surface: {clean(fitted.refused)}",)
    ends = [
        f"The {word} prediction in these ranges is {_extreme(extreme, fitted)} at "
        f"{settings(surface.runs.settings(extreme.at), fitted, data)}."
        for word, extreme in (("smallest", surface.smallest), ("largest", surface.largest))
    ]
    confirm = [
        f"That {name_of(item.factor, data.labels)} matters is claimed once these two were run: "
        + " and ".join(
            settings(surface.runs.settings(at), fitted, data) for at in item.range.confirm
        )
        + "."
        for item in surface.sensitivity
        if item.range is not None and item.range.claims
    ]
    return (
        accuracy(fitted),
        *_shape(fitted, data),
        *differences(fitted, data),
        *ends,
        *confirm,
        *uncertainty_lines(fitted, data),
    )


def differences(fitted: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say what another level of a factor without numbers changes over the ranges."""
    unit = clean(fitted.unit)
    for difference in fitted.differences:
        word = "more" if difference.mean >= 0 else "less"
        ends = (
            (difference.low, difference.high)
            if difference.mean >= 0
            else (-difference.high, -difference.low)
        )
        ending = {
            MATTERS: "this matters",
            NO_DIFFERENCE: "this makes no practical difference at any setting",
        }.get(difference.verdict, "these runs cannot show whether this matters")
        limit = (
            ""
            if fitted.practical is None
            else f"; with {fitted.practical:.3g} {unit} as what matters, {ending}"
        )
        yield sentence(
            f"{name_of(fitted.response, data.labels)} with "
            f"{name_of(difference.factor, data.labels)} "
            f"{clean(difference.level)} is {quantity(abs(difference.mean), unit)} {word} than with "
            f"{clean(difference.other)} on average over the ranges, and between "
            f"{significant(ends[0])} and {quantity(ends[1], unit)} {word} at 95 % of the settings "
            f"(each \N{PLUS-MINUS SIGN} {significant(difference.bound, 2)}){limit}"
        )


def _shape(fitted: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say where a quadratic surface is level, whether it fits, and what it cannot tell apart."""
    model = None if fitted.found is None else fitted.found.model
    if not isinstance(model, QuadraticSurface):
        return
    point = model.stationary
    if point is not None and point.established:
        where = "inside" if point.inside else "outside"
        at = settings(model.runs.settings(point.at), fitted, data)
        yield (
            f"The surface is level at a {point.kind} of "
            f"{quantity(point.value, clean(fitted.unit))}, {where} the ranges: {at}."
        )
    lack = model.lack_of_fit
    if lack is not None:
        yield (
            f"Lack of fit: F({lack.df:.3g}, {lack.df_error:.3g}) = {significant(lack.f)}, "
            f"{p_phrase(lack.p)}."
        )
    yield from (f"Not told apart: {clean(alias)}." for alias in model.aliases)


def settings(at: Mapping[str, float], fitted: FittedSurface, data: ReportData) -> str:
    """Write settings with their names and units."""
    return listing(
        [
            f"{name_of(name, data.labels)} {quantity(value, fitted.units.get(name, ''))}"
            for name, value in at.items()
        ]
    )


def sensitivity(fitted: FittedSurface, data: ReportData) -> Table | None:
    """Shares and ranges of the factors, the strongest first; None of a quadratic surface."""
    surface = fitted.found
    if surface is None or all(item.index is None for item in surface.sensitivity):
        return None
    items = sorted(surface.sensitivity, key=lambda item: item.rank)
    rows = tuple(_sensitivity_row(item, fitted, data) for item in items)
    columns = ("factor", "share alone", "share in all", "range", "bound", "verdict")
    note = (
        "Shares of the variance of the response when every factor is uniform over its range: by "
        "the factor alone (first-order Sobol index) and with all its interactions (total index), "
        "each with an interval of about 95 %. Range: 95 % of the settings of the other factors "
        "change the response by less along this one."
    )
    return Table(_table_name("sensitivity", fitted), columns, rows, 1, 1, note)


def coefficients(fitted: FittedSurface, data: ReportData) -> Table | None:
    """Coefficients of a quadratic surface in coded factors; None of an emulator."""
    model = None if fitted.found is None else fitted.found.model
    if not isinstance(model, QuadraticSurface):
        return None
    judged = model.error != "none"
    unit = clean(fitted.unit)
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
    return Table(_table_name("coefficients", fitted), columns, rows, 1, 0, note)


def _answer(fitted: FittedSurface, data: ReportData) -> str:
    named = sentence(title(fitted, data)).rstrip(".")
    if fitted.found is None:
        return f"{named}: no surface could be fitted. {clean(fitted.refused)}"
    moved = _ranges(fitted.found)
    gate = getattr(fitted.found.model, "gate", "given")
    ranked = [name_of(name, data.labels) for name in strongest(fitted.found)]
    if gate == "refused":
        reason = "the runs do not carry an emulator that could rank the factors: add runs"
    elif not moved:
        reason = f"the emulator ranks the factors, and says no more: {listing(ranked)}"
    else:
        sizes = [
            f"{name_of(name, data.labels)} {'changes it ' if not place else ''}by up to "
            f"{quantity(size, clean(fitted.unit))}"
            for place, (name, size) in enumerate(moved.items())
        ]
        reason = f"over its range, {listing(sizes)}"
    rest = (_judged(fitted, data), *differences(fitted, data), accuracy(fitted))
    parts = (f"{named}: {reason}.", *rest, *uncertainty_answer(fitted, data))
    return " ".join(text for text in parts if text)


def _ranges(surface: SurfaceAnalysis) -> dict[str, float]:
    """Largest changes by factor: of an emulator where it may tell, of a profile of a quadratic."""
    order = strongest(surface)
    if surface.sensitivity:
        ranges = {i.factor: i.range.value for i in surface.sensitivity if i.range is not None}
    else:
        ranges = (
            {p.factor: p.range for p in profiles(surface)} if surface.kind == "quadratic" else {}
        )
    return {name: ranges[name] for name in order if name in ranges}


def _judged(fitted: FittedSurface, data: ReportData) -> str:
    """Which factors matter, against what does."""
    if fitted.practical is None or fitted.found is None:
        return ""
    by: dict[str, list[str]] = {}
    for item in fitted.found.sensitivity:
        if item.range is not None:
            by.setdefault(item.range.verdict, []).append(name_of(item.factor, data.labels))
    limit = f"{fitted.practical:.3g} {clean(fitted.unit)}".strip()
    parts = []
    if MATTERS in by:
        verb = "matters" if len(by[MATTERS]) == 1 else "matter"
        parts.append(f"{listing(by.pop(MATTERS))} {verb}")
    if NO_DIFFERENCE in by:
        verb = "makes" if len(by[NO_DIFFERENCE]) == 1 else "make"
        parts.append(f"{listing(by.pop(NO_DIFFERENCE))} {verb} no practical difference")
    rest = [name for names in by.values() for name in names]
    if rest:
        parts.append(f"these runs cannot show whether {listing(rest, 'or')} matters")
    return (
        sentence(f"with {limit} as the smallest difference that matters, {'; '.join(parts)}")
        if parts
        else ""
    )


def _sensitivity_row(item: Sensitivity, fitted: FittedSurface, data: ReportData) -> tuple[str, ...]:
    index, effect, unit = item.index, item.range, clean(fitted.unit)
    shares = (MISSING, MISSING) if index is None else (
        _share(index.first, index.first_interval), _share(index.total, index.total_interval)
    )  # fmt: skip
    moved = (MISSING, MISSING, "cannot tell") if effect is None else (
        quantity(effect.value, unit), quantity(effect.bound, unit, 2),
        f"{effect.verdict}, if confirmed" if effect.claims else effect.verdict,
    )  # fmt: skip
    return (clean(name_of(item.factor, data.labels)), *shares, *moved)


def _share(value: float, ends: tuple[float, float]) -> str:
    low, high = (max(0.0, min(1.0, end)) for end in ends)
    return f"{percent(max(value, 0.0))} [{percent(low)}, {percent(high)}]"


def _extreme(extreme: Extreme, fitted: FittedSurface) -> str:
    value = quantity(extreme.value, clean(fitted.unit))
    if extreme.half_width != extreme.half_width:  # NaN where no run can be left out
        return value
    return f"{value} \N{PLUS-MINUS SIGN} {significant(extreme.half_width, 2)}"


def _term(term: str, data: ReportData) -> Sequence[str]:
    return [name_of(part.strip(), data.labels) for part in term.split(":")]


def _table_name(kind: str, fitted: FittedSurface) -> str:
    return " ".join((kind, fitted.response, *fitted.labels.values()))


def _q2(value: float) -> str:
    return f"{value:.3f}" if value < 0.9995 else "above 0.999"
