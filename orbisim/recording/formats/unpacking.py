"""Compressed parts of bags, unpacked within bounds."""

from __future__ import annotations

import bz2
import io

MEGABYTE = 2**20  # bytes
_LEAST = 64 * MEGABYTE
"""Bytes that any part may unpack to; recorders write chunks of about one megabyte."""
_RATIO = 200
"""As `orbisim.files.reading.RATIO`, of one part."""
_WINDOW = 128 * MEGABYTE
"""Memory of a zstandard frame (its own recommendation is 8 megabytes)."""


def unpacked(data: bytes, kind: str, size: int | None = None) -> bytes:
    """A part of a file, unpacked.

    Args:
      data: the part. kind: `bz2`, `lz4`, `zstd`; `` and `none` for what is not compressed.
      size: that it should have, if that is known.

    Raises:
      ValueError: it is damaged, is larger than it should be or than is reasonable, or is packed in
        another way.
    """
    if kind in ("", "none"):
        return data
    most = max(_LEAST, _RATIO * len(data))
    if size is not None:
        if size > most:
            raise ValueError(f"a part of {len(data)} bytes says that it unpacks to {size}")
        most = size
    unpack = {"bz2": _bz2, "lz4": _lz4, "zstd": _zstd}.get(kind)
    if unpack is None:
        raise ValueError(f"it is packed by {kind[:40]!r}; known are bz2, lz4 and zstd")
    found = unpack(data, most + 1)
    if len(found) > most or (size is not None and len(found) != size):
        raise ValueError(f"a part of {len(data)} bytes does not unpack to the size that it says")
    return found


def _bz2(data: bytes, most: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, max_length=most)


def _lz4(data: bytes, most: int) -> bytes:
    import lz4.frame

    found: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
    return found


def _zstd(data: bytes, most: int) -> bytes:
    import zstandard

    unpacker = zstandard.ZstdDecompressor(max_window_size=_WINDOW)
    with unpacker.stream_reader(io.BytesIO(data)) as stream:
        found: bytes = stream.read(most)
    return found
