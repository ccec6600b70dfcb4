"""A backbone whose faults are set: what a model would say of a drive that is known."""

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
