from consistent_id.diagnosis.all_logs import diagnose
from consistent_id.diagnosis.findings import Diagnosis, LogFinding

__all__ = ["Diagnosis", "LogFinding", "diagnose"]
