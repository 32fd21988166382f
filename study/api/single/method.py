"""How a calibration file wants its constants found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from study.design.load import load_calibration


def is_analytic(source: str | Path, overrides: Sequence[str] = ()) -> bool:
    """Whether a calibration file asks for the closed form of indentations.

    Parameters
    ----------
    source : str or Path
        Calibration file.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.

    Raises
    ------
    InputError
        For a faulty file.
    """
    return load_calibration(source, overrides).asked.method == "analytic"
