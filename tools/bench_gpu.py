"""Throughput of a batched rollout on backend `warp` against MuJoCo-Warp alone in a CUDA graph.

    python tools/bench_gpu.py [--model humanoid.xml] [--worlds 4096] [--steps 500] [--out FILE]

Both sides get the same model, initial state, buffer sizes and controls; every world has controls
of its own, and they change with every step. MuJoCo-Warp alone copies the controls of a step and
launches the graph of a step, and keeps nothing but the last state. OrbiSim's rollout also records
every state and looks for worlds that diverged. Runs alternate; the ratio is the median of the
pairs. Without --model, dm_control's humanoid is taken from where it is installed.

Needs mujoco, mujoco-warp, numpy, defusedxml, and torch for `--arrays torch`; neither dm_control
nor an installation of OrbiSim. On a machine without a GPU it runs on the CPU, for a rehearsal:
    python tools/bench_gpu.py --worlds 4 --steps 5 --repeats 2 --device cpu
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.metadata
import importlib.util
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "backends")]

import mujoco  # noqa: E402
import mujoco_warp as mjw  # noqa: E402
import numpy as np  # noqa: E402
import warp as wp  # noqa: E402
from orbisim_warp import WarpBackend  # noqa: E402

from orbisim.scene import load_scene  # noqa: E402

GOAL = 0.95
MAX_CONTROLS = 2**31
"""Bytes of controls that are made at most."""


def main() -> int:
    """Measures, prints one JSON object, and writes it to --out."""
    options = arguments()
    scene = load_scene(options.model or dm_control_humanoid(), trusted=True)
    model = scene.model
    if options.worlds * options.steps * model.nu * 4 > MAX_CONTROLS:
        raise SystemExit("the controls would take more than 2 GB; ask for fewer steps")
    controls = random_controls(model, options.worlds, options.steps)
    backend = WarpBackend(nworld=options.worlds, device=options.device, arrays=options.arrays)
    backend.load(scene)
    result = describe(options, model, backend)
    note("first rollout: compiles kernels, finds the sizes of the buffers")
    ours = Ours(backend, controls)
    result["first_rollout_s"] = ours()
    sizes = {"naconmax": backend._data.naconmax, "njmax": backend._data.njmax}
    theirs = Raw(model, controls, backend.device, sizes)
    note("first run of MuJoCo-Warp alone")
    theirs()
    result |= {"buffers": sizes, **measured(ours, theirs, options)}
    result["apart_after_one_step"] = apart(ours, theirs)
    text = json.dumps(result, indent=1)
    print(text)
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(text + "\n")
    return 0


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", type=Path, help="MJCF file. Default: dm_control's humanoid")
    parser.add_argument("--worlds", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--repeats", type=int, default=7, help="pairs of runs")
    parser.add_argument("--device", default=None, help="cpu, cuda or cuda:N. Default: Warp's")
    parser.add_argument("--arrays", choices=["torch", "numpy"], default="torch")
    parser.add_argument("--out", type=Path, help="file for the result")
    return parser.parse_args()


def dm_control_humanoid() -> Path:
    """The humanoid of dm_control's suite, without importing it."""
    spec = importlib.util.find_spec("dm_control")
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit("dm_control is not installed; pass --model with an MJCF file")
    return Path(next(iter(spec.submodule_search_locations))) / "suite" / "humanoid.xml"


def random_controls(model: mujoco.MjModel, worlds: int, steps: int) -> np.ndarray:
    """[worlds, steps, nu] uniform in the middle half of each control range."""
    draw = np.random.default_rng(0)
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -1.0)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 1.0)
    unit = draw.uniform(-0.5, 0.5, (worlds, steps, model.nu))
    return np.asarray((low + high) / 2 + (high - low) / 2 * unit, np.float32)


class Ours:
    """A rollout through OrbiSim; calling it returns the seconds that it took."""

    def __init__(self, backend: WarpBackend, controls: np.ndarray) -> None:
        self.backend, self.state = backend, backend.reset()
        self.controls: Any = controls
        if not isinstance(self.state.qpos, np.ndarray):
            import torch

            self.controls = torch.as_tensor(controls, device=self.state.qpos.device)
        self.qpos: Any = None
        self.lost = 0

    def __call__(self) -> float:
        """Seconds of one rollout."""
        wp.synchronize()
        began = time.perf_counter()
        trajectory = self.backend.rollout(self.state, self.controls, sensors=False)
        wp.synchronize()
        elapsed = time.perf_counter() - began
        self.lost = int((trajectory.diverged_at >= 0).sum())
        self.qpos = trajectory.qpos[:, 0]
        return elapsed


@dataclasses.dataclass
class Raw:
    """MuJoCo-Warp alone: on a GPU the graph of a step, launched for every step."""

    model: mujoco.MjModel
    controls: np.ndarray
    device: str
    sizes: dict[str, int]

    def __post_init__(self) -> None:
        with wp.ScopedDevice(self.device):
            self.warp_model = mjw.put_model(self.model)
            self.warp_model.opt.run_rne_postconstraint = False  # as in the rollout
            self.warp_model.opt.warn_overflow = 0
            self.data = mjw.make_data(self.model, nworld=len(self.controls), **self.sizes)
            by_step = np.ascontiguousarray(self.controls.transpose(1, 0, 2))
            self.by_step = wp.array(by_step, dtype=float)
            self.step: Callable[[], None] = self._step
            self._step()  # loads the kernels; a capture cannot
            if wp.get_device(self.device).is_cuda:
                with wp.ScopedCapture() as capture:
                    self._step()
                self.step = lambda: wp.capture_launch(capture.graph)

    def _step(self) -> None:
        mjw.step(self.warp_model, self.data)

    def __call__(self, steps: int | None = None) -> float:
        """Seconds of all steps, or of the first few."""
        with wp.ScopedDevice(self.device):
            mjw.reset_data(self.warp_model, self.data)
            wp.synchronize()
            began = time.perf_counter()
            size = self.data.ctrl.size
            for t in range(steps or self.controls.shape[1]):
                if size:
                    wp.copy(self.data.ctrl, self.by_step, src_offset=t * size, count=size)
                self.step()
            wp.synchronize()
            return time.perf_counter() - began


def measured(ours: Ours, theirs: Raw, options: argparse.Namespace) -> dict[str, Any]:
    """Alternating runs."""
    total = options.worlds * options.steps
    pairs = []
    for repeat in range(options.repeats):
        pairs.append((total / ours(), total / theirs()))
        note(f"{repeat + 1}: OrbiSim {pairs[-1][0]:.4g}, MuJoCo-Warp {pairs[-1][1]:.4g} steps/s")
    ratio = statistics.median(a / b for a, b in pairs)
    return {
        "orbisim_steps_per_s": statistics.median(a for a, _ in pairs),
        "mujoco_warp_steps_per_s": statistics.median(b for _, b in pairs),
        "ratio": ratio,
        "ratios": [a / b for a, b in pairs],
        "goal": GOAL,
        "reached": ratio >= GOAL,
        "diverged_worlds": ours.lost,
    }


def apart(ours: Ours, theirs: Raw) -> float:
    """Largest difference between the two sides after the first step: both do the same work."""
    theirs(1)
    mine = ours.qpos if isinstance(ours.qpos, np.ndarray) else ours.qpos.cpu().numpy()
    return float(np.abs(mine - theirs.data.qpos.numpy()).max())


def describe(
    options: argparse.Namespace, model: mujoco.MjModel, backend: WarpBackend
) -> dict[str, Any]:
    """What is measured, on what."""
    device = wp.get_device(backend.device)
    packages = ("mujoco", "mujoco-warp", "warp-lang", "torch", "numpy")
    return {
        "schema": "orbisim.bench_gpu/1",
        "model": (options.model or dm_control_humanoid()).name,
        "nv": model.nv,
        "nu": model.nu,
        "timestep_s": model.opt.timestep,
        "worlds": options.worlds,
        "steps": options.steps,
        "repeats": options.repeats,
        "arrays": options.arrays,
        "device": str(device),
        "device_name": device.name,
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
    }


def version(package: str) -> str | None:
    """Of an installed package; None if it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def note(text: str) -> None:
    """A line of progress."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
