"""Strips of rollouts: the true images above, the diffusion renderer's below, their difference last.

python tools/vision_pictures.py DATA.h5 --out docs/images/vision.webp [--episodes 0 3]

With `--declared OTHER.h5`, a row below the true images shows the same episodes from another file:
of a camera that the scene does not declare (tools/real_camera.py), what MuJoCo makes of the scene.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import numpy.typing as npt
import torch
from orbisim_diffusion.checkpoint import load_checkpoint
from orbisim_diffusion.model import Painter
from orbisim_diffusion.predictions import predict, with_predictions
from orbisim_diffusion.store import Store, load
from orbisim_diffusion.workflows import rollout
from orbisim_diffusion.zoo import FOLDER

from orbisim.report.video import difference

_TIMES = (1, 20, 40, 60, 80, 100)
"""Frames that are shown."""


def main() -> None:
    """Writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="episodes with images")
    parser.add_argument("--out", type=Path, required=True, help="a .png file")
    parser.add_argument("--checkpoint", type=Path, default=FOLDER / "push")
    parser.add_argument("--episodes", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--steps", type=int, default=1, help="of the sampler")
    parser.add_argument("--declared", type=Path, help="the same episodes as another file has them")
    parser.add_argument("--predicted", action="store_true", help="states of the learned backend")
    arguments = parser.parse_args()
    device = torch.device("cpu")
    painter = Painter.of(load_checkpoint(arguments.checkpoint), device)
    store = load([arguments.data], device, limit=max(arguments.episodes) + 1)
    states = store
    if arguments.predicted:
        made = predict(arguments.data, range(max(arguments.episodes) + 1))
        states = with_predictions(store, made)
    other = None
    if arguments.declared:
        other = load([arguments.declared], device, limit=max(arguments.episodes) + 1)
    strips = [
        one(painter, store, states, number, arguments.steps, other) for number in arguments.episodes
    ]
    iio.imwrite(arguments.out, np.concatenate(strips))


def one(
    painter: Painter, store: Store, states: Store, number: int, steps: int, other: Store | None
) -> npt.NDArray[np.uint8]:
    """The strip of one episode."""
    times = [t for t in _TIMES if t < int(store.length[number])]
    index = torch.tensor([number])
    made = rollout(painter, states, index, "GT-first", times[-1], steps)[0].numpy()
    true = store.frames[store.first[number] + torch.tensor(times)].numpy()
    ours = made[[t - 1 for t in times]]
    rows = [true, ours, np.stack(difference(list(true), list(ours)))]
    if other is not None:
        rows.insert(1, other.frames[other.first[number] + torch.tensor(times)].numpy())
    return np.concatenate([np.concatenate(list(row), axis=1) for row in rows])


if __name__ == "__main__":
    main()
