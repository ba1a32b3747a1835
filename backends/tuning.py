"""Noise parameters that a log can be used to tune, from its innovations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from conegraph.backends.innovations import (
    FrameInnovation,
    Settled,
    SettledEvent,
    SettledFrame,
    innovations,
    settle,
)
from conegraph.backends.noise_parameters import (
    NoiseParameters,
    SensorNoise,
    noise_parameters,
)
from conegraph.config import Config
from conegraph.errors import SourceError
from conegraph.types import (
    Array,
    ConeObservations,
    Event,
    SensorModel,
    VelocityObservation,
)

MAX_ROUNDS = 6
"""Associations made anew at most so often."""

MAX_SCORINGS = 6
"""Steps of the maximisation within a round at most."""

SETTLED_STEP = 0.02
"""A change of every parameter below 2 % ends the search."""

LONGEST_STEP = 1.0
PROBE = 0.02
"""Step of the numerical derivatives, in the logarithm of a parameter."""

PRIOR_SIGMA = 0.5
"""Sigma of a parameter's logarithm before any data: a factor of 1.65 either way. Noise
too small to be seen beside the sensor's has a likelihood that is flat far upwards of
the truth; what a log says little of stays near where it was."""

LEAST_DOF = 200
"""Degrees of freedom of the first run's innovations: with noise far too small most of
its cones are not settled yet, so that few of those are no reason to refuse."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a configuration explains a stretch of a log.

    Attributes:
        frames: frames of the stretch.
        nis_per_dof: NIS over degrees of freedom of a run with this configuration.
        correlation: of successive innovations of a cone, 0 where they are white.
        overconfident_frames: frames that ended an overconfident window.
    """

    frames: int
    nis_per_dof: float
    correlation: float
    overconfident_frames: int


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter before and after, and one sigma of the latter as a share of it."""

    name: str
    before: float
    after: float
    error: float


@dataclass(frozen=True, slots=True)
class Tuning:
    """What tuning found.

    Attributes:
        config: the tuned configuration.
        changes: the parameters.
        before: how the given configuration explains the stretch it is tuned on.
        after: how the tuned one does.
        check_before: the same on the frames that follow; None where there are none.
        check_after: the same, tuned.
        rounds: how often associations were made anew.
        converged: whether the last round changed nothing.
    """

    config: Config
    changes: tuple[Change, ...]
    before: Fit
    after: Fit
    check_before: Fit | None
    check_after: Fit | None
    rounds: int
    converged: bool

    @property
    def holds(self) -> bool:
        """Whether frames that were not tuned on speak for the result too."""
        before, after = self.check_before, self.check_after
        if before is None or after is None:
            return True
        return after.overconfident_frames <= before.overconfident_frames

    def figures(self) -> dict[str, object]:
        """Return everything but the configuration."""
        names = [f.name for f in fields(self) if f.name != "config"]
        return {**{name: getattr(self, name) for name in names}, "holds": self.holds}


def tune(
    events: Sequence[Event],
    config: Config,
    sensor: SensorModel | None,
    *,
    frames: int = 600,
    kind: SensorNoise = "model",
    progress: Callable[[int], None] = lambda _: None,
) -> Tuning:
    """Estimate the noise of sensor and motion from a stream's innovations.

    The innovations z of a filter that knows the noise are white with the covariance
    Z that it says. Their likelihood ``sum log|Z| + z' Z^-1 z`` is therefore greatest
    at the true noise (Mehra, "On the identification of variances and adaptive Kalman
    filtering", 1970); the method of scoring finds the maximum (Gupta and Mehra,
    "Computational aspects of maximum likelihood estimation", 1974). Associations are
    held fixed meanwhile and made anew with the result, until nothing changes: a gate
    that was too narrow hid the errors that would have shown it.

    Args:
        events: the stream; its first frames are used, and as many again to check.
        config: the configuration to start from.
        sensor: the source's sensor.
        frames: frames to tune on.
        kind: ``model`` estimates the sensor's curve, ``scale`` one factor on what
            the source reports.
        progress: told the number of each round.

    Raises:
        SourceError: too few cones are seen again to learn anything.
    """
    fitted, checked = _stretch(events, frames), _stretch(events, 2 * frames)
    settled = settle(fitted, config, sensor)
    parameters = _parameters(settled, config, sensor, kind)
    before = _fit(settled, config, sensor, 0)
    theta = np.zeros(len(parameters.start))
    information = np.eye(len(theta))
    converged, rounds = False, 0
    while not converged and rounds < MAX_ROUNDS:
        rounds += 1
        progress(rounds)
        found, information = _maximise(settled.events, parameters, theta, sensor)
        converged = bool(np.abs(found - theta).max() < SETTLED_STEP)
        theta = found
        settled = settle(fitted, parameters.config(theta), sensor)
    tuned = parameters.config(theta)
    error = np.sqrt(np.diag(np.linalg.inv(information)))
    rows = zip(
        parameters.names,
        parameters.start.tolist(),
        parameters.values(theta).tolist(),
        error.tolist(),
        strict=True,
    )
    later = len(settled.nis)
    more = len(checked) > len(fitted)
    return Tuning(
        tuned,
        tuple(Change(*row) for row in rows),
        before,
        _fit(settled, tuned, sensor, 0),
        _fit(settle(checked, config, sensor), config, sensor, later) if more else None,
        _fit(settle(checked, tuned, sensor), tuned, sensor, later) if more else None,
        rounds,
        converged,
    )


def _stretch(events: Sequence[Event], frames: int) -> list[Event]:
    """Return the events up to and with so many frames."""
    end = [n for n, e in enumerate(events) if isinstance(e, ConeObservations)]
    return list(events[: end[min(frames, len(end)) - 1] + 1]) if end else []


def _parameters(
    settled: Settled, config: Config, sensor: SensorModel | None, kind: SensorNoise
) -> NoiseParameters:
    seen = [e for e in settled.events if isinstance(e, SettledFrame)]
    xy = np.vstack([np.zeros((0, 2)), *(e.observations.xy_m for e in seen)])
    cones = {cone for e in seen for cone in e.landmark_id.tolist()}
    if settled.nis[:, 1].sum() < LEAST_DOF or len(xy) == len(cones):
        raise SourceError(
            f"too few cones were seen again to tune on: {len(xy)} matched sightings "
            f"in {len(seen)} frames"
        )
    odometry = any(isinstance(e, VelocityObservation) for e in settled.events)
    return noise_parameters(
        config, sensor, np.hypot(*xy.T), kind=kind, has_odometry=odometry
    )


def _fit(
    settled: Settled, config: Config, sensor: SensorModel | None, first: int
) -> Fit:
    """Describe a run from frame number ``first`` on."""
    nis = settled.nis[first:]
    seen = innovations(settled.events, config, sensor)
    return Fit(
        len(nis),
        float(nis[:, 0].sum() / max(nis[:, 1].sum(), 1.0)),
        _correlation(seen),
        int(settled.overconfident[first:].sum()),
    )


def _correlation(seen: Sequence[FrameInnovation]) -> float:
    """Return the correlation of a cone's innovation with its one before."""
    last: dict[int, Array] = {}
    now, then = [], []
    for frame in seen:
        scaled = (frame.residual / np.sqrt(np.diag(frame.cov))).reshape(-1, 2)
        for cone, value in zip(frame.landmark_id.tolist(), scaled, strict=True):
            if cone in last:
                now.append(value)
                then.append(last[cone])
            last[cone] = value
    if not now:
        return float("nan")
    a, b = np.concatenate(now), np.concatenate(then)
    return float(a @ b / np.sqrt((a @ a) * (b @ b)))


def _maximise(
    events: Sequence[SettledEvent],
    parameters: NoiseParameters,
    theta: Array,
    sensor: SensorModel | None,
) -> tuple[Array, Array]:
    """Return the likeliest parameters (P,) and their information (P, P)."""

    def seen_at(at: Array) -> list[FrameInnovation]:
        return innovations(events, parameters.config(at), sensor)

    seen = seen_at(theta)
    cost = _cost(seen, theta)
    for _ in range(MAX_SCORINGS):
        moved = [seen_at(theta + row) for row in PROBE * np.eye(len(theta))]
        gradient, information = _score(seen, moved, theta)
        whole = np.asarray(-np.linalg.solve(information, gradient), dtype=np.float64)
        shrink = min(1.0, LONGEST_STEP / float(np.abs(whole).max()))
        theta, seen, cost, done = _descend(seen_at, theta, shrink * whole, seen, cost)
        if done:
            break
    return theta, information


def _descend(
    seen_at: Callable[[Array], list[FrameInnovation]],
    theta: Array,
    step: Array,
    seen: list[FrameInnovation],
    cost: float,
) -> tuple[Array, list[FrameInnovation], float, bool]:
    """Take the step, halved until the cost falls; say whether nothing is left to do."""
    while np.abs(step).max() > 0.2 * SETTLED_STEP:
        there = seen_at(theta + step)
        lower = _cost(there, theta + step)
        if lower < cost:
            small = bool(np.abs(step).max() < 0.5 * SETTLED_STEP)
            return theta + step, there, lower, small
        step = 0.5 * step
    return theta, seen, cost, True


def _cost(seen: Sequence[FrameInnovation], theta: Array) -> float:
    """Return minus the log-likelihood, but for a constant, with the prior."""
    total = 0.5 * float(theta @ theta) / PRIOR_SIGMA**2
    for frame in seen:
        factor = cholesky(frame.cov, lower=True)
        weighted = cho_solve((factor, True), frame.residual)
        total += float(np.log(np.diag(factor)).sum() + 0.5 * frame.residual @ weighted)
    return total


def _score(
    seen: Sequence[FrameInnovation],
    moved: Sequence[Sequence[FrameInnovation]],
    theta: Array,
) -> tuple[Array, Array]:
    """Return gradient (P,) and expected Hessian (P, P) of the cost.

    With ``Z = L L'``, ``w = L^-1 z``, ``A_i = L^-1 Z_i L^-T`` and ``b_i = L^-1 z_i``,
    where an index is a derivative: gradient ``(tr A_i - w' A_i w) / 2 + w' b_i``,
    expected Hessian ``tr(A_i A_j) / 2 + b_i' b_j``.
    """
    gradient = theta / PRIOR_SIGMA**2
    information = np.eye(len(theta)) / PRIOR_SIGMA**2
    for k, frame in enumerate(seen):
        there = [m[k] for m in moved]
        dz = np.stack([m.residual - frame.residual for m in there], -1) / PROBE
        dcov = np.stack([m.cov - frame.cov for m in there]) / PROBE
        factor = cholesky(frame.cov, lower=True)
        whiten = solve_triangular(factor, np.eye(len(factor)), lower=True)
        w, b, a = whiten @ frame.residual, whiten @ dz, whiten @ dcov @ whiten.T
        gradient += 0.5 * (np.einsum("iaa->i", a) - np.einsum("a,iab,b->i", w, a, w))
        gradient += w @ b
        flat = a.reshape(len(a), -1)
        information += 0.5 * flat @ flat.T + b.T @ b
    return gradient, information
