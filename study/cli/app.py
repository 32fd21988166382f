"""The program ``study``: its verbs, its exit codes, its errors in words."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Annotated

import typer

from study.cli import (
    accuracy,
    haptics,
    new_files,
    power,
    serve,
    single,
    statistics,
    studies,
    verification,
)
from study.cli.next_command import interrupted, is_resumable
from study.cli.output import complain
from study.errors import DiskFullError, StudyError
from study.working_folder import leave

INTERRUPTED = 130
#: a polite kill and a terminal that is closed end as Ctrl-C does
POLITE = (signal.SIGTERM, signal.SIGHUP)
app = typer.Typer(
    name="study",
    epilog="Exit codes: 0 done, 1 some cases failed or disk full, 2 bad input, 3 refused, "
    "130 interrupted.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _say_version(asked: bool) -> None:
    """Print the version and leave."""
    if asked:
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


VERBS: tuple[Callable[..., None], ...] = (
    *studies.VERBS,
    *verification.VERBS,
    power.power,
    serve.serve,
    *statistics.VERBS,
    *new_files.VERBS,
    *single.VERBS,
    *haptics.VERBS,
    *accuracy.VERBS,
)
for verb in VERBS:
    app.command()(verb)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program and exit with its code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words behind ``study``; by default those of the command line.
    """
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

    Parameters
    ----------
    arguments : sequence of str, optional
        Words behind ``study``; by default those of the command line.

    Returns
    -------
    int
        0 done, 1 some cases failed or the disk is full, 2 bad input, 3 refused, 130 interrupted.
    """
    # by default cycles are looked for at every 700 new objects: a tenth of the time of a resume
    gc.set_threshold(50_000, 20, 20)
    typed = list(sys.argv[1:] if arguments is None else arguments)
    try:
        words = None if arguments is None else list(arguments)
        code = app(words, prog_name="study", standalone_mode=False)
    except StudyError as error:
        complain(error)
        if not isinstance(error, DiskFullError) or not is_resumable(typed):
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
        if not _is_usage(error):
            raise
        error.show()  # type: ignore[attr-defined]
        return 2
    if code == INTERRUPTED:  # the parser turns Ctrl-C into this code
        with suppress(OSError):  # a terminal that was closed cannot be written to
            print(interrupted(typed), file=sys.stderr)
    return code if isinstance(code, int) else 0


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _is_usage(error: Exception) -> bool:
    """Whether the parser complains: it knows how to show itself and which code it has."""
    return hasattr(error, "show") and hasattr(error, "exit_code")
