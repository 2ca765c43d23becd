"""Section: the torque residual, and its implications for the model."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.regression.correlation_lengths import correlation_length
from consistent_id.regression.torque_along import measured_torque
from consistent_id.report.markup import Html, folded, grid, joined, paragraphs, tag
from consistent_id.report.plot import Frame, band, dots, line, plot, spanning, stems
from consistent_id.report.report_content import (
    ReportContent,
    Section,
    angle_unit,
    torque_unit,
)
from consistent_id.robot.model import Joint

BINS = 12
"""Intervals of position or velocity in which residuals are averaged."""

LAGS = 100
"""Least number of lags of an autocorrelation."""


@dataclass(frozen=True, slots=True, eq=False)
class Binned:
    """Residuals averaged over intervals of another quantity with like many samples.

    Parameters
    ----------
    centres, means : ndarray, shape (bins,)
    explained : float
        Share of the residual's variance that the means explain, less the share expected
        by chance; NaN where there are too few independent samples.
    """

    centres: Vector
    means: Vector
    explained: float


@dataclass(frozen=True, slots=True, eq=False)
class ResidualStatistics:
    """Figures of one joint's residual.

    Parameters
    ----------
    rms, mean : float, [N m or N]
    correlation : float
        Samples that carry the information of one independent sample.
    autocorrelation : ndarray, shape (lags + 1,)
        One at lag zero.
    bound : float
        Bound of 95 % of a white residual's autocorrelations.
    drift, drift_error : float, [N m/min or N/min]
        Slope of a straight line over time and its standard error, which counts
        independent samples only.
    """

    rms: float
    mean: float
    correlation: float
    autocorrelation: Vector
    bound: float
    drift: float
    drift_error: float
    by_position: Binned
    by_velocity: Binned

    @property
    def white_share(self) -> float:
        """Share of the autocorrelations within a white residual's bound."""
        return float(np.mean(abs(self.autocorrelation[1:]) <= self.bound))


def residual_statistics(
    residual: Vector, time: Vector, position: Vector, velocity: Vector
) -> ResidualStatistics:
    """Examine one joint's residual.

    Parameters
    ----------
    residual : ndarray, shape (samples,), [N m or N]
    time : ndarray, shape (samples,), [s]
    position, velocity : ndarray, shape (samples,)
        Motion of the same joint.
    """
    n, rms = len(residual), float(np.sqrt(np.mean(residual**2)))
    centred = residual - residual.mean()
    length = correlation_length([centred], np.array([max(rms, 1e-300)]))
    independent = n / length
    lags = min(max(LAGS, int(2 * length)), n - 1)
    slope, error = _slope(time / 60.0, centred, independent)
    return ResidualStatistics(
        rms=rms,
        mean=float(residual.mean()),
        correlation=length,
        autocorrelation=autocorrelation(centred, lags),
        bound=1.96 / np.sqrt(n),
        drift=slope,
        drift_error=error,
        by_position=binned(residual, position, independent),
        by_velocity=binned(residual, velocity, independent),
    )


def autocorrelation(centred: Vector, lags: int) -> Vector:
    """Return ``sum_t r_t r_(t+k) / sum_t r_t^2`` for lags up to `lags`."""
    size = 2 ** int(np.ceil(np.log2(2 * len(centred))))
    power = abs(np.fft.rfft(centred, size)) ** 2
    sums = np.fft.irfft(power, size)[: lags + 1]
    return np.asarray(sums / max(float(sums[0]), 1e-300))


def binned(residual: Vector, against: Vector, independent: float) -> Binned:
    """Average a residual over intervals of another quantity.

    With ``R^2`` the share of the variance between intervals, the share explained is
    ``1 - (1 - R^2) (n - 1) / (n - bins)``, ``n`` the number of independent samples.
    """
    order = np.argsort(against, kind="stable")
    parts = np.array_split(order, min(BINS, len(order)))
    means = np.array([residual[part].mean() for part in parts])
    centres = np.array([against[part].mean() for part in parts])
    weights = np.array([len(part) for part in parts])
    total = float(np.sum((residual - residual.mean()) ** 2))
    between = float(np.sum(weights * (means - residual.mean()) ** 2))
    free = independent - len(parts)
    if total == 0.0 or free < 1.0:
        return Binned(centres, means, np.nan)
    explained = 1.0 - (1.0 - between / total) * (independent - 1.0) / free
    return Binned(centres, means, max(explained, 0.0))


def _slope(time: Vector, centred: Vector, independent: float) -> tuple[float, float]:
    """Return the slope of a straight line, and its standard error."""
    t = time - time.mean()
    power = float(t @ t)
    slope = float(t @ centred) / power
    rest = centred - slope * t
    # Independent samples spread over the same times: power shrinks as their number.
    variance = float(rest @ rest) / max(independent - 2.0, 1.0)
    return slope, float(np.sqrt(variance / power))


_DOTS = 300
_STEMS = 100
_WINDOWS = 24


def residuals_section(content: ReportContent) -> Section | None:
    """Return residual diagnostics of the main estimate; None without recordings.

    Only joints are examined, because a base has no single velocity or position.
    """
    if not content.held_out or not content.joint_rows:
        return None
    lead = paragraphs(
        f"Of the {content.main.estimate.method} estimate. A complete model leaves "
        "white noise: no correlation beyond the bounds, no part that position or "
        "velocity explains, no drift. A part that velocity explains is friction that "
        "the model lacks. A part that position explains is gravity, springs or "
        "cogging. Drift comes from temperature or an amplifier.",
        "Filters before identification correlate neighbouring samples by themselves.",
    )
    shown = [
        folded(f"On {r.name}", _of(content, r), open_=i == 0)
        for i, r in enumerate(content.held_out)
    ]
    return Section("residuals", "Residuals", joined((lead, *shown)))


def _of(content: ReportContent, recording: Recording) -> Html:
    model = content.model
    rest = measured_torque(model, recording) - content.main.estimate.predict(recording)
    moved = recording.of(model.robot.joint_names)
    rows, drawn = [], []
    for column, joint in content.joint_rows:
        r = rest[:, column]
        k = model.robot.joint_names.index(joint.name)
        q, dq = moved.position[:, k], velocities(moved)[:, k]
        found = residual_statistics(r, recording.time, q, dq)
        rows.append(_row(joint, found, recording.rate))
        drawn.append(tag("h4", joint.name))
        drawn.append(_panels(joint, r, recording, q, dq, found))
    header = (
        "joint",
        "RMS",
        "mean",
        "unit",
        "independent every [s]",
        "within white bounds",
        "by velocity",
        "by position",
        "drift per minute",
    )
    note = (
        "By velocity, by position: share of the residual's variance that twelve means "
        "explain, minus the share expected by chance. Drift: with its standard error, "
        "which counts independent samples only."
    )
    return joined((grid(header, rows), paragraphs(note, class_="notes"), *drawn))


def _row(joint: Joint, found: ResidualStatistics, rate: float) -> list[object]:
    sure = abs(found.drift) > 2.0 * found.drift_error
    drift = f"{found.drift:+.2g} ± {found.drift_error:.1g}"
    return [
        joint.name,
        f"{found.rms:.3g}",
        f"{found.mean:.2g}",
        torque_unit(joint),
        f"{found.correlation / rate:.3g}",
        f"{found.white_share:.0%}",
        _share(found.by_velocity),
        _share(found.by_position),
        tag("strong", drift) if sure else drift,
    ]


def _share(found: Binned) -> str:
    return "-" if np.isnan(found.explained) else f"{found.explained:.0%}"


def _panels(
    joint: Joint,
    r: Vector,
    recording: Recording,
    q: Vector,
    dq: Vector,
    found: ResidualStatistics,
) -> Html:
    unit, angle = torque_unit(joint), angle_unit(joint)
    return tag(
        "div",
        _whiteness(found, recording.rate),
        _against(r, dq, found.by_velocity, f"velocity [{angle}/s]", unit),
        _against(r, q, found.by_position, f"position [{angle}]", unit),
        _over_time(r, recording.time, unit),
        class_="panels",
    )


def _whiteness(found: ResidualStatistics, rate: float) -> Html:
    rho = found.autocorrelation
    thin = slice(None, None, max(1, len(rho) // _STEMS))
    lags = np.arange(len(rho)) / rate
    ends = lags[[0, -1]]
    bound = np.full(2, found.bound)
    frame = Frame((0.0, float(lags[-1])), (min(-0.25, float(rho.min()) - 0.05), 1.05))
    return plot(
        frame,
        band(frame, ends, -bound, bound, "area"),
        stems(frame, lags[thin], rho[thin], "curve main"),
        across="lag [s]",
        down="autocorrelation",
    )


def _against(r: Vector, x: Vector, found: Binned, name: str, unit: str) -> Html:
    thin = slice(None, None, max(1, len(r) // _DOTS))
    frame = Frame(spanning([x]), spanning([r]))
    return plot(
        frame,
        dots(frame, x[thin], r[thin], "measured"),
        line(frame, found.centres, found.means, "curve main bold"),
        across=name,
        down=f"residual [{unit}]",
    )


def _over_time(r: Vector, time: Vector, unit: str) -> Html:
    """Draw mean and root-mean-square in windows."""
    windows = np.array_split(np.arange(len(r)), min(_WINDOWS, len(r)))
    t = np.array([time[w].mean() for w in windows])
    mean = np.array([r[w].mean() for w in windows])
    rms = np.array([np.sqrt(np.mean(r[w] ** 2)) for w in windows])
    frame = Frame((float(time[0]), float(time[-1])), spanning([-rms, rms, mean]))
    return plot(
        frame,
        band(frame, t, -rms, rms, "area"),
        line(frame, t, mean, "curve main bold"),
        across="time [s]",
        down=f"mean, RMS [{unit}]",
    )
