"""ISO 9283 characteristics with their uncertainty, and the certificate."""

from lmeasure.certification.characteristic import Characteristic, Conformity
from lmeasure.certification.evaluate import SCHEMA, AttainedPath, Evaluation, Excluded, Settings, evaluate
from lmeasure.trajectory.attained import AttainedPose
from lmeasure.trajectory.pose_errors import ErrorModel, ErrorsOfFile, ErrorsOfRun, PoseErrors

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
