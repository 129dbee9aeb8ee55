"""Closing the loop: the residual, the effect behind it, and the scene with that effect."""

from orbisim.diagnosis.found import Alternative, Retuned
from orbisim.diagnosis.result import Diagnosis
from orbisim.diagnosis.run import diagnose
from orbisim.diagnosis.settings import Settings
from orbisim.effects.estimate import Estimate, FoundEffect

__all__ = [
    "Alternative",
    "Diagnosis",
    "Estimate",
    "FoundEffect",
    "Retuned",
    "Settings",
    "diagnose",
]
