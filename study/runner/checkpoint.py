"""Accepted iterations of a fit on the disk, so that an interrupted one goes on where it was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from study.record.files import write_atomic

if TYPE_CHECKING:
    from study.calibration import Iteration


class Checkpoint:
    """Last accepted iteration of every stage of one fit.

    Parameters
    ----------
    path : Path, optional
        Its file; nothing is kept without one.
    key : str
        Name of the fit, made of its content: a file of another fit is not read.
    """

    def __init__(self, path: Path | None = None, key: str = "") -> None:
        self.path, self.key = path, key
        self.stages: dict[str, dict[str, Any]] = {} if path is None else _read(path, key)

    def last(self, stage: str) -> Iteration | None:
        """Last accepted iteration of a stage; None where it has not begun."""
        from study.calibration import Iteration

        kept = self.stages.get(stage)
        if kept is None:
            return None
        arrays = {name: np.array(kept[name], float) for name in ("x", "scale")}
        return Iteration(**{**kept, **arrays})

    def keep(self, stage: str, iteration: Iteration) -> None:
        """Keep an accepted iteration."""
        if self.path is None:
            return
        content = vars(iteration)
        arrays = {name: content[name].tolist() for name in ("x", "scale")}
        self.stages[stage] = {**content, **arrays}
        text = json.dumps({"key": self.key, "stages": self.stages}, indent=1, allow_nan=False)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path, text.encode())

    def clear(self) -> None:
        """Forget everything: the fit is finished."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
        self.stages = {}


def _read(path: Path, key: str) -> dict[str, dict[str, Any]]:
    """Stages of a file; none where it is of another fit, or damaged: the fit then starts anew."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        stages: dict[str, dict[str, Any]] = content["stages"] if content["key"] == key else {}
        wanted = {"iteration", "evaluations", "x", "cost", "radius", "damping", "offset", "scale"}
        return {name: kept for name, kept in stages.items() if set(kept) == wanted}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
