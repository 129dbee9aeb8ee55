"""Effects that a stage carries: JSON in an attribute `orbisim:effects` of any prim.

UsdPhysics has no latch and no detent. The JSON is a list of effects as MJCF has them in
`<custom><text name="orbisim:effects">`; targets are names of joints, bodies and so on as the scene
has them.
"""

from __future__ import annotations

import json

import mujoco

from orbisim.scene.texts import ACTING, replace_text
from orbisim.scene.usd.context import Context


def add_carried(context: Context, spec: mujoco.MjSpec) -> None:
    """Writes the effects of all prims into the scene.

    Raises:
      SceneError: a text is not a JSON list. Whether effects fit the scene is checked when it is
        compiled.
    """
    name = ACTING[0]
    found: list[object] = []
    for prim in context.prims.values():
        if not prim.authored(name):
            continue
        try:
            entries = json.loads(prim.token(name, "[]"))
        except (ValueError, RecursionError) as error:
            raise prim.error(f"{name} is not JSON ({error})") from None
        if not isinstance(entries, list):
            raise prim.error(f"{name} is {type(entries).__name__}; expected a list of effects")
        found += entries
    if found:
        replace_text(spec, name, found)
