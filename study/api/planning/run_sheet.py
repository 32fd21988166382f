"""A run sheet for physical trials: every specimen under every condition, in random order.

Order is drawn anew for each specimen, so that drift of the machine, the room or the operator is
spread over the conditions instead of being taken for one of them (randomized complete blocks;
Fisher 1935, The Design of Experiments).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.design.load import load
from study.design.spec import Design, Factor
from study.errors import Fault, InputError
from study.record.table import write_csv

if TYPE_CHECKING:
    import pandas as pd

#: tables whose keys choose a simulation: nothing changes in the laboratory
SIMULATED = ("model", "material", "forward", "calibration", "measurements")


def run_sheet(
    design: Design | str | Path, specimens: int, *, path: str | Path | None = None
) -> pd.DataFrame:
    """Draw the order of physical trials.

    Parameters
    ----------
    design : Design, str or Path
        Its factors that change something in the laboratory make the conditions; combinations
        that it excludes are left out.
    specimens : int
        Specimens, each measured once under every condition.
    path : str or Path, optional
        CSV to write; it is refused where it exists.

    Returns
    -------
    DataFrame
        One row a trial: ``run`` (from 1, in the order of work), ``specimen``, the factors, and
        empty columns for what is written down.

    Raises
    ------
    InputError
        Where no factor changes anything in the laboratory, or the file exists.
    """
    import pandas as pd

    loaded = design if isinstance(design, Design) else load(design)
    if specimens < 1:
        raise InputError(Fault("specimens", f"must be at least 1, got {specimens}"))
    physical = [factor.name for factor in loaded.factors if _is_physical(factor)]
    if not physical:
        rule = "no factor changes anything in the laboratory, so there is nothing to randomize"
        raise InputError(
            Fault("factors", rule, "a run sheet is for factors such as test.interface")
        )
    levels = [{name: one.levels[name] for name in physical} for one in loaded.treatments]
    conditions = list({tuple(one.items()): one for one in levels}.values())
    random = np.random.default_rng(loaded.seed)
    rows = [
        {"specimen": k + 1, **conditions[i]}
        for k in range(specimens)
        for i in random.permutation(len(conditions))
    ]
    sheet = pd.DataFrame(rows)
    sheet.insert(0, "run", range(1, len(rows) + 1))
    sheet = sheet.assign(date="", file="", remarks="")
    if path is not None:
        if Path(path).exists():
            raise InputError(Fault(str(path), "exists; a sheet that is in use is not overwritten"))
        write_csv(sheet, Path(path))
    return sheet


def _is_physical(factor: Factor) -> bool:
    return any(key.partition(".")[0] not in SIMULATED for key in factor.keys)
