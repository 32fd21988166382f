"""What a surface over numeric factors says: sentences and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from study.ground.arrays import gathered
from study.reporting.content.blocks import (
    Block,
    Figure,
    Heading,
    Points,
    Sentence,
    Table,
    Verbatim,
    titled,
)
from study.reporting.content.text import (
    MISSING,
    THIN,
    TIMES,
    between,
    capital,
    clean,
    count,
    general,
    interval,
    listing,
    name_of,
    p_phrase,
    p_value,
    percent,
    quantity,
    sentence,
    significant,
    trimmed,
)
from study.statistics.analysis.simple_effects import MATTERS, NO_DIFFERENCE
from study.statistics.surfaces.emulator import Emulator
from study.statistics.surfaces.quadratic import QuadraticSurface, SurfaceTerm
from study.statistics.surfaces.surface_result import (
    ElementaryEffect,
    FittedSurface,
    Sensitivity,
    SurfaceAnalysis,
    SurfacePrediction,
    profiles,
    strongest,
)

if TYPE_CHECKING:
    from study.reporting.results.study_answers import Confirmed, Inverted, Recommendation
    from study.reporting.results.study_result import ReportData


#: a gain below this is no reason to measure an input better
WORTH = 0.01


def uncertainty_answer(fit: FittedSurface, data: ReportData) -> Iterator[str]:
    """Sentences of the answer: how sure the response is, and which input to measure better."""
    if (spread := fit.uncertain) is None:
        return
    unit, ends, best = clean(fit.unit), spread.percentiles, spread.inputs[0]
    yield (
        f"With these uncertain inputs it is {quantity(spread.mean.value, unit)} with a standard "
        f"deviation of {quantity(spread.sd.value, unit)}; 95 % of it lie between "
        f"{quantity(ends[2.5].value, unit)} and {quantity(ends[97.5].value, unit)}."
    )
    if best.gain < WORTH:
        yield "Measuring one of them twice as well would change that by less than 1 %."
        return
    yield (
        f"Knowing {name_of(best.name, data.labels)} twice as well would lower the standard "
        f"deviation by {percent(best.gain)}{', more than any other' * bool(spread.inputs[1:])}."
    )


def uncertainty_lines(fit: FittedSurface, data: ReportData) -> Iterator[str]:
    """Sentences of the section: the surface's own error, and what was held or cut off."""
    if (spread := fit.uncertain) is None:
        return
    unit, largest = clean(fit.unit), max(end.own for end in spread.percentiles.values())
    yield (
        f"The surface itself may be off by {quantity(spread.mean.own, unit, 2)} in the mean, "
        f"{quantity(spread.sd.own, unit, 2)} in the standard deviation and "
        f"{quantity(largest, unit, 2)} in the percentiles of the uncertain inputs' response; that "
        "is no part of these."
    )
    if spread.fixed:
        yield f"Held there for it: {settings(spread.fixed, fit, data, ' at')}."
    cut = {name_of(n, data.labels): percent(p, 2) for n, p in spread.cut.items() if p > 1e-4}
    if cut:
        parts = listing([f"{part} of {name}" for name, part in cut.items()])
        yield f"Outside of the ranges that were run, and cut off: {parts}."


def uncertain_inputs(fit: FittedSurface, data: ReportData) -> Table | None:
    """List the inputs, the one that is worth measuring most first; None where none is uncertain."""
    if (spread := fit.uncertain) is None:
        return None
    unit = clean(fit.unit)
    return Table.of(
        _table_name("uncertain", fit),
        spread.inputs,
        {
            "input": lambda item: name_of(item.name, data.labels),
            "distribution": lambda item: clean(fit.inputs.get(item.name, "")),
            "share alone": lambda item: percent(None if item.index is None else item.index.first),
            "share in all": lambda item: percent(None if item.index is None else item.index.total),
            "sd if halved": lambda item: quantity(item.halved, unit),
            "gain": lambda item: percent(item.gain),
        },
        left=2,
        note=f"Standard deviation of the response now: {quantity(spread.sd.value, unit)}. Shares "
        "of its variance by the input alone and with all its interactions. Gain: part of the "
        "standard deviation that goes when the input is known twice as well.",
    )


def title(fit: FittedSurface, data: ReportData) -> str:
    """Name of the response, and where the factors without numbers stand."""
    at, named = at_labels(fit, data), name_of(fit.response, data.labels)
    return f"{named} at {at}" if at else named


def at_labels(fit: FittedSurface, data: ReportData) -> str:
    """Where the factors without numbers stand; empty without such factors."""
    return listing([f"{name_of(k, data.labels)} {clean(v)}" for k, v in fit.labels.items()])


def would_change(data: ReportData) -> str:
    """Say what would make the answer surer."""
    if any(fit.screened for fit in data.surfaces):
        return sentence("a surface or a factorial of the factors that change most")
    good = [fit.surface for fit in data.surfaces if fit.surface is not None]
    parts = []
    poor = [surface for surface in good if not surface.model.q2 >= 0.9]
    if poor or len(good) < len(data.surfaces):
        parts.append("more runs would make the surface surer")
    if any(i.range is not None and i.range.claims for surface in good for i in surface.sensitivity):
        parts.append("the two runs that confirm each factor could overturn what is said of it")
    parts.append("wider ranges may show more, for nothing is said beyond those that were run")
    return sentence("; ".join(parts))


def accuracy(fit: FittedSurface) -> str:
    """How well runs are predicted from the others."""
    if (surface := fit.surface) is None:
        return ""
    model, runs = surface.model, count(surface.runs.response.size, "run")
    kind = "quadratic surface" if surface.kind == "quadratic" else "Gaussian-process emulator"
    if isinstance(model, QuadraticSurface):
        if model.loo is None:
            return f"A {kind} of {runs}; no run can be left out, so its error is not known."
        rms = model.loo.rms
    else:
        rms = model.loo_rms
    learned = ", which learns from those at the other levels," * _learns_from_others(surface)
    q2 = f"{model.q2:.3f}" if model.q2 < 0.9995 else "above 0.999"
    return (
        f"A {kind} of {runs}{learned} predicts each from all the others within "
        f"{quantity(rms, clean(fit.unit))} (root mean square; Q2 {q2})."
    )


def _learns_from_others(surface: SurfaceAnalysis) -> bool:
    """Whether the runs at other levels were fitted together with those of a surface."""
    model = surface.model
    each = getattr(model, "each", (model,))
    return any(isinstance(e, Emulator) and e.combination is not None for e in each)


def method(fit: FittedSurface, data: ReportData) -> str:
    """Sentences for a methods paragraph: what was fitted, and how it was judged."""
    if (surface := fit.surface) is None:
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
    if any(item.index is not None for item in surface.sensitivity):
        how += (
            "; shares of variance are Sobol indices of factors uniform over their ranges, by "
            "Jansen's estimators on posterior paths"
        )
    return f"{sentence(title(fit, data)).rstrip('.')} was fitted with {how}. {accuracy(fit)}"


def extremes(fit: FittedSurface, data: ReportData) -> Iterator[str]:
    """Smallest and largest prediction in the ranges, and where they are."""
    if (surface := fit.surface) is None:
        return
    unit = "" if fit.unit == "1" else f"{THIN}{clean(fit.unit)}" * bool(fit.unit)
    for word, extreme in (("smallest", surface.smallest), ("largest", surface.largest)):
        value = significant(extreme.value)
        if not math.isnan(extreme.half_width):  # as where no run can be left out
            value += f"{THIN}\N{PLUS-MINUS SIGN}{THIN}{significant(extreme.half_width, 2)}"
        at = settings(extreme.settings, fit, data)
        yield f"The {word} prediction in these ranges is {value}{unit} at {at}."


def _refusal(fit: FittedSurface) -> str:
    return clean("; ".join(map(str.strip, fit.refused.splitlines())))


def differences(fit: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say what another level of a factor without numbers changes over the ranges."""
    unit = clean(fit.unit)
    for difference in fit.differences:
        word = "more" if difference.mean >= 0 else "less"
        ends = (difference.low, difference.high)
        if difference.mean < 0:
            ends = (-difference.high, -difference.low)
        limit = ""
        if fit.practical is not None:
            # what 95 % of the settings have at least, or what only some have
            most = ends[0] - difference.bound > fit.practical
            verdict = {
                MATTERS: f"this matters at {'95 % of the' if most else 'some'} settings",
                NO_DIFFERENCE: "this makes no practical difference at any setting",
            }.get(difference.verdict, "these runs cannot show whether this matters")
            matters = f"{trimmed(fit.practical)} {unit}".strip()
            limit = f"; with {matters} as what matters, {verdict}"
        yield sentence(
            f"{name_of(fit.response, data.labels)} with {name_of(difference.factor, data.labels)} "
            f"{clean(difference.level)} is {quantity(abs(difference.mean), unit)} {word} than with "
            f"{clean(difference.other)} on average over the ranges, and between "
            f"{significant(ends[0])} and {quantity(ends[1], unit)} {word} at 95 % of the settings "
            f"(each \N{PLUS-MINUS SIGN}{THIN}{significant(difference.bound, 2)}){limit}"
        )


def _shape(fit: FittedSurface, data: ReportData) -> Iterator[str]:
    """Say where a quadratic surface is level, whether it fits, and what it cannot tell apart."""
    if fit.surface is None or not isinstance(model := fit.surface.model, QuadraticSurface):
        return
    if (point := model.stationary) is not None and point.established:
        where = "inside" if point.inside else "outside"
        at = settings(model.runs.settings(point.at), fit, data)
        yield (
            f"The surface is level at a {point.kind} of {quantity(point.value, clean(fit.unit))}, "
            f"{where} the ranges: {at}."
        )
    if (lack := model.lack_of_fit) is not None:
        yield (
            f"Lack of fit: F({lack.df:.3g}, {lack.df_error:.3g}) = {significant(lack.f)}, "
            f"{p_phrase(lack.p)}."
        )
    yield from (
        f"Not told apart: {clean(alias)}; intervals of predictions allow for either."
        for alias in model.aliases
    )


def settings(where: Mapping[str, float], fit: FittedSurface, data: ReportData, at: str = "") -> str:
    """Write settings with their names and units."""
    values = {name: quantity(value, fit.units.get(name, "")) for name, value in where.items()}
    return listing([f"{name_of(name, data.labels)}{at} {value}" for name, value in values.items()])


def sensitivity(surface: SurfaceAnalysis, fit: FittedSurface, data: ReportData) -> Table | None:
    """Shares and ranges of the factors, the strongest first; None where none is known."""
    if all(item.index is None and item.range is None for item in surface.sensitivity):
        return None
    unit = clean(fit.unit)
    columns: dict[str, Callable[[Sensitivity], str]] = {
        "factor": lambda item: name_of(item.factor, data.labels),
        "share alone": lambda item: (
            MISSING if item.index is None else _share(item.index.first, item.index.first_interval)
        ),
        "share in all": lambda item: (
            MISSING if item.index is None else _share(item.index.total, item.index.total_interval)
        ),
        "range": lambda item: quantity(None if item.range is None else item.range.value, unit),
        "bound": lambda item: quantity(None if item.range is None else item.range.bound, unit, 2),
        "verdict": lambda item: MISSING if fit.practical is None else item.verdict,
    }
    note = (
        "Range: 95 % of the settings of the other factors change the response by less along this "
        "one."
    )
    if surface.kind == "quadratic":
        del columns["share alone"], columns["share in all"]
    else:
        note = (
            "Shares of the variance of the response when every factor is uniform over its range: "
            "by the factor alone (first-order Sobol index) and with all its interactions (total "
            f"index), each with an interval of about 95 %. {note}"
        )
    ranked = sorted(surface.sensitivity, key=lambda item: item.rank)
    return Table.of(_table_name("sensitivity", fit), ranked, columns, tail=1, note=note)


def screening(fit: FittedSurface, data: ReportData) -> Table | None:
    """Elementary effects of the factors, the largest mean size first; None of a surface."""
    unit = clean(fit.unit)
    columns: dict[str, Callable[[ElementaryEffect], str]] = {
        "factor": lambda e: name_of(e.factor, data.labels),
        "effects": lambda e: str(e.effects),
        "\N{GREEK SMALL LETTER MU}*": lambda e: quantity(e.mu_star, unit),
        "\N{GREEK SMALL LETTER MU}": lambda e: quantity(e.mu, unit),
        "\N{GREEK SMALL LETTER SIGMA}": lambda e: quantity(e.sigma, unit),
    }
    note = (
        "Elementary effects: change of the response over the whole range of a factor, by pairs of "
        "runs that differ in it alone. Mean size, mean and standard deviation. Of a straight line "
        "without interactions the deviation is 0."
    )
    table = Table.of(_table_name("screening", fit), fit.screened, columns, note=note)
    return table if table.rows else None


def coefficients(model: QuadraticSurface, fit: FittedSurface, data: ReportData) -> Table:
    """Coefficients of a quadratic surface in coded factors."""
    columns: dict[str, Callable[[SurfaceTerm], str]] = {
        "term": lambda t: (
            "(constant)"
            if t.term == "1"
            else clean(
                f" {TIMES} ".join(name_of(part.strip(), data.labels) for part in t.term.split(":"))
            )
        ),
        "coefficient": lambda t: quantity(t.coefficient, clean(fit.unit), 4),
    }
    note = "Every factor runs from \N{MINUS SIGN}1 at its lower end to 1 at its upper end."
    if model.error == "none":
        note += " No p: no repeats tell the scatter of the runs from the misfit of the surface."
    else:
        columns["95 % interval"] = lambda t: interval(*(t.interval or (None, None)))
        columns["p"] = lambda t: p_value(t.p)
    return Table.of(_table_name("coefficients", fit), model.terms, columns, note=note)


#: factors that a short answer names
_NAMED = 3


def surface_answer(fit: FittedSurface, data: ReportData, *, is_short: bool = False) -> str:
    """Say which numbers drive a response, in short the strongest of them; how sure that is."""
    named = sentence(title(fit, data)).rstrip(".")
    if fit.screened:
        sizes = [
            f"{name_of(e.factor, data.labels)} {quantity(e.mu_star, clean(fit.unit))}"
            for e in fit.screened
        ]
        return (
            f"{named}: over its whole range a factor changes it on average by {listing(sizes)}. "
            "This screens, and is no verdict: leave out what changes little, and run a surface or "
            "a factorial of the others."
        )
    if fit.surface is None:
        return f"{named}: no surface could be fitted: {_refusal(fit)}"
    moved = _ranges(fit.surface)
    gate = getattr(fit.surface.model, "gate", "given")
    ranked = [name_of(name, data.labels) for name in strongest(fit.surface)]
    if gate == "refused":
        refusal = "the runs do not carry an emulator that could rank the factors: add runs"
    elif not moved:
        refusal = f"the emulator ranks the factors, and says no more: {listing(ranked)}"
    else:
        sizes = [
            f"{name_of(name, data.labels)} {'changes it ' if not rank else ''}by up to "
            f"{quantity(size, clean(fit.unit))}"
            for rank, (name, size) in enumerate(moved.items())
        ]
        less = [f"{len(sizes) - _NAMED} more by less"] if is_short and sizes[_NAMED:] else []
        refusal = f"over its range, {listing([*sizes[: _NAMED if less else None], *less])}"
    if is_short:
        of_unit = f"{trimmed(fit.practical or 0.0)} {clean(fit.unit)}".strip()
        limit = f" (what matters: {of_unit})" if fit.practical else ""
        return " ".join(
            (f"{named}: {refusal}{limit if moved else ''}.", *uncertainty_answer(fit, data))
        )
    further = (_judged(fit, data), *differences(fit, data), accuracy(fit))
    parts = (f"{named}: {refusal}.", *further, *uncertainty_answer(fit, data))
    return " ".join(text for text in parts if text)


def _ranges(surface: SurfaceAnalysis) -> dict[str, float]:
    """Largest changes by factor: of an emulator where it may tell, of a profile of a quadratic."""
    order = strongest(surface)
    ranges = {i.factor: i.range.value for i in surface.sensitivity if i.range is not None}
    if not ranges and surface.kind == "quadratic":
        ranges = {
            n: float(p.value.max() - p.value.min()) for n, (_, p) in profiles(surface).items()
        }
    return {name: ranges[name] for name in order if name in ranges}


def _judged(fit: FittedSurface, data: ReportData) -> str:
    if fit.practical is None or fit.surface is None:
        return ""
    by = gathered(
        (item.range.words, name_of(item.factor, data.labels))
        for item in fit.surface.sensitivity
        if item.range is not None
    )
    limit = f"{trimmed(fit.practical)} {clean(fit.unit)}".strip()
    claims = []
    for verdict, verb, more in (
        (MATTERS, "matter", ""),
        (f"{MATTERS}, if confirmed", "matter", ", if the two confirming runs of each agree"),
        (NO_DIFFERENCE, "make", " no practical difference"),
    ):
        if names := by.pop(verdict, []):
            claims.append(f"{listing(names)} {verb}{'s' * (len(names) == 1)}{more}")
    if rest := [name for names in by.values() for name in names]:
        claims.append(f"these runs cannot show whether {listing(rest, 'or')} matters")
    start = f"with {limit} as the smallest difference that matters, "
    return sentence(start + "; ".join(claims)) if claims else ""


def _share(value: float, ends: tuple[float, float]) -> str:
    low, high = (max(0.0, min(1.0, end)) for end in ends)
    return f"{percent(max(value, 0.0))} [{percent(low)}, {percent(high)}]"


def _table_name(kind: str, fit: FittedSurface) -> str:
    return " ".join((kind, fit.response, *fit.labels.values()))


def surface_blocks(
    fit: FittedSurface,
    data: ReportData,
    anchor: str = "",
    drawn: Mapping[str, Figure] | None = None,
) -> Iterator[Block | None]:
    """One surface: what drives it, what it says, its tables, then its other figures."""
    figures = drawn or {}
    yield Heading(capital(title(fit, data)), 2, anchor, fit.unit)
    if (surface := fit.surface) is None:
        yield Sentence(f"No surface: {_refusal(fit)}.", kind="missing")
        yield screening(fit, data)
        return
    confirm = [
        f"{name_of(item.factor, data.labels)} matters if these two runs confirm it: "
        f"{' and '.join(settings(at, fit, data) for at in item.confirm)}."
        for item in surface.sensitivity
        if item.confirm
    ]
    shape, others, ends = _shape(fit, data), differences(fit, data), extremes(fit, data)
    yield figures.get("shares")
    yield Points([accuracy(fit), *shape, *others, *ends, *confirm, *uncertainty_lines(fit, data)])
    yield sensitivity(surface, fit, data)
    if isinstance(model := surface.model, QuadraticSurface):
        yield from titled(coefficients(model, fit, data), "Coefficients")
        for name, test in model.factor_tests.items():
            ratio = f"F({test.df:.3g}, {test.df_error:.3g}) = {test.f:.3g}"
            yield Sentence(f"All terms of {name}: {ratio}, {p_phrase(test.p)}.")
    yield from titled(uncertain_inputs(fit, data), "Uncertain inputs")
    yield from (figures[kind] for kind in ("contours", "left-out") if kind in figures)


def recommendation_blocks(recommendations: Sequence[Recommendation]) -> Iterator[Block]:
    """Give the best settings, what is predicted there, and the runs that confirm them."""
    for recommended in recommendations:
        if recommended is not recommendations[0]:
            yield Verbatim("")
        yield from _recommendation(recommended)


def _recommendation(recommended: Recommendation) -> Iterator[Block]:
    word = "smallest" if recommended.goal == "minimize" else "largest"
    unit = f" {recommended.unit}" if recommended.unit else ""
    ends = between((recommended.low, recommended.high), 3)
    yield Verbatim(
        f"{word} {recommended.response}: {general(recommended.value, 3)}{unit}, 95 % interval "
        f"{ends}{unit}"
    )
    yield Table.of(
        "",
        recommended.settings.items(),
        {
            "Choice": lambda of: of[0],
            "Best setting": lambda of: _setting(of[1], recommended.units.get(of[0], "")),
            "": lambda of: "at an end of what was run" if of[0] in recommended.at_end else "",
        },
    )
    if held := _settings(recommended.held, recommended.units):
        yield Verbatim(f"held, not recommended: {held}")
    if recommended.bounds:
        yield from _limits(recommended)
    if (spread := recommended.spread) is not None:
        share = f"; the limits hold at {100 * spread.kept:.0f} % of them"
        yield Sentence(
            f"over what was run of the inputs that are not chosen, {recommended.response} there "
            f"goes from {spread.low:.3g} to {spread.high:.3g}{unit}"
            f"{share if recommended.bounds else ''}"
        )
    for rival in recommended.rivals:
        other = _settings(rival.settings, recommended.units)
        yield Verbatim(f"best with {other}: {rival.value:.3g}{unit}")
    if recommended.confirmed is not None:
        yield from _confirmed(recommended, recommended.confirmed)


def _limits(recommended: Recommendation) -> Iterator[Block]:
    yield Table.of(
        "",
        list(zip(recommended.bounds, recommended.limited, strict=True)),
        {
            "Limit": lambda of: of[0].words,
            "Predicted": lambda of: general(of[1][0], 3),
            "95 % interval": lambda of: between(of[1][1:], 3),
        },
    )
    if recommended.limits_hold == "predicted":
        yield Sentence(
            "the limits hold for the prediction, not at the unfavourable end of its interval: no "
            "setting keeps them there"
        )


def _confirmed(recommended: Recommendation, run: Confirmed) -> Iterator[Block]:
    ends = [(recommended.low, recommended.high), *(limited[1:] for limited in recommended.limited)]
    yield Table.of(
        "",
        [(name, value, pair) for (name, value), pair in zip(run.values.items(), ends, strict=True)],
        {
            "True model": lambda of: of[0],
            "Run": lambda of: general(of[1]),
            "Predicted interval": lambda of: between(of[2], 4),
        },
    )
    inside = "inside of" if run.predicted else "outside of"
    limits = f"; limits {'' if run.within_limits else 'not '}kept" if recommended.bounds else ""
    yield Verbatim(f"the confirming run lies {inside} the predicted interval{limits}")


def inversion_blocks(inverted: Inverted) -> Iterator[Block]:
    """Tabulate inputs that agree, what of them is determined, and the true model's runs."""
    yield Table.of(
        "",
        inverted.inputs,
        {
            "Input": lambda item: item.name,
            "Best": lambda item: _setting(item.best, item.unit),
            "Settings that agree": lambda item: (
                f"{between((item.low, item.high), 4)} {item.unit}".strip()
            ),
            "": lambda item: item.verdict,
        },
    )
    yield Sentence(inverted.sentence)
    for product in inverted.combinations:
        within = 100 * (product.ratio - 1)
        yield Verbatim(f"{product.words} = {product.value:.4g}, within {within:.2g} %")
    if held := _settings(inverted.held, inverted.units):
        yield Verbatim(f"known: {held}")
    yield Verbatim(
        f"best curve: misses {inverted.rms:.3g} N rms ({100 * inverted.relative:.3g} %) over "
        f"{inverted.rows} rows; a curve agrees up to {inverted.limit:.3g} N"
    )
    yield Table.of(
        "",
        () if inverted.best_run is None else (inverted.best_run, *inverted.end_runs),
        {
            "True model at": lambda run: ", ".join(f"{n} = {v}" for n, v in run.settings.items()),
            "Misses [N]": lambda run: general(run.rms, 3),
            "Agrees": lambda run: "yes" if run.agrees else "no",
        },
    )


def _settings(settings: Mapping[str, float | str], units: Mapping[str, str]) -> str:
    return ", ".join(f"{n} = {_setting(v, units.get(n, ''))}" for n, v in settings.items())


def _setting(value: float | str, unit: str) -> str:
    return value if isinstance(value, str) else f"{value:.4g} {unit}".strip()


def prediction_blocks(predictions: Sequence[SurfacePrediction]) -> Iterator[Block]:
    """Tabulate predictions with their intervals."""
    yield Table.of(
        "",
        predictions,
        {
            "Response": lambda of: of.response,
            "Prediction": lambda of: f"{general(of.value[0])} {of.unit}".strip(),
            "95 % interval": lambda of: between((of.low[0], of.high[0]), 4),
        },
    )
    yield Sentence(
        "predicted by a surface fitted to the runs; about 95 of 100 simulations at such settings "
        "lie in their interval"
    )
