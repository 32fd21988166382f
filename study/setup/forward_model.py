"""The table ``[forward]``: which program predicts the curves of a cell."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from study.errors import Fault
from study.setup.quantity import Duration, shown
from study.setup.section import Bad, Reads, section
from study.setup.text import relative_path, text, word

Kind = Literal["fem", "closed-form", "command", "python"]

#: what a table may hold: a chain of programs is short, and adapters are small
MAX_STEPS = 20
MAX_WORDS = 200
MAX_FILES = 50

#: seconds of one solution by a program that does not say them
USUAL_SECONDS = 1.0


def _argv(value: object) -> tuple[tuple[str, ...], ...]:
    """Read one command, or several that run one after the other; each is a list of words."""
    mend = 'for example argv = [["ccx", "-i", "model"]]'
    if not isinstance(value, list) or not value:
        raise Bad(f"must be a list of words, or of such lists, got {shown(value)}", mend)
    steps = [value] if all(isinstance(one, str) for one in value) else value
    if len(steps) > MAX_STEPS:
        raise Bad(f"has {len(steps)} commands, the limit is {MAX_STEPS}")
    return tuple(_words(step, mend) for step in steps)


def _words(value: object, mend: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
        raise Bad(f"a command must be a list of words, got {shown(value)}", mend)
    if len(value) > MAX_WORDS:
        raise Bad(f"a command has {len(value)} words, the limit is {MAX_WORDS}")
    words = tuple(text(one) for one in value)
    if not words[0]:
        raise Bad("a command has no program", mend)
    return words


def _version(value: object) -> tuple[str, ...]:
    return _words(value, 'for example version = ["ccx", "-v"]')


def _files(value: object) -> tuple[str, ...]:
    items = value if isinstance(value, list) else [value]
    if len(items) > MAX_FILES:
        raise Bad(f"lists {len(items)} files, the limit is {MAX_FILES}")
    found = tuple(dict.fromkeys(relative_path(item) for item in items))
    names = [path.replace("\\", "/").rpartition("/")[2] for path in found]
    if len(set(names)) < len(names):
        raise Bad("names two files alike, which would lie on one another", "rename one of them")
    return found


@section
class ForwardModel:
    """What predicts a curve.

    Parameters
    ----------
    model : {"fem", "closed-form", "command", "python"}
        The built-in finite elements, the closed form of a homogeneous test, programs, or a
        function given to :func:`study.run`.
    argv : tuple of tuple of str
        Commands, run one after the other in a folder of the case; never by a shell.
    files : tuple of str
        Files beside the design that are copied into that folder.
    version : tuple of str
        Command whose first line of output is kept in every record.
    success, failure : str
        Text that the output of one command must hold, and text that none may hold.
    install : str
        What installs the program, for the message where it is missing.
    timeout_s : float, optional
        Wall-clock limit of one solution.
    seconds_s : float
        What one solution takes, for the plan.
    """

    model: Annotated[Kind, word("fem", "closed-form", "command", "python")] = "fem"
    argv: Annotated[tuple[tuple[str, ...], ...], Reads(_argv)] = ()
    files: Annotated[tuple[str, ...], Reads(_files)] = ()
    version: Annotated[tuple[str, ...], Reads(_version)] = ()
    success: Annotated[str, Reads(text)] = ""
    failure: Annotated[str, Reads(text)] = ""
    install: Annotated[str, Reads(text)] = ""
    timeout_s: Duration | None = Field(default=None, validation_alias="timeout")
    seconds_s: Duration = Field(default=USUAL_SECONDS, validation_alias="seconds")

    @property
    def is_external(self) -> bool:
        """Whether something else than this package predicts."""
        return self.model in ("command", "python")

    def fault(self, where: str) -> Fault | None:
        """Say what is missing for its kind."""
        if self.model == "command" and not self.argv:
            mend = 'write argv = [["PROGRAM", "ARGUMENT"]]'
            return Fault(f"{where}.argv", "is missing: model = 'command' runs a program", mend)
        return None
