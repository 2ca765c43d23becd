"""A study in plain numbers and text, ready for JSON."""

from typing import Any

import numpy as np

from consistent_id.comparison.comparison import EstimateReport
from consistent_id.estimation.torque_error import TorqueError
from consistent_id.problems.published import PublishedReport
from consistent_id.problems.study import Study


def study_record(study: Study) -> dict[str, Any]:
    """Return a study as plain numbers and text, ready for JSON."""
    return {
        "format": "consistent_id study 1",
        "problem": study.problem.name,
        "source": study.problem.table.source,
        **study.answer(),
        "recommendation": _recommendation_record(study),
        "excitation": _excitation_record(study),
        "constraint_costs": [
            {
                "constraint": cost.name,
                "misfit_increase": cost.increase,
                "rms_with": cost.rms_with.tolist(),
                "rms_without": cost.rms_without.tolist(),
                "verdict": cost.verdict,
            }
            for cost in study.costs
        ],
        "regularisation_path": _path_record(study),
        "slacks": {method: c.to_dict() for method, c in study.slacks.items()},
        "shadow_prices": [
            {
                "constraint": price.label,
                "price": price.price,
                "cost": _number(price.cost),
                "verdict": price.verdict,
            }
            for price in study.prices
        ],
        "estimates": [_report_record(r) for r in study.comparison.reports],
        "delivered": study.delivered.to_dict(),
        "published": (
            None if study.published is None else _published_record(study.published)
        ),
    }


def _recommendation_record(study: Study) -> dict[str, Any]:
    chosen = study.recommendation
    expected = chosen.expected
    held_out = zip(study.recommended.validation, study.expected_held_out, strict=True)
    return {
        "method": chosen.method,
        "expected_error": None if expected is None else expected.error,
        "expected_range": None if expected is None else [expected.low, expected.high],
        "expected_on": [
            {"recording": error.recording, **forecast.to_dict()}
            for error, forecast in held_out
            if forecast is not None
        ],
        "left_out_errors": {
            method: _number(error)
            for method, error in zip(chosen.candidates, chosen.error, strict=True)
        },
    }


def _excitation_record(study: Study) -> dict[str, Any]:
    return {
        "structural_rank": study.excitation.structural_rank,
        "data_rank": study.excitation.data_rank,
        "condition_numbers": [
            {
                "value": _number(c.value),
                "basis": c.basis,
                "column_scaling": c.scaling,
            }
            for c in study.excitation.condition
        ],
        "undetermined": list(study.excitation.undetermined),
    }


def _path_record(study: Study) -> dict[str, Any]:
    path = study.path
    return {
        "distance": path.distance,
        "weights": path.weights.tolist(),
        "errors": path.errors.tolist(),
        "misfits": path.misfits.tolist(),
        "distances": [_number(d) for d in path.distances],
        "chosen": float(path.weights[path.best]),
    }


def _report_record(report: EstimateReport) -> dict[str, Any]:
    return report.with_verdict.to_dict() | {
        "training": [_error_record(e) for e in report.training],
        "validation": [_error_record(e) for e in report.validation],
        "consistent_links": list(report.consistent_links),
        "base_feasibility": {
            "answer": report.base_feasibility.answer,
            "summary": report.base_feasibility.summary,
            "depth": _number(report.base_feasibility.proof.margin),
            "bound": _number(report.base_feasibility.proof.bound),
            "nearest_torque_change": _to_nearest(report),
        },
        "links": [
            {
                "link": link.link,
                "least_eigenvalue": link.least_eigenvalue,
                "edge": link.edge,
            }
            for link in report.links
        ],
        "least_mass_eigenvalue": report.least_mass_eigenvalue,
        "distance_to_nominal": report.distance_to_nominal.tolist(),
    }


def _to_nearest(report: EstimateReport) -> float | None:
    nearest = report.base_feasibility.nearest
    return None if nearest is None else nearest.torque_change


def _error_record(error: TorqueError) -> dict[str, Any]:
    return {
        "recording": error.recording,
        "rms": error.rms.tolist(),
        "relative": [_number(share) for share in error.relative],
        "mse": error.mse.tolist(),
        "stacked": _number(error.stacked),
    }


def _published_record(report: PublishedReport) -> dict[str, Any]:
    return {
        "parameters": list(report.parametrisation.names),
        "mean": report.mean.tolist(),
        "standard_deviation": report.standard_deviation.tolist(),
        "largest_differences": report.largest_differences,
        "central_inertia": {k: v.tolist() for k, v in report.central_inertia.items()},
        "ranks": [
            {
                "columns": list(rank.columns),
                "rank": rank.rank,
                "singular_values": rank.singular_values.tolist(),
                "null_directions": list(rank.null_directions),
            }
            for rank in (report.all_columns, report.free_columns)
        ],
        "vectors": [
            {
                "name": v.name,
                "answer": v.feasibility.answer,
                "summary": v.feasibility.summary,
                "depth": _number(v.feasibility.proof.margin),
                "bound": _number(v.feasibility.proof.bound),
                "nearest": v.nearest.to_dict(),
                "torque_change": v.torque_change.tolist(),
            }
            for v in report.vectors
        ],
    }


def _number(value: float) -> float | None:
    """Return a number that JSON can represent, or None."""
    return float(value) if np.isfinite(value) else None
