"""Surfaces over numeric factors as the terminal shows them."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from study.cli import output
from study.ground.errors import Fault, InputError

if TYPE_CHECKING:
    from study.api.fitting_surfaces import Surface
    from study.reporting.results.study_answers import Checked, Inverted, Recommendation
    from study.reporting.results.study_result import ReportData
    from study.statistics.surfaces.surface_result import SurfacePrediction


#: flags of `study analyze` that a surface has a use for
_USED = frozenset({
    "--response", "--factors", "--block", "--practical", "--decimal", "--report", "--format",
})  # fmt: skip


def show(
    source: Path,
    numeric: Sequence[str],
    surface: str,
    flags: Mapping[str, str | None],
    as_json: bool,
) -> None:
    """Fit a surface and print it."""
    from study import api
    from study.api.analyzing import AnalysisSource
    from study.api.fitting_surfaces import table_data, write_surface_page

    if source.is_dir() or source.suffix == ".toml":
        raise InputError(Fault("--numeric", "reads a table, one row a run", "name a CSV"))
    if not flags["--response"]:
        rule, mend = "is missing", "name the column of the response"
        raise InputError(Fault("--response", rule, mend))
    refuse_useless(flags, _USED, "a surface over numeric factors")
    every = api.fit_surfaces(
        source,
        flags["--response"],
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
    refused = [(fitted.labels, fitted.refused) for fitted in every if fitted.found is None]
    at = [f"{', '.join(f'{n} = {v}' for n, v in at.items())}: {why}" for at, why in refused]
    output.warn([*notes, *at])
    given = {flag: value for flag, value in flags.items() if value}
    given |= {"--numeric": ",".join(numeric), "--surface": surface}
    data = table_data(every, AnalysisSource(source, given))
    page = None
    if (folder := flags["--report"]) is not None:
        page = write_surface_page(data, folder, names(flags["--format"]) or ["html"])
    if as_json:
        surfaces_document = {"surfaces": [fitted.to_json() for fitted in every]}
        document = surfaces_document if flags["--factors"] else carried[0].to_json()
        output.print_json(document if page is None else document | {"report": str(page)})
        return
    print_surfaces(data)
    if page is not None:
        print(f"\nreport: {page}")


def refuse_useless(flags: Mapping[str, str | None], used: Container[str], of: str) -> None:
    """Refuse flags that were given and that an analysis of some kind has no use for."""
    rule, always_95 = f"has no meaning for {of}", "intervals are 95 %: leave it out"
    useless = [flag for flag, value in flags.items() if value and flag not in used]
    if useless:
        raise InputError(
            [Fault(f, rule, always_95 if f == "--alpha" else "leave it out") for f in useless]
        )


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


def print_predictions(predictions: Sequence[SurfacePrediction]) -> None:
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


def print_surfaces(data: ReportData) -> None:
    """Print the surfaces of a study or a table as their page shows them."""
    from study.reporting.content import surface_content
    from study.statistics.surfaces.quadratic import QuadraticSurface

    for fitted in data.surfaces:
        if fitted.found is None:
            continue
        print(f"\n{surface_content.title(fitted, data)}")
        for table in (surface_content.coefficients, surface_content.sensitivity):
            output.content(table(fitted, data))
        if isinstance(model := fitted.found.model, QuadraticSurface):
            for name, test in model.factor_tests.items():
                ratio = f"F({test.df:.3g}, {test.df_error:.3g}) = {test.f:.3g}"
                print(f"all terms of {name}: {ratio}, p = {test.p:.3g}")
        output.paragraphs(surface_content.surface_lines(fitted, data))
        output.content(surface_content.table(fitted, data))


# What optimize and invert show in a terminal.


def print_recommendations(recommendations: Sequence[Recommendation]) -> None:
    """Print the best setting, what is predicted there, and the run that confirms it."""
    for number, recommended in enumerate(recommendations):
        if number:
            print()
        _print_recommendation(recommended)


def _print_recommendation(recommended: Recommendation) -> None:
    word = "smallest" if recommended.goal == "minimize" else "largest"
    held = _settings(recommended.held, recommended.units)
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
        print(f"best with {_settings(at, recommended.units)}: {value:.3g}{unit}")
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
    held = _settings(inverted.held, inverted.units)
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


def _settings(settings: Mapping[str, float | str], units: Mapping[str, str]) -> str:
    return ", ".join(f"{n} = {_setting(v, units.get(n, ''))}" for n, v in settings.items())


def _setting(value: float | str, unit: str) -> str:
    return value if isinstance(value, str) else f"{value:.4g} {unit}".strip()
