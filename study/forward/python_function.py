"""A Python function as a forward model: given to ``study.run``, never named in a file."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.canonical import Json
from study.curve import Curve
from study.errors import Fault, InputError
from study.forward import exchange
from study.forward.exchange import Answer, NoAnswer
from study.setup.setup import Problem
from study.working_folder import UserImports

#: problem (see :func:`study.forward.exchange.request`) -> forces in N at its ``displacement_mm``,
#: a curve, or columns such as ``displacement_mm``, ``force_N`` and ``dforce_C10``
Function = Callable[[Mapping[str, Json]], "ArrayLike | Curve | Mapping[str, ArrayLike]"]


@dataclass(frozen=True)
class PythonFunction:
    """A function that goes to worker processes.

    Parameters
    ----------
    text : str
        The function as cloudpickle wrote it, in base 64; it lives in memory alone.
    version : str
        Its identity, part of the name of every result: a source text is none.
    """

    text: str
    version: str

    @classmethod
    def of(cls, function: Function, version: str) -> PythonFunction:
        """Make it of a function.

        Raises
        ------
        InputError
            If the version is empty or the function cannot travel.
        """
        import cloudpickle

        if not version.strip():
            mend = 'give version = "1", and another one whenever the function changes'
            raise InputError(Fault("version", "is missing: it is part of every key", mend))
        try:
            text = base64.b64encode(cloudpickle.dumps(function)).decode("ascii")
        except Exception as error:  # it may hold anything
            mend = "define it in a module, without open files or locks"
            raise InputError(
                Fault("forward", f"cannot go to a worker process: {error}", mend)
            ) from error
        return cls(text, version.strip())

    def solve(self, problem: Problem, displacement_mm: Array) -> Answer:
        """Curve of a problem; whatever the function raises is a case without an answer.

        Raises
        ------
        NoAnswer
            If it raises, or gives no whole curve.
        """
        import cloudpickle

        with UserImports():
            function: Function = cloudpickle.loads(base64.b64decode(self.text))
        try:
            found = function(exchange.request(problem, displacement_mm))
        except Exception as error:  # noqa: BLE001 - a function of the user may raise anything
            raise NoAnswer("failed", f"{type(error).__name__}: {error}") from error
        return exchange.at_points(_columns(found, displacement_mm), displacement_mm, {})


def _columns(
    found: ArrayLike | Curve | Mapping[str, ArrayLike], displacement_mm: Array
) -> dict[str, Array]:
    if isinstance(found, Curve):
        made: Mapping[str, ArrayLike] = {
            exchange.DISPLACEMENT: found.displacement_mm,
            exchange.FORCE: found.force_N,
            **{exchange.GRADIENT + k: v for k, v in found.force_gradient.items()},
        }
    elif isinstance(found, Mapping):
        made = {exchange.DISPLACEMENT: displacement_mm, **found}
    else:
        made = {exchange.DISPLACEMENT: displacement_mm, exchange.FORCE: found}
    columns = {name: np.asarray(values, dtype=float) for name, values in made.items()}
    if exchange.FORCE not in columns:
        raise NoAnswer("failed", f"the function gives no {exchange.FORCE}")
    size = columns[exchange.DISPLACEMENT].shape
    for name, values in columns.items():
        if values.shape != size or values.ndim != 1:
            raise NoAnswer("failed", f"{name} of the function has the shape {values.shape}")
        if not np.all(np.isfinite(values)):
            raise NoAnswer("not-converged", f"{name} of the function is not finite everywhere")
    return columns
