"""The data detective: what is wrong with a log, before it is used."""

from consistent_id.diagnosis.diagnose import diagnose
from consistent_id.diagnosis.findings import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "diagnose"]
