"""Whether an effect earns its place, and if not, why not."""

from __future__ import annotations

import numpy as np

from orbisim.diagnosis.refine import Judged
from orbisim.diagnosis.settings import Settings


def unpaid(settings: Settings, before: Judged, after: Judged) -> str | None:
    """Why the windows that were not fitted do not get better by enough and surely; None if they do.

    Args:
      before, after: the hypothesis without and with the effect, fitted on the same windows.
    """
    drop = before.checked - after.checked
    excess = max(float(before.checked.mean()) - 1.0, 1e-12)
    mean, error = float(drop.mean()), float(drop.std() / np.sqrt(max(len(drop), 1)))
    if not mean > 0:
        return "it makes windows that it was not fitted to no better"
    if mean <= settings.gain * max(excess, 0.02):
        return (
            f"on windows that it was not fitted to, it takes away {100 * mean / excess:.2g} % of "
            f"the squared residual; {100 * settings.gain:g} % are needed"
        )
    if mean < settings.certainty * error and mean < 0.5 * excess:
        return (
            f"on windows that it was not fitted to, its gain is {mean / error:.2g} standard errors "
            f"over windows; {settings.certainty:g} are needed"
        )
    gain = before.cost - after.cost
    if not gain > settings.margin:
        return (
            f"the information criterion falls by {gain:.2g}, {settings.margin:g} are needed for "
            "the numbers that it adds"
        )
    return None
