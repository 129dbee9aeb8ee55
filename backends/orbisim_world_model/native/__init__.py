"""The learned step of one world as compiled C: for a processor, where calls cost more than sums.

The step is traced once with torch, everything that depends on weights and descriptors alone is
computed once, and what is left is written as C with fixed sizes. The C code depends on the
structure only; weights are handed to it, so that it is compiled once for each layout.
"""

from orbisim_world_model.native.step import NativeStep

__all__ = ["NativeStep"]
