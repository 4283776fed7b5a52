"""What is known of gain and bodies, in coordinates in which data of one body hardly bend.

Of a body in gravity the channels show m C T(c), whose weight is felt: T takes a wrench at the centre of mass
to the sensor's origin. In this product what they tell is nearly normal, where gain and body by themselves
follow a curve within what each of them leaves uncertain. So one body's product stands in place of the gain,
and is taken apart only at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from truewrench import _core
from truewrench.estimation.assumptions import assumed_gain_prior
from truewrench.estimation.joint import EXACT, Joint, body_part
from truewrench.estimation.static_poses import Poses
from truewrench.model.arrays import Array, Integers
from truewrench.model.rig import Rig
from truewrench.tool.bodies import total_body
from truewrench.tool.model_rows import MotionInformation, Problem, about_center
from truewrench.tool.parameters import Layout, second_moments, symmetric
from truewrench.tool.prior import S_STD, Prior
from truewrench.tool.solve import Solution

_WIDE = 1e3  # sigma of the rig's prior, where the joint distribution holds it: tolerance, 1e-6 of a variance


@dataclass(frozen=True, slots=True, eq=False)
class PosesOfOne(Problem):
    """Poses of one payload, perhaps beside the reference body, which none of them carries.

    The vector x ends in the ten of the reference body where it is another than that of the poses.
    """

    def total(self, x: Array) -> tuple[Array, Array]:
        """The body that the sensor carries as (log m, c, inertia) (10,), and its derivative (10, p)."""
        v = self.vector
        at = np.arange(v.layout.body.start, v.layout.body.stop)
        body, jacobian = total_body(x[at].reshape(1, 10))
        out = np.zeros((10, v.size))
        out[:, at] = jacobian
        return body, out

    def of_motion(self, x: Array) -> tuple[Array, Array]:
        """Product, reference body, tilt, and the body of the poses where it is another; derivative (y, p)."""
        v, n = self.vector, self.vector.n
        reference = v.before if v.on else v.layout.body
        at = np.r_[v.layout.gain, reference]
        y, jacobian = about_center(x[at], n)
        own = np.r_[v.layout.body][: 4 * v.on]
        rest = np.r_[np.r_[v.layout.tilt], own]
        D = np.zeros((6 * n + 4 + rest.size, v.size))
        D[: 6 * n + 4, at] = jacobian[: 6 * n + 4]
        D[6 * n + 4 + np.arange(rest.size), rest] = 1.0
        return np.append(y[: 6 * n + 4], x[rest]), D

    @property
    def normal_in_product(self) -> bool:
        """What is known of a reference body is."""
        return self.motion is not None

    def changes(self, x: Array, std: Array) -> Array:
        """Of the wrench as the product tells it: C w = K M_reference^-1 w."""
        out = Problem.changes(self, x, std)
        if self.motion is None:
            return out
        if not self.vector.on:
            return np.zeros_like(out)
        before = self.vector.before
        body, by_x = total_body(x[before].reshape(1, 10))
        L = _core.body_changes(_core.Payload(float(np.exp(body[0])), body[1:4], symmetric(body[4:])))
        out[before] = -np.einsum("kp,kab->pab", by_x, L)
        out[before][4:] = 0.0  # the product holds mass and centre of mass
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known so far."""

    # `gain` as the rig states it and `tilt`, or, once there is a reference body, `product` in place of the
    # gain, with what else was found
    joint: Joint
    reference: str | None = None  # name of that payload

    @staticmethod
    def stated(rig: Rig) -> Known:
        """Gain and gravity's tilt, which all payloads share, as the rig has them."""
        sensor = rig.sensor
        std = np.append(_stated_std(rig), [_tilt_std(rig)] * 2)
        parts = {"gain": sensor.nominal_gain_array.ravel(), "tilt": np.zeros(2)}
        return Known(Joint.of_parts(parts, np.diag(std**2)))

    @staticmethod
    def of_motion(rig: Rig, joint: Joint, reference: str, *, one_root: bool) -> Known:
        """`Estimate.joint`, about a payload that moved; `one_root`: poses share the root frame of motion."""
        spec, body, n = rig.payloads[reference], body_part(reference), rig.sensor.n
        if body not in joint.places:  # exact
            mean = np.append(np.log(spec.mass), spec.center_of_mass_array)
            joint = joint.told([], mean, EXACT**2 * np.eye(4), {body: 4})
        if one_root:
            places = {"tilt" if name == "tilt 0" else name: place for name, place in joint.places.items()}
            joint = replace(joint, places=places)
        else:
            joint = joint.told([], np.zeros(2), _tilt_std(rig) ** 2 * np.eye(2), {"tilt": 2})
        at = joint.at(["gain", body])
        product, J = _product(joint.mean[at], n)
        return Known(_mapped(joint, "gain", "product", at, product, J), reference)

    def problem(self, rig: Rig, name: str, poses: Poses, end_ns: Sequence[int]) -> tuple[Problem, Array]:
        """Poses of a payload with what is known before them, and where its search may begin."""
        layout = Layout(rig.sensor.n)
        beside = self.reference not in (None, name)
        mean, std = _stated(rig, name)
        joint, parts = self.joint, self._parts(name)
        held = [part for part in parts if part in joint.places]
        if self.reference is None:
            prior = Prior(mean, np.diag(np.maximum(std, EXACT) ** 2), assumed_gain_prior(rig), {})
            problem: Problem = PosesOfOne(rig, prior, poses, end_ns)
            return problem, problem.prior_of_all()[0]
        wide = [layout.gain, layout.tilt]
        if body_part(name) in held:
            wide.append(layout.body)
        for place in wide:
            std[place] = _WIDE * np.maximum(std[place], EXACT)
        product, body = joint.of(["product"])[0], joint.of([body_part(self.reference)])[0]
        mean[layout.gain] = _gain(product, body)
        mean[layout.tilt] = joint.of(["tilt"])[0]
        if body_part(name) in held:
            mean[layout.body][:4] = joint.of([body_part(name)])[0]
        if beside:
            its_mean, its_std = _stated(rig, self.reference)
            its_mean[layout.body][:4] = body
            mean = np.append(mean, its_mean[layout.body])
            std = np.append(std, _WIDE * np.maximum(its_std[layout.body], EXACT))
        at, P = joint.of(held)
        scale = np.sqrt(np.diag(P))
        size = sum(joint.places[part].stop - joint.places[part].start for part in held) + 4 * (
            len(parts) - len(held)
        )
        information = np.zeros((size, size))
        information[: at.size, : at.size] = np.linalg.inv(P / np.outer(scale, scale)) / np.outer(scale, scale)
        told = MotionInformation(np.append(at, np.zeros(size - at.size)), information, np.zeros(size))
        prior = Prior(mean, np.diag(np.maximum(std, EXACT) ** 2), assumed_gain_prior(rig), {}, on=beside)
        problem = PosesOfOne(rig, prior, poses, end_ns, motion=told)
        return problem, problem.prior_of_all()[0]

    def _parts(self, name: str) -> list[str]:
        reference = self.reference or name
        parts = ["product", body_part(reference), "tilt"]
        return parts if reference == name else [*parts, body_part(name)]

    def told(self, name: str, found: Solution, offsets: Sequence[str]) -> Known:
        """The same after the poses of a payload, with the offsets of its logs."""
        v = found.problem.vector
        y, D = found.problem.of_motion(found.x)
        places = [np.r_[v.offset(j)] for j in range(len(offsets))]
        unit = np.eye(v.size)[np.concatenate(places)]
        mean, rows = np.append(y, unit @ found.x), np.vstack([D, unit])
        P = rows @ found.covariance @ rows.T
        parts = self._parts(name)
        sizes = dict.fromkeys(parts, 4) | {"product": 6 * v.n, "tilt": 2} | dict.fromkeys(offsets, v.n)
        if self.reference is None:
            ends = np.cumsum(list(sizes.values()))
            means = dict(zip(sizes, np.split(mean, ends[:-1]), strict=True))
            return Known(Joint.of_parts(means, P), name)
        held = [part for part in parts if part in self.joint.places]
        new = {part: size for part, size in sizes.items() if part not in held}
        return Known(self.joint.told(held, mean, P, new), self.reference)

    def plain(self, rig: Rig) -> Joint:
        """With the gain itself, and in its covariance what bends within that of the product."""
        if self.reference is None:
            return self.joint
        n, body = rig.sensor.n, body_part(self.reference)
        at = self.joint.at(["product", body])
        own, P_body = self.joint.of([body])
        gain = _gain(self.joint.of(["product"])[0], own)
        _, J = _product(np.append(gain, own), n)
        out = _mapped(self.joint, "product", "gain", at, gain, np.asarray(np.linalg.inv(J), np.float64))
        place = out.places["gain"]
        out.covariance[place, place] += _core.bend(
            out.covariance[place, place], P_body[1:, 1:], _stated_std(rig) ** 2
        )
        return out


def _product(gain_and_body: Array, n: int) -> tuple[Array, Array]:
    """M C T(c) (6n,) of gain, log m and c, and the derivative of the product and these by gain and these."""
    y, J = about_center(np.append(gain_and_body, np.zeros(6)), n)
    return y[: 6 * n], J[: 6 * n + 4, : 6 * n + 4]


def _gain(product: Array, body: Array) -> Array:
    """C (6n,) of m C T(c)."""
    n = product.size // 6
    unit, _ = _product(np.concatenate([np.eye(6).ravel(), body]), 6)
    return np.asarray(np.linalg.solve(unit.reshape(6, 6).T, product.reshape(n, 6).T).T.ravel())


def _mapped(joint: Joint, old: str, new: str, at: Integers, value: Array, J: Array) -> Joint:
    """One part in other coordinates: J by the parts that stand at `at`, of which it is the first."""
    M = np.eye(joint.mean.size)
    M[np.ix_(at[: value.size], at)] = J[: value.size]
    mean = joint.mean.copy()
    mean[at[: value.size]] = value
    places = {new if name == old else name: place for name, place in joint.places.items()}
    P = M @ joint.covariance @ M.T
    return Joint(places, mean, 0.5 * (P + P.T))


def _stated_std(rig: Rig) -> Array:
    """(6n,) 1 sigma of the gains [raw units, SI]."""
    units = rig.sensor.gain_unit.ravel()
    return np.asarray(assumed_gain_prior(rig) * units)


def _tilt_std(rig: Rig) -> float:
    """1 sigma of gravity's direction about two axes [rad]."""
    return max(rig.gravity_tilt_prior, EXACT)


def _stated(rig: Rig, name: str) -> tuple[Array, Array]:
    """Mean and 1 sigma of all parameters with a payload, as the rig has them."""
    layout, spec = Layout(rig.sensor.n), rig.payloads[name]
    mean, std = np.zeros(layout.size), np.zeros(layout.size)
    mean[layout.gain], std[layout.gain] = rig.sensor.nominal_gain_array.ravel(), _stated_std(rig)
    mean[layout.log_mass], std[layout.log_mass] = np.log(spec.mass), spec.uncertainty.mass
    mean[layout.center_of_mass], std[layout.center_of_mass] = (
        spec.center_of_mass,
        spec.uncertainty.center_of_mass,
    )
    i = spec.inertia
    mean[layout.S] = second_moments(spec.mass, np.array([i.xx, i.yy, i.zz, i.xy, i.xz, i.yz]))
    std[layout.S] = S_STD  # nothing of it is felt at rest
    std[layout.offset] = rig.sensor.offset_prior_array
    std[layout.tilt] = rig.gravity_tilt_prior
    return mean, std
