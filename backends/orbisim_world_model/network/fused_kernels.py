# mypy: ignore-errors
# Triton compiles kernels from their source; their annotations are not types.
"""The kernels of `network.fused`, in Triton: needs a GPU with tensor cores, or TRITON_INTERPRET=1.

A row is a token of a world; a program of `layers_kernel` has M rows, whole worlds, and keeps them
in registers through all layers. Only weights, modulations, features of pairs, and the keys and
values of the program's own rows are read on the way. Products are of float16 and summed in float32,
as is what runs from layer to layer.
"""

from __future__ import annotations

import triton
import triton.language as tl

_EPSILON = tl.constexpr(1e-5)  # of torch's layer_norm


@triton.jit
def _normed(z, W: tl.constexpr):
    """Layer norm of rows [M, W] without scale and shift."""
    off = z - (tl.sum(z, 1) / W)[:, None]
    return off * tl.rsqrt(tl.sum(off * off, 1) / W + _EPSILON)[:, None]


@triton.jit
def _silu(x):
    return x * tl.sigmoid(x)


@triton.jit
def _rows(base, rows, ok, stride, size, SPACE: tl.constexpr):
    """[M, SPACE] of rows of `size` numbers, zeros beyond them."""
    at = tl.arange(0, SPACE)
    mask = ok[:, None] & (at < size)[None, :]
    return tl.load(base + rows[:, None] * stride + at[None, :], mask=mask, other=0.0)


@triton.jit
def _beside(own, row, world, ok, OWN: tl.constexpr, setting, SETTING: tl.constexpr,
            SPACE: tl.constexpr):  # fmt: skip
    """[M, SPACE]: a row's own numbers and then its world's, zeros beyond them."""
    at = tl.arange(0, SPACE)[None, :]
    mine = ok[:, None] & (at < OWN)
    x = tl.load(own + row[:, None] * OWN + at, mask=mine, other=0.0)
    rest = ok[:, None] & (at >= OWN) & (at < OWN + SETTING)
    y = tl.load(setting + world[:, None] * SETTING + at - OWN, mask=rest, other=0.0)
    return x.to(tl.float16) + y.to(tl.float16)


@triton.jit
def _weight(base, first, step, ROWS: tl.constexpr, COLUMNS: tl.constexpr):
    """[ROWS, COLUMNS] of a matrix with `step` numbers a row, from element `first` on."""
    at = tl.arange(0, ROWS)[:, None] * step + tl.arange(0, COLUMNS)[None, :]
    return tl.load(base + first + at)


@triton.jit
def _vector(base, first, SIZE: tl.constexpr):
    """[1, SIZE]."""
    return tl.load(base + first + tl.arange(0, SIZE))[None, :]


@triton.jit
def _hidden(x, acc, weights, biases, IN: tl.constexpr, OUT: tl.constexpr, HIDDEN: tl.constexpr,
            CHUNK: tl.constexpr, AT: tl.constexpr, AT_BIAS: tl.constexpr):  # fmt: skip
    """acc + W2 silu(W1 x + b1) + b2, hidden numbers in chunks."""
    for c in tl.range(0, HIDDEN, CHUNK):
        first = _weight(weights, AT + c, HIDDEN, IN, CHUNK)
        h = _silu(tl.dot(x, first) + _vector(biases, AT_BIAS + c, CHUNK))
        second = _weight(weights, AT + IN * HIDDEN + c * OUT, OUT, CHUNK, OUT)
        acc = tl.dot(h.to(tl.float16), second, acc)
    return acc + _vector(biases, AT_BIAS + HIDDEN, OUT)


@triton.jit
def _scales(x, to, row, ok, first, weights, biases, SPACE: tl.constexpr, W: tl.constexpr,
            ALL: tl.constexpr, COLUMNS: tl.constexpr, CHUNK: tl.constexpr, AT: tl.constexpr,
            AT_BIAS: tl.constexpr, AT_ALL: tl.constexpr, AT_ALL_BIAS: tl.constexpr,
            M: tl.constexpr):  # fmt: skip
    """Scales and shifts of AdaLN, columns from `first` on, of tokens with the descriptors x."""
    c = tl.zeros((M, W), tl.float32)
    c = _silu(_hidden(x, c, weights, biases, SPACE, W, W, CHUNK, AT, AT_BIAS)).to(tl.float16)
    for at in tl.range(0, COLUMNS, CHUNK):
        w = _weight(weights, AT_ALL + first + at, ALL, W, CHUNK)
        found = tl.dot(c, w) + _vector(biases, AT_ALL_BIAS + first + at, CHUNK)
        where = to + row[:, None] * ALL + first + at + tl.arange(0, CHUNK)[None, :]
        tl.store(where, found.to(tl.float16), mask=ok[:, None])


@triton.jit(do_not_specialize=["worlds"])
def tokens_kernel(robot, objects, edges, control, attributes, setting, tokens, pairs, robot_scales,
                  object_scales, weights, biases, worlds,
                  K: tl.constexpr, HAS_ROBOT: tl.constexpr, L: tl.constexpr, W: tl.constexpr,
                  PAIR: tl.constexpr, ROBOT: tl.constexpr, ROBOT_SPACE: tl.constexpr,
                  OBJECT: tl.constexpr, OBJECT_SPACE: tl.constexpr, EDGE: tl.constexpr,
                  EDGE_SPACE: tl.constexpr, EDGE_HIDDEN: tl.constexpr, CONTROL: tl.constexpr,
                  ATTRIBUTES: tl.constexpr, SETTING: tl.constexpr, COMMAND_SPACE: tl.constexpr,
                  DESCRIBED_SPACE: tl.constexpr, AT: tl.constexpr, AT_BIAS: tl.constexpr,
                  COLUMNS: tl.constexpr, CHUNK: tl.constexpr, FIRST: tl.constexpr,
                  M: tl.constexpr):  # fmt: skip
    """z_t = f_enc and the AdaLN of robots and objects, and the features of pairs.

    Axis 1 of the grid, counted from `FIRST`: 0 pairs, 1 robots, 2 objects, then as many programs
    for the AdaLN of robots, and of objects, as there are `COLUMNS` in all its numbers.

    Args:
      robot: [B, ROBOT]. objects: [B, N, OBJECT]. edges: [B, K, K, EDGE]. control: [B, CONTROL].
      attributes: [B, N, ATTRIBUTES]. setting: [B, SETTING].
      tokens: [B, K, W], pairs: [B, K, K, PAIR], robot_scales: [B, L * 4 W] and
        object_scales: [B, N, L * 4 W], to be written.
      AT, AT_BIAS: where weights and biases of pairs, encoders of robots and objects, conditions of
        robots and objects, and of the AdaLN begin.
    """
    N: tl.constexpr = K - HAS_ROBOT
    ALL: tl.constexpr = L * 4 * W
    SPLIT: tl.constexpr = ALL // COLUMNS
    first = tl.program_id(0).to(tl.int64) * M
    at = first + tl.arange(0, M)
    kind = FIRST + tl.program_id(1)
    wide = tl.arange(0, W)[None, :]
    if kind == 0:
        ok = at < worlds * (K * K)
        x = _rows(edges, at, ok, EDGE, EDGE, EDGE_SPACE).to(tl.float16)
        z = tl.zeros((M, PAIR), tl.float32)
        z = _hidden(x, z, weights, biases, EDGE_SPACE, PAIR, EDGE_HIDDEN, CHUNK, AT[0], AT_BIAS[0])
        where = pairs + at[:, None] * PAIR + tl.arange(0, PAIR)[None, :]
        tl.store(where, _silu(z).to(tl.float16), mask=ok[:, None])
    elif (kind == 1) & (first < worlds * HAS_ROBOT):
        ok = at < worlds
        x = _rows(robot, at, ok, ROBOT, ROBOT, ROBOT_SPACE).to(tl.float16)
        z = tl.zeros((M, W), tl.float32)
        z = _hidden(x, z, weights, biases, ROBOT_SPACE, W, 2 * W, CHUNK, AT[1], AT_BIAS[1])
        z = _normed(z, W) * _vector(biases, AT_BIAS[1] + 3 * W, W)
        z += _vector(biases, AT_BIAS[1] + 4 * W, W)
        tl.store(tokens + at[:, None] * (K * W) + wide, z.to(tl.float16), mask=ok[:, None])
    elif (kind == 2) & (first < worlds * N):
        ok = at < worlds * N
        x = _rows(objects, at, ok, OBJECT, OBJECT, OBJECT_SPACE).to(tl.float16)
        z = tl.zeros((M, W), tl.float32)
        z = _hidden(x, z, weights, biases, OBJECT_SPACE, W, 2 * W, CHUNK, AT[2], AT_BIAS[2])
        z = _normed(z, W) * _vector(biases, AT_BIAS[2] + 3 * W, W)
        z += _vector(biases, AT_BIAS[2] + 4 * W, W)
        row = at // N * K + HAS_ROBOT + at % N
        tl.store(tokens + row[:, None] * W + wide, z.to(tl.float16), mask=ok[:, None])
    elif (kind > 2) & (kind < 3 + SPLIT) & (first < worlds * HAS_ROBOT):
        ok = at < worlds
        x = _beside(control, at, at, ok, CONTROL, setting, SETTING, COMMAND_SPACE)
        _scales(x, robot_scales, at, ok, (kind - 3) * COLUMNS, weights, biases, COMMAND_SPACE,
                W, ALL, COLUMNS, CHUNK, AT[3], AT_BIAS[3], AT[5], AT_BIAS[5], M)  # fmt: skip
    elif (kind >= 3 + SPLIT) & (first < worlds * N):
        ok = at < worlds * N
        x = _beside(attributes, at, at // N, ok, ATTRIBUTES, setting, SETTING, DESCRIBED_SPACE)
        _scales(x, object_scales, at, ok, (kind - 3 - SPLIT) * COLUMNS, weights, biases,
                DESCRIBED_SPACE, W, ALL, COLUMNS, CHUNK, AT[4], AT_BIAS[4], AT[5], AT_BIAS[5],
                M)  # fmt: skip


@triton.jit(do_not_specialize=["worlds", "scales_step"])
def layers_kernel(tokens, pairs, robot_scales, object_scales, scales_step, weights, biases, told,
                  robot_out, objects_out, worlds,
                  K: tl.constexpr, HAS_ROBOT: tl.constexpr, L: tl.constexpr, W: tl.constexpr,
                  HEADS: tl.constexpr, MIX: tl.constexpr, PAIR: tl.constexpr,
                  ROBOT_OUT: tl.constexpr, ROBOT_SPACE: tl.constexpr, OBJECT_OUT: tl.constexpr,
                  OBJECT_SPACE: tl.constexpr, AT: tl.constexpr, AT_BIAS: tl.constexpr,
                  CHUNK: tl.constexpr, PART: tl.constexpr, M: tl.constexpr):  # fmt: skip
    """f_cp, f_tra and f_dec of M // K worlds.

    Args:
      tokens: [B, K, W]. pairs: [B, K, K, PAIR]. robot_scales: [B, L * 4 W].
      object_scales: [B or 1, N, L * 4 W]. scales_step: 1, or 0 where they are all worlds' own.
      told: [B, K, 2 W], room for keys and values.
      robot_out: [B, ROBOT_OUT] and objects_out: [B, N, OBJECT_OUT], to be written.
      AT, AT_BIAS: where weights and biases of the layers, of the transition, and of the decoders
        of robots and objects begin.
      CHUNK: hidden numbers at a time. PART: numbers of heads at a time, whole heads.
    """
    D: tl.constexpr = W // HEADS
    N: tl.constexpr = K - HAS_ROBOT
    USED: tl.constexpr = M // K * K
    local = tl.arange(0, M)
    row = tl.program_id(0).to(tl.int64) * USED + local
    ok = (local < USED) & (row < worlds * K)
    world = row // K
    there = ok[:, None]
    wide, part = tl.arange(0, W)[None, :], tl.arange(0, PART)[None, :]
    token = row % K
    own = object_scales + ((world * scales_step * N + token - HAS_ROBOT) * (L * 4 * W))[:, None]
    if HAS_ROBOT:
        robots = robot_scales + (world * (L * 4 * W))[:, None]
        own = tl.where((token == 0)[:, None], robots, own)
    z = tl.load(tokens + row[:, None] * W + wide, mask=there, other=0.0).to(tl.float32)

    QKV: tl.constexpr = 3 * W
    layer_size: tl.constexpr = W * QKV + PAIR * 2 * W + W * W + 2 * W * MIX
    bias_size: tl.constexpr = QKV + W + MIX + W
    for layer in tl.range(0, L):
        at = AT[0] + layer * layer_size
        at_bias = AT_BIAS[0] + layer * bias_size
        scales = own + layer * (4 * W) + wide

        gamma = tl.load(scales, mask=there, other=0.0)
        beta = tl.load(scales + W, mask=there, other=0.0)
        u = (_normed(z, W) * gamma + beta).to(tl.float16)
        for c in tl.range(0, 2 * W, CHUNK):
            w = _weight(weights, at + W + c, QKV, W, CHUNK)
            bias = _vector(biases, at_bias + W + c, CHUNK)
            where = told + row[:, None] * (2 * W) + c + tl.arange(0, CHUNK)[None, :]
            tl.store(where, (tl.dot(u, w) + bias).to(tl.float16), mask=there)
        tl.debug_barrier()  # keys and values of other rows were written by other threads
        for c in tl.range(0, W, PART):  # some heads
            wq = _weight(weights, at + c, QKV, W, PART)
            wk = _weight(weights, at + W * QKV + c, 2 * W, PAIR, PART)
            wv = _weight(weights, at + W * QKV + W + c, 2 * W, PAIR, PART)
            q = tl.dot(u, wq) + _vector(biases, at_bias + c, PART)
            # softmax with a running maximum, so that one token at a time is looked at
            most = tl.full((M, PART // D), -1e30, tl.float32)
            total = tl.zeros((M, PART // D), tl.float32)
            seen = tl.zeros((M, PART // D, D), tl.float32)
            for j in tl.range(0, K):
                pair = pairs + (row[:, None] * K + j) * PAIR + tl.arange(0, PAIR)[None, :]
                p = tl.load(pair, mask=there, other=0.0)
                other = told + (world[:, None] * K + j) * (2 * W) + c + part
                k = tl.load(other, mask=there, other=0.0)
                v = tl.load(other + W, mask=there, other=0.0)
                score = tl.sum(tl.reshape(q * (tl.dot(p, wk) + k), (M, PART // D, D)), 2)
                value = tl.reshape(tl.dot(p, wv) + v, (M, PART // D, D))
                larger = tl.maximum(most, score)
                kept, more = tl.exp(most - larger), tl.exp(score - larger)
                total = total * kept + more
                seen = seen * kept[:, :, None] + value * more[:, :, None]
                most = larger
            heard = tl.reshape(seen / total[:, :, None], (M, PART)).to(tl.float16)
            wo = _weight(weights, at + W * QKV + PAIR * 2 * W + c * W, W, PART, W)
            z = tl.dot(heard, wo, z)
        z += _vector(biases, at_bias + QKV, W)
        tl.debug_barrier()  # all have read before the next layer's are written

        gamma = tl.load(scales + 2 * W, mask=there, other=0.0)
        beta = tl.load(scales + 3 * W, mask=there, other=0.0)
        u = (_normed(z, W) * gamma + beta).to(tl.float16)
        at_mix = at + W * QKV + PAIR * 2 * W + W * W
        for c in tl.range(0, MIX, CHUNK):
            w1 = _weight(weights, at_mix + c, MIX, W, CHUNK)
            b1 = _vector(biases, at_bias + QKV + W + c, CHUNK)
            w2 = _weight(weights, at_mix + W * MIX + c * W, W, CHUNK, W)
            z = tl.dot(_silu(tl.dot(u, w1) + b1).to(tl.float16), w2, z)
        z += _vector(biases, at_bias + QKV + W + MIX, W)

    e = _normed(z, W) * _vector(biases, AT_BIAS[1], W) + _vector(biases, AT_BIAS[1] + W, W)
    x = e.to(tl.float16)
    e = _hidden(x, e, weights, biases, W, W, 2 * W, CHUNK, AT[1], AT_BIAS[1] + 2 * W)
    x = e.to(tl.float16)  # the latent
    if HAS_ROBOT:
        out = tl.zeros((M, ROBOT_SPACE), tl.float32)
        out = _hidden(x, out, weights, biases, W, ROBOT_SPACE, W, CHUNK, AT[2], AT_BIAS[2])
        at = tl.arange(0, ROBOT_SPACE)[None, :]
        mask = (ok & (token == 0))[:, None] & (at < ROBOT_OUT)
        tl.store(robot_out + world[:, None] * ROBOT_OUT + at, out, mask=mask)
    out = tl.zeros((M, OBJECT_SPACE), tl.float32)
    out = _hidden(x, out, weights, biases, W, OBJECT_SPACE, W, CHUNK, AT[3], AT_BIAS[3])
    at = tl.arange(0, OBJECT_SPACE)[None, :]
    place = world * N + token - HAS_ROBOT
    mask = (ok & (token >= HAS_ROBOT))[:, None] & (at < OBJECT_OUT)
    tl.store(objects_out + place[:, None] * OBJECT_OUT + at, out, mask=mask)


@triton.jit(do_not_specialize=["worlds"])
def spread_kernel(robot, objects, edges, control, attributes, setting, variance, weights, biases,
                  start, senders, found, worlds,
                  K: tl.constexpr, HAS_ROBOT: tl.constexpr, W: tl.constexpr, ROBOT: tl.constexpr,
                  ROBOT_SPACE: tl.constexpr, OBJECT: tl.constexpr, OBJECT_SPACE: tl.constexpr,
                  EDGE: tl.constexpr, EDGE_SPACE: tl.constexpr, CONTROL: tl.constexpr,
                  ATTRIBUTES: tl.constexpr, SETTING: tl.constexpr, COMMAND_SPACE: tl.constexpr,
                  DESCRIBED_SPACE: tl.constexpr, MOST_GAIN: tl.constexpr, MOST: tl.constexpr,
                  AT: tl.constexpr, AT_BIAS: tl.constexpr, NARROW: tl.constexpr,
                  M: tl.constexpr):  # fmt: skip
    """`spread.Spread` for M // K worlds: a row is a token.

    Args:
      robot, objects, edges, control, attributes, setting: as for `tokens_kernel`.
      variance: [B, K, 2]. start: [K, K, 4]. senders: [B, K, W], room.
      found: [B, K, 2], to be written.
      AT, AT_BIAS: where weights and biases begin of the robot's layer, the objects', the pairs',
        `sender`, `mix`, `gain` and `noise`, which have `NARROW` columns, those beyond theirs 0.
    """
    N: tl.constexpr = K - HAS_ROBOT
    USED: tl.constexpr = M // K * K
    local = tl.arange(0, M)
    row = tl.program_id(0).to(tl.int64) * USED + local
    ok = (local < USED) & (row < worlds * K)
    there = ok[:, None]
    world, token = row // K, row % K
    column, wide = tl.arange(0, NARROW)[None, :], tl.arange(0, W)[None, :]

    at = world * N + token - HAS_ROBOT
    object_here = ok & (token >= HAS_ROBOT)
    x = _rows(objects, at, object_here, OBJECT, OBJECT, OBJECT_SPACE).to(tl.float16)
    y = _beside(attributes, at, world, object_here, ATTRIBUTES, setting, SETTING, DESCRIBED_SPACE)
    own = tl.dot(x, _weight(weights, AT[1], W, OBJECT_SPACE, W))
    own = tl.dot(y, _weight(weights, AT[1] + OBJECT_SPACE * W, W, DESCRIBED_SPACE, W), own)
    own += tl.where(object_here[:, None], _vector(biases, AT_BIAS[1], W), 0.0)
    if HAS_ROBOT:  # of other rows these are zeros
        robot_here = ok & (token == 0)
        x = _rows(robot, world, robot_here, ROBOT, ROBOT, ROBOT_SPACE).to(tl.float16)
        y = _beside(control, world, world, robot_here, CONTROL, setting, SETTING, COMMAND_SPACE)
        own = tl.dot(x, _weight(weights, AT[0], W, ROBOT_SPACE, W), own)
        own = tl.dot(y, _weight(weights, AT[0] + ROBOT_SPACE * W, W, COMMAND_SPACE, W), own)
        own += tl.where(robot_here[:, None], _vector(biases, AT_BIAS[0], W), 0.0)
    own = _silu(own)
    mine = own.to(tl.float16)
    sender = tl.dot(mine, _weight(weights, AT[3], W, W, W)) + _vector(biases, AT_BIAS[3], W)
    tl.store(senders + row[:, None] * W + wide, sender.to(tl.float16), mask=there)
    tl.debug_barrier()  # those of other rows were written by other threads

    wp = _weight(weights, AT[2], W, EDGE_SPACE, W)
    wm = _weight(weights, AT[4], W, W, W)
    wg = _weight(weights, AT[5], NARROW, W, NARROW)
    own += _vector(biases, AT_BIAS[2], W)
    sent = tl.zeros((M, NARROW), tl.float32)
    all_pairs = tl.zeros((M, W), tl.float32)
    for j in tl.range(0, K):
        e = _rows(edges, row * K + j, ok, EDGE, EDGE, EDGE_SPACE).to(tl.float16)
        other = world[:, None] * K + j
        pair = tl.load(senders + other * W + wide, mask=there, other=0.0).to(tl.float32)
        pair = _silu(tl.dot(e, wp, own + pair)).to(tl.float16)
        pair = _silu(tl.dot(pair, wm) + _vector(biases, AT_BIAS[4], W))
        all_pairs += pair
        gain = tl.dot(pair.to(tl.float16), wg) + _vector(biases, AT_BIAS[5], NARROW)
        before = start + (token[:, None] * K + j) * 4 + column
        gain += tl.load(before, mask=there & (column < 4), other=0.0)
        # of (onto, from) in columns 0 to 3: what becomes of the other's variance of `from`
        theirs = variance + other * 2 + column % 2
        theirs = tl.load(theirs, mask=there & (column < 4), other=0.0)
        sent += MOST_GAIN * tl.sigmoid(gain) * theirs
    # As sums: of these two products with `tl.dot`, ptxas 12.8 (that of Triton 3.6) makes warpgroup
    # instructions (HGMMA) whose descriptor of the weights lies in registers that nothing has
    # written, so that they read any address; of the sums its code has no such read.
    mine, wide = mine.to(tl.float32), tl.arange(0, W)
    for onto in tl.static_range(2):
        at = weights + AT[6] + onto
        noise = tl.sum(mine * tl.load(at + wide * NARROW).to(tl.float32)[None, :], 1)
        more = tl.load(at + (W + wide) * NARROW).to(tl.float32)[None, :]
        noise += tl.sum(all_pairs * more, 1) + tl.load(biases + AT_BIAS[6] + onto)
        noise = tl.exp(tl.minimum(tl.maximum(noise, -20.0), 10.0))
        total = tl.sum(tl.where(column // 2 == onto, sent, 0.0), 1) + noise
        tl.store(found + row * 2 + onto, tl.minimum(total, MOST), mask=ok)
