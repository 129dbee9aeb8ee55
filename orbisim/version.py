"""The version of OrbiSim."""

VERSION = "0.1.0"
