"""A DreamerV3-style recurrent state-space model on states, as a baseline.

From the description in Hafner et al., "Mastering Diverse Domains through World Models": a
deterministic memory, categorical latents with straight-through gradients and one per cent of
uniform probability, posterior from the observation and prior from the memory, KL balancing with
free bits. The reward, continuation and actor parts have no role here.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.network.recurrence import Recurrence

_GROUPS, _CLASSES, _UNIFORM, _FREE = 32, 16, 0.01, 1.0
_DYNAMICS, _REPRESENTATION = 0.5, 0.1


class DreamerNetwork(nn.Module):
    """Memory h and categorical latent s; the state is decoded from (h, s).

    `memory` holds h [width] and the prior's latent s [groups * classes]. A step that observes
    replaces s by the posterior's sample; one that does not goes on from the prior's.
    """

    def __init__(self, sizes: Sizes, config: ModelConfig) -> None:
        super().__init__()
        width, hidden, latent = config.width, 2 * config.width, _GROUPS * _CLASSES
        self.sizes, self.width = sizes, width
        descriptors = sizes.many * sizes.attributes + sizes.world
        self.start = nn.Parameter(torch.zeros(width + latent))
        self.posterior = _perceptron(width + sizes.flat, hidden, latent)
        self.prior = _perceptron(width, hidden, latent)
        self.mix = _perceptron(latent + sizes.control + descriptors, hidden, width)
        self.f_rec = Recurrence(width)
        outputs = sizes.robot_out + sizes.many * sizes.objects_out
        self.f_dec = _perceptron(width + latent + descriptors, hidden, outputs)

    def initial_memory(self, batch: int) -> Tensor:
        """[B, width + groups * classes], learned."""
        return self.start.expand(batch, -1)

    def encode(self, inputs: Inputs, memory: Tensor) -> Tensor:
        """Logits [B, groups, classes] of the posterior."""
        logits = self.posterior(torch.cat([memory[:, : self.width], inputs.flat()], dim=1))
        return logits.unflatten(1, (_GROUPS, _CLASSES))

    def forward(self, inputs: Inputs, memory: Tensor, observe: bool = True) -> Outputs:
        """One step: correct by the observation (or not), act, predict."""
        h, latent = memory[:, : self.width], memory[:, self.width :]
        penalty = h.new_zeros(())
        if observe:
            post = self.encode(inputs, memory)
            prior = self.prior(h).unflatten(1, (_GROUPS, _CLASSES))
            penalty = _balanced_kl(post, prior)
            latent = _sample(post, self.training)
        given = torch.cat([inputs.attributes.flatten(1), inputs.world], dim=1)
        h = self.f_rec(h, self.mix(torch.cat([latent, inputs.control, given], dim=1)))
        logits = self.prior(h).unflatten(1, (_GROUPS, _CLASSES))
        latent = _sample(logits, self.training)
        decoded = self.f_dec(torch.cat([h, latent, given], dim=1))
        robot, objects = decoded.split(
            (self.sizes.robot_out, self.sizes.many * self.sizes.objects_out), dim=1
        )
        shaped = objects.unflatten(1, (self.sizes.many, self.sizes.objects_out))
        memory = torch.cat([h, latent], dim=1)
        return Outputs(robot, shaped, memory, logits.flatten(1), penalty)


def _perceptron(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, hidden),
        nn.LayerNorm(hidden),
        nn.SiLU(),
        nn.Linear(hidden, hidden),
        nn.LayerNorm(hidden),
        nn.SiLU(),
        nn.Linear(hidden, outputs),
    )


def _probabilities(logits: Tensor) -> Tensor:
    return (1.0 - _UNIFORM) * logits.float().softmax(-1) + _UNIFORM / _CLASSES


def _sample(logits: Tensor, random: bool) -> Tensor:
    """One-hot [B, groups * classes] with straight-through gradients; the mode if not random."""
    p = _probabilities(logits)
    score = p.log()
    if random:  # the largest of Gumbel-perturbed scores is a sample
        score = score - torch.empty_like(score).exponential_().log()
    hard = torch.nn.functional.one_hot(score.argmax(-1), _CLASSES).to(p.dtype)
    return (hard + p - p.detach()).flatten(1).to(logits.dtype)


def _balanced_kl(post: Tensor, prior: Tensor) -> Tensor:
    """KL balancing with free bits, divided by its usual size so that it weighs like a state."""
    q, p = _probabilities(post), _probabilities(prior)
    dynamics = _kl(q.detach(), p).clamp_min(_FREE).mean()
    representation = _kl(q, p.detach()).clamp_min(_FREE).mean()
    return (_DYNAMICS * dynamics + _REPRESENTATION * representation) / _GROUPS


def _kl(q: Tensor, p: Tensor) -> Tensor:
    return (q * (q.log() - p.log())).sum((-1, -2))
