"""Array types, named once: what an array holds; its shape stands in the docstring of its user."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
#: indices of unknowns in compiled loops: half the memory traffic of int64
Unknowns = NDArray[np.int32]
#: numbers of elements
Elements = NDArray[np.uint32]
