"""Policies: analytic gradients through the learned step, baselines, evaluation in MuJoCo."""
