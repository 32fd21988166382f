"""The program ``study``: its verbs, its exit codes, its errors in words."""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import typer
from typer.main import get_command

from study import api
from study.cli import output, single_commands, statistics_commands, study_commands
from study.cli.output import (
    argument,
    complain,
    described,
    interrupted,
    is_resumable,
    option,
    written,
)
from study.cli.study_commands import REPORTS, RESULTS, Reports, Results, Set
from study.ground.errors import Fault, InputError, StoppedError, StudyError, names_in_bounds
from study.ground.working_folder import leave

# The verb that shows studies in a browser.


def serve(
    port: Annotated[int, option("Port on 127.0.0.1; 0 takes a free one.", min=0, max=65535)] = 8765,
    results: Results = RESULTS,
    reports: Reports = REPORTS,
) -> None:
    """Show studies at work, finished ones and their reports in a browser, on this machine alone."""

    def say(address: str) -> None:
        print(f"{address}  (Ctrl-C ends it)", flush=True)

    with suppress(KeyboardInterrupt):  # the usual end, nothing was interrupted
        api.serve(results=results, reports=reports, port=port, ready=say)


# Verbs that write files to start from: new, virtual.


def new(
    file: Annotated[Path, argument("File to be written.")],
    calibration: Annotated[bool, "A calibration, with virtual measurements beside it."] = False,
) -> None:
    """Write a commented design, or calibration, to start from."""
    from study.api.calibrating import new_file

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
    command = written("virtual", "measurements", options={"--from": file})
    output.next_step("make the measurements, then plan", f"{command}\n  {written('plan', file)}")


def virtual(
    out: Annotated[Path, argument("Folder for the generated CSV files.")],
    source: Annotated[
        Path | None, option("Design, or tracker study, whose data are imitated.", "--from")
    ] = None,
    truth: Annotated[str, "Material behind the specimens: yeoh, ogden or humphrey."] = "yeoh",
    specimens: Annotated[int | None, option("Number of specimens (or batches).", min=2)] = None,
    settings: Set = None,
) -> None:
    """Write virtual measurements as CSV."""
    from study.harness.design.load import design_root, load
    from study.laboratory.tracker.tracker_recording import is_tracking
    from study.simulation.job import data_root

    chosen = {"overrides": settings or (), "truth": truth, "blocks": specimens}
    progress = partial(print, file=sys.stderr, flush=True)
    for path in api.virtual(out, source, **chosen, progress=progress):
        print(path)
    if source is not None and is_tracking(source):
        where = None if data_root(source).resolve() == out.resolve() else out
        command = written("tracking", source, options={"--data": where})
        output.next_step("what the tracker is worth", command, is_optional=True)
    elif source is not None:
        is_beside_design = design_root(load(source, settings or ())).resolve() == out.resolve()
        options = {"--data": None if is_beside_design else out, "-s": settings}
        output.next_step(
            "what a study of them computes",
            written("plan", source, options=options),
            is_optional=True,
        )


#: the parser of all verbs, which takes 0.1 s to make
_parser = cache(get_command)
INTERRUPTED = 130
#: a polite kill and a terminal that is closed end as Ctrl-C does
POLITE = (signal.SIGTERM, signal.SIGHUP)
app = typer.Typer(
    name="study",
    epilog="Exit codes: 0 done, 1 some cases failed or disk full, 2 bad input, 3 refused, "
    "130 interrupted (also a run whose disk is full): the same command resumes.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(is_asked: bool) -> None:
    """Print the version and leave."""
    if is_asked:
        from study import __version__

        print(f"study {__version__}")
        raise typer.Exit()


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_say_version, is_eager=True),
    ] = False,
) -> None:
    """Design of experiments and honest statistics for simulations of soft materials."""


#: verbs by the group that ``study --help`` shows them in, each with an example of its call
GROUPS: dict[str, dict[Callable[..., None], str]] = {
    "Studies": {
        study_commands.demo: "study demo",
        new: "study new study.toml",
        virtual: "study virtual measurements --from study.toml",
        study_commands.plan: "study plan study.toml",
        study_commands.run: "study run study.toml --jobs 2",
        study_commands.import_: "study import runs.csv --factors a,b --responses y",
        study_commands.status: "study status STUDY",
        study_commands.report: "study report STUDY --format html,tex",
        study_commands.diff: "study diff FIRST SECOND",
        study_commands.why: "study why CASE",
        study_commands.verify: "study verify STUDY",
        serve: "study serve",
    },
    "Analysis": {
        statistics_commands.analyze: "study analyze runs.csv --response y --factors a,b",
        statistics_commands.power: "study power study.toml --sd 0.4",
        study_commands.predict: "study predict STUDY --at thickness='3 mm'",
        statistics_commands.optimize: "study optimize STUDY --minimize error",
        statistics_commands.invert: "study invert STUDY --to curve.csv",
    },
    "Materials and mechanics": {
        single_commands.solve: "study solve problem.toml",
        single_commands.calibrate: "study calibrate calibration.toml",
        single_commands.converge: "study converge --sizes 1,2,4 --values 0.9705,0.9685,0.9618",
        single_commands.export: "study export problem.toml --as abaqus",
    },
    "Laboratory": {
        single_commands.inspect: "study inspect recorded.csv",
        single_commands.require: "study require sensors.toml",
        single_commands.tracking: "study tracking tracker.toml",
        single_commands.shape: "study shape problem.toml --scan scan.ply",
    },
    "Tools": {single_commands.doctor: "study doctor"},
}
VERBS = tuple(verb for verbs in GROUPS.values() for verb in verbs)
for group, verbs in GROUPS.items():
    for verb, example in verbs.items():
        app.command(rich_help_panel=group, epilog=f"Example: {example}")(described(verb))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and exit with its code."""
    leave()
    for number in POLITE:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup leaves it
            signal.signal(number, _interrupt)
    code = run(arguments)
    if code == INTERRUPTED:
        # a second Ctrl-C while leaving must not undo the orderly end
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(code)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the program; errors that a user can mend are printed, bugs raise.

    How the process answers signals is left as it is: that belongs to :func:`main`.
    """
    # by default cycles are looked for at every 700 new objects: a tenth of the time of a resume
    gc.set_threshold(50_000, 20, 20)
    typed = list(sys.argv[1:] if arguments is None else arguments)
    try:
        # a digest may be written as the value of --allow-commands
        given = [re.sub("^--allow-commands=", "--allow-digest=", word) for word in typed]
        with names_in_bounds():
            code = _parser(app)(given, prog_name="study", standalone_mode=False)
    except StudyError as error:
        complain(error)
        if not isinstance(error, StoppedError) or not is_resumable(typed):
            return error.exit_code
        code = INTERRUPTED
    except KeyboardInterrupt:
        code = INTERRUPTED
    except typer.Abort as abort:  # the parser takes the end of any file for a user who left
        raise abort.__cause__ or abort from None
    except BrokenPipeError:
        # the reader has gone (study plan | head): nothing is wrong, and nothing may be printed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if not (hasattr(error, "show") and hasattr(error, "exit_code")):
            raise
        error.show()
        return 2
    if code == INTERRUPTED:  # the parser turns Ctrl-C into this code
        with suppress(OSError):  # a terminal that was closed cannot be written to
            print(interrupted(typed), file=sys.stderr)
    return code if isinstance(code, int) else 0


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt
