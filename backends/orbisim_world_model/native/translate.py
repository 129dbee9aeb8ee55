"""From a traced graph of torch operations to C."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from orbisim.errors import OrbiSimError
from orbisim_world_model.native.values import Value, contiguous
from orbisim_world_model.native.writer import Writer

aten = torch.ops.aten

_MOVES = {
    *(aten.view.default, aten.reshape.default, aten.unsqueeze.default, aten.permute.default),
    *(aten.slice.Tensor, aten.select.int, aten.squeeze.dims, aten.squeeze.dim),
    *(aten.expand.default, aten.index_select.default, aten.index.Tensor, aten.clone.default),
    *(aten.split_with_sizes.default, aten.alias.default, aten.flip.default, aten.t.default),
    *(aten.transpose.int, aten._to_copy.default, aten.detach.default, aten.diagonal.default),
}
_UNARY = {
    aten.sigmoid.default: "sigmoid({0})",
    aten.tanh.default: "squash({0})",
    aten.exp.default: "expf(clampf({0}, -80.0f, 80.0f))",
    aten.sin.default: "sinf({0})",
    aten.cos.default: "cosf({0})",
    aten.asinh.default: "copysignf(logf(fabsf({0}) + sqrtf({0} * {0} + 1.0f)), {0})",
    aten.sqrt.default: "sqrtf({0})",
    aten.rsqrt.default: "1.0f / sqrtf({0})",
    aten.reciprocal.default: "1.0f / {0}",
    aten.log.default: "logf({0})",
    aten.log1p.default: "log1pf({0})",
    aten.neg.default: "-{0}",
    aten.abs.default: "fabsf({0})",
}
_BINARY = {
    aten.add.Tensor: "{0} + {1}",
    aten.sub.Tensor: "{0} - {1}",
    aten.mul.Tensor: "{0} * {1}",
    aten.div.Tensor: "{0} / {1}",
    aten.rsub.Scalar: "{1} - {0}",
    aten.lt.Scalar: "({0} < {1}) ? 1.0f : 0.0f",
    aten.lt.Tensor: "({0} < {1}) ? 1.0f : 0.0f",
    aten.gt.Tensor: "({0} > {1}) ? 1.0f : 0.0f",
    aten.gt.Scalar: "({0} > {1}) ? 1.0f : 0.0f",
    aten.bitwise_and.Tensor: "{0} * {1}",
    aten.maximum.default: "({0} > {1}) ? {0} : {1}",
    aten.minimum.default: "({0} < {1}) ? {0} : {1}",
}


class UntranslatableError(OrbiSimError):
    """The graph has an operation that is not known here."""


class Translator:
    """Walks a graph; what does not depend on its inputs is computed, the rest is written.

    Args:
      module: a traced function of `inputs` tensors.
    """

    def __init__(self, module: Any) -> None:
        self.module, self.writer = module, Writer()
        self._values: dict[Any, Any] = {}

    def run(self) -> list[Value]:
        """Writes everything; returns the outputs."""
        number = 0
        for node in self.module.graph.nodes:
            if node.op == "placeholder":
                self._values[node] = contiguous(f"in[{number}]", 0, node.meta["val"].shape)
                number += 1
            elif node.op == "get_attr":
                self._values[node] = getattr(self.module, node.target).detach()
            elif node.op == "call_function":
                self._values[node] = self._call(node)
            elif node.op == "output":
                return [self._written(self._values[item]) for item in node.args[0]]
        raise UntranslatableError("a graph without output")

    def _call(self, node: Any) -> Any:
        args = torch.fx.node.map_arg(node.args, lambda item: self._values[item])
        flat = _leaves(args)
        if not any(isinstance(leaf, Value) for leaf in flat):
            return node.target(*args, **node.kwargs)
        if node.target is operator.getitem:
            return args[0][args[1]]
        if node.target in _MOVES:
            return _moved(node.target, args, node.kwargs)
        shape = _shape(node)
        found = _without_zeros(node.target, shape, args, node.kwargs)
        if found is not None:
            return found
        if node.target in _UNARY:
            return self.writer.elementwise(shape, _UNARY[node.target], [args[0]])
        if node.target in _BINARY:
            return self._binary(_BINARY[node.target], shape, args, node.kwargs)
        special: Callable[..., Any] | None = getattr(self, _special(node.target), None)
        if special is None:
            raise UntranslatableError(str(node.target))
        return special(shape, *args, **node.kwargs)

    def _binary(self, formula: str, shape: Any, args: Any, kwargs: Any) -> Value:
        scale = float(kwargs.get("alpha", 1))
        a, b = args[:2]
        inputs = [item for item in (a, b) if isinstance(item, (Value, Tensor))]
        names, slots = iter(("{0}", "{1}")), []
        for item in (a, b):
            known = isinstance(item, (Value, Tensor))
            slots.append(next(names) if known else f"({float(item)!r}f)")
        if scale != 1.0:
            slots[1] = f"({scale!r}f) * {slots[1]}"
        text = formula.replace("{0}", "<0>").replace("{1}", "<1>")
        text = text.replace("<0>", slots[0]).replace("<1>", slots[1])
        return self.writer.elementwise(shape, text, [self._written(item) for item in inputs])

    # -- operations with a method of their own -------------------------------------------------

    def _op_pow(self, shape: Any, x: Value, exponent: float) -> Value:
        if float(exponent) == 2.0:
            return self.writer.elementwise(shape, "{0} * {0}", [x])
        return self.writer.elementwise(shape, f"powf({{0}}, {float(exponent)!r}f)", [x])

    def _op_clamp(
        self, shape: Any, x: Value, low: float | None = None, high: float | None = None
    ) -> Value:
        bounds = (-3e38 if low is None else low, 3e38 if high is None else high)
        text = f"clampf({{0}}, {float(bounds[0])!r}f, {float(bounds[1])!r}f)"
        return self.writer.elementwise(shape, text, [x])

    _op_clamp_min = _op_clamp

    def _op_where(self, shape: Any, condition: Any, a: Any, b: Any) -> Value:
        inputs = [self._written(item) for item in (condition, a, b)]
        return self.writer.elementwise(shape, "({0} != 0.0f) ? {1} : {2}", inputs)

    def _op_full_like(self, shape: Any, x: Value, fill: float, **_: Any) -> Tensor:
        return torch.full(shape, fill)

    def _op_cat(self, shape: Any, parts: list[Any], axis: int = 0) -> Value:
        filled = [self._written(part) for part in parts if _filled(part)]
        return self.writer.concatenated(filled, axis) if filled else self.writer.room(shape)

    def _op_sum(self, shape: Any, x: Value, axes: list[int], keep: bool = False, **_: Any) -> Value:
        return self.writer.summed(x, list(axes), keep)

    def _op_mean(
        self, shape: Any, x: Value, axes: list[int], keep: bool = False, **_: Any
    ) -> Value:
        total = self.writer.summed(x, list(axes), keep)
        count = x.index.numel() // max(total.index.numel(), 1)
        return self.writer.elementwise(total.shape, f"{{0}} * {1.0 / count!r}f", [total])

    def _op_bmm(self, shape: Any, a: Any, b: Any) -> Value:
        a, b = self._written(a), self._written(b)
        many, rows, inner = a.shape
        each = (many, rows, inner, b.shape[2])
        left = a.moved(a.index[..., None].expand(each))
        right = b.moved(b.index[:, None].expand(each))
        terms = self.writer.elementwise(each, "{0} * {1}", [left, right])
        return self.writer.summed(terms, [2], False)

    def _op_div(self, shape: Any, a: Any, b: float, rounding_mode: str) -> Value:
        if rounding_mode != "floor":
            raise UntranslatableError(f"a quotient that is rounded by {rounding_mode!r}")
        return self._binary("floorf({0} / {1})", shape, (a, b), {})

    def _op_gather(self, shape: Any, x: Any, axis: int, index: Any) -> Value:
        if isinstance(x, Value) and isinstance(index, Tensor):
            return x.moved(x.index.gather(axis, index))
        return self.writer.gathered(self._written(x), axis % len(shape), index)

    def _op_argmin(self, shape: Any, x: Value, axis: int, keep: bool = False) -> Value:
        return self.writer.least(x, axis % len(x.shape), keep)

    def _op__softmax(self, shape: Any, x: Value, axis: int, half: bool) -> Value:
        above = self._largest(x, axis % len(shape))
        e = self.writer.elementwise(shape, "expf(clampf({0} - {1}, -80.0f, 0.0f))", [x, above])
        total = self.writer.summed(e, [axis], True)
        return self.writer.elementwise(shape, "{0} / {1}", [e, total])

    def _largest(self, x: Value, axis: int) -> Value:
        """The largest of each row, by halves."""
        while (count := x.shape[axis]) > 1:
            half = count // 2
            cuts = ((0, half), (half, 2 * half), (2 * half, count))
            one, other, spare = (_moved(aten.slice.Tensor, (x, axis, *cut), {}) for cut in cuts)
            best = self.writer.elementwise(one.shape, "({0} > {1}) ? {0} : {1}", [one, other])
            x = self.writer.concatenated([best, spare], axis) if count % 2 else best
        return x

    def _op_native_layer_norm(
        self, shape: Any, x: Value, size: Any, weight: Any, bias: Any, eps: float
    ) -> tuple[Value]:
        writer, count = self.writer, int(size[0])
        x = writer.elementwise(x.shape, "{0}", [x])
        out, rows = writer.room(x.shape), x.index.numel() // count
        source, target = int(x.index.reshape(-1)[0]), int(out.index.reshape(-1)[0])
        writer.lines.append(
            f"normalize(w + {source}, w + {target}, {rows}, {count}, {float(eps)!r}f);"
        )
        if weight is None:
            return (out,)
        scaled = "{0} * {1} + {2}"
        given = [out, self._written(weight), self._written(bias)]
        return (writer.elementwise(shape, scaled, given),)

    def _op_addmm(self, shape: Any, bias: Tensor, x: Value, weight: Tensor) -> Value:
        if isinstance(weight, Value) or isinstance(bias, Value):
            raise UntranslatableError("a product of two inputs")
        return self.writer.product(x, weight, bias)

    def _op_mm(self, shape: Any, x: Value, weight: Tensor) -> Value:
        return self._op_addmm(shape, torch.zeros(shape[1]), x, weight)

    def _written(self, item: Any) -> Value:
        return item if isinstance(item, Value) else self.writer.constant(item)


def simplified(module: Any) -> Any:
    """The module without what only makes zeros: its nodes become constants, and what nothing else
    needs goes. Of a scene in which nothing can be touched that is the whole network.
    """
    first, graph = Translator(module), module.graph
    first.run()
    for number, node in enumerate(list(graph.nodes)):
        value = first._values.get(node)
        if node.op != "call_function" or not isinstance(value, Tensor):
            continue
        name = f"_known_{number}"
        module.register_buffer(name, value)
        with graph.inserting_before(node):
            constant = graph.get_attr(name)
        node.replace_all_uses_with(constant)
    graph.eliminate_dead_code()
    return module


def _without_zeros(target: Any, shape: Any, args: Any, kwargs: Any) -> Any:
    """What a product, sum or choice comes to where a constant decides it; None where none does.

    Products with zeros are taken to be zero: `NativeStep` steps finite numbers only.
    """
    if target in (aten.mul.Tensor, aten.div.Tensor):
        if _zero(args[0]) or (target == aten.mul.Tensor and _zero(args[1])):
            return torch.zeros(shape)
    elif target in (aten.add.Tensor, aten.sub.Tensor):
        if _zero(args[1]):
            return _spread(args[0], shape)
        if _zero(args[0]) and target == aten.add.Tensor and not kwargs:
            return _spread(args[1], shape)
    elif target == aten.where.self and isinstance(args[0], Tensor):
        if bool(args[0].all()):
            return _spread(args[1], shape)
        if not bool(args[0].any()):
            return _spread(args[2], shape)
    return None


def _zero(item: Any) -> bool:
    return isinstance(item, Tensor) and not bool(item.any())


def _spread(item: Any, shape: Any) -> Any:
    return item.moved(item.index.expand(shape)) if isinstance(item, Value) else item.expand(shape)


def _moved(target: Any, args: Any, kwargs: Any) -> Any:
    """An operation that moves numbers, done to their indices."""
    value, rest = args[0], args[1:]
    kept = {name: v for name, v in kwargs.items() if name not in ("dtype", "device", "layout")}
    found = target(value.index, *rest, **kept)
    if isinstance(found, Tensor):
        return value.moved(found)
    return tuple(value.moved(part) for part in found)


def _shape(node: Any) -> tuple[int, ...]:
    meta = node.meta["val"]
    return tuple(int(size) for size in (meta[0] if isinstance(meta, (tuple, list)) else meta).shape)


def _special(target: Any) -> str:
    return "_op_" + str(target).removeprefix("aten.").split(".")[0]


def _filled(part: Any) -> bool:
    return bool(part.index.numel() if isinstance(part, Value) else part.numel())


def _leaves(args: Any) -> list[Any]:
    if isinstance(args, (list, tuple)):
        return [leaf for item in args for leaf in _leaves(item)]
    return [args]
