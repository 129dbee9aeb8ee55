"""Ways to damage a scene, for `fuzz_readers`."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from fuzz_seeds import Files

Mutation = Callable[[bytes, random.Random], bytes]

_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
_TOKEN = re.compile(rb"[A-Za-z_][\w:.]*")
_ATTRIBUTE = re.compile(rb'\s[\w:]+="[^"]*"')
_ELEMENT = re.compile(rb"<(\w+)[^<>]*?(?:/>|>.*?</\1>)", re.DOTALL)
_NASTY = (
    b"nan", b"inf", b"-inf", b"1e999", b"-1e999", b"1e308", b"1e-308", b"0", b"-1", b"-0.0", b"abc",
    b"", b"99999999999999999999", b"2147483648", b"-2147483649", b"1000000000", b"1e30", b"1e10",
    b"1 2 3 4 5 6 7 8 9", b"0x10", b"1_0", b"\xc3\xa9", b"\xff", b"&#0;", b"../../etc/passwd",
)  # fmt: skip


def _flip(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _span(data: bytes, rng: random.Random) -> tuple[int, int]:
    start = rng.randrange(len(data))
    return start, min(len(data), start + int(2 ** rng.uniform(0, 10)))


def _delete(data: bytes, rng: random.Random) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def _double(data: bytes, rng: random.Random) -> bytes:
    start, end = _span(data, rng)
    return data[:end] + data[start:end] * rng.choice((1, 1, 2, 20)) + data[end:]


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _noise(data: bytes, rng: random.Random) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + rng.randbytes(end - start) + data[end:]


def _at_match(
    pattern: re.Pattern[bytes], make: Callable[[re.Match[bytes], random.Random], bytes]
) -> Mutation:
    """Replaces one match of a pattern."""

    def mutate(data: bytes, rng: random.Random) -> bytes:
        found = list(pattern.finditer(data))
        if not found:
            return _flip(data, rng)
        match = rng.choice(found)
        return data[: match.start()] + make(match, rng) + data[match.end() :]

    return mutate


def _swap_tokens(data: bytes, rng: random.Random) -> bytes:
    found = list(_TOKEN.finditer(data))
    if len(found) < 2:
        return _flip(data, rng)
    a, b = sorted(rng.sample(found, 2), key=lambda match: match.start())
    return data[: a.start()] + b[0] + data[a.end() : b.start()] + a[0] + data[b.end() :]


def _move_element(data: bytes, rng: random.Random) -> bytes:
    found = list(_ELEMENT.finditer(data))
    if len(found) < 2:
        return _delete(data, rng)
    moved, target = rng.sample(found, 2)
    at = rng.choice((target.start(), target.end()))
    return data[:at] + moved[0] + data[at:]


BYTES: Sequence[Mutation] = (_flip, _delete, _double, _truncate, _noise)
TOKENS: Sequence[Mutation] = (
    _swap_tokens,
    _move_element,
    _at_match(_NUMBER, lambda match, rng: rng.choice(_NASTY)),
    _at_match(_NUMBER, lambda match, rng: b"%g" % (float(match[0]) * 10 ** rng.uniform(-12, 12))),
    _at_match(_NUMBER, lambda match, rng: b"-" + match[0].lstrip(b"-")),
    _at_match(_TOKEN, lambda match, rng: rng.choice((b"", b"x", match[0] * 2, match[0][:-1]))),
    _at_match(_ATTRIBUTE, lambda match, rng: b""),
    _at_match(_ATTRIBUTE, lambda match, rng: match[0] * 2),
    _at_match(_ELEMENT, lambda match, rng: b""),
    _at_match(_ELEMENT, lambda match, rng: match[0] * rng.choice((2, 2, 50))),
)


def mutated(files: Files, rng: random.Random) -> Files:
    """A scene with one file damaged, mostly the scene file itself, text mostly by token."""
    names = list(files)
    name = names[0] if rng.random() < 0.8 else rng.choice(names)
    content = files[name]
    data = content.read_bytes() if isinstance(content, Path) else content
    binary = b"\0" in data[:1024]
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        kinds = BYTES if binary or rng.random() < 0.25 else TOKENS
        data = rng.choice(kinds)(data or b"\n", rng)
    return {**files, name: data}
