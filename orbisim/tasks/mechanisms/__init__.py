"""Mechanisms with joints, locks and springs, made by parametric generators (docs/mechanisms.md).

`make(family, number)` gives the same instance every time; `write_urdf` and `write_usd` write it
for any program that reads those.
"""
