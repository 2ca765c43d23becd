"""Results for people: tables, figures, and a study as one HTML file."""

from consistent_id.report.advice import Advice, advise
from consistent_id.report.html import comparison_html, report_html, write_report

__all__ = ["Advice", "advise", "comparison_html", "report_html", "write_report"]
