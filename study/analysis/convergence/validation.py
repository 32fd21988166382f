"""Comparison of a simulated with a measured curve: E and its uncertainty (ASME V&V 20-2009)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.arrays import Array
from study.canonical import plain


@dataclass(frozen=True)
class Comparison:
    """E with its parts along a curve; arrays have one entry a displacement, forces in N.

    Parameters
    ----------
    displacement_mm, simulated_N, measured_N, error_N : ndarray, shape (n,)
        Curve and E = S - D.
    u_num_N, u_input_N, u_data_N, u_val_N : ndarray, shape (n,)
        Standard uncertainties; zero where one is not known.
    unknown : tuple of str
        Which of numerics, inputs and data are not known at all.
    """

    displacement_mm: Array
    simulated_N: Array
    measured_N: Array
    error_N: Array
    u_num_N: Array
    u_input_N: Array
    u_data_N: Array
    u_val_N: Array
    unknown: tuple[str, ...] = ()

    @property
    def outside(self) -> float:
        """Part of the curve where |E| exceeds u_val."""
        return float(np.mean(np.abs(self.error_N) > self.u_val_N))

    @property
    def verdict(self) -> str:
        """What the end of the curve says of the model."""
        e, u = float(self.error_N[-1]), float(self.u_val_N[-1])
        if u == 0:
            return "no uncertainty is known, so E cannot be judged"
        lacking = f" ({', '.join(self.unknown)} not known)" if self.unknown else ""
        if abs(e) > u:
            return f"the model is off by E = {e:.3g} N +- {u:.2g} N at the end{lacking}"
        return f"|E| = {abs(e):.2g} N is within u_val = {u:.2g} N at the end{lacking}"

    def to_json(self) -> dict[str, object]:
        """JSON document with the verdict."""
        return {**plain(self), "outside": self.outside, "verdict": self.verdict}


def compare(
    displacement_mm: ArrayLike,
    simulated_N: ArrayLike,  # noqa: N803
    measured_N: ArrayLike,  # noqa: N803
    u_num_N: ArrayLike | None = None,  # noqa: N803
    u_input_N: ArrayLike | None = None,  # noqa: N803
    u_data_N: ArrayLike | None = None,  # noqa: N803
) -> Comparison:
    """E +- u_val along a curve.

    Parameters
    ----------
    displacement_mm : array_like, shape (n,)
        Displacements of both curves.
    simulated_N, measured_N : array_like, shape (n,)
        Forces S and D at these displacements.
    u_num_N, u_input_N, u_data_N : float or array_like, shape (n,), optional
        Standard uncertainties of the numerics, the inputs and the data; None where one is not
        known, which counts as zero and is named.

    Returns
    -------
    Comparison
        E = S - D, and u_val as the root of the sum of the squares of the three.

    Examples
    --------
    >>> found = compare([1.0, 2.0], [1.0, 2.1], [1.0, 2.0], 0.03, 0.0, 0.04)
    >>> found.error_N.round(3).tolist(), found.u_val_N.round(3).tolist(), found.outside
    ([0.0, 0.1], [0.05, 0.05], 0.5)
    """
    d, s, m = (np.atleast_1d(np.asarray(v, float)) for v in (displacement_mm, simulated_N,
                                                            measured_N))  # fmt: skip
    parts = {"numerics": u_num_N, "inputs": u_input_N, "data": u_data_N}
    known = [np.broadcast_to(np.asarray(0.0 if v is None else v, float), d.shape)
             for v in parts.values()]  # fmt: skip
    total = np.sqrt(sum(u**2 for u in known))
    unknown = tuple(name for name, v in parts.items() if v is None)
    return Comparison(d, s, m, s - m, known[0], known[1], known[2], np.asarray(total), unknown)
