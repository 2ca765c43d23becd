"""An estimate with its provenance: method, data, certificate and verdict."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.files import write_json
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import Table, brief
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.constraints.delivered_bodies import link_conditions, robot_size
from consistent_id.errors import ProblemError
from consistent_id.estimation.determination import loose_trunk
from consistent_id.estimation.estimate_file import (
    FORMAT,
    EstimatedValues,
    base_records,
    base_table,
    certificate_record,
    error_notes,
    parameter_frame,
    parameter_records,
    parameter_table,
    read_estimate,
)
from consistent_id.estimation.estimate_plot import draw_torque, torque_curves
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.judgement import Evidence, judge
from consistent_id.estimation.method import FittedSpan, FittedUnder, fitted_to_others
from consistent_id.estimation.torque_error import TorqueError, prediction_errors
from consistent_id.estimation.verdict import Verdict
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_sigma
from consistent_id.regression.segments import (
    merged,
    segment_regressions,
    segment_sources,
)
from consistent_id.regression.torque_along import predicted_torque, without_motion

if TYPE_CHECKING:
    from pandas import DataFrame

    from consistent_id.estimation.uncertainties.parameter_uncertainty import Uncertainty


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Parameters of a torque model, estimated from data.

    Parameters
    ----------
    method : str
    model : TorqueModel
    base : BaseParameters
    parameters : array_like, shape (parameters,)
        Standard parameters; the data determine only their base parameters.
    base_covariance : array_like, shape (base, base), optional
        Of the base parameters, under noise correlated as the residuals are (white, if a
        note says so); None where it has no simple form.
    origins : tuple of str
        Source of each parameter: ``"data"``, ``"combination"`` (data determine only
        sums that contain it), ``"loose"`` (data bound it loosely), ``"constraint"``,
        ``"prior"``, or ``"convention"`` (the smallest vector); see `determinations`.
    undetermined : tuple of str
        Combinations of base parameters that are not identifiable from the data, as
        readable sums.
    sigma : array_like, shape (torque joints,), [N m or N]
        Residual standard deviation of each joint whose torque is known.
    certificate : Certificate
    notes : tuple of str
        Conditions that a reader must know before using the numbers.
    seconds : float
        Wall time of the estimation.
    fit : Fit, optional
        How well it explains the data that it was fitted to.
    accepted : tuple of str
        Kinds of reasons that its `verdict` ignores, as the user decided.
    judged : Verdict, optional
        Verdict of a study, with more evidence than the estimate has itself; see
        `EstimateReport`.
    fitted_to : tuple of FittedSpan
        Recordings that it was fitted to, which cannot validate it; empty if they are
        not known.
    parameter_errors : array_like, shape (parameters,), optional
        Standard errors, NaN where the data do not determine a parameter: for noise as
        correlated as the residuals, under the constraints, and the prior's bias.  An
        active inequality counts in half of all data sets, see `active_ratios`.  Only
        `uncertainty` includes the scatter between recordings.
    parameter_quantiles, base_quantiles : array_like, optional
        Shapes (parameters,) and (base,): standard errors either way of a 95 % interval,
        by Student's distribution; without them, by a normal one.
    fitted_under : FittedUnder, optional
        Constraints, prior and weights of a constrained estimate; None of any other, and
        of one that was read from a file.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> estimate = ci.least_squares(model, regression)
    >>> estimate.method, round(estimate["joint1.viscous"], 6)
    ('least squares', 0.4)
    >>> estimate.predict(log).shape, round(estimate.score(log).stacked, 6)
    ((200, 1), 0.0)
    """

    method: str
    model: TorqueModel
    base: BaseParameters
    parameters: Vector
    base_covariance: Matrix | None
    origins: tuple[str, ...]
    undetermined: tuple[str, ...]
    sigma: Vector
    certificate: Certificate
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    fit: Fit | None = None
    accepted: tuple[str, ...] = ()
    judged: Verdict | None = None
    fitted_to: tuple[FittedSpan, ...] = ()
    parameter_errors: Vector | None = None
    fitted_under: FittedUnder | None = None
    parameter_quantiles: Vector | None = None
    base_quantiles: Vector | None = None

    def __post_init__(self) -> None:
        p, b, n = len(self.model.layout), len(self.base), len(self.model.torque_joints)
        freeze_arrays(self, {"parameters": (p,), "sigma": (n,)}, self.method)
        shapes = {
            "base_covariance": (b, b),
            "parameter_errors": (p,),
            "parameter_quantiles": (p,),
            "base_quantiles": (b,),
        }
        known = {k: v for k, v in shapes.items() if getattr(self, k) is not None}
        freeze_arrays(self, known, self.method, finite=False)

    def __getitem__(self, name: str) -> float:
        return float(self.parameters[self.model.layout.index(name)])

    def __repr__(self) -> str:
        return (
            f"Estimate({self.method!r}, {len(self.base)} base parameters of "
            f"{len(self.parameters)}, {self.verdict})"
        )

    def __str__(self) -> str:
        return self.table().text()

    def _repr_html_(self) -> str:
        return self.table().html()

    @property
    def verdict(self) -> Verdict:
        """Whether the robot may be used, as stated or by its own evidence.

        `compare` and `Study` have more evidence than an estimate: held-out errors, and
        findings about a log.
        """
        return judge(self.evidence()) if self.judged is None else self.judged

    def evidence(self, *, seed: int = 0) -> Evidence:
        """Return the evidence that the estimate contains itself.

        Parameters
        ----------
        seed : int
            Seed of the poses at which the mass matrix is examined.
        """
        model, x = self.model, self.parameters
        poses = random_poses(model, POSES, seed)
        return Evidence(
            method=self.method,
            optimum=self.certificate.verdict,
            optimum_reason=self.certificate.reason,
            links=link_conditions(model, x),
            least_mass_eigenvalue=least_mass_eigenvalue(model, x, poses),
            fit=self.fit,
            undetermined=self.undetermined,
            accepted=self.accepted,
            loose_trunk=self.loose_trunk,
            size=robot_size(model, x),
        )

    @property
    def loose_trunk(self) -> tuple[str, ...]:
        """Undetermined mass and first moments of a floating base's own body.

        The data may determine their sums with other bodies.
        """
        return loose_trunk(self.model, self.origins)

    @property
    def base_values(self) -> Vector:
        """Base parameters, shape (base,)."""
        return self.base.projection @ self.parameters

    @property
    def standard_errors(self) -> Vector | None:
        """Standard errors of the base parameters; infinite where undetermined."""
        if self.base_covariance is None:
            return None
        return np.sqrt(np.diag(self.base_covariance))

    @property
    def half_intervals(self) -> Vector | None:
        """Half of the 95 % intervals of the standard parameters, shape (parameters,).

        NaN where the data do not determine a parameter, as in `parameter_errors`.
        """
        return self._standard.half_intervals

    @property
    def base_half_intervals(self) -> Vector | None:
        """Half of the 95 % intervals of the base parameters, shape (base,)."""
        return self._combined.half_intervals

    @property
    def error_texts(self) -> tuple[str, ...]:
        """`parameter_errors` for people: a dash where there is none."""
        return self._standard.error_texts

    @property
    def origin_texts(self) -> tuple[str, ...]:
        """`origins` for people: small where the data do not determine the value."""
        return self._standard.origin_texts(self.origins)

    @property
    def error_notes(self) -> tuple[str, ...]:
        """The meaning of `error_texts` and of the words in `origin_texts`."""
        return error_notes(self._standard, self.origin_texts)

    @property
    def _standard(self) -> EstimatedValues:
        """The standard parameters, with their errors."""
        errors, quantiles = self.parameter_errors, self.parameter_quantiles
        return EstimatedValues(self.parameters, errors, quantiles)

    @property
    def _combined(self) -> EstimatedValues:
        """The base parameters, with their errors."""
        errors, quantiles = self.standard_errors, self.base_quantiles
        return EstimatedValues(self.base_values, errors, quantiles)

    @property
    def links(self) -> Array:
        """Inertial parameters, shape (links, 10)."""
        return self.parameters[: self.model.layout.inertial_size].reshape(-1, 10)

    def predict(self, recording: Recording) -> Array:
        """Return the torques that the estimate predicts along a recorded motion.

        Returns
        -------
        ndarray, shape (samples, torque joints), [N m or N]
            In the order of the model's torque joints.

        Raises
        ------
        ProblemError
            If the recording has no velocity or acceleration.
        """
        return predicted_torque(self.model, self.parameters, recording)

    def score(self, recording: Recording) -> TorqueError:
        """Return the error of the predicted torque of a recording.

        Its `stacked` is the relative error of all joints, ``||tau - prediction|| /
        ||tau||``; `relative` and `rms` are joint by joint.

        Raises
        ------
        ProblemError
            If the recording has no torque, no velocity or no acceleration.
        """
        require_type(recording, Recording, "recording")
        if recording.velocity is None or recording.acceleration is None:
            raise without_motion(recording)
        (error,) = torque_errors([self], recording)
        return error

    def uncertainty(
        self,
        recordings: Recording | Sequence[Recording],
        *,
        replicates: int = 200,
        seed: int = 0,
        progress: bool = False,
    ) -> "Uncertainty":
        """Return each parameter's uncertainty: error, bootstrap, and proven interval.

        Only for constrained estimates, which know their constraints, prior and weights.
        For one from a problem file, `Study.uncertainty` needs no data.

        Parameters
        ----------
        recordings : Recording or sequence of Recording
            Those that the estimate was fitted to.
        replicates, seed, progress
            See `bootstrap`.

        Returns
        -------
        Uncertainty
            One entry for each parameter, in the layout's order.

        Raises
        ------
        ProblemError
            If the estimate is not a constrained one, or was fitted to other data.
        NotExcitedError, InfeasibleError, SolverError
            See `consistent_id.uncertainty`.
        """
        from consistent_id.estimation.uncertainties.parameter_uncertainty import (
            uncertainty,
        )

        under = self.fitted_under
        if under is None:
            raise ProblemError(
                f"{self.method} is not known to be a constrained estimate: call "
                "consistent_id.uncertainty(model, segments, constraints=...), or take "
                "standard_errors of least squares"
            )
        logs = several(recordings)
        segments = segment_regressions(self.model, logs, sigma=under.weights)
        found = residual_sigma(merged(segments), self.parameters, len(self.base))
        if not np.allclose(found, self.sigma, rtol=1e-6):
            raise fitted_to_others(self.method, logs, self.fitted_to)
        return uncertainty(
            self.model,
            segments,
            constraints=under.constraints,
            prior=under.prior,
            base=self.base,
            replicates=replicates,
            seed=seed,
            progress=progress,
            sources=segment_sources(logs),
        )

    def plot(
        self,
        recording: Recording,
        *,
        joints: Sequence[str] | None = None,
        axes: Any = None,
    ) -> Any:
        """Draw measured and predicted torque along a recording, joint by joint.

        Each joint's relative error, ``||tau - prediction|| / ||tau||``, stands above
        it.  Without measured torque only the prediction is drawn.  To compare
        estimates, draw one into the axes that another one returned.

        Parameters
        ----------
        recording : Recording
            With velocity and acceleration.
        joints : sequence of str, optional
            Torques to draw; by default all that the model has.
        axes : matplotlib.axes.Axes or array_like of it, shape (joints,), optional
            By default those of a new figure of `matplotlib.pyplot`.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (joints,)

        Raises
        ------
        ProblemError
            If the recording has no velocity or acceleration, a joint has no torque in
            the model, or the number of axes is not that of the joints.
        """
        predicted = self.predict(recording)
        curves = torque_curves(self.model, predicted, recording, joints)
        return draw_torque(curves, self.method, axes)

    def table(self) -> Table:
        """Return the verdict and the parameters, for people.

        For least squares, the table has the base parameters, because the data determine
        only these; else the standard parameters, with the source of each value.
        """
        verdict, layout = self.verdict, self.model.layout
        optimum = f"optimum {self.certificate.verdict}: {self.certificate.reason}"
        notes = (*verdict.lines, optimum, *self.notes)
        if self.standard_errors is None:
            notes += self.error_notes if self.parameter_errors is not None else ()
            known, title = self._standard, verdict.sentence
            return parameter_table(title, known, layout, self.origins, notes)
        notes += tuple(f"not identifiable: {text}" for text in self.undetermined)
        return base_table(verdict.sentence, self._combined, self.base, notes)

    def to_frame(self) -> "DataFrame":
        """Return the standard parameters as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            Indexed by ``parameter``, with columns ``value``, ``standard_error`` (NaN
            where the data do not determine it), ``half_interval`` (half of the 95 %
            interval), ``unit`` and ``determined_by``; the method and the verdict are in
            its ``attrs``.

        Raises
        ------
        ProblemError
            If pandas is not installed.
        """
        frame = parameter_frame(self._standard, self.model.layout, self.origins)
        frame.attrs = {"method": self.method, "verdict": self.verdict.word}
        return frame

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the model as plain numbers and text.

        `load` reads it back; units and base parameters are only for people.
        """
        sigma = zip(self.model.torque_joints, self.sigma.tolist(), strict=True)
        layout = self.model.layout
        return {
            "format": FORMAT,
            "robot": self.model.robot.name,
            "method": self.method,
            **self.verdict.to_dict(),
            "certificate": certificate_record(self.certificate),
            "parameters": parameter_records(self._standard, layout, self.origins),
            "base_parameters": base_records(self._combined, self.base),
            "undetermined": list(self.undetermined),
            "sigma": dict(sigma),
            "notes": list(self.notes),
            "seconds": self.seconds,
            "fit": None if self.fit is None else self.fit.to_dict(),
            "fitted_to": [span._asdict() for span in self.fitted_to],
        }

    def save(self, path: str | Path) -> Path:
        """Write `to_dict` as JSON; the file is complete or not written.

        Figures that are not finite are null, and read again as NaN.
        """
        return write_json(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | Path, model: TorqueModel, base: BaseParameters) -> Self:
        """Read what `save` wrote, for the same torque model.

        Covariances are not kept in the file.

        Parameters
        ----------
        path : str or Path
        model : TorqueModel
            The model of the estimate.
        base : BaseParameters
            Base parameters of the model.

        Raises
        ------
        ProblemError
            If the file is not an estimate of this model.
        """
        record = read_estimate(Path(path), model)
        return cls(model=model, base=base, base_covariance=None, **record.fields(model))


def torque_errors(
    estimates: Sequence[Estimate], recording: Recording
) -> list[TorqueError]:
    """Return the prediction error of each estimate of one model along a recording.

    Raises
    ------
    ProblemError
        If the recording has no torque, or its torque is zero throughout.
    """
    predictions = (
        (e.parameters, None if e.fit is None else e.fit.holding) for e in estimates
    )
    return prediction_errors(estimates[0].model, predictions, recording)
