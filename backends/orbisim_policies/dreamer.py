"""DreamerV3 (Hafner et al. 2023) on states: a latent model, and a policy that learns inside it.

As published but for sizes and what images need: observations are vectors (symlog), of which a
multilayer perceptron makes embeddings. Gradients of the policy are REINFORCE's, as the paper has
for continuous actions, too.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from orbisim_world_model.graphs import Graphed
from orbisim_world_model.optimizer import FlatAdamW
from orbisim_world_model.sampling import generator_of
from orbisim_world_model.schedule import Clock
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, log_softmax

from orbisim_policies.latent import (
    Latent,
    LatentConfig,
    LatentPolicy,
    drawn,
    network,
    symexp,
    symlog,
)
from orbisim_policies.problem import Problem, Starts
from orbisim_policies.replay import Moments, Replay
from orbisim_policies.run import Report, Run, check_run, train_with, training_seeds
from orbisim_policies.successive import SuccessiveEpisodes

_BINS, _EDGE = 255, 20.0
"""Of rewards and values: bins from -20 to 20 after `symlog`."""
_FREE = 1.0
"""Nats of each Kullback-Leibler term that cost nothing."""
_FORWARD, _BACK = 1.0, 0.1
"""Weights of the two: the prior towards the posterior, and the other way round."""
_SLOW = 0.98
"""Share of the slow critic that an update keeps."""
_LOW, _HIGH, _KEPT = 0.05, 0.95, 0.99
"""Quantiles of returns whose distance scales them, and share of that scale that an update keeps."""
_CLIP = 100.0
"""Largest norm of a gradient: it acts on outliers alone."""


@dataclasses.dataclass(frozen=True)
class DreamerConfig:
    """How DreamerV3 is trained; numbers are the paper's unless said otherwise.

    Attributes:
      batch: worlds at once (paper: 1 to 16). sequences, length: of an update (paper: 16 of 64).
      ratio: moments that are replayed for each control step (paper: 32 to 1,024 by domain).
      imagined: control steps that are imagined.
      rate: of Adam, of the model. behaviour: by how much actor and critic are slower; both are
        three times the paper's rates (1e-4, 3e-5), as networks are smaller.
      discount, trace: of returns. entropy: its weight.
      capacity: moments that are kept. sizes: of the networks.
    """

    batch: int = 16
    sequences: int = 32
    length: int = 32
    ratio: float = 32.0
    imagined: int = 15
    rate: float = 3e-4
    behaviour: float = 0.3
    discount: float = 0.997
    trace: float = 0.95
    entropy: float = 3e-4
    capacity: int = 500_000
    sizes: LatentConfig = dataclasses.field(default_factory=LatentConfig)


class Draws(NamedTuple):
    """Noise of an update: Gumbel's of what is seen and imagined, normal of actions."""

    seen: Tensor
    imagined: Tensor
    actions: Tensor


class Model(nn.Module):
    """All that is trained, but the slow critic.

    Args:
      observations, actions: how many. config: sizes.
    """

    def __init__(self, observations: int, actions: int, config: LatentConfig) -> None:
        super().__init__()
        width = config.deter + config.variables * config.classes
        self.policy = LatentPolicy(observations, actions, config)
        self.decoder = network(width, config, observations)
        self.reward = network(width, config, _BINS, 0.0)
        self.goes_on = network(width, config, 1)
        self.critic = network(width, config, _BINS, 0.0)

    @property
    def world(self) -> nn.ModuleList:
        """What the model's own loss trains."""
        return nn.ModuleList([self.policy.dynamics, self.decoder, self.reward, self.goes_on])


class Dreamer:
    """One training, resumable to the exact step; an iteration is a control step in every world.

    Args:
      problem: on the CPU. config: how. starts: of episodes, drawn from at random.
      seed: of weights, starts and noise. device: where to compute. nthread: of MuJoCo.
      graph: run an update as one CUDA graph, where there is a GPU.
    """

    names = ("model_loss", "divergence", "entropy", "scale")

    def __init__(
        self,
        problem: Problem,
        config: DreamerConfig,
        starts: Starts,
        *,
        seed: int = 0,
        device: torch.device | None = None,
        nthread: int = 0,
        graph: bool = True,
    ) -> None:
        self.config, self.seed, self.done, self.updates = config, seed, 0, 0
        self.device = device = device or torch.device("cpu")
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.model = Model(problem.observations, problem.actions, config.sizes)
        self.model.to(device)
        self.slow = copy.deepcopy(self.model.critic).requires_grad_(False)
        self.optimizers = {
            "world": FlatAdamW(self.model.world, 0.0, _CLIP),
            "actor": FlatAdamW(self.model.policy.actor, 0.0, _CLIP),
            "critic": FlatAdamW(self.model.critic, 0.0, _CLIP),
        }
        self.optimizers["world"].rate.fill_(config.rate)
        for name in ("actor", "critic"):
            self.optimizers[name].rate.fill_(config.rate * config.behaviour)
        self._bins = torch.linspace(-_EDGE, _EDGE, _BINS, device=device)
        self._scale = torch.ones((), device=device)
        self.episodes = SuccessiveEpisodes(problem, config.batch, starts, seed, nthread)
        shape = (problem.observations, problem.actions)
        self.replay = Replay(config.batch, config.capacity, *shape, torch.device("cpu"))
        self._latent = self.model.policy.dynamics.initial(config.batch)
        self._action = torch.zeros((config.batch, problem.actions), device=device)
        self._view = self.episodes.reset()
        self._first = torch.ones(config.batch)
        self._remember(self._view, torch.zeros(config.batch), self._first)
        self._row = torch.zeros(len(self.names) + len(problem.parts))
        self._buffers: Any = None
        self._graph = graph and device.type == "cuda"
        self._run: Any = None

    # -- acting --------------------------------------------------------------------------------

    def step(self, progress: float) -> Tensor:
        """A control step in every world, and the updates that are due then.

        Returns:
          [names + parts]: of the last update, and the mean of the episodes that ended last.
        """
        generator = generator_of("cpu", self.seed, self.done)
        self._act(generator)
        self.done += 1
        while self.replay.ready(self.config.length) and self.updates < self._due:
            self._update(generator)
        return self._row.clone()

    @property
    def _due(self) -> int:
        """Updates after so many control steps; none before there are sequences to replay."""
        config = self.config
        steps = (self.done - config.length) * config.batch
        return int(steps * config.ratio / (config.sequences * config.length))

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def _act(self, generator: torch.Generator) -> None:
        count, sizes, device = self.config.batch, self.config.sizes, self.device
        gumbel = _gumbel((count, sizes.variables, sizes.classes), generator).to(device)
        noise = torch.randn(self._action.shape, generator=generator).to(device)
        kept = (1.0 - self._first)[:, None].to(device)
        before = Latent(*(field * kept for field in self._latent))
        view = self._view.to(device)
        self._latent, self._action = self.model.policy.step(
            before, self._action * kept, view, gumbel, noise
        )
        turn = self.episodes.step(self._action.cpu())
        over = torch.as_tensor(turn.done & ~turn.cut).float()
        nothing = torch.zeros(count)
        self._remember(turn.last, torch.as_tensor(turn.reward), nothing, self._action.cpu(), over)
        self._view, self._first = turn.view, torch.as_tensor(turn.done).float()
        if turn.done.any():
            which = torch.as_tensor(turn.done.nonzero()[0])
            self._remember(turn.view, nothing, torch.ones(count), which=which)
            well = turn.done & ~turn.lost
            if well.any():
                self._row[len(self.names) :] = turn.parts[torch.as_tensor(well)].mean(0)

    def _remember(
        self,
        view: Tensor,
        reward: Tensor,
        first: Tensor,
        action: Tensor | None = None,
        over: Tensor | None = None,
        which: Tensor | None = None,
    ) -> None:
        """Adds a moment of each world, or of `which`."""
        nothing = torch.zeros(self.config.batch)
        action = torch.zeros_like(self._action, device="cpu") if action is None else action
        moments = Moments(view, action, reward, first, nothing if over is None else over)
        which = torch.arange(self.config.batch) if which is None else which
        self.replay.add(which, Moments(*(field[which] for field in moments)))

    # -- learning ------------------------------------------------------------------------------

    def _update(self, generator: torch.Generator) -> None:
        config, sizes = self.config, self.config.sizes
        length, batch = config.length, config.sequences
        chance = torch.rand((2, batch), generator=generator)
        moments = self.replay.sample(batch, length, chance)
        count, shape = length * batch, (sizes.variables, sizes.classes)
        mine = generator_of(self.device, self.seed + 1, self.updates)
        draws = Draws(
            _gumbel((length, batch, *shape), mine),
            _gumbel((config.imagined, count, *shape), mine),
            torch.randn(
                (config.imagined, count, self._action.shape[1]), generator=mine, device=self.device
            ),
        )
        fresh = [field.to(self.device) for field in (*moments, *draws)]
        if self._buffers is None:
            self._buffers = fresh
        else:
            for mine_, new in zip(self._buffers, fresh, strict=True):
                mine_.copy_(new)
        if self._run is None:
            saved = {name: tensor.clone() for name, tensor in self._trained().items()}
            self._run = Graphed(self._learn, lambda: self._restore(saved), self._graph)
        self._row[: len(self.names)] = self._run().cpu()
        self.updates += 1

    def _learn(self) -> Tensor:
        """One update of everything from the buffers; what is logged of it."""
        moments = Moments(*self._buffers[: len(Moments._fields)])
        draws = Draws(*self._buffers[len(Moments._fields) :])
        loss, divergence, latent = self._model_loss(moments, draws.seen)
        self._take("world", loss)
        begun = Latent(*(field.detach().flatten(0, 1) for field in latent))
        entropy = self._learn_behaviour(begun, 1.0 - moments.over.flatten(), draws)
        with torch.no_grad():
            for mine, theirs in zip(
                self.slow.parameters(), self.model.critic.parameters(), strict=True
            ):
                mine.lerp_(theirs, 1.0 - _SLOW)
        return torch.stack([loss.detach(), divergence, entropy, self._scale])

    def _model_loss(self, moments: Moments, gumbel: Tensor) -> tuple[Tensor, Tensor, Latent]:
        """Loss and divergence of the world model, and the latent states [L, B, ...]."""
        model, dynamics = self.model, self.model.policy.dynamics
        embedded = dynamics.encode(moments.observation)
        latent = dynamics.initial(moments.first.shape[1])
        deters, posteriors, stochs = [], [], []
        for t in range(len(moments.first)):
            kept = (1.0 - moments.first[t])[:, None]
            before = Latent(latent.deter * kept, latent.stoch * kept)
            deter = dynamics.advance(before, moments.action[t] * kept)
            logs = dynamics.inferred(deter, embedded[t])
            latent = Latent(deter, drawn(logs, gumbel[t]))
            deters.append(deter)
            posteriors.append(logs)
            stochs.append(latent.stoch)
        every = Latent(torch.stack(deters), torch.stack(stochs))
        posterior, prior = torch.stack(posteriors), dynamics.expected(every.deter)
        feature = every.feature
        seen = (model.decoder(feature) - symlog(moments.observation)).square().sum(-1)
        reward = _surprise(model.reward(feature), moments.reward, self._bins)
        going = binary_cross_entropy_with_logits(
            model.goes_on(feature)[..., 0], 1.0 - moments.over, reduction="none"
        )
        forward = _divergence(posterior.detach(), prior)
        back = _divergence(posterior, prior.detach())
        cost = _FORWARD * forward.clamp_min(_FREE) + _BACK * back.clamp_min(_FREE)
        return (seen + reward + going + cost).mean(), forward.detach().mean(), every

    def _learn_behaviour(self, begun: Latent, alive: Tensor, draws: Draws) -> Tensor:
        """Updates actor and critic from what is imagined after each moment; mean entropy.

        Args:
          begun: latent states [M, ...]. alive: [M] whether their episodes go on. draws: noise.
        """
        config, model = self.config, self.model
        dynamics, actor = model.policy.dynamics, model.policy.actor
        with torch.no_grad():
            latent, features, actions = begun, [begun.feature], []
            for t in range(config.imagined):
                mean, std = actor(features[-1])
                action = mean + std * draws.actions[t]
                deter = dynamics.advance(latent, action.clamp(-1.0, 1.0))
                latent = Latent(deter, drawn(dynamics.expected(deter), draws.imagined[t]))
                features.append(latent.feature)
                actions.append(action)
            feature = torch.stack(features)  # [H + 1, M, ...]
            reward = _mean(model.reward(feature), self._bins)
            values = _mean(model.critic(feature), self._bins)
            share = config.discount * model.goes_on(feature)[..., 0].sigmoid()
            following, returns = values[-1], []
            for t in reversed(range(config.imagined)):
                mixed = (1 - config.trace) * values[t + 1] + config.trace * following
                following = reward[t + 1] + share[t + 1] * mixed
                returns.append(following)
            gain = torch.stack(returns[::-1])
            weight = torch.cumprod(torch.cat([alive[None], share[1:-1]]), 0)
            ordered = gain.flatten().sort().values
            low, high = (ordered[int(q * (len(ordered) - 1))] for q in (_LOW, _HIGH))
            self._scale.lerp_(high - low, 1.0 - _KEPT)
            advantage = (gain - values[:-1]) / self._scale.clamp_min(1.0)
        feature = feature[:-1]
        mean, std = actor(feature)
        off = (torch.stack(actions) - mean) / std
        logs = (-0.5 * off.square() - std.log() - 0.5 * math.log(2 * math.pi)).sum(-1)
        entropy = (std.log() + 0.5 * math.log(2 * math.pi * math.e)).sum(-1)
        self._take("actor", -(weight * (logs * advantage + config.entropy * entropy)).mean())
        logits = model.critic(feature)
        with torch.no_grad():
            slow = _mean(self.slow(feature), self._bins)
        error = _surprise(logits, gain, self._bins) + _surprise(logits, slow, self._bins)
        self._take("critic", (weight * error).mean())
        return entropy.detach().mean()

    def _take(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    # -- state ---------------------------------------------------------------------------------

    @property
    def true_steps(self) -> int:
        """Control steps of C MuJoCo so far."""
        return self.episodes.worlds.steps

    @property
    def current(self) -> LatentPolicy:
        """The policy as it is now."""
        return self.model.policy

    @property
    def chosen(self) -> LatentPolicy:
        """The policy to keep."""
        return self.model.policy

    def _trained(self) -> dict[str, Tensor]:
        """What an update changes."""
        found = {f"{k}.{n}": t for k, o in self.optimizers.items() for n, t in o.state().items()}
        found |= {f"slow.{name}": tensor for name, tensor in self.slow.state_dict().items()}
        return found | {"scale": self._scale}

    def state(self) -> dict[str, Tensor]:
        """What is needed to go on, by name."""
        found = self._trained() | {
            "latent.deter": self._latent.deter,
            "latent.stoch": self._latent.stoch,
            "action": self._action,
            "first": self._first,
            "row": self._row,
            "replay": self.replay.rows,
            "replay.count": self.replay.count,
            "updates": torch.tensor(self.updates),
        }
        return found | {f"worlds.{k}": t for k, t in self.episodes.state().items()}

    def restore(self, tensors: Mapping[str, Tensor], done: int) -> None:
        """Takes what `state` gave after `done` iterations."""
        self._restore(tensors)
        self.done, self.updates = done, int(tensors["updates"])
        theirs = {n: t for n, t in tensors.items() if n.startswith("worlds.")}
        self.episodes.restore({n.removeprefix("worlds."): t for n, t in theirs.items()})
        self._view = self.episodes.worlds.observation()
        mine = {"action": self._action, "first": self._first, "row": self._row}
        mine |= {"replay": self.replay.rows, "replay.count": self.replay.count}
        for name, tensor in mine.items():
            tensor.copy_(tensors[name])
        device = self.device
        self._latent = Latent(*(tensors[f"latent.{n}"].to(device) for n in Latent._fields))

    def _restore(self, tensors: Mapping[str, Tensor]) -> None:
        with torch.no_grad():
            for name, tensor in self._trained().items():
                tensor.copy_(tensors[name])


def train_dreamer(
    problem: Problem, config: DreamerConfig, run: Run, report: Report = lambda _: None
) -> dict[str, Any]:
    """Trains a policy by DreamerV3 in C MuJoCo; returns its manifest.

    `run.steps` are control steps of all worlds together. Errors as `train_apg`.
    """
    check_run(run)
    clock = Clock(None if run.steps is None else -(-run.steps // config.batch), run.limit)
    starts, device = problem.draw(training_seeds(problem, run)), torch.device(run.device)
    how = {"seed": run.seed, "device": device, "nthread": run.nthread, "graph": run.graph}
    trainer = Dreamer(problem, config, starts, **how)
    notes = {
        "method": "dreamer",
        "config": dataclasses.asdict(config),
        "true_steps": 0,
        **problem.conditions,
    }
    names = (*Dreamer.names, *problem.parts)
    with contextlib.closing(trainer.episodes):
        return train_with(trainer, problem, run, clock, names, notes, report)


def _gumbel(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Noise whose addition to log-probabilities makes the largest a draw of them."""
    uniform = torch.rand(shape, generator=generator, device=generator.device)
    return -(-uniform.clamp(1e-9, 1.0 - 1e-7).log()).log()


def _divergence(posterior: Tensor, prior: Tensor) -> Tensor:
    """KL(posterior || prior) of log-probabilities [..., S, C], summed over variables."""
    return (posterior.exp() * (posterior - prior)).sum((-2, -1))


def _surprise(logits: Tensor, value: Tensor, bins: Tensor) -> Tensor:
    """Cross-entropy [...] of logits [..., bins] to a value [...], spread over two bins."""
    place = (symlog(value) - bins[0]) / (bins[1] - bins[0])
    place = place.clamp(0.0, len(bins) - 1.001)
    low = place.floor()
    share = (place - low)[..., None]
    index = low.long()[..., None]
    logs = log_softmax(logits, -1)
    found = (1.0 - share) * logs.gather(-1, index) + share * logs.gather(-1, index + 1)
    return -found[..., 0]


def _mean(logits: Tensor, bins: Tensor) -> Tensor:
    """The value [...] that logits [..., bins] expect."""
    return symexp((logits.softmax(-1) * bins).sum(-1))
