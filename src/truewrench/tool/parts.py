"""What a tool is made of besides its numbers: its body, the verdict on it, what held-out poses say."""

from dataclasses import asdict, dataclass
from typing import Any

from truewrench.model.arrays import Array
from truewrench.tool.parameters import symmetric


@dataclass(frozen=True, slots=True)
class Unknown:
    """What the data did not determine."""

    direction: str  # which quantity: `mass`, `inertia`, `center_of_mass`, `mounting`, `offset`, `gain`
    words: str  # the same for a person


@dataclass(frozen=True, slots=True)
class ToolVerdict:
    """Whether a tool may be used as it stands.

    Attributes:
        usable: mass and centre of mass are determined, and no test of the set-up fails.
        reasons: every one why not.
        undetermined: what the data did not tell, which alone refuses nothing.
        needed: what to do next.
    """

    usable: bool
    reasons: tuple[str, ...] = ()
    undetermined: tuple[Unknown, ...] = ()
    needed: tuple[str, ...] = ()

    def to_mapping(self) -> dict[str, Any]:
        """As `tool.yaml` has it."""
        return {key: list(x) if isinstance(x, tuple) else x for key, x in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class HeldOut:
    """RMS of the norms of what is left in poses that the fit did not see [N, N m]; None: nothing held out.

    Attributes:
        force: of this estimate.
        moment: likewise.
        recipe_force: of ten linear parameters beside an exact gain and a fixed offset.
        recipe_moment: likewise.
    """

    force: float | None = None
    moment: float | None = None
    recipe_force: float | None = None
    recipe_moment: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A rigid body in sensor axes.

    Attributes:
        mass: [kg].
        center_of_mass: (3,) seen from the sensor's origin [m].
        inertia: (6,) elements about the centre of mass, in the order of `ELEMENTS` [kg m^2].
        inertia_assumed: whether the inertia is none that was determined, but that of a sphere.
    """

    mass: float
    center_of_mass: Array
    inertia: Array
    inertia_assumed: bool = False

    @property
    def inertia_matrix(self) -> Array:
        """(3, 3) about the centre of mass [kg m^2]."""
        return symmetric(self.inertia)
