"""Whether links of an arm touch each other, as far as its URDF says what they look like."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from truewrench.model.arrays import Array, Mask
from truewrench.model.rig.urdf import model_of
from truewrench.robot.arm import Robot


@dataclass(frozen=True, eq=False)
class Collisions:
    """The collision geometry of an arm."""

    model: Any  # that of the arm
    geometry: Any  # a `pinocchio.GeometryModel` with the pairs that are looked at
    missing: tuple[str, ...]  # meshes that were not found, and are not looked at

    @property
    def pairs(self) -> int:
        """How many pairs of bodies are looked at."""
        return len(self.geometry.collisionPairs)

    def touch(self, q: Array) -> Mask:
        """Whether any two bodies touch, in each of N positions (N, n) of the joints."""
        import pinocchio as pin

        out = np.zeros(len(q), dtype=bool)
        if not self.pairs:
            return out
        data, shapes = self.model.createData(), self.geometry.createData()
        for k, position in enumerate(np.ascontiguousarray(q)):
            out[k] = pin.computeCollisions(self.model, data, self.geometry, shapes, position, True)
        return out


def collisions_of(urdf: str | Path, robot: Robot, home: Array) -> Collisions | None:
    """The geometry that a URDF states for collisions, None where it states none that can be read.

    Bodies on one link, or on links that one joint connects, may touch; so may what touches at `home` (n,), a
    posture that the arm has had.
    """
    import pinocchio as pin

    text, missing, count = _with_collisions(Path(urdf))
    if not count:
        return None
    whole = model_of(urdf)
    geometry = pin.buildGeomFromUrdfString(whole, text, pin.GeometryType.COLLISION)
    locked = [k for k in range(1, whole.njoints) if whole.names[k] not in robot.joints]
    model, geometry = pin.buildReducedModel(whole, geometry, locked, pin.neutral(whole))
    geometry.addAllCollisionPairs()
    bodies, parents = geometry.geometryObjects, model.parents
    for pair in list(geometry.collisionPairs):
        a, b = (bodies[k].parentJoint for k in (pair.first, pair.second))
        if a == b or parents[a] == b or parents[b] == a:
            geometry.removeCollisionPair(pair)
    data, shapes = model.createData(), geometry.createData()
    pin.computeCollisions(model, data, geometry, shapes, np.asarray(home, dtype=np.float64), False)
    touching = [result.isCollision() for result in shapes.collisionResults]
    for pair, touches in zip(list(geometry.collisionPairs), touching, strict=True):
        if touches:
            geometry.removeCollisionPair(pair)
    return Collisions(model, geometry, missing)


def _with_collisions(path: Path) -> tuple[str, tuple[str, ...], int]:
    """The URDF without what only looks and without meshes that are not there, and how many bodies it has."""
    robot, missing, count = ElementTree.fromstring(path.read_bytes()), [], 0
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for body in link.findall("collision"):
            mesh = body.find("geometry/mesh")
            if mesh is not None:
                name = mesh.get("filename", "")
                found = path.parent / name.removeprefix("file://")
                if "package://" in name or not found.is_file():
                    missing.append(name)
                    link.remove(body)
                    continue
                mesh.set("filename", str(found.resolve()))
            count += 1
    return ElementTree.tostring(robot, encoding="unicode"), tuple(missing), count
