"""What compiled loops over elements are handed: arrays that belong together.

Loops take these tuples instead of a dozen arguments each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Narrow = NDArray[np.int32]
#: numbers of elements
Elements = NDArray[np.uint32]


class Shapes(NamedTuple):
    """Elements before anything moves.

    Parameters
    ----------
    gradients : ndarray, shape (n_elements, n_quadrature, n_nodes, dim)
        Reference gradients of the displacement shape functions.
    hoop : ndarray, shape (n_elements, n_quadrature, n_nodes)
        N / R (axisymmetric; anything with as many axes in 3D).
    pressure_shape : ndarray, shape (n_elements or 1, n_quadrature, n_pressure)
        Pressure shape functions.
    weights : ndarray, shape (n_elements, n_quadrature)
        Quadrature weights times volume (2 pi R included in axisymmetric space).
    dofs : ndarray of int32, shape (n_elements, m)
        Unknowns of each element: displacements node by node, then pressures.
    """

    gradients: Array
    hoop: Array
    pressure_shape: Array
    weights: Array
    dofs: Narrow


class Energy(NamedTuple):
    """What a loop knows of the material.

    Parameters
    ----------
    family : int
        ``POLYNOMIAL``, ``OGDEN``, ``OGDEN_BY_EXPONENT`` or ``LINEAR``.
    constants : ndarray, shape (n, k)
        What the family says.
    bulk, compliance : float
        Bulk modulus that acts at every point, and 1 / K of the pressure field (mixed form; 0
        when incompressible).
    evenness : float
        Resistance to uneven volume within an element in N/mm^2, see :mod:`study.forward.swell`.
    """

    family: int
    constants: Array
    bulk: float
    compliance: float
    evenness: float


class Sums(NamedTuple):
    """Where the tangents of the elements are added up.

    Parameters
    ----------
    positions : ndarray of int32, shape (n_elements, m (m + 1) / 2)
        Entry of ``data`` of each packed one; negative where a constrained unknown takes part.
    data : ndarray, shape (n_entries,)
        Sums.
    slots : ndarray of int32, shape (n_elements,)
        Row of ``kept`` of the elements with constrained unknowns, negative for all others.
    kept : ndarray, shape (n_kept, m (m + 1) / 2)
        Packed tangents of those elements.
    """

    positions: Narrow
    data: Array
    slots: Narrow
    kept: Array
