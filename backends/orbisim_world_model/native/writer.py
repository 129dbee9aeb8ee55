"""Writes C for the operations of a traced step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from orbisim_world_model.native.values import Access, Value, accesses, contiguous

PANEL = 32
"""Columns of a weight matrix that stand together."""
_VECTORS = (("defined(__AVX512F__)", 16, 12), ("defined(__AVX__)", 8, 3), ("1", 4, 2))
"""By what the processor has: numbers of a vector register, and rows that are multiplied at once, so
that a weight is loaded once for all of them while their sums stay in 32 or 16 registers. A vector
longer than a register is none: GCC 12 takes it apart number by number."""
_TERMS = 16
"""Of a sum in one statement."""
_PART = 30
"""Statements of one C function: compilers take longer than in proportion to a function's length
(hopper's step of suite_one: 25 s as one function, 7.6 s in parts of 30, 7.3 s of 10)."""

HEADER = """
#include <math.h>
static inline float clampf(float x, float low, float high) {
  return x < low ? low : x > high ? high : x;
}
static inline float sigmoid(float x) { return 1.0f / (1.0f + expf(-clampf(x, -80.0f, 80.0f))); }
static inline float squash(float x) { return 1.0f - 2.0f * sigmoid(-2.0f * x); }
static void normalize(const float *restrict x, float *restrict y, int rows, int n, float eps) {
  for (int r = 0; r < rows; r++) {
    float mean = 0, spread = 0;
    for (int i = 0; i < n; i++) mean += x[r * n + i];
    mean /= n;
    for (int i = 0; i < n; i++) spread += (x[r * n + i] - mean) * (x[r * n + i] - mean);
    float scale = 1.0f / sqrtf(spread / n + eps);
    for (int i = 0; i < n; i++) y[r * n + i] = (x[r * n + i] - mean) * scale;
  }
}
"""


class Writer:
    """Collects statements, constants and the size of the workspace.

    In the code, `c` are the constants, `w` is the workspace.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.constants: list[Tensor] = []
        self.tables: list[str] = []
        self._constants, self.workspace = 0, 0

    def constant(self, values: Tensor) -> Value:
        """A value known when the scene is loaded."""
        found = contiguous("c", self._constants, values.shape)
        self._store(values.reshape(-1))
        return found

    def _store(self, flat: Tensor) -> int:
        start = self._constants
        padding = -len(flat) % 16
        self.constants.append(torch.cat([flat.float(), torch.zeros(padding)]))
        self._constants += len(flat) + padding
        return start

    def room(self, shape: Any) -> Value:
        """A new value in the workspace."""
        value = contiguous("w", self.workspace, shape)
        self.workspace += value.index.numel() + -value.index.numel() % 16
        return value

    # -- operations ----------------------------------------------------------------------------

    def elementwise(self, shape: Any, formula: str, inputs: list[Value]) -> Value:
        """A formula of `{0}`, `{1}` ... for each element."""
        out = self.room(shape)
        self.assign(out, formula, inputs)
        return out

    def assign(self, out: Value, formula: str, inputs: list[Value]) -> None:
        """The same, into a value that exists."""
        if not out.index.numel():
            return
        sizes, found = accesses(out.shape, [out, *inputs])
        terms = [self._element(access, len(sizes)) for access in found]
        self._loops(sizes, f"{terms[0]} = {formula.format(*terms[1:])};")

    def concatenated(self, parts: list[Value], axis: int) -> Value:
        """Values after one another."""
        shape = list(parts[0].shape)
        shape[axis] = sum(part.shape[axis] for part in parts)
        out, start = self.room(shape), 0
        for part in parts:
            end = start + part.shape[axis]
            self.assign(out.moved(out.index.narrow(axis, start, end - start)), "{0}", [part])
            start = end
        return out

    def summed(self, value: Value, axes: list[int], keep: bool) -> Value:
        """Sums over axes."""
        axes = [axis % len(value.shape) for axis in axes]
        kept = [axis for axis in range(len(value.shape)) if axis not in axes]
        index = value.index.permute(*kept, *axes)
        rows = index.flatten(len(kept)) if axes else index[..., None]
        total = self.room([value.shape[axis] for axis in kept])
        columns = [value.moved(column) for column in rows.unbind(-1)]
        for first in range(0, len(columns), _TERMS):
            terms = columns[first : first + _TERMS] + ([total] if first else [])
            self.assign(total, " + ".join(f"{{{n}}}" for n in range(len(terms))), terms)
        if not keep:
            return total
        shape = [1 if axis in axes else size for axis, size in enumerate(value.shape)]
        return total.moved(total.index.reshape(shape))

    def least(self, value: Value, axis: int, keep: bool) -> Value:
        """Where along an axis the least is, the first of several."""
        rows = value.moved(value.index.movedim(axis, -1))
        first = rows.moved(rows.index[..., 0])
        low, place = self.elementwise(first.shape, "{0}", [first]), self.room(first.shape)
        self.assign(place, "0.0f", [])
        for number in range(1, rows.shape[-1]):
            here = rows.moved(rows.index[..., number])
            self.assign(place, f"({{0}} < {{1}}) ? {number}.0f : {{2}}", [here, low, place])
            self.assign(low, "({0} < {1}) ? {0} : {1}", [here, low])
        return place.moved(place.index.unsqueeze(axis)) if keep else place

    def gathered(self, value: Value, axis: int, places: Value) -> Value:
        """`torch.gather` by numbers that are known when the code runs."""
        value, out = self.elementwise(value.shape, "{0}", [value]), self.room(places.shape)
        places = self.elementwise(places.shape, "{0}", [places])
        lines = value.index.movedim(axis, -1)
        step = int((lines[..., -1] - lines[..., 0]).flatten()[0]) // max(lines.shape[-1] - 1, 1)
        starts = value.index.narrow(axis, 0, 1)
        for other, size in enumerate(out.shape):
            starts = starts.narrow(other, 0, 1 if other == axis else size)
        table = self._table(starts.expand(out.shape).flatten().tolist())
        first, second = (int(part.index.flatten()[0]) for part in (out, places))
        there = f"{value.buffer}[{table}[i0] + {step} * (int){places.buffer}[{second} + i0]]"
        self._loops((out.index.numel(),), f"{out.buffer}[{first} + i0] = {there};")
        return out

    def product(self, x: Value, weight: Tensor, bias: Tensor | None) -> Value:
        """x [M, K] times a constant [K, N], plus a constant [N]."""
        rows, inner = x.shape
        columns = weight.shape[1]
        panels = -(-columns // PANEL)
        padded = torch.zeros(inner, panels * PANEL)
        padded[:, :columns] = weight
        packed = padded.reshape(inner, panels, PANEL).transpose(0, 1)
        shift = torch.zeros(panels * PANEL)
        if bias is not None:
            shift[:columns] = bias
        at_weight, at_bias = self._store(packed.reshape(-1)), self._store(shift)
        x = self.elementwise(x.shape, "{0}", [x])
        out = self.room((rows, panels * PANEL))
        source, target = int(x.index[0, 0]), int(out.index[0, 0])
        self.lines.append(
            f"product(c + {at_weight}, c + {at_bias}, w + {source}, w + {target}, "
            f"{rows}, {inner}, {panels});"
        )
        return out.moved(out.index[:, :columns])

    # -- loops ---------------------------------------------------------------------------------

    def _element(self, access: Access, depth: int) -> str:
        if access.table:
            return f"{access.buffer}[{self._table(access.table)}[i0]]"
        terms = [str(access.offset)]
        for level in range(depth):
            stride = access.strides[level]
            if stride:
                terms.append(f"i{level}" if stride == 1 else f"i{level} * {stride}")
        return f"{access.buffer}[{' + '.join(terms)}]"

    def _table(self, numbers: Sequence[int]) -> str:
        """The name of a table of numbers."""
        name = f"t{len(self.tables)}"
        self.tables.append(f"static const int {name}[] = {{{','.join(map(str, numbers))}}};")
        return name

    def _loops(self, sizes: tuple[int, ...], statement: str) -> None:
        heads = [
            f"for (int i{level} = 0; i{level} < {size}; i{level}++)"
            for level, size in enumerate(sizes)
        ]
        if heads:
            heads[-1] = '_Pragma("GCC ivdep")\n' + heads[-1]
        self.lines.append("\n".join([*heads, f"  {statement}"]))

    def source(self) -> str:
        """The whole C file: `step(c, w, inputs)`."""
        takes = "(const float *restrict c, float *restrict w, const float *const *in)"
        firsts = range(0, len(self.lines), _PART)
        parts = [
            f"static __attribute__((noinline)) void part{first}{takes} {{\n"
            + "\n".join(self.lines[first : first + _PART])
            + "\n}"
            for first in firsts
        ]
        calls = "\n".join(f"  part{first}(c, w, in);" for first in firsts)
        return "\n".join(
            [
                HEADER,
                _products(),
                *self.tables,
                *parts,
                f"void step{takes} {{\n{calls}\n}}\n",
            ]
        )


def _products() -> str:
    """The product for each kind of processor."""
    heads = [
        f"#{'elif' if number else 'if'} {kind}" for number, (kind, _, _) in enumerate(_VECTORS)
    ]
    parts = [
        "".join(_kernel(rows, lanes) for rows in range(1, most + 1)) + _product(most)
        for _, lanes, most in _VECTORS
    ]
    types = [
        f"typedef float vector __attribute__((vector_size({4 * lanes}), aligned(4), may_alias));"
        for _, lanes, _ in _VECTORS
    ]
    rows = (row for three in zip(heads, types, parts, strict=True) for row in three)
    return "\n".join((*rows, "#endif"))


def _kernel(rows: int, lanes: int) -> str:
    """The product of so many rows and a panel, whose sums stay in registers."""
    many = range(PANEL // lanes)
    sums = [(r, v) for r in range(rows) for v in many]
    begin = "".join(f"  vector s{r}_{v} = shift[{v}];\n" for r, v in sums)
    line = "".join(f"    const vector l{v} = line[{v}];\n" for v in many)
    add = "".join(f"    s{r}_{v} += x[{r} * inner + k] * l{v};\n" for r, v in sums)
    end = "".join(f"  ((vector *)(y + {r} * across))[{v}] = s{r}_{v};\n" for r, v in sums)
    return f"""
static void panel{rows}(const float *restrict weight, const vector *restrict shift,
                   const float *restrict x, float *restrict y, int inner, int across) {{
{begin}  for (int k = 0; k < inner; k++) {{
    const vector *line = (const vector *)(weight + k * {PANEL});
{line}{add}  }}
{end}}}
"""


def _product(most: int) -> str:
    """All rows and panels; rows are shared out evenly among kernels, and a panel's weights stay in
    the nearest cache from one to the next."""
    given = "(line, shift, from, to, inner, across)"
    cases = "\n".join(f"        case {r}: panel{r}{given}; break;" for r in range(1, most + 1))
    return f"""
static void product(const float *restrict weight, const float *restrict bias,
                    const float *restrict x, float *restrict y, int rows, int inner, int panels) {{
  const int across = panels * {PANEL};
  for (int p = 0; p < panels; p++) {{
    const float *line = weight + (long)p * inner * {PANEL};
    const vector *shift = (const vector *)(bias + p * {PANEL});
    int left = (rows + {most - 1}) / {most};
    for (int done = 0, many; left > 0; left--, done += many) {{
      const float *from = x + done * inner;
      float *to = y + done * across + p * {PANEL};
      many = (rows - done + left - 1) / left;
      switch (many) {{
{cases}
      }}
    }}
  }}
}}
"""
