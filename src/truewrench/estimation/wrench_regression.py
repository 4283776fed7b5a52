"""Weighted total least squares on wrenches known from elsewhere, over errors of a given structure.

Raw channels and reference wrench are both noisy, `raw = C w + b + e` and `ref = w + d`, and every row has a
wrench w of its own. Row by row the likelihood is largest at (docs/method.md, M20)

    w_k = ref_k + G v_k,    v_k = raw_k - C ref_k - b,    G = D C^T S^-1,    S = R + C D C^T

with R and D the covariances of e and d. At the truth v_k ~ N(0, S) is independent of that w_k, whose error
has the covariance Q = D - G C D. So regressing with w_k is unbiased where regressing with ref_k is not.
Errors that last (METHOD 10.5) are taken to do so on both sides in the proportion of the stated noise, which
leaves G as it is and gives v_i the covariance S_ii T_i along time; how unsure that proportion is, the
covariance of the estimate contains.

What the rows say of a direction of w in which they vary little more than by Q is mostly noise, though: the
regressor is w_k times the share of its scatter that is not noise, and the covariance of the estimate follows
from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import dct, idct

from truewrench.estimation.lasting_errors import Chain, ErrorSize, whitened
from truewrench.model.arrays import Array, Mask

_CHANCE = 1e-3  # probability that noise alone is taken for a direction in which the wrench varies
_BAND = 24  # waves of the lowest band; the others are each as wide as all below it; tolerance
_ITERATIONS = 100
_STEP = 1e-5  # of sigma, at which the iterations end; tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All rows of all logs in normalised units: channels over their scale, wrenches over their range."""

    raw: Array  # (N, n)
    reference: Array  # (N, 6)
    columns: Array  # (N, m) one per offset, then temperature: what multiplies the other parameters
    raw_noise: Array  # (n, n) R
    reference_noise: Array  # (6, 6) D
    mean: Array  # (n, p) prior of [C, offsets, slope], p = 6 + m
    std: Array  # (n, p), 0 where a parameter does not exist

    @property
    def exists(self) -> Mask:
        """(n p,)."""
        return np.asarray(self.std.ravel() > 0.0)

    @property
    def prior(self) -> Array:
        """(n p,) information, 1 for what does not exist."""
        return np.asarray(np.where(self.exists, self.std.ravel(), 1.0) ** -2.0)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Rows whose errors have one structure, averaged where they belong together."""

    raw: Array  # (M, n) means of rows
    reference: Array  # (M, 6) likewise
    columns: Array  # (M, m) likewise
    chain: Chain  # of the M means
    sizes: tuple[ErrorSize, ...]  # of the errors of each channel, over the stated variance

    @property
    def as_stated(self) -> bool:
        """Whether the errors are white and of the stated size."""
        return all(size == ErrorSize() for size in self.sizes)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What the parts say, normalised."""

    parameters: Array  # (n, p)
    covariance: Array  # (n p, n p) of them, row by row
    noise: Array  # (n, n) S
    designs: tuple[Array, ...]  # per part (M, p): the regressors
    residuals: tuple[Array, ...]  # per part (M, n): v
    followed: Array  # (p, p) covariance of what the parameters follow, over a row's stated variance
    fitted: Array  # (n,) degrees of freedom that the parameters take
    converged: bool  # whether the iterations ended below their tolerance
    iterations: int  # how many


def solve(problem: Problem, parts: Sequence[Part]) -> Solution:
    """Iterate residual noise, regressors and parameters, each given the others.

    Errors of the channels are correlated as R + C D C^T says where all is as stated. Of what was found
    beyond this nobody knows how channels go together: each is weighted by itself then, and the covariance
    between two follows from the correlation of what is left of them.
    """
    R, D = problem.raw_noise, problem.reference_noise
    n, p = problem.mean.shape
    exists, prior = problem.exists, problem.prior
    as_stated = all(part.as_stated for part in parts)
    parameters = problem.mean.copy()
    covariance = np.diag(problem.std.ravel() ** 2)
    converged, iteration = False, 0
    while not converged and iteration < _ITERATIONS:
        C = parameters[:, :6]
        S = noise = R + C @ D @ C.T
        residuals = [part.raw - np.hstack([part.reference, part.columns]) @ parameters.T for part in parts]
        # to begin with, as if the reference were exact
        designs = [np.hstack([part.reference, part.columns]) for part in parts]
        places = float(sum(len(part.raw) for part in parts))
        if iteration > 0:
            G = np.linalg.solve(S, C @ D).T
            Q = np.linalg.inv(np.linalg.inv(D) + C.T @ np.linalg.solve(R, C))  # D - G C D
            # errors of the regressor, times what is not known of the gain
            noise = S + np.einsum("iajb,ab->ij", covariance.reshape(n, p, n, p)[:, :6, :, :6], Q)
            of_reference = np.linalg.solve(C.T @ np.linalg.solve(R, C), C.T @ np.linalg.inv(R))
            moved = [
                np.zeros((len(v), 6)) if part.as_stated else v @ of_reference.T
                for part, v in zip(parts, residuals, strict=True)
            ]
            for part, Z, v, other in zip(parts, designs, residuals, moved, strict=True):
                Z[:, :6] += v @ G.T
                if not part.as_stated:
                    places += _in_bands(part, Z, other, v / np.sqrt(np.diag(S)), Q) - len(Z)
        sums = _sums(parts, designs, residuals)
        shaped = _without_noise(sums.mean, Q, places) if iteration > 0 else np.eye(p)
        products = shaped.T @ sums.products @ shaped
        inverse = np.linalg.inv(noise) if as_stated else np.diag(1.0 / np.diag(noise))
        weight = np.einsum("ij,ijab->iajb", inverse, products).reshape(n * p, n * p)
        pull = np.einsum("ij,ijb->ib", inverse, sums.pulls @ shaped)
        gradient = pull.ravel() + prior * (problem.mean - parameters).ravel()
        inner = np.linalg.inv((weight + np.diag(prior))[np.ix_(exists, exists)])
        covariance[np.ix_(exists, exists)] = 0.5 * (inner + inner.T)
        step = np.zeros(n * p)
        step[exists] = inner @ gradient[exists]
        parameters = parameters + step.reshape(n, p)
        if not np.all(np.diag(inner) > 0.0):
            raise np.linalg.LinAlgError("a variance below zero")
        sigma = np.sqrt(np.diag(inner))
        converged = iteration > 0 and bool(np.all(np.abs(step[exists]) <= _STEP * sigma))
        iteration += 1
    C = parameters[:, :6]
    fitted = (covariance @ weight).diagonal().reshape(n, p).sum(axis=1)
    if not as_stated:
        # whose the errors are, nobody knows: the reference has a share of them, of which the stated noise
        # gives the mean, with a Beta distribution that is the uniform one where this is a half
        share = float(np.mean(1.0 - np.diag(R) / np.diag(S)))
        shift = np.zeros((n, p))
        pulls = _sums(parts, [other @ shaped[:6, :6] for other in moved], residuals).pulls
        shift[:, :6] = pulls[range(n), range(n)] / np.diag(noise)[:, None]
        shifted = np.sqrt(share * (1.0 - share) / 3.0) * covariance @ shift.ravel()
        scatter = sums.squares / np.sqrt(np.outer(np.diag(sums.squares), np.diag(sums.squares)))
        scatter /= np.sqrt(np.outer(np.diag(noise), np.diag(noise)))
        np.fill_diagonal(scatter, np.diag(inverse))
        varies = np.einsum("ij,ijab->iajb", scatter, products).reshape(n * p, n * p) + np.diag(prior)
        covariance = np.asarray(covariance @ varies @ covariance + np.outer(shifted, shifted), np.float64)
    followed = np.asarray(np.linalg.pinv(shaped.T @ sums.mean @ shaped, hermitian=True))
    return Solution(
        parameters,
        covariance,
        R + C @ D @ C.T,
        tuple(Z @ shaped for Z in designs),
        tuple(part.raw - np.hstack([part.reference, part.columns]) @ parameters.T for part in parts),
        followed,
        fitted,
        converged,
        iteration,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Over all places of all parts, whitened: E_i of the regressors for channel i, and its residual."""

    products: Array  # (n, n, p, p) E_i^T E_j
    pulls: Array  # (n, n, p) E_i^T of the residual of j
    squares: Array  # (n, n) of the residuals
    mean: Array  # (p, p) E_i^T E_i, averaged over the channels


def _sums(parts: Sequence[Part], designs: Sequence[Array], residuals: Sequence[Array]) -> _Sums:
    n, p = residuals[0].shape[1], designs[0].shape[1]
    products, pulls, squares = np.zeros((n, n, p, p)), np.zeros((n, n, p)), np.zeros((n, n))
    for part, Z, v in zip(parts, designs, residuals, strict=True):
        kinds = list(dict.fromkeys(part.sizes))  # channels of one size are whitened together
        of = [np.array([k for k, size in enumerate(part.sizes) if size == kind]) for kind in kinds]
        white = [
            whitened(part.chain, kind, np.hstack([Z, v[:, own]]))[0]
            for kind, own in zip(kinds, of, strict=True)
        ]
        for E, rows in zip(white, of, strict=True):
            for F, columns in zip(white, of, strict=True):
                both = E.T @ F
                products[np.ix_(rows, columns)] += both[:p, :p]
                pulls[np.ix_(rows, columns)] += both[:p, p:].T
                squares[np.ix_(rows, columns)] += both[p:, p:]
    return _Sums(products, pulls, squares, np.mean([products[i, i] for i in range(n)], axis=0))


def _without_noise(products: Array, noise: Array, places: float) -> Array:
    """(p, p) what makes regressors of [w, columns]: the scatter of w reduced to the share that is not noise.

    Whitened errors of w have, place by place, the covariance `noise` (6, 6), Q of a row, whatever they last;
    `products` (p, p) of the whitened [w, columns] were summed over the places.
    """
    shaped = np.eye(len(products))
    mean = np.linalg.lstsq(products[6:, 6:], products[6:, :6])[0]  # (m, 6) of w on the columns
    scatter = products[:6, :6] - products[:6, 6:] @ mean
    kept = _share(scatter, noise, places - (len(products) - 6))
    shaped[:6, :6] = kept.T
    shaped[6:, :6] = mean @ (np.eye(6) - kept.T)
    return shaped


def _share(scatter: Array, noise: Array, freedom: float) -> Array:
    """(6, 6) K that reduces a scatter of so many degrees of freedom to what is not noise.

    In a direction whose scatter chance could have made of the noise alone, nothing is left of it: the gain
    to a wrench that does not vary cannot be told from the offset.
    """
    if freedom < 1.0:
        return np.zeros((6, 6))
    root = np.linalg.cholesky(noise)
    whitening = np.linalg.inv(root)
    white = whitening @ scatter @ whitening.T / freedom
    ratio, axes = np.linalg.eigh(0.5 * (white + white.T))
    # largest eigenvalue by chance: Davidson and Szarek's bound
    chance = (1.0 + np.sqrt(6.0 / freedom) + np.sqrt(2.0 * np.log(1.0 / _CHANCE) / freedom)) ** 2
    share = np.where(ratio > chance, 1.0 - 1.0 / np.maximum(ratio, 1.0), 0.0)
    return np.asarray(root @ (axes * share) @ axes.T @ whitening)


def _in_bands(part: Part, design: Array, moved: Array, residual: Array, noise: Array) -> float:
    """Reduce the scatter of w to the share that is not noise band by band, in place.

    Whitening lets errors that last weigh less where they are slow. Where the wrench is slow, too, what is
    left of w at other frequencies is noise, (6, 6) Q of a row, on which the equation for the gain would rest.
    In the design (M, p), [w, columns], w is replaced, and so is `moved` (M, 6), by what w would be another;
    the residual (M, n) is in units of the stated sigma. Returned is how many places are left.
    """
    if len(design) < 2 * _BAND:
        return float(len(design))
    columns = design[:, 6:]
    both = np.hstack([design[:, :6], moved])
    mean = columns @ np.linalg.lstsq(columns, both)[0]
    begins = np.flatnonzero(np.isinf(part.chain.step))
    logs = [slice(a, b) for a, b in pairwise([*begins, len(design)])]
    waves = [dct(both[log] - mean[log], norm="ortho", axis=0) for log in logs]
    power = [np.mean(dct(residual[log], norm="ortho", axis=0) ** 2, axis=1) for log in logs]
    size = max(map(len, waves))
    edges = [0, *(_BAND * 2 ** np.arange(int(np.log2(size / _BAND)))).tolist(), size]
    places = 0.0
    for band in (slice(a, b) for a, b in pairwise(edges)):
        scatter = sum((wave[band, :6].T @ wave[band, :6] for wave in waves), np.zeros((6, 6)))
        errors = np.concatenate([p[band] for p in power])
        kept = _share(scatter, noise * errors.mean(), errors.size)
        places += errors.size * float(np.trace(kept)) / 6.0
        for wave in waves:
            wave[band, :6] = wave[band, :6] @ kept.T
            wave[band, 6:] = wave[band, 6:] @ kept.T
    for log, wave in zip(logs, waves, strict=True):
        found = idct(wave, norm="ortho", axis=0)
        design[log, :6], moved[log] = mean[log, :6] + found[:, :6], found[:, 6:]
    return places
