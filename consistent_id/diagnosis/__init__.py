"""What is wrong with a log, found before anything is estimated from it."""

from consistent_id.diagnosis.diagnose import diagnose
from consistent_id.diagnosis.findings import Diagnosis, LogFinding

__all__ = ["Diagnosis", "LogFinding", "diagnose"]
