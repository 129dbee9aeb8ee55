"""Whether an engine does what C MuJoCo does, step by step."""

from orbisim.agreement.first_steps import EngineWarning, FirstSteps
from orbisim.agreement.judge import PERSISTS, Fault, StepJudge, checkable
from orbisim.agreement.rollout import faults_of_rollout

__all__ = [
    "PERSISTS",
    "EngineWarning",
    "Fault",
    "FirstSteps",
    "StepJudge",
    "checkable",
    "faults_of_rollout",
]
