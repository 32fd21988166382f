"""Verbs that write files to start from: new, virtual."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from study.cli import output
from study.cli.next_command import written
from study.cli.studies import Set
from study.errors import Fault, InputError


def new(
    file: Annotated[Path, typer.Argument(help="File to be written.")],
    calibration: Annotated[
        bool, typer.Option(help="A calibration, with virtual measurements beside it.")
    ] = False,
) -> None:
    """Write a commented design, or calibration, to start from."""
    from study.api.single.virtual import new_file

    try:
        new_file(file, calibration=calibration)
    except FileExistsError as error:
        rule = "exists already"
        where = str(error.filename or file)
        raise InputError(Fault(where, rule, "choose another name")) from None
    except OSError as error:
        rule = f"cannot be written ({error.strerror or error})"
        raise InputError(Fault(str(file), rule)) from None
    if calibration:
        output.next_step(f"{file} runs as it is; edit it later", written("calibrate", file))
        return
    print(f"{file} runs as it is, with measurements of virtual specimens; edit it later")
    made = written("virtual", "measurements", options={"--from": file})
    output.next_step("make the measurements, then plan", f"{made}\n  {written('plan', file)}")


def virtual(
    out: Annotated[Path, typer.Argument(help="Folder for the generated CSV files.")],
    source: Annotated[
        Path | None,
        typer.Option("--from", help="Design, or tracker study, whose data are imitated."),
    ] = None,
    truth: Annotated[
        str, typer.Option(help="Material behind the specimens: yeoh, ogden or humphrey.")
    ] = "yeoh",
    specimens: Annotated[
        int | None, typer.Option(min=2, help="Number of specimens (or batches).")
    ] = None,
    settings: Set = None,
) -> None:
    """Write virtual measurements as CSV."""
    from study import api
    from study.api.folders import data_root, design_root
    from study.design.load import load
    from study.tracker_accuracy.section import is_tracking

    chosen = {"overrides": settings or (), "truth": truth, "blocks": specimens}
    for path in api.virtual(out, source, **chosen):
        print(path)
    if source is not None and is_tracking(source):
        where = None if data_root(source).resolve() == out.resolve() else out
        command = written("tracking", source, options={"--data": where})
        output.next_step("what the tracker is worth", command, beside=True)
    elif source is not None:
        found = design_root(load(source, settings or ())).resolve() == out.resolve()
        told = {"--data": None if found else out, "-s": settings}
        output.next_step(
            "what a study of them computes", written("plan", source, options=told), beside=True
        )


VERBS: tuple[Callable[..., None], ...] = (new, virtual)
