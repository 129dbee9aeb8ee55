"""From measured data to the missing effect: an arm whose scene lacks friction."""

from pathlib import Path

import orbisim
from orbisim.diagnosis import Settings

folder = Path("mjcf_assets/arm2")
recordings = [orbisim.Recording.load(path) for path in sorted(folder.glob("example/run*.npz"))]

# all of the catalogue is searched by default; two effects are quicker
settings = Settings(effects=("coulomb_friction", "viscous_damping"))
found = orbisim.diagnose(folder / "scene.xml", recordings, settings=settings, progress=False)

print(found.verdict)
print(found.sentence)
print(found.patch.text)  # what to change in scene.xml
before, after = (orbisim.replay(s, recordings).rms for s in (found.scene, found.augmented_scene))
print(f"replay error {before:.3g} -> {after:.3g} rad")
