"""Scenes: reading, describing, saving."""

from orbisim.scene.descriptor import SceneDescriptor
from orbisim.scene.load import load_scene, named_scene
from orbisim.scene.objects import SceneSource
from orbisim.scene.reading import Reader, ReadResult, Unsupported
from orbisim.scene.scene import Scene

__all__ = [
    "ReadResult",
    "Reader",
    "Scene",
    "SceneDescriptor",
    "SceneSource",
    "Unsupported",
    "load_scene",
    "named_scene",
]
