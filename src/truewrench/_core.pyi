"""
Numerical core of truewrench (C++20). The public face is the truewrench package.
"""

from typing import Annotated

import numpy
from numpy.typing import NDArray


class Payload:
    """
    A rigid payload: mass [kg], centre of mass [m] and inertia about it [kg m^2], sensor axes.
    """

    def __init__(self) -> None: ...

    @property
    def mass(self) -> float: ...

    @mass.setter
    def mass(self, arg: float, /) -> None: ...

    @property
    def center_of_mass(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]: ...

    @center_of_mass.setter
    def center_of_mass(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], /) -> None: ...

    @property
    def inertia(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')]: ...

    @inertia.setter
    def inertia(self, arg: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], /) -> None: ...

variant: str
"""Which variant is loaded: baseline or avx2."""
