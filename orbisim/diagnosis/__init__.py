"""Closing the loop: the residual, the effect behind it, and the scene with that effect.

Each stage takes values that do not change and gives one. In the order in which data flow:

- `run` reads recordings, sets some aside, and puts the stages together.
- `search` goes from move to move. A `context` is what it knows at a time: the data, their noise,
  and derivatives along the best scene so far.
- `proposals` says what to try next: what a regression along the motion ranks (`screening`, with
  what else may change meanwhile, `nuisance`), what one simulation of each suspect ranks where
  bodies touch (`glances`), and many effects at once (`together`, by `selection`).
- `worth` compares two fitted explanations; nothing else decides.
- `conclusion` fits what was found to all windows, and keeps what is surely worth it there.
- `findings`, `alternatives`, `consistency` and `checks` say what that means, with `wording`;
  `sensor_faults` looks at sensors that read no joint; `result` is the `Diagnosis` with its files.
- `force_data`, `force_search` and `force_result` are the same for forces that are known along the
  motion. `rest` lets a network learn what no effect explains.

Below it, `orbisim.shooting` fits explanations to windows of recordings, `orbisim.motion` follows a
recording along a scene, and `orbisim.evidence` has the score.
"""

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
