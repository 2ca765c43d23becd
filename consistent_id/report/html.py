"""Studies and comparisons as one HTML file."""

from collections.abc import Sequence
from pathlib import Path

from consistent_id._support.files import write_atomically
from consistent_id.comparison.comparison import Comparison
from consistent_id.diagnosis import Diagnosis
from consistent_id.estimation.uncertainties.parameter_uncertainty import Uncertainty
from consistent_id.problems.study import Study
from consistent_id.recordings.recording import Recording
from consistent_id.report.advice import advise
from consistent_id.report.page import page
from consistent_id.report.report_content import ReportContent, Section


def report_html(
    study: Study,
    *,
    uncertainty: Uncertainty | None = None,
    further: Sequence[Section] = (),
    command: str = "",
) -> str:
    """Return a study as one HTML file, which needs no other file and no network.

    Parameters
    ----------
    study : Study
    uncertainty : Uncertainty, optional
        Of its constrained estimate.
    further : sequence of Section
        Additional sections, such as that of rollouts.
    command : str
        Command that reproduces the report.

    Examples
    --------
    >>> import consistent_id as ci
    >>> study = ci.run_study(ci.load_problem("problems/rx60"))
    >>> ci.report.report_html(study).splitlines()[0]
    '<!doctype html>'
    """
    return page(
        ReportContent(
            title=study.problem.name,
            comparison=study.comparison,
            advice=advise(study.comparison, recommendation=study.recommendation),
            training=study.training,
            validation=study.validation,
            problem=study.problem,
            excitation=study.excitation,
            diagnosis=study.diagnosis,
            uncertainty=uncertainty,
            costs=study.costs,
            prices=study.prices,
            path=study.path,
            published=study.published,
            delivered=study.delivered,
            further=tuple(further),
            seed=None if uncertainty is None else study.seed,
            command=command,
        )
    )


def write_report(
    study: Study,
    path: str | Path,
    *,
    uncertainty: Uncertainty | None = None,
    further: Sequence[Section] = (),
    command: str = "",
) -> Path:
    """Write `report_html` to a file, whole or not at all; return its path.

    Parameters
    ----------
    study : Study
    path : str or Path
    uncertainty, further, command
        See `report_html`.

    Raises
    ------
    ProblemError
        If the file cannot be written.

    Examples
    --------
    >>> import consistent_id as ci
    >>> import tempfile
    >>> from pathlib import Path
    >>> study = ci.run_study(ci.load_problem("problems/rx60"), costs=False)
    >>> ci.write_report(study, Path(tempfile.mkdtemp(), "report.html")).name
    'report.html'
    """
    html = report_html(
        study,
        uncertainty=uncertainty,
        further=further,
        command=command,
    )
    return write_atomically(path, html)


def comparison_html(
    comparison: Comparison,
    *,
    training: Sequence[Recording] = (),
    validation: Sequence[Recording] = (),
    diagnosis: Diagnosis | None = None,
    uncertainty: Uncertainty | None = None,
) -> str:
    """Return a comparison as one HTML file; unknown parts have no section.

    Parameters
    ----------
    comparison : Comparison
    training, validation : sequence of Recording
        Of which torque and residuals are drawn.
    diagnosis, uncertainty
        See `report_html`.
    """
    return page(
        ReportContent(
            title=comparison.model.robot.name,
            comparison=comparison,
            advice=advise(comparison, diagnosis),
            training=tuple(training),
            validation=tuple(validation),
            diagnosis=diagnosis,
            uncertainty=uncertainty,
        )
    )
