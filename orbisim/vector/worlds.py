"""`Worlds`: an array that holds one value for each world and behaves like any single one of them.

The leading axis of the memory is the world; code that is given a `Worlds` sees the shape without
it. Operators, NumPy's functions and indexing act on every world, so that code written for one
world runs once for all of them. Two rules keep the results those of single worlds, to the bit:

- what has no form for many worlds at once here is called world by world and stacked;
- a branch (`if`, `while`, `and`, `max` of Python) that is not the same in all worlds raises
  `WorldsDifferError`, and the caller runs the code again on each of the two groups.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Rows: TypeAlias = npt.NDArray[Any]

_FEW_VALUES = 8
"""Different values at which `float()` still divides the worlds: labels and flags, not numbers."""
_SEQUENTIAL = 8
"""NumPy adds fewer numbers than these one after the other, whatever the layout in memory."""


class NotBatchedError(RuntimeError):
    """Code that cannot be run for many worlds at once; it is to be run world by world."""


class WorldsDifferError(BaseException):
    """A branch that not all worlds take; no `Exception`, so that no task's code catches it.

    Attributes:
      mask: [nworld] the worlds that take it.
    """

    def __init__(self, mask: npt.NDArray[np.bool_]) -> None:
        super().__init__(f"{int(mask.sum())} of {len(mask)} worlds take a branch")
        self.mask = mask


class ManyWorlds:
    """An array for each world: `Worlds` on the host, `TensorWorlds` on a device."""

    __slots__ = ()

    def squeeze(self: Any) -> Any:
        """Without axes of length 1."""
        return self.reshape(tuple(n for n in self.shape if n != 1))

    def sum(self: Any, axis: Any = None) -> Any:
        """`np.sum` in every world."""
        return np.sum(self, axis=axis)

    def prod(self: Any, axis: Any = None) -> Any:
        """`np.prod` in every world."""
        return np.prod(self, axis=axis)

    def min(self: Any, axis: Any = None) -> Any:
        """`np.min` in every world."""
        return np.min(self, axis=axis)

    def max(self: Any, axis: Any = None) -> Any:
        """`np.max` in every world."""
        return np.max(self, axis=axis)

    def any(self: Any, axis: Any = None) -> Any:
        """`np.any` in every world."""
        return np.any(self, axis=axis)

    def all(self: Any, axis: Any = None) -> Any:
        """`np.all` in every world."""
        return np.all(self, axis=axis)

    def mean(self: Any, axis: Any = None) -> Any:
        """`np.mean` in every world."""
        return np.mean(self, axis=axis)

    def clip(self: Any, low: Any = None, high: Any = None) -> Any:
        """`np.clip` in every world."""
        return np.clip(self, low, high)


class Worlds(np.lib.mixins.NDArrayOperatorsMixin, ManyWorlds):
    """One array for each world, of the same shape.

    Args:
      rows: [nworld, ...].
    """

    __slots__ = ("rows",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, rows: Rows) -> None:
        self.rows = rows

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape in one world."""
        return self.rows.shape[1:]

    @property
    def ndim(self) -> int:
        """Number of axes in one world."""
        return self.rows.ndim - 1

    @property
    def size(self) -> int:
        """Number of elements in one world."""
        return int(np.prod(self.shape, dtype=int))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the elements."""
        return self.rows.dtype

    @property
    def T(self) -> Worlds:
        """Transposed in every world."""
        return Worlds(self.rows.transpose(0, *range(self.ndim, 0, -1)))

    def __repr__(self) -> str:
        return f"Worlds({self.rows!r})"

    # -- what Python asks of a value ------------------------------------------------------------

    def __bool__(self) -> bool:
        if self.size != 1:
            raise ValueError("the truth value of an array with several elements is ambiguous")
        mask = self.rows.reshape(-1).astype(bool)
        if mask.all() or not mask.any():
            return bool(mask[0])
        raise WorldsDifferError(mask)

    def _one(self) -> Any:
        """The value that all worlds share."""
        if self.size != 1:
            raise TypeError("only arrays with one element can be made a Python number")
        values = self.rows.reshape(-1)
        same = values == values[0]
        if same.all():
            return values[0]
        if len(np.unique(values)) > _FEW_VALUES:
            raise NotBatchedError("float() of a value that differs from world to world")
        raise WorldsDifferError(same)

    def __float__(self) -> float:
        return float(self._one())

    def __int__(self) -> int:
        return int(self._one())

    def __index__(self) -> int:
        return operator.index(self._one())

    def __len__(self) -> int:
        if not self.ndim:
            raise TypeError("len() of a scalar")
        return self.shape[0]

    def __iter__(self) -> Iterator[Worlds]:
        return (self[i] for i in range(len(self)))

    def __array__(self, *args: Any, **kwargs: Any) -> Rows:
        raise NotBatchedError("np.array or np.asarray of a value that differs from world to world")

    # -- elements -------------------------------------------------------------------------------

    def __getitem__(self, key: Any) -> Worlds:
        if _has_worlds(key):
            return each_world(operator.getitem, (self, key), {})
        parts = key if isinstance(key, tuple) else (key,)
        if all(_is_basic(part) for part in parts):
            return Worlds(self.rows[(slice(None), *parts)])
        return Worlds(_picked(self.rows, key))

    def __setitem__(self, key: Any, value: Any) -> None:
        parts = key if isinstance(key, tuple) else (key,)
        if not all(_is_basic(part) for part in parts) or _has_worlds(key):
            raise NotBatchedError("assignment to elements by lists or arrays")
        part = self.rows[(slice(None), *parts)]
        if not isinstance(value, Worlds):
            part[...] = value
            return
        part[...] = _aligned(value, part.ndim - 1)

    # -- NumPy's protocols ------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method == "reduce":
            return reduced(ufunc, *inputs, **kwargs)
        if ufunc is np.matmul and method == "__call__" and not kwargs:
            product = dotted(*inputs)
            return each_world(np.matmul, inputs, {}) if product is NotImplemented else product
        if method != "__call__" or ufunc.signature is not None or kwargs.keys() - {"out"}:
            return each_world(getattr(ufunc, method), inputs, kwargs)
        ndim = max(map(_ndim, inputs))
        rows = [_aligned(x, ndim) for x in inputs]
        if "out" in kwargs:
            (target,) = kwargs["out"]
            if not isinstance(target, Worlds):
                raise NotBatchedError("many worlds written into an array of one")
            ufunc(*rows, out=target.rows)
            return target
        return _wrapped(ufunc(*rows))

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        handler = _FUNCTIONS.get(func)
        result = handler(*args, **kwargs) if handler else NotImplemented
        return each_world(func, args, kwargs) if result is NotImplemented else result

    def __pow__(self, exponent: Any) -> Any:
        """As NumPy: an array takes shortcuts for some exponents, a number the C library's pow."""
        if self.ndim or np.ndim(exponent):
            return _operated(operator.pow, self, exponent)
        return Worlds(np.float_power(self.rows, _aligned(exponent, 0)))

    def __rpow__(self, base: Any) -> Any:
        if self.ndim or np.ndim(base):
            return _operated(operator.pow, base, self)
        return Worlds(np.float_power(base, self.rows))

    # -- methods of arrays ------------------------------------------------------------------------

    def copy(self, *args: Any) -> Worlds:
        """A copy."""
        return Worlds(self.rows.copy())

    def astype(self, dtype: Any) -> Worlds:
        """Converted elements."""
        return Worlds(self.rows.astype(dtype))

    def ravel(self) -> Worlds:
        """One axis."""
        return Worlds(self.rows.reshape(len(self.rows), -1))

    def flatten(self) -> Worlds:
        """One axis, copied."""
        return Worlds(np.array(self.ravel().rows))

    def reshape(self, *shape: Any) -> Worlds:
        """Another shape of each world's array."""
        new = shape[0] if len(shape) == 1 and isinstance(shape[0], tuple | list) else shape
        return Worlds(self.rows.reshape(len(self.rows), *new))

    def transpose(self, *axes: Any) -> Worlds:
        """Permuted axes."""
        if not axes:
            return self.T
        order = axes[0] if isinstance(axes[0], tuple | list) else axes
        return Worlds(self.rows.transpose(0, *(a % self.ndim + 1 for a in order)))

    def dot(self, other: Any) -> Any:
        """`np.dot` in every world."""
        return np.dot(self, other)


# -- world by world ------------------------------------------------------------------------------


def each_world(func: Callable[..., Any], args: Any, kwargs: Any) -> Any:
    """Calls a function of one world in each, and stacks what it returns.

    Raises:
      NotBatchedError: it does not return arrays of one shape.
    """
    found = list(_worlds_in((args, tuple(kwargs.values()))))
    results = [
        func(*_of_world(args, world), **_of_world(kwargs, world))
        for world in range(len(found[0].rows))
    ]
    if isinstance(results[0], tuple):
        return tuple(_stacked(column) for column in zip(*results, strict=True))
    return _stacked(results)


def _stacked(results: Sequence[Any]) -> Worlds:
    try:
        rows = np.stack([np.asarray(r) for r in results])
    except ValueError:
        raise NotBatchedError("results of different shapes in different worlds") from None
    if rows.dtype == object:
        raise NotBatchedError("results that are no arrays of numbers")
    return Worlds(rows)


def _worlds_in(value: Any) -> Iterator[Worlds]:
    if isinstance(value, Worlds):
        yield value
    elif isinstance(value, tuple | list):
        for part in value:
            yield from _worlds_in(part)


def _has_worlds(value: Any) -> bool:
    return any(True for _ in _worlds_in(value))


def _of_world(value: Any, world: int) -> Any:
    if isinstance(value, Worlds):
        return value.rows[world]
    if isinstance(value, tuple | list):
        return type(value)(_of_world(part, world) for part in value)
    if isinstance(value, dict):
        return {name: _of_world(part, world) for name, part in value.items()}
    return value


# -- all worlds at once --------------------------------------------------------------------------


def _aligned(value: Any, ndim: int) -> Any:
    """The rows with so many axes beside the world's; what is the same in all worlds as it is."""
    if not isinstance(value, Worlds):
        return value
    fill = (1,) * (ndim - value.ndim)
    return value.rows.reshape(len(value.rows), *fill, *value.shape) if fill else value.rows


def _ndim(value: Any) -> int:
    """As `np.ndim`, sooner."""
    if isinstance(value, Worlds):
        return value.rows.ndim - 1
    return 0 if isinstance(value, float | int) else np.ndim(value)


def _wrapped(result: Any) -> Any:
    return tuple(map(Worlds, result)) if isinstance(result, tuple) else Worlds(result)


def _operated(operation: Callable[[Any, Any], Any], a: Any, b: Any) -> Worlds:
    ndim = max(np.ndim(a), np.ndim(b))
    return Worlds(operation(_aligned(a, ndim), _aligned(b, ndim)))


def _is_basic(part: Any) -> bool:
    is_number = isinstance(part, int | np.integer) and not isinstance(part, bool)
    return is_number or part is None or part is Ellipsis or isinstance(part, slice)


def _picked(rows: Rows, key: Any) -> Rows:
    """Indexing by lists and arrays, with the layout in memory that one world's result has."""
    shape = rows.shape[1:]
    index = np.arange(int(np.prod(shape, dtype=int))).reshape(shape)[key]
    order = np.argsort([-stride for stride in index.strides], kind="stable")
    flat = rows.reshape(len(rows), -1)[:, index.transpose(order)]
    return flat.transpose(0, *(np.argsort(order) + 1))


def _rows_of(values: Sequence[Any]) -> list[Rows]:
    """Rows of each value; what is the same in all worlds is repeated."""
    count = len(next(_worlds_in(tuple(values))).rows)
    return [
        v.rows if isinstance(v, Worlds) else np.broadcast_to(v, (count, *np.shape(v)))
        for v in values
    ]


def _contiguous(x: Worlds) -> bool:
    return x.ndim < 2 or x.rows[0].flags.c_contiguous


_EXACT = {np.minimum, np.maximum, np.logical_and, np.logical_or}
"""Their result does not depend on the order of the elements."""


def reduced(ufunc: np.ufunc, x: Any, axis: Any = 0, **kwargs: Any) -> Any:
    """`ufunc.reduce` in every world, adding in the order that one world would."""
    keeps = kwargs.pop("keepdims", False) in (False, np._NoValue)
    if not isinstance(x, Worlds) or kwargs or not keeps or isinstance(axis, tuple):
        return each_world(ufunc.reduce, (x,), {"axis": axis, **kwargs})
    if axis is None or x.ndim == 1:
        if ufunc in _EXACT or _contiguous(x):
            flat = np.ascontiguousarray(x.rows.reshape(len(x.rows), -1))
            return Worlds(ufunc.reduce(flat, axis=1))
    elif ufunc in _EXACT or x.shape[axis] < _SEQUENTIAL:
        return Worlds(ufunc.reduce(x.rows, axis=axis % x.ndim + 1))
    return each_world(ufunc.reduce, (x,), {"axis": axis})


def dotted(a: Any, b: Any) -> Any:
    """`np.dot`: of vectors and matrices by the routine of BLAS that one world's would use."""
    if not (isinstance(a, Worlds) and isinstance(b, Worlds)):
        return NotImplemented if {np.ndim(a), np.ndim(b)} <= {1, 2} else np.multiply(a, b)
    if 0 in (a.ndim, b.ndim):
        return np.multiply(a, b)
    if max(a.ndim, b.ndim) > 2:
        return NotImplemented
    left = np.ascontiguousarray(a.rows)[:, None, :] if a.ndim == 1 else a.rows
    right = np.ascontiguousarray(b.rows)[:, :, None] if b.ndim == 1 else b.rows
    product = np.matmul(left, right)
    return Worlds(product.reshape(len(product), *a.shape[:-1], *b.shape[1:]))


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    if ord is not None or axis is not None or keepdims or not _contiguous(x) or not x.ndim:
        return NotImplemented
    flat = x.ravel()
    return np.sqrt(dotted(flat, flat))


def _reduction(ufunc: np.ufunc) -> Callable[..., Any]:
    def function(a: Any, axis: Any = None, **kwargs: Any) -> Any:
        return NotImplemented if kwargs else reduced(ufunc, a, axis=axis)

    return function


def _mean(a: Any, axis: Any = None, **kwargs: Any) -> Any:
    if kwargs or not isinstance(a, Worlds) or a.dtype != np.float64 or isinstance(axis, tuple):
        return each_world(np.mean, (a,), {"axis": axis, **kwargs})
    return reduced(np.add, a, axis=axis) / (a.size if axis is None else a.shape[axis])


def _where(condition: Any, *choices: Any) -> Any:
    if not choices:
        return NotImplemented
    parts = (condition, *choices)
    ndim = max(map(_ndim, parts))
    return Worlds(np.where(*(_aligned(x, ndim) for x in parts)))


def _clip(a: Any, low: Any = None, high: Any = None, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    ndim = max(np.ndim(x) for x in (a, low, high))
    return Worlds(np.clip(*(_aligned(x, ndim) for x in (a, low, high))))


def _concatenate(arrays: Any, axis: int | None = 0, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    rows = _rows_of(arrays)
    if axis is None:
        rows, axis = [r.reshape(len(r), -1) for r in rows], 0
    if min(r.ndim for r in rows) < 2:
        raise ValueError("zero-dimensional arrays cannot be concatenated")
    return Worlds(np.concatenate(rows, axis=axis + 1 if axis >= 0 else axis))


def _stack(arrays: Any, axis: int = 0, **kwargs: Any) -> Any:
    if kwargs:
        return NotImplemented
    return Worlds(np.stack(_rows_of(arrays), axis=axis + 1 if axis >= 0 else axis))


def _atleast(rows: Rows, ndim: int) -> Worlds:
    return Worlds(rows.reshape(len(rows), *(1,) * (ndim + 1 - rows.ndim), *rows.shape[1:]))


def _hstack(arrays: Any, **kwargs: Any) -> Any:
    parts = [_atleast(r, 1) for r in _rows_of(list(arrays))]
    return _concatenate(parts, 0 if parts[0].ndim == 1 else 1, **kwargs)


def _vstack(arrays: Any, **kwargs: Any) -> Any:
    return _concatenate([_atleast(r, 2) for r in _rows_of(list(arrays))], 0, **kwargs)


def _diff(a: Any, n: int = 1, axis: int = -1, **kwargs: Any) -> Any:
    if kwargs or not isinstance(a, Worlds):
        return NotImplemented
    return Worlds(np.diff(a.rows, n, axis=axis + 1 if axis >= 0 else axis))


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.all: _reduction(np.logical_and),
    np.amax: _reduction(np.maximum),
    np.amin: _reduction(np.minimum),
    np.any: _reduction(np.logical_or),
    np.clip: _clip,
    np.concatenate: _concatenate,
    np.copy: lambda a, **kwargs: a.copy(),
    np.diff: _diff,
    np.dot: dotted,
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
"""NumPy's functions that are run on all worlds at once; the others run world by world."""
