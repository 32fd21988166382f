"""Types of arrays by what they hold, values by their keys, linear algebra on one thread."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from functools import wraps
from typing import ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
#: indices of unknowns in compiled loops: half the memory traffic of int64
Unknowns = NDArray[np.int32]
#: numbers of elements
Elements = NDArray[np.uint32]

P = ParamSpec("P")
R = TypeVar("R")
K = TypeVar("K", bound=Hashable)


def gathered(pairs: Iterable[tuple[K, R]]) -> dict[K, list[R]]:
    """Values of each key, in the order in which they come."""
    groups: dict[K, list[R]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


def chunks(count: int, most: float) -> Iterator[int]:
    """Sizes of the pieces in which so many are drawn: ``most`` at a time, and at least one."""
    step = max(1, int(most))
    return (min(step, count - start) for start in range(0, count, step))


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run ``function`` with one linear-algebra thread.

    On a busy machine the threads of a small product wait for each other (15 s instead of
    0.5 s for 10,000 rows), and the last digits of a sum would depend on their number.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1):
            return function(*args, **kwargs)

    return limited
