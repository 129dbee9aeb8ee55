"""The kernels of `network.fused`, in Triton: needs a GPU with tensor cores, or TRITON_INTERPRET=1.

A program steps M worlds. A token is a tile of M rows and stays in registers through all layers, so
that everything between two tokens of the same world (scores, softmax, sums over tokens) is
elementwise between tiles; only weights, features of pairs and modulations are read on the way.
Products are of float16 and summed in float32, as is what runs from layer to layer.
"""

from __future__ import annotations

import triton
import triton.language as tl

_EPSILON = tl.constexpr(1e-5)  # of torch's layer_norm


@triton.jit
def _normed(z, W: tl.constexpr):  # type: ignore[no-untyped-def]
    """Layer norm of rows [M, W] without scale and shift."""
    off = z - (tl.sum(z, 1) / W)[:, None]
    return off * tl.rsqrt(tl.sum(off * off, 1) / W + _EPSILON)[:, None]


@triton.jit
def _silu(x):  # type: ignore[no-untyped-def]
    return x * tl.sigmoid(x)


@triton.jit
def _rows(base, rows, ok, stride, size, SPACE: tl.constexpr):  # type: ignore[no-untyped-def]
    """[M, SPACE] of rows of `size` numbers, zeros beyond them."""
    at = tl.arange(0, SPACE)
    mask = ok[:, None] & (at < size)[None, :]
    return tl.load(base + rows[:, None] * stride + at[None, :], mask=mask, other=0.0)


@triton.jit
def _weight(base, first, step, ROWS: tl.constexpr, COLUMNS: tl.constexpr):  # type: ignore[no-untyped-def]
    """[ROWS, COLUMNS] of a matrix with `step` numbers a row, from element `first` on."""
    at = tl.arange(0, ROWS)[:, None] * step + tl.arange(0, COLUMNS)[None, :]
    return tl.load(base + first + at)


@triton.jit
def _vector(base, first, SIZE: tl.constexpr):  # type: ignore[no-untyped-def]
    """[1, SIZE]."""
    return tl.load(base + first + tl.arange(0, SIZE))[None, :]


@triton.jit
def _hidden(x, acc, weights, biases, IN: tl.constexpr, OUT: tl.constexpr, HIDDEN: tl.constexpr,
            CHUNK: tl.constexpr, AT: tl.constexpr, AT_BIAS: tl.constexpr):  # type: ignore[no-untyped-def]  # fmt: skip
    """acc + W2 silu(W1 x + b1) + b2, hidden numbers in chunks."""
    for c in tl.range(0, HIDDEN, CHUNK):
        first = _weight(weights, AT + c, HIDDEN, IN, CHUNK)
        h = _silu(tl.dot(x, first) + _vector(biases, AT_BIAS + c, CHUNK))
        second = _weight(weights, AT + IN * HIDDEN + c * OUT, OUT, CHUNK, OUT)
        acc = tl.dot(h.to(tl.float16), second, acc)
    return acc + _vector(biases, AT_BIAS + HIDDEN, OUT)


@triton.jit
def pair_kernel(edges, pairs, weights, biases, count,
                E: tl.constexpr, SPACE: tl.constexpr, HIDDEN: tl.constexpr, OUT: tl.constexpr,
                AT: tl.constexpr, AT_BIAS: tl.constexpr, M: tl.constexpr):  # type: ignore[no-untyped-def]  # fmt: skip
    """`Coupling.edge`: features of pairs [count, E] to [count, OUT], row by row."""
    rows = tl.program_id(0).to(tl.int64) * M + tl.arange(0, M)
    ok = rows < count
    x = _rows(edges, rows, ok, E, E, SPACE).to(tl.float16)
    zero = tl.zeros((M, OUT), tl.float32)
    found = _silu(_hidden(x, zero, weights, biases, SPACE, OUT, HIDDEN, HIDDEN, AT, AT_BIAS))
    at = rows[:, None] * OUT + tl.arange(0, OUT)[None, :]
    tl.store(pairs + at, found.to(tl.float16), mask=ok[:, None])


@triton.jit
def network_kernel(robot, objects, pairs, modulation, weights, biases, robot_out, objects_out,
                   count, K: tl.constexpr, HAS_ROBOT: tl.constexpr, L: tl.constexpr,
                   W: tl.constexpr, HEADS: tl.constexpr, MIX: tl.constexpr, PAIR: tl.constexpr,
                   ROBOT: tl.constexpr, ROBOT_SPACE: tl.constexpr, OBJECT: tl.constexpr,
                   OBJECT_SPACE: tl.constexpr, ROBOT_OUT: tl.constexpr, OBJECT_OUT: tl.constexpr,
                   ROBOT_SPACE_OUT: tl.constexpr, OBJECT_SPACE_OUT: tl.constexpr,
                   AT: tl.constexpr, AT_BIAS: tl.constexpr, CHUNK: tl.constexpr, M: tl.constexpr):  # type: ignore[no-untyped-def]  # fmt: skip
    """Equation RSSM for M worlds: encoder, layers of attention and mixing, transition, decoder.

    `AT` and `AT_BIAS` say where in `weights` and `biases` begin: encoder of the robot, of an
    object, layers, transition, decoder of the robot, of an object (see `fused._packed`).
    """
    D: tl.constexpr = W // HEADS
    N: tl.constexpr = K - HAS_ROBOT
    rows = tl.program_id(0).to(tl.int64) * M + tl.arange(0, M)
    ok = rows < count
    wide = tl.arange(0, W)[None, :]

    zs = ()
    for t in tl.static_range(K):
        zero = tl.zeros((M, W), tl.float32)
        if t < HAS_ROBOT:
            x = _rows(robot, rows, ok, ROBOT, ROBOT, ROBOT_SPACE).to(tl.float16)
            z = _hidden(x, zero, weights, biases, ROBOT_SPACE, W, 2 * W, CHUNK, AT[0], AT_BIAS[0])
            z = _normed(z, W) * _vector(biases, AT_BIAS[0] + 3 * W, W)
            z += _vector(biases, AT_BIAS[0] + 4 * W, W)
        else:
            first = objects + (t - HAS_ROBOT) * OBJECT
            x = _rows(first, rows, ok, N * OBJECT, OBJECT, OBJECT_SPACE).to(tl.float16)
            z = _hidden(x, zero, weights, biases, OBJECT_SPACE, W, 2 * W, CHUNK, AT[1], AT_BIAS[1])
            z = _normed(z, W) * _vector(biases, AT_BIAS[1] + 3 * W, W)
            z += _vector(biases, AT_BIAS[1] + 4 * W, W)
        zs = zs + (z,)

    QKV: tl.constexpr = 3 * W
    layer_size: tl.constexpr = W * QKV + PAIR * 2 * W + W * W + 2 * W * MIX
    bias_size: tl.constexpr = QKV + W + MIX + W
    for layer in tl.range(0, L):
        at = AT[2] + layer * layer_size
        at_bias = AT_BIAS[2] + layer * bias_size
        told = layer * 4 * W

        us = ()
        for t in tl.static_range(K):
            base = modulation + (rows[:, None] * K + t) * (L * 4 * W) + told + wide
            gamma = tl.load(base, mask=ok[:, None], other=0.0).to(tl.float32)
            beta = tl.load(base + W, mask=ok[:, None], other=0.0).to(tl.float32)
            us = us + ((_normed(zs[t], W) * gamma + beta).to(tl.float16),)
        for head in tl.range(0, HEADS):
            c = head * D
            wq = _weight(weights, at + c, QKV, W, D)
            wk = _weight(weights, at + W + c, QKV, W, D)
            wv = _weight(weights, at + 2 * W + c, QKV, W, D)
            wpk = _weight(weights, at + W * QKV + c, 2 * W, PAIR, D)
            wpv = _weight(weights, at + W * QKV + W + c, 2 * W, PAIR, D)
            wo = _weight(weights, at + W * QKV + PAIR * 2 * W + c * W, W, D, W)
            bq = _vector(biases, at_bias + c, D)
            bk = _vector(biases, at_bias + W + c, D)
            bv = _vector(biases, at_bias + 2 * W + c, D)
            ks, vs = (), ()
            for t in tl.static_range(K):
                ks = ks + (tl.dot(us[t], wk) + bk,)
                vs = vs + (tl.dot(us[t], wv) + bv,)
            new = ()
            for i in tl.static_range(K):
                q = tl.dot(us[i], wq) + bq
                # softmax with a running maximum, so that no more than one token's is kept
                most = tl.full((M,), -1e30, tl.float32)
                total = tl.zeros((M,), tl.float32)
                seen = tl.zeros((M, D), tl.float32)
                for j in tl.static_range(K):
                    pair = pairs + ((i * K + j) + rows[:, None] * (K * K)) * PAIR
                    p = tl.load(pair + tl.arange(0, PAIR)[None, :], mask=ok[:, None], other=0.0)
                    score = tl.sum(q * tl.dot(p, wpk, ks[j]), 1)
                    value = tl.dot(p, wpv, vs[j])
                    larger = tl.maximum(most, score)
                    kept, more = tl.exp(most - larger), tl.exp(score - larger)
                    total = total * kept + more
                    seen = seen * kept[:, None] + value * more[:, None]
                    most = larger
                seen = (seen / total[:, None]).to(tl.float16)
                new = new + (tl.dot(seen, wo, zs[i]),)
            zs = new

        us = ()
        new = ()
        bias = _vector(biases, at_bias + QKV, W)
        for t in tl.static_range(K):
            z = zs[t] + bias
            base = modulation + (rows[:, None] * K + t) * (L * 4 * W) + told + 2 * W + wide
            gamma = tl.load(base, mask=ok[:, None], other=0.0).to(tl.float32)
            beta = tl.load(base + W, mask=ok[:, None], other=0.0).to(tl.float32)
            us = us + ((_normed(z, W) * gamma + beta).to(tl.float16),)
            new = new + (z + _vector(biases, at_bias + QKV + W + MIX, W),)
        zs = new
        at_mix = at + W * QKV + PAIR * 2 * W + W * W
        for c in tl.range(0, MIX, CHUNK):
            w1 = _weight(weights, at_mix + c, MIX, W, CHUNK)
            b1 = _vector(biases, at_bias + QKV + W + c, CHUNK)
            w2 = _weight(weights, at_mix + W * MIX + c * W, W, CHUNK, W)
            new = ()
            for t in tl.static_range(K):
                h = _silu(tl.dot(us[t], w1) + b1).to(tl.float16)
                new = new + (tl.dot(h, w2, zs[t]),)
            zs = new

    for t in tl.static_range(K):
        e = _normed(zs[t], W) * _vector(biases, AT_BIAS[3], W)
        e += _vector(biases, AT_BIAS[3] + W, W)
        x = e.to(tl.float16)
        latent = _hidden(x, e, weights, biases, W, W, 2 * W, CHUNK, AT[3], AT_BIAS[3] + 2 * W)
        x = latent.to(tl.float16)
        if t < HAS_ROBOT:
            out = tl.zeros((M, ROBOT_SPACE_OUT), tl.float32)
            out = _hidden(
                x, out, weights, biases, W, ROBOT_SPACE_OUT, W, CHUNK, AT[4], AT_BIAS[4]
            )
            at = tl.arange(0, ROBOT_SPACE_OUT)[None, :]
            where = robot_out + rows[:, None] * ROBOT_OUT + at
            tl.store(where, out, mask=ok[:, None] & (at < ROBOT_OUT))
        else:
            out = tl.zeros((M, OBJECT_SPACE_OUT), tl.float32)
            out = _hidden(
                x, out, weights, biases, W, OBJECT_SPACE_OUT, W, CHUNK, AT[5], AT_BIAS[5]
            )
            at = tl.arange(0, OBJECT_SPACE_OUT)[None, :]
            where = objects_out + (rows[:, None] * N + t - HAS_ROBOT) * OBJECT_OUT + at
            tl.store(where, out, mask=ok[:, None] & (at < OBJECT_OUT))
