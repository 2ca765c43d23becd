"""An estimate with its provenance: how it came about and how far it can be trusted."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast, get_args

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.extras import pandas
from consistent_id._support.files import write_json
from consistent_id._support.tables import Table
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate_file import FORMAT, read_estimate
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.verdict import Verdict
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.motion_arrays import predicted_torque
from consistent_id.regression.regressor import TorqueModel

if TYPE_CHECKING:
    from pandas import DataFrame

    from consistent_id.estimation.torque_error import TorqueError


@dataclass(frozen=True, slots=True)
class Certificate:
    """OptimumVerdict on an estimate, and the recomputed figures behind it.

    Parameters
    ----------
    verdict : {"certified", "uncertified"}
    reason : str
        In words: what was checked, or what failed.
    figures : dict of str to float
        Residuals, gaps, eigenvalues, by name.
    """

    verdict: OptimumVerdict
    reason: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Parameters of a torque model, estimated from data.

    Parameters
    ----------
    method : str
    model : TorqueModel
    base : BaseParameters
    parameters : array_like, shape (parameters,)
        Standard parameters; only their base parameters are determined by data.
    base_covariance : array_like, shape (base, base), optional
        Of the base parameters, under noise correlated as the residuals are (white, if
        a note says so); None where it has no simple form.
    origins : tuple of str
        What determines each parameter: ``"data"``, ``"combination"`` (data fix only
        sums it is part of), ``"loose"`` (data bound it loosely), ``"constraint"``,
        ``"prior"``, or ``"convention"`` (the smallest vector); see `determinations`.
    undetermined : tuple of str
        Combinations of base parameters that are not identifiable from the data, as
        readable sums.
    sigma : array_like, shape (torque joints,), [N m or N]
        Residual standard deviation of each joint whose torque is known.
    certificate : Certificate
    notes : tuple of str
        What a reader must know before using the numbers.
    seconds : float
        Wall time of the estimation.
    fit : Fit, optional
        How well it explains the data that it was fitted to.
    accepted : tuple of str
        Kinds of reasons that its `verdict` is to overlook, as the user decided.
    judged : Verdict, optional
        By somebody who knows more of it than it does itself; see `EstimateReport`.
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

    def __post_init__(self) -> None:
        p, b, n = len(self.model.layout), len(self.base), len(self.model.torque_joints)
        freeze_arrays(self, {"parameters": (p,), "sigma": (n,)}, self.method)
        if self.base_covariance is not None:
            shape = {"base_covariance": (b, b)}
            freeze_arrays(self, shape, self.method, finite=False)

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
        """Whether the robot may be used: as it was judged, or as it judges itself.

        `compare` and `Study` know more than an estimate: held-out errors, and what is
        wrong with a log.
        """
        if self.judged is not None:
            return self.judged
        from consistent_id.estimation.evidence import evidence_of
        from consistent_id.estimation.judge import judge

        return judge(evidence_of(self))

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

    def score(self, recording: Recording) -> "TorqueError":
        """Return how well the estimate predicts the torque of a recording.

        Its `stacked` is the relative error of all joints, ``||tau - prediction|| /
        ||tau||``; `relative` and `rms` are joint by joint.

        Raises
        ------
        ProblemError
            If the recording has no torque, no velocity or no acceleration.
        """
        from consistent_id.estimation.torque_error import torque_errors

        if recording.velocity is None or recording.acceleration is None:
            raise ProblemError(
                f"{recording.name}: torques need velocity and acceleration; call "
                "signals.differentiated(recording) first"
            )
        (error,) = torque_errors([self], recording)
        return error

    def table(self) -> Table:
        """Return the verdict and the parameters, for people.

        Of what has standard errors the base parameters, which alone are determined by
        the data; else the standard parameters, with what determines each.
        """
        verdict = self.verdict
        title = verdict.sentence
        optimum = f"optimum {self.certificate.verdict}: {self.certificate.reason}"
        notes = (*verdict.lines, optimum, *self.notes)
        units, errors = self.model.layout.units, self.standard_errors
        if errors is None:
            return Table(
                title,
                ("parameter", "value", "unit", "determined by"),
                tuple(
                    (name, f"{value:.6g}", unit, origin)
                    for name, value, unit, origin in zip(
                        self.model.layout.names,
                        self.parameters,
                        units,
                        self.origins,
                        strict=True,
                    )
                ),
                notes,
            )
        return Table(
            title,
            ("base parameter, led by", "value", "standard error", "unit"),
            tuple(
                (name, f"{value:.6g}", f"{error:.2g}", units[i])
                for name, value, error, i in zip(
                    self.base.names,
                    self.base_values,
                    errors,
                    self.base.independent,
                    strict=True,
                )
            ),
            (
                *notes,
                *(f"not identifiable: {text}" for text in self.undetermined),
            ),
        )

    def to_frame(self) -> "DataFrame":
        """Return the standard parameters as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            Indexed by ``parameter``, with columns ``value``, ``unit`` and
            ``rests_on``; the method and the verdict are in its ``attrs``.

        Raises
        ------
        ProblemError
            If pandas is not installed.
        """
        layout = self.model.layout
        frame = pandas().DataFrame(
            {
                "value": self.parameters,
                "unit": list(layout.units),
                "rests_on": list(self.origins),
            },
            index=pandas().Index(layout.names, name="parameter"),
        )
        frame.attrs = {"method": self.method, "verdict": self.verdict.word}
        return frame

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the model as plain numbers and text."""
        errors = self.standard_errors
        layout = self.model.layout
        return {
            "format": FORMAT,
            "robot": self.model.robot.name,
            "method": self.method,
            **self.verdict.to_dict(),
            "certificate": {
                "verdict": self.certificate.verdict,
                "reason": self.certificate.reason,
                "figures": {k: _finite(v) for k, v in self.certificate.figures.items()},
            },
            "parameters": {
                name: {"value": float(value), "unit": unit, "origin": origin}
                for name, value, unit, origin in zip(
                    layout.names,
                    self.parameters,
                    layout.units,
                    self.origins,
                    strict=True,
                )
            },
            "base_parameters": [
                {
                    "name": name,
                    "value": float(value),
                    "standard_error": None if errors is None else _finite(errors[i]),
                    "grouping": grouping,
                }
                for i, (name, value, grouping) in enumerate(
                    zip(
                        self.base.names,
                        self.base_values,
                        self.base.groupings,
                        strict=True,
                    )
                )
            ],
            "undetermined": list(self.undetermined),
            "sigma": dict(
                zip(self.model.torque_joints, self.sigma.tolist(), strict=True)
            ),
            "notes": list(self.notes),
            "seconds": self.seconds,
            "fit": None if self.fit is None else self.fit.to_dict(),
        }

    def save(self, path: str | Path) -> Path:
        """Write `to_dict` as JSON; the file is whole or not there.

        Figures that are not finite are null, and read again as NaN.
        """
        return write_json(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | Path, model: TorqueModel, base: BaseParameters) -> Self:
        """Read what `save` wrote, for the same torque model.

        Covariances are not kept in the file.

        Raises
        ------
        ProblemError
            If the file is not an estimate of this model.
        """
        record = read_estimate(Path(path))
        certificate = record.certificate
        known = certificate.verdict in get_args(OptimumVerdict)
        if record.format != FORMAT or not known:
            raise ProblemError(f"{path}: not an estimate in the form {FORMAT!r}")
        if tuple(record.parameters) != model.layout.names or set(record.sigma) != set(
            model.torque_joints
        ):
            raise ProblemError(
                f"{path}: its parameters are not those of robot "
                f"{model.robot.name!r} with these drive terms"
            )
        return cls(
            method=record.method,
            model=model,
            base=base,
            parameters=np.array([entry.value for entry in record.parameters.values()]),
            base_covariance=None,
            origins=tuple(entry.origin for entry in record.parameters.values()),
            undetermined=tuple(record.undetermined),
            sigma=np.array([record.sigma[j] for j in model.torque_joints]),
            certificate=Certificate(
                cast(OptimumVerdict, certificate.verdict),
                certificate.reason,
                certificate.known_figures,
            ),
            notes=tuple(record.notes),
            seconds=record.seconds,
            fit=record.fit_value(),
            accepted=tuple(record.accepted),
            judged=record.verdict_value(),
        )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
