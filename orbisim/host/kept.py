"""Results that are asked for again: what the same numbers gave is not computed twice."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

Result = TypeVar("Result")


class Kept(Generic[Result]):
    """Results by what they were computed from, those used last, within a budget.

    Args:
      size: bytes that a result takes. most: bytes that all take.
    """

    def __init__(self, size: Callable[[Result], int], most: int) -> None:
        self._size, self._most = size, most
        self._results: OrderedDict[bytes, Result] = OrderedDict()
        self._lock, self._taken = threading.Lock(), 0

    def of(self, key: bytes, compute: Callable[[], Result]) -> Result:
        """The result of a key (see `key_of`), computed if it is not kept."""
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
                return self._results[key]
        result = compute()
        size = self._size(result)
        with self._lock:
            if key not in self._results and size <= self._most:
                self._results[key] = result
                self._taken += size
                while self._taken > self._most:
                    self._taken -= self._size(self._results.popitem(last=False)[1])
        return result


def key_of(*parts: npt.ArrayLike) -> bytes:
    """A key that only the same numbers in the same shapes have."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        array = np.ascontiguousarray(part)
        digest.update(f"{array.dtype.str}{np.shape(part)};".encode())
        digest.update(array.tobytes())
    return digest.digest()
