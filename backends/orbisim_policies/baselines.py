"""SAC, PPO and PPO with random network distillation, by Stable-Baselines3, in C MuJoCo."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from orbisim_world_model.progress_file import load_progress, save_progress
from torch import Tensor

from orbisim.errors import InputError, MissingDependencyError
from orbisim.files.locking import claimed
from orbisim.files.writing import make_folder
from orbisim.vector.stable_baselines import AlikeWorlds
from orbisim.version import VERSION
from orbisim_policies import learner_state
from orbisim_policies.checkpoint import load_policy, save_policy
from orbisim_policies.evaluate import in_mujoco, starts_of, summary
from orbisim_policies.network import NetworkConfig, Policy
from orbisim_policies.problem import Problem
from orbisim_policies.run import (
    DTYPES,
    METRICS,
    Report,
    Run,
    append_metrics,
    begin_metrics,
    check_run,
    draw_curves,
    training_seeds,
)
from orbisim_policies.successive import SuccessiveEpisodes

try:
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback
except ImportError as error:
    raise MissingDependencyError("orbisim_policies.baselines", "sb3", str(error)) from None


@dataclasses.dataclass(frozen=True)
class Baseline:
    """How a baseline is trained; what is not said here is Stable-Baselines3's default.

    Attributes:
      method: `sac`, `ppo` or `ppo_rnd`.
      batch: worlds at once. rate: of Adam. network: hidden widths, as the others have.
      window: control steps of each world between updates of PPO.
      curiosity: weight of the intrinsic reward of `ppo_rnd`.
      updates: of SAC after a control step in every world; one for eight worlds if 0.
      returns: control steps of rewards before SAC's own value of what follows (n-step returns):
        with 1, a reward at the end of an episode comes back one control step at a time.
    """

    method: str
    batch: int = 16
    rate: float = 3e-4
    network: NetworkConfig = dataclasses.field(default_factory=NetworkConfig)
    window: int = 128
    curiosity: float = 0.05
    updates: int = 0
    returns: int = 1


LINE = 4096
"""Control steps between lines of metrics, the same in a training that was killed on its way: one of
PPO's rollouts in 32 worlds."""


class ProblemVecEnv(AlikeWorlds):
    """`SuccessiveEpisodes` as Stable-Baselines3 sees them.

    `infos[i]["diverged"]` is there for a world that did, and `diverged` counts it.

    Args:
      episodes: that it hands on; `close` closes them.
    """

    def __init__(self, episodes: SuccessiveEpisodes) -> None:
        self.episodes, self.worlds = episodes, episodes.worlds
        self.problem = problem = episodes.problem
        self._action: Any = None
        box = gymnasium.spaces.Box
        super().__init__(
            episodes.nworld,
            box(-np.inf, np.inf, (problem.observations,), np.float32),
            box(-1.0, 1.0, (problem.actions,), np.float32),
        )

    @property
    def diverged(self) -> npt.NDArray[np.int64]:
        """[nworld] how often each world has diverged."""
        return self.worlds.diverged

    def reset(self) -> npt.NDArray[np.float32]:
        """An episode in every world."""
        view = self.episodes.reset()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return view.numpy()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Keeps the actions for `step_wait`."""
        self._action = torch.as_tensor(np.asarray(actions), dtype=torch.float32)

    def step_wait(self) -> tuple[Any, Any, Any, list[dict[str, Any]]]:
        """One control step in every world; those whose episode ends begin the next one."""
        turn = self.episodes.step(self._action)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(turn.done):
            last, cut = turn.last[world].numpy(), bool(turn.cut[world])
            infos[world] = {"terminal_observation": last, "TimeLimit.truncated": cut}
            if turn.lost[world]:
                infos[world]["diverged"] = True
            else:
                names = zip(self.problem.parts, turn.parts[world].tolist(), strict=True)
                infos[world]["parts"] = dict(names)
        return turn.view.numpy(), turn.reward, turn.done, infos

    def state(self) -> dict[str, Tensor]:
        """All that episodes go on from, by name."""
        return self.episodes.state()

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Takes what `state` gave."""
        self.episodes.restore(tensors)

    def close(self) -> None:
        """Frees the worlds."""
        self.episodes.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of each world: one for all."""
        value = None if attr_name == "render_mode" else getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]


class Curiosity:
    """Random network distillation (Burda et al. 2018): what a network cannot predict yet is new.

    Args:
      observations: how many. seed: of both networks.
    """

    def __init__(self, observations: int, seed: int = 0) -> None:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.target, self.guess = (_small(observations) for _ in range(2))
        self.target.requires_grad_(False)
        self._optimizer = torch.optim.Adam(self.guess.parameters(), 1e-3)
        self._square, self._count = 1.0, 1e-4

    def reward(self, observation: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """[N]: the error, in units of its running root mean square; the guess is improved."""
        seen = torch.as_tensor(observation, dtype=torch.float32).clamp(-5.0, 5.0)
        error = (self.guess(seen) - self.target(seen)).square().mean(1)
        self._optimizer.zero_grad()
        error.mean().backward()
        self._optimizer.step()
        new = error.detach().double().numpy()
        self._count += len(new)
        self._square += (float(np.square(new).sum()) - len(new) * self._square) / self._count
        return np.asarray(new / np.sqrt(self._square + 1e-12))

    def state(self) -> dict[str, Tensor]:
        """What it goes on from, by name."""
        found = {"running": torch.tensor([self._square, self._count], dtype=torch.float64)}
        found |= {f"guess/{name}": tensor for name, tensor in self.guess.state_dict().items()}
        entries = self._optimizer.state_dict()["state"]
        return found | {f"adam/{i}/{n}": t for i, row in entries.items() for n, t in row.items()}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Takes what `state` gave."""
        self._square, self._count = tensors["running"].tolist()
        names = self.guess.state_dict()
        self.guess.load_state_dict({name: tensors[f"guess/{name}"] for name in names})
        optimizer = self._optimizer.state_dict()
        rows: dict[int, dict[str, Tensor]] = {}
        for name, tensor in tensors.items():
            kind, _, rest = name.partition("/")
            if kind == "adam":
                rows.setdefault(int(rest.split("/")[0]), {})[rest.split("/")[1]] = tensor
        self._optimizer.load_state_dict({**optimizer, "state": rows})


class _Progress(BaseCallback):
    """Budget, saves, metrics and live estimates of a training."""

    def __init__(
        self,
        problem: Problem,
        run: Run,
        report: Report,
        policy_of: Callable[[Any], Policy],
        curiosity: Curiosity | None,
        weight: float,
        settings: Mapping[str, Any],
    ) -> None:
        super().__init__()
        self._problem, self._run, self._report = problem, run, report
        self._policy_of, self._curiosity, self._weight = policy_of, curiosity, weight
        self._settings = json.loads(json.dumps(settings))
        self._parts: list[dict[str, float]] = []
        self._spent, self._logged, self.stopped = 0.0, 0, False
        self.best, self.best_at, self._check_steps = -math.inf, 0, 0
        self._began = self._checked = self._saved = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds of training, those before a resumption included."""
        return self._spent + time.monotonic() - self._began

    def resume(self, model: Any, environment: ProblemVecEnv) -> int:
        """Gives a learner and its worlds what was saved; how many steps were done by then.

        Raises:
          InputError: what stands in the folder is damaged or of another training.
        """
        out, found = self._run.out, load_progress(self._run.out, DTYPES)
        if found is None:
            return 0  # killed before the first save: the same as a fresh start
        notes = found[1]
        if notes["config"] != self._settings:
            raise InputError(f"{out}: was trained with other settings; use another --out")
        if notes["seed"] != self._run.seed:
            raise InputError(
                f"{out}: was trained with --seed {notes['seed']}, not {self._run.seed}"
            )
        # copies: where in memory a row begins decides about the last bit of a product
        tensors = {name: tensor.clone() for name, tensor in found[0].items()}
        try:
            environment.restore(_part(tensors, "worlds"))
            if self._curiosity is not None:
                self._curiosity.restore(_part(tensors, "curiosity"))
            learner_state.restore(model, _part(tensors, "learner"), notes["learner"])
            self._logged = int(notes["logged"])
            self._parts = [dict(part) for part in notes["parts"]]
            self._check_steps, self.best_at = int(notes["check"][0]), int(notes["check"][1])
            if self._check_steps:
                self.best = float(notes["check"][2])
        except (KeyError, RuntimeError, TypeError, ValueError) as error:
            raise InputError(f"{out}: its training cannot be gone on with ({error})") from None
        self._spent = float(notes["seconds"])
        return int(notes["step"])

    def save(self) -> None:
        """Writes all that the training goes on from; between two rollouts only."""
        tensors, notes = learner_state.state_of(self.model)
        parts = {"learner": tensors, "worlds": self.training_env.state()}
        if self._curiosity is not None:
            parts["curiosity"] = self._curiosity.state()
        together = {f"{kind}/{n}": t for kind, part in parts.items() for n, t in part.items()}
        where = {"seed": self._run.seed, "step": notes["timesteps"], "seconds": self.elapsed}
        where |= {"logged": self._logged, "parts": self._parts}
        best = self.best if self._check_steps else 0.0  # JSON has no infinity
        where |= {"check": [self._check_steps, self.best_at, best]}
        save_progress(
            self._run.out, together, {"config": self._settings, **where, "learner": notes}
        )
        self._saved = time.monotonic()

    def _on_rollout_start(self) -> None:
        if time.monotonic() - self._saved > self._run.save_every:
            self.save()

    def _on_step(self) -> bool:
        self._parts += [info["parts"] for info in self.locals["infos"] if "parts" in info]
        if self._curiosity is not None:
            seen = self.locals["new_obs"]
            self.locals["rewards"] += self._weight * self._curiosity.reward(seen)
        run, done = self._run, int(self.model.num_timesteps)
        if done // LINE > self._logged // LINE:
            self.log(run.check > 0 and time.monotonic() - self._checked > run.check_every)
        self.stopped = run.limit is not None and self.elapsed >= run.limit
        return not self.stopped

    def log(self, check: bool) -> None:
        """A line of metrics."""
        done, seconds = int(self.model.num_timesteps), round(self.elapsed, 3)
        self._logged = done
        line: dict[str, Any] = {"step": done, "seconds": seconds, "true_steps": done}
        for name in self._problem.parts if self._parts else ():
            line[name] = float(np.mean([part[name] for part in self._parts]))
        self._parts.clear()
        if check:
            starts = starts_of(self._problem, self._run.check, self._run.seed, "checks")
            policy = self._policy_of(self.model)
            found = in_mujoco(self._problem, policy, starts, self._run.nthread)
            known = summary(self._problem, starts, *found[:2])
            means = {f"true_{n}": row["mean"] for n, row in known["reward"].items()}
            line |= {f"success_{n}": row["share"] for n, row in known["success"].items()} | means
            self._check_steps += self._run.check * self._problem.steps
            if sum(means.values()) > self.best:
                self.best, self.best_at = sum(means.values()), done
                save_policy(self._run.out, policy, self._problem, self.notes(False))
            self._checked = time.monotonic()
        append_metrics(self._run.out, line)
        self._report(line)

    def notes(self, finished: bool) -> dict[str, Any]:
        """What a manifest says of the training so far."""
        worlds = self.training_env.worlds
        check: dict[str, Any] = {"episodes": self._run.check, "true_steps": self._check_steps}
        if self._check_steps:
            check |= {"reward": self.best, "step": self.best_at}
        return {
            **self._settings,
            "true_steps": int(worlds.steps),
            "check": check,
            "training": {
                "seed": self._run.seed,
                "step": int(self.model.num_timesteps),
                "seconds": round(self.elapsed, 1),
                "device": "cpu",
                "finished": finished,
                "diverged": int(worlds.diverged.sum()),
            },
            "versions": {"torch": torch.__version__, "orbisim": VERSION},
        }


def train_baseline(
    problem: Problem, config: Baseline, run: Run, report: Report = lambda _: None
) -> dict[str, Any]:
    """Trains a baseline in C MuJoCo; returns the manifest of the policy that it leaves.

    Raises:
      InputError: no budget, or `out` holds another training.
    """
    check_run(run)
    settings = {"method": config.method, "config": dataclasses.asdict(config)}
    settings |= problem.conditions
    with claimed(make_folder(run.out), "another training", "wait for it, or choose another --out"):
        starts = problem.draw(training_seeds(problem, run))
        episodes = SuccessiveEpisodes(problem, config.batch, starts, run.seed, run.nthread)
        with contextlib.closing(ProblemVecEnv(episodes)) as environment:
            model, policy_of = _learner(config, environment, run.seed)
            curiosity = None
            if config.method == "ppo_rnd":
                curiosity = Curiosity(problem.observations, run.seed)
            weight = config.curiosity
            progress = _Progress(problem, run, report, policy_of, curiosity, weight, settings)
            progress.init_callback(model)
            done = progress.resume(model, environment) if run.resume else 0
            begin_metrics(run.out / METRICS, done)
            left = (run.steps or 10**12) - done
            if left > 0:
                model.learn(left, callback=progress, reset_num_timesteps=not done)
            if not progress.stopped:
                progress.save()
            progress.log(run.check > 0)
            kept = policy_of(model)
            if run.check and progress.best > -math.inf:  # the best by its live estimates
                kept = load_policy(run.out, problem)
            notes = progress.notes(True)
            save_policy(run.out, kept, problem, notes)
            draw_curves(run.out)
    return {"task": problem.name, **notes}


def _learner(
    config: Baseline, environment: ProblemVecEnv, seed: int
) -> tuple[Any, Callable[[Any], Policy]]:
    """The library's learner, and what makes our policy of it."""
    problem, hidden = environment.problem, list(config.network.hidden)
    discount = 0.99
    if config.method == "sac":
        model = SAC(
            "MlpPolicy",
            environment,
            learning_rate=config.rate,
            gamma=discount,
            train_freq=1,
            gradient_steps=config.updates or max(1, config.batch // 8),
            n_steps=config.returns,
            policy_kwargs={"net_arch": hidden},
            seed=seed,
            device="cpu",
        )
        return model, lambda m: _from_sac(m, problem, config)
    model = PPO(
        "MlpPolicy",
        environment,
        learning_rate=config.rate,
        gamma=discount,
        n_steps=config.window,
        batch_size=max(64, config.batch * config.window // 16),
        policy_kwargs={"net_arch": hidden},
        seed=seed,
        device="cpu",
    )
    return model, lambda m: _from_ppo(m, problem, config)


def _from_sac(model: Any, problem: Problem, config: Baseline) -> Policy:
    shape = NetworkConfig(config.network.hidden, "relu", "tanh")
    return _copied(problem, shape, model.policy.actor.latent_pi, model.policy.actor.mu)


def _from_ppo(model: Any, problem: Problem, config: Baseline) -> Policy:
    shape = NetworkConfig(config.network.hidden, "tanh", "clip")
    body = model.policy.mlp_extractor.policy_net
    return _copied(problem, shape, body, model.policy.action_net)


def _copied(problem: Problem, shape: NetworkConfig, body: Any, head: Any) -> Policy:
    """A policy with the weights of a trained actor."""
    with torch.random.fork_rng(devices=[]):  # an estimate on the way changes no training
        policy = Policy(problem.observations, problem.actions, shape)
    policy.body.load_state_dict(body.state_dict())
    policy.head.load_state_dict(head.state_dict())
    return policy.eval()


def _part(tensors: Mapping[str, Tensor], kind: str) -> dict[str, Tensor]:
    """The tensors of one part, without its name."""
    return {n.removeprefix(f"{kind}/"): t for n, t in tensors.items() if n.startswith(f"{kind}/")}


def _small(observations: int) -> torch.nn.Sequential:
    layers = torch.nn
    return layers.Sequential(
        layers.Linear(observations, 64), layers.ReLU(), layers.Linear(64, 64), layers.Linear(64, 32)
    )
