"""`TensorWorlds`: what `Worlds` is, of a tensor on any device.

Code of NumPy that was written for one world runs as operations of torch for all of them. It never
looks at a number on the host: a branch on a value is taken both ways, one after the other
(`Paths`), and what cannot be said without a number raises `NotBatchedError`.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch

from orbisim.vector.worlds import ManyWorlds, NotBatchedError

_TORCH = {
    np.dtype(name): getattr(torch, name)
    for name in ("bool", "uint8", "int8", "int16", "int32", "int64", "float32", "float64")
}
_NUMPY = {tensor: array for array, tensor in _TORCH.items()}

_MOST_CONSTANTS = 4096
"""Different numbers and arrays of a task's functions; more means that they change in each step."""
_MOST_PATHS = 32
"""Ways through a function by its branches, each of which costs as much as the function; and
branches on one of them."""


def torch_dtype(dtype: Any) -> torch.dtype:
    """Torch's name of a type of NumPy.

    Raises:
      NotBatchedError: torch has none.
    """
    found = _TORCH.get(np.dtype(dtype))
    if found is None:
        raise NotBatchedError(f"numbers of type {np.dtype(dtype)} on the device")
    return found


class Paths:
    """The branches that a function of values on the device can take, one way after the other."""

    def __init__(self) -> None:
        self._script: list[bool] = []
        self._choices: list[bool] = []
        self._mask: torch.Tensor | None = None

    def decide(self, mask: torch.Tensor) -> bool:
        """Which way to go on, at a branch that is taken where `mask` [nworld] is true."""
        at = len(self._choices)
        if at >= _MOST_PATHS:  # a loop ends where a number says so, and none is looked at
            raise NotBatchedError(f"more than {_MOST_PATHS} branches on the way")
        choice = self._script[at] if at < len(self._script) else True
        self._choices.append(choice)
        here = mask if choice else ~mask
        self._mask = here if self._mask is None else self._mask & here
        return choice

    def of(self, function: Callable[[], Any]) -> list[tuple[torch.Tensor | None, Any]]:
        """Calls a function once for each way through it.

        Returns:
          In which worlds [nworld] (None: in all), and what it gives there.

        Raises:
          NotBatchedError: there are too many ways.
        """
        found: list[tuple[torch.Tensor | None, Any]] = []
        self._script = []
        while True:
            self._choices, self._mask = [], None
            value = function()
            found.append((self._mask, value))
            left = list(self._choices)
            while left and not left[-1]:
                left.pop()
            if not left:
                return found
            if len(found) >= _MOST_PATHS:
                raise NotBatchedError(f"more than {_MOST_PATHS} ways through branches")
            self._script = [*left[:-1], False]


class Context:
    """What operations on one device share: constants that are there already, and branches.

    Args:
      device: where. nworld: number of worlds.
    """

    def __init__(self, device: Any, nworld: int) -> None:
        self.device, self.nworld = torch.device(device), nworld
        self.paths = Paths()
        self._constants: dict[Any, torch.Tensor] = {}

    def constant(self, value: Any, dtype: Any = None) -> torch.Tensor:
        """What is the same in all worlds, as a tensor; copied to the device once."""
        array = np.asarray(value, dtype)
        key = (array.dtype, array.shape, array.tobytes())
        found = self._constants.get(key)
        if found is None:
            if len(self._constants) >= _MOST_CONSTANTS:
                raise NotBatchedError("other numbers in every step that are not of the physics")
            kind = torch_dtype(array.dtype)
            found = torch.tensor(array.tolist(), dtype=kind, device=self.device)
            found = self._constants[key] = found.reshape(array.shape)
        return found

    def rows(self, value: Any, dtype: Any = None) -> torch.Tensor:
        """The rows [nworld, ...] of any value, of a type of NumPy."""
        if isinstance(value, TensorWorlds):
            return value.rows if dtype is None else _cast(value.rows, np.dtype(dtype))
        one = self.constant(value, dtype)
        return one.expand(self.nworld, *one.shape)


class TensorWorlds(np.lib.mixins.NDArrayOperatorsMixin, ManyWorlds):
    """One array for each world, of the same shape, on a device.

    Args:
      rows: [nworld, ...].
      context: of its device.
      frozen: whether elements may not be assigned, because the physics or a task keeps them.
    """

    __slots__ = ("context", "frozen", "rows")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, rows: torch.Tensor, context: Context, *, frozen: bool = False) -> None:
        self.rows, self.context, self.frozen = rows, context, frozen

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape in one world."""
        return tuple(self.rows.shape[1:])

    @property
    def ndim(self) -> int:
        """Number of axes in one world."""
        return self.rows.ndim - 1

    @property
    def size(self) -> int:
        """Number of elements in one world."""
        return math.prod(self.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the elements."""
        return _NUMPY[self.rows.dtype]

    @property
    def T(self) -> TensorWorlds:
        """Transposed in every world."""
        return self._view(self.rows.permute(0, *range(self.ndim, 0, -1)))

    def __repr__(self) -> str:
        return f"TensorWorlds({self.rows!r})"

    # -- what Python asks of a value ------------------------------------------------------------

    def __bool__(self) -> bool:
        if self.size != 1:
            raise ValueError("the truth value of an array with several elements is ambiguous")
        return self.context.paths.decide(self.rows.reshape(-1) != 0)

    def _flag(self) -> bool:
        if self.size != 1:
            raise TypeError("only arrays with one element can be made a Python number")
        if self.rows.dtype != torch.bool:
            raise NotBatchedError("float() or int() of a value on the device")
        return bool(self)

    def __float__(self) -> float:
        return float(self._flag())

    def __int__(self) -> int:
        return int(self._flag())

    def __index__(self) -> int:
        raise NotBatchedError("an index that differs from world to world")

    def __len__(self) -> int:
        if not self.ndim:
            raise TypeError("len() of a scalar")
        return self.shape[0]

    def __iter__(self) -> Iterator[TensorWorlds]:
        return (self[i] for i in range(len(self)))

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise NotBatchedError("np.array or np.asarray of a value that differs from world to world")

    # -- elements -------------------------------------------------------------------------------

    def _view(self, rows: torch.Tensor) -> TensorWorlds:
        return TensorWorlds(rows, self.context, frozen=self.frozen)

    def _new(self, rows: torch.Tensor) -> TensorWorlds:
        return TensorWorlds(rows, self.context)

    def __getitem__(self, key: Any) -> TensorWorlds:
        if _has_worlds(key):
            raise NotBatchedError("an index that differs from world to world")
        parts = key if isinstance(key, tuple) else (key,)
        if all(_is_basic(part) for part in parts):
            return self._view(self.rows[(slice(None), *parts)])
        index = np.arange(self.size).reshape(self.shape)[key]
        flat = self.rows.reshape(len(self.rows), -1)
        chosen = flat.index_select(1, self.context.constant(index.reshape(-1), np.int64))
        return self._new(chosen.reshape(len(self.rows), *index.shape))

    def __setitem__(self, key: Any, value: Any) -> None:
        if self.frozen:
            raise ValueError("assignment destination is read-only")
        parts = key if isinstance(key, tuple) else (key,)
        if _has_worlds(key) or not all(_is_basic(part) for part in parts):
            raise NotBatchedError("assignment to elements by lists or arrays")
        part = self.rows[(slice(None), *parts)]
        part.copy_(_aligned(value, part.ndim - 1, self.context))

    # -- NumPy's protocols ------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method == "reduce":
            return reduced(ufunc, *inputs, **kwargs)
        if ufunc is np.matmul and method == "__call__" and not kwargs:
            return dotted(*inputs)
        target = kwargs.pop("out", None)
        if method != "__call__" or ufunc not in _UFUNCS or kwargs:
            raise NotBatchedError(f"np.{ufunc.__name__} ({method}) on the device")
        result = _applied(ufunc, inputs, self.context)
        if target is None:
            return result
        (into,) = target
        if not isinstance(into, TensorWorlds):
            raise NotBatchedError("many worlds written into an array of one")
        into[...] = result
        return into

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        handler = _FUNCTIONS.get(func)
        result = handler(*args, **kwargs) if handler else NotImplemented
        if result is NotImplemented:
            raise NotBatchedError(f"np.{func.__name__} in this form on the device")
        return result

    # -- methods of arrays ------------------------------------------------------------------------

    def copy(self, *args: Any) -> TensorWorlds:
        """A copy."""
        return self._new(self.rows.clone())

    def astype(self, dtype: Any) -> TensorWorlds:
        """Converted elements."""
        return self._new(self.rows.to(torch_dtype(dtype), copy=True))

    def ravel(self) -> TensorWorlds:
        """One axis."""
        return self.reshape(-1)

    def flatten(self) -> TensorWorlds:
        """One axis, copied."""
        return self.ravel().copy()

    def reshape(self, *shape: Any) -> TensorWorlds:
        """Another shape of each world's array."""
        new = shape[0] if len(shape) == 1 and isinstance(shape[0], tuple | list) else shape
        known = np.empty(self.shape, np.bool_).reshape(*new).shape
        return self._view(self.rows.reshape(len(self.rows), *known))

    def transpose(self, *axes: Any) -> TensorWorlds:
        """Permuted axes."""
        if not axes:
            return self.T
        order = axes[0] if isinstance(axes[0], tuple | list) else axes
        return self._view(self.rows.permute(0, *(a % self.ndim + 1 for a in order)))

    def dot(self, other: Any) -> Any:
        """`np.dot` in every world."""
        return dotted(self, other)


def merged(parts: Sequence[tuple[torch.Tensor | None, Any]], context: Context) -> torch.Tensor:
    """The rows [nworld, ...] of a value that has several forms, each in some of the worlds.

    Raises:
      NotBatchedError: their shapes differ.
    """
    numbers = [value for _, value in parts]
    if any(not isinstance(v, TensorWorlds) and np.asarray(v).dtype == object for v in numbers):
        raise NotBatchedError("an observation or a reward that is no array of numbers")
    dtype = np.result_type(*(np.asarray(v) if not _is_worlds(v) else v.dtype for v in numbers))
    rows = [context.rows(value, dtype) for value in numbers]
    if len({part.shape for part in rows}) > 1:
        raise NotBatchedError("a value of different shapes in different worlds")
    found = rows[0]
    for (mask, _), part in zip(parts[1:], rows[1:], strict=True):
        assert mask is not None
        found = torch.where(mask.reshape(-1, *(1,) * (part.ndim - 1)), part, found)
    return found


# -- operations ------------------------------------------------------------------------------------


def _is_worlds(value: Any) -> bool:
    return isinstance(value, TensorWorlds)


def _has_worlds(value: Any) -> bool:
    if isinstance(value, tuple | list):
        return any(map(_has_worlds, value))
    return _is_worlds(value)


def _context(*values: Any) -> Context:
    for value in values:
        if isinstance(value, TensorWorlds):
            return value.context
        if isinstance(value, tuple | list) and _has_worlds(value):
            return _context(*value)
    raise NotBatchedError("no value of many worlds")


def _is_basic(part: Any) -> bool:
    if isinstance(part, slice):
        return part.step is None or part.step > 0
    is_number = isinstance(part, int | np.integer) and not isinstance(part, bool)
    return is_number or part is None or part is Ellipsis


def _cast(rows: torch.Tensor, dtype: np.dtype[Any]) -> torch.Tensor:
    return rows.to(torch_dtype(dtype))


def _kind(value: Any) -> Any:
    """The type that NumPy promotes by: Python's own numbers give way to arrays."""
    if isinstance(value, TensorWorlds):
        return value.dtype
    if isinstance(value, float | int) and not isinstance(value, bool | np.generic):
        return type(value)
    return np.asarray(value).dtype


def _ndim(value: Any) -> int:
    return value.ndim if isinstance(value, TensorWorlds) else int(np.ndim(value))


def _aligned(value: Any, ndim: int, context: Context, dtype: Any = None) -> torch.Tensor:
    """The rows with so many axes beside the world's; what is the same in all worlds as it is."""
    if not isinstance(value, TensorWorlds):
        return context.constant(value, dtype)
    rows = value.rows if dtype is None else _cast(value.rows, np.dtype(dtype))
    fill = (1,) * (ndim - value.ndim)
    return rows.reshape(len(rows), *fill, *value.shape) if fill else rows


@functools.lru_cache(maxsize=4096)
def _loop(ufunc: np.ufunc, kinds: tuple[Any, ...]) -> tuple[np.dtype[Any], ...]:
    """The types of a ufunc's inputs and output, by NumPy's own rules."""
    return tuple(ufunc.resolve_dtypes((*kinds, None)))


def _applied(ufunc: np.ufunc, inputs: Sequence[Any], context: Context) -> TensorWorlds:
    *types, out = _loop(ufunc, tuple(map(_kind, inputs)))
    ndim = max(map(_ndim, inputs))
    tensors = [_aligned(x, ndim, context, t) for x, t in zip(inputs, types, strict=True)]
    result = _UFUNCS[ufunc](*tensors)
    return TensorWorlds(_cast(result, out), context)


def _axes(axis: Any, ndim: int) -> tuple[int, ...]:
    """Axes of rows that those of one world are."""
    if axis is None:
        return tuple(range(1, ndim + 1))
    chosen = axis if isinstance(axis, tuple | list) else (axis,)
    return tuple(operator.index(a) % ndim + 1 for a in chosen)


def reduced(ufunc: np.ufunc, x: Any, axis: Any = 0, **kwargs: Any) -> Any:
    """`ufunc.reduce` in every world."""
    if {k for k, v in kwargs.items() if v not in (None, False, np._NoValue)}:
        raise NotBatchedError(f"np.{ufunc.__name__}.reduce with {', '.join(kwargs)}")
    if ufunc not in _REDUCTIONS or not isinstance(x, TensorWorlds):
        raise NotBatchedError(f"np.{ufunc.__name__}.reduce on the device")
    rows, dims = x.rows, _axes(axis, x.ndim)
    if not dims:
        return x.copy()
    order = [d for d in range(rows.ndim) if d not in dims]
    kept = [rows.shape[d] for d in order]
    flat = rows.permute(*order, *dims).reshape(*kept, -1)
    return x._new(_REDUCTIONS[ufunc](flat))


def dotted(a: Any, b: Any) -> Any:
    """`np.dot`."""
    if 0 in (_ndim(a), _ndim(b)):
        return np.multiply(a, b)
    if max(_ndim(a), _ndim(b)) > 2:
        raise NotBatchedError("np.dot of more than two axes")
    context = _context(a, b)
    sides = [x.rows if isinstance(x, TensorWorlds) else context.constant(x)[None] for x in (a, b)]
    if any(not side.dtype.is_floating_point for side in sides):
        raise NotBatchedError("np.dot of integers")
    left, right = (side.double() for side in sides)
    left = left[:, None, :] if _ndim(a) == 1 else left
    right = right[:, :, None] if _ndim(b) == 1 else right
    product = torch.matmul(left, right)
    shape = (*np.shape(a)[:-1], *np.shape(b)[1:])
    return TensorWorlds(product.reshape(context.nworld, *shape), context)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    one_axis = x.ndim == 1 or isinstance(axis, int)
    if keepdims or not (ord is None or (ord == 2 and one_axis)):
        return NotImplemented
    return np.sqrt(reduced(np.add, np.square(x), axis=axis))


def _reduction(ufunc: np.ufunc) -> Callable[..., Any]:
    def function(a: Any, axis: Any = None, **kwargs: Any) -> Any:
        if not isinstance(a, TensorWorlds) or kwargs:
            return NotImplemented
        return reduced(ufunc, a, axis=axis)

    return function


def _mean(a: Any, axis: Any = None, **kwargs: Any) -> Any:
    if kwargs or not isinstance(a, TensorWorlds):
        return NotImplemented
    count = math.prod(a.rows.shape[d] for d in _axes(axis, a.ndim))
    return reduced(np.add, a, axis=axis) / float(count)


def _where(condition: Any, *choices: Any) -> Any:
    if len(choices) != 2:
        return NotImplemented
    context = _context(condition, *choices)
    ndim = max(map(_ndim, (condition, *choices)))
    dtype = np.result_type(*(_promoted(x) for x in choices))
    chosen = [_aligned(x, ndim, context, dtype) for x in choices]
    rows = torch.where(_aligned(condition, ndim, context, np.bool_), *chosen)
    if not _is_worlds(condition):
        rows = rows.expand(context.nworld, *rows.shape[1:])
    return TensorWorlds(rows, context)


def _promoted(value: Any) -> Any:
    """What `np.result_type` takes: Python's own numbers as they are."""
    if isinstance(value, TensorWorlds):
        return value.dtype
    return value if isinstance(value, float | int | bool) else np.asarray(value).dtype


def _clip(a: Any, low: Any = None, high: Any = None, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    above = a if low is None else np.maximum(a, low)
    return above if high is None else np.minimum(above, high)


def _rows_of(values: Sequence[Any]) -> tuple[list[torch.Tensor], Context]:
    """Rows of each value, of one type; what is the same in all worlds is repeated."""
    context = _context(*values)
    dtype = np.result_type(*(_promoted(v) for v in values))
    return [context.rows(v, dtype) for v in values], context


def _joined(rows: list[torch.Tensor], axis: int, context: Context) -> TensorWorlds:
    return TensorWorlds(torch.cat(rows, dim=axis + 1 if axis >= 0 else axis), context)


def _concatenate(arrays: Any, axis: int | None = 0, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    rows, context = _rows_of(list(arrays))
    if axis is None:
        rows, axis = [r.reshape(len(r), -1) for r in rows], 0
    if min(r.ndim for r in rows) < 2:
        raise ValueError("zero-dimensional arrays cannot be concatenated")
    return _joined(rows, axis, context)


def _stack(arrays: Any, axis: int = 0, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    rows, context = _rows_of(list(arrays))
    return TensorWorlds(torch.stack(rows, dim=axis + 1 if axis >= 0 else axis), context)


def _atleast(rows: torch.Tensor, ndim: int) -> torch.Tensor:
    return rows.reshape(len(rows), *(1,) * (ndim + 1 - rows.ndim), *rows.shape[1:])


def _hstack(arrays: Any, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    rows, context = _rows_of(list(arrays))
    rows = [_atleast(r, 1) for r in rows]
    return _joined(rows, 0 if rows[0].ndim == 2 else 1, context)


def _vstack(arrays: Any, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    rows, context = _rows_of(list(arrays))
    return _joined([_atleast(r, 2) for r in rows], 0, context)


def _diff(a: Any, n: int = 1, axis: int = -1, **kwargs: Any) -> Any:
    if kwargs or not isinstance(a, TensorWorlds) or a.rows.dtype == torch.bool:
        return NotImplemented
    return a._new(torch.diff(a.rows, n, dim=axis + 1 if axis >= 0 else axis))


def _cross(a: Any, b: Any, **kwargs: Any) -> Any:
    if kwargs or np.shape(a)[-1:] != (3,) or np.shape(b)[-1:] != (3,):
        return NotImplemented
    context = _context(a, b)
    ndim = max(_ndim(a), _ndim(b))
    left, right = (_aligned(x, ndim, context, np.float64) for x in (a, b))
    return TensorWorlds(torch.linalg.cross(*torch.broadcast_tensors(left, right)), context)


_UFUNCS: dict[np.ufunc, Callable[..., torch.Tensor]] = {
    np.absolute: torch.abs,
    np.add: torch.add,
    np.arccos: torch.arccos,
    np.arccosh: torch.arccosh,
    np.arcsin: torch.arcsin,
    np.arcsinh: torch.arcsinh,
    np.arctan: torch.arctan,
    np.arctan2: torch.arctan2,
    np.arctanh: torch.arctanh,
    np.ceil: torch.ceil,
    np.cos: torch.cos,
    np.cosh: torch.cosh,
    np.deg2rad: lambda x: x * (math.pi / 180.0),
    np.divide: torch.true_divide,
    np.equal: torch.eq,
    np.exp: torch.exp,
    np.expm1: torch.expm1,
    np.fabs: torch.abs,
    np.float_power: torch.pow,
    np.floor: torch.floor,
    np.floor_divide: torch.floor_divide,
    np.fmod: torch.fmod,
    np.greater: torch.gt,
    np.greater_equal: torch.ge,
    np.hypot: torch.hypot,
    np.isfinite: torch.isfinite,
    np.isinf: torch.isinf,
    np.isnan: torch.isnan,
    np.less: torch.lt,
    np.less_equal: torch.le,
    np.log: torch.log,
    np.log10: torch.log10,
    np.log1p: torch.log1p,
    np.log2: torch.log2,
    np.logical_and: torch.logical_and,
    np.logical_not: torch.logical_not,
    np.logical_or: torch.logical_or,
    np.logical_xor: torch.logical_xor,
    np.bitwise_and: torch.bitwise_and,
    np.bitwise_or: torch.bitwise_or,
    np.bitwise_xor: torch.bitwise_xor,
    np.invert: torch.bitwise_not,
    np.maximum: torch.maximum,
    np.minimum: torch.minimum,
    np.multiply: torch.mul,
    np.negative: torch.neg,
    np.not_equal: torch.ne,
    np.positive: torch.positive,
    np.power: torch.pow,
    np.rad2deg: lambda x: x * (180.0 / math.pi),
    np.reciprocal: torch.reciprocal,
    np.remainder: torch.remainder,
    np.rint: torch.round,
    np.sign: torch.sign,
    np.sin: torch.sin,
    np.sinh: torch.sinh,
    np.sqrt: torch.sqrt,
    np.square: torch.square,
    np.subtract: torch.sub,
    np.tan: torch.tan,
    np.tanh: torch.tanh,
    np.trunc: torch.trunc,
}
"""NumPy's functions of elements, and torch's."""

_REDUCTIONS: dict[np.ufunc, Callable[[torch.Tensor], torch.Tensor]] = {
    np.add: lambda x: x.sum(-1),
    np.logical_and: lambda x: (x != 0).all(-1),
    np.logical_or: lambda x: (x != 0).any(-1),
    np.maximum: lambda x: x.amax(-1),
    np.minimum: lambda x: x.amin(-1),
    np.multiply: lambda x: x.prod(-1),
}
"""Reductions over a last axis."""

_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.all: _reduction(np.logical_and),
    np.amax: _reduction(np.maximum),
    np.amin: _reduction(np.minimum),
    np.any: _reduction(np.logical_or),
    np.clip: _clip,
    np.concatenate: _concatenate,
    np.copy: lambda a, **kwargs: a.copy(),
    np.cross: _cross,
    np.diff: _diff,
    np.dot: dotted,
    np.expand_dims: lambda a, axis: a.reshape(np.expand_dims(np.empty(a.shape), axis).shape),
    np.hstack: _hstack,
    np.linalg.norm: _norm,
    np.max: _reduction(np.maximum),
    np.mean: _mean,
    np.min: _reduction(np.minimum),
    np.ndim: lambda a: a.ndim,
    np.prod: _reduction(np.multiply),
    np.ravel: lambda a, order="C": a.ravel() if order == "C" else NotImplemented,
    np.reshape: lambda a, shape: a.reshape(shape if isinstance(shape, tuple | list) else (shape,)),
    np.shape: lambda a: a.shape,
    np.size: lambda a, axis=None: a.size if axis is None else a.shape[axis],
    np.squeeze: lambda a: a.squeeze(),
    np.stack: _stack,
    np.sum: _reduction(np.add),
    np.transpose: lambda a, axes=None: a.transpose(*(axes or ())),
    np.vstack: _vstack,
    np.where: _where,
}
"""NumPy's functions of arrays that there are on the device."""
