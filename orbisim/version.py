"""The version of OrbiSim."""

VERSION = "1.0.0"
