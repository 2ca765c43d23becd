from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.playable import ValidationPath, validation_trajectory

__all__ = [
    "Aim",
    "ExcitationDesign",
    "PathForm",
    "PredictedAccuracy",
    "ValidationPath",
    "design_trajectory",
    "predicted_accuracy",
    "validation_trajectory",
]
