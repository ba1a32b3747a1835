"""The extended Kalman filter's algebra: one car, many cones, one covariance.

State ``[x, y, psi, u, r, b, l_1x, l_1y, …]``. Both back ends use it: the EKF
holds the whole map in it, the graph's tracker only the cones near the car.
Rows that an operation does not touch are not read: a joint update of k cones
costs O(n^2 k), a prediction O(n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf, dtrtrs

from conegraph.backends.motion import NV, Prediction
from conegraph.backends.sensor_noise import transport_covariance
from conegraph.geometry import rotation, wrap_angle
from conegraph.types import Array, IntArray, SensorModel


@dataclass(frozen=True, slots=True)
class PredictedCones:
    """Cones of the map as the car should see them.

    Attributes:
        slot: (k,) their places in the filter.
        xy_m: (k, 2) predicted positions in the car frame.
        cov_m2: (2k, 2k) joint covariance of these, without sensor noise.
    """

    slot: IntArray
    xy_m: Array
    cov_m2: Array


@dataclass(frozen=True, slots=True)
class Innovation:
    """Normalised innovation squared of a joint update, and its degrees of freedom."""

    nis: float
    dof: int


class LandmarkFilter:
    """Mean and covariance of the car and its cones, changed in place."""

    def __init__(
        self,
        bias_sigma_radps: float = 0.0,
        speed_sigma_mps: float = 0.0,
        *,
        invariant: bool = True,
    ) -> None:
        """Start at the origin, at rest (thesis section 4.2).

        Args:
            bias_sigma_radps: doubt about the odometry's yaw-rate bias.
            speed_sigma_mps: doubt about standing still; the thesis has none.
            invariant: re-express the covariance after corrections, see `_settle`.
        """
        self._invariant = invariant
        self._x = np.zeros(NV)
        self._P = np.zeros((NV, NV))
        self._P[3, 3] = speed_sigma_mps**2
        self._P[4, 4] = (0.2 * speed_sigma_mps) ** 2
        self._P[5, 5] = bias_sigma_radps**2

    @property
    def n_landmarks(self) -> int:
        """How many cones the filter holds."""
        return (len(self._x) - NV) // 2

    @property
    def vehicle(self) -> Array:
        """(6,) the car's state, a copy."""
        return self._x[:NV].copy()

    @property
    def vehicle_cov(self) -> Array:
        """(6, 6) the car's covariance, a copy."""
        return self._P[:NV, :NV].copy()

    @property
    def landmarks_m(self) -> Array:
        """(M, 2) the cones in the world, a copy."""
        return self._x[NV:].reshape(-1, 2).copy()

    def landmark_covs(self) -> Array:
        """(M, 2, 2) the cones' own covariances."""
        m = self.n_landmarks
        blocks = self._P[NV:, NV:].reshape(m, 2, m, 2)
        return np.ascontiguousarray(np.einsum("iaib->iab", blocks))

    def load(self, state: Array, cov: Array) -> None:
        """Replace everything: state (6 + 2 M,), covariance square of it."""
        self._x, self._P = state.copy(), cov.copy()

    def predict(self, step: Prediction) -> None:
        """Move the car (thesis section 4.3).

        ``P_VV = F P_VV F' + Q``, ``P_VM = F P_VM``; cones do not move.
        """
        self._x[:NV] = step.state
        rows = step.F @ self._P[:NV]
        self._P[:NV, NV:] = rows[:, NV:]
        self._P[NV:, :NV] = rows[:, NV:].T
        self._P[:NV, :NV] = rows[:, :NV] @ step.F.T + step.Q

    def place_car(self, pose: Array, cov: Array) -> None:
        """Set the pose (3,), or the state (6,), with its covariance.

        It is then independent of the cones.
        """
        n = len(pose)
        self._x[:n] = pose
        self._P[:n], self._P[:, :n] = 0.0, 0.0
        self._P[:n, :n] = cov

    def inflate(self, Q: Array) -> None:
        """Add noise (6, 6) to the car."""
        self._P[:NV, :NV] += Q

    def cones_in_car_frame(self) -> Array:
        """(M, 2) every cone as the car should see it.

        ``h(p, l) = R(psi)' (l - [x, y])`` (thesis section 4.4.1).
        """
        seen: Array = (self._x[NV:].reshape(-1, 2) - self._x[:2]) @ rotation(self._x[2])
        return seen

    def predict_cones(self, slot: IntArray) -> PredictedCones:
        """Predict the cones in the given slots with their joint covariance."""
        H, columns, h = self._jacobian(slot)
        cov = H @ self._P[columns[:, None], columns] @ H.T
        return PredictedCones(slot, h, cov)

    def _jacobian(self, slot: IntArray) -> tuple[Array, IntArray, Array]:
        """Return H (2k, 3 + 2k), the state columns it acts on, and h (k, 2).

        ``H_p = [-R', [h_y, -h_x]']`` and ``H_l = R'`` (thesis section 4.4.1).
        """
        k = len(slot)
        columns = np.concatenate([np.arange(3), NV + components(slot)])
        R = rotation(self._x[2])
        h = (self._x[NV:].reshape(-1, 2)[slot] - self._x[:2]) @ R
        H = np.zeros((2 * k, 3 + 2 * k))
        H[0::2, :2], H[1::2, :2] = -R.T
        H[0::2, 2], H[1::2, 2] = h[:, 1], -h[:, 0]
        add_blocks(H[:, 3:], R.T)
        return H, columns, h

    def update_cones(
        self,
        slot: IntArray,
        xy_m: Array,
        cov_m2: Array,
        model: SensorModel | None,
        doubt: Array | None = None,
    ) -> Innovation:
        """Correct everything with the cones matched in one frame, jointly.

        ``z = y - h, Z = H P H' + R, K = P H' Z^-1, x += K z, P -= K Z K'``
        (thesis section 4.4.1). With a sensor model, R is evaluated at the predicted
        positions. Linearising again at the corrected state (an iterated EKF) was
        measured to double the drift: Jacobian and measurement noise then agree.

        Args:
            slot: (k,) places of the matched cones.
            xy_m: (k, 2) where they were seen, car frame.
            cov_m2: (k, 2, 2) their reported covariances.
            model: sensor model, or None to use the covariances as reported.
            doubt: (6, 6) noise that is first added to the car if the cones do not
                fit together: a NIS above ``dof + 4 sqrt(2 dof)``.

        Returns:
            The innovation, before any doubt was added.
        """
        H, columns, h = self._jacobian(slot)
        R = cov_m2
        if model is not None:
            R = transport_covariance(cov_m2, xy_m, h, model)
        z = (xy_m - h).ravel()
        PHt = self._P[:, columns] @ H.T
        W, w = _whitened(add_blocks(H @ PHt[columns], R), PHt, z)
        seen = Innovation(float(w @ w), len(z))
        surprising = seen.nis > seen.dof + 4.0 * np.sqrt(2.0 * seen.dof)
        if surprising and doubt is not None:
            self.inflate(doubt)
            PHt = self._P[:, columns] @ H.T
            W, w = _whitened(add_blocks(H @ PHt[columns], R), PHt, z)
        self._apply(W, w)
        return seen

    def _update(self, PHt: Array, Z: Array, z: Array) -> None:
        """Apply the Kalman gain ``P H' Z^-1`` to a residual z."""
        self._apply(*_whitened(Z, PHt, z))

    def _apply(self, W: Array, w: Array) -> None:
        """Move the state by ``W' w``, and settle the covariance."""
        prior = self._x.copy()
        self._x = prior + w @ W
        self._x[2] = wrap_angle(self._x[2])
        self._settle(prior, W)

    def _settle(self, prior: Array, W: Array) -> None:
        """Take the gain's ``W`` (m, n) off the covariance: ``P -= W' W``.

        An EKF that linearises each update at a new estimate gains information about
        the world's heading that no cone gives, and grows overconfident. With errors
        of positions taken relative to a turn of the whole world,
        ``e' = e - e_psi J p`` (Barrau and Bonnabel, "An EKF-SLAM algorithm with
        consistency properties", 2015), it does not. In plain coordinates that is one
        step more: as the estimate moves by ``d``, ``P <- M P M'`` with
        ``M = I + g e_psi'``, ``g = J d``, J the quarter turn of every position.
        """
        left, right = W, -W
        if self._invariant:
            moved = self._x - prior
            g = np.zeros_like(moved)
            g[0], g[1] = -moved[1], moved[0]
            g[NV::2], g[NV + 1 :: 2] = -moved[NV + 1 :: 2], moved[NV::2]
            heading = self._P[2] - W.T @ W[:, 2]
            a = heading + 0.5 * heading[2] * g
            left, right = np.vstack([left, g, a]), np.vstack([right, a, g])
        # In place, ``P += left' right``: a matrix to be added would cost as much again.
        self._P = dgemm(
            1.0, right, left, 1.0, self._P.T, trans_a=True, overwrite_c=True
        ).T

    def innovation(
        self, slot: IntArray, xy_m: Array, cov_m2: Array, model: SensorModel | None
    ) -> Innovation:
        """Return the joint NIS ``z' Z^-1 z`` of matched cones before their update."""
        z, Z = self.residual(slot, xy_m, cov_m2, model)
        w = _lower_solved(Z, z)
        return Innovation(float(w @ w), len(z))

    def residual(
        self, slot: IntArray, xy_m: Array, cov_m2: Array, model: SensorModel | None
    ) -> tuple[Array, Array]:
        """Return the joint innovation z (2k,) of matched cones and its covariance."""
        predicted = self.predict_cones(slot)
        R = cov_m2
        if model is not None:
            R = transport_covariance(cov_m2, xy_m, predicted.xy_m, model)
        Z = add_blocks(predicted.cov_m2.copy(), R)
        return (xy_m - predicted.xy_m).ravel(), Z

    def update_velocity(self, u_mps: float, r_radps: float, cov: Array) -> None:
        """Correct with a measured velocity (thesis section 4.4.2).

        ``h = [u, r + b]``; the bias is part of what a gyro reports.
        """
        H = np.zeros((2, NV))
        H[0, 3] = H[1, 4] = H[1, 5] = 1.0
        z = np.array([u_mps, r_radps]) - H @ self._x[:NV]
        PHt = self._P[:, :NV] @ H.T
        self._update(PHt, H @ PHt[:NV] + cov, z)

    def update_bias(self, bias_radps: float, sigma_radps: float) -> None:
        """Correct with a yaw-rate bias that was measured by itself."""
        PHt = self._P[:, 5:6]
        Z = PHt[5:6] + sigma_radps**2
        self._update(PHt, Z, np.array([bias_radps]) - self._x[5:6])

    def add_cones(self, xy_m: Array, cov_m2: Array) -> IntArray:
        """Append new cones (k, 2) seen from the car; return their slots (k,).

        ``l = R y + [x, y]``, ``P_lx = G_p P_px``,
        ``P_ll = G_p P_pp G_p' + R cov R'`` (thesis section 4.4.4).
        """
        n, k = len(self._x), len(xy_m)
        Rw = rotation(self._x[2])
        offset = xy_m @ Rw.T
        by_pose = np.zeros((k, 2, 3))
        by_pose[:, 0, 0] = by_pose[:, 1, 1] = 1.0
        by_pose[:, 0, 2], by_pose[:, 1, 2] = -offset[:, 1], offset[:, 0]
        G = by_pose.reshape(2 * k, 3)
        P = np.empty((n + 2 * k, n + 2 * k))
        P[:n, :n] = self._P
        P[n:, :n] = G @ self._P[:3]
        P[:n, n:] = P[n:, :n].T
        P[n:, n:] = add_blocks(
            G @ self._P[:3, :3] @ G.T, np.asarray(Rw @ cov_m2 @ Rw.T)
        )
        self._x = np.concatenate([self._x, (offset + self._x[:2]).ravel()])
        self._P = P
        return np.arange((n - NV) // 2, (n - NV) // 2 + k, dtype=np.int64)

    def place_cones(self, xy_m: Array, cov_m2: Array) -> None:
        """Append cones (k, 2) of a given map, in the world, independent of all."""
        n, k = len(self._x), len(xy_m)
        P = np.zeros((n + 2 * k, n + 2 * k))
        P[:n, :n] = self._P
        add_blocks(P[n:, n:], cov_m2)
        self._x, self._P = np.concatenate([self._x, xy_m.ravel()]), P

    def keep(self, mask: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> None:
        """Drop the cones whose mask (M,) is False; the others close ranks."""
        rows = np.concatenate([np.ones(NV, bool), np.repeat(mask, 2)])
        self._x = self._x[rows]
        self._P = self._P[rows[:, None] & rows].reshape(len(self._x), -1)

    def separation(self, first: IntArray, second: IntArray) -> tuple[Array, Array]:
        """Return difference (k, 2) of cones and its covariances (k, 2, 2)."""
        a = (NV + 2 * first)[:, None] + np.arange(2)
        b = (NV + 2 * second)[:, None] + np.arange(2)
        P = self._P

        def block(i: IntArray, j: IntArray) -> Array:
            return P[i[:, :, None], j[:, None, :]]

        cov = block(a, a) + block(b, b) - block(a, b) - block(b, a)
        return self._x[a] - self._x[b], cov

    def equate(self, first: int, second: int, sigma_m: float) -> None:
        """Correct with the knowledge that two cones are one (difference zero)."""
        a, b = NV + 2 * first, NV + 2 * second
        columns = [a, a + 1, b, b + 1]
        H = np.hstack([np.eye(2), -np.eye(2)])
        PHt = self._P[:, columns] @ H.T
        Z = H @ PHt[columns] + np.eye(2) * sigma_m**2
        self._update(PHt, Z, self._x[columns[2:]] - self._x[columns[:2]])


def _whitened(Z: Array, PHt: Array, z: Array) -> tuple[Array, Array]:
    """Return ``W = L^-1 H P`` (m, n) and ``w = L^-1 z`` (m,), with ``Z = L L'``.

    The gain applied to z is then ``K z = W' w``, the covariance that it takes off
    ``K Z K' = W' W``, and the innovation's ``z' Z^-1 z = w' w``.

    Raises:
        LinAlgError: Z is not positive definite.
    """
    solved = _lower_solved(Z, np.column_stack([PHt.T, z]))
    return solved[:, :-1], solved[:, -1]


def _lower_solved(Z: Array, right: Array) -> Array:
    """Return ``L^-1`` times a matrix or vector, with ``Z = L L'``.

    LAPACK's own routines: around so small a matrix, the checks of `scipy.linalg` take
    longer than the work.
    """
    root, failed = dpotrf(Z, lower=True)
    if failed:
        raise np.linalg.LinAlgError("the innovation's covariance is not positive")
    solved: Array = dtrtrs(root, right, lower=True)[0]
    return solved


def components(place: IntArray) -> IntArray:
    """Return where x and y (2k,) of places (k,) stand in a vector of positions."""
    return (2 * place[:, None] + np.arange(2)).ravel()


def add_blocks(matrix: Array, blocks: Array) -> Array:
    """Add blocks (k, 2, 2), or k times one, to the diagonal of a (2k, 2k) matrix."""
    k = len(matrix) // 2
    i = np.arange(k)
    matrix.reshape(k, 2, k, 2)[i, :, i] += blocks
    return matrix
