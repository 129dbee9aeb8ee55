"""OrbiSim-Vision: a state-guided latent diffusion model as a renderer like any other.

docs/vision.md says what it is; docs/equations.md which function is which equation of the paper.
"""
