"""Whether least squares can be believed where the motion is noisy: a test.

The test of Durbin, Wu and Hausman [Hausman1978]_ asks whether least squares and
instrumental variables differ by more than noise.  They do if instruments ``Z`` explain
what the regressor ``W`` leaves of the torque, so both are given to one regression.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.estimation.instrumental import instrumented
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.linear import column_sizes
from consistent_id.regression.regressor import TorqueModel

_RANK = 1e-9  # of unit columns, relative to the largest singular value


@dataclass(frozen=True, slots=True)
class EndogeneityTest:
    """The answer of `endogeneity_test`.

    Parameters
    ----------
    statistic : float
        ``F``: misfit that instruments take away, per direction, over what is left per
        effective sample.
    directions : int
        In which instruments differ from the regressor.
    effective_samples : float
        Samples over their correlation length.
    p_value : float
        Of an ``F`` as large by chance, if the motion's noise did not matter.
    """

    statistic: float
    directions: int
    effective_samples: float
    p_value: float

    def __str__(self) -> str:
        verdict = (
            "least squares and instrumental variables differ by more than noise"
            if self.p_value < 0.01
            else "least squares and instrumental variables agree within noise"
        )
        return (
            f"{verdict} (F = {self.statistic:.3g} of {self.directions} directions and "
            f"{self.effective_samples:.0f} effective samples, p = {self.p_value:.2g})"
        )


@single_threaded
def endogeneity_test(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    instruments: Recording | Sequence[Recording],
    *,
    base: BaseParameters | None = None,
) -> EndogeneityTest:
    """Test weighted least squares against instrumental variables.

    A small p-value says that the regressor is correlated with what least squares
    leaves over: by noise in the motion, a delay, or friction that the model lacks.
    Take the noise out, or `instrumental_variables`.

    Parameters
    ----------
    model, recordings, instruments, base
        As for `instrumental_variables`.

    Raises
    ------
    ProblemError
        If there are too few effective samples.
    """
    from scipy.special import fdtrc

    base = base_parameters(model) if base is None else base
    rows = instrumented(model, recordings, instruments, base)
    R, b = rows.stacked, len(base)
    few, alone = _left(R[:, b : 2 * b], R[:, -1])
    rank, both = _left(R[:, : 2 * b], R[:, -1])
    directions = rank - few
    effective = rows.samples / rows.correlation
    freedom = effective - rank
    if directions < 1 or freedom < 1.0:
        raise ProblemError(
            f"{effective:.0f} effective samples and {directions} directions in which "
            "instruments differ from the motion are too few for a test; record longer"
        )
    statistic = ((alone - both) / directions) / (both / freedom)
    p = float(fdtrc(directions, freedom, statistic))
    return EndogeneityTest(float(statistic), directions, float(effective), p)


def _left(A: Matrix, b: Vector) -> tuple[int, float]:
    """Return the rank of columns, and the square that they leave of a vector."""
    U, s, _ = np.linalg.svd(A / column_sizes(A), full_matrices=False)
    rank = int((s > _RANK * s[0]).sum())
    rest = b - U[:, :rank] @ (U[:, :rank].T @ b)
    return rank, float(rest @ rest)
