"""OrbiSim-Dynamics: a learned step as an OrbiSim backend, its training and its checkpoints.

Modules import what they need: training needs torch and no MuJoCo, reading a scene needs MuJoCo.
"""
