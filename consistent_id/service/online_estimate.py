"""An estimate that follows the robot in service: warmth, wear, loads on and off.

Each block of samples extends a triangular factor, whose older rows fade: ``R <- QR of
[exp(-dt / 2 memory) R; rows of the block]``.  The parameters are those of the least
misfit within the constraints, with an anchor at the estimate that they began from, for
parameters that the last minutes do not determine.  The result is a function of state
and block: there is no thread and no clock, and the same blocks give the same state.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import Certificate, Optimality
from consistent_id.constraints.delivered_bodies import link_conditions
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.verdict import Verdict
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.linear import triangle
from consistent_id.service.load_watch import (
    PARTS,
    LoadWatch,
    Quiet,
    learned_watch,
)
from consistent_id.service.online_state import (
    ARM,
    METHOD,
    LoadChange,
    LoadPlace,
    OnlineState,
    Regime,
    WaitingBlock,
    held_of,
    noise_of,
    regimes_of,
    units_of,
    verdict_of,
)
from consistent_id.service.running_log import (
    HALF,
    FadedRows,
    extended_by,
    inverse_of,
    joined,
    local_motion,
    without_body,
)
from consistent_id.service.warm_fit import (
    WarmFit,
    warm_fit,
)

MEMORY = 60.0
"""Time after which a sample counts 1/e, [s]."""

_BODIES = 0.1  # of a link's typical size, by which bodies may differ from the start
_USUAL = 0.1  # of the capacity: mass of a load that is worth announcing
SETTLING = 2.0
"""Time in which an announced load is learned, and not announced again, [s]."""

_LEAST_HALF = 2  # samples on either side: a polynomial of degree 3 needs four
_TOGETHER = 1000  # samples of a log whose rows are computed at once
_BLOCK = 0.1  # s; length of the blocks of `watching`


@brief
@dataclass(frozen=True, slots=True, eq=False)
class OnlineEstimate:
    """An estimate that follows samples, block by block.

    ``state = online.follow(state, block)``

    Parameters
    ----------
    estimate : Estimate
        Where it begins.
    memory : float, [s]
        Time after which a sample counts 1/e; infinite for one that forgets nothing.
    constraints : sequence of Constraint, optional
        By default those of the estimate; empty for none at all: the verdict names
        bodies that are not physically consistent then.
    bodies : float
        How far bodies may differ from the estimate, relative to their typical size: a
        standard deviation.  That of drive terms is their size itself.
    carrier : str, optional
        Link that carries loads; by default the last one.
    capacity : float, [kg]
        Mass of the largest load.
    period : float, [s]
        Time between solutions; infinite for parameters that stay as they are.  The
        watch for loads looks at every block.
    half, torque_delay
        See `local_motion`, for blocks without accelerations.
    watch : LoadWatch, optional
        See `watching`; without it, loads are not watched for.

    Raises
    ------
    ProblemError
        If the base floats, or a number is out of its range.
    """

    estimate: Estimate
    memory: float = MEMORY
    constraints: Sequence[Constraint] | None = None
    bodies: float = _BODIES
    carrier: str | None = None
    capacity: float = 10.0
    period: float = 0.5
    half: int = HALF
    torque_delay: float = 0.0
    watch: LoadWatch | None = None
    sigma: Vector = field(init=False)
    held: Vector = field(init=False)
    unit: Vector = field(init=False)
    alone: Regime = field(init=False)
    with_load: Regime = field(init=False)
    begun: Verdict = field(init=False)

    def __post_init__(self) -> None:
        robot = self.estimate.model.robot
        if robot.floating:
            raise ProblemError(
                f"the base of {robot.name!r} floats; an estimate follows robots whose "
                "base stands still"
            )
        _require_settings(self)
        if self.carrier is not None and self.carrier not in robot.link_names:
            raise ProblemError(
                f"no link {self.carrier!r} carries loads; the links are "
                f"{', '.join(robot.link_names)}"
            )
        freeze(self, sigma=noise_of(self.estimate), unit=units_of(self.estimate))
        freeze(self, held=held_of(self.estimate), begun=self.estimate.verdict)
        load = LoadPlace(self.link, self.capacity)
        alone, loaded = regimes_of(self.estimate, self.constraints, self.bodies, load)
        freeze(self, alone=alone, with_load=loaded)

    def __repr__(self) -> str:
        robot = self.estimate.model.robot
        return (
            f"OnlineEstimate({robot.name!r}, memory {self.memory:g} s, "
            f"{'no watch' if self.watch is None else 'watched'})"
        )

    @property
    def link(self) -> int:
        """Number of the link that carries loads."""
        names = self.estimate.model.robot.link_names
        return len(names) - 1 if self.carrier is None else names.index(self.carrier)

    @single_threaded
    def start(self, time: float = -np.inf) -> OnlineState:
        """Return the state before the first sample: that of the estimate.

        Parameters
        ----------
        time : float, [s]
            Before the first sample.

        Raises
        ------
        ProblemError
            If it is no time.
        """
        if not time < np.inf:
            raise ProblemError(f"the time is {time}, expected seconds")
        size, joints = len(self.unit), len(self.sigma)
        state = OnlineState(
            time,
            time,
            np.zeros((size + 1, size + 1)),
            0.0,
            np.zeros((joints, 2)),
            self.estimate.parameters,
            np.zeros(size),
            np.zeros((PARTS, PARTS)),
            Optimality(0.0, np.inf, np.inf, np.inf),
            self.begun,
        )
        return self._solved(state)

    @single_threaded
    def follow(self, state: OnlineState, block: Recording) -> OnlineState:
        """Return the state after some samples.

        Parameters
        ----------
        state : OnlineState
            After the samples before.
        block : Recording
            Positions, torques, and accelerations with velocities; without
            accelerations, `local_motion` computes them, a few samples late.

        Raises
        ------
        ProblemError
            If the clock goes back, or the torque is missing.
        RecordingError
            If a joint is missing.
        """
        log, tail = self._motion(state, block)
        if log is None:
            return replace(state, tail=tail)
        rows = FadedRows.of(self.estimate.model, log)
        return replace(self._taken(state, rows), tail=tail)

    @single_threaded
    def along(
        self, log: Recording, block: float = _BLOCK, start: OnlineState | None = None
    ) -> list[OnlineState]:
        """Return the states after each block of a log.

        Parameters
        ----------
        log : Recording
        block : float, [s]
        start : OnlineState, optional
            By default that of the estimate.
        """
        state = self.start() if start is None else start
        states = []
        for rows in self._blocks(log, block):
            state = self._taken(state, rows)
            states.append(state)
        return states

    def watching(
        self,
        logs: Recording | Sequence[Recording],
        *,
        false_alarms: float = 1.0,
        block: float = _BLOCK,
    ) -> "OnlineEstimate":
        """Return the same, announcing changes of the load.

        Parameters
        ----------
        logs : Recording or sequence of Recording
            In which the load does not change: the robot as it was identified.
        false_alarms : float, [1/h]
            Rate to state; see `learned_watch`.
        block : float, [s]
            Length of blocks, as in service.

        Raises
        ------
        ProblemError
            If the logs are shorter than a minute together.
        """
        plain = replace(self, watch=None)
        quiet = [plain._quiet(log, block) for log in several(logs)]
        load = _USUAL * self.capacity * np.array([1.0, ARM, ARM, ARM])
        watch = learned_watch(quiet, self.held, load, false_alarms)
        return replace(self, watch=watch)

    def load(self, state: OnlineState) -> tuple[Vector, Vector]:
        """Return the load's inertial parameters in its link, and standard errors.

        Both have shape (10,): mass [kg], first moment [kg m], inertia [kg m^2] about
        the origin of the link's frame.
        """
        own = self.estimate.model.layout.link_slice(self.link)
        start = self.estimate.parameters[own]
        return state.parameters[own] - start, state.deviations[own]

    def delivered(self, state: OnlineState) -> Estimate:
        """Return the followed estimate, as `control_model` and exporters take it."""
        proof = state.optimality
        certified = proof.verdict == "certified"
        certificate = Certificate(
            proof.verdict,
            f"optimum {'proven' if certified else 'known only'} to a relative "
            f"{proof.gap:.1e}, constraints violated by at most {proof.violation:.1e}",
            {"relative gap": proof.gap, "violation": proof.violation},
        )
        return replace(
            self.estimate,
            method=METHOD,
            parameters=state.parameters,
            parameter_errors=state.deviations,
            parameter_quantiles=None,
            base_covariance=None,
            certificate=certificate,
            judged=state.verdict,
            fit=None,
            notes=(f"followed up to {state.time:.6g} s",),
        )

    def _motion(
        self, state: OnlineState | None, block: Recording
    ) -> tuple[Recording | None, Recording | None]:
        """Return the samples to learn from, and those that wait for others."""
        require_type(block, Recording, "samples")
        log = block.of(self.estimate.model.robot.joint_names)
        if log.acceleration is not None:
            return log, None
        raw = joined(None if state is None else state.tail, log)
        last = raw.samples(slice(-2 * self.half, None))
        return local_motion(raw, self.half, self.torque_delay), last

    def _blocks(self, log: Recording, block: float) -> Iterator[FadedRows]:
        """Yield the rows of a log's blocks; a thousand samples are computed at once."""
        motion, _ = self._motion(None, log)
        if motion is None:
            return
        for first in range(0, len(motion) - 1, _TOGETHER):
            last = first + _TOGETHER
            end = last if len(motion) - last > 1 else len(motion)
            part = motion.samples(slice(first, end))
            yield from FadedRows.of(self.estimate.model, part).blocks(block)
            if end == len(motion):
                return

    @single_threaded
    def _quiet(self, log: Recording, block: float) -> Quiet:
        """Follow a log, and return what the watch learns from."""
        state, parts, spread = self.start(), [], np.zeros((PARTS, PARTS))
        for rows in self._blocks(log, block):
            parts.append(rows.watched(self.link, rows.less(state.parameters)))
            state = self._taken(state, rows)
            if np.trace(state.carried) > np.trace(spread):
                spread = state.carried
        return Quiet(parts, spread)

    def _taken(self, state: OnlineState, rows: FadedRows) -> OnlineState:
        """Return the state after a block, with a solution if it is time for one."""
        if not rows.time[0] > state.time:
            raise ProblemError(
                f"a block begins at {rows.time[0]:.9g} s, expected after "
                f"{state.time:.9g} s, the last sample before it; if the clock was set "
                "back, begin again with `start`"
            )
        state = self._learned(state, rows)
        due = np.isfinite(self.period) and state.time >= state.solved + self.period
        return self._solved(state) if due or state.relearned == state.time else state

    def _learned(self, state: OnlineState, rows: FadedRows) -> OnlineState:
        """Return the state with the rows of a block, and with the watch's answer."""
        now = float(rows.time[-1])
        new = rows.faded(self.memory, self.sigma, self.held)
        passed = now - (state.time if state.time > -np.inf else rows.time[0])
        fade = 1.0 if np.isinf(self.memory) else np.exp(-passed / self.memory)
        residual = rows.less(state.parameters)
        seen = [(residual**2).sum(axis=0), (rows.torque**2).sum(axis=0)]
        state = replace(
            state,
            time=now,
            weight=fade * state.weight + len(rows.time),
            errors=fade * state.errors + np.column_stack(seen),
            factor=np.sqrt(fade) * state.factor,
            waiting=tuple(
                replace(w, rows=np.sqrt(fade) * w.rows) for w in state.waiting
            ),
        )
        if self.watch is None:
            return replace(state, factor=extended_by(state.factor, new))
        return self._watched(state, self.watch, rows, new)

    def _watched(
        self, state: OnlineState, watch: LoadWatch, rows: FadedRows, new: Matrix
    ) -> OnlineState:
        """Return the state with a block that waits, or with an announcement."""
        free = state.parameters.copy()
        own = self.estimate.model.layout.link_slice(self.link)
        free[own] = self.estimate.parameters[own]
        block = watch.block(
            rows.watched(self.link, rows.less(state.parameters)), rows.less(free)
        )
        waiting = (*state.waiting, WaitingBlock(block, new))
        kept = watch.recent([w.watched for w in waiting], state.time)
        sure, unsure = waiting[: len(waiting) - len(kept)], waiting[-len(kept) :]
        factor = state.factor
        for one in sure:
            factor = extended_by(factor, one.rows)
        state = replace(state, factor=factor, waiting=unsure)
        settled = kept[0].first > state.relearned
        score = watch.score(kept, state.carried) / watch.limit if settled else 0.0
        state = replace(state, score=score)
        if score < 1.0:
            return state
        loaded = not state.loaded or not watch.is_free(kept[-1], state.carried)
        change = state.change
        # While a new load is still being learned, it is not announced again.
        same = change is not None and change.loaded == loaded
        if change is None or not same or state.time > change.time + SETTLING:
            change = LoadChange(state.time, loaded, score)
        own = self.estimate.model.layout.link_slice(self.link)
        # Only the last block is sure to be of the new load.
        forgotten = extended_by(without_body(factor, own), unsure[-1].rows)
        return replace(
            state,
            factor=forgotten,
            waiting=(),
            change=change,
            relearned=state.time,
            path=(),
        )

    def _solved(self, state: OnlineState) -> OnlineState:
        """Return the state with the parameters of its factor."""
        regime = self.with_load if state.loaded else self.alone
        found = resolved(self, state, regime)
        spread = self._spread(found.stacked, regime)
        own = self.estimate.model.layout.link_slice(self.link)
        carried = spread[own][:PARTS]
        state = replace(
            state,
            solved=state.time,
            parameters=found.fit.u * self.unit,
            deviations=np.linalg.norm(spread, axis=1),
            carried=carried @ carried.T,
            optimality=found.fit.optimality,
            path=found.fit.path,
        )
        links = link_conditions(self.estimate.model, state.parameters)
        return replace(state, verdict=verdict_of(state, self.begun, links))

    def _spread(self, stacked: Matrix, regime: Regime) -> Matrix:
        """Return a root of the covariance under the equalities: ``C = S S^T``.

        With steps ``x = U N v`` and the factor ``R`` of data and anchor, it is
        ``U N (R U N)^-1``.
        """
        n, steps = len(self.unit), self.unit[:, None] * regime.cone.steps
        R = triangle(np.asfortranarray(stacked[:n, :n] @ steps))
        return np.asarray(steps @ inverse_of(R))


def _require_settings(online: OnlineEstimate) -> None:
    """Refuse numbers with which an estimate would follow wrongly or not at all."""
    for name in ("memory", "bodies", "capacity", "period"):
        value = getattr(online, name)
        endless = name in ("memory", "period")
        if not value > 0.0 or (np.isinf(value) and not endless):
            raise ProblemError(f"{name} is {value}, expected a number above 0")
    if not isinstance(online.half, int | np.integer) or online.half < _LEAST_HALF:
        raise ProblemError(
            f"half is {online.half}, expected a whole number of samples, "
            f"{_LEAST_HALF} or more"
        )
    if not np.isfinite(online.torque_delay):
        raise ProblemError(f"torque_delay is {online.torque_delay}, expected seconds")


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """A solution, and the triangular factor of data and anchor that it is of."""

    fit: WarmFit
    stacked: Matrix


def resolved(online: OnlineEstimate, state: OnlineState, regime: "Regime") -> Resolved:
    """Return the least misfit of a state's factor and the anchor, certified."""
    unit, x = online.unit, online.estimate.parameters
    n = len(unit)
    anchor = np.column_stack([np.diag(regime.anchor), regime.anchor * x])
    stacked = extended_by(state.factor, anchor)
    # The least misfit is about one half of its square then, as proofs expect.
    size = max(float(abs(stacked[n, n])), 1.0)
    fit = warm_fit(
        stacked[:n, :n] * (unit / size),
        stacked[:n, n] / size,
        regime.cone,
        x / unit,
        state.path,
    )
    return Resolved(fit, stacked)
