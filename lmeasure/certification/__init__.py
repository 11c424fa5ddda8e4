"""ISO 9283 characteristics with their uncertainty, and the certificate."""

from lmeasure.certification.attained import AttainedPose
from lmeasure.certification.characteristic import Characteristic, Conformity
from lmeasure.certification.errors_of_poses import ErrorModel, ErrorsOfFile, ErrorsOfRun, PoseErrors
from lmeasure.certification.evaluate import SCHEMA, AttainedPath, Evaluation, Excluded, Settings, evaluate

__all__ = [
    "SCHEMA",
    "AttainedPath",
    "AttainedPose",
    "Characteristic",
    "Conformity",
    "ErrorModel",
    "ErrorsOfFile",
    "ErrorsOfRun",
    "Evaluation",
    "Excluded",
    "PoseErrors",
    "Settings",
    "evaluate",
]
