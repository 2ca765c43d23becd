"""A study as one HTML file: each section a small function of what was found."""

from consistent_id.report.advice import Advice, advise
from consistent_id.report.html import comparison_html, report_html, write_report

__all__ = ["Advice", "advise", "comparison_html", "report_html", "write_report"]
