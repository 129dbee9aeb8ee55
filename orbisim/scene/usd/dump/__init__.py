"""Dumps a USD stage into plain numbers, in a process of its own.

The only package that imports OpenUSD (`pxr`), whose parsers can crash on broken files; see
`orbisim.scene.usd.process` for how it is started and held to its limits.
"""
