"""Equation Dynamics: x_t = f_dyn(x_{0:t-1}, a_{t-1}, x), one control step at a time."""

from __future__ import annotations

import contextlib
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from orbisim_world_model.config import ModelConfig
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.features import EDGE_FEATURES, Features
from orbisim_world_model.integrate import OBJECT_OUTPUTS, Raw, advance, required, robot_outputs
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.layout import Layout
from orbisim_world_model.network.dreamer import DreamerNetwork
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.network.monolith import GlobalNetwork
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.network.still import StillNetwork
from orbisim_world_model.normalization import Normalizer

_NETWORKS: dict[str, Any] = {
    "objects": ObjectCentricNetwork,
    "global": GlobalNetwork,
    "dreamer": DreamerNetwork,
    "constant_velocity": StillNetwork,
}


class Step(NamedTuple):
    """What one step gives.

    Attributes:
      state: the predicted x_t.
      memory: h_t.
      latent: zhat_t.
      penalty: [] a loss of the network's own.
    """

    state: Entities
    memory: Tensor
    latent: Tensor
    penalty: Tensor


class Dynamics(nn.Module):
    """Equation Dynamics: a network between normalised features and an integrator.

    Args:
      layout: of the scene.
      config: of the network.
      precision: type in which matrix products are computed (`torch.bfloat16`: autocast).
    """

    def __init__(self, layout: Layout, config: ModelConfig, precision: Any = None) -> None:
        super().__init__()
        self.layout, self.config, self.precision = layout, config, precision
        self.kinematics = Kinematics(layout) if layout.hand and config.extended else None
        self.controls = layout.nu  # the number of an `action` is set by `with_controls`
        self.network: Any = None

    def build(self, controls: int) -> Dynamics:
        """Makes the network for so many controls; returns itself."""
        layout, config = self.layout, self.config
        self.features = Features(layout, config)
        sizes = _sizes(self.features, controls)
        self.sizes = sizes
        self.controls = controls
        extra = OBJECT_OUTPUTS if config.baseline != "none" else 0
        self.see_robot = Normalizer(sizes.robot - (sizes.robot_out if extra else 0))
        self.see_objects = Normalizer(sizes.objects - extra)
        self.see_edges = Normalizer(EDGE_FEATURES)
        self.see_attributes, self.see_world = Normalizer(sizes.attributes), Normalizer(sizes.world)
        self.see_control = Normalizer(sizes.control)
        centered = not config.residual
        self.robot_scale = Normalizer(sizes.robot_out, centered=centered, output=True)
        self.object_scale = Normalizer(sizes.objects_out, centered=centered, output=True)
        corrects = config.baseline != "none"
        self.base_robot = Normalizer(sizes.robot_out if corrects else 0)
        self.base_objects = Normalizer(sizes.objects_out if corrects else 0)
        self.network = _NETWORKS[config.kind](sizes, config)
        return self

    # -- one step ------------------------------------------------------------------------------

    def initial_memory(self, batch: int) -> Tensor:
        """h_0 [B, ...], when nothing is known of the past."""
        return self.network.initial_memory(batch)

    def completed(self, x: Entities) -> Entities:
        """The state with the hand's pose and velocity that follow from the joints."""
        if self.kinematics is None:
            return x
        with self._exact():
            return x._replace(hand=self.kinematics(x.q, x.v))

    def forward(
        self,
        x: Entities,
        memory: Tensor,
        control: Tensor,
        context: Context,
        observe: bool = True,
        base: Entities | None = None,
    ) -> Step:
        """x_t and h_t from x_{t-1} (`completed`), h_{t-1}, a_{t-1} [B, U] and descriptors.

        Args:
          base: what the classical step predicts for x_t, where the model corrects one.
        """
        with self._exact():
            inputs = self._cast(self.inputs(x, control, context, base))
        out = self.network(inputs, memory, observe)
        with self._exact():
            return self._advanced(x, out, base)

    def _advanced(self, x: Entities, out: Outputs, base: Entities | None) -> Step:
        raw = Raw(*self._unscaled(out, x.pos.dtype))
        if base is None:
            state = advance(x, raw, self.layout.timestep, self.config)
        else:
            state = advance(base, raw, 0.0, self.config)
        return Step(self.completed(state), out.memory, out.latent, out.penalty)

    def encode(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> Tensor:
        """z_t = f_enc(h_t, x_t)."""
        with self._exact():
            inputs = self._cast(self.inputs(x, control, context))
        return self.network.encode(inputs, memory)

    def inputs(
        self, x: Entities, control: Tensor, context: Context, base: Entities | None = None
    ) -> Inputs:
        """Normalised features."""
        see, edges = self.features, None
        if self.sizes.edges:
            edges = self.see_edges(see.edges(x))
        robot, objects = self.see_robot(see.robot(x)), self.see_objects(see.objects(x, context))
        if base is not None:
            change = required(x, base, self.layout.timestep, self.config)
            robot = torch.cat([robot, self.base_robot(change.robot)], dim=-1)
            objects = torch.cat([objects, self.base_objects(change.objects)], dim=-1)
        return Inputs(
            robot,
            objects,
            edges,
            self.see_attributes(context.attributes),
            self.see_world(context.world),
            self.see_control(see.control(x, control)),
            context.mask,
        )

    # -- scales --------------------------------------------------------------------------------

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def fit(
        self,
        x: Entities,
        after: Entities,
        control: Tensor,
        context: Context,
        base: Entities | None = None,
    ) -> None:
        """Takes all scales from transitions of the training data."""
        x, after = self.completed(x), self.completed(after)
        mask, see = context.mask, self.features
        self.see_robot.fit(see.robot(x))
        self.see_objects.fit(see.objects(x, context), mask)
        self.see_attributes.fit(context.attributes, mask)
        self.see_world.fit(context.world)
        self.see_control.fit(see.control(x, control))
        if self.sizes.edges:
            self.see_edges.fit(see.edges(x))
        dt = self.layout.timestep
        if base is None:
            raw = required(x, after, dt, self.config)
        else:
            raw = required(base, after, 0.0, self.config)
            change = required(x, base, dt, self.config)
            self.base_robot.fit(change.robot)
            self.base_objects.fit(change.objects, mask)
        self.robot_scale.fit(raw.robot)
        self.object_scale.fit(raw.objects, mask)
        if self.config.residual:
            _share(self.object_scale.std, ((0, 3), (3, 7), (7, 10), (10, 13)))

    def _unscaled(self, out: Outputs, dtype: Any) -> tuple[Tensor, Tensor]:
        """The decoder's numbers in SI units."""
        return self.robot_scale.undo(out.robot.to(dtype)), self.object_scale.undo(
            out.objects.to(dtype)
        )

    def _cast(self, inputs: Inputs) -> Inputs:
        """To the network's own type, where it was converted to half precision."""
        start = getattr(self.network, "start", None)
        if start is None or start.dtype == inputs.robot.dtype:
            return inputs
        return Inputs(*(None if part is None else part.to(start.dtype) for part in inputs))

    def autocast(self) -> Any:
        """Around several steps: matrix products of the network in `precision`."""
        if self.precision is None:
            return contextlib.nullcontext()
        return torch.autocast("cuda", self.precision)

    def _exact(self) -> Any:
        """Around physics: float32, whatever the network uses."""
        if self.precision is None:
            return contextlib.nullcontext()
        return torch.autocast("cuda", enabled=False)


def _sizes(see: Features, controls: int) -> Sizes:
    """Numbers of features, found by asking the functions that make them."""
    layout, config = see.layout, see.config
    x, context = example(layout)
    pairs = layout.tokens > 1 and config.kind == "objects"
    outputs = robot_outputs(layout, config) if layout.has_robot else 0
    corrects = config.baseline != "none"
    return Sizes(
        robot=see.robot(x).shape[1] + corrects * outputs if layout.has_robot else 0,
        objects=see.objects(x, context).shape[2] + corrects * OBJECT_OUTPUTS,
        many=len(layout.objects),
        edges=EDGE_FEATURES if pairs and config.relative else 0,
        attributes=len(layout.attributes),
        world=len(layout.settings),
        control=controls + len(see.servos),
        robot_out=outputs,
        objects_out=OBJECT_OUTPUTS,
    )


def example(layout: Layout, batch: int = 1) -> tuple[Entities, Context]:
    """A state and a context with the right shapes."""
    count = len(layout.objects)
    quat = torch.zeros(batch, count, 4)
    quat[..., 0] = 1.0
    zero = torch.zeros(batch, count, 3)
    hand = torch.eye(3).flatten().expand(batch, 9)
    edge = torch.zeros(batch, 3)
    x = Entities(
        torch.zeros(batch, len(layout.joints)),
        torch.zeros(batch, len(layout.joints)),
        torch.zeros(batch, layout.na),
        torch.cat([edge, hand, edge, edge], 1) if layout.hand else torch.zeros(batch, 0),
        zero,
        quat,
        zero,
        zero,
    )
    attributes = torch.zeros(batch, count, len(layout.attributes))
    return x, Context(attributes, torch.zeros(batch, len(layout.settings)), zero[..., 0] + 1)


def _share(std: Tensor, groups: tuple[tuple[int, int], ...]) -> None:
    """One scale for the components of a vector: no direction is special."""
    for start, end in groups:
        if end <= len(std):
            std[start:end] = std[start:end].square().mean().sqrt()
