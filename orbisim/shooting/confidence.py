"""How sure fitted parameters are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbisim.shooting.fits import Fit


def confidence(fit: Fit, names: Sequence[str], seed: int = 0) -> dict[str, tuple[float, float]]:
    """95 % intervals of fitted parameters: the wider of the Jacobian's and a block bootstrap's.

    The bootstrap resamples windows and takes one Gauss-Newton step from the fit. Where few windows
    feel a parameter, resamples that hardly contain any of them say nothing and are left out.
    """
    count = len(fit.values)
    if not count:
        return {}
    rng = np.random.default_rng(seed)
    windows = len(fit.information)
    draws, felt = np.empty((_DRAWS, count)), np.zeros(_DRAWS, bool)
    scale = np.sqrt(np.maximum(np.diag(fit.information.sum(axis=0)), 1e-300))
    for d in range(_DRAWS):
        chosen = rng.integers(0, windows, windows)
        gram = fit.information[chosen].sum(axis=0) / np.outer(scale, scale)
        felt[d] = np.diag(gram).min() >= _FELT
        moment = fit.score[chosen].sum(axis=0) / scale
        draws[d] = fit.values + np.linalg.lstsq(gram, moment, rcond=1e-10)[0] / scale
    draws = draws[felt] if felt.any() else np.array([fit.values])
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    width = 1.96 * np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    low, high = np.minimum(low, fit.values - width), np.maximum(high, fit.values + width)
    return {n: (float(low[i]), float(high[i])) for i, n in enumerate(names)}


_DRAWS = 200
"""Resamples: five of them lie beyond either end of an interval."""
_FELT = 1e-4
"""Share of what all windows say about a parameter that a resample must say."""
