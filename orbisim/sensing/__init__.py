"""Sensors that do not read the joints themselves (gyros, force sensors, second encoders): what each
should have read along a motion, and which offset, scale or delay of it explains what it did read.

`readings` gives expected beside measured readings, along free runs or along the smoothed motion;
`forms` fits a sensor's offset, scale and delay; `faults` decides which of them it has.
"""
