"""A backbone whose faults are set: what a model would say of a drive that is known."""

from calm_edge.backbones.scripted.backbone import ScriptedBackbone
from calm_edge.backbones.scripted.batch import DEPTH_STRIDE
from calm_edge.backbones.scripted.errors import ScriptedErrors
from calm_edge.backbones.scripted.scene import Exposures, ScriptedScene
from calm_edge.backbones.scripted.street import Street

__all__ = [
    "DEPTH_STRIDE",
    "Exposures",
    "ScriptedBackbone",
    "ScriptedErrors",
    "ScriptedScene",
    "Street",
]
