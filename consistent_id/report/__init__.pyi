from consistent_id.report.page import comparison_html, report_html, write_report
from consistent_id.report.report_content import Advice, advise
from consistent_id.report.results import Results, open_results

__all__ = [
    "Advice",
    "Results",
    "advise",
    "comparison_html",
    "open_results",
    "report_html",
    "write_report",
]
