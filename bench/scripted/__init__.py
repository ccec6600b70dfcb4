"""Scripted backbone: predictions from the ground truth of a drive, with configured errors."""

from bench.scripted.backbone import ScriptedBackbone
from bench.scripted.batch import DEPTH_STRIDE
from bench.scripted.errors import ScriptedErrors
from bench.scripted.scene import Exposures, ScriptedScene
from bench.scripted.street import Street

__all__ = [
    "DEPTH_STRIDE",
    "Exposures",
    "ScriptedBackbone",
    "ScriptedErrors",
    "ScriptedScene",
    "Street",
]
