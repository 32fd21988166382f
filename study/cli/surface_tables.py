"""Surfaces over numeric factors as the terminal shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from study.cli import output
from study.ground.errors import Fault, InputError

if TYPE_CHECKING:
    from study.api.fitting_surfaces import Surface
    from study.api.predicting import PredictedAnswer
    from study.reporting.results.study_answers import Checked, Inverted, Recommendation
    from study.statistics.surfaces.quadratic import QuadraticSurface, SurfaceFTest
    from study.statistics.surfaces.surface_factors import Extreme
    from study.statistics.surfaces.surface_profile import FittedSurface
    from study.statistics.surfaces.surface_result import SurfaceAnalysis


#: flags of `study analyze` that a surface has a use for
USED = frozenset({
    "--response", "--factors", "--block", "--practical", "--decimal", "--report", "--format",
})  # fmt: skip

#: what to do instead of a flag; every other one is left out
MEND = {
    "--alpha": "intervals are 95 %: leave it out",
}


def show(
    source: Path,
    numeric: Sequence[str],
    surface: str,
    flags: Mapping[str, str | None],
    as_json: bool,
) -> None:
    """Fit a surface and print it."""
    from study import api

    _check(source, flags)
    every = api.fit_surfaces(
        source,
        cast(str, flags["--response"]),
        numeric,
        names(flags["--factors"]),
        surface=cast("Surface", surface),
        block=flags["--block"],
        practical=flags["--practical"],
        decimal=flags["--decimal"] or ".",
        announce=lambda text: output.warn([text]),
    )
    carried = [fitted.found for fitted in every if fitted.found is not None]
    notes = dict.fromkeys(note for surface_found in carried for note in surface_found.notes)
    output.warn(
        [*notes, *[f"{_at(fitted)}: {fitted.refused}" for fitted in every if fitted.found is None]]
    )
    page = _page(every, source, {"--numeric": ",".join(numeric), "--surface": surface}, flags)
    if as_json:
        surfaces_document = {"surfaces": [fitted.to_json() for fitted in every]}
        document = surfaces_document if flags["--factors"] else carried[0].to_json()
        output.print_json(document if page is None else document | {"report": str(page)})
        return
    for fitted in every:
        print_fitted(fitted)
    if page is not None:
        print(f"\nreport: {page}")


def _at(fitted: FittedSurface) -> str:
    return ", ".join(f"{name} = {label}" for name, label in fitted.labels.items())


def _page(
    every: Sequence[FittedSurface],
    source: Path,
    numeric: dict[str, str],
    flags: Mapping[str, str | None],
) -> Path | None:
    """Write the page where one is asked for."""
    folder = flags["--report"]
    if folder is None:
        return None
    from study.api.analyzing import AnalysisSource as Source
    from study.api.fitting_surfaces import write_surface_page

    given = {flag: value for flag, value in flags.items() if value} | numeric
    formats = names(flags["--format"]) or ["html"]
    return write_surface_page(every, folder, source=Source(source, given), formats=formats)


def _check(source: Path, flags: Mapping[str, str | None]) -> None:
    faults = []
    if source.is_dir() or source.suffix == ".toml":
        faults.append(Fault("--numeric", "reads a table, one row a run", "name a CSV"))
    if not flags["--response"]:
        faults.append(Fault("--response", "is missing", "name the column of the response"))
    faults += [
        Fault(
            flag,
            "has no meaning for a surface over numeric factors",
            MEND.get(flag, "leave it out"),
        )
        for flag, value in flags.items()
        if value and flag not in USED
    ]
    if faults:
        raise InputError(faults)


def names(text: str | None) -> list[str]:
    """Read names with commas between them.

    Examples
    --------
    >>> names("time, temperature,")
    ['time', 'temperature']
    """
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def settings(text: str) -> dict[str, str]:
    """Read ``thickness=3 mm,C10=5 kPa``.

    Examples
    --------
    >>> settings("specimen.height=3 mm, material.C10 = 5 kPa")
    {'specimen.height': '3 mm', 'material.C10': '5 kPa'}
    """
    settings_typed: dict[str, str] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip(" \"'") for piece in part.partition("="))
        if not equals or not name or not value or name in settings_typed:
            rule = f"cannot read {part.strip()!r}"
            raise InputError(Fault("--at", rule, "write thickness='3 mm',C10='5 kPa', each once"))
        settings_typed[name] = value
    return settings_typed


def print_predictions(predictions: Sequence[PredictedAnswer]) -> None:
    """Print a row for every response."""
    rows = [["Response", "Prediction", "95 % interval"]]
    for prediction in predictions:
        ends = f"{prediction.low[0]:.4g} to {prediction.high[0]:.4g}"
        rows.append(
            [prediction.response, f"{prediction.value[0]:.4g} {prediction.unit}".strip(), ends]
        )
    output.table(rows)
    output.paragraph(
        "predicted by a surface fitted to the runs; about 95 of 100 simulations at such settings "
        "lie in their interval"
    )


def print_fitted(fitted: FittedSurface) -> None:
    """Print the surface of a response of a study."""
    if fitted.found is None:
        return
    at = _at(fitted)
    unit, in_unit = (f" in {fitted.unit}", f" {fitted.unit}") if fitted.unit else ("", "")
    print(f"\n{fitted.response}{unit}{' at ' if at else ''}{at}")
    print_surface(fitted.found, fitted.units)
    for difference in fitted.differences:
        output.paragraph(
            f"{difference.factor} = {difference.level} less {difference.other}: "
            f"{difference.mean:.3g}{in_unit} on average "
            f"over the ranges, {difference.low:.3g} to {difference.high:.3g} at 95 % of the "
            f"settings (each +- {difference.bound:.2g}): {difference.verdict}"
        )
    _print_uncertain(fitted)


def _print_uncertain(fitted: FittedSurface) -> None:
    """Print the response's distribution where inputs are uncertain."""
    uncertain = fitted.uncertain
    if uncertain is None:
        return
    ends = uncertain.percentiles
    print(
        f"with uncertain inputs: mean {uncertain.mean.value:.4g}, standard deviation "
        f"{uncertain.sd.value:.3g}, 95 % between {ends[2.5].value:.4g} and "
        f"{ends[97.5].value:.4g}; the "
        f"surface itself may err by {uncertain.mean.own:.2g} in the mean"
    )
    rows = [["Uncertain input", "Distribution", "S", "T", "Gain if known twice as well"]]
    for item in uncertain.inputs:
        index = item.index
        shares = ["-", "-"] if index is None else [f"{index.first:.3f}", f"{index.total:.3f}"]
        gain = f"{100 * uncertain.gain(item):.1f} % of the sd"
        rows.append([item.name, fitted.inputs.get(item.name, ""), *shares, gain])
    output.table(rows)


def print_surface(surface: SurfaceAnalysis, units: Mapping[str, str] | None = None) -> None:
    """Print model, error, factors and extremes of a surface, settings with their units."""
    from study.statistics.surfaces.quadratic import QuadraticSurface

    model = surface.model
    if isinstance(model, QuadraticSurface):
        _print_quadratic(model, units or {})
        _print_sensitivity(surface, units or {})
    else:
        runs = model.runs
        blocks = f", one emulator for each of {len(set(runs.blocks))} blocks" if runs.blocks else ""
        print(f"Gaussian process: {runs.response.size} runs of {len(runs.factors)} factors{blocks}")
        print(f"leave-one-out: rms {output.number(model.loo_rms)}, Q2 {model.q2:.3f}\n")
        _print_sensitivity(surface, units or {})
    for word, extreme in (("smallest", surface.smallest), ("largest", surface.largest)):
        print(f"{word} predicted: {_extreme(surface, extreme, units or {})}")


def _print_quadratic(model: QuadraticSurface, units: Mapping[str, str]) -> None:
    judged = model.error != "none"
    rows = [["Term (coded)", "Coefficient", *(["95 % interval", "P-Value"] if judged else [])]]
    for term in model.terms:
        row = [term.term, output.number(term.coefficient)]
        if judged:
            ends = term.interval
            row += ["-" if ends is None else f"{ends[0]:.4g} to {ends[1]:.4g}"]
            row += [output.number(term.p, 3)]
        rows.append(row)
    output.table(rows, f"Quadratic surface: {model.runs.name}")
    for name, test in model.factor_tests.items():
        print(f"all terms of {name}: {_test(test)}")
    for alias in model.aliases:
        print(f"alias: {alias}")
    if model.loo is not None:
        loo = model.loo
        print(f"\nleave-one-out: rms {loo.rms:.4g}, largest {loo.largest:.4g}, Q2 {loo.q2:.3f}")
    if model.lack_of_fit is not None:
        print(f"lack of fit: {_test(model.lack_of_fit)}")
    point = model.stationary
    if point is not None and point.established:
        values = ", ".join(output.number(float(v)) for v in point.eigenvalues)
        at = _surface_tables_settings(model.runs.settings(point.at), units)
        print(f"stationary point ({point.kind}): {point.value:.4g} at {at}; eigenvalues {values}")


def _print_sensitivity(surface: SurfaceAnalysis, units: Mapping[str, str]) -> None:
    rows = [["Rank", "Factor", "S", "T", "Range", "Verdict"]]
    for item in sorted(surface.sensitivity, key=lambda item: item.rank):
        row = [str(item.rank), item.factor]
        index, effect = item.index, item.range
        row += ["-", "-"] if index is None else [
            _share(index.first, index.first_interval), _share(index.total, index.total_interval)
        ]  # fmt: skip
        if effect is None:
            rows.append([*row, "-", "cannot tell"])
            continue
        row.append(f"{effect.value:.4g} +- {effect.bound:.2g}")
        rows.append([*row, effect.told])
    if surface.sensitivity:
        output.table(rows, f"Sensitivity: {surface.runs.name}")
        print()
    for item in surface.sensitivity:
        if item.range is not None and item.range.claims:
            ends = [
                _surface_tables_settings(surface.runs.settings(at), units)
                for at in item.range.confirm
            ]
            print(f"confirm {item.factor}: run {ends[0]}\n    and {ends[1]}")


def _test(test: SurfaceFTest) -> str:
    return f"F({test.df:.3g}, {test.df_error:.3g}) = {test.f:.3g}, p = {test.p:.3g}"


def _share(value: float, interval: tuple[float, float]) -> str:
    return f"{value:.3f} ({interval[0]:.3f} to {interval[1]:.3f})"


def _extreme(surface: SurfaceAnalysis, extreme: Extreme, units: Mapping[str, str]) -> str:
    at = _surface_tables_settings(surface.runs.settings(extreme.at), units)
    # NaN where no run can be left out
    is_bounded = math.isfinite(extreme.half_width)
    error = f" +- {extreme.half_width:.2g}" if is_bounded else ", error unknown,"
    return f"{extreme.value:.4g}{error} at {at}"


def _surface_tables_settings(settings: Mapping[str, float], units: Mapping[str, str]) -> str:
    return ", ".join(
        f"{name} = {value:.4g} {units.get(name, '')}".rstrip() for name, value in settings.items()
    )


# What optimize and invert show in a terminal.


def print_recommendations(recommendations: Sequence[Recommendation]) -> None:
    """Print the best setting, what is predicted there, and the run that confirms it."""
    for number, recommended in enumerate(recommendations):
        if number:
            print()
        _print_recommendation(recommended)


def _print_recommendation(recommended: Recommendation) -> None:
    word = "smallest" if recommended.goal == "minimize" else "largest"
    held = _optimum_tables_settings(recommended.held, recommended.units)
    unit = f" {recommended.unit}" if recommended.unit else ""
    print(
        f"{word} {recommended.response}: {recommended.value:.3g}{unit}, 95 % interval "
        f"{recommended.low:.3g} to {recommended.high:.3g}{unit}"
    )
    rows = [["Choice", "Best setting", ""]]
    for name, value in recommended.settings.items():
        end = "at an end of what was run" if name in recommended.at_end else ""
        rows.append([name, _setting(value, recommended.units.get(name, "")), end])
    output.table(rows)
    if held:
        print(f"held, not recommended: {held}")
    if recommended.bounds:
        _print_limits(recommended)
    if recommended.spread is not None:
        limits = (
            f"; the limits hold at {100 * recommended.spread.kept:.0f} % of them"
            if recommended.bounds
            else ""
        )
        output.paragraph(
            f"over what was run of the inputs that are not chosen, {recommended.response} there "
            "goes from "
            f"{recommended.spread.low:.3g} to {recommended.spread.high:.3g}{unit}{limits}"
        )
    for at, value in recommended.rivals:
        print(f"best with {_optimum_tables_settings(at, recommended.units)}: {value:.3g}{unit}")
    if recommended.confirmed is not None:
        _print_confirmed(recommended)


def _print_limits(recommended: Recommendation) -> None:
    rows = [["Limit", "Predicted", "95 % interval"]]
    for bound, (value, low, high) in zip(recommended.bounds, recommended.limited, strict=True):
        rows.append([bound.words, f"{value:.3g}", f"{low:.3g} to {high:.3g}"])
    output.table(rows)
    if recommended.assurance == "predicted":
        output.paragraph(
            "the limits hold for the prediction, not at the unfavourable end of its interval: no "
            "setting keeps them there"
        )


def _print_confirmed(recommended: Recommendation) -> None:
    run = recommended.confirmed
    if run is None:
        return
    rows = [["True model", "Run", "Predicted interval"]]
    intervals = [
        (recommended.low, recommended.high),
        *((low, high) for _, low, high in recommended.limited),
    ]
    for (name, value), (low, high) in zip(run.values.items(), intervals, strict=True):
        rows.append([name, f"{value:.4g}", f"{low:.4g} to {high:.4g}"])
    output.table(rows)
    inside = "inside of" if run.predicted else "outside of"
    limits = "" if not recommended.bounds else "; limits kept" if run.kept else "; limits not kept"
    print(f"the confirming run lies {inside} the predicted interval{limits}")


def print_inverted(inverted: Inverted) -> None:
    """Print the set of inputs that agree, what of it is determined, and the true model's runs."""
    rows = [["Input", "Best", "Settings that agree", ""]]
    for item in inverted.inputs:
        unit = f" {item.unit}" if item.unit else ""
        ends = f"{item.low:.4g} to {item.high:.4g}{unit}"
        rows.append([item.name, f"{item.best:.4g}{unit}", ends, item.verdict])
    output.table(rows)
    output.paragraph(inverted.sentence)
    for combination in inverted.combinations:
        percent = 100 * (combination.ratio - 1)
        print(f"{combination.words} = {combination.value:.4g}, within {percent:.2g} %")
    held = _optimum_tables_settings(inverted.held, inverted.units)
    if held:
        print(f"known: {held}")
    print(
        f"best curve: misses {inverted.rms:.3g} N rms ({100 * inverted.relative:.3g} %) over "
        f"{inverted.rows} rows; a curve agrees up to {inverted.limit:.3g} N"
    )
    _print_runs(inverted.best_run, inverted.end_runs)


def _print_runs(best: Checked | None, ends: Sequence[Checked]) -> None:
    if best is None:
        return
    rows = [["True model at", "Misses [N]", "Agrees"]]
    for run in (best, *ends):
        at = ", ".join(f"{name} = {label}" for name, label in run.settings.items())
        rows.append([at, f"{run.rms:.3g}", "yes" if run.agrees else "no"])
    output.table(rows)


def _optimum_tables_settings(settings: Mapping[str, float | str], units: Mapping[str, str]) -> str:
    return ", ".join(f"{n} = {_setting(v, units.get(n, ''))}" for n, v in settings.items())


def _setting(value: float | str, unit: str) -> str:
    return value if isinstance(value, str) else f"{value:.4g} {unit}".strip()
