"""The types of arrays, by what they hold."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]  # counts, rows, or times in nanoseconds
Mask = NDArray[np.bool_]
