"""Scenes: reading, describing, saving."""

from orbisim.scene.descriptor import SceneDescriptor
from orbisim.scene.load import load_scene
from orbisim.scene.reading import ReadResult, Unsupported
from orbisim.scene.scene import Scene

__all__ = ["ReadResult", "Scene", "SceneDescriptor", "Unsupported", "load_scene"]
