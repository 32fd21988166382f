"""How a calibration file wants its constants found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from study.design.load import load_calibration


def is_analytic(source: str | Path, overrides: Sequence[str] = ()) -> bool:
    """Whether a calibration file asks for the closed form of indentations.

    Raises
    ------
    InputError
        For a faulty file.
    """
    return load_calibration(source, overrides).asked.method == "analytic"
