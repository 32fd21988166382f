"""What optimize and invert show in a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from study.cli import output

if TYPE_CHECKING:
    from study.study_result.inversion import Checked, Inverted
    from study.study_result.optimum import Recommendation


def print_recommendations(found: Sequence[Recommendation]) -> None:
    """Print the best setting, what is predicted there, and the run that confirms it.

    Parameters
    ----------
    found : sequence of Recommendation
        One for each combination of levels of conditions and unknowns that are not numbers.
    """
    for number, one in enumerate(found):
        if number:
            print()
        _print_recommendation(one)


def _print_recommendation(one: Recommendation) -> None:
    word = "smallest" if one.goal == "minimize" else "largest"
    held = _settings(one.held, one.units)
    unit = f" {one.unit}" if one.unit else ""
    print(
        f"{word} {one.response}: {one.value:.3g}{unit}, 95 % interval {one.low:.3g} to "
        f"{one.high:.3g}{unit}"
    )
    rows = [["Choice", "Best setting", ""]]
    for name, value in one.settings.items():
        end = "at an end of what was run" if name in one.at_end else ""
        rows.append([name, _setting(value, one.units.get(name, "")), end])
    output.table(rows)
    if held:
        print(f"held, not recommended: {held}")
    if one.bounds:
        _print_limits(one)
    if one.spread is not None:
        limits = f"; the limits hold at {100 * one.spread.kept:.0f} % of them" if one.bounds else ""
        output.paragraph(
            f"over what was run of the inputs that are not chosen, {one.response} there goes from "
            f"{one.spread.low:.3g} to {one.spread.high:.3g}{unit}{limits}"
        )
    for at, value in one.rivals:
        print(f"best with {_settings(at, one.units)}: {value:.3g}{unit}")
    if one.confirmed is not None:
        _print_confirmed(one)


def _print_limits(one: Recommendation) -> None:
    rows = [["Limit", "Predicted", "95 % interval"]]
    for bound, (value, low, high) in zip(one.bounds, one.limited, strict=True):
        rows.append([bound.words, f"{value:.3g}", f"{low:.3g} to {high:.3g}"])
    output.table(rows)
    if one.assurance == "predicted":
        output.paragraph(
            "the limits hold for the prediction, not at the unfavourable end of its interval: no "
            "setting keeps them there"
        )


def _print_confirmed(one: Recommendation) -> None:
    run = one.confirmed
    if run is None:
        return
    rows = [["True model", "Run", "Predicted interval"]]
    intervals = [(one.low, one.high), *((low, high) for _, low, high in one.limited)]
    for (name, value), (low, high) in zip(run.values.items(), intervals, strict=True):
        rows.append([name, f"{value:.4g}", f"{low:.4g} to {high:.4g}"])
    output.table(rows)
    inside = "inside of" if run.predicted else "outside of"
    limits = "" if not one.bounds else "; limits kept" if run.kept else "; limits not kept"
    print(f"the confirming run lies {inside} the predicted interval{limits}")


def print_inverted(found: Inverted) -> None:
    """Print the set of inputs that agree, what of it is determined, and the true model's runs.

    Parameters
    ----------
    found : Inverted
        Without a run at the best setting no runs are printed.
    """
    rows = [["Input", "Best", "Settings that agree", ""]]
    for one in found.inputs:
        unit = f" {one.unit}" if one.unit else ""
        ends = f"{one.low:.4g} to {one.high:.4g}{unit}"
        rows.append([one.name, f"{one.best:.4g}{unit}", ends, one.verdict])
    output.table(rows)
    output.paragraph(found.sentence)
    for told in found.combinations:
        percent = 100 * (told.ratio - 1)
        print(f"{told.words} = {told.value:.4g}, within {percent:.2g} %")
    held = _settings(found.held, found.units)
    if held:
        print(f"known: {held}")
    print(
        f"best curve: misses {found.rms:.3g} N rms ({100 * found.relative:.3g} %) over "
        f"{found.rows} rows; a curve agrees up to {found.limit:.3g} N"
    )
    _print_runs(found.best_run, found.end_runs)


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
