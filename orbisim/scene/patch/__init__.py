"""A patch of the user's own MJCF files that makes of their scene another one.

Stages: `marked` reads the files with the place of every element, `differences` compares two
documents as MuJoCo writes them, `editing` carries the differences over into the files, `making`
compiles the result and writes the patch.
"""

from orbisim.scene.patch.making import Patch, patch_of

__all__ = ["Patch", "patch_of"]
