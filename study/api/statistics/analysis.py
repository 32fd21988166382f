"""The verb analyze: a study, a table or a file in, an analysis out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Unpack, cast

from study import api
from study.analysis.anova import anova
from study.api.statistics.notebook import Analysis
from study.api.statistics.records import rows_for, specimens_of
from study.api.uncertainty.numerical import numerical_bound
from study.errors import Fault, InputError, nearest
from study.tabular import NUMBER
from study.tidy_csv import read_csv

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.effects.numerical_bound import NumericalBound
    from study.analysis.request import AnovaOptions
    from study.analysis.result import AnalysisResult

#: levels from which labels that are numbers are remarked upon: two say no more as numbers
FEWEST_NUMBERS = 3


def _is_csv(path: Path) -> bool:
    if path.suffix == ".toml" or path.is_dir():
        return False
    return path.is_file() or path.suffix in (".csv", ".gz", ".txt", ".tsv")


def _table(
    frame: pd.DataFrame, response: str | None, factors: Sequence[str], options: AnovaOptions
) -> AnalysisResult:
    _check_named(response, factors)
    found = anova(frame, str(response), list(factors), **options)
    return found.noted(*twin_levels(frame, factors), *number_levels(frame, factors))


def twin_levels(frame: pd.DataFrame, columns: Sequence[str]) -> list[str]:
    """Sentences about labels of a column that differ in case or spaces alone: probably one level.

    Parameters
    ----------
    frame : DataFrame
        The table.
    columns : sequence of str
        Those of its columns that hold labels.
    """
    said = []
    for name in columns:
        alike: dict[str, dict[str, None]] = {}
        for label in dict.fromkeys(map(str, frame[name])):
            alike.setdefault("".join(label.split()).casefold(), {})[label] = None
        said += [
            f"column {name!r} holds {' and '.join(map(repr, labels))} as different levels: "
            "did you mean one?"
            for labels in alike.values()
            if len(labels) > 1
        ]
    return said


def number_levels(frame: pd.DataFrame, columns: Sequence[str]) -> list[str]:
    """Sentences about columns of labels that look like numbers: they are never taken as such.

    Parameters
    ----------
    frame, columns
        As for `twin_levels`.
    """
    labels = {name: set(map(str, frame[name])) for name in columns}
    return [
        f"the levels of {name!r} are numbers, and are taken as labels: --numeric {name} asks for "
        "a surface over them"
        for name, own in labels.items()
        if len(own) >= FEWEST_NUMBERS and all(NUMBER.fullmatch(one) for one in own)
    ]


def _check_named(response: str | None, factors: Sequence[str]) -> None:
    faults = []
    if response is None:
        faults.append(Fault("--response", "is missing", "name the column of the response"))
    if not factors:
        mend = "name the columns: --factors for labels, --numeric for numbers"
        faults.append(Fault("--factors", "is missing", mend))
    if faults:
        raise InputError(faults)


def _study(
    source: str | Path,
    response: str | None,
    factors: Sequence[str],
    results: str | Path,
    options: AnovaOptions,
) -> AnalysisResult:
    """Analysis of stored records: what is not said is taken from the design."""
    study = api.open_study(source, results)
    by_name = {r.name: r for r in study.design.responses}
    name = response or next(iter(by_name))
    if not study.records:
        raise InputError(f"{study.folder}: no case is computed yet")
    known = list(study.records[0].responses)
    if name not in known:
        raise InputError(Fault("--response", f"there is no {name!r}", nearest(name, known)))
    said = cast("AnovaOptions", {key: v for key, v in options.items() if v is not None})
    asked, spec = by_name.get(name), study.design.analysis
    blocked = options.get("block") or ("block" if len(study.manifest["blocks"]) > 1 else None)
    merged: AnovaOptions = {
        "type": spec.type,
        "model": spec.model if isinstance(spec.model, (str, int)) else list(spec.model),
        "alpha": spec.alpha,
        "seed": study.design.seed,
        "practical": None if asked is None else asked.practical,
        "transform": "none" if asked is None else asked.transform,
        "records": True,
        "specimens": specimens_of(study.design, study.records),
    }
    merged.update(said)
    names = list(factors) or [f.name for f in study.design.factors if len(f.levels) > 1]

    def u_num(frame: pd.DataFrame) -> NumericalBound | None:
        return numerical_bound(
            study.design, study.numerical, study.records, frame, name, merged["transform"]
        )

    if not isinstance(blocked, (str, type(None))):
        crossing: AnovaOptions = {"u_num": u_num(study.table), **merged, "block": blocked}
        return anova(study.table, name, names, **crossing)
    every = [f.name for f in study.design.factors]
    rows = rows_for(study.table, name, every, said.get("error", spec.error), blocked)
    own: AnovaOptions = {
        "u_num": u_num(rows.table),
        "replicates": rows.replicates,
        **merged,
        "error": rows.error,
        "block": rows.block,
    }
    found = anova(rows.table, name, names, **own)
    return found.noted(*rows.notes)


def analyze(
    source: str | Path | pd.DataFrame,
    response: str | None = None,
    factors: Sequence[str] = (),
    *,
    results: str | Path = Path("results"),
    decimal: str = ".",
    **options: Unpack[AnovaOptions],
) -> Analysis:
    """Analyze one response of a finished study, of a CSV file or of a table.

    Parameters
    ----------
    source : str, Path or DataFrame
        Results folder or design of a study, a tidy CSV (one row a run), or a table.
    response : str, optional
        Column of the response; that of a study's first response by default.
    factors : sequence of str
        Columns of the factors; all factors of a study by default.
    results : Path
        Folder of the results, where ``source`` is the name of a study.
    decimal : {".", ","}
        Decimal mark of a CSV.
    **options : optional
        As for :func:`study.anova`: ``block``, ``unit``, ``whole_plot``, ``replicates``,
        ``type``, ``model``, ``error``, ``practical``, ``transform``, ``alpha``, ``seed``.

    Returns
    -------
    Analysis
        Error term, table, effects with intervals and verdicts, assumptions; ``to_frame()``,
        ``plot()``, ``report(DIR)``, and a table in a notebook.

    Raises
    ------
    InputError
        If there is nothing to analyze, or a column does not exist.
    RefusedError
        If the answer would be meaningless.
    """
    if not isinstance(source, (str, Path)):
        return Analysis.of(_table(source, response, factors, options))
    if _is_csv(Path(source)):
        _check_named(response, factors)
        blocks, unit = options.get("block"), options.get("unit")
        frame = read_csv(Path(source), str(response), list(factors), blocks, unit, decimal)
        return Analysis.of(_table(frame, response, factors, options))
    return Analysis.of(_study(source, response, factors, results, options))
