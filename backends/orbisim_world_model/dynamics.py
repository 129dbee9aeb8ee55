"""Equation Dynamics: x_t = f_dyn(x_{0:t-1}, a_{t-1}, x), one control step at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from orbisim.errors import InputError
from orbisim_world_model.articulation import LIMB_OUTPUTS
from orbisim_world_model.config import ModelConfig
from orbisim_world_model.contacts import SEEN, Contacts, Geometry
from orbisim_world_model.entities import Context, Entities
from orbisim_world_model.features import Features
from orbisim_world_model.integrate import OBJECT_OUTPUTS, Raw, advance, required, robot_outputs
from orbisim_world_model.kinematics import Kinematics
from orbisim_world_model.layout import Layout
from orbisim_world_model.network.coupling import token_mask
from orbisim_world_model.network.dreamer import DreamerNetwork
from orbisim_world_model.network.inputs import Inputs, Outputs, Sizes
from orbisim_world_model.network.monolith import GlobalNetwork
from orbisim_world_model.network.objects import ObjectCentricNetwork
from orbisim_world_model.network.still import StillNetwork
from orbisim_world_model.normalization import Normalizer
from orbisim_world_model.parts import OUTPUTS
from orbisim_world_model.rest import Rest
from orbisim_world_model.rotation import rotate_back, to_matrix
from orbisim_world_model.spread import Spread

_NETWORKS: dict[str, Any] = {
    "global": GlobalNetwork,
    "dreamer": DreamerNetwork,
    "constant_velocity": StillNetwork,
}


_LEAST = 1e-3
"""Least scale of what is seen of contacts, all of order 1 (or m): a direction that never varies in
the data but by rounding is not blown up."""


_RIDGE = 1e-5
"""Of `Dynamics.fit_linear`, in units of the features' variance: many follow from one another."""


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


class Transitions(NamedTuple):
    """Single steps of the training data: states before and after, and what acted."""

    x: Entities
    after: Entities
    control: Tensor
    context: Context
    base: Entities | None = None


SHARED = (
    "see_objects",
    "see_edges",
    "see_attributes",
    "see_world",
    "object_scale",
    "network.start",
    "network.f_enc.objects",
    "network.f_cp",
    "network.f_rec",
    "network.f_tra",
    "network.f_dec.objects",
    "network.f_imp",
    "network.object_condition",
    "see_parts",
    "see_part_attributes",
    "part_scale",
    "network.f_enc.parts",
    "network.f_dec.parts",
    "network.part_condition",
)
"""The parts of a model that know nothing of its robot."""


class Dynamics(nn.Module):
    """Equation Dynamics: a network between normalised features and an integrator.

    Args:
      layout: of the scene.
      config: of the network.
    """

    def __init__(self, layout: Layout, config: ModelConfig) -> None:
        super().__init__()
        self.layout, self.config = layout, config
        self.kinematics = Kinematics(layout) if layout.hand and config.extended else None
        self.rest = Rest(layout) if config.rest and Rest.suits(layout) else None
        chosen = config.boxes or config.apart
        self.contacts = Contacts(layout) if chosen and Contacts.suits(layout) else None
        if config.articulated and config.kind == "objects" and not layout.articulated:
            raise InputError(
                "a model of limbs needs scenes of robots without free bodies, read as limbs "
                f"(packing.with_limbs); this layout has {len(layout.objects)} objects"
            )
        if layout.parts and not (
            config.extended
            and config.residual
            and config.kind in ("objects", "constant_velocity")
            and config.baseline == "none"
        ):
            raise InputError(
                "parts of mechanisms need tokens, the extended state and predicted changes: a "
                f"configuration such as 'parts'; not one of kind {config.kind!r} with extended = "
                f"{config.extended}, residual = {config.residual}, baseline {config.baseline!r}"
            )
        self.controls = layout.nu  # the number of an `action` is set by `with_controls`
        self.network: Any = None
        self.spread: Spread | None = None

    def build(self, controls: int) -> Dynamics:
        """Makes the network for so many controls; returns itself."""
        layout, config = self.layout, self.config
        self.features = Features(layout, config)
        sizes = _sizes(self.features, controls, self.contacts)
        self.sizes = sizes
        self.controls = controls
        extra = OBJECT_OUTPUTS if config.baseline != "none" else 0
        self.see_robot = Normalizer(sizes.robot - (sizes.robot_out if extra else 0))
        self.see_objects = Normalizer(sizes.objects - extra)
        self.see_edges = Normalizer(sizes.edges or self.features.pairs)
        self.see_attributes, self.see_world = Normalizer(sizes.attributes), Normalizer(sizes.world)
        self.see_control = Normalizer(sizes.control)
        centered = not config.residual
        self.robot_scale = Normalizer(sizes.robot_out, centered=centered, output=True)
        self.object_scale = Normalizer(sizes.objects_out, centered=centered, output=True)
        corrects = config.baseline != "none"
        self.see_parts: Any = None
        self.see_part_attributes: Any = None
        self.part_scale: Any = None
        if sizes.parts:
            self.see_parts = Normalizer(sizes.part_features)
            self.see_part_attributes = Normalizer(sizes.part_attributes)
            self.part_scale = Normalizer(4, centered=False, output=True)
        self.base_robot = Normalizer(sizes.robot_out if corrects else 0)
        self.base_objects = Normalizer(sizes.objects_out if corrects else 0)
        if config.linear:  # fitted, not trained: a step of training would only blur it
            shape = sizes.robot_out, sizes.robot + sizes.control + 1
            self.register_buffer("linear", torch.zeros(shape))
        if config.kind == "objects":
            self.network = ObjectCentricNetwork(sizes, config, self.contacts)
        else:
            self.network = _NETWORKS[config.kind](sizes, config)
        return self

    def with_spread(self, width: int) -> Dynamics:
        """Also predicts how far off it may be, as two more numbers of each token's memory."""
        if self.config.kind != "objects":
            raise InputError(f"a network of kind {self.config.kind!r} has no tokens to be off")
        if self.layout.parts:
            raise InputError("how far off parts of mechanisms may be is not predicted yet")
        self.spread = Spread(self.sizes, width)
        return self

    def with_rest(self) -> Dynamics:
        """Also keeps boxes at rest (see `rest`), which needs no weights."""
        self.config = dataclasses.replace(self.config, rest=True)
        self.rest = Rest(self.layout) if Rest.suits(self.layout) else None
        return self

    # -- one step ------------------------------------------------------------------------------

    def initial_memory(self, batch: int) -> Tensor:
        """h_0 [B, ...], when nothing is known of the past; with a spread, [B, K, width + 2].

        A network without memory then leaves its part out: [B, K, 2].
        """
        h = self.network.initial_memory(batch)
        if self.spread is None:
            return h
        exact = h.new_zeros((*h.shape[:2], 2), dtype=torch.float32)
        return torch.cat([h.float(), exact], dim=-1) if self._remembers else exact

    @property
    def _remembers(self) -> bool:
        return self.config.memory != "none"

    def variance(self, memory: Tensor) -> Tensor:
        """The variances [B, K, 2] in a memory (see `Spread`)."""
        return memory[..., -2:]

    def completed(self, x: Entities) -> Entities:
        """The state with the hand's pose and velocity that follow from the joints."""
        if self.kinematics is None:
            return x
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
        inputs = self.inputs(x, control, context, base)
        if self.spread is None:
            out = self.network(self._cast(inputs), memory, observe)
            return self._advanced(x, inputs, out, context, base)
        h = memory[..., :-2] if self._remembers else self.network.initial_memory(len(x.pos))
        out = self.network(self._cast(inputs), h.to(self.network.start.dtype), observe)
        variance = self.spread(inputs, self.variance(memory))
        kept = [out.memory.float(), variance] if self._remembers else [variance]
        out = out._replace(memory=torch.cat(kept, dim=-1))
        return self._advanced(x, inputs, out, context, base)

    def _advanced(
        self, x: Entities, inputs: Inputs, out: Outputs, context: Context, base: Entities | None
    ) -> Step:
        mask = context.mask
        if self.features.limbs is not None:
            assert inputs.known is not None and out.parts is not None
            said = out.parts.to(x.q.dtype)
            if self.config.kind == "constant_velocity":
                state = x._replace(q=x.q + self.layout.timestep * x.v)
            else:
                state = self.features.limbs.advance(x, inputs.known, said, context)
            return Step(state, out.memory, out.latent, out.penalty)
        if self.config.linear:
            straight = _with_one(inputs) @ self.linear.T
            out = out._replace(robot=out.robot.to(straight.dtype) + straight)
        raw = Raw(*self._unscaled(out, x.pos.dtype, context))
        if out.impulses is not None:
            raw = self._pushed(x, inputs, out.impulses.to(x.pos.dtype), context, raw)
        if mask is not None and self.config.residual:  # objects that are not there stay at rest
            raw = raw._replace(objects=raw.objects * mask[..., None])
        if base is None:
            state = advance(x, raw, self.layout.timestep, self.config)
            if self.features.parts is not None and out.parts is not None:
                share = out.parts[..., 2].to(x.pos.dtype).sigmoid()
                state = self.features.parts.carried(x, self.completed(state), share, context)
                state = self.features.parts.limited(state, context)
            if self.contacts is not None and self.config.apart:
                state = self.contacts.apart(self.completed(state), context)
            if self.rest is not None and not self.training:  # what it holds teaches nothing
                state = self.rest(x, state, context)
        else:
            state = advance(base, raw, 0.0, self.config)
        return Step(self.completed(state), out.memory, out.latent, out.penalty)

    def _pushed(
        self, x: Entities, inputs: Inputs, wanted: Tensor, context: Context, raw: Raw
    ) -> Raw:
        """The decoder's numbers with the changes of velocity by contacts' impulses added."""
        assert self.contacts is not None and inputs.contacts is not None
        dvel, dang = self.contacts.changes(x, context, inputs.contacts, wanted)
        if self.config.relative:
            rot = to_matrix(x.quat)
            dvel, dang = rotate_back(rot, dvel), rotate_back(rot, dang)
        own, vel, ang = raw.objects.split((7, 3, 3), dim=-1)
        return raw._replace(objects=torch.cat([own, vel + dvel, ang + dang], dim=-1))

    def encode(self, x: Entities, memory: Tensor, control: Tensor, context: Context) -> Tensor:
        """z_t = f_enc(h_t, x_t)."""
        inputs = self._cast(self.inputs(x, control, context))
        return self.network.encode(inputs, memory)

    def inputs(
        self, x: Entities, control: Tensor, context: Context, base: Entities | None = None
    ) -> Inputs:
        """Normalised features."""
        see, edges, contacts = self.features, None, self._geometry(x, context)
        if self.sizes.edges:
            edges = self.see_edges(self._edges(x, context, contacts))
        robot, objects = self.see_robot(see.robot(x)), self.see_objects(see.objects(x, context))
        if base is not None:
            change = required(x, base, self.layout.timestep, self.config)
            robot = torch.cat([robot, self.base_robot(change.robot)], dim=-1)
            objects = torch.cat([objects, self.base_objects(change.objects)], dim=-1)
        more: dict[str, Any] = {}
        if see.limbs is not None:
            known = see.limbs.known(x, control, context)
            more = {
                "parts": self.see_parts(see.limbs.seen_of(x, known, context)),
                "part_attributes": self._part_attributes(context),
                "part_mask": context.part_mask,
                "known": known,
            }
        if see.parts is not None:
            more = {
                "parts": self.see_parts(see.parts.features(x, control, context)),
                "part_attributes": self._part_attributes(context),
                "part_mask": context.part_mask,
            }
        return Inputs(
            robot,
            objects,
            edges,
            self.see_attributes(context.attributes),
            self.see_world(context.world),
            self.see_control(see.control(x, control)),
            context.mask,
            contacts,
            **more,
            scales=context.scales,
        )

    def described(self, context: Context) -> Context:
        """The same with what the network makes of descriptors alone, for steps that share them.

        Of networks that make it apart from states (`describes`).
        """
        if not getattr(self.network, "describes", False):
            return context
        seen = [self.see_attributes(context.attributes), self.see_world(context.world)]
        if self.see_parts is not None:
            seen.append(self._part_attributes(context))
        dtype = self.network.start.dtype
        return context._replace(scales=self.network.scales(*(part.to(dtype) for part in seen)))

    def _part_attributes(self, context: Context) -> Tensor:
        """[B, P, A]: normalised, what conditions parts or limbs."""
        see: Any = self.features.parts or self.features.limbs
        found: Tensor = self.see_part_attributes(see.attributes(context))
        return found

    def _geometry(self, x: Entities, context: Context) -> Geometry | None:
        if self.contacts is None or not self.config.boxes:
            return None
        return self.contacts.geometry(x, context)

    def _edges(self, x: Entities, context: Context, contacts: Geometry | None) -> Tensor:
        """[B, K, K, E]: what tokens see of each other, and of their contacts."""
        seen = self.features.edges(x, context)
        if contacts is None or self.contacts is None:
            return seen
        rot = self.features.frames(x, context)[1]
        return torch.cat([seen, self.contacts.edges(x, context, contacts, rot)], dim=-1)

    # -- scales --------------------------------------------------------------------------------

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def fit(self, transitions: Transitions) -> None:
        """Takes all scales from transitions of the training data."""
        fit_together([self], [transitions])

    @torch.no_grad()  # type: ignore[untyped-decorator]
    def fit_linear(self, transitions: Transitions) -> None:
        """Takes `linear` from the data, by ridge regression, after the scales."""
        if not self.config.linear:
            return
        x, after = self.completed(transitions.x), self.completed(transitions.after)
        inputs = self.inputs(x, transitions.control, transitions.context, transitions.base)
        raw = required(x, after, self.layout.timestep, self.config).robot
        if self.features.parts is not None:
            raw = self.features.parts.split(raw)[0]
        wanted = self.robot_scale(raw).double()
        wanted[:, self.robot_scale.std == 0] = 0.0
        seen = _with_one(inputs).double()
        square = seen.T @ seen
        square = square + _RIDGE * len(seen) * torch.eye(len(square), device=square.device)
        self.linear.copy_(torch.linalg.solve(square, seen.T @ wanted).T)

    def scale_rows(self, transitions: Transitions) -> dict[str, tuple[Tensor, Tensor | None]]:
        """What each normaliser is fitted to, by its name: values [..., size] and weights [...]."""
        x, after = self.completed(transitions.x), self.completed(transitions.after)
        control, context, base = transitions.control, transitions.context, transitions.base
        mask, see = context.mask, self.features
        if see.limbs is not None:
            there = context.part_mask
            return {
                "see_parts": (see.limbs.features(x, control, context), there),
                "see_part_attributes": (see.limbs.attributes(context), there),
                "see_world": (context.world, None),
            }
        rows: dict[str, tuple[Tensor, Tensor | None]] = {
            "see_robot": (see.robot(x), None),
            "see_objects": (see.objects(x, context), mask),
            "see_attributes": (context.attributes, mask),
            "see_world": (context.world, None),
            "see_control": (see.control(x, control), None),
        }
        if self.sizes.edges:
            pairs = None
            if mask is not None:
                tokens = token_mask(mask, self.layout.robot_token, context.part_mask)
                pairs = tokens[:, :, None] * tokens[:, None, :]
            rows["see_edges"] = self._edges(x, context, self._geometry(x, context)), pairs
        dt = self.layout.timestep
        if base is None:
            raw = required(x, after, dt, self.config)
        else:
            raw = required(base, after, 0.0, self.config)
            change = required(x, base, dt, self.config)
            rows["base_robot"] = change.robot, None
            rows["base_objects"] = change.objects, mask
        rows["robot_scale"] = raw.robot, None
        if see.parts is not None:
            there = context.part_mask
            robot, moves = see.parts.split(raw.robot)
            rows["robot_scale"] = robot, None
            rows["part_scale"] = see.parts.by_type(moves, context), there
            rows["see_parts"] = see.parts.features(x, control, context), there
            rows["see_part_attributes"] = see.parts.attributes(context), there
        rows["object_scale"] = raw.objects, mask
        return rows

    # -- several robots ------------------------------------------------------------------------

    def share(self, others: Sequence[Dynamics]) -> None:
        """Takes over all parts of other models but those of their robots; each from the first that
        has the same (a model of objects has none of what mechanisms need, and the other way round).

        Raises:
          InputError: their objects or world settings differ, the network has no tokens, or one has
            objects and another mechanisms without `ModelConfig.mixed`.
        """
        for lead in others:
            ours, theirs = self.layout, lead.layout
            same = ours.settings == theirs.settings and self.sizes.edges == lead.sizes.edges
            kinds = (ours.attributes, ours.part_columns), (theirs.attributes, theirs.part_columns)
            many = (ours.objects and theirs.objects) or (ours.parts and theirs.parts)
            fits = self.config.mixed or (many and kinds[0] == kinds[1])
            if self.config.kind != "objects" or not same or not fits:
                raise InputError(
                    f"robots with joints {ours.joints} and {theirs.joints} fit into one model only "
                    "with object-centric tokens and the same descriptors, and objects and "
                    "mechanisms only with model.mixed"
                )
        for name in SHARED if others else ():
            module, last = _place(self, name)
            own = _shape(getattr(module, last))
            found = (getattr(_place(lead, name)[0], last) for lead in others)
            theirs_first = next((part for part in found if _shape(part) == own), None)
            if theirs_first is not None:
                setattr(module, last, theirs_first)

    def _unscaled(self, out: Outputs, dtype: Any, context: Context) -> tuple[Tensor, Tensor]:
        """The decoder's numbers in SI units."""
        robot = self.robot_scale.undo(out.robot.to(dtype))
        if self.features.parts is not None and out.parts is not None:
            scale = self.features.parts.chosen(self.part_scale.std, context)
            robot = self.features.parts.whole(robot, out.parts[..., :2].to(dtype) * scale)
        return robot, self.object_scale.undo(out.objects.to(dtype))

    def _cast(self, inputs: Inputs) -> Inputs:
        """To the network's own type, where it was converted to half precision."""
        start = getattr(self.network, "start", None)
        if start is None or start.dtype == inputs.robot.dtype:
            return inputs
        cast = {
            name: part.to(start.dtype)
            for name, part in inputs._asdict().items()
            if isinstance(part, Tensor)
        }
        return inputs._replace(**cast)


@torch.no_grad()  # type: ignore[untyped-decorator]
def fit_together(models: list[Dynamics], transitions: list[Transitions]) -> None:
    """Takes all scales from the data; parts that models share from the data of all of them."""
    rows = [model.scale_rows(part) for model, part in zip(models, transitions, strict=True)]
    for model, part in zip(models, transitions, strict=True):
        if model.contacts is not None:
            model.contacts.fit(model.completed(part.x), part.context)
    lead = models[0]
    for name in dict.fromkeys(name for mine in rows for name in mine):
        owners = {id(getattr(model, name)): getattr(model, name) for model in models}
        for owner in owners.values():
            parts = [
                mine[name]
                for model, mine in zip(models, rows, strict=True)
                if getattr(model, name) is owner and name in mine
            ]
            if len(parts) == 1:
                owner.fit(*parts[0])
            elif parts:
                values = torch.cat([v.reshape(-1, v.shape[-1]) for v, _ in parts])
                weights = [v.new_ones(v.shape[:-1]) if w is None else w for v, w in parts]
                owner.fit(values, torch.cat([w.reshape(-1) for w in weights]))
    if lead.contacts is not None:
        lead.see_edges.std.clamp_(min=_LEAST)
    for model, part in zip(models, transitions, strict=True):
        model.fit_linear(part)
    if lead.config.residual:
        _share(lead.object_scale.std, ((0, 3), (3, 7), (7, 10), (10, 13)))


def _with_one(inputs: Inputs) -> Tensor:
    """[B, F + U + 1]: what is seen of the robot and of the control, and a 1."""
    return torch.cat([inputs.robot, inputs.control, torch.ones_like(inputs.robot[:, :1])], dim=-1)


def _shape(part: nn.Module | Tensor | None) -> Any:
    """Of a parameter, or of all that a module has; None of what is not there."""
    if part is None or isinstance(part, Tensor):
        return None if part is None else part.shape
    return {name: tensor.shape for name, tensor in part.state_dict().items()}


def _place(model: nn.Module, name: str) -> tuple[nn.Module, str]:
    """The module that holds a part, and the part's name in it."""
    path, _, last = name.rpartition(".")
    return model.get_submodule(path), last


def _sizes(see: Features, controls: int, contacts: Contacts | None) -> Sizes:
    """Numbers of features, found by asking the functions that make them."""
    layout, config = see.layout, see.config
    x, context = example(layout)
    pairs = layout.tokens > 1 and config.kind == "objects" and not layout.articulated
    outputs = robot_outputs(layout, config) if layout.robot_token else 0
    corrects = config.baseline != "none"
    touching = contacts.slots * SEEN if contacts is not None and config.boxes else 0
    return Sizes(
        robot=see.robot(x).shape[1] + corrects * outputs if layout.robot_token else 0,
        objects=see.objects(x, context).shape[2] + corrects * OBJECT_OUTPUTS,
        many=len(layout.objects),
        edges=see.pairs + touching if pairs and config.relative else 0,
        attributes=len(layout.attributes),
        world=len(layout.settings),
        control=0 if see.limbs is not None else controls + len(see.servos),
        robot_out=outputs,
        objects_out=OBJECT_OUTPUTS,
        **_part_sizes(see, x, context, controls),
    )


def _part_sizes(see: Features, x: Entities, context: Context, controls: int) -> dict[str, int]:
    control = torch.zeros(1, max(controls, see.layout.nu))
    if see.limbs is not None:
        return {
            "parts": len(see.layout.parts),
            "part_features": see.limbs.features(x, control, context).shape[2],
            "part_attributes": see.limbs.attributes(context).shape[2],
            "part_outputs": LIMB_OUTPUTS,
        }
    if see.parts is None:
        return {}
    return {
        "part_outputs": OUTPUTS,
        "parts": len(see.layout.parts),
        "part_features": see.parts.features(x, control, context).shape[2],
        "part_attributes": see.parts.attributes(context).shape[2],
    }


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
    settings, mask = torch.zeros(batch, len(layout.settings)), zero[..., 0] + 1
    if not layout.parts:
        return x, Context(attributes, settings, mask)
    shape = (batch, len(layout.parts))
    parts = torch.zeros(*shape, len(layout.part_columns))
    return x, Context(attributes, settings, mask, parts, torch.ones(shape))


def _share(std: Tensor, groups: tuple[tuple[int, int], ...]) -> None:
    """One scale for the components of a vector: no direction is special."""
    for start, end in groups:
        if end <= len(std):
            std[start:end] = std[start:end].square().mean().sqrt()
