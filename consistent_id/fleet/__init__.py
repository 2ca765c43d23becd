"""Robots of one type identified together, and logs that are larger than memory."""

from consistent_id.fleet.fleet_result import Fleet, FleetRobot, Outliers
from consistent_id.fleet.identification import fleet_estimate, identify_fleet
from consistent_id.fleet.payloads import CarriedBody, FoundPayload
from consistent_id.fleet.stream import stream_estimate, stream_regression

__all__ = [
    "CarriedBody",
    "Fleet",
    "FleetRobot",
    "FoundPayload",
    "Outliers",
    "fleet_estimate",
    "identify_fleet",
    "stream_estimate",
    "stream_regression",
]
