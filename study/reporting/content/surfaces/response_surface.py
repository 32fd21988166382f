"""What a surface over numeric factors says: sentences and tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from study.analysis.effects.verdict import MATTERS, NO_DIFFERENCE
from study.reporting.content.surfaces import uncertainty
from study.reporting.content.table import Table
from study.reporting.numbers import (
    MISSING,
    interval,
    p_phrase,
    p_value,
    percent,
    quantity,
    significant,
)
from study.reporting.text import clean, count, listing, name_of, sentence
from study.response_surface.emulator.emulator import Emulator
from study.response_surface.profile import profiles, strongest
from study.response_surface.quadratic.surface import QuadraticSurface

if TYPE_CHECKING:
    from study.response_surface.extremes import Extreme
    from study.response_surface.result import Sensitivity, SurfaceAnalysis
    from study.study_result.report_data import ReportData
    from study.study_result.response_surface import FittedSurface


def title(one: FittedSurface, data: ReportData) -> str:
    """Name of the response, and where the factors without numbers stand.

    Parameters
    ----------
    one, data : FittedSurface, ReportData with better names
    """
    at = listing([f"{name_of(k, data.labels)} {clean(v)}" for k, v in one.labels.items()])
    named = clean(name_of(one.response, data.labels))
    return f"{named} at {at}" if at else named


def answer(data: ReportData) -> tuple[str, ...]:
    """Sentences that answer which numbers drive each response, and how sure that is.

    Parameters
    ----------
    data : ReportData with surfaces, an entry each
    """
    return tuple(_answer(one, data) for one in data.surfaces)


def would_change(data: ReportData) -> str:
    """Say what would make the answer surer.

    Parameters
    ----------
    data : ReportData with surfaces
    """
    good = [one.found for one in data.surfaces if one.found is not None]
    parts = []
    poor = [found for found in good if not quality(found) >= 0.9]
    if poor or len(good) < len(data.surfaces):
        parts.append("more runs would make the surface surer")
    if any(i.range is not None and i.range.claims for found in good for i in found.sensitivity):
        parts.append("the two runs that confirm each factor could overturn what is said of it")
    parts.append("wider ranges may show more, for nothing is said beyond those that were run")
    return sentence("; ".join(parts))


def quality(found: SurfaceAnalysis) -> float:
    """Leave-one-out Q2; NaN where no run can be left out.

    Parameters
    ----------
    found : SurfaceAnalysis
    """
    model = found.model
    if not isinstance(model, QuadraticSurface):
        return model.q2
    return float("nan") if model.loo is None else model.loo.q2


def accuracy(one: FittedSurface) -> str:
    """How well runs are predicted from the others.

    Parameters
    ----------
    one : FittedSurface; empty text where no surface was found
    """
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
        f"{quantity(rms, clean(one.unit))} (root mean square; Q2 {_q2(quality(found))})."
    )


def _learns_from_others(found: SurfaceAnalysis) -> bool:
    """Whether the runs at other levels were fitted together with those of a surface."""
    model = found.model
    each = getattr(model, "each", (model,))
    return any(isinstance(e, Emulator) and e.combination is not None for e in each)


def method(one: FittedSurface, data: ReportData) -> str:
    """Sentences for a methods paragraph: what was fitted, and how it was judged.

    Parameters
    ----------
    one, data : FittedSurface, ReportData; empty text where no surface was found
    """
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


def lines(one: FittedSurface, data: ReportData) -> tuple[str, ...]:
    """Sentences of the section of one surface: accuracy, extremes, what must still be run.

    Parameters
    ----------
    one, data : FittedSurface, ReportData; where no surface was found, why
    """
    found = one.found
    if found is None:
        return (f"No surface: {clean(one.refused)}",)
    ends = [
        f"The {word} prediction in these ranges is {_extreme(extreme, one)} at "
        f"{settings(found.runs.settings(extreme.at), one, data)}."
        for word, extreme in (("smallest", found.smallest), ("largest", found.largest))
    ]
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
        *ends,
        *confirm,
        *uncertainty.lines(one, data),
    )


def differences(one: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say what another level of a factor without numbers changes over the ranges.

    Parameters
    ----------
    one, data : FittedSurface with differences in its unit, ReportData
    """
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
    """Write settings with their names and units.

    Parameters
    ----------
    at, one, data : mapping of str to float in the factors' own units, FittedSurface, ReportData
    """
    return listing(
        [
            f"{name_of(name, data.labels)} {quantity(value, one.units.get(name, ''))}"
            for name, value in at.items()
        ]
    )


def sensitivity(one: FittedSurface, data: ReportData) -> Table | None:
    """Shares and ranges of the factors, the strongest first; None of a quadratic surface.

    Parameters
    ----------
    one, data : FittedSurface, ReportData; also None where the runs carry no indices
    """
    found = one.found
    if found is None or all(item.index is None for item in found.sensitivity):
        return None
    items = sorted(found.sensitivity, key=lambda item: item.rank)
    rows = tuple(_sensitivity_row(item, one, data) for item in items)
    columns = ("factor", "share alone", "share in all", "range", "bound", "verdict")
    note = (
        "Shares of the variance of the response when every factor is uniform over its range: by "
        "the factor alone (first-order Sobol index) and with all its interactions (total index), "
        "each with an interval of about 95 %. Range: 95 % of the settings of the other factors "
        "change the response by less along this one."
    )
    return Table(_table_name("sensitivity", one), columns, rows, 1, 1, note)


def coefficients(one: FittedSurface, data: ReportData) -> Table | None:
    """Coefficients of a quadratic surface in coded factors; None of an emulator.

    Parameters
    ----------
    one, data : FittedSurface, ReportData with better names of factors
    """
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
    parts = (f"{named}: {said}.", *beside, *uncertainty.answer(one, data))
    return " ".join(text for text in parts if text)


def _ranges(found: SurfaceAnalysis) -> dict[str, float]:
    """Largest changes by factor: of an emulator where it may tell, of a profile of a quadratic."""
    order = strongest(found)
    if found.sensitivity:
        told = {i.factor: i.range.value for i in found.sensitivity if i.range is not None}
    else:
        told = {p.factor: p.range for p in profiles(found)} if found.kind == "quadratic" else {}
    return {name: told[name] for name in order if name in told}


def _judged(one: FittedSurface, data: ReportData) -> str:
    """Which factors matter, against what does."""
    if one.practical is None or one.found is None:
        return ""
    by: dict[str, list[str]] = {}
    for item in one.found.sensitivity:
        if item.range is not None:
            by.setdefault(item.range.verdict, []).append(name_of(item.factor, data.labels))
    limit = f"{one.practical:.3g} {clean(one.unit)}".strip()
    said = []
    if MATTERS in by:
        verb = "matters" if len(by[MATTERS]) == 1 else "matter"
        said.append(f"{listing(by.pop(MATTERS))} {verb}")
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
        f"{effect.verdict}, if confirmed" if effect.claims else effect.verdict,
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
