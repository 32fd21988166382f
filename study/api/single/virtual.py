"""Files to start from: virtual measurements, a commented design or calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from study.design.load import load, loads, template
from study.errors import Fault, InputError
from study.record.atomic_files import write_new
from study.runner.virtual.gauge_section import write_tests
from study.runner.virtual.specimens import usual_generator, write_virtual
from study.tracker_accuracy.section import is_tracking, load_tracking
from study.tracker_accuracy.virtual import write_recording


def virtual(
    out: str | Path,
    source: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    truth: str = "yeoh",
    blocks: int | None = None,
) -> list[Path]:
    """Write virtual measurements for a design, the demo's by default; or a tracker's recording.

    Parameters
    ----------
    out : str or Path
        Data root: the files get the names that the design gives them below it.
    source : str or Path, optional
        The design, or a file of ``study tracking``.
    overrides : sequence of str
        ``key=value`` each, laid over the design before it is validated.
    truth : str
        Material behind the specimens: ``yeoh``, ``ogden`` or ``humphrey``.
    blocks : int, optional
        Number of specimens (or batches); 6 by default.

    Returns
    -------
    list of Path
        Files written.

    Raises
    ------
    InputError
        For a faulty file, or options that a tracker's recording does not have.
    """
    from importlib import resources

    if source is not None and is_tracking(source):
        if overrides or blocks is not None:
            mend = "leave -s and --specimens out; a tracker has neither"
            raise InputError(Fault(str(source), "is a file of `study tracking`, no design", mend))
        return write_recording(load_tracking(source), Path(out))
    if source is None:
        text = resources.files("study.runner").joinpath("demo.toml").read_text(encoding="utf-8")
        design = loads(text, "demo.toml", overrides)
    else:
        design = load(source, overrides)
    return write_virtual(
        design, Path(out), usual_generator(design, truth_name=truth, blocks=blocks)
    )


def new_file(file: str | Path, *, calibration: bool = False) -> list[Path]:
    """Write a commented file to start from.

    Parameters
    ----------
    file : str or Path
        Its name; nothing is overwritten.
    calibration : bool
        Whether it is a calibration, with virtual measurements in ``tests-of-material/`` beside
        it, instead of a design.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    FileExistsError
        If one of the files exists.
    """
    path = Path(file)
    write_new(path, template("calibration" if calibration else "template"))
    return [path, *(write_tests(path.parent / "tests-of-material") if calibration else ())]
